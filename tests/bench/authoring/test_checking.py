"""What a file is, and everything wrong with it."""

import io
import subprocess
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path
from types import SimpleNamespace

import pytest

from gyrobench.bench.authoring import file_kinds
from gyrobench.bench.authoring.file_kinds import KINDS, PROCEDURE, check_file
from gyrobench.bench.foundations.shipped import find_document, shipped_names
from gyrobench.bench.station.station import Station
from gyrobench.drivers.emulators.check_file import main as emulators_program

#: The emulators' files are checked by a process of their own; one of each shows that.
SHIPPED = [
    ("world", "worlds", "quick"),
    ("faults", "faults", "every_kind"),
    *(
        (kind.name, kind.folder, name)
        for kind in KINDS.values()
        if kind.model
        for name in shipped_names(kind.folder)
    ),
]
COMPENSATION = "polynomial_dph: [[0.1], [0.2], [0.3]]\nlow_c: [0, 0, 0]\nhigh_c: [60, 60, 60]\n"


@pytest.mark.parametrize(("kind", "folder", "name"), SHIPPED)
def test_a_shipped_file_is_known_for_what_it_is_and_right(kind, folder, name):
    check = check_file(find_document(folder, name))
    assert (check.kind, check.text) == (kind, "")


def test_a_compensation_is_known_for_what_it_is(tmp_path):
    path = tmp_path / "c.yaml"
    path.write_text(COMPENSATION)
    assert check_file(path).kind == "compensation"
    assert check_file(path).is_good


@pytest.fixture
def without_a_process(monkeypatch):
    """The emulators' program runs in this process."""

    def run(command, **options):
        assert command[1:3] == ["-P", "-m"]
        printed, complained = io.StringIO(), io.StringIO()
        with redirect_stdout(printed), redirect_stderr(complained):
            code = emulators_program(command[4:])
        return subprocess.CompletedProcess(command, code, printed.getvalue(), complained.getvalue())

    monkeypatch.setattr(
        file_kinds, "subprocess", SimpleNamespace(run=run, TimeoutExpired=subprocess.TimeoutExpired)
    )


def changed(tmp_path, folder, name, *pairs):
    text = find_document(folder, name).read_text()
    for old, new in pairs:
        assert old in text
        text = text.replace(old, new, 1)
    path = tmp_path / f"{name}.yaml"
    path.write_text(text)
    return path


@pytest.mark.usefixtures("without_a_process")
@pytest.mark.parametrize(
    ("folder", "name", "pairs", "kind", "said"),
    [
        (
            "procedures",
            "ten_minute_check",
            [("settle_s", "setle_s"), ("z_up", "z_upp")],
            "procedure",
            ["setle_s", "z_upp"],
        ),
        (
            "procedures",
            "ten_minute_check",
            [("procedure:", "prosedure:")],
            "procedure",
            ["prosedure", "'procedure' is missing"],
        ),
        (
            "stations",
            "quick",
            [("tick_s: 2.0", "tick_s: 200"), ("HEADING.HEADING", "HEADING.NONE")],
            "station",
            ["tick_s"],
        ),
        (
            "worlds",
            "quick",
            [("latitude_deg: 36.4", "latitude_deg: 100"), ("boot_s", "bot_s")],
            "world",
            ["latitude_deg", "bot_s"],
        ),
        ("faults", "every_kind", [("lost_reply", "lost_replies")], "faults", ["lost_replies"]),
        ("imports", "ln100", [("unit: deg/s", "unit: rpm")], "import", ["deg/s"]),
    ],
)
def test_everything_wrong_is_reported_with_its_place(folder, name, pairs, kind, said, tmp_path):
    check = check_file(changed(tmp_path, folder, name, *pairs))
    assert check.kind == kind
    assert len(check.problems()) == len(said)
    for words in said:
        assert any(words in problem.message and problem.line for problem in check.problems())


@pytest.mark.usefixtures("without_a_process")
@pytest.mark.parametrize(
    ("folder", "name", "right", "wrong", "message"),
    [
        (
            "worlds",
            "gyro_a",
            "kind: att",
            "kind: at",
            "unknown kind 'atitude_thermal' (did you mean 'attitude_thermal'?); allowed here: t",
        ),
        ("worlds", "gyro_a", "kind: att", "knd: att", "the key 'kind' is missing"),
        (
            "faults",
            "every_kind",
            "fault: lost_reply",
            "fault: lost_replay",
            "unknown fault 'lost_replay' (did you mean 'lost_reply'?); allowed here: ",
        ),
    ],
)
def test_an_entry_of_an_unknown_kind_is_reported_with_the_kinds_that_there_are(
    folder, name, right, wrong, message, tmp_path
):
    check = check_file(changed(tmp_path, folder, name, (right, wrong)))
    [problem] = check.problems()
    assert problem.message.startswith(message)
    assert problem.line > 1


def test_a_signal_that_the_dbc_file_lacks_is_reported(tmp_path):
    check = check_file(changed(tmp_path, "stations", "quick", ("HEADING.HEADING", "HEADING.NONE")))
    assert "NONE" in check.text


def test_a_value_of_a_loop_that_its_step_can_not_take_is_reported(tmp_path):
    path = tmp_path / "p.yaml"
    path.write_text(
        "procedure: p\nsteps:\n  - repeat:\n      over: {x: [1, -1]}\n"
        "      steps: [{wait: {duration_s: $x}}]\n"
    )
    [problem] = check_file(path).problems()
    assert (problem.line, problem.column) == (4, 21)


def test_with_a_station_the_plan_is_checked_too(tmp_path):
    path = tmp_path / "p.yaml"
    path.write_text("procedure: p\nsteps:\n  - chamber: {temperature_c: 300, ramp_c_per_min: 1}\n")
    assert check_file(path).is_good
    check = check_file(path, station=Station(find_document("stations", "quick")))
    assert "300" in check.text


@pytest.mark.parametrize("text", ["a: 1\n", "- 1\n", "just text\n", "", "x: [1\n"])
def test_what_is_not_a_file_of_the_bench_is_reported_without_a_kind(text, tmp_path):
    path = tmp_path / "x.yaml"
    path.write_text(text)
    check = check_file(path)
    assert check.kind == ""
    assert str(path) in check.text


def test_the_kind_that_a_file_is_meant_to_be_can_be_said(tmp_path):
    path = tmp_path / "x.yaml"
    path.write_text("a: 1\n")
    assert "'procedure' is missing" in check_file(path, PROCEDURE).text


def test_a_file_that_is_not_there_is_reported():
    assert "nowhere.yaml" in check_file(Path("nowhere.yaml")).text
