"""Kinds of file: their schemas, and the check of a file."""

import copy
import io
import json
import subprocess
from contextlib import redirect_stderr, redirect_stdout
from functools import cache
from pathlib import Path
from types import SimpleNamespace

import pytest
from jsonschema import Draft202012Validator

from gyrobench.bench.authoring import file_kinds
from gyrobench.bench.authoring.file_kinds import (
    KINDS,
    PROCEDURE,
    STATION,
    check_file,
    editor_line,
    kind_of,
    schema_of,
)
from gyrobench.bench.foundations.documents import read_document
from gyrobench.bench.foundations.shipped import find_document, shipped_folder, shipped_names
from gyrobench.bench.station.station import Station
from gyrobench.drivers.emulators.check_file import main as emulators_program
from tests.bench.command_line import gyrobench

#: The emulators' files are checked by a process of their own; one of each shows that.
SHIPPED_NAMES = [
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


@pytest.mark.parametrize(("kind", "folder", "name"), SHIPPED_NAMES)
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


ROOT = Path(__file__).parents[3]
SHIPPED = sorted(
    path for kind in KINDS.values() if kind.folder for path in (ROOT / kind.folder).glob("*.yaml")
)


@cache
def validator(kind):
    return Draft202012Validator(schema_of(kind))


def shipped(kind, name):
    return copy.deepcopy(read_document(ROOT / kind.folder / f"{name}.yaml").data)


@pytest.mark.parametrize("kind", KINDS.values(), ids=KINDS)
def test_the_schema_of_a_kind_is_a_schema(kind):
    Draft202012Validator.check_schema(validator(kind).schema)


def test_the_command_writes_and_prints_the_schemas(tmp_path):
    assert gyrobench("schema", "--out", tmp_path, cwd=tmp_path).returncode == 0
    assert {path.name for path in tmp_path.iterdir()} == {kind.schema_name for kind in KINDS.values()}
    for kind in KINDS.values():
        assert json.loads((tmp_path / kind.schema_name).read_text()) == validator(kind).schema
    printed = gyrobench("schema", "procedure", cwd=tmp_path).stdout
    assert printed == (tmp_path / "procedure.schema.json").read_text()


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: f"{path.parent.name}/{path.stem}")
def test_a_shipped_file_fits_its_schema_and_names_it(path):
    document = read_document(path)
    kind = kind_of(document)
    assert [error.message for error in validator(kind).iter_errors(document.data)] == []
    first = document.text.splitlines()[0]
    assert first == f"# yaml-language-server: $schema=../schemas/{kind.schema_name}"
    assert f"{first}\n" == editor_line(kind, path)


def without(document, *keys):
    for key in keys[:-1]:
        document = document[key]
    del document[keys[-1]]


def with_value(document, value, *keys):
    for key in keys[:-1]:
        document = document[key]
    document[keys[-1]] = value


STEPS = [
    {"soak": {}},
    {"soak": {"for_s": 600, "until_gyro_rate_below_c_per_h": 1}},
    {"soak": {"for": 600}},
    {"sok": {"for_s": 600}},
    {"soak": {"for_s": "600"}},
    {"soak": {"for_s": 0}},
    {"go_to": {"position": "z_upp"}},
    {"go_to": {}},
    "go_to",
    {"wait": {"duration_s": 1}, "power_off": None},
    {"navigate": {"until": {"bias_sigma_below_dph": 0.001}}},
    {"align": {}},
    {"chamber": {"temperature_c": "$", "ramp_c_per_min": 1}},
    {"repeat": {"over": {"cycle": []}, "steps": ["power_off"]}},
    {"repeat": {"over": {"cycle": [1]}, "steps": [{"wait": {}}]}},
    {"repeat": {"over": {"cycle": [1]}}},
]


@pytest.mark.parametrize("step", STEPS, ids=str)
def test_a_mistake_in_a_step_does_not_fit(step):
    procedure = shipped(PROCEDURE, "ten_minute_check")
    procedure["steps"].append(step)
    assert not validator(PROCEDURE).is_valid(procedure)


@pytest.mark.parametrize(
    "step",
    [
        "power_off",
        {"power_off": None},
        {"power_off": {"retries": 1}},
        {"soak": {"for_s": 600}},
        {
            "repeat": {
                "over": {"cycle": [1, 2], "position": ["z_up"]},
                "steps": [{"go_to": {"position": "$position"}}],
            }
        },
        {"chamber": {"temperature_c": "$chamber_c", "ramp_c_per_min": "$ramp"}},
        {"navigate": {"until": {"bias_sigma_below_dph": "$sigma"}, "at_most_s": 1200}},
    ],
    ids=str,
)
def test_a_right_step_fits(step):
    procedure = shipped(PROCEDURE, "ten_minute_check")
    procedure["steps"].append(step)
    assert [error.message for error in validator(PROCEDURE).iter_errors(procedure)] == []


@pytest.mark.parametrize(
    ("value", "keys"),
    [
        ("watlow_f5", ("chamber", "dialect")),
        (-3, ("chamber", "limits", "ramp_c_per_min")),
        (91, ("location", "latitude_deg")),
        ([1, 2, 3], ("rate_table", "limits", "inner_deg")),
        ("sideways", ("rate_table", "inner_axis")),
        ("guessed", ("ins", "noise")),
        ("NO_DOT", ("ins", "signals", "velocity_east")),
        ("warm", ("safe_state", "chamber_c")),
        (True, ("instruments_period_s",)),
        (1, ("unknown_key",)),
    ],
    ids=str,
)
def test_a_mistake_in_a_station_does_not_fit(value, keys):
    station = shipped(STATION, "quick")
    with_value(station, value, *keys)
    assert not validator(STATION).is_valid(station)


@pytest.mark.parametrize(
    "keys", [("chamber", "port"), ("safe_state",), ("ins", "signals", "attitude")], ids=str
)
def test_a_station_that_lacks_a_key_does_not_fit(keys):
    station = shipped(STATION, "quick")
    without(station, *keys)
    assert not validator(STATION).is_valid(station)


@pytest.mark.parametrize(
    ("value", "keys"),
    [
        ("off", ("safe_state", "chamber_c")),
        ("estimated", ("ins", "noise")),
        ({"signal": "A.B", "sign": -1}, ("ins", "signals", "velocity_east")),
        ([1, 2], ("ins", "signals", "mode", "standby")),
        ("rpy_321", ("ins", "signals", "attitude", "euler", "sequence")),
    ],
    ids=str,
)
def test_other_ways_to_write_a_station_fit(value, keys):
    station = shipped(STATION, "quick")
    with_value(station, value, *keys)
    assert [error.message for error in validator(STATION).iter_errors(station)] == []


@pytest.mark.parametrize("kind", KINDS.values(), ids=KINDS)
def test_every_key_says_what_it_means(kind):
    schema = validator(kind).schema
    sections = {kind.name: schema, **schema["$defs"]} if "$defs" in schema else {kind.name: schema}
    silent = [
        f"{name}.{key}"
        for name, section in sections.items()
        if name != "entry"
        for key, each in section.get("properties", {}).items()
        if not each.get("description") and "const" not in each
    ]
    assert silent == []


def test_schemas_that_a_checkout_lacks_are_written_when_a_file_names_them(tmp_path, monkeypatch):
    (tmp_path / "schemas").mkdir()
    monkeypatch.setattr(file_kinds, "shipped_folder", lambda name: tmp_path / name)
    line = editor_line(STATION, Path("/elsewhere/mine.yaml"))
    assert line == f"# yaml-language-server: $schema={tmp_path}/schemas/station.schema.json\n"
    assert json.loads((tmp_path / "schemas" / "station.schema.json").read_text()) == validator(STATION).schema
    (tmp_path / "full" / "schemas" / "procedure.schema.json").mkdir(parents=True)  # can't be written
    monkeypatch.setattr(file_kinds, "shipped_folder", lambda name: tmp_path / "full" / name)
    assert editor_line(STATION, Path("/elsewhere/mine.yaml")) == ""
    monkeypatch.setattr(file_kinds, "shipped_folder", lambda name: tmp_path / "none" / name)
    assert editor_line(STATION, Path("/elsewhere/mine.yaml")) == ""


def test_a_file_elsewhere_names_the_schema_by_its_whole_path(tmp_path):
    line = editor_line(PROCEDURE, tmp_path / "mine.yaml")
    path = Path(line.strip().partition("=")[2])
    assert path == shipped_folder("schemas") / "procedure.schema.json"
    assert path.is_file()
