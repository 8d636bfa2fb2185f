"""What all parts of the engine share in one run."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from gyrobench.bench.bias.dwell_table import write_dwells
from gyrobench.bench.dwells.measurement_setup import MeasurementSetup
from gyrobench.bench.engine.job import Job
from gyrobench.bench.engine.live_bench import LiveBench
from gyrobench.bench.engine.observers import RunObserver
from gyrobench.bench.engine.operator import CommandQueue, Operator
from gyrobench.bench.engine.resume import ResumeState
from gyrobench.bench.engine.run_outcome import RunOutcome
from gyrobench.bench.foundations.errors import InstrumentError
from gyrobench.bench.guard.process import Guard
from gyrobench.bench.procedure.plan import Plan
from gyrobench.bench.runs.folder import RunFolder
from gyrobench.bench.runs.journal import Journal


@dataclass(frozen=True, eq=False)
class UnitRun:
    """The run of one unit, as if it were alone on the bench; a single unit shares the run's folder."""

    number: str  #: serial number by the station file; empty for a single unit
    plan: Plan  #: with the unit's positions
    setup: MeasurementSetup  #: how frames become biases
    folder: RunFolder
    state: ResumeState
    outcome: RunOutcome  #: its dwells, and how its part of the run ends

    def __post_init__(self) -> None:
        self.outcome.finished = self.state.finished

    def write_dwells(self) -> None:
        """Write the table of its dwells."""
        write_dwells(self.folder.dwells, [each.row for each in self.outcome.dwells])

    def named(self, text: str) -> str:
        """A message about the unit, with its number where there are several."""
        return f"unit {self.number}: {text}" if self.number else text


@dataclass(frozen=True)
class RunContext:
    """One run on one bench."""

    job: Job
    bench: LiveBench
    folder: RunFolder
    journal: Journal  #: its entries are in the journals of the units too
    observers: RunObserver
    operator: Operator
    commands: CommandQueue  #: commands that wait to be executed
    guard: Guard  #: gets a sign of life at each tick
    state: ResumeState  #: what is finished; the run keeps it up to date
    outcome: RunOutcome  #: how the run ends
    units: Mapping[str, UnitRun]  #: all by number, also those that were dropped
    unit_journals: Mapping[str, Journal]  #: of the units that are not dropped when it begins

    @property
    def plan(self) -> Plan:
        """The planned steps."""
        return self.job.plan

    def note(self, text: str) -> None:
        """Record something that the operator should know; notify the observers."""
        self.journal.record("note", text=text)
        self.observers.noted(text)

    def record_retry(self, error: InstrumentError) -> None:
        """Record an exchange that is tried again."""
        self.journal.record("retry", instrument=error.instrument, error=str(error))
