"""How a run ended."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

from gyrobench.bench.dwells.measure_dwell import CheckDwell, MeasuredDwell
from gyrobench.bench.dwells.run_results import RunResults
from gyrobench.bench.dwells.run_rotations import RunRotations
from gyrobench.bench.foundations.text import flag_text, listed, plural, run_ending
from gyrobench.bench.station.safe_state import SafeAction

#: Condition under which a finished run counts as failed.
FailOn = Literal["rejected", "flagged"]


@dataclass
class RunOutcome:
    """How a run ended."""

    ended: str = "finished"  #: "finished", "stopped" (by the operator, or a hold lasted too long) or "failed"
    reason: str = ""  #: why it did not finish; empty if it did
    #: Whether it ended because the data contradict the signal map or latitude of the station file.
    is_station_wrong: bool = False
    dwells: list[MeasuredDwell] = field(default_factory=list)
    check_dwells: list[CheckDwell] = field(default_factory=list)  #: dwells that check a calibration
    rotations: RunRotations = field(default_factory=RunRotations)
    finished: set[int] = field(default_factory=set)  #: numbers of all dwells that are over
    skipped: set[int] = field(default_factory=set)  #: numbers of the dwells that the operator skipped
    results: RunResults = field(default_factory=RunResults)
    #: Outcome of each unit by number in a run with several units; the run itself then has no dwells.
    units: dict[str, RunOutcome] = field(default_factory=dict)
    duration_s: float = 0.0  #: on the run's clock
    #: Actions at the end that brought the bench to its safe state.
    safe_state: list[SafeAction] = field(default_factory=list)

    @property
    def ending(self) -> str:
        """How the run ended and why, see :func:`gyrobench.bench.foundations.text.run_ending`."""
        return run_ending(self.ended, self.reason)

    @property
    def contradicting_dwell(self) -> int | None:
        """Number of the dwell whose contradiction ended the run; None if none did."""
        faults = {each.row.dwell: each.setup_fault for each in self.dwells}
        faults |= {each.marks.dwell: each.setup_fault for each in self.check_dwells}
        # The last one: dwells measured by an earlier attempt may have the same fault.
        return max(
            (number for number, fault in faults.items() if fault and fault == self.reason), default=None
        )

    @property
    def is_safe(self) -> bool:
        """Whether every action at the end succeeded."""
        return not any(action.problem for action in self.safe_state)

    def shortcoming(self, fail_on: FailOn | None) -> str:
        """Reason why a finished run counts as failed; empty if it does not.

        ``fail_on``: "rejected" if the unit is rejected; "flagged" also if a dwell has flags or was skipped.
        """
        for number, outcome in self.units.items():
            if text := outcome.shortcoming(fail_on) or (outcome.reason if fail_on else ""):
                return f"Unit {number}: {text}"
        flagged = [dwell.row for dwell in self.dwells if dwell.row.flags]
        if fail_on and self.results.acceptance.verdict == "rejected":
            return "The unit is rejected: acceptance.json has the judgements."
        if fail_on == "flagged" and flagged:
            names = "; ".join(f"dwell {row.dwell}: {flag_text(row.flags)}" for row in flagged[:3])
            flags = f"{len(flagged)} of {len(self.dwells)} dwells are flagged: {names}"
            return f"{flags}. dwells.csv has all of them."
        return self.skipped_text if fail_on == "flagged" else ""

    @property
    def skipped_text(self) -> str:
        """States the dwells that the operator skipped, which have no results; empty if there are none."""
        numbers = self.skipped.union(*(unit.skipped for unit in self.units.values())) - self.finished
        skipped = [str(dwell) for dwell in sorted(numbers)]
        name = plural(len(skipped), "dwell", "dwells")
        return f"Skipped by the operator, and not measured: {name} {listed(skipped)}." if skipped else ""

    def release(self) -> None:
        """Free the memory of dwells and results, which are in the run folder."""
        self.dwells, self.check_dwells = [], []
        self.rotations, self.results = RunRotations(), RunResults()
        for unit in self.units.values():
            unit.release()

    def fail(self, reason: str) -> None:
        """Record a failure, unless the run has already failed or stopped."""
        if self.ended == "finished":
            self.ended, self.reason = "failed", reason
