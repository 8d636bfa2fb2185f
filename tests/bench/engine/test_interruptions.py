"""What trips, fails or is ordered takes the run out of its step, and back into it."""

import os
import signal
import subprocess
from types import SimpleNamespace

import can
import numpy as np
import pytest

from gyrobench.bench.bias.dwell_table import read_dwells
from gyrobench.bench.engine.bench_state import RunPosition
from gyrobench.bench.engine.job import prepare_job
from gyrobench.bench.engine.measured_unit import DwellRecorder
from gyrobench.bench.engine.observers import RunObserver
from gyrobench.bench.engine.operator import ConsentingOperator, RunCommand
from gyrobench.bench.engine.run import run_job
from gyrobench.bench.foundations.clock import VirtualClock
from gyrobench.bench.foundations.shipped import find_document
from gyrobench.bench.runs.journal import read_journal
from gyrobench.bench.station.instruments import Emulation
from gyrobench.drivers.emulators.acl_axis import SoftwareFault
from gyrobench.drivers.frames import FrameBlock
from gyrobench.drivers.modbus_rtu import append_crc
from tests.bench.engine.intervention import Intervention, run_with, short_dwell

FLAG = """procedure: flag_only
disturbed_dwell: flag
steps:
  - power_on: {settle_s: 20}
  - go_to: {position: z_up, rate_dps: 10}
  - align: {duration_s: 60}
  - navigate: {duration_s: 61}
  - turn: {angle_deg: 180, rate_dps: 30, settle_s: 1}
  - navigate: {duration_s: 61}
"""
TWO = """procedure: two
steps:
  - power_on: {settle_s: 20}
  - repeat:
      over: {position: [z_up, z_down]}
      steps:
""" + short_dwell("$position", indent=8)


@pytest.fixture
def flag_only(tmp_path):
    path = tmp_path / "flag_only.yaml"
    path.write_text(FLAG)
    return path


@pytest.fixture
def two(tmp_path):
    path = tmp_path / "two.yaml"
    path.write_text(TWO)
    return path


def consent(tmp_path, kind, action, procedure="ten_minute_check", nth=1):
    return run_with(tmp_path, kind, action, procedure, nth, ConsentingOperator())


def events(folder, *names):
    return [entry for entry in read_journal(folder.journal) if entry["event"] in names]


def names(folder, *wanted):
    return [entry["event"] for entry in events(folder, *wanted)]


def trip_table(bench, clock):
    bench.serial["table"].trip(1, SoftwareFault.RATE_TRIP, clock.now())


def switch_unit_off(bench, clock):
    bench.world.power_unit(False)


@pytest.fixture(scope="module")
def tripped_run(tmp_path_factory):
    """A run whose table trips while the INS navigates: run folder and outcome."""
    return consent(tmp_path_factory.mktemp("tripped"), "navigate", trip_table)[:2]


def test_after_a_trip_the_bench_is_made_safe_and_held_and_the_dwell_repeated(tripped_run):
    folder, outcome = tripped_run
    assert outcome.ended == "finished", outcome.reason
    story = names(folder, "tripped", "dwell_given_up", "made_safe", "held", "continued", "dwell_finished")
    assert story == [
        "made_safe", "tripped", "dwell_given_up", "made_safe", "held", "continued", "dwell_finished"
    ]  # fmt: skip
    (tripped,) = events(folder, "tripped")
    assert tripped["interlocks"] == ["table_fault"]
    assert "rate trip" in tripped["why"]
    (row,) = read_dwells(folder.dwells)
    assert row.flags == ()


def test_a_trip_that_needs_the_operator_is_recorded_as_such(tripped_run):
    folder, _ = tripped_run
    (held,) = events(folder, "held")
    assert held["waits_for"] == "the operator"


def test_an_ins_that_falls_silent_is_switched_off_and_on_and_the_run_continues_without_an_operator(tmp_path):
    folder, outcome, _ = consent(tmp_path, "navigate", switch_unit_off, nth=2)
    assert outcome.ended == "finished", outcome.reason
    (tripped,) = events(folder, "tripped")
    assert tripped["interlocks"] == ["ins_silence"]
    (continued,) = events(folder, "continued")
    assert continued["by"] == "itself"
    assert [entry["run"] for entry in events(folder, "powered_on")] == [1, 2]
    (row,) = read_dwells(folder.dwells)
    assert row.flags == ()
    assert row.run.endswith("-2")


def test_an_ins_that_falls_back_to_alignment_has_its_dwell_repeated(tmp_path):
    folder, outcome, _ = consent(tmp_path, "navigate", lambda bench, clock: bench.world.unit.align(), nth=2)
    assert outcome.ended == "finished", outcome.reason
    (given_up,) = events(folder, "dwell_given_up")
    assert given_up["counts"]
    assert "the INS left navigation" in given_up["why"]
    (row,) = read_dwells(folder.dwells)
    assert row.flags == ()


def test_an_ins_that_falls_back_to_alignment_gives_a_flag_and_no_number_where_nothing_is_repeated(
    tmp_path, flag_only
):
    folder, outcome, _ = consent(
        tmp_path, "navigate", lambda bench, clock: bench.world.unit.align(), flag_only, nth=2
    )
    assert outcome.ended == "finished", outcome.reason
    (row,) = read_dwells(folder.dwells)
    assert "the INS left navigation" in str(row.flags)
    assert np.isnan([row.bias_dph, row.sigma_dph, row.paper_bias_dph, row.paper_sigma_dph]).all()
    assert (outcome.results.bins, outcome.results.joint, outcome.results.noise) == ([], [], None)


def test_an_ins_that_aligns_again_in_the_turn_gives_a_flag_and_no_number(tmp_path, flag_only):
    """Its new heading hides the East gyro's bias, and nothing in the two windows shows it."""
    folder, outcome, _ = consent(tmp_path, "turn", lambda bench, clock: bench.world.unit.align(), flag_only)
    assert outcome.ended == "finished", outcome.reason
    (row,) = read_dwells(folder.dwells)
    assert "the INS left navigation in the turn" in str(row.flags)
    assert np.isnan([row.bias_dph, row.sigma_dph, row.paper_bias_dph]).all()


def test_a_table_that_is_moved_and_brought_back_gives_a_flag_and_no_number(tmp_path, flag_only):
    def nudge(bench, clock):
        axis = bench.world.axes[1]
        axis.move_to(axis.encoder(clock.now()).position_deg + 5.0, clock.now())

    class Nudger(Intervention):
        def ticked(self, live, left_s):
            was_done = self.done
            super().ticked(live, left_s)
            if self.done and not was_done:
                self.back_s = live.clock.now() + 30.0
            elif self.done and self.back_s and live.clock.now() >= self.back_s:
                axis = self.bench.world.axes[1]
                axis.move_to(axis.encoder(live.clock.now()).position_deg - 5.0, live.clock.now())
                self.back_s = 0.0

    intervention = Nudger("navigate", nudge)
    job = prepare_job(str(flag_only), "emulated", Emulation("ideal", 0))
    folder, outcome = run_job(job, tmp_path / "run", intervention, ConsentingOperator())
    assert outcome.ended == "finished", outcome.reason
    (row,) = read_dwells(folder.dwells)
    assert "the table moved by 5.0" in str(row.flags)
    assert "in window 1 the unit turned by 5.0 deg according to the INS (limit 0.5 deg)." in str(row.flags)
    assert np.isnan(row.bias_dph).all()


@pytest.mark.parametrize(("step_deg", "flags"), [(0.001, ()), (0.002, ("the table moved by 0.0020 deg",))])
def test_the_last_digit_of_a_table_that_reads_thousandths_is_no_motion(step_deg, flags):
    capture = SimpleNamespace(table_deg=[(20.0 + step_deg, 0.0), (20.0, 0.0)] * 30, log_part=1)
    capture.chamber_c = capture.neighbours_on = []
    unit = SimpleNamespace(
        capture=capture,
        state=SimpleNamespace(azimuth_deg=0.0, position="z_up", number="1"),
        begin_capture=lambda: None,
        begin_window=lambda **_: None,
        captured_frames=lambda: 0,
        ins=SimpleNamespace(error_frames=0),
    )
    bench = SimpleNamespace(clock=VirtualClock(), table_angles=lambda: (20.0, 0.0))
    bench.state = SimpleNamespace(run_position=RunPosition(), commanded_c=None)
    recorder = DwellRecorder(bench, unit, None)
    recorder.begin()
    recorder.begin_window()
    recorder.end_window()
    found = recorder.marks().disturbances
    assert len(found) == len(flags)
    assert all(each.startswith(flag) for each, flag in zip(found, flags, strict=True))


def test_a_dwell_that_stays_invalid_is_flagged_after_its_repeats_and_the_run_continues(tmp_path, two):
    text = two.read_text()
    two.write_text(text.replace("align: {duration_s: 60}", "align: {until_fine: true, at_most_s: 100}"))
    folder, outcome, _ = consent(tmp_path, "align", lambda bench, clock: None, two)
    assert outcome.ended == "finished", outcome.reason
    assert len(events(folder, "dwell_given_up")) == 4
    # Switching it off and on for a repeat is no restart without a command.
    assert len(events(folder, "powered_on")) == 4
    assert not any("has restarted" in entry["text"] for entry in events(folder, "note"))
    rows = read_dwells(folder.dwells)
    assert [row.dwell for row in rows] == [1, 2]
    assert all("did not end within 100 s" in str(row.flags) for row in rows)


def test_a_chamber_switched_off_at_its_panel_trips(tmp_path):
    path = tmp_path / "hot.yaml"
    path.write_text("procedure: hot\nsteps:\n  - chamber: {temperature_c: 40, ramp_c_per_min: 4}\n")

    def switch_off(bench, clock):
        bench.serial["chamber"].feed(append_crc(bytes.fromhex("010607d00000")), clock.now())

    folder, outcome, _ = run_with(tmp_path, "chamber", switch_off, path)
    assert outcome.ended == "stopped"
    (tripped,) = events(folder, "tripped")
    assert tripped["interlocks"] == ["chamber_command"]
    assert "off although the bench switched it on" in tripped["why"]


def test_bus_errors_in_a_dwell_are_noted_and_are_no_data(tmp_path, flag_only):
    def disturb(bench, clock):
        error = can.Message(clock.now(), 0x04, is_extended_id=False, is_error_frame=True, data=b"\xff" * 8)
        for channel in bench.channels.values():
            for listener in channel.listeners:
                listener(FrameBlock.from_messages([error] * 7))

    folder, outcome, _ = run_with(tmp_path, "navigate", disturb, flag_only)
    assert outcome.ended == "finished"
    (row,) = read_dwells(folder.dwells)
    assert row.flags == ()
    notes = [entry["text"] for entry in read_journal(folder.journal) if entry["event"] == "note"]
    note = "the CAN adapter reports 7 bus errors in dwell 1. Check bit rate, termination and cable."
    assert note in notes


def test_a_pause_discards_the_dwell_and_repeats_it(tmp_path):
    folder, outcome, _ = consent(
        tmp_path, "navigate", lambda bench, clock: os.kill(os.getpid(), signal.SIGTSTP), nth=2
    )
    assert outcome.ended == "finished", outcome.reason
    story = names(folder, "ordered", "dwell_given_up", "held", "continued", "dwell_finished")
    assert story == ["ordered", "dwell_given_up", "held", "continued", "dwell_finished"]
    (ordered,) = events(folder, "ordered")
    assert (ordered["order"], ordered["by"]) == ("pause", "SIGTSTP")
    (row,) = read_dwells(folder.dwells)
    assert row.flags == ()
    assert row.run.endswith("-1")  # the INS stayed on


def test_a_process_that_was_stopped_does_not_continue_a_hold_when_it_runs_again(tmp_path):
    """SIGCONT also comes from a shell, cpulimit or systemd, and means only that the process runs again."""

    def pause_and_stop(bench, clock):
        os.kill(os.getpid(), signal.SIGTSTP)
        stopped = f"kill -STOP {os.getpid()}; kill -CONT {os.getpid()}"
        subprocess.run(["sh", "-c", stopped], check=True)

    folder, outcome, _ = consent(tmp_path, "navigate", pause_and_stop)
    assert outcome.ended == "finished", outcome.reason
    assert [entry["order"] for entry in events(folder, "ordered")] == ["pause"]
    assert [entry["by"] for entry in events(folder, "continued")] == ["the operator"]


def test_a_process_that_did_not_run_for_a_while_is_noted(tmp_path):
    folder, outcome, _ = consent(tmp_path, "navigate", lambda bench, clock: clock.sleep(45.0))
    assert outcome.ended == "finished", outcome.reason
    [text] = [entry["text"] for entry in events(folder, "note") if "no tick" in entry["text"]]
    assert text.startswith("no tick for 46 s: this process was stopped, the computer suspended")


def test_a_hold_lets_the_dwell_end_first(tmp_path, two):
    folder, outcome, _ = consent(
        tmp_path, "align", lambda bench, clock: os.kill(os.getpid(), signal.SIGUSR1), two
    )
    assert outcome.ended == "finished", outcome.reason
    story = names(folder, "ordered", "dwell_finished", "held", "continued")
    assert story == ["ordered", "dwell_finished", "held", "continued", "dwell_finished"]
    [held] = events(folder, "held")
    assert held["why"] == "hold at this temperature commanded by another program (SIGUSR1)"


def test_a_skipped_dwell_is_not_measured(tmp_path, two):
    folder, outcome, _ = consent(
        tmp_path, "navigate", lambda bench, clock: os.kill(os.getpid(), signal.SIGUSR2), two
    )
    assert outcome.ended == "finished", outcome.reason
    assert [entry["dwell"] for entry in events(folder, "dwell_skipped")] == [1]
    assert (outcome.skipped, outcome.skipped_text) == (
        {1},
        "Skipped by the operator, and not measured: dwell 1.",
    )
    assert [row.dwell for row in read_dwells(folder.dwells)] == [2]


def test_a_skip_outside_of_a_dwell_changes_nothing(tmp_path, two):
    folder, outcome, _ = consent(
        tmp_path, "power_on", lambda bench, clock: os.kill(os.getpid(), signal.SIGUSR2), two
    )
    assert outcome.ended == "finished", outcome.reason
    assert [entry["text"] for entry in events(folder, "note")] == [
        "no dwell is in progress: nothing is skipped"
    ]
    [ordered] = events(folder, "ordered")
    assert ordered["refused"] == "no dwell is in progress: nothing is skipped"
    assert not outcome.skipped
    assert [entry["step"] for entry in events(folder, "step_started")] == list(range(1, 12))


def test_a_run_states_which_commands_it_does_not_accept(tmp_path):
    def send(bench, clock):
        for number in (signal.SIGRTMAX, signal.SIGTSTP, signal.SIGUSR2, signal.SIGUSR1, signal.SIGTSTP):
            os.kill(os.getpid(), number)

    class Waiting(ConsentingOperator):
        ticks = 6

        def answer(self):
            self.ticks -= 1
            return super().answer() if self.ticks < 0 else None

    folder, outcome, _ = run_with(tmp_path, "navigate", send, operator=Waiting())
    assert outcome.ended == "finished", outcome.reason
    hold = "the run holds: it accepts continue or abort, not"
    assert [(entry["order"], entry.get("refused", "")) for entry in events(folder, "ordered")] == [
        ("continue", "the run does not hold: there is nothing to continue"),
        ("pause", ""),
        ("skip", f"{hold} skip"),
        ("hold", f"{hold} hold"),
        ("pause", f"{hold} pause"),
    ]


def test_continue_gives_the_first_answer_to_a_question_of_the_procedure(tmp_path):
    class Away(ConsentingOperator):
        def answer(self):
            return None

    procedure = tmp_path / "ask.yaml"
    step = "{ask_operator: {question: 'Shut?', answers: ['yes', 'no']}}"
    procedure.write_text(f"procedure: ask\nsteps: [{step}]\n")
    folder, outcome, _ = run_with(
        tmp_path, "ask_operator", lambda *_: os.kill(os.getpid(), signal.SIGRTMAX), procedure, operator=Away()
    )
    assert outcome.ended == "finished", outcome.reason
    assert [entry.get("refused", "") for entry in events(folder, "ordered")] == [""]
    assert events(folder, "note")[-1]["text"] == "answered 'yes' by another program (SIGRTMAX)"


def test_an_operator_of_an_emulated_bench_gives_up_on_a_hold_that_never_clears(tmp_path):
    text = find_document("stations", "quick").read_text()
    station = tmp_path / "cold.yaml"
    station.write_text(text + "\ninterlocks:\n  gyro_temperature: {low_c: -55, high_c: 10}\n")
    job = prepare_job("ten_minute_check", str(station), Emulation("quick", 0))
    folder, outcome = run_job(job, tmp_path / "run", RunObserver(), ConsentingOperator())
    assert outcome.ended == "stopped"
    assert "the operator answered 'abort'" in outcome.reason
    assert list(read_journal(folder.journal))[-1]["time_s"] < 7200.0


def test_commands_can_be_typed(tmp_path, two):
    class Typist(ConsentingOperator):
        typed = [None] * 100 + [RunCommand.SKIP]

        def command(self):
            return self.typed.pop(0) if self.typed else None

    job = prepare_job(str(two), "emulated", Emulation("ideal", 0))
    folder, outcome = run_job(job, tmp_path / "run", Intervention("nothing", None), Typist())
    assert outcome.ended == "finished", outcome.reason
    (ordered,) = events(folder, "ordered")
    assert (ordered["order"], ordered["by"]) == ("skip", "the terminal")


def test_a_lost_reply_is_asked_for_again_and_the_retry_is_in_the_journal(tmp_path):
    def forget(bench, clock):
        table = bench.serial["table"]
        answer, lost = table.feed, []

        def feed(data, now_s):
            reply = answer(data, now_s)
            if lost:
                return reply
            lost.append(reply)
            return b""

        table.feed = feed

    folder, outcome, _ = consent(tmp_path, "go_to", forget)
    assert outcome.ended == "finished", outcome.reason
    retries = events(folder, "retry")
    assert retries
    assert retries[0]["instrument"] == "rate table"
    (row,) = read_dwells(folder.dwells)
    assert row.flags == ()
