"""However a run ends, the bench is brought to its safe state and the journal has the reason."""

import os
import re
import signal
from dataclasses import replace
from pathlib import Path

import pytest

from gyrobench.bench.dwells.sign_check import SignCheck
from gyrobench.bench.engine.job import prepare_job
from gyrobench.bench.engine.observers import RunObserver
from gyrobench.bench.engine.operator import ConsentingOperator
from gyrobench.bench.engine.resume import prepare_resumption
from gyrobench.bench.engine.run import resume_run, run_job
from gyrobench.bench.foundations.errors import DocumentError, RunFolderError, SignalMapError
from gyrobench.bench.foundations.files import file_sha256
from gyrobench.bench.foundations.shipped import find_document
from gyrobench.bench.runs.can_log import CanLog
from gyrobench.bench.runs.journal import read_journal
from gyrobench.bench.runs.provenance import read_provenance
from gyrobench.bench.station.instruments import Emulation
from gyrobench.bench.station.station import Station
from gyrobench.drivers.emulators import can_interface
from gyrobench.drivers.emulators.acl_axis import SoftwareFault
from gyrobench.drivers.emulators.bench import BenchAddress, bench_at
from gyrobench.drivers.frames import EXTENDED_ID
from tests.bench.engine.intervention import Intervention, RefusingOperator, run_with
from tests.bench.engine.stations import changed_station

#: Dwells without a turn, as short as they can be.
CHECK = """procedure: short_check
steps:
  - power_on: {settle_s: 20}
  - repeat:
      over: {azimuth_deg: [0, 180, 0, 180]}
      steps:
        - go_to: {position: z_up, azimuth_deg: $azimuth_deg, rate_dps: 30}
        - align: {duration_s: 60}
        - navigate: {duration_s: 61, purpose: calibration_check}
"""


def assert_safe(folder, outcome, bench):
    assert [action.problem for action in outcome.safe_state] == [""] * len(outcome.safe_state)
    for axis in bench.world.axes.values():
        assert not axis.is_moving(bench.clock.now() + 60.0)
    assert bench.world.air.set_point_c == 23.0
    last = list(read_journal(folder.journal))[-1]
    assert (last["event"], last["reason"]) == ("run_ended", outcome.reason)


@pytest.mark.parametrize(
    ("number", "who"),
    [
        (signal.SIGTERM, "another program (SIGTERM)"),
        (signal.SIGHUP, "the end of the terminal session (SIGHUP)"),
        (signal.SIGINT, "the operator (Ctrl-C)"),
    ],
)
def test_a_signal_stops_the_run_safely_and_the_reason_names_its_source_in_words(tmp_path, number, who):
    folder, outcome, bench = run_with(tmp_path, "navigate", lambda bench, clock: os.kill(os.getpid(), number))
    assert outcome.ended == "stopped"
    assert outcome.reason == f"stopped by {who}"
    [ordered] = [entry for entry in read_journal(folder.journal) if entry["event"] == "ordered"]
    assert ordered["by"] == signal.Signals(number).name
    assert_safe(folder, outcome, bench)


def test_a_log_that_can_not_be_written_leaves_the_reason_in_the_journal(tmp_path, monkeypatch):
    def fail(log, block):
        raise RunFolderError("part-00002.blf: can't be written: No space left. Free some space.")

    folder, outcome, bench = run_with(
        tmp_path, "navigate", lambda bench, clock: monkeypatch.setattr(CanLog, "write", fail)
    )
    assert outcome.ended == "failed"
    assert_safe(folder, outcome, bench)
    lines = prepare_resumption(folder.path).describe().splitlines()
    assert lines[0].endswith(
        "the run failed: part-00002.blf: can't be written: No space left. Free some space."
    )
    assert "The bench was brought to its safe state." in lines


@pytest.mark.parametrize(
    ("step", "happen", "reason"),
    [
        ("navigate", lambda table, now_s: table.trip(1, SoftwareFault.RATE_TRIP, now_s), "rate trip"),
        ("turn", lambda table, now_s: table.open_interlock(2, now_s), "axis 2: user interlock 1"),
    ],
)
def test_a_fault_of_the_table_that_is_not_fixed_ends_the_run_safely(tmp_path, step, happen, reason):
    folder, outcome, bench = run_with(
        tmp_path, step, lambda bench, clock: happen(bench.serial["table"], clock.now())
    )
    assert outcome.ended == "stopped"
    assert reason in outcome.reason
    assert_safe(folder, outcome, bench)


def test_a_broken_chamber_sensor_ends_the_run(tmp_path):
    def break_sensor(bench, clock):
        bench.serial["chamber"].sensor_error = 1

    _, outcome, _ = run_with(tmp_path, "align", break_sensor)
    assert outcome.ended == "stopped"
    assert "the chamber reports error 1 of input 1" in outcome.reason


def test_a_chamber_that_does_not_get_there_ends_the_step_with_its_place_in_the_file(tmp_path):
    path = tmp_path / "hot.yaml"
    path.write_text(
        "procedure: hot\nsteps:\n  - chamber: {temperature_c: 60, ramp_c_per_min: 4, timeout_s: 900}\n"
    )

    def weaken(bench, clock):
        bench.world.air.parameters = replace(bench.world.air.parameters, heating_limit_c_per_min=0.5)

    folder, outcome, bench = run_with(tmp_path, "chamber", weaken, path)
    assert outcome.ended == "stopped"
    assert "hot.yaml:3:" in outcome.reason
    assert "did not end within 900 s" in outcome.reason
    assert_safe(folder, outcome, bench)


def test_an_ins_whose_mode_is_not_in_the_signal_map_ends_power_on_with_the_value_of_its_signal(tmp_path):
    station = find_document("stations", "emulated").read_text()
    path = tmp_path / "other_modes.yaml"
    path.write_text(station.replace("standby: 1, align: 2, navigate: 3, fault: 4", "navigate: 48"))
    job = prepare_job("ten_minute_check", str(path), Emulation("ideal", 0))
    _, outcome = run_job(job, tmp_path / "run", Intervention("nothing", None), RefusingOperator())
    assert outcome.ended == "stopped"
    assert (
        "INS reports boot (INS_STATUS.MODE is 1, no value of ins.signals.mode). Check the instrument"
        in outcome.reason
    )


def test_an_unexpected_exception_is_raised_once_the_bench_is_safe(tmp_path):
    class SurpriseError(Exception):
        pass

    def fail(bench, clock):
        raise SurpriseError("in a step")

    intervention = Intervention("turn", fail)
    job = prepare_job("ten_minute_check", "emulated", Emulation("ideal", 0))
    with pytest.raises(SurpriseError):
        run_job(job, tmp_path / "run", intervention, ConsentingOperator())
    last = list(read_journal(tmp_path / "run" / "journal.jsonl"))[-1]
    assert last["ended"] == "failed"
    assert "Surprise" in last["reason"]
    assert [action["problem"] for action in last["safe_state"]] == [""] * len(last["safe_state"])
    assert intervention.bench.world.air.set_point_c == 23.0


def test_nothing_moves_before_a_wrong_procedure_is_refused(tmp_path):
    path = tmp_path / "wrong.yaml"
    path.write_text("procedure: wrong\nsteps:\n  - chamber: {temperature_c: 90, ramp_c_per_min: 50}\n")
    with pytest.raises(DocumentError) as caught:
        prepare_job(str(path), "emulated")
    assert str(caught.value).count("wrong.yaml:3:") == 2


def test_an_operator_who_does_not_continue_stops_the_run(tmp_path):
    path = tmp_path / "ask.yaml"
    path.write_text("procedure: ask\nsteps:\n  - ask_operator: {question: 'Is the door shut?'}\n")
    job = prepare_job(str(path), "emulated")
    watcher = Intervention("nothing", None)
    _, outcome = run_job(job, tmp_path / "run", watcher, RefusingOperator())
    assert outcome.ended == "stopped"
    assert "Is the door shut?" in outcome.reason


def test_a_question_without_an_answer_in_time_holds_the_run_with_the_advice_to_answer_it(tmp_path):
    path = tmp_path / "ask.yaml"
    ask = "ask_operator: {question: 'Is the door shut?', timeout_s: 60}"
    path.write_text(f"procedure: ask\nsteps:\n  - {ask}\n")

    class Absent(RefusingOperator):
        def ask(self, question, answers):
            super().ask(question, answers)
            self.is_hold = question.startswith("The run holds")

        def answer(self):
            return super().answer() if self.is_hold else None

    _, outcome = run_job(
        prepare_job(str(path), "emulated"), tmp_path / "run", Intervention("nothing", None), Absent()
    )
    assert outcome.ended == "stopped"
    assert "did not end within 60 s. Answer it, or increase the step's timeout_s" in outcome.reason


def test_the_dwell_table_holds_every_dwell_that_was_finished_before_the_end(tmp_path):
    path = Path(tmp_path / "two.yaml")
    path.write_text(
        """procedure: two
steps:
  - power_on
  - repeat:
      over: {position: [z_up, z_down]}
      steps:
        - go_to: {position: $position}
        - align: {duration_s: 60}
        - navigate: {duration_s: 60}
        - turn: {angle_deg: 180}
        - navigate: {duration_s: 60}
  - wait: {duration_s: 100}
"""
    )
    folder, outcome, _ = run_with(
        tmp_path, "wait", lambda bench, clock: os.kill(os.getpid(), signal.SIGTERM), path
    )
    assert outcome.ended == "stopped"
    assert len(folder.dwells.read_text().splitlines()) == 3


def test_a_velocity_mapped_with_the_wrong_sign_ends_the_run_after_its_first_dwell(tmp_path):
    text = find_document("stations", "emulated").read_text()
    right = "velocity_north: VELOCITY_NE.VELOCITY_NORTH"
    assert right in text
    station = tmp_path / "station.yaml"
    station.write_text(text.replace(right, "velocity_north: {signal: VELOCITY_NE.VELOCITY_NORTH, sign: -1}"))
    job = prepare_job("calibration_check", str(station), Emulation("gyro_a", 1))
    folder, outcome = run_job(job, tmp_path / "run", RunObserver(), ConsentingOperator())
    assert outcome.ended == "failed"
    assert outcome.reason.startswith("ins.signals.velocity_north has the wrong sign")
    (dwell,) = outcome.check_dwells
    assert dwell.flags == (outcome.reason,)
    assert [action.problem for action in outcome.safe_state] == [""] * len(outcome.safe_state)
    assert "dwell_given_up" not in [entry["event"] for entry in read_journal(folder.journal)]


@pytest.mark.parametrize(("period_s", "speed"), [(0.05, 1.0), (0.2, 10.0)])
def test_a_wrong_period_of_the_epochs_ends_the_run_before_its_first_dwell(
    tmp_path, monkeypatch, period_s, speed
):
    monkeypatch.setattr(can_interface, "_check_period", lambda *_: None)  # a real INS can't refuse it
    text = find_document("stations", "emulated").read_text()
    right = "epoch_period_s: 0.1"
    assert right in text
    station = tmp_path / "station.yaml"
    station.write_text(text.replace(right, f"epoch_period_s: {period_s}"))
    job = prepare_job("calibration_check", str(station), Emulation("gyro_a", 1))
    monkeypatch.setitem(job.station.file.__dict__, "speed", speed)  # of a bench that is served
    _, outcome = run_job(job, tmp_path / "run", RunObserver(), ConsentingOperator())
    assert outcome.ended == "failed"
    assert ("give `gyrobench emulate` the --speed of the station file" in outcome.reason) == (speed > 1.0)
    assert f"counts an epoch in 0.1 s, not in {period_s:g} s. Correct epoch_period_s" in outcome.reason
    assert not outcome.check_dwells
    assert [action.problem for action in outcome.safe_state] == [""] * len(outcome.safe_state)


def test_a_run_ends_at_power_on_where_station_and_ins_use_other_latitudes(tmp_path, run_procedure):
    station = tmp_path / "station.yaml"
    text = find_document("stations", "quick").read_text()
    place = re.search(r"latitude_deg: [-\d.]+", text)[0]
    station.write_text(text.replace(place, "latitude_deg: 63.4"))
    folder, outcome, _ = run_procedure("ten_minute_check", tmp_path / "run", "quick", station=str(station))
    assert outcome.ended == "failed"
    assert "location.latitude_deg is 63.4000 deg. Correct the one that is wrong" in outcome.reason
    finished = [each["name"] for each in read_journal(folder.journal) if each["event"] == "step_finished"]
    assert finished == []


def test_a_run_ends_at_power_on_where_the_ins_sends_other_identifiers_than_the_dbc_file_has(
    tmp_path, run_procedure
):
    text = find_document("stations", "quick").read_text()
    (tmp_path / "station.yaml").write_text(text.replace("dbc: gyrobench_ins", "dbc: extended"))
    dbc = Station(find_document("stations", "quick")).dbc_path.read_text()
    identifier = re.compile(r"^((?:BO_|VAL_|SIG_VALTYPE_|CM_ \w+_|BA_ \S+ \w+_) )(\d+)", re.MULTILINE)
    extended = identifier.sub(lambda found: f"{found[1]}{int(found[2]) | EXTENDED_ID}", dbc)
    (tmp_path / "extended.dbc").write_text(extended)
    folder, outcome, _ = run_procedure(
        "ten_minute_check", tmp_path / "run", "quick", station=str(tmp_path / "station.yaml")
    )
    assert outcome.ended == "failed"
    assert outcome.is_station_wrong
    assert "0x001 arrives as an identifier of 11 bits, and has 29 bits in the DBC file" in outcome.reason
    assert outcome.is_safe
    assert "step_finished" not in [entry["event"] for entry in read_journal(folder.journal)]


@pytest.mark.parametrize(("contradicting", "ended"), [({2}, "finished"), ({2, 3}, "failed")])
def test_only_two_dwells_in_a_row_contradict_a_signal_map_that_agreed_before(
    tmp_path, monkeypatch, contradicting, ended
):
    check, checked = SignCheck.check, []

    def contradicted(self, marks, frames, navigation):
        checked.append(marks.dwell)
        if len(checked) in contradicting:
            raise SignalMapError("velocity_north has the wrong sign")
        check(self, marks, frames, navigation)

    monkeypatch.setattr(SignCheck, "check", contradicted)
    path = tmp_path / "short_check.yaml"
    path.write_text(CHECK)
    job = prepare_job(str(path), "emulated", Emulation("gyro_a", 1))
    folder, outcome = run_job(job, tmp_path / "run", RunObserver(), ConsentingOperator())
    assert outcome.ended == ended
    assert checked[:3] == [1, 2, 2]
    given_up = [entry for entry in read_journal(folder.journal) if entry["event"] == "dwell_given_up"]
    assert [entry["why"] for entry in given_up] == ["velocity_north has the wrong sign"]


@pytest.mark.parametrize(
    ("old", "new", "reason"),
    [
        ("mounting: {x: east, y: north", "mounting: {x: north, y: west", "disagree by 90.0 deg"),
        ("latitude_deg: 36.4", "latitude_deg: 36.5", "the INS uses a latitude of 36.4000 deg"),
    ],
)
def test_a_wrong_mounting_and_another_latitude_end_a_run_at_once(tmp_path, old, new, reason):
    right = find_document("stations", "emulated").read_text()
    station = tmp_path / "mine.yaml"
    station.write_text(right.replace(old, new))
    job = prepare_job("ten_minute_check", str(station), Emulation("gyro_a", 1))
    folder, outcome = run_job(job, tmp_path / "run", RunObserver(), ConsentingOperator())
    assert outcome.ended == "failed"
    assert outcome.is_station_wrong
    assert reason in outcome.reason
    folder.station.write_text(right)
    _, outcome = resume_run(prepare_resumption(folder.path), RunObserver(), ConsentingOperator())
    assert outcome.ended == "finished"


def test_a_run_with_a_wrong_signal_map_resumes_with_its_corrected_copy(tmp_path):
    """Dwells that were measured with the wrong map have biases then."""
    right = find_document("stations", "emulated").read_text()
    east, north = "VELOCITY_NE.VELOCITY_EAST", "VELOCITY_NE.VELOCITY_NORTH"
    station = tmp_path / "mine.yaml"
    station.write_text(right.replace(east, "?").replace(north, east).replace("?", north))
    job = prepare_job("signal_map_check", str(station), Emulation("gyro_a", 1))
    folder, outcome = run_job(job, tmp_path / "run", RunObserver(), ConsentingOperator())
    assert outcome.ended == "failed"
    assert outcome.is_station_wrong
    assert outcome.reason.endswith("Correct the station file")
    assert "exchanged" in str(outcome.dwells[0].row.flags)
    folder.station.write_text(right)
    folder, outcome = resume_run(prepare_resumption(folder.path), RunObserver(), ConsentingOperator())
    assert outcome.ended == "finished"
    assert outcome.dwells[0].row.flags == ()
    notes = [entry["text"] for entry in read_journal(folder.journal) if entry["event"] == "note"]
    assert "Changed since the run began: station.yaml. All dwells are evaluated with the changes." in notes
    assert read_provenance(folder)["files_sha256"]["station.yaml"] == file_sha256(folder.station)


class ForgetfulOperator(ConsentingOperator):
    """Answers that the unit was switched off and on; switches it off for ``off_s`` at the second question."""

    def __init__(self, off_s):
        super().__init__()
        self.questions, self.world, self.duration_s, self.off_s = 0, None, off_s, None

    def ask(self, question, answers):
        super().ask(question, answers)
        self.questions += 1

    def answer(self):
        if self.questions == 1:
            return super().answer()
        if self.off_s is None:
            self.off_s = self.clock.now()
        is_off = self.clock.now() < self.off_s + self.duration_s
        self.world.power_unit(not is_off)
        return None if is_off else super().answer()


@pytest.mark.parametrize("off_s", [1.0, 10.0])
def test_an_operator_who_did_not_switch_the_unit_off_is_asked_again(tmp_path, off_s):
    class Observer(RunObserver):
        def begun(self, folder, bench, outcome):
            operator.clock = bench.clock
            world = str(find_document("worlds", "ideal"))
            operator.world = bench_at(BenchAddress(bench.clock.name, world, 0)).world
            operator.world.power_unit(True)
            bench.clock.sleep(30.0)

    operator = ForgetfulOperator(off_s)
    station = changed_station(tmp_path, {"power: chamber_event": "power: operator"})
    (tmp_path / "on.yaml").write_text("procedure: on\nsteps:\n  - power_on: {settle_s: 20}\n")
    job = prepare_job(str(tmp_path / "on.yaml"), str(station), Emulation("ideal", 0))
    folder, outcome = run_job(job, tmp_path / "run", Observer(), operator)
    assert (outcome.ended, operator.questions) == ("finished", 2)
    texts = [entry["text"] for entry in read_journal(folder.journal) if entry["event"] == "note"]
    assert texts == ["the INS was not switched off: it has sent frames all the time"]


def test_the_time_since_power_on_of_an_ins_that_is_always_on_is_noted_as_unknown(tmp_path):
    class Observer(RunObserver):
        def begun(self, folder, bench, outcome):
            world = str(find_document("worlds", "ideal"))
            bench_at(BenchAddress(bench.clock.name, world, 0)).world.power_unit(True)

    station = changed_station(tmp_path, {"power: chamber_event": "power: always_on"})
    (tmp_path / "on.yaml").write_text("procedure: on\nsteps:\n  - power_on: {settle_s: 20}\n")
    job = prepare_job(str(tmp_path / "on.yaml"), str(station), Emulation("ideal", 0))
    folder, _ = run_job(job, tmp_path / "run", Observer(), ConsentingOperator())
    texts = [entry["text"] for entry in read_journal(folder.journal) if entry["event"] == "note"]
    assert texts == ["the INS is always on: its time since power-on is not known and counts from this step"]
