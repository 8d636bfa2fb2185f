"""Record of an investigation: its searches, each with the block that was measured after it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

from gyrobench.bench.bias.dwell_table import DwellRow
from gyrobench.bench.closure.outcome import Closure
from gyrobench.bench.investigation.choice import Rival
from gyrobench.bench.investigation.forecast import Forecast
from gyrobench.bench.investigation.open_hypotheses import confirming_rivals
from gyrobench.bench.investigation.profile import ProfileCalibration
from gyrobench.bench.investigation.proposal import Outcome, Proposal

#: Purposes of a block.
DISTINGUISH, CONFIRM, TEST_LAW, CALIBRATE = "distinguish", "confirm", "test_law", "calibrate"


@dataclass(frozen=True)
class Stage:
    """One search, and the block that was measured after it."""

    #: Hours on the bench before the block: since the first table, or with a profile from the beginning.
    spent_h: float
    closure: Closure  #: The search.
    #: The hypotheses that a block has to distinguish. If one is confirmed or a law tested, that is the
    #: first, and the others lack it or one of its effects.
    rivals: tuple[Rival, ...]
    forecast: Forecast  #: Of the next dwells, from all dwells searched.
    purpose: str = DISTINGUISH  #: DISTINGUISH, CONFIRM, TEST_LAW, or CALIBRATE (a hypothesis is settled).
    proposal: Proposal | None = None  #: The block measured next; None at the end.
    #: Result of the block for the rivals; None at the end, and if all its dwells have flags.
    outcome: Outcome | None = None
    confirmation: Outcome | None = None  #: Result of the block for :attr:`confirmed`; None without one.
    calibration: ProfileCalibration | None = None  #: Calibration of the profile's biases; None without one.

    @property
    def is_uncertain(self) -> bool:
        """Whether the biases are less certain than after a measurement of the whole profile."""
        return self.calibration is not None and self.calibration.ratio > 1.0

    @property
    def confirmed(self) -> tuple[Rival, ...]:
        """The hypothesis that a block confirms or contradicts, and it without each of its effects."""
        return self.rivals if self.purpose == CONFIRM else confirming_rivals(self.closure)

    @property
    def is_test(self) -> bool:
        """Whether its block tests a prediction."""
        return self.purpose in (CONFIRM, TEST_LAW)


class Ending(NamedTuple):
    """How an investigation ends."""

    #: "settled", "nothing_found", "not_on_list", "budget", "no_block", "declined", "refuted" or
    #: "bench_failed".
    ended: str
    reason: str  #: Reason why it ends.


@dataclass(frozen=True)
class Investigation:
    """Outcome of an investigation."""

    stages: tuple[Stage, ...]  #: In the order of time; the last one has no block.
    #: ended, reason: As in :class:`Ending`.
    ended: str
    reason: str
    rows: tuple[DwellRow, ...]  #: All dwells.
    refused: Mapping[tuple[str, ...], str]  #: Reasons why the bench refused blocks, by their kinds.
    repeated_campaign_h: float  #: Duration of the first campaign, or of the profile if there is one.

    @property
    def is_conclusive(self) -> bool:
        """Whether a hypothesis is settled, or nothing was found."""
        return self.ended in ("settled", "nothing_found")

    @property
    def test(self) -> Stage | None:
        """The last block that tested a settled hypothesis or a composed law, if it gave an outcome."""
        return next((each for each in reversed(self.stages) if each.is_test and each.outcome), None)

    @property
    def closure(self) -> Closure:
        """The last search."""
        return self.stages[-1].closure

    @property
    def calibration(self) -> ProfileCalibration | None:
        """Calibration of the biases of an adaptive campaign's profile after the last search."""
        return self.stages[-1].calibration

    @property
    def spent_h(self) -> float:
        """Hours on the bench since the first table; for an adaptive campaign, from the beginning."""
        return self.stages[-1].spent_h
