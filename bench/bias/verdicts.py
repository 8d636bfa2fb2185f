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

#: What a limit is on; a vertical difference is one between a gyro's axis up and down, with a separate limit.
JudgedQuantity = Literal["position difference", "vertical difference", "bias"]
#: Of a gyro in one bin.
Verdict = Literal["pass", "marginal", "fail"]
#: Of a whole gyro.
GyroVerdict = Literal["pass", "marginal", "fail", "not measured"]
#: Of a run.
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
        own = {"vertical difference": self.vertical_difference_dph, "bias": self.bias_dph}.get(quantity)
        return self.position_difference_dph if own is None else own


class Judgement(StrictModel):
    """One gyro on the plateaus of one bin against one limit; the mean temperature decides the bin."""

    gyro: str = Field(pattern="^[xyz]$")
    quantity: JudgedQuantity
    bin_low_c: float
    bin_high_c: float
    positions: list[str]  #: Those compared.
    #: The two that differ most, the higher bias first; for a bias, its position.
    worst: list[str] = Field(min_length=1, max_length=2)
    #: value_dph, sigma_dph: Their difference, or that bias without its sign, and its standard uncertainty.
    value_dph: float
    sigma_dph: float
    #: at_least_dph, at_most_dph: Limits of the largest true one, each with the probability ``confidence``
    #: that the limits of acceptance state: the lower one for all judgements of the run together.
    at_least_dph: float
    at_most_dph: float
    limit_dph: float
    verdict: Verdict
    #: Whether these plateaus had the same differences in each pass; else each pass was judged alone.
    passes_agree: bool = True
    passes: int = 1  #: Number of passes of the plateau of which the value is the mean.
    common_sigma_dph: float = 0.0  #: Part of sigma_dph that is the same in each pass.

    @property
    def cycles_to_decide(self) -> float:
        """Cycles of one run that decide, if the value stays as measured; infinite where no number does.

        The distance of both confidence limits from a mean of passes follows its standard uncertainty, of
        which the part that is the same in each pass stays.
        """
        if self.quantity == "bias" or not self.passes_agree:
            return math.inf
        left = self._variance_to_decide - self.common_sigma_dph**2
        own = self.sigma_dph**2 - self.common_sigma_dph**2
        return math.ceil(self.passes * own / left) if left > 0.0 else math.inf

    @property
    def is_limited_by_common_errors(self) -> bool:
        """Whether errors that are the same in each pass keep any number of cycles from a decision."""
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
    """A planned dwell of which a gyro's bias was not compared with the others of its plateau."""

    gyro: str = Field(pattern="^[xyz]$")
    cycle: int
    chamber_set_c: float | None
    position: str


class Acceptance(StrictModel):
    """Verdict on the unit of a run, and what it stands on."""

    verdict: RunVerdict = "not judged"
    limits: AcceptanceLimits | None = None  #: None where the procedure states none: then nothing is judged.
    gyros: dict[str, GyroVerdict] = Field(default_factory=dict)  #: Verdict on each gyro.
    #: Number of plateaus on which positions were compared; ``stops`` in the file.
    plateaus: int = Field(
        default=0, validation_alias=AliasChoices("plateaus", "stops"), serialization_alias="stops"
    )
    judgements: list[Judgement] = Field(default_factory=list)
    not_measured: list[NotMeasured] = Field(default_factory=list)
    #: Positions in groups between which no plateau compares; empty where plateaus connect all.
    unconnected: list[list[str]] = Field(default_factory=list)

    def deciding(self, gyro: str) -> Judgement | None:
        """Return what decides on a gyro: nearest to a fail, or farthest beyond it; None without any.

        Of judgements with the same verdict one on a difference comes before one on a bias.
        """
        own = [each for each in self.judgements if each.gyro == gyro]
        return max(own, key=_severity, default=None)


def _severity(judged: Judgement) -> tuple[int, bool, float]:
    order = ("pass", "marginal", "fail")
    return order.index(judged.verdict), judged.quantity != "bias", judged.at_most_dph / judged.limit_dph


def write_acceptance(path: Path, acceptance: Acceptance) -> None:
    """Write a verdict and all that it stands on. Raises RunFolderError if the file can't be written."""
    write_text(path, acceptance.model_dump_json(indent=2, by_alias=True) + "\n")


def read_acceptance(path: Path) -> Acceptance:
    """Read a verdict. Raises DocumentError if the file can't be read or holds something else."""
    text = read_text(path)
    try:
        return Acceptance.model_validate(parse_json(text))
    except ValueError as error:
        raise DocumentError(f"{path}: holds no verdict: {error}") from error
