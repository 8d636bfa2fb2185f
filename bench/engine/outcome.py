"""How a run ended."""

from __future__ import annotations

from dataclasses import dataclass, field

from gyrobench.bench.dwells.check_dwell import CheckDwell
from gyrobench.bench.dwells.dwell import MeasuredDwell
from gyrobench.bench.dwells.results import RunResults
from gyrobench.bench.station.safe_state import SafeAction


@dataclass
class RunOutcome:
    """How a run ended.

    Attributes
    ----------
    ended : str
        "finished", "stopped" (somebody asked, or a hold lasted too long) or "failed".
    reason : str
        Why it did not finish; empty where it did.
    dwells : list of MeasuredDwell
        What was measured.
    verifications : list of CheckDwell
        What was taken to verify a calibration.
    results : RunResults
        What the dwells give together.
    duration_s : float
        On the run's clock.
    took_s : dict of str to list of tuple
        Planned and real duration of every step done, by kind.
    safe_state : list of SafeAction
        What was done at the end, and how it went.
    """

    ended: str = "finished"
    reason: str = ""
    dwells: list[MeasuredDwell] = field(default_factory=list)
    verifications: list[CheckDwell] = field(default_factory=list)
    results: RunResults = field(default_factory=RunResults)
    duration_s: float = 0.0
    took_s: dict[str, list[tuple[float, float]]] = field(default_factory=dict)
    safe_state: list[SafeAction] = field(default_factory=list)

    def fail(self, reason: str) -> None:
        """Note a failure, unless there is one already."""
        if self.ended == "finished":
            self.ended, self.reason = "failed", reason
