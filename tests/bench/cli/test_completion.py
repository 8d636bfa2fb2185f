"""What the shell offers while a command is typed, by the shells' own protocol."""

import subprocess
import sys

import pytest

from gyrobench.bench.exchange.run_export import DataKind, Format
from tests.bench.command_line import gyrobench


def asked(environment, cwd):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys.modules["__main__"], "__package__", None)  # the program is not `python -m pytest`
        for name, value in environment.items():
            patch.setenv(name, value)
        answer = gyrobench(cwd=cwd)
    assert answer.stderr == ""
    return answer.stdout.split()


def offered(typed, cwd):
    """What bash would offer for the last word of a line."""
    words = f"gyrobench {typed}"
    return asked(
        {
            "_GYROBENCH_COMPLETE": "complete_bash",
            "COMP_WORDS": words,
            "COMP_CWORD": str(len(words.split()) - (not words.endswith(" "))),
        },
        cwd,
    )


@pytest.mark.parametrize(
    ("typed", "expected"),
    [
        ("pla", {"plan"}),
        ("plan six", {"six_position_fig7"}),
        ("check qui", {"quick"}),
        ("jog emul", {"emulated"}),
        ("run x --world gyro", {"gyro_a", "gyro_b"}),
        ("run x --faults ev", {"every_kind"}),
        ("verify r --station ex", {"example_bench"}),
        ("new procedure x --like ch", {"check"}),
        ("new procedure x --like ver", {"verify_compensation"}),
        ("emulate --station sing", {"single_axis"}),
        ("message qui", {"quick"}),
        ("import log.csv --map ex", {"example_log"}),
        ("validate --as fau", {"faults"}),
        ("new station x --chamber wat", {"watlow_f4"}),
        ("new station x --table acu", {"acutrol3000"}),
        ("close r --coefficient gyro_s", {"gyro_scale_factor"}),
        ("export r --what dwells,ca", {"dwells,can"}),
        ("export r --format bl", {"blf"}),
        ("certificate r --format dcc,p", {"dcc,pdf"}),
    ],
)
def test_bash_is_offered_commands_and_shipped_names(typed, expected, tmp_path):
    found = set(offered(typed, tmp_path))
    assert expected <= found
    assert all(each.startswith(typed.split()[-1]) for each in found)


def test_all_kinds_and_formats_of_an_export_are_offered(tmp_path):
    assert set(offered("export r --what ", tmp_path)) == set(DataKind)
    assert set(offered("export r --format ", tmp_path)) == set(Format)


def test_run_folders_are_offered_wherever_they_are(tmp_path):
    for name in ("runs/a-001", "runs/b-001", "else/c-001"):
        (tmp_path / name).mkdir(parents=True)
        (tmp_path / name / "journal.jsonl").touch()
    (tmp_path / "runs" / "no_run").mkdir()
    assert set(offered("bins ", tmp_path)) == {"runs/a-001", "runs/b-001"}
    assert offered("close runs/b", tmp_path) == ["runs/b-001"]
    assert offered("bins else/", tmp_path) == ["else/c-001"]
    assert offered("monitor runs/a", tmp_path) == ["runs/a-001"]
    assert offered("verify runs/a", tmp_path) == ["runs/a-001"]
    assert offered("report runs/b-001 --before runs/a", tmp_path) == ["runs/a-001"]


def test_what_fits_no_name_is_left_to_the_shell(tmp_path):
    assert offered("plan ./mine", tmp_path) == []
    assert offered("bins ", tmp_path) == []


@pytest.mark.parametrize(
    "environment",
    [
        {"_GYROBENCH_COMPLETE": "complete_zsh"},
        {"_GYROBENCH_COMPLETE": "complete_fish", "_TYPER_COMPLETE_FISH_ACTION": "get-args"},
    ],
    ids=["zsh", "fish"],
)
def test_zsh_and_fish_are_offered_the_same(environment, tmp_path):
    found = asked(environment | {"_TYPER_COMPLETE_ARGS": "gyrobench plan six"}, tmp_path)
    assert "six_position_fig7" in " ".join(found)


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_the_script_for_each_shell_calls_the_command(shell, tmp_path):
    script = " ".join(asked({"_GYROBENCH_COMPLETE": f"source_{shell}"}, tmp_path))
    assert f"_GYROBENCH_COMPLETE=complete_{shell}" in script


def test_completion_loads_nothing_heavy():
    code = (
        "import sys, gyrobench.bench.cli; "
        "print([m for m in ('numpy', 'pydantic', 'rich', 'can') if m in sys.modules])"
    )
    answer = subprocess.run((sys.executable, "-c", code), capture_output=True, text=True, timeout=100)
    assert answer.stdout.strip() == "[]"
