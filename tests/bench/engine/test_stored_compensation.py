"""What the INS compensates by itself is found before anything is measured, and loaded where it is wanted."""

import re

import numpy as np
import pytest

from gyrobench.bench.engine.job import prepare_job
from gyrobench.bench.engine.operator import ConsentingOperator
from gyrobench.bench.engine.run import run_job
from gyrobench.bench.foundations.errors import DocumentError, NoReplyError
from gyrobench.bench.foundations.shipped import find_document
from gyrobench.bench.runs.compensation_file import read_compensation
from gyrobench.bench.runs.journal import read_journal
from gyrobench.bench.station.instruments import Emulation
from gyrobench.bench.station.station import Station
from gyrobench.drivers.ins.can_ins import CanIns
from gyrobench.drivers.ins.compensation import Compensation
from tests.bench.engine.intervention import Intervention

#: Of the world "ideal".
BIAS_DPH = np.array([0.003, -0.002, 0.004])
TWO_DWELLS = """procedure: two_dwells
steps:
  - power_on
  - repeat:
      over: {cycle: [1, 2]}
      steps:
        - wait: {duration_s: 10}
        - go_to: {position: z_up}
        - align: {duration_s: 120}
        - navigate: {duration_s: 200}
        - turn: {angle_deg: 180}
        - navigate: {duration_s: 200}
"""
WHOLE = Compensation(BIAS_DPH[:, np.newaxis], np.full(3, -40.0), np.full(3, 80.0))


class Answering(ConsentingOperator):
    """Gives one answer to every question, and keeps the questions."""

    def __init__(self, answer):
        super().__init__()
        self.answer_to_all = answer
        self.questions = []

    def ask(self, question, answers):
        assert self.answer_to_all in answers
        self.questions.append(question)
        self._answer = self.answer_to_all


def keeps_its_compensation(bench, clock):
    """An INS whose memory needs no power: it compensates from each power-on."""
    unit, power = bench.world.unit, bench.world.unit.power

    def power_with_memory(on):
        power(on)
        unit.loaded_table[:, 0] = 0.1
        unit.apply_compensation()

    unit.power = power_with_memory


def loses_it(bench, clock):
    bench.world.unit.clear_compensation()


def gets_another(bench, clock):
    bench.world.unit.loaded_table[:, 0] = 0.1
    bench.world.unit.apply_compensation()


@pytest.fixture
def run(tmp_path):
    """``run(kind, action, nth, compensation, answer)``: run folder, outcome, questions, notes and events."""

    def run_it(kind="power_on", action=lambda bench, clock: None, nth=1, compensation=None, answer="clear"):
        path = tmp_path / "two_dwells.yaml"
        path.write_text(TWO_DWELLS)
        job = prepare_job(str(path), "emulated", Emulation("ideal", 0), compensation=compensation)
        operator = Answering(answer)
        folder, outcome = run_job(job, tmp_path / "run", Intervention(kind, action, nth), operator)
        entries = list(read_journal(folder.journal))
        notes = [entry["text"] for entry in entries if entry["event"] == "note"]
        events = [entry for entry in entries if entry["event"] == "compensation"]
        return folder, outcome, operator.questions, notes, events

    return run_it


def biases_dph(outcome):
    assert outcome.ended == "finished", outcome.reason
    return np.array([dwell.row.bias_dph for dwell in outcome.dwells])


def test_a_compensation_beyond_whose_limits_the_ins_extrapolates_is_noted_with_what_that_adds():
    load = Station(find_document("stations", "emulated")).file.ins.commands.load_compensation
    curve = Compensation(np.tile([0.0, 1e-3], (3, 1)), np.full(3, -20.0), np.full(3, 60.0))
    assert load.extrapolation(curve) == ""
    unlimited = load.model_copy(update={"highest_index": None})
    assert unlimited.extrapolation(curve) == (
        "the INS does not get the temperature limits (highest_index of load_compensation): 10 K outside "
        "-20 to 60 °C it may subtract 0.01 deg/h more or less than was measured at the limit"
    )
    assert unlimited.extrapolation(WHOLE) == ""


def test_an_ins_that_compensates_nothing_is_checked_and_measured(run):
    _, outcome, questions, notes, events = run()
    assert (questions, notes) == ([], [])
    nothing = {"active": False, "checksum": "00000000"}
    assert [(each["found"], each["in_use"], each["terms"]) for each in events] == [(nothing, nothing, None)]
    np.testing.assert_allclose(biases_dph(outcome), np.tile(BIAS_DPH, (2, 1)), atol=3e-4)


def test_a_stored_compensation_is_cleared_if_the_operator_decides_so(run):
    _, outcome, questions, notes, events = run(action=keeps_its_compensation)
    checksum = events[0]["found"]["checksum"]
    assert questions == [
        f"The INS applies a stored compensation ({checksum}). "
        "Clear it, or keep it and measure the remaining biases?"
    ]
    assert notes == [f"clearing the stored compensation of the INS ({checksum})"]
    assert [each["in_use"]["active"] for each in events] == [False]
    np.testing.assert_allclose(biases_dph(outcome), np.tile(BIAS_DPH, (2, 1)), atol=3e-4)


def test_the_remaining_biases_are_measured_if_the_operator_keeps_a_stored_compensation(run):
    _, outcome, questions, notes, events = run(action=keeps_its_compensation, answer="keep")
    assert len(questions) == 1
    assert notes == [
        f"the biases are those that remain with the stored compensation ({events[0]['found']['checksum']})"
    ]
    assert [each["in_use"]["active"] for each in events] == [True]
    np.testing.assert_allclose(biases_dph(outcome), np.tile(BIAS_DPH - 0.1, (2, 1)), atol=3e-4)


def test_the_operator_can_stop_because_of_it(run):
    _, outcome, questions, _, _ = run(action=keeps_its_compensation, answer="stop")
    assert outcome.ended == "stopped"
    assert questions[0] in outcome.reason


def test_a_compensation_is_loaded_and_the_biases_are_gone(run):
    folder, outcome, questions, notes, events = run(compensation=WHOLE)
    (event,) = events
    assert questions == []
    assert event["in_use"]["active"]
    assert event["terms"] == []
    assert notes == [f"the compensation {event['in_use']['checksum']} is loaded into the INS"]
    np.testing.assert_allclose(biases_dph(outcome), np.zeros((2, 3)), atol=3e-4)
    np.testing.assert_array_equal(read_compensation(folder.compensation).polynomial_dph, WHOLE.polynomial_dph)


def test_nothing_is_compensated_twice(run):
    _, outcome, questions, _, events = run(action=keeps_its_compensation, compensation=WHOLE)
    assert questions == [
        f"The INS applies a stored compensation ({events[0]['found']['checksum']}). "
        "Clear it before the run's compensation is loaded?"
    ]
    np.testing.assert_allclose(biases_dph(outcome), np.zeros((2, 3)), atol=3e-4)


def test_the_runs_own_compensation_that_was_applied_without_confirmation_is_not_asked_about(run, monkeypatch):
    def keeps_what_is_loaded(bench, clock):
        unit, power = bench.world.unit, bench.world.unit.power

        def power_with_memory(on):
            table = unit.loaded_table.copy()
            power(on)
            unit.loaded_table[:] = table
            if table[:, 0].any():
                unit.apply_compensation()

        unit.power = power_with_memory

    apply, lost = CanIns.apply_compensation, []

    def apply_unconfirmed_at_first(ins, loaded=None):
        apply(ins, loaded)
        if not lost:
            lost.append(loaded)
            raise NoReplyError("INS", "no confirmation")

    monkeypatch.setattr(CanIns, "apply_compensation", apply_unconfirmed_at_first)
    _, outcome, questions, _, (event,) = run(action=keeps_what_is_loaded, compensation=WHOLE)
    assert event["found"] == event["in_use"] == {"active": True, "checksum": f"{lost[0]:08x}"}
    assert questions == []
    np.testing.assert_allclose(biases_dph(outcome), np.zeros((2, 3)), atol=3e-4)


def test_a_compensation_that_the_ins_loses_is_loaded_again_before_the_next_dwell(run):
    _, outcome, questions, _, events = run("wait", loses_it, nth=2, compensation=WHOLE)
    assert questions == []
    assert [(each["found"]["active"], each["in_use"]["active"]) for each in events] == [(False, True)] * 2
    np.testing.assert_allclose(biases_dph(outcome), np.zeros((2, 3)), atol=3e-4)


def test_a_compensation_that_appears_in_the_middle_is_asked_about(run):
    _, outcome, questions, _, events = run("wait", gets_another, nth=2)
    assert len(questions) == 1
    assert "has begun to apply a stored compensation" in questions[0]
    assert [each["found"]["active"] for each in events] == [False, True]
    np.testing.assert_allclose(biases_dph(outcome), np.tile(BIAS_DPH, (2, 1)), atol=3e-4)


def test_a_compensation_that_cannot_be_cleared_prevents_another(tmp_path):
    text = find_document("stations", "emulated").read_text()
    station, procedure = tmp_path / "station.yaml", tmp_path / "two_dwells.yaml"
    station.write_text("\n".join(line for line in text.splitlines() if "clear_compensation" not in line))
    procedure.write_text(TWO_DWELLS)
    job = prepare_job(str(procedure), str(station), Emulation("ideal", 0), compensation=WHOLE)
    watcher = Intervention("power_on", keeps_its_compensation)
    _, outcome = run_job(job, tmp_path / "run", watcher, ConsentingOperator())
    assert outcome.ended == "stopped"
    assert "INS: applies a stored compensation" in outcome.reason
    assert "no clear_compensation" in outcome.reason


def test_an_ins_that_does_not_report_its_compensation_is_loaded_after_each_power_on(tmp_path):
    text = find_document("stations", "emulated").read_text()
    lines = [line for line in text.splitlines() if not re.match(r" +compensation\w*: ", line)]
    station, procedure = tmp_path / "station.yaml", tmp_path / "two_dwells.yaml"
    station.write_text("\n".join(lines))
    each_powered = TWO_DWELLS.replace("  - power_on\n", "").replace("wait: {duration_s: 10}", "power_on")
    procedure.write_text(f"{each_powered}        - power_off\n")
    job = prepare_job(str(procedure), str(station), Emulation("ideal", 0), compensation=WHOLE)
    folder, outcome = run_job(
        job, tmp_path / "run", Intervention("power_on", lambda *_: None), Answering("clear")
    )
    entries = list(read_journal(folder.journal))
    assert [entry["terms"] for entry in entries if entry["event"] == "compensation"] == [[]] * 2
    assert "does not report whether it compensates" in next(
        entry["text"] for entry in entries if entry["event"] == "note"
    )
    np.testing.assert_allclose(biases_dph(outcome), np.zeros((2, 3)), atol=3e-4)


@pytest.mark.parametrize(
    ("left_out", "message"),
    [
        ("apply_compensation", "lacks load_compensation or apply_compensation"),
        ("terms", "does not accept g_sensitivity. Map the indices"),
    ],
)
def test_what_the_ins_does_not_accept_is_refused_before_anything_moves(tmp_path, left_out, message):
    text = find_document("stations", "emulated").read_text()
    begin = text.index(f"{left_out}:")
    end = text.index("\n  noise:" if left_out == "apply_compensation" else "    apply_compensation:")
    station = tmp_path / "station.yaml"
    station.write_text(text[:begin].rstrip(" ") + text[end:].lstrip("\n"))
    along_up = Compensation(
        np.zeros((3, 1)), np.full(3, -40.0), np.full(3, 80.0), gravity_dph_per_g=np.eye(3)
    )
    with pytest.raises(DocumentError, match=message):
        prepare_job("ten_minute_check", str(station), Emulation("ideal", 0), compensation=along_up)
