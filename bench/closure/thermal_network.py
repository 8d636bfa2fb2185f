"""A small thermal network of each gyro, fitted to the temperatures that the dwells hold.

Optics at T are warmed by the electronics at B and lose heat to the case; convection makes the flow
from the electronics depend on the direction of gravity below an onset temperature::

    q = (B - T) (1 + s(T) a . Up)         s(T) = 1 / (1 + exp((T - onset) / width))
    dT/dt = k q + h (case - T) + c
    dB/dt = p - e q + f (case - B)

The case's temperature drives it. The network says what the electronics' temperature above the
optics was with less noise than the sensors have, and also where there is no sensor at the
electronics. Between dwells nothing is known of the attitude, so they have to follow one another.
"""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import make_interp_spline
from scipy.optimize import least_squares

FloatArray = NDArray[np.float64]

_STEPS_A_DWELL = 10
_LONGEST_PAUSE = 0.05
_S_PER_H = 3600.0
#: Parameters, each with the lower bound, start, upper bound and scale of its fit; hours and kelvin.
_PARAMETERS = (
    ("optics by flow", 0.01, 0.5, 10.0, 0.2),
    ("optics to case", 0.05, 1.5, 10.0, 0.5),
    ("optics' own power", -50.0, 0.0, 50.0, 1.0),
    ("electronics' power", 0.0, 20.0, 600.0, 10.0),
    ("electronics by flow", 0.0, 0.8, 20.0, 0.3),
    ("electronics to case", 0.05, 1.2, 40.0, 0.5),
    ("gravity along x", -0.95, 0.0, 0.95, 0.3),
    ("gravity along y", -0.95, 0.0, 0.95, 0.3),
    ("gravity along z", -0.95, 0.0, 0.95, 0.3),
    ("onset_c", 0.0, 50.0, 80.0, 5.0),
    ("onset_width_c", 1.0, 4.0, 15.0, 2.0),
)
_START_ABOVE_OPTICS_C = 8.0
#: What the sensors are believed to, and how far off a network may be that is used: means and slopes.
_SENSOR_C, _SLOPE_C_PER_H = 0.02, 0.06
_MOST_OFF_C, _MOST_OFF_C_PER_H = 0.1, 0.3
_MOST_EVALUATIONS = 60


def electronics_above_optics(
    start_s: FloatArray,
    end_s: FloatArray,
    case_c: FloatArray,
    gyro_c: FloatArray,
    rate_c_per_h: FloatArray,
    board_c: FloatArray,
    up_body: FloatArray,
) -> FloatArray | None:
    """Mean temperature of each gyro's electronics above its optics in each dwell, (n, 3), by the network.

    None where the network does not describe the temperatures, or where there are pauses between dwells.

    Parameters
    ----------
    start_s, end_s, case_c : ndarray, shape (n,)
        Times of the dwells, in order, and mean temperature of the case.
    gyro_c, rate_c_per_h, board_c : ndarray, shape (n, 3)
        Mean temperature and slope of the optics, mean temperature of the electronics (may be NaN).
    up_body : ndarray, shape (n, 3)
        Unit vector Up in body axes.
    """
    lengths_s = end_s - start_s
    if len(case_c) <= 2 * len(_PARAMETERS) or not np.isfinite(case_c).all():
        return None
    if np.any(np.abs(start_s[1:] - end_s[:-1]) > _LONGEST_PAUSE * lengths_s[1:]) or np.any(lengths_s <= 0.0):
        return None
    edges_h = np.append(start_s, end_s[-1]) / _S_PER_H
    lengths_h = np.diff(edges_h)
    sums = np.concatenate([[0.0], np.cumsum(case_c * lengths_h)])
    steps_h = lengths_h[:, np.newaxis] / _STEPS_A_DWELL
    times_h = edges_h[:-1, np.newaxis] + (np.arange(_STEPS_A_DWELL) + 0.5) * steps_h
    driven_c = make_interp_spline(edges_h, sums, k=5).derivative()(times_h)
    above_c = []
    for gyro in range(3):
        measured = (gyro_c[:, gyro], rate_c_per_h[:, gyro], board_c[:, gyro])
        fitted = _fit(measured, up_body, driven_c, steps_h[:, 0])
        if fitted is None:
            return None
        above_c.append(fitted)
    return np.stack(above_c, axis=1)


def _fit(
    measured: tuple[FloatArray, FloatArray, FloatArray],
    up_body: FloatArray,
    driven_c: FloatArray,
    step_h: FloatArray,
) -> FloatArray | None:
    gyro_c, rate_c_per_h, board_c = measured
    has_board = bool(np.isfinite(board_c).all())
    first_c = gyro_c[0] - 0.5 * _STEPS_A_DWELL * step_h[0] * rate_c_per_h[0]
    board_first_c = board_c[0] if has_board else first_c + _START_ABOVE_OPTICS_C

    def off(values: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        optics_c, slopes, electronics_c = _run(values, up_body, driven_c, step_h)
        return optics_c - gyro_c, slopes - rate_c_per_h, electronics_c - board_c

    def weighted(values: FloatArray) -> FloatArray:
        optics_c, slopes, electronics_c = off(values)
        parts = [optics_c / _SENSOR_C, slopes / _SLOPE_C_PER_H, electronics_c / _SENSOR_C]
        return np.concatenate(parts if has_board else parts[:2])

    lows, starts, highs, scales = np.array([each[1:] for each in _PARAMETERS]).T
    fitted = least_squares(
        weighted,
        np.concatenate([starts, [first_c, board_first_c]]),
        bounds=(np.append(lows, [-100.0, -100.0]), np.append(highs, [150.0, 250.0])),
        x_scale=np.append(scales, [1.0, 3.0]),
        max_nfev=_MOST_EVALUATIONS,
    ).x
    optics_c, slopes, electronics_c = (float(np.sqrt(np.mean(each**2))) for each in off(fitted))
    if optics_c > _MOST_OFF_C or slopes > _MOST_OFF_C_PER_H or (has_board and electronics_c > _MOST_OFF_C):
        return None
    warm_c, _, hot_c = _run(fitted, up_body, driven_c, step_h)
    return hot_c - warm_c


@numba.njit(cache=True)
def _run(
    values: FloatArray, up_body: FloatArray, driven_c: FloatArray, step_h: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Dwells' means of the optics, their slopes, and means of the electronics, by the midpoint rule."""
    flow, to_case, own, power, back, loss = values[:6]
    along = up_body @ values[6:9]
    onset, width, optics, electronics = values[9:]
    count, steps = driven_c.shape
    means, slopes, boards = np.zeros(count), np.zeros(count), np.zeros(count)
    for dwell in range(count):
        step, first = step_h[dwell], optics
        for each in range(steps):
            case = driven_c[dwell, each]
            middle_optics, middle_electronics = optics, electronics
            for part in (0.5, 1.0):
                share = along[dwell] / (1.0 + np.exp((middle_optics - onset) / width))
                heat = (middle_electronics - middle_optics) * (1.0 + share)
                rise = flow * heat + to_case * (case - middle_optics) + own
                rise_electronics = power - back * heat + loss * (case - middle_electronics)
                if part == 0.5:
                    middle_optics = optics + 0.5 * step * rise
                    middle_electronics = electronics + 0.5 * step * rise_electronics
            optics += step * rise
            electronics += step * rise_electronics
            means[dwell] += middle_optics / steps
            boards[dwell] += middle_electronics / steps
        slopes[dwell] = (optics - first) / (steps * step)
    return means, slopes, boards
