"""Objects of one run that all parts of the engine share."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from gyrobench.bench.bias.dwell_table import write_dwells
from gyrobench.bench.dwells.measurement_setup import MeasurementSetup
from gyrobench.bench.engine.job import Job
from gyrobench.bench.engine.live_bench import LiveBench
from gyrobench.bench.engine.observers import RunObserver
from gyrobench.bench.engine.operator import CommandQueue, Operator
from gyrobench.bench.engine.resume_state import ResumeState
from gyrobench.bench.engine.run_outcome import RunOutcome
from gyrobench.bench.foundations.errors import InstrumentError
from gyrobench.bench.guard.process import Guard
from gyrobench.bench.procedure.plan import Plan
from gyrobench.bench.runs.folder import RunFolder
from gyrobench.bench.runs.journal import Journal


@dataclass(frozen=True, eq=False)
class UnitRun:
    """The part of a run that belongs to one unit; a single unit shares the run's folder."""

    number: str  #: serial number in the station file; empty for a single unit
    plan: Plan  #: with the unit's positions
    setup: MeasurementSetup  #: how frames become biases
    folder: RunFolder
    progress: ResumeState
    outcome: RunOutcome  #: its dwells, and how the run ended for it

    def __post_init__(self) -> None:
        self.outcome.finished, self.outcome.skipped = self.progress.finished, self.progress.skipped

    def write_dwells(self) -> None:
        """Write the table of its dwells."""
        write_dwells(self.folder.dwells, [each.row for each in self.outcome.dwells])

    def with_number(self, text: str) -> str:
        """Prefix a message with the unit's number, if there are several."""
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
    commands: CommandQueue  #: commands not yet executed
    guard: Guard  #: gets a heartbeat at each tick
    progress: ResumeState  #: kept up to date by the run
    outcome: RunOutcome  #: how the run ends
    units: Mapping[str, UnitRun]  #: all units by number, including dropped ones
    unit_journals: Mapping[str, Journal]  #: of the units that are not dropped when the run starts

    @property
    def plan(self) -> Plan:
        """The planned steps."""
        return self.job.plan

    def note(self, text: str) -> None:
        """Record a note for the operator; notify the observers."""
        self.journal.record("note", text=text)
        self.observers.noted(text)

    def record_retry(self, error: InstrumentError) -> None:
        """Record a failed exchange that is repeated."""
        self.journal.record("retry", instrument=error.instrument, error=str(error))
