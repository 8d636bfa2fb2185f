"""What trips while a run holds: everything is brought to its safe value again, and has to be good as well."""

import os
from types import SimpleNamespace
from unittest.mock import Mock

import pytest

from gyrobench.bench.engine.holding import Ticker
from gyrobench.bench.engine.job import prepare_job
from gyrobench.bench.engine.operator import ConsentingOperator, RunCommand, send_command
from gyrobench.bench.engine.run import run_job
from gyrobench.bench.runs.journal import read_journal
from gyrobench.bench.station.instruments import Emulation
from tests.bench.engine.intervention import short_dwell
from tests.bench.engine.test_resumption import Watcher

PROCEDURE = """procedure: one_dwell
steps:
  - power_on: {settle_s: 20}
  - chamber: {temperature_c: 26, ramp_c_per_min: 10}
  - soak: {for_s: 60}
""" + short_dwell(align_s=16)


class PausingOperator(ConsentingOperator):
    """Pauses after some ticks, and continues after some more."""

    def __init__(self, pause_tick, continue_tick):
        super().__init__()
        self.ticks, self.pause_tick, self.continue_tick = 0, pause_tick, continue_tick

    def command(self):
        self.ticks += 1
        return RunCommand.PAUSE if self.ticks == self.pause_tick else None

    def answer(self):
        return super().answer() if self.ticks >= self.continue_tick else None


def run(tmp_path, fault, operator):
    procedure, faults = tmp_path / "one_dwell.yaml", tmp_path / "faults.yaml"
    procedure.write_text(PROCEDURE)
    faults.write_text(f"faults:\n  - {{{fault}}}\n")
    job = prepare_job(str(procedure), "quick", Emulation("quick", 0, str(faults)))
    folder, outcome = run_job(job, tmp_path / "run", Watcher(), operator)
    return list(read_journal(folder.journal)), outcome


def test_a_chamber_that_was_restarted_is_commanded_again_once_the_operator_continues(tmp_path):
    entries, outcome = run(
        tmp_path, "fault: instrument_restarts, target: chamber, at_s: 150, for_s: 15", ConsentingOperator()
    )
    assert outcome.ended == "finished", outcome.reason
    trips = [entry["interlocks"] for entry in entries if entry["event"] == "tripped"]
    assert trips[0] == ["ins_silence"]  # the chamber feeds it
    assert trips[1] == ["ins_silence", "chamber_command"]
    story = [
        entry["event"] for entry in entries if entry["event"] in ("tripped", "made_safe", "held", "continued")
    ]
    # While it starts, its set point fails; that is repeated once it answers.
    assert story[1:5] == ["tripped", "made_safe", "held", "made_safe"]
    assert story[5:9] == ["tripped", "made_safe", "held", "continued"]
    assert [entry["by"] for entry in entries if entry["event"] == "continued"] == ["the operator"]
    assert len(outcome.dwells) == 1
    assert outcome.dwells[0].row.chamber_set_c == 26.0


@pytest.mark.parametrize("kind", ["chamber_alarm, alarm: 2", "table_trips"])
def test_what_trips_in_a_pause_makes_the_bench_safe(tmp_path, kind):
    for_s = ", for_s: 30" if "alarm" in kind else ""
    entries, outcome = run(tmp_path, f"fault: {kind}, at_s: 200{for_s}", PausingOperator(60, 200))
    assert outcome.ended == "finished", outcome.reason
    events = [entry["event"] for entry in entries]
    paused = next(i for i, entry in enumerate(entries) if entry["event"] == "held")
    assert entries[paused]["why"] == "paused by the operator (terminal)"
    assert events[paused + 1 : paused + 4] == ["tripped", "made_safe", "held"]


def test_the_journal_has_who_started_paused_and_continued(tmp_path, monkeypatch):
    monkeypatch.setenv("GYROBENCH_OPERATOR", "A. Smith")
    entries, outcome = run(
        tmp_path, "fault: instrument_restarts, target: chamber, at_s: 900, for_s: 15", PausingOperator(5, 9)
    )
    assert outcome.ended == "finished", outcome.reason
    who = {entry["event"]: entry.get("operator") for entry in entries if "operator" in entry}
    assert who == {"run_started": "A. Smith", "ordered": "A. Smith", "continued": "A. Smith"}


class RelievedOperator(PausingOperator):
    """Pauses; another one continues by `gyrobench control`."""

    def __init__(self, pause_tick, continue_tick, run_folder):
        super().__init__(pause_tick, continue_tick)
        self.run_folder = run_folder

    def command(self):
        if self.ticks == self.continue_tick:
            send_command(self.run_folder, RunCommand.CONTINUE, os.getpid(), "B. Jones")
        return super().command()

    def answer(self):
        return None


def test_a_run_that_another_operator_continues_names_that_one(tmp_path, monkeypatch):
    monkeypatch.setenv("GYROBENCH_OPERATOR", "A. Smith")
    entries, outcome = run(
        tmp_path,
        "fault: instrument_restarts, target: chamber, at_s: 900, for_s: 15",
        RelievedOperator(5, 9, tmp_path / "run"),
    )
    assert outcome.ended == "finished", outcome.reason
    [continued] = [entry for entry in entries if entry["event"] == "continued"]
    assert (continued["operator"], continued["by"]) == ("B. Jones", "B. Jones (gyrobench control)")


@pytest.mark.parametrize("speed", [1.0, 10.0])
def test_of_a_resumed_fast_run_the_calendar_counts_as_set_once_it_is(speed):
    notes, clock = [], SimpleNamespace(speed=speed, offset_s=-165.8, now=lambda: 0.0)
    clock.calendar_offset_s = lambda: clock.offset_s
    bench = SimpleNamespace(clock=clock, tick=lambda: None)
    run = SimpleNamespace(bench=bench, note=notes.append, guard=Mock(), observers=Mock())
    run.guard.beat.return_value = ""
    ticker = Ticker(run, Mock())
    ticker.tick()
    assert [note[:25] for note in notes] == ["this machine's calendar w"] * (speed == 1.0)
    clock.offset_s += 7.0
    ticker.tick()
    assert "is -158.8 s from the run's time" in notes[-1]
