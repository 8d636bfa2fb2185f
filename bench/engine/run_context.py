"""What all parts of the engine share in one run."""

from __future__ import annotations

from dataclasses import dataclass

from gyrobench.bench.dwells.dwell import MeasurementSetup
from gyrobench.bench.engine.job import Job
from gyrobench.bench.engine.live_bench import LiveBench
from gyrobench.bench.engine.observers import RunObserver, RunOutcome
from gyrobench.bench.engine.operator import CommandQueue, Operator
from gyrobench.bench.engine.resume import ResumeState
from gyrobench.bench.foundations.errors import InstrumentError
from gyrobench.bench.guard.process import Guard
from gyrobench.bench.procedure.plan import Plan
from gyrobench.bench.runs.folder import RunFolder
from gyrobench.bench.runs.journal import Journal


@dataclass(frozen=True)
class RunContext:
    """One run on one bench."""

    job: Job
    setup: MeasurementSetup  #: how frames become biases
    bench: LiveBench
    folder: RunFolder
    journal: Journal
    observers: RunObserver
    operator: Operator
    commands: CommandQueue  #: commands that wait to be executed
    guard: Guard  #: gets a sign of life at each tick
    state: ResumeState  #: what is finished; the run keeps it up to date
    outcome: RunOutcome  #: how the run ends, and its dwells

    @property
    def plan(self) -> Plan:
        """The planned steps."""
        return self.job.plan

    def note(self, text: str) -> None:
        """Record something that the operator should know, and notify the observers."""
        self.journal.record("note", text=text)
        self.observers.noted(text)

    def record_retry(self, error: InstrumentError) -> None:
        """Record an exchange that is tried again."""
        self.journal.record("retry", instrument=error.instrument, error=str(error))
