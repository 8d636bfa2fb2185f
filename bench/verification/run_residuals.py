"""Residual biases of one run: at each plateau, and as position error of a day of navigation."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.stats import norm, studentized_range

from gyrobench.bench.bias.dwell_table import DwellRow
from gyrobench.bench.bias.plateaus import set_point_c
from gyrobench.bench.bias.statistics import weighted_mean
from gyrobench.bench.dwells.measure_dwell import CheckDwell
from gyrobench.bench.foundations.arrays import FloatArray, rms
from gyrobench.bench.foundations.errors import MeasurementError
from gyrobench.bench.navigation.error_model import Site
from gyrobench.bench.navigation.positions import AXES, POSITIONS
from gyrobench.bench.navigation.rotational_ins import (
    DAY_S,
    NAUTICAL_MILE_M,
    SIX_POSITIONS,
    PositionError,
    bias_by_position,
    rotate_for,
    rotate_for_each,
)


@dataclass(frozen=True, eq=False, kw_only=True)
class VerificationRow:
    """Residual bias with one compensation at one plateau, or at all of them.

    A field with ``noise`` is the value expected from the measurement noise alone; a size that was not
    measured is NaN.
    """

    compensation: str  #: Name, as in the module of the verification.
    #: Number of the plateau, from 1 (column ``stop``), the same in all runs; there is no row for a plateau
    #: that the run lacks. 0 for all plateaus: an rms over the dwells that every run has, and for other sizes
    #: the maximum over the plateaus at which every run has a value.
    plateau: int
    #: cycle, chamber_set_c, gyro_c: Cycle, set point and mean gyro temperature; not set for all plateaus.
    cycle: int | None = None
    chamber_set_c: float | None = None
    gyro_c: float = math.nan
    #: Temperature relative to those fitted: "fitted", "between" or "outside"; empty for all.
    fit: str = ""
    dwells: int  #: Number of biases per gyro, only of dwells that the other runs have too.
    #: bias_rms_dph, bias_noise_dph: Rms over all gyros, including the constant of the power cycle.
    bias_rms_dph: float
    bias_noise_dph: float
    #: Rms of the varying bias: without the mean of each gyro over the dwells that every run has, which
    #: includes the constant.
    varying_rms_dph: float = math.nan
    varying_p_value: float = math.nan  #: p-value of the varying bias over all plateaus; NaN for one plateau.
    #: spread_dph, spread_noise_dph: Largest difference between two positions in the bias of one gyro.
    spread_dph: float = math.nan
    spread_noise_dph: float = math.nan
    #: velocity_east_mps, velocity_noise_mps: Largest absolute error of the velocity East in navigations
    #: directly after an alignment.
    velocity_east_mps: float = math.nan
    velocity_noise_mps: float = math.nan
    #: position_nmi, position_noise_nmi: Largest position error of a rotational INS with these biases within a
    #: day; NaN without all six positions.
    position_nmi: float = math.nan
    position_noise_nmi: float = math.nan
    #: Rms standard uncertainty of the varying bias due to the compensation; NaN without one.
    compensation_sigma_dph: float = math.nan
    #: p-value of the varying bias, given the noise and that uncertainty, over all plateaus; NaN for one
    #: plateau.
    agreement_p_value: float = math.nan
    #: members, day: Numbers of the dwells, and errors of a day (None unless all six positions were measured);
    #: no columns of the table.
    members: tuple[int, ...] = ()
    day: DayOfNavigation | None = None


AnyDwell = DwellRow | CheckDwell


def check_plateau(
    plateau: Sequence[AnyDwell], compared: Collection[int], site: Site, compensation: str, number: int
) -> VerificationRow:
    """Evaluate one plateau, by its ``number``, from the dwells ``compared``, which other runs have too.

    The day of navigation uses all dwells, since it needs six positions.
    """
    measured = bias_rows(plateau)
    gyro_c = [each.gyro_c for each in measured or plateau]
    all_six = {row.position for row in measured} == POSITIONS.keys()
    rows = [each for each in measured if each.dwell in compared]
    check_dwells = [each for each in plateau if isinstance(each, CheckDwell) and each.dwell in compared]
    biases, sigmas = ([getattr(row, name) for row in rows] for name in ("bias_dph", "sigma_dph"))
    day = day_of_navigation(measured, site) if all_six else None
    return VerificationRow(
        compensation=compensation,
        plateau=number,
        cycle=plateau[0].cycle,
        chamber_set_c=set_point_c(plateau[0].chamber_set_c),
        gyro_c=float(np.mean(gyro_c)),
        dwells=len(rows),
        bias_rms_dph=rms(biases),
        bias_noise_dph=rms(sigmas),
        spread_dph=_spread(rows),
        spread_noise_dph=_spread_noise(rows),
        velocity_east_mps=max(map(_largest_velocity_east, check_dwells), default=math.nan),
        velocity_noise_mps=_velocity_noise(check_dwells, site),
        position_nmi=day.error.max_nmi if day else math.nan,
        position_noise_nmi=day.noise_nmi if day else math.nan,
        members=tuple(row.dwell for row in rows),
        day=day,
    )


def bias_rows(plateau: Iterable[AnyDwell]) -> list[DwellRow]:
    """Dwells that measure biases."""
    return [each for each in plateau if isinstance(each, DwellRow)]


def _velocity_noise(check_dwells: Sequence[CheckDwell], site: Site) -> float:
    """Median of the largest of several velocities that consist of noise only."""
    sigmas = [_velocity_sigma(each, site) for each in check_dwells]
    if not sigmas:
        return math.nan
    return float(np.sqrt(np.mean(np.square(sigmas))) * norm.ppf(0.5 + 0.5 ** (1.0 + 1.0 / len(sigmas))))


def _velocity_sigma(each: CheckDwell, site: Site) -> float:
    """Standard deviation of the final velocity due to the noise of alignment and navigation."""
    if each.navigation is None:
        return math.nan
    noise, time_s = each.navigation.noise, each.navigation.dwell.windows[-1].time_s
    final_weights = np.zeros(len(time_s))
    final_weights[-1] = 1.0
    levelling_mps = noise.velocity_random_walk / math.sqrt(each.marks.align_s) * float(np.ptp(time_s))
    walk_variance = float(noise.velocity_variance(time_s, final_weights, site.gravity))
    return math.hypot(levelling_mps, math.sqrt(walk_variance))


def _spread(rows: Sequence[DwellRow]) -> float:
    if len({row.position for row in rows}) < 2:
        return math.nan
    means = [
        np.mean([row.bias_dph for row in rows if row.position == name], axis=0)
        for name in {row.position for row in rows}
    ]
    return float(np.ptp(np.reshape(means, (-1, len(AXES))), axis=0).max())


def _spread_noise(rows: Sequence[DwellRow]) -> float:
    """Median of the largest of three ranges, if only noise differs between the positions."""
    counts = Counter(row.position for row in rows)
    if len(counts) < 2:
        return math.nan
    sigma_dph = rms([[sigma / math.sqrt(counts[row.position]) for sigma in row.sigma_dph] for row in rows])
    return sigma_dph * _median_largest_range(len(counts))


@lru_cache(maxsize=len(POSITIONS))
def _median_largest_range(count: int) -> float:
    """Median of the largest of three ranges of normal numbers, in standard deviations."""
    return float(studentized_range.ppf(0.5 ** (1.0 / len(AXES)), count, math.inf))


def _largest_velocity_east(each: CheckDwell) -> float:
    if each.navigation is None:
        return math.nan
    return max(float(np.abs(window.velocity_enu_mps[:, 0]).max()) for window in each.navigation.dwell.windows)


_UNIT_BIAS_DPH = 0.001


@dataclass(frozen=True, eq=False)
class DayOfNavigation:
    """Errors of a day of navigation, and the error expected from the uncertainty of the biases."""

    #: Error with the measured biases; the part that is equal in all positions averages out.
    error: PositionError
    #: Largest rms distance expected from the uncertainties of the biases alone.
    noise_nmi: float


def day_of_navigation(rows: Iterable[DwellRow], site: Site) -> DayOfNavigation:
    """Propagate the biases of one temperature through a day of rotation over the six positions.

    ``rows``: in all six positions; several in one position are averaged, those with flags are omitted. Raises
    MeasurementError if a position was not measured.
    """
    usable = [row for row in rows if not row.flags]
    missing = POSITIONS.keys() - {row.position for row in usable}
    if missing:
        raise MeasurementError(
            f"a day of navigation needs all six positions; no bias in {', '.join(sorted(missing))}"
        )
    means = {name: _mean([row for row in usable if row.position == name]) for name in POSITIONS}
    error = rotate_for(
        DAY_S, SIX_POSITIONS, bias_by_position({name: mean for name, (mean, _) in means.items()}), site
    )
    sigmas = np.array([means[name][1] for name in POSITIONS]).ravel()
    distances_m = np.hypot(*np.einsum("k,kct->ct", sigmas**2, _displacement_responses(site) ** 2) ** 0.5)
    return DayOfNavigation(error, float(distances_m.max()) / NAUTICAL_MILE_M)


def _mean(rows: list[DwellRow]) -> tuple[FloatArray, FloatArray]:
    """Bias of each gyro in one position and its standard uncertainty, deg/h."""
    means = [
        weighted_mean([row.bias_dph[axis] for row in rows], [row.sigma_dph[axis] for row in rows])
        for axis in range(len(AXES))
    ]
    return np.array([mean.value for mean in means]), np.array([mean.sigma for mean in means])


@lru_cache(maxsize=4)
def _displacement_responses(site: Site) -> FloatArray:
    """Displacement East and North, m per deg/h, for the bias of each gyro in each position: (18, 2, n)."""
    zero_bias = dict.fromkeys(POSITIONS, np.zeros(3))
    single_biases = [zero_bias | {name: unit} for name in POSITIONS for unit in _UNIT_BIAS_DPH * np.eye(3)]
    error = rotate_for_each(DAY_S, SIX_POSITIONS, single_biases, site)
    return np.stack([error.east_m.T, error.north_m.T], axis=1) / _UNIT_BIAS_DPH
