"""`gyrobench new`, `validate` and `schema` as they are typed."""

import json

import pytest

from tests.bench.authoring.filled_in import filled_in
from tests.bench.command_line import gyrobench, output_of, refusal_of


def test_a_new_procedure_can_be_planned_at_once(tmp_path):
    output_of("new", "procedure", "mine", "--like", "check", cwd=tmp_path)
    assert (tmp_path / "mine.yaml").is_file()
    assert gyrobench("plan", "mine.yaml", cwd=tmp_path).returncode == 0


def test_a_file_that_is_there_is_not_written_over(tmp_path):
    path = tmp_path / "mine.yaml"
    path.write_text("precious")
    assert "mine.yaml: exists already" in refusal_of("new", "station", "mine", cwd=tmp_path)
    assert path.read_text() == "precious"


def test_a_folder_that_is_not_there_is_reported(tmp_path):
    problem = refusal_of("new", "station", "mine", "--out", "nowhere/mine.yaml", cwd=tmp_path)
    assert "No such file or directory" in problem


def test_a_new_file_can_go_to_standard_output(tmp_path):
    made = gyrobench("new", "station", "mine", "--out", "-", cwd=tmp_path)
    assert made.stdout.startswith("# yaml-language-server: $schema=")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("kind", ["procedure", "station", "world", "effect"])
@pytest.mark.parametrize("name", [("-",), ("--", "-mine")])
def test_a_name_that_begins_with_a_hyphen_is_refused_with_the_option_for_standard_output(
    kind, name, tmp_path
):
    problem = refusal_of("new", kind, *name, cwd=tmp_path)
    assert f"found '{name[-1]}'. For standard output: NAME --out -" in problem
    assert list(tmp_path.iterdir()) == []


def test_an_unknown_template_is_shown_with_the_shipped_ones(tmp_path):
    assert "ten_minute_check" in refusal_of("new", "procedure", "mine", "--like", "nothing", cwd=tmp_path)


def test_right_files_are_named_for_what_they_are(tmp_path):
    gyrobench("new", "procedure", "mine", cwd=tmp_path)
    gyrobench("new", "station", "bench", cwd=tmp_path)
    (tmp_path / "bench.yaml").write_text(filled_in((tmp_path / "bench.yaml").read_text()))
    printed = output_of("validate", "mine.yaml", "bench.yaml", "--station", "emulated", cwd=tmp_path)
    assert printed == (
        "mine.yaml: valid procedure file, 7 steps, 1 dwell, 0:09 h on emulated\n"
        "bench.yaml: valid station file, not filled in yet: description, rate_table.port and chamber.port\n"
    )


def test_without_a_station_a_procedure_states_that_limits_are_not_checked(tmp_path):
    (tmp_path / "p.yaml").write_text(
        "procedure: p\nsteps:\n  - chamber: {temperature_c: -80, ramp_c_per_min: 50}\n"
    )
    assert output_of("validate", "p.yaml", cwd=tmp_path) == (
        "p.yaml: valid procedure file, 1 step. Limits of a station are not checked: add --station STATION\n"
    )
    output = output_of("validate", "p.yaml", "--station", "emulated", cwd=tmp_path, code=2)
    assert "-80 degC is outside the chamber's range" in output


def test_the_order_of_steps_is_checked_without_a_station(tmp_path):
    (tmp_path / "p.yaml").write_text("procedure: p\nsteps:\n  - align: {duration_s: 60}\n")
    assert "align needs the INS on" in output_of("validate", "p.yaml", cwd=tmp_path, code=2)


def test_wrong_files_are_shown_with_places_and_exit_code_2(tmp_path):
    (tmp_path / "p.yaml").write_text("procedure: p\nsteps:\n  - wait: {duration_s: -1}\n  - sok\n")
    lines = output_of("validate", "p.yaml", cwd=tmp_path, code=2).splitlines()
    assert lines[0].startswith("p.yaml:3:12: 'duration_s' must be above 0")
    assert lines[1].startswith("p.yaml:4:5: unknown step")


def test_a_program_reads_the_same_as_json(tmp_path):
    (tmp_path / "p.yaml").write_text("procedure: p\nsteps:\n  - wait: {duration_s: -1}\n")
    gyrobench("new", "station", "bench", cwd=tmp_path)
    (tmp_path / "bench.yaml").write_text(filled_in((tmp_path / "bench.yaml").read_text()))
    printed = output_of("validate", "p.yaml", "bench.yaml", "--json", cwd=tmp_path, code=2)
    wrong, right = json.loads(printed)["files"]
    assert (wrong["file"], wrong["kind"], wrong["ok"]) == ("p.yaml", "procedure", False)
    assert [(each["line"], each["column"]) for each in wrong["problems"]] == [(3, 12)]
    found = "not filled in yet: description, rate_table.port and chamber.port"
    assert right == {"file": "bench.yaml", "kind": "station", "ok": True, "found": found, "problems": []}


def test_a_schema_is_printed_alone(tmp_path):
    answer = gyrobench("schema", "procedure", cwd=tmp_path)
    assert json.loads(answer.stdout)["title"] == "gyrobench procedure"


def test_a_list_of_rotations_is_no_procedure(tmp_path):
    answer = gyrobench("plan", "eighteen_rotations", cwd=tmp_path)
    assert (answer.returncode, answer.stderr) == (
        2,
        "gyrobench: eighteen_rotations: no such file or shipped name, but a shipped rotation list. Show what "
        "it determines with: gyrobench plan eighteen_rotations --observability\n",
    )


def test_a_new_import_map_is_valid(tmp_path):
    made = gyrobench("new", "import", "my_log", cwd=tmp_path)
    assert made.stdout == "my_log.yaml: written. Edit it. Next: gyrobench validate my_log.yaml\n"
    checked = gyrobench("validate", "my_log.yaml", cwd=tmp_path)
    assert checked.stdout == "my_log.yaml: valid import map\n"
    assert gyrobench("new", "import", "x", "--like", "nowhere", cwd=tmp_path).returncode == 2


def test_a_new_world_is_the_shipped_one_under_another_name(tmp_path):
    output_of("new", "world", "hidden", "--like", "gyro_b", cwd=tmp_path)
    text = (tmp_path / "hidden.yaml").read_text()
    assert "\nworld: hidden\n" in text
    assert gyrobench("validate", "hidden.yaml", cwd=tmp_path).returncode == 0
