"""Coefficients of the sensors over temperature as tables: ``coefficients.csv`` and ``correlations.csv``."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from gyrobench.bench.calibration.coefficients import COEFFICIENTS, NOT_OBSERVABLE, correlation_cells
from gyrobench.bench.foundations.arrays import FloatArray
from gyrobench.bench.foundations.csv_tables import CsvTable, RecordTable, one_of, read_text, write_text
from gyrobench.bench.runs.tables.budget_table import BUDGET_TABLE


@dataclass(frozen=True, slots=True)
class PlateauCoefficientRow:
    """One coefficient at one plateau; NaN for unknown numbers."""

    plateau: int  #: Number of the plateau, from 1.
    cycle: int
    chamber_set_c: float
    temperature_c: float  #: Mean temperature of the gyro; for an accelerometer, of the case.
    coefficient: str  #: ``gyro_bias``, ``accelerometer_misalignment``, ...
    axis: str  #: Sensor axis; of a misalignment the sensor and the axis that it senses.
    value: float  #: NaN if not observable.
    sigma: float  #: Standard uncertainty.
    unit: str
    finding: str  #: Empty, ``not observable``, or the problem of the plateau.
    #: Expected standard uncertainty if the INS sent specific force; NaN if it does.
    sigma_with_force: float
    #: Slope of the temperature of the gyro along the sensor's axis in the rotations; NaN without these.
    gyro_rate_c_per_h: float
    note: str = ""  #: Effect estimated at the plateau in addition to the coefficients, which remain valid.

    @property
    def name(self) -> str:
        """Name with the axis: ``gyro_bias_x``."""
        return f"{self.coefficient}_{self.axis}"


#: ``coefficients.csv``.
COEFFICIENT_TABLE = RecordTable(
    PlateauCoefficientRow,
    {
        field: one_of({getattr(each, name) for each in COEFFICIENTS})
        for field, name in (("coefficient", "name"), ("axis", "axis"))
    },
)
#: Contributions to uncertainty that are one error at all plateaus.
COMMON_SOURCES = ("gravity", "latitude")

#: Frame and temperatures of the rows, as reports state them.
FRAME_TEXT = (
    "The body frame is that of the accelerometers: x is the input axis of the x accelerometer, and that of y "
    "lies in the plane of x and y; so 21 of the 24 coefficients are independent, and the others are zero. A "
    "misalignment xy is what sensor x senses of axis y."
)
TEMPERATURE_TEXT = (
    "Columns are headed by the temperatures of x gyro and case: coefficients of gyros belong to the "
    "first, those of accelerometers to the second."
)


def plateau_heads(rows: Iterable[PlateauCoefficientRow]) -> dict[int, str]:
    """Temperatures of the x gyro and of the case at each plateau, ``67 / 63 °C``, by its number."""
    temperatures_by_plateau: dict[int, dict[str, float]] = {}
    for row in rows:
        sensor = "gyro" if row.coefficient.startswith("gyro") else "case"
        temperatures_by_plateau.setdefault(row.plateau, {}).setdefault(sensor, row.temperature_c)
    return {
        plateau: " / ".join("–" if math.isnan(each) else f"{each:.0f}" for each in temperatures.values())
        + " °C"
        for plateau, temperatures in temperatures_by_plateau.items()
    }


def plateau_findings(rows: Iterable[PlateauCoefficientRow]) -> list[str]:
    """Problems of plateaus, one sentence each."""
    return _plateau_texts(
        (row.plateau, row.finding.removeprefix(NOT_OBSERVABLE).removeprefix("; ")) for row in rows
    )


def plateau_notes(rows: Iterable[PlateauCoefficientRow]) -> list[str]:
    """Effects at plateaus that leave the coefficients valid, one sentence each."""
    return _plateau_texts((row.plateau, row.note) for row in rows)


def _plateau_texts(texts: Iterable[tuple[int, str]]) -> list[str]:
    return [f"Plateau {plateau}: {text}." for plateau, text in dict.fromkeys(texts) if text]


def write_correlations(path: Path, plateaus: Sequence[tuple[int, FloatArray]]) -> None:
    """Write correlation coefficients (21, 21), by number of plateau; NaN if not observable."""
    names = [f"{each.name}_{each.axis}" for each in COEFFICIENTS]
    lines = [",".join(["plateau", "coefficient", *names])]
    for plateau, correlations in plateaus:
        for name, row in zip(names, correlations, strict=True):
            lines.append(",".join([str(plateau), name, *correlation_cells(row)]))
    write_text(path, "\n".join(lines) + "\n")


def read_correlations(path: Path) -> dict[int, FloatArray]:
    """Read ``correlations.csv``: (21, 21) by number of plateau, NaN if not observable.

    Raises DocumentError if the file can't be read or is wrong.
    """
    names = [f"{each.name}_{each.axis}" for each in COEFFICIENTS]
    table = CsvTable(read_text(path), str(path), required=["plateau", "coefficient", *names])
    plateaus: dict[int, FloatArray] = {}
    for index in range(len(table)):
        matrix = plateaus.setdefault(table.integer(index, "plateau"), np.full((len(names),) * 2, np.nan))
        row = names.index(table.choice(index, "coefficient", names))
        matrix[row] = [table.number(index, name, may_be_empty=True) for name in names]
    table.raise_problems()
    return plateaus


def read_coefficients_for_fit(coefficients: Path, budget: Path) -> list[PlateauCoefficientRow]:
    """Read coefficients without the uncertainties that plateaus share, for fits over plateaus.

    An error of gravity or latitude is the same at all plateaus. It is excluded if ``budget.csv`` states it;
    errors as of :class:`gyrobench.bench.foundations.csv_tables.RecordTable`.
    """
    variances: dict[tuple[int, str], float] = {}
    for key, source, sigma in _contributions(budget):
        if source not in COMMON_SOURCES:
            variances[key] = variances.get(key, 0.0) + sigma**2
    return [
        replace(row, sigma=math.sqrt(variances.get((row.plateau, row.name), row.sigma**2)))
        for row in COEFFICIENT_TABLE.read(coefficients)
    ]


def read_common_sigmas(budget: Path) -> dict[tuple[int, str], tuple[float, ...]]:
    """Read the uncertainties that plateaus share, by plateau and name, due to each of the COMMON_SOURCES.

    Empty without ``budget.csv``; errors as of :class:`gyrobench.bench.foundations.csv_tables.RecordTable`.
    """
    sigmas: dict[tuple[int, str], dict[str, float]] = {}
    for key, source, sigma in _contributions(budget):
        sigmas.setdefault(key, {})[source] = sigma
    return {key: tuple(each.get(name, 0.0) for name in COMMON_SOURCES) for key, each in sigmas.items()}


def _contributions(budget: Path) -> Iterator[tuple[tuple[int, str], str, float]]:
    """Plateau and name of each coefficient in a budget, source, and standard uncertainty due to it."""
    for each in BUDGET_TABLE.iterate(budget) if budget.exists() else ():
        if each.result == "coefficient" and each.plateau is not None and not each.is_sum:
            key = each.plateau, f"{each.quantity}_{each.axis}"
            yield key, each.contribution, float(np.nan_to_num(each.sigma))
