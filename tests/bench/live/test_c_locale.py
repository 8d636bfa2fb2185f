import subprocess
import sys

import pytest

from gyrobench.bench.live.c_locale import is_c_locale

ASK = "import os; from gyrobench.bench.live.c_locale import is_c_locale; print(is_c_locale(os.environ))"


@pytest.mark.parametrize(
    ("environment", "is_c"),
    [
        ({"LC_ALL": "C"}, True),
        ({"LC_ALL": "POSIX", "LANG": "de_DE.UTF-8"}, True),
        ({"LANG": "C"}, True),
        ({"LANG": "C", "LC_ALL": "C.UTF-8"}, False),
        ({"LANG": "C", "LC_CTYPE": "C.UTF-8"}, False),
        ({}, False),
    ],
)
def test_a_c_locale_gets_ascii_although_python_would_write_utf_8(environment, is_c):
    run = subprocess.run(
        [sys.executable, "-c", ASK], env=environment, capture_output=True, text=True, check=True
    )
    assert run.stdout.strip() == str(is_c)


def test_the_character_locale_counts_before_the_language():
    assert is_c_locale({"LC_ALL": "", "LC_CTYPE": "C", "LANG": "de_DE.UTF-8"}) != bool(sys.flags.utf8_mode)
