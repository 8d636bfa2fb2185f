"""Detects an aid, such as a magnetometer or a GNSS compass, that holds the heading of an INS.

An aid of time constant ``1/k`` acts on the heading in two ways:

* The rate of a free heading is the white noise of the gyros. The aid reduces its power at frequencies ``w``
  by ``w^2 / (w^2 + k^2)``. Windows of ten minutes show that up to time constants of about a minute.
* The rate due to the bias of the vertical gyro decays with ``exp(-k t)`` in each window, from its start. A
  slow aid shows itself by that, the more the larger the biases, which it makes wrong.

Rates that are no bias are known: those due to the velocity East and to the tilt since the start of a window.
The tilt at its start differs between the windows by the accelerometer biases.

A random walk about a bias that is estimated from it returns to that by chance, which looks like a slow aid
(Dickey and Fuller, 1979). The data are therefore compared with simulations without an aid, of the same
windows, biases and noise.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gyrobench.bench.bias.noise_estimate import RestMotion
from gyrobench.bench.foundations.arrays import (
    DPH_TO_RADPS,
    STANDARD_GRAVITY,
    FloatArray,
    IntArray,
    block_diagonal,
    integral,
)
from gyrobench.bench.navigation.earth import MEAN_RADIUS, earth_rate_enu
from gyrobench.bench.navigation.error_model import Site

#: Shortest period, s, at which an aid that holds the heading is looked for; number of the longest periods.
_AID_PERIOD_S, _SLOW_MODES = 10.0, 10
#: An aid holds the heading if that increases twice the log-likelihood by this much. If only the comparison
#: with the tilt shows it, the heading must have less than this share of the power at the longest periods.
_MIN_GAIN, _MAX_SHARE = 20.0, 0.04
#: Least rounding of the heading, as a share of the variance of the tilt's steps.
_MIN_ROUNDING = 1e-6
#: Longer windows are used up to this time, in which any aid has acted: the cost grows with its square.
_MAX_WINDOW_S = 1800.0
#: Interval of the headings in which a decay of the rate is sought, s, and their least number in a window.
_BLOCK_S, _MIN_BLOCKS = 20.0, 8
#: Time constants of the aid, s; and squares of the random walk of the heading, relative to their estimate.
_TIME_CONSTANTS_S, _WALK_FACTORS = np.geomspace(20.0, 1500.0, 14), (0.7, 1.0, 1.4)
#: Largest square of the random walk of the heading, relative to that of the tilt.
_MAX_WALK_RATIO = 2.0
#: Least range of the heading in a window, in steps of its output: less is its rounding.
_MIN_STEPS = 2.0
#: Simulations without an aid, and the least excess of the gain of the data over their largest one.
_SIMULATIONS, _MIN_EXCESS = 32, 10.0
#: Prior standard uncertainties of the bias of a vertical gyro and of its difference between windows, rad/s,
#: and of its drift in a dwell, rad/s^2.
_BIAS, _DIFFERENCE, _DRIFT = 0.05 * DPH_TO_RADPS, 0.003 * DPH_TO_RADPS, 0.1 * DPH_TO_RADPS / 3600.0


def held_heading_s(
    dwells: Sequence[Sequence[RestMotion]], step_rad: float, site: Site, accelerometer_mps2: float
) -> float | None:
    """Time constant with which an aid of the INS holds its heading, s; None if the heading is free.

    ``dwells``: windows of each. ``step_rad``: resolution of the attitude. ``accelerometer_mps2``: largest
    accelerometer bias.
    """
    dwells = [[window.beginning(_MAX_WINDOW_S) for window in dwell] for dwell in dwells]
    windows = [window for dwell in dwells for window in dwell]
    if not windows:
        return None
    by_noise = _time_constant_by_noise(windows, step_rad)
    return by_noise or _time_constant_by_decay(dwells, step_rad, site, accelerometer_mps2)


def _time_constant_by_decay(
    dwells: Sequence[Sequence[RestMotion]], step_rad: float, site: Site, accelerometer_mps2: float
) -> float | None:
    """Time constant of an aid by the decay of the rate in each window, s; None if that shows none."""
    long_dwells = [[each for each in dwell if _blocks(each) >= _MIN_BLOCKS] for dwell in dwells]
    long_dwells = [each for each in long_dwells if each]
    if not long_dwells:
        return None
    tilt_rate = earth_rate_enu(site.latitude)[1] * accelerometer_mps2 / STANDARD_GRAVITY
    difference = math.hypot(_DIFFERENCE, tilt_rate)
    headings = [[_seconds(each, each.rotation_enu[:, 2]) for each in dwell] for dwell in long_dwells]
    walk, white = _noise([heading for dwell in headings for heading in dwell])
    tilts = [
        _seconds(each, angle) for dwell in long_dwells for each in dwell for angle in each.rotation_enu.T[:2]
    ]
    motion = max(np.ptp(heading) for dwell in headings for heading in dwell)
    if motion < _MIN_STEPS * step_rad or not 0.0 < walk < _MAX_WALK_RATIO * _noise(tilts)[0]:
        return None  # the heading is too coarse, or vibrates
    rates = (0.0, *1.0 / _TIME_CONSTANTS_S)
    choices = [(factor * walk, rate) for factor in _WALK_FACTORS for rate in rates]
    matrices: dict[tuple[tuple[int, int], ...], list[_Steps]] = {}
    random = np.random.default_rng(0)
    total = np.zeros((len(choices), 1 + _SIMULATIONS))
    for dwell, dwell_headings in zip(long_dwells, headings, strict=True):
        # Times to the second: few dwells have windows of their own.
        begins_s = [round(each.time_s[0] - dwell[0].time_s[0]) for each in dwell]
        windows = tuple(zip(begins_s, map(len, dwell_headings), strict=True))
        if windows not in matrices:
            matrices[windows] = [_Steps.of(windows, rate, walk, white, difference) for walk, rate in choices]
        known = [_known_motion(each, site) for each in dwell]
        known_steps = {rate: _steps(known, rate) for rate in rates}
        free = matrices[windows][_WALK_FACTORS.index(1.0) * len(rates)]
        measured = _steps(dwell_headings)
        simulated = known_steps[0.0][:, np.newaxis] + free.simulate(measured - known_steps[0.0], random)
        data = np.column_stack([measured, simulated])
        total += [
            each.log_likelihood(data - known_steps[rate][:, np.newaxis])
            for each, (_, rate) in zip(matrices[windows], choices, strict=True)
        ]
    free_gain, *held = total.reshape(len(_WALK_FACTORS), -1, 1 + _SIMULATIONS).max(axis=0)
    gains = np.max(held, axis=0) - free_gain
    if gains[0] - max(0.0, gains[1:].max()) < _MIN_EXCESS:
        return None
    return float(_TIME_CONSTANTS_S[np.argmax([each[0] for each in held])])


def _seconds(window: RestMotion, values: FloatArray) -> FloatArray:
    """Values (n,) of a window each second."""
    seconds = np.arange(1.0 + _BLOCK_S * _blocks(window))
    return np.asarray(np.interp(seconds, window.time_s - window.time_s[0], values))


def _blocks(window: RestMotion) -> int:
    return int((window.time_s[-1] - window.time_s[0]) / _BLOCK_S)


def _known_motion(window: RestMotion, site: Site) -> FloatArray:
    """Motion (n,) of a free heading each second due to the velocity East and the tilt, rad."""
    rate = earth_rate_enu(site.latitude)[1] * window.rotation_enu[:, :1]
    rate = rate - math.tan(site.latitude) / MEAN_RADIUS * window.velocity_mps[:, :1]
    return _seconds(window, integral(rate, window.time_s)[:, 0])


def _steps(angles: Sequence[FloatArray], rate: float = 0.0) -> FloatArray:
    """Steps (n,) of angles each second from block to block, as an aid of this rate, 1/s, leaves them."""
    keep, parts = math.exp(-rate * _BLOCK_S), []
    for each in angles:
        steps = np.diff(each[:: round(_BLOCK_S)])
        if rate:
            lags = np.subtract.outer(np.arange(len(steps)), np.arange(len(steps)))
            held = (1.0 - keep) / (rate * _BLOCK_S) * np.tril(keep ** np.abs(lags)) @ steps
            steps = np.diff(held, prepend=0.0)
        parts.append(steps)
    return np.concatenate(parts)


def _noise(angles: Sequence[FloatArray]) -> tuple[float, float]:
    """Squares of the random walk, rad^2/s, and of the output noise, rad^2, of angles each second."""
    lags = 1, round(_BLOCK_S)
    squares = [
        np.mean(
            np.concatenate([each[2 * lag :] - 2.0 * each[lag:-lag] + each[: -2 * lag] for each in angles])
            ** 2
        )
        for lag in lags
    ]
    walk = max(0.0, float(squares[1] - squares[0]) / (2.0 * (lags[1] - lags[0])))
    return walk, max(0.0, float(squares[0]) - 2.0 * walk) / 6.0


@dataclass(frozen=True, eq=False)
class _Steps:
    """Model of the steps of the heading in a dwell."""

    whitening: FloatArray  #: Shape (n, n).
    noise_root: FloatArray  #: Shape (n, n). Root of the covariance of the noise.
    mean: FloatArray  #: Shape (n, n). Best values of biases and drift, as steps, from the data.

    @classmethod
    def of(
        cls, windows: Sequence[tuple[int, int]], rate: float, walk: float, white: float, difference: float
    ) -> _Steps:
        """Make the model.

        ``windows``: second at which each begins, and its number of seconds. ``rate``: of the aid, 1/s; zero
        without one. ``walk``, ``white``: as of :func:`_noise`. ``difference``: of the biases in the windows,
        rad/s.
        """
        noise, responses, drifts = [], [], []
        middle_s = 0.5 * (windows[0][0] + sum(windows[-1]))
        for begin_s, count in windows:
            time_s = np.arange(0.0, count, _BLOCK_S)
            if rate:
                later = np.exp(-rate * np.abs(np.subtract.outer(time_s, time_s)))
                motion = (later - np.exp(-rate * np.add.outer(time_s, time_s))) / (2.0 * rate)
                response = -np.expm1(-rate * time_s) / rate
            else:
                motion, response = np.minimum.outer(time_s, time_s), time_s
            steps = np.diff(np.eye(len(time_s)), axis=0)
            noise.append(steps @ (walk * motion + white * np.eye(len(time_s))) @ steps.T)
            responses.append(np.diff(response)[:, np.newaxis])
            drifts.append(np.diff(0.5 * (begin_s + time_s - middle_s) ** 2))
        by_window, drift = block_diagonal(*responses), np.concatenate(drifts)
        bias = _BIAS**2 + difference**2 * np.eye(len(windows))
        signal = by_window @ bias @ by_window.T + _DRIFT**2 * np.outer(drift, drift)
        covariance = block_diagonal(*noise) + signal
        whitening = np.linalg.inv(np.linalg.cholesky(covariance))
        noise_root = np.asarray(np.linalg.cholesky(block_diagonal(*noise)))
        return cls(np.asarray(whitening), noise_root, signal @ whitening.T @ whitening)

    def log_likelihood(self, steps: FloatArray) -> FloatArray:
        """Twice the log-likelihood (k,) of k series of steps (n, k)."""
        volume = 2.0 * np.log(np.diag(self.whitening)).sum()
        return np.asarray(volume - np.sum((self.whitening @ steps) ** 2, axis=0))

    def simulate(self, steps: FloatArray, random: np.random.Generator) -> FloatArray:
        """Steps (n, k) with other noise and the biases and the drift of these (n,)."""
        noise = self.noise_root @ random.standard_normal((len(steps), _SIMULATIONS))
        return np.asarray((self.mean @ steps)[:, np.newaxis] + noise)


def _time_constant_by_noise(windows: Sequence[RestMotion], step_rad: float) -> float | None:
    """Time constant of an aid by the spectrum of the heading, s; None if that shows none."""
    interval_s = float(np.median(np.concatenate([np.diff(each.time_s) for each in windows])))
    count = min(int((each.time_s[-1] - each.time_s[0]) / interval_s) for each in windows)
    # Without the mode of half a period in the window, in which the Earth rate couples the gyros' biases.
    modes = np.arange(2, min(int(2.0 * count * interval_s / _AID_PERIOD_S), count // 2) + 1)
    if len(modes) < 2 * _SLOW_MODES:
        return None
    power = _power_of_rate(windows, interval_s, count, modes)
    heading, tilt = power[:, 2], power[:, 0] + power[:, 1]
    # Bias steps add to the tilt at the longest periods, output noise at the others.
    white = min(float(each.mean()) for each in np.split(tilt, [_SLOW_MODES])) / (2.0 * len(windows))
    # A coarse output hides the random walk.
    if white == 0.0 or white * count / _SLOW_MODES < step_rad**2:
        return None
    frequencies = np.pi * modes / (count * interval_s)
    # A heading that is held exactly has at least its rounding.
    rounding = max(step_rad**2 / 12.0, _MIN_ROUNDING * white) * len(windows)
    heading = heading + rounding * (2.0 - 2.0 * np.cos(frequencies * interval_s))
    rates = np.concatenate([[0.0], np.geomspace(0.3 / (count * interval_s), 0.5, 24)])
    output_noise = np.multiply.outer(
        np.concatenate([[0.0], np.geomspace(1e-2, 1e4, 24)]), 2.0 - 2.0 * np.cos(frequencies * interval_s)
    )
    reduction = frequencies**2 / (frequencies**2 + rates[:, np.newaxis] ** 2)
    held_spectra = reduction[:, np.newaxis] + output_noise
    free_spectra = np.broadcast_to(1.0 + output_noise, held_spectra.shape)
    dof = np.full(len(modes), float(len(windows)))
    of_heading = _log_likelihood(heading, dof, held_spectra)
    of_both = _log_likelihood(
        np.concatenate([heading, tilt]),
        np.concatenate([dof, 2.0 * dof]),
        np.concatenate([held_spectra, free_spectra], axis=-1),
    )
    heading_gain, gain = (2.0 * (each.max() - each[0].max()) for each in (of_heading, of_both))
    ratio_to_tilt = float(heading[:_SLOW_MODES].mean()) / len(windows) / white
    if gain < _MIN_GAIN or (heading_gain < _MIN_GAIN and ratio_to_tilt > _MAX_SHARE):
        return None
    return 1.0 / float(rates[np.unravel_index(int(of_both.argmax()), of_both.shape)[0]])


def _power_of_rate(
    windows: Sequence[RestMotion], interval_s: float, count: int, modes: IntArray
) -> FloatArray:
    """Sums over the windows of the squared cosine modes (n, 3) of the rotation rate, ENU."""
    cosines = math.sqrt(2.0 / count) * np.cos(
        np.pi / count * np.multiply.outer(modes, np.arange(count) + 0.5)
    )
    even_s = interval_s * np.arange(count + 1)
    power = np.zeros((len(modes), 3))
    for each in windows:
        motion = [np.interp(each.time_s[0] + even_s, each.time_s, angle) for angle in each.rotation_enu.T]
        power += (cosines @ np.diff(motion, axis=1).T) ** 2
    return power


def _log_likelihood(power: FloatArray, dof: FloatArray, shapes: FloatArray) -> FloatArray:
    """Log-likelihood (...) of sums of squares (n,) for spectra (..., n) of unknown scale."""
    scale = (power / shapes).sum(axis=-1, keepdims=True) / dof.sum()
    return np.asarray(-0.5 * (dof * np.log(scale * shapes)).sum(axis=-1))
