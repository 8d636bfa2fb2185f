"""Unlisted effects: Gaussian processes of the quantities on which the bias may physically depend.

Each process is a sum of smooth functions of one driver (or of a product of drivers) with independent
normal coefficients, smaller for functions that vary faster: the Hilbert-space approximation of a Gaussian
process (Solin and Saerkkae, 2020). Few columns span it, which makes its evidence cheap to compute.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from gyrobench.bench.closure.campaign import Campaign
from gyrobench.bench.closure.effects.effect import same_for_all_gyros
from gyrobench.bench.closure.problem import Problem
from gyrobench.bench.foundations.arrays import FloatArray

#: Largest number of columns of a process, and of functions of time.
RANK = 48
_ORDERS = 30
#: Name of the sum of all processes.
ALL_PROCESSES = "several of these together"
_MIN_POWER = 1e-6
#: Smallest slope of a set point that moves; smallest change of temperature that counts.
_MIN_SLOPE_C, _MIN_CHANGE_C = 1e-4, 1.0


@dataclass(frozen=True)
class Remainder:
    """K processes, in units of the noise, with the declared model projected out; each of rms 1."""

    names: tuple[str, ...]  #: Driver of each process.
    directions: FloatArray  #: Shape (3, K, m, RANK). Orthonormal for each gyro and process.
    #: Shape (3, K, RANK). Variance along each direction, zero for unused ones, over
    #: :attr:`Problem.correlation_factor`.
    powers: FloatArray


def remainder_of(problem: Problem) -> Remainder:
    """Processes that are observable in the dwells searched."""
    campaign = problem.campaign.part(problem.searched)
    processes = {name: terms for name, make in _PROCESSES.items() if (terms := make(campaign)) is not None}
    names: list[str] = []
    directions = np.zeros((3, len(processes) + 1, len(campaign), RANK))
    powers = np.zeros((3, len(processes) + 1, RANK))
    for name, columns in processes.items():
        visible, rms = problem.project_out(columns)
        visible /= np.sqrt(np.sum(rms**2, axis=1))[:, np.newaxis, np.newaxis]
        index = len(names)
        for gyro in range(3):
            vectors, lengths, _ = np.linalg.svd(visible[gyro], full_matrices=False)
            rank = int(np.sum(lengths[:RANK] ** 2 > _MIN_POWER))
            directions[gyro, index, :, :rank] = vectors[:, :rank]
            powers[gyro, index, :rank] = lengths[:rank] ** 2
        if powers[:, index].any():  # skips a process without observable columns, as of a constant temperature
            names.append(name)
    directions, powers = directions[:, : len(names) + 1], powers[:, : len(names) + 1]
    scaled = np.concatenate(np.moveaxis(directions * np.sqrt(powers[:, :, np.newaxis]), 1, 0), axis=2)
    lengths, vectors = np.linalg.eigh(scaled @ np.swapaxes(scaled, 1, 2) / len(names))
    rank = min(RANK, len(campaign))
    directions[:, -1, :, :rank] = vectors[:, :, : -rank - 1 : -1]
    powers[:, -1, :rank] = np.maximum(lengths[:, : -rank - 1 : -1], 0.0)
    return Remainder((*names, ALL_PROCESSES), directions, powers / problem.correlation_factor)


def _cosines(values: FloatArray, count: int, length: float) -> FloatArray:
    """Cosines (..., count) over the range of values, weighted for a length scale (share of the range)."""
    low, high = float(np.min(values)), float(np.max(values))
    order = np.arange(1, count + 1)
    fraction = (values - low) / max(high - low, 1e-9)
    return np.asarray(np.cos(np.pi * order * fraction[..., np.newaxis]) / (1.0 + (order * length) ** 2))


def _add_constant(waves: FloatArray) -> FloatArray:
    return np.concatenate([np.ones_like(waves[..., :1]), waves], axis=-1)


def _products(first: FloatArray, second: FloatArray) -> FloatArray:
    """Products (n, 3, k l) of all columns of two sets, (n, 3, k) and (n, 3, l)."""
    product = first[..., :, np.newaxis] * second[..., np.newaxis, :]
    return product.reshape(*product.shape[:-2], -1)


def _time(campaign: Campaign, count: int, length: float) -> FloatArray:
    return same_for_all_gyros(_cosines(campaign.middle_s, count, length))


def _power_law(campaign: Campaign, exponent: float) -> FloatArray:
    """Bias noise whose spectrum falls as a power of frequency: 1 for flicker, 2 for random walk."""
    fraction = (campaign.middle_s - campaign.middle_s.min()) / max(float(np.ptp(campaign.middle_s)), 1e-9)
    order = np.arange(1, _ORDERS + 1)
    return same_for_all_gyros(np.cos(np.pi * order * fraction[:, np.newaxis]) / order ** (0.5 * exponent))


def _attitude(campaign: Campaign) -> FloatArray | None:
    up = same_for_all_gyros(campaign.up_body)
    return np.concatenate([up, np.abs(up)], axis=2) if len(set(campaign.position)) > 1 else None


def _temperature_rate(campaign: Campaign) -> FloatArray:
    rate = campaign.rate_c_per_h[..., np.newaxis]
    scaled = rate / max(float(np.sqrt(np.mean(rate**2))), 1e-9)
    return np.concatenate([scaled, np.abs(scaled), _cosines(campaign.rate_c_per_h, 4, 0.5)], axis=2)


def _temperatures(campaign: Campaign, count: int, length: float) -> FloatArray:
    return _cosines(campaign.gyro_c, count, length)


def _by_attitude(driver: Callable[[Campaign], FloatArray]) -> Callable[[Campaign], FloatArray | None]:
    def columns(campaign: Campaign) -> FloatArray | None:
        attitude = _attitude(campaign)
        return None if attitude is None else _products(attitude, driver(campaign))

    return columns


def _electronics_above_optics(campaign: Campaign) -> FloatArray | None:
    above_c = campaign.above_optics_c
    return None if above_c is None else _cosines(above_c, 8, 0.3)


def _chamber(campaign: Campaign) -> FloatArray | None:
    outside_c = campaign.air_c if np.isfinite(campaign.air_c).all() else campaign.set_c
    if not np.isfinite(outside_c).all():
        return None
    return np.concatenate(
        [
            same_for_all_gyros(_cosines(outside_c, 8, 0.3)),
            _cosines(outside_c[:, np.newaxis] - campaign.gyro_c, 6, 0.5),
        ],
        axis=2,
    )


def _chamber_state(campaign: Campaign) -> FloatArray | None:
    """Shares of each dwell with a falling, rising and constant set point, as functions of temperature."""
    if not np.isfinite(campaign.set_c).all():
        return None
    path_c = campaign.set_point_path_c
    slopes_c = np.diff(path_c, axis=1)
    moves = [slopes_c < -_MIN_SLOPE_C, slopes_c > _MIN_SLOPE_C, np.abs(slopes_c) <= _MIN_SLOPE_C]
    shares = np.stack([np.mean(each, axis=1) for each in moves], axis=1)
    waves = _add_constant(_cosines(path_c.mean(axis=1), 8, 0.2))
    return _products(same_for_all_gyros(shares), same_for_all_gyros(waves))


def _branch(campaign: Campaign) -> FloatArray:
    """Sign of the last change of temperature (rising or falling branch), as a function of temperature."""
    branch = np.zeros_like(campaign.gyro_c)
    turn_c = campaign.gyro_c[0].copy()
    for index, gyro_c in enumerate(campaign.gyro_c):
        is_moving = np.abs(gyro_c - turn_c) > _MIN_CHANGE_C
        branch[index] = np.where(is_moving, np.sign(gyro_c - turn_c), branch[max(index - 1, 0)])
        turn_c = np.where(is_moving, gyro_c, turn_c)
    return _products(branch[..., np.newaxis], _add_constant(_temperatures(campaign, 8, 0.2)))


_PROCESSES: dict[str, Callable[[Campaign], FloatArray | None]] = {
    "time": lambda campaign: _time(campaign, 16, 0.5),
    "time irregularly": lambda campaign: _time(campaign, _ORDERS, 0.1),
    "time as a random walk": lambda campaign: _power_law(campaign, 2.0),
    "time as flicker noise": lambda campaign: _power_law(campaign, 1.0),
    "time since power-on": lambda campaign: same_for_all_gyros(
        _cosines(np.log(campaign.since_power_on_s + 900.0), 10, 0.5)
    ),
    "temperature": lambda campaign: _temperatures(campaign, 24, 0.1),
    "temperature rate": lambda campaign: _products(
        _temperature_rate(campaign), _add_constant(_temperatures(campaign, 3, 0.5))
    ),
    "attitude": _by_attitude(lambda campaign: _add_constant(_temperatures(campaign, 4, 0.5))),
    "attitude and time": _by_attitude(lambda campaign: _add_constant(_time(campaign, 4, 0.5))),
    "attitude and temperature rate": _by_attitude(_temperature_rate),
    "electronics above optics": _electronics_above_optics,
    "chamber temperature": _chamber,
    "state of the chamber": _chamber_state,
    "direction of the temperature": _branch,
}
