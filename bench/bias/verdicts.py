"""What acceptance asks of a unit, and the verdicts on it: how they are told and kept."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from bench.documents import StrictModel

#: What a limit is on.
Quantity = Literal["position difference", "bias"]
#: Of a gyro in one bin.
Verdict = Literal["pass", "marginal", "fail"]
#: Of a whole gyro.
GyroVerdict = Literal["pass", "marginal", "fail", "not measured"]
#: Of a run.
RunVerdict = Literal["accepted", "marginal", "rejected", "not judged"]


class AcceptanceLimits(StrictModel):
    """What a gyro has to keep in every temperature bin."""

    position_difference_dph: float = Field(
        gt=0.0, description="largest difference of a gyro's bias between two positions in one bin, deg/h"
    )
    bias_dph: float | None = Field(
        default=None,
        gt=0.0,
        description="largest bias of a gyro in any position and bin, of either sign, deg/h",
    )
    bias_sigma_dph: float | None = Field(
        default=None,
        gt=0.0,
        description="a bias whose standard uncertainty is larger counts as not measured, deg/h",
    )
    confidence: float = Field(
        default=0.95,
        gt=0.5,
        lt=1.0,
        description="probability that a unit at a limit is not accepted, and one within all is not rejected",
    )


class Judgement(StrictModel):
    """One gyro in one bin against one limit.

    Attributes
    ----------
    positions : list of str
        Those compared.
    worst : list of str
        The two that differ most, the higher bias first; for a bias, its position.
    value_dph, sigma_dph : float
        Their difference, or that bias without its sign, and its standard uncertainty.
    at_least_dph, at_most_dph : float
        Limits of the largest true one, each with the probability ``confidence`` that the limits of
        acceptance state: the lower one for all judgements of the run together.
    """

    gyro: str = Field(pattern="^[xyz]$")
    quantity: Quantity
    bin_low_c: float
    bin_high_c: float
    positions: list[str]
    worst: list[str] = Field(min_length=1, max_length=2)
    value_dph: float
    sigma_dph: float
    at_least_dph: float
    at_most_dph: float
    limit_dph: float
    verdict: Verdict


class NotMeasured(StrictModel):
    """A planned position of which a gyro's bias was not compared with another one at that temperature."""

    gyro: str = Field(pattern="^[xyz]$")
    chamber_set_c: float | None
    position: str


class Acceptance(StrictModel):
    """Verdict on the unit of a run, and what it stands on.

    Attributes
    ----------
    limits : AcceptanceLimits or None
        None where the procedure states none: then nothing is judged.
    gyros : dict of str to str
        Verdict on each gyro.
    """

    verdict: RunVerdict = "not judged"
    limits: AcceptanceLimits | None = None
    gyros: dict[str, GyroVerdict] = Field(default_factory=dict)
    judgements: list[Judgement] = Field(default_factory=list)
    not_measured: list[NotMeasured] = Field(default_factory=list)

    def worst(self, gyro: str, quantity: Quantity = "position difference") -> Judgement | None:
        """Return the judgement that comes nearest to a fail, or is farthest beyond it; None without any."""
        own = [each for each in self.judgements if (each.gyro, each.quantity) == (gyro, quantity)]
        order = ("pass", "marginal", "fail")
        return max(own, key=lambda each: (order.index(each.verdict), each.at_most_dph), default=None)
