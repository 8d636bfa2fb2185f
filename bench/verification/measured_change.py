"""What a loaded compensation changed in the measured biases, against what its numbers say that it subtracts.

A compensation that the INS does not apply, applies with the wrong sign, twice or to another gyro leaves a
change that is not the one loaded, however large the residual is.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby
from operator import itemgetter

import numpy as np
from scipy.stats import f, norm

from gyrobench.bench.bias.dwell_table import DwellRow
from gyrobench.bench.closure.temperature_record import followed_with_play
from gyrobench.bench.foundations.arrays import BoolArray, FloatArray
from gyrobench.bench.navigation.positions import POSITIONS
from gyrobench.drivers.ins.compensation import Compensation

#: Above this standard uncertainty the factor of a gyro says nothing.
_MAX_SIGMA = 0.25
#: What the mean temperatures of a dwell leave open of the subtracted bias, as a share of it.
_EVALUATION = 0.1
#: The play of hysteresis is known if what it may have been at first leaves less open than this, K.
_PLAY_KNOWN_K = 0.1
#: p-value from which a change is one.
SIGNIFICANT_P = 1e-3
#: The same for a change that is not the loaded one.
_CONTRADICTION_P = 1e-5


@dataclass(frozen=True, eq=False)
class MeasuredChange:
    """Change of the varying biases from one run to another with another compensation."""

    #: factors, sigmas: Shape (3,). Measured over loaded change of each gyro, and its standard uncertainty;
    #: NaN where the loaded change hardly exceeds the noise.
    factors: FloatArray
    sigmas: FloatArray
    #: is_applied, is_smaller: Whether the biases changed as loaded, over all gyros, and became smaller by
    #: that, each with p < 0.001.
    is_applied: bool
    is_smaller: bool
    contradicts: BoolArray  #: Shape (3,). Which gyros changed otherwise than loaded.


def subtracted_dph(compensation: Compensation, rows: Sequence[DwellRow]) -> FloatArray:
    """Biases (n, 3) that an INS subtracts in dwells, deg/h, from their mean temperatures.

    NaN where a temperature is missing that a term needs, and where hysteresis still depends on temperatures
    before the first dwell of a power cycle. ``rows``: in the order of time.
    """
    numbers = compensation
    gyro_c = np.array([row.gyro_c for row in rows]).reshape(-1, 3)
    at_c = np.clip(gyro_c, numbers.low_c, numbers.high_c)
    hotter_k = np.array([row.board_c for row in rows]).reshape(-1, 3) - gyro_c
    hotter_k = np.clip(hotter_k, numbers.difference_low_k, numbers.difference_high_k)
    rate = np.array([row.gyro_rate_c_per_h for row in rows]).reshape(-1, 3)
    rate = np.clip(rate, -numbers.rate_limit_c_per_h, numbers.rate_limit_c_per_h)
    up = np.array([POSITIONS[row.position].C_nb()[2] for row in rows]).reshape(-1, 3)
    middle_s = np.array([row.since_power_on_s + 0.5 * (row.end_s - row.start_s) for row in rows])[
        :, np.newaxis
    ]
    total = np.zeros_like(at_c)
    for coefficients in numbers.polynomial_dph.T[::-1]:
        total = total * at_c + coefficients
    cold = (numbers.onset_c - at_c) / np.where(numbers.onset_width_c > 0.0, numbers.onset_width_c, np.inf)
    factor = (
        numbers.gradient_dph_per_k
        + up @ numbers.saturating_dph_per_k.T / (1.0 + np.exp(np.clip(-cold, -500.0, 500.0)))
        + up @ numbers.growing_dph_per_k.T * np.logaddexp(0.0, cold)
    )
    decay = np.exp(-middle_s / np.where(numbers.warm_up_s > 0.0, numbers.warm_up_s, np.inf))
    terms = (
        (numbers.rate_dph_per_c_per_h, rate),
        (factor, hotter_k),
        (numbers.warm_up_dph, decay),
        (numbers.hysteresis_dph_per_k, _play_k([row.run for row in rows], at_c, numbers.half_width_k)),
    )
    for size, driver in terms:
        total = total + np.where(size == 0.0, 0.0, size * driver)
    return np.asarray(total + up @ numbers.gravity_dph_per_g.T)


def _play_k(cycles: Sequence[str], at_c: FloatArray, half_width_k: FloatArray) -> FloatArray:
    """How far the play of hysteresis is from the temperatures of dwells (n, 3), K.

    Between dwells the temperature is taken to change one way. NaN while the play depends on what it was at
    the first dwell of its power cycle.
    """
    found = []
    for _, group in groupby(zip(cycles, at_c, strict=True), key=itemgetter(0)):
        course_c = np.array([each for _, each in group])
        lowest_c, highest_c = (
            followed_with_play(course_c, half_width_k, course_c[0] + side * half_width_k)
            for side in (-1.0, 1.0)
        )
        is_known = highest_c - lowest_c < _PLAY_KNOWN_K
        found.append(np.where(is_known, 0.5 * (lowest_c + highest_c) - course_c, np.nan))
    return np.concatenate(found) if found else np.zeros_like(at_c)


def measured_change(
    before: Sequence[DwellRow],
    after: Sequence[DwellRow],
    loaded: tuple[Compensation | None, Compensation | None],
    *,
    is_limited: bool = True,
) -> MeasuredChange | None:
    """Compare the same dwells of two runs with what was loaded in each; None where nothing is comparable.

    Without limits of temperature in the INS (``is_limited``), dwells beyond them are not compared: what it
    subtracts there is not known.

    Each gyro's means over the dwells that share their power cycles are taken out first, as of the varying
    bias.
    """
    changes = [np.zeros((len(rows), 3)) for rows in (before, after)]
    for place, (rows, compensation) in enumerate(zip((before, after), loaded, strict=True)):
        if compensation is not None:
            changes[place] = subtracted_dph(compensation, rows)
            if not is_limited:
                gyro_c = np.array([row.gyro_c for row in rows]).reshape(-1, 3)
                is_known = (gyro_c >= compensation.low_c) & (gyro_c <= compensation.high_c)
                changes[place] = np.where(is_known, changes[place], np.nan)
    expected = changes[1] - changes[0]
    first, second = (np.array([row.bias_dph for row in rows]).reshape(-1, 3) for rows in (before, after))
    sigmas = [np.array([row.sigma_dph for row in rows]).reshape(-1, 3) for rows in (before, after)]
    known = np.isfinite(first + second + expected).all(axis=1)
    if known.sum() < 2 or not np.any(expected[known]):
        return None
    names = [(one.run, other.run) for one, other in zip(before, after, strict=True)]
    cycles = np.array([names.index(name) for name in names])[known]
    weights = (sigmas[0] ** 2 + sigmas[1] ** 2)[known] ** -1.0
    expected, change, total = (
        without_cycle_means(each[known], weights, cycles, np.ones(len(cycles), dtype=bool))
        for each in (expected, first - second, first + second)
    )
    information = np.sum(weights * expected**2, axis=0)
    fits = [_fit(expected, change[:, gyro], weights[:, gyro], gyro) for gyro in range(3)]
    scatter = np.array([fit.scatter for fit in fits])
    with np.errstate(divide="ignore", invalid="ignore"):
        factors = np.sum(weights * expected * change, axis=0) / information
        errors = scatter * information**-0.5
    is_shown = errors < _MAX_SIGMA
    # Scatter beyond the noise makes both less certain.
    root = scatter.max() * math.sqrt(float(information.sum()))
    is_applied, is_smaller = (
        bool(norm.sf(float(np.sum(weights * expected * each)) / root) < SIGNIFICANT_P)
        for each in (change, total)
    )
    return MeasuredChange(
        factors=np.where(is_shown, factors, np.nan),
        sigmas=np.where(is_shown, errors, np.nan),
        contradicts=is_shown & np.array([fit.contradicts for fit in fits]),
        is_applied=is_applied,
        is_smaller=is_smaller,
    )


@dataclass(frozen=True)
class _Fit:
    """How a gyro's change follows the loaded changes of all gyros."""

    scatter: float  #: What is left, in standard deviations; at least 1.
    contradicts: bool  #: Whether its own loaded change alone does not explain it.


def _fit(expected: FloatArray, change: FloatArray, weights: FloatArray, gyro: int) -> _Fit:
    """F-test of a gyro's own loaded change against any sum of those of all."""
    roots = np.sqrt(weights)
    columns, values = expected * roots[:, np.newaxis], change * roots
    found, _, rank, _ = np.linalg.lstsq(columns, values, rcond=1e-6)
    left = float(np.sum((values - columns @ found) ** 2))
    excess = float(np.sum((values - columns[:, gyro]) ** 2)) - left
    dof = max(len(values) - 1 - int(rank), 1)
    variance = max(left / dof, 1.0)
    size = float(np.sum(columns[:, gyro] ** 2))
    is_unlikely = f.sf(excess / max(int(rank), 1) / variance, max(int(rank), 1), dof) < _CONTRADICTION_P
    return _Fit(math.sqrt(variance), bool(is_unlikely and excess > _EVALUATION**2 * size))


def without_cycle_means(
    values: FloatArray, weights: FloatArray, cycles: np.ndarray, counts: BoolArray
) -> FloatArray:
    """Values (..., n, 3) minus each gyro's weighted mean in its power cycle.

    ``weights``: shape (n, 3). ``cycles``: shape (n,), the power cycle of each dwell. ``counts``: shape (n,),
    which dwells are in the mean; all of a power cycle if none of it are.
    """
    found = values.copy()
    for cycle in set(cycles.tolist()):
        mine = cycles == cycle
        averaged = mine & counts if (mine & counts).any() else mine
        means = (weights[averaged] * values[..., averaged, :]).sum(axis=-2) / weights[averaged].sum(axis=0)
        found[..., mine, :] -= means[..., np.newaxis, :]
    return found
