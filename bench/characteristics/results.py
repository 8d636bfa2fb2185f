"""Results of characteristic tests, and their file ``characteristics.json``."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Literal

import numpy as np
from pydantic import Field

from gyrobench.bench.foundations.arrays import FloatArray
from gyrobench.bench.foundations.csv_tables import read_text, write_text
from gyrobench.bench.foundations.documents import StrictModel
from gyrobench.bench.foundations.errors import DocumentError
from gyrobench.bench.foundations.files import parse_json

TestName = Literal[
    "turn_on_repeatability", "warm_up", "thermal_sensitivity", "allan_variance", "scale_factor_stability"
]


class Coefficient(StrictModel):
    """One coefficient of one gyro with its 95 % interval."""

    gyro: str = Field(pattern="^[xyz]$")
    name: str
    unit: str
    value: float | None  #: None if the data do not determine it.
    #: low, high: Ends of the 95 % interval; None if the data set no limit.
    low: float | None
    high: float | None


class Curve(StrictModel):
    """Data of a figure of one gyro: points with bars, and the fit."""

    gyro: str = Field(pattern="^[xyz]$")
    #: x, value, low, high, fit: One number for each point; low and high are the ends of its bar.
    x: list[float]
    value: list[float]
    low: list[float]
    high: list[float]
    fit: list[float]
    #: For each point, the name of its part of the measurement; lines are not drawn across parts. Empty if
    #: there is only one.
    parts: list[str] = Field(default_factory=list)

    @classmethod
    def of(
        cls,
        gyro: str,
        x: FloatArray,
        value: FloatArray,
        sigma: FloatArray,
        fit: FloatArray,
        parts: Sequence[str] = (),
    ) -> Curve:
        """Make a curve from points (n,) with standard uncertainties."""
        low, high = value - sigma, value + sigma
        fields = {"x": x, "value": value, "low": low, "high": high, "fit": fit}
        return cls(gyro=gyro, parts=list(parts), **{name: each.tolist() for name, each in fields.items()})


class TestResult(StrictModel):
    """Result of one test."""

    __test__ = False  # for pytest

    test: TestName
    coefficients: list[Coefficient] = Field(default_factory=list)
    curves: list[Curve] = Field(default_factory=list)
    notes: list[str] = Field(default_factory=list)  #: Sentences about omissions and limitations.


class Characteristics(StrictModel):
    """Results of the tests of one run, in the order of the procedure."""

    tests: list[TestResult] = Field(default_factory=list)


def from_draws(gyro: str, name: str, unit: str, value: float, draws: FloatArray) -> Coefficient:
    """Coefficient with the interval that contains 95 % of ``draws`` (n,); an infinite limit becomes None."""
    low, high = np.quantile(draws, [0.025, 0.975], method="nearest")
    return coefficient(gyro, name, unit, value, float(low), float(high))


def coefficient(gyro: str, name: str, unit: str, value: float, low: float, high: float) -> Coefficient:
    """Coefficient with its interval; numbers that are not finite become None."""
    value_, low_, high_ = (each if np.isfinite(each) else None for each in (value, low, high))
    return Coefficient(gyro=gyro, name=name, unit=unit, value=value_, low=low_, high=high_)


def write_characteristics(path: Path, results: Sequence[TestResult]) -> None:
    """Write the results of tests. Raises RunFolderError if the file can't be written."""
    write_text(path, Characteristics(tests=list(results)).model_dump_json(indent=1) + "\n")


def read_characteristics(path: Path) -> list[TestResult]:
    """Read the results of tests. Raises DocumentError if the file can't be read or has other content."""
    text = read_text(path)
    try:
        return Characteristics.model_validate(parse_json(text)).tests
    except ValueError as error:
        raise DocumentError(f"{path}: holds no results of tests: {error}") from error
