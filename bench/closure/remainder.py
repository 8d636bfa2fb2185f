"""Anything that is on no list of effects: Gaussian processes on what the bias may physically depend on.

Each process is a sum of smooth functions of one driver (or of a product of drivers) with independent
normal coefficients, small for functions that vary fast: the Hilbert-space form of a Gaussian process
(Solin and Saerkkae, 2020). Few columns span it, so that its evidence is cheap.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from gyrobench.bench.closure.campaign import Campaign
from gyrobench.bench.closure.problem import Problem
from gyrobench.bench.foundations.arrays import FloatArray

#: Largest number of columns of a process, and of functions of time.
RANK = 48
_ORDERS = 30
#: Name of the sum of all processes.
TOGETHER = "several of these together"
_MIN_POWER = 1e-6
#: The set point moves, and the temperature has changed, from this on.
_MIN_SLOPE_C, _MIN_CHANGE_C = 1e-4, 1.0


@dataclass(frozen=True)
class Remainder:
    """K processes of a problem, in units of the noise and beside the declared model, each of rms 1."""

    names: tuple[str, ...]  #: What each process follows.
    directions: FloatArray  #: Shape (3, K, m, RANK). Orthonormal for each gyro and process.
    powers: FloatArray  #: Shape (3, K, RANK). Variance along each direction; zero for unused ones.


def remainder_of(problem: Problem) -> Remainder:
    """The processes that the dwells searched can show."""
    seen = problem.campaign.part(problem.searched)
    processes = {name: found for name, make in _PROCESSES.items() if (found := make(seen)) is not None}
    names: list[str] = []
    directions = np.zeros((3, len(processes) + 1, len(seen), RANK))
    powers = np.zeros((3, len(processes) + 1, RANK))
    for name, columns in processes.items():
        visible, rms = problem.beside(columns)
        visible /= np.sqrt(np.sum(rms**2, axis=1))[:, np.newaxis, np.newaxis]
        index = len(names)
        for gyro in range(3):
            left, lengths, _ = np.linalg.svd(visible[gyro], full_matrices=False)
            rank = int(np.sum(lengths[:RANK] ** 2 > _MIN_POWER))
            directions[gyro, index, :, :rank] = left[:, :rank]
            powers[gyro, index, :rank] = lengths[:rank] ** 2
        if powers[:, index].any():  # not without any visible column, as of a constant temperature
            names.append(name)
    directions, powers = directions[:, : len(names) + 1], powers[:, : len(names) + 1]
    scaled = np.concatenate(np.moveaxis(directions * np.sqrt(powers[:, :, np.newaxis]), 1, 0), axis=2)
    lengths, left = np.linalg.eigh(scaled @ np.swapaxes(scaled, 1, 2) / len(names))
    rank = min(RANK, len(seen))
    directions[:, -1, :, :rank] = left[:, :, : -rank - 1 : -1]
    powers[:, -1, :rank] = np.maximum(lengths[:, : -rank - 1 : -1], 0.0)
    return Remainder((*names, TOGETHER), directions, powers)


def _waves(values: FloatArray, count: int, length: float) -> FloatArray:
    """Cosines over the range of values, weighted for a length scale (share of the range): (..., count)."""
    low, high = float(np.min(values)), float(np.max(values))
    order = np.arange(1, count + 1)
    place = (values - low) / max(high - low, 1e-9)
    return np.asarray(np.cos(np.pi * order * place[..., np.newaxis]) / (1.0 + (order * length) ** 2))


def _with_constant(waves: FloatArray) -> FloatArray:
    return np.concatenate([np.ones_like(waves[..., :1]), waves], axis=-1)


def _products(first: FloatArray, second: FloatArray) -> FloatArray:
    """All products of the columns of two sets (n, 3, k) and (n, 3, l): (n, 3, k l)."""
    product = first[..., :, np.newaxis] * second[..., np.newaxis, :]
    return product.reshape(*product.shape[:-2], -1)


def _each_gyro(columns: FloatArray) -> FloatArray:
    return np.repeat(columns[:, np.newaxis, :], 3, axis=1)


def _hours(campaign: Campaign, count: int, length: float) -> FloatArray:
    return _each_gyro(_waves(campaign.middle_s, count, length))


def _power_law(campaign: Campaign, exponent: float) -> FloatArray:
    """Noise of the bias whose power falls as a power of frequency: flicker 1, random walk 2."""
    place = (campaign.middle_s - campaign.middle_s.min()) / max(float(np.ptp(campaign.middle_s)), 1e-9)
    order = np.arange(1, _ORDERS + 1)
    return _each_gyro(np.cos(np.pi * order * place[:, np.newaxis]) / order ** (0.5 * exponent))


def _attitude(campaign: Campaign) -> FloatArray | None:
    up = _each_gyro(campaign.up_body)
    return np.concatenate([up, np.abs(up)], axis=2) if len(set(campaign.position)) > 1 else None


def _rates(campaign: Campaign) -> FloatArray:
    rate = campaign.rate_c_per_h[..., np.newaxis]
    scaled = rate / max(float(np.sqrt(np.mean(rate**2))), 1e-9)
    return np.concatenate([scaled, np.abs(scaled), _waves(campaign.rate_c_per_h, 4, 0.5)], axis=2)


def _temperatures(campaign: Campaign, count: int, length: float) -> FloatArray:
    return _waves(campaign.gyro_c, count, length)


def _by_attitude(by: Callable[[Campaign], FloatArray]) -> Callable[[Campaign], FloatArray | None]:
    def columns(campaign: Campaign) -> FloatArray | None:
        attitude = _attitude(campaign)
        return None if attitude is None else _products(attitude, by(campaign))

    return columns


def _flow(campaign: Campaign) -> FloatArray | None:
    above_c = campaign.above_optics_c
    return None if above_c is None else _waves(above_c, 8, 0.3)


def _chamber(campaign: Campaign) -> FloatArray | None:
    outside_c = campaign.air_c if np.isfinite(campaign.air_c).all() else campaign.set_c
    if not np.isfinite(outside_c).all():
        return None
    return np.concatenate(
        [_each_gyro(_waves(outside_c, 8, 0.3)), _waves(outside_c[:, np.newaxis] - campaign.gyro_c, 6, 0.5)],
        axis=2,
    )


def _machinery(campaign: Campaign) -> FloatArray | None:
    """Shares of each dwell with a falling, rising and constant set point, at any temperature."""
    if not np.isfinite(campaign.set_c).all():
        return None
    path_c = campaign.set_point_path_c
    slopes_c = np.diff(path_c, axis=1)
    moves = [slopes_c < -_MIN_SLOPE_C, slopes_c > _MIN_SLOPE_C, np.abs(slopes_c) <= _MIN_SLOPE_C]
    shares = np.stack([np.mean(each, axis=1) for each in moves], axis=1)
    waves = _with_constant(_waves(path_c.mean(axis=1), 8, 0.2))
    return _products(_each_gyro(shares), _each_gyro(waves))


def _branch(campaign: Campaign) -> FloatArray:
    """Temperature on the way up and on the way down: the sign of its last change."""
    branch = np.zeros_like(campaign.gyro_c)
    turn_c = campaign.gyro_c[0].copy()
    for index, now_c in enumerate(campaign.gyro_c):
        is_moving = np.abs(now_c - turn_c) > _MIN_CHANGE_C
        branch[index] = np.where(is_moving, np.sign(now_c - turn_c), branch[max(index - 1, 0)])
        turn_c = np.where(is_moving, now_c, turn_c)
    return _products(branch[..., np.newaxis], _with_constant(_temperatures(campaign, 8, 0.2)))


_PROCESSES: dict[str, Callable[[Campaign], FloatArray | None]] = {
    "time": lambda campaign: _hours(campaign, 16, 0.5),
    "time irregularly": lambda campaign: _hours(campaign, _ORDERS, 0.1),
    "time as a random walk": lambda campaign: _power_law(campaign, 2.0),
    "time as flicker noise": lambda campaign: _power_law(campaign, 1.0),
    "time since power-on": lambda campaign: _each_gyro(
        _waves(np.log(campaign.since_power_on_s + 900.0), 10, 0.5)
    ),
    "temperature": lambda campaign: _temperatures(campaign, 24, 0.1),
    "temperature rate": lambda campaign: _products(
        _rates(campaign), _with_constant(_temperatures(campaign, 3, 0.5))
    ),
    "attitude": _by_attitude(lambda campaign: _with_constant(_temperatures(campaign, 4, 0.5))),
    "attitude and time": _by_attitude(lambda campaign: _with_constant(_hours(campaign, 4, 0.5))),
    "attitude and temperature rate": _by_attitude(_rates),
    "electronics above optics": _flow,
    "chamber temperature": _chamber,
    "state of the chamber": _machinery,
    "direction of the temperature": _branch,
}
