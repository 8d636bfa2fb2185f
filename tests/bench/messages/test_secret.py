import base64
import html
import json
from urllib.parse import quote, quote_plus

import pytest

from gyrobench.bench.messages.delivery import server_words, without_secret

SECRET = "Geheim/Wort+9 x&y"  # noqa: S105 - made up


@pytest.mark.parametrize(
    "written",
    [
        SECRET,
        quote(SECRET, safe="/"),
        quote(SECRET, safe=""),
        quote(SECRET, safe="").lower(),
        quote_plus(SECRET),
        html.escape(SECRET),
        json.dumps(SECRET)[1:-1],
        SECRET.replace("/", r"\/"),
        SECRET.upper(),
    ],
)
def test_it_is_left_out_however_it_is_written(written):
    assert without_secret(SECRET, f"Cannot POST /hook/{written}!") == "Cannot POST /hook/{secret}!"


@pytest.mark.parametrize("user", ["", "a", "ab", "abc"])
def test_it_is_left_out_of_a_login_in_base64(user):
    said = base64.b64encode(f"{user}\0{SECRET}\0".encode()).decode()
    shown = without_secret(SECRET, said)
    assert "{secret}" in shown
    assert len(shown.replace("{secret}", "")) < 12


def test_no_part_of_it_is_left_where_an_answer_is_cut():
    for before in range(150, 220):
        shown = server_words(SECRET, "x" * before + SECRET)
        assert "Geh" not in shown
        assert len(shown) <= 200


def test_without_a_secret_all_is_shown():
    assert without_secret("", "nothing to hide") == "nothing to hide"


def test_words_of_a_server_are_one_printable_line():
    assert server_words("", "a\x1b[2J\r\n\tb  c") == "a [2J b c"
