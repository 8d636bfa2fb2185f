"""Commands without the POSIX modules of the standard library, and without optional packages."""

import json
import os
import subprocess
import sys

import pytest

from gyrobench.bench.bias.dwell_table import write_dwells
from gyrobench.bench.cli.output import EXIT_WRONG_INPUT
from tests.bench.report.made_up_closure import made_up_rows

POSIX_MODULES = ["fcntl", "termios", "tty", "pty", "pwd", "grp", "resource"]
OPTIONAL_PACKAGES = ["dask", "distributed", "duckdb", "fsspec", "weasyprint", "asammdf"]

pytestmark = pytest.mark.long

#: Runs commands one after the other in a process in which modules can't be imported: POSIX modules not by
#: this package (pyserial and others choose theirs by the operating system), optional packages not at all.
PROGRAM = """
import builtins, io, json, sys
from contextlib import redirect_stderr, redirect_stdout

posix, optional, commands = json.loads(sys.argv[1])
import_module = builtins.__import__

def blocked_import(name, globals=None, locals=None, fromlist=(), level=0):
    importer = (globals or {}).get("__name__") or ""
    top = name.partition(".")[0]
    if level == 0 and (top in optional or (top in posix and importer.startswith("gyrobench"))):
        raise ModuleNotFoundError(f"No module named {name!r}", name=name)
    return import_module(name, globals, locals, fromlist, level)

class Finder:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in optional:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)

builtins.__import__ = blocked_import
sys.meta_path.insert(0, Finder())
from gyrobench.bench.cli import main

results = []
for command in commands:
    sys.argv = ["gyrobench", *command]
    printed = io.StringIO()
    code = 0
    with redirect_stdout(printed), redirect_stderr(printed):
        try:
            main()
        except SystemExit as end:
            code = end.code or 0
    results.append([code, printed.getvalue()])
print(json.dumps(results))
"""


def results_of(commands, cwd):
    """Exit code and output of each command."""
    modules = json.dumps([POSIX_MODULES, OPTIONAL_PACKAGES, commands])
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM, modules],
        cwd=cwd,
        env=os.environ | {"COLUMNS": "200"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


RUN = "runs/ten_minute_check-001"


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """A folder with a finished run, made without POSIX modules and optional packages."""
    cwd = tmp_path_factory.mktemp("portable")
    ((code, text),) = results_of([["run", "ten_minute_check", "--world", "ideal", "--view", "lines"]], cwd)
    assert code == 0, text
    return cwd


def test_commands_of_a_run_need_no_posix_module(finished, log):
    write_dwells(finished / "campaign.csv", made_up_rows())
    data, mapping = log.write(), log.mapping()
    commands = [
        ["plan", "ten_minute_check"],
        ["validate", f"{RUN}/procedure.yaml"],
        ["bins", RUN],
        ["close", "campaign.csv"],
        ["report", RUN],
        ["import", str(data), "--map", str(mapping), "--out", "imported.csv"],
        ["export", RUN, "--what", "dwells,telemetry,can"],
    ]
    for command, (code, text) in zip(commands, results_of(commands, finished), strict=True):
        assert code == 0, f"{command}: {text}"


@pytest.mark.parametrize(
    ("command", "extra"),
    [
        (("fleet", "bins", RUN, "--scheduler", "tcp://127.0.0.1:9"), "fleet"),
        (("runs", "runs"), "index"),
        (("report", RUN, "--pdf"), "pdf"),
        (("export", RUN, "--what", "can", "--format", "mf4"), "mf4"),
    ],
)
def test_a_command_names_the_extra_of_a_missing_package(finished, command, extra):
    ((code, text),) = results_of([command], finished)
    assert code == EXIT_WRONG_INPUT
    assert f"pip install 'gyrobench[{extra}]'" in text
    assert "Traceback" not in text
