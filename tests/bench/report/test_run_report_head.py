import json
import math
from dataclasses import replace

import pytest

from gyrobench.bench.bias.dwell_table import write_dwells
from gyrobench.bench.bias.verdicts import Acceptance, write_acceptance
from gyrobench.bench.report.run_content import read_run
from gyrobench.bench.report.run_report import head_facts, serial_number_of, verdict_boxes
from gyrobench.bench.runs.folder import RunFolder
from gyrobench.bench.runs.tables.coefficient_table import COEFFICIENT_TABLE, PlateauCoefficientRow


@pytest.fixture
def stopped(empty_folder, journal_writer):
    """A run that the operator stopped in a turn."""
    journal_writer(empty_folder, ended="stopped", reason="stopped by the operator (Ctrl-C)")
    return empty_folder


def add(folder, **entry):
    with folder.journal.open("a", encoding="utf-8") as journal:
        journal.write(json.dumps(entry) + "\n")


def resume(folder):
    add(folder, time_s=9000.0, event="run_resumed", procedure="six_position_fig7", station="emulated")


def test_the_end_of_a_run_is_stated_with_its_unfinished_step(stopped: RunFolder):
    content = read_run(stopped)
    [box] = verdict_boxes(content)
    assert (box.colour, box.text) == ("stopped", "")
    assert box.headline == "The run was stopped by the operator (Ctrl-C)."
    assert box.notes == ["Unfinished step: 6, turn 180 deg (cycle 1, 62 degC, z_up)."]
    assert [action["what"] for action in content.facts.safe_state] == [
        "rate table stopped",
        "chamber switched off",
    ]


def test_a_run_that_was_stopped_resumed_and_killed_has_not_ended(stopped: RunFolder):
    resume(stopped)
    content = read_run(stopped)
    [box], lines = verdict_boxes(content), head_facts(content)
    assert (box.colour, box.headline) == ("failed", "The run has not ended.")
    assert "killed or is still running" in box.text
    assert content.facts.safe_state == ()
    assert "ended" not in lines
    assert lines["duration"] == "2:30 h, resumed 1 time"


def test_a_run_faster_than_real_time_states_its_speed(stopped: RunFolder):
    content = read_run(stopped)
    real = replace(content, facts=replace(content.facts, options={"clock": "wall"}))
    assert "speed" not in head_facts(real)["options"]
    assert "clock" not in head_facts(real)["ended"]
    fast = replace(content, facts=replace(content.facts, options={"clock": "wall", "speed": 10.0}))
    assert head_facts(fast)["options"].endswith("speed 10 (the run's clock, relative to real time)")
    assert head_facts(fast)["ended"].endswith(" by the run's own clock")


def test_a_run_that_was_stopped_and_resumed_has_its_new_end(stopped: RunFolder):
    resume(stopped)
    add(stopped, time_s=9060.0, event="step_finished", step=6)
    add(stopped, time_s=9100.0, event="run_ended", ended="finished", reason="", safe_state=[])
    [box] = verdict_boxes(read_run(stopped))
    assert (box.colour, box.headline, box.text, box.notes) == ("finished", "The run finished.", "", [])


def test_the_serial_number_of_a_run_without_dwells_is_what_the_ins_said(stopped: RunFolder):
    assert serial_number_of(read_run(stopped)) == ""
    add(stopped, time_s=9000.0, event="ins_identified", unit="1007")
    assert serial_number_of(read_run(stopped)) == "1007"


@pytest.fixture
def accepted(empty_folder, journal_writer, dwells):
    """A run that finished, and whose unit was accepted."""
    journal_writer(empty_folder)
    add(empty_folder, time_s=9060.0, event="dwell_finished", marks={"dwell": 1}, flags="")
    write_dwells(empty_folder.dwells, dwells)
    write_acceptance(empty_folder.acceptance, Acceptance(verdict="accepted"))
    return empty_folder


def statements(folder):
    return [f"{box.headline} {box.text}".strip() for box in verdict_boxes(read_run(folder))]


def test_another_firmware_in_a_part_of_the_dwells_is_stated_first(accepted: RunFolder):
    add(accepted, time_s=9070.0, event="ins_identified", identity="firmware 104")
    assert not any(each.startswith("The INS changed.") for each in statements(accepted))
    add(accepted, time_s=9080.0, event="dwell_finished", marks={"dwell": 2}, flags="")
    [text] = [each for each in statements(accepted) if each.startswith("The INS changed.")]
    assert "as firmware 104 in 1 dwell" in text


def test_a_run_with_a_damaged_journal_states_that_first_and_is_not_judged(accepted):
    lines = accepted.journal.read_text(encoding="utf-8").splitlines(keepends=True)
    accepted.journal.write_text("".join([*lines[:2], "xx\n", *lines[3:]]), encoding="utf-8")
    assert statements(accepted) == [
        f"journal.jsonl can't be used. {accepted.journal}:3: damaged entry: 'xx'. "
        "Restore the file from a copy.",
        "How the run ended is not known.",
        "Unit not judged. A run with a damaged file is not judged.",
    ]
    assert not {"ended", "duration"} & set(head_facts(read_run(accepted)))


def test_a_run_with_a_damaged_dwell_table_states_that_first_and_is_not_judged(accepted):
    lines = accepted.dwells.read_text(encoding="utf-8").splitlines(keepends=True)
    accepted.dwells.write_text("".join([*lines[:9], lines[9][:40] + "\n", *lines[10:]]), encoding="utf-8")
    first, *others = statements(accepted)
    assert first.startswith(f"dwells.csv can't be used. {accepted.dwells}:10: ")
    assert first.endswith(f"Write it again with `gyrobench bins {accepted.path}`.")
    assert others == ["The run finished.", "Unit not judged. A run with a damaged file is not judged."]


def test_a_finished_run_without_its_dwell_table_is_not_judged(accepted):
    accepted.dwells.unlink()
    first, *_, last = statements(accepted)
    assert first.startswith(f"dwells.csv can't be used. {accepted.dwells}: is missing. ")
    assert last.startswith("Unit not judged.")


def test_an_interrupted_run_without_a_dwell_table_is_not_damaged(empty_folder, journal_writer):
    journal_writer(empty_folder, ended="")
    add(empty_folder, time_s=9060.0, event="dwell_finished", marks={"dwell": 1}, flags="")
    assert read_run(empty_folder).damage == {}


def test_plateaus_whose_rotations_are_contradicted_are_named_first(accepted):
    def row(plateau, finding):
        return PlateauCoefficientRow(
            *(plateau, 1, 60.0, 65.0, "gyro_bias", "x", 0.01, 0.001, "deg/h", finding, math.nan, 0.0)
        )

    COEFFICIENT_TABLE.write(
        accepted.coefficients, [row(1, ""), row(2, "noise does not explain"), row(3, "p = 0")]
    )
    expected = "Coefficients in doubt. Plateau 2 and Plateau 3: see the section on coefficients."
    assert expected in statements(accepted)
