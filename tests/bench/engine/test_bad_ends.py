"""Whatever ends a run, the bench is brought to its safe state and the journal says why."""

import os
import signal
from pathlib import Path

import numpy as np
import pytest

from bench.bias.tables.dwell_table import read_dwells
from bench.engine.operator import ConsentingOperator
from bench.engine.session import prepare_job, run_job
from bench.errors import DocumentError
from bench.run_store.journal import read_journal
from bench.station.instruments import Emulation
from drivers.emulators.acl_axis import SoftwareFault
from tests.bench.engine.meddler import Meddler, run_with


class RefusingOperator(ConsentingOperator):
    def ask(self, question, answers):
        self._answer = answers[-1]


def assert_safe(folder, outcome, bench):
    assert [action.problem for action in outcome.safe_state] == [""] * len(outcome.safe_state)
    for axis in bench.world.axes.values():
        assert not axis.is_moving(bench.clock.now() + 60.0)
    assert bench.world.air.set_point_c == 23.0
    last = list(read_journal(folder.journal))[-1]
    assert (last["event"], last["reason"]) == ("run_ended", outcome.reason)


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP, signal.SIGINT])
def test_a_signal_stops_the_run_safely(tmp_path, number):
    folder, outcome, bench = run_with(tmp_path, "navigate", lambda bench, clock: os.kill(os.getpid(), number))
    assert outcome.ended == "stopped"
    assert signal.Signals(number).name in outcome.reason
    assert_safe(folder, outcome, bench)


def test_a_trip_of_the_table_fails_the_run_safely(tmp_path):
    def trip(bench, clock):
        bench.serial["table"].trip(1, SoftwareFault.RATE_TRIP, clock.now())

    folder, outcome, bench = run_with(tmp_path, "navigate", trip)
    assert outcome.ended == "failed"
    assert "rate trip" in outcome.reason
    assert_safe(folder, outcome, bench)


def test_an_interlock_that_opens_in_a_turn_fails_the_run_safely(tmp_path):
    def open_door(bench, clock):
        bench.serial["table"].open_interlock(2, clock.now())

    folder, outcome, bench = run_with(tmp_path, "turn", open_door)
    assert outcome.ended == "failed"
    assert "rate table" in outcome.reason
    assert_safe(folder, outcome, bench)


def test_a_broken_chamber_sensor_fails_the_run(tmp_path):
    def break_sensor(bench, clock):
        bench.serial["chamber"].sensor_error = 1

    _, outcome, _ = run_with(tmp_path, "align", break_sensor)
    assert outcome.ended == "failed"
    assert "INPUT_1_ERROR" in outcome.reason or "sensor" in outcome.reason


def test_an_ins_that_loses_power_fails_the_step_in_its_time(tmp_path):
    folder, outcome, bench = run_with(tmp_path, "align", lambda bench, clock: bench.world.power_unit(False))
    assert outcome.ended == "failed"
    assert outcome.dwells == []
    assert_safe(folder, outcome, bench)


def test_an_ins_that_falls_silent_while_it_navigates_fails_the_run_without_a_dwell(tmp_path):
    folder, outcome, bench = run_with(
        tmp_path, "navigate", lambda bench, clock: bench.world.power_unit(False), nth=2
    )
    assert outcome.ended == "failed"
    assert "INS: has sent nothing for" in outcome.reason
    assert outcome.dwells == []
    assert outcome.results.bins == []
    assert_safe(folder, outcome, bench)


def test_an_ins_that_falls_back_to_alignment_gives_a_flag_and_no_number(tmp_path):
    folder, outcome, _ = run_with(tmp_path, "navigate", lambda bench, clock: bench.world.unit.align(), nth=2)
    assert outcome.ended == "finished", outcome.reason
    (row,) = read_dwells(folder.dwells)
    assert "the INS left navigation" in row.flags
    assert np.isnan([row.bias_dph, row.sigma_dph, row.paper_bias_dph, row.paper_sigma_dph]).all()
    assert (outcome.results.bins, outcome.results.joint, outcome.results.noise) == ([], [], None)


def test_an_ins_that_aligns_anew_in_the_turn_gives_a_flag_and_no_number(tmp_path):
    """Its new heading hides the East gyro's bias, and nothing in the two windows shows it."""
    folder, outcome, _ = run_with(tmp_path, "turn", lambda bench, clock: bench.world.unit.align())
    assert outcome.ended == "finished", outcome.reason
    (row,) = read_dwells(folder.dwells)
    assert "the INS left navigation in the turn" in row.flags
    assert np.isnan([row.bias_dph, row.sigma_dph, row.paper_bias_dph]).all()


def test_a_table_that_is_moved_and_brought_back_gives_a_flag_and_no_number(tmp_path):
    def nudge(bench, clock):
        axis = bench.world.axes[1]
        axis.move_to(axis.encoder(clock.now()).position_deg + 5.0, clock.now())

    class Nudger(Meddler):
        def ticked(self, live, left_s):
            was_done = self.done
            super().ticked(live, left_s)
            if self.done and not was_done:
                self.back_s = live.clock.now() + 60.0
            elif self.done and self.back_s and live.clock.now() >= self.back_s:
                axis = self.bench.world.axes[1]
                axis.move_to(axis.encoder(live.clock.now()).position_deg - 5.0, live.clock.now())
                self.back_s = 0.0

    meddler = Nudger("navigate", nudge)
    job = prepare_job("ten_minute_check", "emulated", Emulation("ideal", 0))
    folder, outcome = run_job(job, tmp_path / "run", meddler, ConsentingOperator())
    assert outcome.ended == "finished", outcome.reason
    (row,) = read_dwells(folder.dwells)
    assert "the table moved by 5.0" in row.flags
    assert "in window 1 the unit turned by 5.0 deg" in row.flags
    assert np.isnan(row.bias_dph).all()


def test_a_chamber_switched_off_at_its_panel_fails_the_step_with_its_place_in_the_file(tmp_path):
    path = tmp_path / "hot.yaml"
    path.write_text(
        "procedure: hot\nsteps:\n  - chamber: {temperature_c: 60, ramp_c_per_min: 4, timeout_s: 900}\n"
    )

    def switch_off(bench, clock):
        bench.world.air.running = False

    folder, outcome, bench = run_with(tmp_path, "chamber", switch_off, path)
    assert outcome.ended == "failed"
    assert "hot.yaml:3:" in outcome.reason
    assert "not over after 900 s" in outcome.reason
    assert_safe(folder, outcome, bench)


def test_an_unexpected_exception_is_raised_once_the_bench_is_safe(tmp_path):
    class SurpriseError(Exception):
        pass

    def fail(bench, clock):
        raise SurpriseError("in a step")

    meddler = Meddler("turn", fail)
    job = prepare_job("ten_minute_check", "emulated", Emulation("ideal", 0))
    with pytest.raises(SurpriseError):
        run_job(job, tmp_path / "run", meddler, ConsentingOperator())
    last = list(read_journal(tmp_path / "run" / "journal.jsonl"))[-1]
    assert last["ended"] == "failed"
    assert "Surprise" in last["reason"]
    assert [action["problem"] for action in last["safe_state"]] == [""] * len(last["safe_state"])
    assert meddler.bench.world.air.set_point_c == 23.0


def test_nothing_moves_before_a_wrong_procedure_is_refused(tmp_path):
    path = tmp_path / "wrong.yaml"
    path.write_text("procedure: wrong\nsteps:\n  - chamber: {temperature_c: 90, ramp_c_per_min: 50}\n")
    with pytest.raises(DocumentError) as caught:
        prepare_job(str(path), "emulated")
    assert str(caught.value).count("wrong.yaml:3:") == 2


def test_an_operator_who_does_not_go_on_stops_the_run(tmp_path):
    path = tmp_path / "ask.yaml"
    path.write_text("procedure: ask\nsteps:\n  - ask_operator: {question: 'Is the door shut?'}\n")
    job = prepare_job(str(path), "emulated")
    watcher = Meddler("nothing", None)
    _, outcome = run_job(job, tmp_path / "run", watcher, RefusingOperator())
    assert outcome.ended == "stopped"
    assert "Is the door shut?" in outcome.reason


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
