"""Verification of all coefficients: what is left of each in new measurements, and in a mission."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.stats import norm

from gyrobench.bench.bias.statistics import lowest_polynomial
from gyrobench.bench.calibration.coefficients import COEFFICIENTS, COUNT
from gyrobench.bench.calibration.mission import HOURS, MissionError, mission_error
from gyrobench.bench.foundations.arrays import FloatArray, rms
from gyrobench.bench.foundations.csv_tables import format_csv, write_text
from gyrobench.bench.foundations.text import format_cell
from gyrobench.bench.navigation.error_model import Site
from gyrobench.bench.runs.tables.coefficient_table import PlateauCoefficientRow
from gyrobench.bench.verification.measured_change import SIGNIFICANT_P
from gyrobench.bench.verification.paired_plateaus import PlateauPlace, pair_places
from gyrobench.drivers.ins.compensation import CORRECTION_DEGREE, Correction

_NAMES = tuple(f"{each.name}_{each.axis}" for each in COEFFICIENTS)
_COLUMNS = ("compensation", "coefficient", "unit", "plateaus", "rms", "noise")
_MISSION_COLUMNS = (
    "compensation", "plateau", "gyro_c", "hours", "position_nmi", "position_median_nmi", "position_95_nmi",
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class PlateauMission:
    """Mission with the coefficients of one plateau."""

    plateau: int  #: Its number, the same in all runs.
    gyro_c: float  #: Mean temperature of the gyros.
    error: MissionError
    is_in_all: bool  #: Whether all runs have the plateau.


@dataclass(frozen=True, eq=False)
class CoefficientResult:
    """Coefficients measured with one compensation."""

    compensation: str  #: As in a verification.
    #: rms, noise: Shape (21,), in the units of tables: of the values over the plateaus, and of their standard
    #: uncertainties, at the plateaus at which all runs have the coefficient; NaN where not observable.
    rms: FloatArray
    noise: FloatArray
    plateaus: FloatArray  #: Shape (21,). Number of plateaus with a value.
    missions: tuple[PlateauMission, ...]  #: One for each plateau.

    @property
    def ratio(self) -> float:
        """Rms of all coefficients but the gyros' biases, which each power-on changes, over their noise."""
        others = [place for place, name in enumerate(_NAMES) if not name.startswith("gyro_bias")]
        ratios = (self.rms / self.noise)[others]
        return rms(ratios[np.isfinite(ratios)])

    def is_better_than(self, other: CoefficientResult) -> bool:
        """Whether the rms of these coefficients is smaller than in another run, by more than the noise.

        Over the noise, each sum of squares has a noncentral chi2 distribution.
        """
        values = self._others_and_noise(other)
        sums = np.array([np.sum(counts * ratios**2) for counts, ratios in values])
        number = float(np.sum(values[0][0]))
        sigma = math.sqrt(float(np.sum(2.0 * number + 4.0 * np.maximum(sums - number, 0.0))))
        return bool(sigma > 0.0 and norm.sf((sums[1] - sums[0]) / sigma) < SIGNIFICANT_P)

    def _others_and_noise(self, other: CoefficientResult) -> list[tuple[FloatArray, FloatArray]]:
        """Numbers of values and ratios to the noise in both runs, of all but the gyros' biases."""
        both = [(each.plateaus, each.rms / each.noise) for each in (self, other)]
        known = np.isfinite(both[0][1] + both[1][1])
        known &= [not name.startswith("gyro_bias") for name in _NAMES]
        return [(counts[known], ratios[known]) for counts, ratios in both]

    @property
    def worst(self) -> PlateauMission:
        """The plateau with the largest position error after a day, of those that all runs have."""
        compared = [each for each in self.missions if each.is_in_all]
        return max(compared, key=lambda each: float(each.error.stated_nmi[-1]))


def corrections(rows: Iterable[PlateauCoefficientRow]) -> dict[str, Correction]:
    """Polynomials of all coefficients but the gyros' biases over the temperatures of plateaus.

    Each has the lowest degree that leaves its uncertainties, and takes the temperature of the gyro along its
    sensor's axis, within the temperatures at which it was measured. What is not observable has none.
    """
    gyro_c = {(row.plateau, row.axis): row.temperature_c for row in rows if row.coefficient == "gyro_bias"}
    found = {}
    for name, mine in _by_name(rows).items():
        axis = name.rpartition("_")[2][0]
        known = [row for row in mine if np.isfinite([row.value, row.sigma]).all()]
        known = [row for row in known if np.isfinite(gyro_c[row.plateau, axis])]
        if known and not name.startswith("gyro_bias"):
            at_c = np.array([gyro_c[row.plateau, axis] for row in known])
            values, sigmas = np.array([(row.value, row.sigma) for row in known]).T
            fitted = lowest_polynomial(at_c, values, sigmas, min(CORRECTION_DEGREE, len(known) - 1))
            range_c = float(at_c.min()), float(at_c.max())
            found[name] = Correction(np.asarray(fitted.convert().coef), range_c=range_c)
    return found


@dataclass(frozen=True, eq=False)
class CoefficientRun:
    """Coefficients that one run measured."""

    compensation: str  #: As in a verification.
    rows: Sequence[PlateauCoefficientRow]
    #: Shape (21, 21) by plateau, NaN where not observable: such a coefficient counts as zero and known in the
    #: missions.
    correlations: Mapping[int, FloatArray]


def compare_coefficients(runs: Sequence[CoefficientRun], site: Site) -> tuple[CoefficientResult, ...]:
    """What is left of the coefficients in each run, at the plateaus that all runs have; empty without any.

    Where plateaus have rotations, those without do not count: on a ramp a dwell may be one by itself, which
    hardly shows some of the coefficients.
    """
    numbers = _joint_numbers(runs)
    tables = [
        [replace(row, plateau=of[row.plateau]) for row in _with_rotations(run.rows)]
        for run, of in zip(runs, numbers, strict=True)
    ]
    in_all = set.intersection(*({row.plateau for row in rows} for rows in tables))
    if not in_all:
        return ()
    values = [
        {(f"{row.coefficient}_{row.axis}", row.plateau): row for row in rows if np.isfinite(row.value)}
        for rows in tables
    ]
    shared = set.intersection(*(set(each) for each in values))
    results = []
    for run, of, rows, mine in zip(runs, numbers, tables, values, strict=True):
        pairs = [
            np.array(
                [(row.value, row.sigma) for key, row in mine.items() if key[0] == name and key in shared]
            ).reshape(-1, 2)
            for name in _NAMES
        ]
        correlations = {of[plateau]: each for plateau, each in run.correlations.items() if plateau in of}
        results.append(
            CoefficientResult(
                run.compensation,
                np.array([rms(each[:, 0]) for each in pairs]),
                np.array([rms(each[:, 1]) for each in pairs]),
                np.array([len(each) for each in pairs]),
                tuple(_missions(rows, correlations, in_all, site)),
            )
        )
    return tuple(results)


def _missions(
    rows: Sequence[PlateauCoefficientRow],
    correlations: Mapping[int, FloatArray],
    in_all: Collection[int],
    site: Site,
) -> Iterator[PlateauMission]:
    per_si = np.array([each.per_si for each in COEFFICIENTS])
    for plateau in dict.fromkeys(row.plateau for row in rows):
        mine = {f"{row.coefficient}_{row.axis}": row for row in rows if row.plateau == plateau}
        values, sigmas = (
            np.nan_to_num([getattr(mine[name], which) for name in _NAMES]) / per_si
            for which in ("value", "sigma")
        )
        shared = np.where(
            np.eye(COUNT, dtype=bool), 1.0, np.nan_to_num(correlations.get(plateau, np.eye(COUNT)))
        )
        error = mission_error(values, shared * np.outer(sigmas, sigmas), site)
        yield PlateauMission(plateau, _gyro_c(mine.values()), error, plateau in in_all)


def _with_rotations(rows: Sequence[PlateauCoefficientRow]) -> Sequence[PlateauCoefficientRow]:
    """Rows of the plateaus with rotations; all rows if no plateau has any."""
    turned = {row.plateau for row in rows if np.isfinite(row.gyro_rate_c_per_h)}
    return [row for row in rows if row.plateau in turned] or rows


def _joint_numbers(runs: Iterable[CoefficientRun]) -> list[dict[int, int]]:
    """Number of each plateau that is the same in all runs, by its number in the run."""
    by_plateau: list[dict[int, list[PlateauCoefficientRow]]] = []
    for run in runs:
        mine: dict[int, list[PlateauCoefficientRow]] = {}
        for row in run.rows:
            mine.setdefault(row.plateau, []).append(row)
        by_plateau.append(mine)
    places = [
        [PlateauPlace(rows[0].cycle, rows[0].chamber_set_c, _gyro_c(rows)) for rows in mine.values()]
        for mine in by_plateau
    ]
    return [
        dict(zip(mine, numbers, strict=True))
        for mine, numbers in zip(by_plateau, pair_places(places), strict=True)
    ]


def _gyro_c(rows: Iterable[PlateauCoefficientRow]) -> float:
    return float(np.mean([row.temperature_c for row in rows if row.coefficient == "gyro_bias"]))


def _by_name(rows: Iterable[PlateauCoefficientRow]) -> dict[str, list[PlateauCoefficientRow]]:
    found: dict[str, list[PlateauCoefficientRow]] = {name: [] for name in _NAMES}
    for row in rows:
        if (name := f"{row.coefficient}_{row.axis}") in found:
            found[name].append(row)
    return found


def write_coefficient_tables(folder: Path, results: Sequence[CoefficientResult]) -> None:
    """Write ``coefficient_comparison.csv`` and ``mission.csv``; raises RunFolderError if that fails."""
    rows: list[list[str | float]] = [
        [each.compensation, name, known.unit, int(count), float(value), float(noise)]
        for each in results
        for name, known, count, value, noise in zip(
            _NAMES, COEFFICIENTS, each.plateaus, each.rms, each.noise, strict=True
        )
    ]
    missions: list[list[str | float]] = [
        [each.compensation, one.plateau, one.gyro_c, hours, *map(float, sizes)]
        for each in results
        for one in each.missions
        for hours, *sizes in zip(
            HOURS, one.error.stated_nmi, one.error.median_nmi, one.error.high_nmi, strict=True
        )
    ]
    for name, columns, lines in (
        ("coefficient_comparison.csv", _COLUMNS, rows),
        ("mission.csv", _MISSION_COLUMNS, missions),
    ):
        write_text(
            folder / name, format_csv(columns, [[format_cell(cell) for cell in line] for line in lines])
        )
