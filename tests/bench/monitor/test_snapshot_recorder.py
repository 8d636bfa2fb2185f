import math
import os
import shutil
import signal
from itertools import pairwise

import numpy as np
import pytest

from gyrobench.bench.bias.dwell_table import read_dwells
from gyrobench.bench.engine.job import prepare_job
from gyrobench.bench.engine.live_bench import LiveBench
from gyrobench.bench.engine.observers import ObserverGroup, RunObserver
from gyrobench.bench.engine.operator import ConsentingOperator
from gyrobench.bench.engine.resume import prepare_resumption
from gyrobench.bench.engine.run import resume_run, run_job
from gyrobench.bench.engine.run_outcome import RunOutcome
from gyrobench.bench.foundations.shipped import find_document
from gyrobench.bench.monitor.charts import profile_chart
from gyrobench.bench.monitor.run_list import snapshot_from_records
from gyrobench.bench.monitor.snapshot import RunSnapshot, RunState, read_snapshot
from gyrobench.bench.monitor.snapshot_recorder import SnapshotRecorder, ThinnedRows
from gyrobench.bench.runs.folder import RunFolder
from gyrobench.bench.station.instruments import Emulation
from gyrobench.drivers.emulators.acl_axis import SoftwareFault
from gyrobench.drivers.emulators.bench import BenchAddress, bench_at
from tests.bench.engine.intervention import KilledError, short_dwell
from tests.bench.monitor.conftest import recorded_run


def thinned(count, max_rows=10):
    kept = ThinnedRows(max_rows)
    for number in range(count):
        kept.add((number,))
    return [number for (number,) in kept.rows()]


@pytest.mark.parametrize("count", [0, 1, 5, 9])
def test_few_rows_are_all_kept(count):
    assert thinned(count) == list(range(count))


@pytest.mark.parametrize("count", [10, 11, 57, 640, 641, 12_345])
@pytest.mark.parametrize("max_rows", [9, 10])
def test_many_rows_are_thinned_evenly_with_the_first_and_the_newest(count, max_rows):
    rows = thinned(count, max_rows)
    assert max_rows // 2 <= len(rows) <= max_rows
    assert (rows[0], rows[-1]) == (0, count - 1)
    assert len({after - before for before, after in pairwise(rows[:-1])}) == 1


def during(recorded, text):
    """Snapshots of a step."""
    return [each for each in recorded.snapshots if each.step and each.step.description.startswith(text)]


def test_it_begins_with_what_the_plan_expects(recorded):
    first = recorded.snapshots[0]
    assert (first.procedure, first.station, first.state) == ("ten_minute_check", "emulated", RunState.RUNNING)
    assert first.dwell_count == 1
    assert first.planned.time_s[-1] == pytest.approx(first.planned_s)
    assert [span.position for span in first.planned.positions] == ["z_up"]


def test_time_continues_and_what_is_left_shrinks(recorded):
    now_s = [each.now_s for each in recorded.snapshots]
    left_s = [each.left_s for each in recorded.snapshots]
    assert now_s == sorted(now_s)
    assert left_s[0] == pytest.approx(recorded.snapshots[0].planned_s, abs=15.0)
    assert left_s[-1] == pytest.approx(0.0, abs=1.0)


def test_the_measured_profile_grows_and_ends_with_the_newest_reading(recorded):
    counts = [len(each.measured.time_s) for each in recorded.snapshots]
    assert counts == sorted(counts)
    last = recorded.snapshots[-1].measured
    assert last.time_s == tuple(sorted(last.time_s))
    assert np.ptp(last.chamber_c) < 5.0


def test_the_windows_of_a_dwell_build_up_in_mm_per_s_and_arc_seconds(recorded):
    last = during(recorded, "navigate")[-1]
    first_window, second_window = last.dwell.windows
    assert first_window.planned_s == second_window.planned_s == 150.0
    assert len(first_window.time_s) >= 14
    assert 0.0 <= first_window.time_s[0] < first_window.time_s[-1] <= 155.0
    for window in (first_window, second_window):
        velocities = (*window.velocity_east_mps, *window.velocity_north_mps)
        assert 0.0 < max(map(abs, velocities)) < 0.01
        assert window.heading_change_deg[0] == 0.0
        assert max(map(abs, window.heading_change_deg)) < 0.01


def test_what_the_ins_says_in_the_turn_belongs_to_no_window(recorded):
    turning = during(recorded, "turn")
    assert turning
    assert all(len(each.dwell.windows) == 1 for each in turning)
    assert all(each.dwell.windows[0].time_s[-1] <= 152.0 for each in turning)


def test_the_bias_is_observable_after_the_turn_and_becomes_better_known(recorded):
    assert all(each.live_bias is None for each in during(recorded, "align") + during(recorded, "turn"))
    estimates = during(recorded, "navigate")[-1].dwell.estimates
    assert len(estimates) >= 3
    assert max(estimates[-1].sigma_dph) < max(estimates[0].sigma_dph)


def test_position_and_azimuth_are_those_of_the_table(recorded):
    aligning, after = during(recorded, "align")[-1].attitude, during(recorded, "navigate")[-1].attitude
    assert (aligning.position, aligning.azimuth_deg) == ("z_up", 0.0)
    assert (after.position, after.azimuth_deg) == ("z_up", 180.0)
    np.testing.assert_allclose(aligning.body_in_enu, np.eye(3), atol=1e-4)
    np.testing.assert_allclose(after.body_in_enu, np.diag([-1.0, -1.0, 1.0]), atol=1e-4)


def test_present_values_are_those_of_the_instruments(recorded):
    bench = during(recorded, "navigate")[-1].bench
    assert bench.ins_mode == "navigate"
    assert abs(bench.outer_rate_dps) < 1e-3
    assert 15.0 < bench.chamber_c < 30.0
    assert math.isnan(bench.chamber_set_c)
    assert all(15.0 < each < 40.0 for each in (*bench.gyro_c, *bench.electronics_c, bench.case_c))
    assert all(0.0 <= age_s < 20.0 for age_s in (bench.table_age_s, bench.chamber_age_s, bench.ins_age_s))


def test_the_end_has_the_dwell_its_bins_and_the_unit(recorded):
    last = recorded.snapshots[-1]
    (row,) = read_dwells(recorded.folder.dwells)
    assert (last.state, last.reason, last.alarms) == (RunState.FINISHED, "", ())
    assert (last.step, last.dwell) == (None, None)
    assert last.unit == row.unit
    assert last.dwells[0].bias_dph == pytest.approx(row.bias_dph, abs=1e-9)
    assert {each.gyro for each in last.bins if each.count} == {"x", "y", "z"}


def test_the_last_snapshot_is_in_the_run_folder(recorded):
    left = read_snapshot(recorded.folder.live)
    assert left.state is RunState.FINISHED
    assert left.dwells == recorded.snapshots[-1].dwells
    assert not list(recorded.folder.path.glob(".live*"))


def test_every_snapshot_survives_json(recorded):
    for snapshot in recorded.snapshots:
        assert RunSnapshot.from_json(snapshot.to_json()).to_json() == snapshot.to_json()


def test_a_snapshot_that_cant_be_written_ends_no_run(tmp_path, monkeypatch):
    monkeypatch.setattr(RunFolder, "live", property(lambda self: self.path / "missing" / "live.json"))
    recorded = recorded_run(tmp_path / "run")
    assert recorded.snapshots[-1].state is RunState.FINISHED
    assert not list(tmp_path.rglob("live.json"))
    shutil.rmtree(tmp_path / "run")


def test_a_run_whose_evaluation_fails_ends_again_without_an_exchange(tmp_path, monkeypatch):
    """As on a full disk: bench and logs are closed by then, and the last readings are old."""
    job = prepare_job("ten_minute_check", "emulated", Emulation("ideal", 0))
    recorder, outcome = SnapshotRecorder(job.plan), RunOutcome(ended="failed", reason="no space left")
    run_job(job, tmp_path / "run", recorder, ConsentingOperator())
    recorder._bench.clock.sleep(1000.0)
    monkeypatch.delattr(LiveBench, "read_instruments")
    recorder.ended(outcome)
    snapshot = read_snapshot(tmp_path / "run" / "live.json")
    assert (snapshot.state, snapshot.reason, snapshot.alarms) == (RunState.FAILED, "no space left", ())


PROCEDURE = """procedure: two_positions
steps:
  - power_on: {settle_s: 20}
  - ask_operator: {question: "Is the cable free?", answers: ["yes", "no"]}
  - repeat:
      over: {position: [z_up, z_down]}
      steps:
""" + short_dwell("$position", indent=8)


class SlowOperator(ConsentingOperator):
    """Takes some ticks to answer, with the last of the answers to one question, else the first."""

    def __init__(self, refuses):
        super().__init__()
        self._refuses = refuses
        self._ticks = 0
        self._word = ""

    def ask(self, question, answers):
        self._ticks, self._word = 10, answers[-1 if question.startswith(self._refuses) else 0]

    def answer(self):
        self._ticks -= 1
        return self._word if self._ticks <= 0 else None


class Witness(RunObserver):
    """Does something in the first step of a kind; keeps a snapshot of each state, and one after it."""

    def __init__(self, recorder, kind, deed):
        self._recorder, self._kind, self._deed = recorder, kind, deed
        self._now = ""
        self.seen = {}

    def step_started(self, planned, bench):
        self._now = planned.step.name

    def ticked(self, bench, left_s):
        if self._now == self._kind and self._deed is not None:
            deed, self._deed = self._deed, None
            deed(bench)

    def beat(self, bench):
        snapshot = self._recorder.snapshot()
        self.seen.setdefault(snapshot.state, []).append(snapshot)


@pytest.fixture
def witnessed(tmp_path):
    procedure = tmp_path / "two_positions.yaml"
    procedure.write_text(PROCEDURE)

    def run(kind="", deed=None, refuses="nothing", faults=""):
        (tmp_path / "faults.yaml").write_text(f"faults: [{faults}]\n")
        emulation = Emulation("ideal", 0, str(tmp_path / "faults.yaml") if faults else "")
        job = prepare_job(str(procedure), "emulated", emulation)
        recorder = SnapshotRecorder(job.plan)
        witness = Witness(recorder, kind, deed)
        operator = SlowOperator(refuses)
        folder, _ = run_job(job, tmp_path / "run", ObserverGroup(recorder, witness), operator)
        return witness.seen, read_snapshot(folder.live)

    return run


def order(number):
    return lambda bench: os.kill(os.getpid(), number)


def test_a_question_of_the_procedure_waits_for_the_operator(witnessed):
    seen, last = witnessed()
    waiting = seen[RunState.WAITING]
    assert waiting[0].question.text == "Is the cable free?"
    assert waiting[0].question.answers == ("yes", "no")
    assert all(each.question is None for each in seen[RunState.RUNNING])
    assert (last.state, last.question) == (RunState.FINISHED, None)


def test_an_answer_that_ends_the_run_is_its_reason(witnessed):
    _, last = witnessed(refuses="Is the cable")
    assert last.state is RunState.STOPPED
    assert "'no' to: Is the cable free?" in last.reason


def test_a_pause_gives_the_dwell_up_says_who_paused_and_leads_back_by_steps_with_their_numbers(witnessed):
    seen, last = witnessed("navigate", order(signal.SIGTSTP))
    paused = seen[RunState.PAUSED]
    assert all(each.dwell is None and each.step is None for each in paused)
    assert paused[0].reason == "paused by the operator (Ctrl-Z)"
    assert paused[0].question.answers == ("continue", "abort")
    assert any("repeated" in message.text for message in last.messages)
    assert len(last.dwells) == 2
    steps = [each.step for each in seen[RunState.RUNNING] if each.step]
    returns = {(step.number, step.description) for step in steps if step.is_return}
    align = next(step.number for step in steps if step.description.startswith("align"))
    assert returns == {(align, "go to z_up, azimuth 0 deg")}


def test_a_hold_that_was_ordered_keeps_the_dwell_that_was_under_way_and_goes_on_reading(witnessed):
    seen, _ = witnessed("navigate", order(signal.SIGUSR1))
    holding = seen[RunState.HOLDING]
    assert [len(each.dwells) for each in holding[:1]] == [1]
    assert "commanded" in holding[0].reason
    assert holding[-1].now_s > holding[0].now_s
    assert holding[-1].left_s == holding[0].left_s


def test_a_dwell_that_was_skipped_is_neither_measured_nor_a_completed_share_of_the_plan(witnessed, tmp_path):
    _, last = witnessed("navigate", order(signal.SIGUSR2))
    assert (last.state, last.finished_dwells, last.skipped) == (RunState.FINISHED, 1, (1,))
    assert [span.dwells for span in last.planned.positions] == [(1,), (2,)]
    assert 0.4 < last.share_done < 0.7
    first, second = (bars[0] for bars in profile_chart(last).lanes.values())
    assert (first.is_over, second.is_over) == (False, True)
    records = snapshot_from_records(RunFolder(tmp_path / "run"))
    assert (records.skipped, records.share_done) == (last.skipped, pytest.approx(last.share_done))


def test_a_trip_waits_for_the_operator_and_says_why_when_its_cause_is_over(witnessed):
    def trip_table(bench):
        world = str(find_document("worlds", "ideal"))
        emulated = bench_at(BenchAddress(bench.clock.name, world, 0))
        emulated.serial["table"].trip(1, SoftwareFault.RATE_TRIP, bench.clock.now())

    seen, last = witnessed("navigate", trip_table, refuses="The run holds")
    held = seen[RunState.WAITING][-1]
    assert "rate trip" in held.reason
    assert held.alarms == ()
    assert held.question.answers == ("continue", "abort")
    assert last.state is RunState.STOPPED


def test_what_is_wrong_is_an_alarm_as_long_as_it_lasts(witnessed):
    seen, last = witnessed(faults="{fault: chamber_alarm, alarm: 2, at_s: 200, for_s: 20}")
    alarms = [{alarm.name for alarm in each.alarms} for each in seen[RunState.WAITING]]
    assert {"chamber_alarm"} in alarms
    assert seen[RunState.RUNNING][-1].alarms == ()
    assert last.state is RunState.FINISHED


def killed(bench):
    raise KilledError


def test_a_resumed_run_shows_what_it_read_and_noted_before_the_kill(tmp_path):
    job = prepare_job("ten_minute_check", "quick", Emulation("quick", 0))
    first, again = SnapshotRecorder(job.plan), SnapshotRecorder(job.plan)
    first.noted("noted at the start")
    with pytest.raises(KilledError):
        run_job(
            job, tmp_path / "run", ObserverGroup(first, Witness(first, "turn", killed)), ConsentingOperator()
        )
    before = first.snapshot()
    (tmp_path / "run" / "live.json").write_bytes(before.to_json())
    resumption = prepare_resumption(tmp_path / "run")
    again.noted("noted before the bench is ready")
    folder, _ = resume_run(resumption, again, ConsentingOperator())
    last = read_snapshot(folder.live)
    times_s = [note.time_s for note in last.messages]
    early = ["noted at the start", "noted before the bench is ready"]
    assert [note.text for note in last.messages][:2] == early
    assert times_s == sorted(times_s)
    assert times_s[1] >= before.now_s
    read_s = np.array(last.measured.time_s)
    assert (np.diff(read_s) >= 0.0).all()
    assert read_s[0] == before.measured.time_s[0] < before.now_s < read_s[-1]
    gap = np.isnan(last.measured.chamber_c)
    assert before.now_s <= read_s[gap].min() <= read_s[gap].max() < read_s[-1]
