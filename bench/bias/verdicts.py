"""Limits of acceptance, the verdicts on a unit, and their file ``acceptance.json``."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Literal

from pydantic import AliasChoices, Field

from gyrobench.bench.foundations.csv_tables import read_text, write_text
from gyrobench.bench.foundations.documents import StrictModel
from gyrobench.bench.foundations.errors import DocumentError
from gyrobench.bench.foundations.files import parse_json

#: Quantity of a limit; a vertical difference is one between a gyro's axis up and down, with its own limit.
JudgedQuantity = Literal["position difference", "vertical difference", "bias"]
#: Verdict on a gyro in one bin.
Verdict = Literal["pass", "marginal", "fail"]
#: Verdict on a gyro in all bins.
GyroVerdict = Literal["pass", "marginal", "fail", "not measured"]
#: Verdict on a run.
RunVerdict = Literal["accepted", "marginal", "rejected", "not judged"]


class AcceptanceLimits(StrictModel):
    """Limits of a gyro on every plateau."""

    position_difference_dph: float = Field(
        gt=0.0, description="largest difference of a gyro's bias between two positions on one plateau, deg/h"
    )
    vertical_difference_dph: float | None = Field(
        default=None,
        gt=0.0,
        description="the same between the gyro's axis up and down, deg/h; default: as between others",
    )
    bias_dph: float | None = Field(
        default=None,
        gt=0.0,
        description="largest bias of a gyro in any position and bin, of either sign, deg/h",
    )
    bias_sigma_dph: float | None = Field(
        default=None,
        gt=0.0,
        description="a dwell whose bias has a larger standard uncertainty counts as not measured, deg/h",
    )
    confidence: float = Field(
        default=0.95,
        gt=0.5,
        lt=1.0,
        description="probability that a unit at a limit is not accepted, and one within all is not rejected",
    )

    def of(self, quantity: JudgedQuantity) -> float:
        """Limit of a quantity, deg/h."""
        special = {"vertical difference": self.vertical_difference_dph, "bias": self.bias_dph}.get(quantity)
        return self.position_difference_dph if special is None else special


class Judgement(StrictModel):
    """Judgement of one gyro on the plateaus of one bin against one limit.

    The mean temperature of a plateau determines its bin.
    """

    gyro: str = Field(pattern="^[xyz]$")
    quantity: JudgedQuantity
    bin_low_c: float
    bin_high_c: float
    positions: list[str]  #: Positions compared.
    #: The two positions that differ most, the higher bias first; for a bias, its position.
    worst: list[str] = Field(min_length=1, max_length=2)
    #: value_dph, sigma_dph: Largest difference, or absolute value of the largest bias, and its standard
    #: uncertainty.
    value_dph: float
    sigma_dph: float
    #: at_least_dph, at_most_dph: Confidence limits of the largest true value, each with the probability
    #: ``confidence`` of the limits of acceptance; the lower one for all judgements of the run together.
    at_least_dph: float
    at_most_dph: float
    limit_dph: float
    verdict: Verdict
    #: Whether these plateaus had the same differences in each pass; else each pass was judged separately.
    passes_agree: bool = True
    passes: int = 1  #: Number of passes of the plateau of which the value is the mean.
    common_sigma_dph: float = 0.0  #: Part of sigma_dph that is the same in each pass.

    @property
    def cycles_to_decide(self) -> float:
        """Cycles of one run needed for a decision, if the value stays as measured; infinite if none suffice.

        The distance of both confidence limits from a mean of passes is proportional to its standard
        uncertainty, of which the part that is the same in each pass does not average out.
        """
        if self.quantity == "bias" or not self.passes_agree:
            return math.inf
        remaining = self._variance_to_decide - self.common_sigma_dph**2
        independent = self.sigma_dph**2 - self.common_sigma_dph**2
        return math.ceil(self.passes * independent / remaining) if remaining > 0.0 else math.inf

    @property
    def is_limited_by_common_errors(self) -> bool:
        """Whether errors that are the same in each pass prevent a decision by any number of cycles."""
        is_mean = self.quantity != "bias" and self.passes_agree
        return is_mean and 0.0 < self._variance_to_decide <= self.common_sigma_dph**2

    @property
    def _variance_to_decide(self) -> float:
        """Variance, (deg/h)^2, at which the confidence limit reaches the limit of acceptance."""
        bound_dph = self.at_most_dph if self.value_dph < self.limit_dph else self.at_least_dph
        if bound_dph == self.value_dph:
            return math.inf
        return (self.sigma_dph * (self.limit_dph - self.value_dph) / (bound_dph - self.value_dph)) ** 2


class NotMeasured(StrictModel):
    """A planned dwell in which a gyro's bias was not compared with the other dwells of its plateau."""

    gyro: str = Field(pattern="^[xyz]$")
    cycle: int
    chamber_set_c: float | None
    position: str


class Acceptance(StrictModel):
    """Verdict on the unit of a run, and the judgements behind it."""

    verdict: RunVerdict = "not judged"
    limits: AcceptanceLimits | None = None  #: None if the procedure states none; then nothing is judged.
    gyros: dict[str, GyroVerdict] = Field(default_factory=dict)  #: Verdict on each gyro.
    #: Number of plateaus on which positions were compared; ``stops`` in the file.
    plateaus: int = Field(
        default=0, validation_alias=AliasChoices("plateaus", "stops"), serialization_alias="stops"
    )
    judgements: list[Judgement] = Field(default_factory=list)
    not_measured: list[NotMeasured] = Field(default_factory=list)
    #: Positions in groups between which no plateau compares; empty where plateaus connect all.
    unconnected: list[list[str]] = Field(default_factory=list)

    @property
    def dwells_not_measured(self) -> list[tuple[int, float | None, str]]:
        """Cycle, set point and position of each dwell of :attr:`not_measured`, for all gyros once."""
        return list(
            dict.fromkeys((each.cycle, each.chamber_set_c, each.position) for each in self.not_measured)
        )

    def deciding(self, gyro: str) -> Judgement | None:
        """Return the judgement that decides on a gyro, which is the most severe; None without any.

        Among equal verdicts a judgement of a difference takes precedence over one of a bias.
        """
        of_gyro = [each for each in self.judgements if each.gyro == gyro]
        return max(of_gyro, key=_severity, default=None)


def _severity(judged: Judgement) -> tuple[int, bool, float]:
    order = ("pass", "marginal", "fail")
    return order.index(judged.verdict), judged.quantity != "bias", judged.at_most_dph / judged.limit_dph


def write_acceptance(path: Path, acceptance: Acceptance) -> None:
    """Write a verdict and its judgements. Raises RunFolderError if the file can't be written."""
    write_text(path, acceptance.model_dump_json(indent=2, by_alias=True) + "\n")


def read_acceptance(path: Path) -> Acceptance:
    """Read a verdict. Raises DocumentError if the file can't be read or is not a verdict."""
    text = read_text(path)
    try:
        return Acceptance.model_validate(parse_json(text))
    except ValueError as error:
        raise DocumentError(f"{path}: holds no verdict: {error}") from error
