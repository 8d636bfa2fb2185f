"""A run on a wall clock while the host's calendar is set by up to a day at a time.

A separate process, since it lasts in real time and another calendar would disturb others.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from datetime import UTC, datetime, timedelta
from pathlib import Path
from random import Random
from unittest import mock

from gyrobench.bench.engine.job import prepare_job
from gyrobench.bench.engine.live_bench import LiveBench
from gyrobench.bench.engine.operator import ConsentingOperator
from gyrobench.bench.engine.resume import prepare_resumption
from gyrobench.bench.engine.run import resume_run, run_job
from gyrobench.bench.foundations.shipped import find_document
from gyrobench.bench.runs.journal import read_journal
from gyrobench.bench.station.instruments import Emulation
from tests.soak.faults import KindTally, outcomes_of
from tests.soak.truth import WORLD, TruthWatcher, compare

_PROCEDURE = """procedure: soak_calendar
steps:
  - power_on
  - go_to: {position: z_up, rate_dps: 30, settle_s: 0}
  - align: {duration_s: 16}
  - navigate: {duration_s: 60}
  - turn: {angle_deg: 180, rate_dps: 30, settle_s: 1}
  - navigate: {duration_s: 60}
"""
#: After this number of ticks of the first attempt the run is stopped, to be resumed on the other calendar.
_STOP_TICKS = 40
_EVERY_TICKS = 6


class _Calendar(TruthWatcher):
    """Sets the calendar every few ticks, and stops the run once."""

    def __init__(self, job, sense: int, count: int, random: Random) -> None:
        super().__init__(job)
        self.offset = timedelta()
        self.set_s: list[float] = []
        self._sense = sense
        self._left = count
        self._random = random
        self._ticks = 0

    def now(self) -> datetime:
        return datetime.now(UTC) + self.offset

    def ticked(self, bench: LiveBench, left_s: float) -> None:
        super().ticked(bench, left_s)
        self._ticks += 1
        if self._left and self._ticks % _EVERY_TICKS == 0:
            self._left -= 1
            self.offset += self._sense * timedelta(seconds=self._random.choice([1.0, 60.0, 3600.0, 86400.0]))
            self.set_s.append(round(bench.clock.now(), 6))
        if self._ticks == _STOP_TICKS:
            os.kill(os.getpid(), signal.SIGTERM)


def calendar_jumps(folder: Path, kind: str, count: int, seed: int) -> KindTally:
    """Set the calendar ``count`` times in a run on a wall clock; returns what came of it."""
    folder.mkdir(parents=True, exist_ok=True)
    command = [sys.executable, "-m", "tests.soak.calendar_run", str(folder), kind, str(count), str(seed)]
    done = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=True)
    result = json.loads(done.stdout.splitlines()[-1])
    tally = KindTally(
        kind, dwells=result["dwells"], lost=result["lost"], flagged=result["flagged"], wrong=result["wrong"]
    )
    tally.outcomes.update(result["outcomes"])
    tally.problems = result["problems"]
    return tally


def _run(folder: Path, kind: str, count: int, seed: int) -> dict[str, object]:
    procedure, station = folder / "procedure.yaml", folder / "station.yaml"
    procedure.write_text(_PROCEDURE)
    text = find_document("stations", "quick").read_text().replace("clock: virtual", "clock: wall")
    for old, new in {
        "tick_s: 2.0": "tick_s: 1.0",
        "poll_period_s: 2.0": "poll_period_s: 0.2",
        "instruments_period_s: 20.0": "instruments_period_s: 2.0",
    }.items():
        text = text.replace(old, new)
    station.write_text(text)
    job = prepare_job(str(procedure), str(station), Emulation(str(WORLD), 0))
    calendar = _Calendar(job, 1 if "forward" in kind else -1, count, Random(f"{seed}/{kind}"))  # noqa: S311
    problems = []
    with mock.patch("gyrobench.bench.foundations.clock._calendar", calendar.now):
        run, outcome = run_job(job, folder / "run", calendar, ConsentingOperator())
        if outcome.ended != "stopped":
            problems.append(f"{kind}: the run was to be stopped and {outcome.ended}: {outcome.reason}")
        else:
            run, outcome = resume_run(prepare_resumption(run.path), calendar, ConsentingOperator())
        if outcome.ended != "finished":
            problems.append(f"{kind}: the run {outcome.ended}: {outcome.reason}")
    entries = list(read_journal(run.journal))
    times_s = [entry["time_s"] for entry in entries]
    if times_s != sorted(times_s):
        problems.append(f"{kind}: times in the journal go back")
    rows = [dwell.row for dwell in outcome.dwells]
    agreement = compare(rows, calendar.true_dph, kind)
    # The stop is the test's own deed, not what the calendar led to.
    caused = [entry for entry in entries if entry["event"] not in ("run_ended", "run_resumed")]
    return {
        "outcomes": outcomes_of(calendar.set_s, caused),
        "dwells": len(rows),
        "lost": job.plan.dwell_count - len(rows),
        "flagged": agreement.flagged,
        "wrong": agreement.wrong,
        "problems": problems,
    }


if __name__ == "__main__":
    sys.stdout.write(
        json.dumps(_run(Path(sys.argv[1]), sys.argv[2], int(sys.argv[3]), int(sys.argv[4]))) + "\n"
    )
