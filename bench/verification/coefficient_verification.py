"""Verification of all coefficients: the residual of each in new measurements, and the error of a mission."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import zip_longest
from pathlib import Path

import numpy as np
from scipy.stats import chi2, norm

from gyrobench.bench.bias.statistics import lowest_polynomial
from gyrobench.bench.calibration.coefficients import COEFFICIENTS, COUNT
from gyrobench.bench.calibration.mission import HOURS, MissionError, mission_error
from gyrobench.bench.foundations.arrays import FloatArray, rms
from gyrobench.bench.foundations.csv_tables import format_csv, write_text
from gyrobench.bench.foundations.text import format_cell
from gyrobench.bench.navigation.error_model import Site
from gyrobench.bench.runs.tables.coefficient_table import PlateauCoefficientRow
from gyrobench.bench.verification.measured_change import SIGNIFICANT_P
from gyrobench.bench.verification.paired_plateaus import PlateauProperties, pair_plateaus
from gyrobench.drivers.ins.compensation import CORRECTION_DEGREE, Correction

_NAMES = tuple(f"{each.name}_{each.axis}" for each in COEFFICIENTS)
_COLUMNS = ("compensation", "coefficient", "unit", "plateaus", "rms", "noise")
_MISSION_COLUMNS = (
    "compensation", "plateau", "gyro_c", "hours", "position_nmi", "position_median_nmi", "position_95_nmi",
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class PlateauMission:
    """Mission with the coefficients of one plateau."""

    plateau: int  #: Number of the plateau, the same in all runs.
    gyro_c: float  #: Mean temperature of the gyros.
    error: MissionError
    is_in_all: bool  #: Whether all runs have the plateau.


@dataclass(frozen=True)
class NoiseSums:
    """Sums over values v in some units; the covariance of their noise is C."""

    count: int  #: Number of values.
    squares: float  #: v' v.
    variance: float  #: tr C, the mean of v' v for noise alone.
    quadratic: float  #: v' C v; its mean is tr(C C) for noise alone.
    square_variance: float  #: tr(C C).
    loaded: int  #: Number of loaded polynomial coefficients, at most one for each value.

    @classmethod
    def of(cls, values: FloatArray, covariance: FloatArray, units: FloatArray, loaded: int) -> NoiseSums:
        """Sums over values (n,) with their covariance (n, n), in units (n,)."""
        values, covariance = values / units, covariance / np.outer(units, units)
        squares, quadratic = float(values @ values), float(values @ covariance @ values)
        return cls(
            len(values), squares, float(np.trace(covariance)), quadratic, float(np.sum(covariance**2)), loaded
        )


@dataclass(frozen=True, eq=False)
class CoefficientResult:
    """Coefficients measured with one compensation."""

    compensation: str  #: As in a verification.
    #: rms, noise: Shape (21,), in the units of tables. Rms of the values, and of their standard
    #: uncertainties, over the plateaus at which all runs have the coefficient; NaN if not observable.
    rms: FloatArray
    noise: FloatArray
    plateaus: FloatArray  #: Shape (21,). Number of plateaus with a value.
    #: sums, stated_sums: Over all coefficients except gyro biases, at these plateaus; in units of the noise,
    #: and of the stated uncertainties.
    sums: NoiseSums
    stated_sums: NoiseSums
    missions: tuple[PlateauMission, ...]  #: One for each plateau.

    @property
    def ratio(self) -> float:
        """Rms relative to the noise, of all coefficients except gyro biases (which each power-on changes)."""
        return math.sqrt(self.sums.squares / self.sums.count) if self.sums.count else math.nan

    @property
    def noise_p_value(self) -> float:
        """p-value of these coefficients, given the noise of the measurement and that of what was loaded.

        A loaded polynomial with k coefficients adds its own noise: its variances, relative to those of the
        values, sum to k. The sum of squares is approximated by a scaled chi2 with equal mean and variance
        (Satterthwaite).
        """
        sums = self.sums
        if not sums.count:
            return math.nan
        mean = sums.variance + sums.loaded
        variance = 2.0 * sums.square_variance * (1.0 + 3.0 * sums.loaded / sums.count)
        dof = 2.0 * mean**2 / variance
        return float(chi2.sf(sums.squares * dof / mean, dof))

    def is_better_than(self, other: CoefficientResult) -> bool:
        """Whether the rms of these coefficients is smaller than in another run, by more than the noise.

        In units of the stated uncertainties, with the covariance C, a sum of squares about means m has the
        variance 2 tr(C C) + 4 m' C m.
        """
        variance = sum(
            2.0 * each.square_variance + 4.0 * max(each.quadratic - each.square_variance, 0.0)
            for each in (self.stated_sums, other.stated_sums)
        )
        excess, excess_of_other = (
            each.stated_sums.squares - each.stated_sums.variance for each in (self, other)
        )
        difference = excess_of_other - excess
        return bool(variance > 0.0 and norm.sf(difference / math.sqrt(variance)) < SIGNIFICANT_P)

    @property
    def worst(self) -> PlateauMission:
        """The plateau with the largest position error after a day, among those that all runs have."""
        compared = [each for each in self.missions if each.is_in_all]
        return max(compared, key=lambda each: float(each.error.stated_nmi[-1]))


def corrections(rows: Sequence[PlateauCoefficientRow]) -> dict[str, Correction]:
    """Polynomials over temperature of all observable coefficients except gyro biases.

    Each has the lowest degree that fits within the uncertainties. It is a function of the temperature of the
    gyro along its sensor's axis, limited to the temperatures at which it was measured.
    """
    gyro_c = {(row.plateau, row.axis): row.temperature_c for row in rows if row.coefficient == "gyro_bias"}
    by_name = {}
    for name in _NAMES:
        axis = name.rpartition("_")[2][0]
        measured = [row for row in rows if row.name == name and np.isfinite([row.value, row.sigma]).all()]
        measured = [row for row in measured if np.isfinite(gyro_c[row.plateau, axis])]
        if measured and not name.startswith("gyro_bias"):
            temperature_c = np.array([gyro_c[row.plateau, axis] for row in measured])
            values, sigmas = np.array([(row.value, row.sigma) for row in measured]).T
            fitted = lowest_polynomial(
                temperature_c, values, sigmas, min(CORRECTION_DEGREE, len(measured) - 1)
            )
            range_c = float(temperature_c.min()), float(temperature_c.max())
            by_name[name] = Correction(np.asarray(fitted.convert().coef), range_c=range_c)
    return by_name


@dataclass(frozen=True, eq=False)
class CoefficientRun:
    """Coefficients that one run measured."""

    compensation: str  #: As in a verification.
    rows: Sequence[PlateauCoefficientRow]
    #: Shape (21, 21) by plateau; NaN if not observable: missions assume that such a coefficient is exactly
    #: zero.
    correlations: Mapping[int, FloatArray]
    loaded: Mapping[str, Correction] = field(default_factory=dict)  #: Polynomials that the INS subtracts.
    #: By plateau and name: standard uncertainties due to each error that all plateaus share, as that of
    #: gravity; by default none. A loaded polynomial was measured with the same errors, which cancel.
    common: Mapping[tuple[int, str], tuple[float, ...]] = field(default_factory=dict)


def compare_coefficients(runs: Sequence[CoefficientRun], site: Site) -> tuple[CoefficientResult, ...]:
    """Residual coefficients of each run at the plateaus that all runs have; empty if there are none.

    If any plateau has rotations, those without are omitted: a dwell on a ramp may be a plateau by itself,
    which hardly shows some of the coefficients.
    """
    runs = [_renumbered(run, numbers) for run, numbers in zip(runs, _joint_numbers(runs), strict=True)]
    in_all = set.intersection(*({row.plateau for row in run.rows} for run in runs))
    if not in_all:
        return ()
    values = [{(row.name, row.plateau): row for row in run.rows if np.isfinite(row.value)} for run in runs]
    shared = set.intersection(*(set(each) for each in values))
    results = []
    for run, run_values in zip(runs, values, strict=True):
        rows = [row for key, row in run_values.items() if key in shared]
        pairs = [
            np.array([(row.value, row.sigma) for row in rows if row.name == name]).reshape(-1, 2)
            for name in _NAMES
        ]
        results.append(
            CoefficientResult(
                run.compensation,
                np.array([rms(each[:, 0]) for each in pairs]),
                np.array([rms(each[:, 1]) for each in pairs]),
                np.array([len(each) for each in pairs]),
                *_noise_sums(run, [run_values[key] for key in sorted(shared)]),
                tuple(_missions(run, in_all, site)),
            )
        )
    return tuple(results)


def _renumbered(run: CoefficientRun, numbers: Mapping[int, int]) -> CoefficientRun:
    """Run with joint numbers of its plateaus, ``numbers`` by its own; rows of :func:`_with_rotations`."""
    return replace(
        run,
        rows=[replace(row, plateau=numbers[row.plateau]) for row in _with_rotations(run.rows)],
        correlations={numbers[key]: each for key, each in run.correlations.items() if key in numbers},
        common={(numbers[key], name): each for (key, name), each in run.common.items() if key in numbers},
    )


def _noise_sums(run: CoefficientRun, rows: Sequence[PlateauCoefficientRow]) -> tuple[NoiseSums, NoiseSums]:
    """Sums over rows except gyro biases, in units of their noise and of the stated uncertainties."""
    used = [row for row in rows if row.coefficient != "gyro_bias"]
    names, plateaus = [row.name for row in used], np.array([row.plateau for row in used])
    columns = np.array([_NAMES.index(name) for name in names], dtype=np.intp)
    values, stated = np.array([(row.value, row.sigma) for row in used]).reshape(-1, 2).T
    sigmas = [run.common.get((row.plateau, row.name), ()) for row in used]
    by_source = np.array(list(zip_longest(*sigmas, fillvalue=0.0))).reshape(-1, len(used))
    own = np.sqrt(np.maximum(stated**2 - (by_source**2).sum(axis=0), 0.0))
    by_plateau = {each: _filled_correlations(run, each) for each in set(plateaus.tolist())}
    pairs = np.array([by_plateau[row.plateau][_NAMES.index(row.name), columns] for row in used])
    pairs = pairs.reshape(len(used), len(used))
    signs = np.where(columns[:, np.newaxis] == columns, 1.0, np.sign(pairs))
    of_shared = signs * (by_source.T @ by_source)  # errors of different sources are independent
    is_loaded = np.array([name in run.loaded for name in names], dtype=bool)
    is_same_plateau = plateaus[:, np.newaxis] == plateaus
    covariance = np.where(is_same_plateau, pairs * np.outer(stated, stated), of_shared)
    covariance -= np.where(is_loaded[:, np.newaxis] | is_loaded, of_shared, 0.0)
    loaded_count = sum(min(names.count(name), len(each.polynomial)) for name, each in run.loaded.items())
    of_noise, of_stated = (
        NoiseSums.of(values, covariance, units, loaded_count)
        for units in (np.where(is_loaded, own, stated), stated)
    )
    return of_noise, of_stated


def _filled_correlations(run: CoefficientRun, plateau: int) -> FloatArray:
    """Correlations (21, 21) at a plateau; unknown ones are zero."""
    filled = np.nan_to_num(run.correlations.get(plateau, np.eye(COUNT)))
    return np.where(np.eye(COUNT, dtype=bool), 1.0, filled)


def _missions(run: CoefficientRun, in_all: Collection[int], site: Site) -> Iterator[PlateauMission]:
    per_si = np.array([each.per_si for each in COEFFICIENTS])
    for plateau in dict.fromkeys(row.plateau for row in run.rows):
        by_name = {row.name: row for row in run.rows if row.plateau == plateau}
        values, sigmas = (
            np.nan_to_num([getattr(by_name[name], field_name) for name in _NAMES]) / per_si
            for field_name in ("value", "sigma")
        )
        covariance = _filled_correlations(run, plateau) * np.outer(sigmas, sigmas)
        error = mission_error(values, covariance, site)
        yield PlateauMission(plateau, _gyro_c(by_name.values()), error, plateau in in_all)


def _with_rotations(rows: Sequence[PlateauCoefficientRow]) -> Sequence[PlateauCoefficientRow]:
    """Rows of the plateaus with rotations; all rows if no plateau has any."""
    rotated = {row.plateau for row in rows if np.isfinite(row.gyro_rate_c_per_h)}
    return [row for row in rows if row.plateau in rotated] or rows


def _joint_numbers(runs: Sequence[CoefficientRun]) -> list[dict[int, int]]:
    """Number of each plateau in the joint order of all runs, by its number in the run."""
    plateaus = [dict.fromkeys(row.plateau for row in run.rows) for run in runs]
    properties = []
    for run, numbers in zip(runs, plateaus, strict=True):
        by_plateau = [[row for row in run.rows if row.plateau == number] for number in numbers]
        properties.append(
            [PlateauProperties(rows[0].cycle, rows[0].chamber_set_c, _gyro_c(rows)) for rows in by_plateau]
        )
    return [
        dict(zip(numbers, joint_numbers, strict=True))
        for numbers, joint_numbers in zip(plateaus, pair_plateaus(properties), strict=True)
    ]


def _gyro_c(rows: Iterable[PlateauCoefficientRow]) -> float:
    return float(np.mean([row.temperature_c for row in rows if row.coefficient == "gyro_bias"]))


def write_coefficient_tables(folder: Path, results: Sequence[CoefficientResult]) -> None:
    """Write ``coefficient_comparison.csv`` and ``mission.csv``. Raises RunFolderError if that fails."""
    rows: list[list[str | float]] = [
        [each.compensation, name, definition.unit, int(count), float(value), float(noise)]
        for each in results
        for name, definition, count, value, noise in zip(
            _NAMES, COEFFICIENTS, each.plateaus, each.rms, each.noise, strict=True
        )
    ]
    missions: list[list[str | float]] = [
        [each.compensation, mission.plateau, mission.gyro_c, hours, *map(float, sizes)]
        for each in results
        for mission in each.missions
        for hours, *sizes in zip(
            HOURS, mission.error.stated_nmi, mission.error.median_nmi, mission.error.high_nmi, strict=True
        )
    ]
    for name, columns, lines in (
        ("coefficient_comparison.csv", _COLUMNS, rows),
        ("mission.csv", _MISSION_COLUMNS, missions),
    ):
        write_text(
            folder / name, format_csv(columns, [[format_cell(cell) for cell in line] for line in lines])
        )
