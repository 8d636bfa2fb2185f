"""Thermal network of each gyro with two nodes, fitted to the temperatures of the dwells.

The electronics at B warm the optics at T, which lose heat to the case; below an onset temperature, convection
makes the flow from the electronics depend on the direction of gravity::

    q = (B - T) (1 + s(T) a . Up)         s(T) = 1 / (1 + exp((T - onset) / width))
    dT/dt = k q + h (case - T) + c
    dB/dt = p - e q + f (case - B)

The temperature of the case drives it. It gives the temperature of the electronics above the optics with less
noise than the sensors, and also without a sensor at the electronics; if there are sensors, it must agree with
them within their noise. The attitude between dwells is unknown, so the network is initialized again after
each pause.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from gyrobench.bench.foundations.arrays import S_PER_H, BoolArray, FloatArray, b_splines
from gyrobench.bench.foundations.kernels import compiled

_STEPS_A_DWELL = 10
_SPLINE_DEGREE = 5
#: Pauses longer than this share of the next dwell separate segments; smallest mean number of dwells in one.
_MAX_PAUSE = 0.05
_MIN_DWELLS = 10
#: Parameters, each with lower bound, start, upper bound and scale of the fit; in hours and kelvin.
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
#: Uncertainty of the sensors and largest rms residual of a valid network: optics, slope, electronics.
_SENSOR_SIGMAS = np.array([0.02, 0.06, 0.02])
_MAX_RMS = np.array([0.1, 0.3, 0.1])
_MAX_EVALUATIONS = 60
#: Relative step of a derivative; absolute for parameters below one.
_STEP = float(np.finfo(np.float64).eps) ** 0.5
#: Polynomial in time for the differences between network and sensors: dwells per degree, largest degree.
_DWELLS_A_POLYNOMIAL, _MAX_DEGREE = 6, 20
_SCALE_C = 50.0


def electronics_above_optics(
    start_s: FloatArray,
    end_s: FloatArray,
    case_c: FloatArray,
    readings: FloatArray,
    up_body: FloatArray,
    fitted: BoolArray,
) -> FloatArray | None:
    """Mean temperature of each gyro's electronics above its optics in each dwell, (n, 3), by the network.

    None if the network does not describe the temperatures, differs from the sensors by more than their noise,
    or there are too many pauses: it is initialized again after each pause and in held-out dwells.

    Parameters
    ----------
    start_s, end_s, case_c : ndarray, shape (n,)
        Times of the dwells, in order, and mean temperature of the case.
    readings : ndarray, shape (n, 3, 3)
        Mean temperature of the optics, its slope in K/h, and mean temperature of the electronics (may be
        NaN) of each gyro.
    up_body : ndarray, shape (n, 3)
        Unit vector Up in body axes.
    fitted : ndarray of bool, shape (n,)
        Whether the parameters are fitted to a dwell.
    """
    if not np.isfinite(case_c).all() or np.any(end_s <= start_s):
        return None
    segments = [
        _Segment.of(start_s[part], end_s[part], case_c[part], up_body[part], bool(fitted[part][0]), part)
        for part in _split_at_pauses(start_s, end_s, fitted)
    ]
    fitted_segments = [each for each in segments if each.is_fitted]
    dwells = sum(len(each.step_h) for each in fitted_segments)
    if dwells <= 2 * len(_PARAMETERS) or dwells < _MIN_DWELLS * len(fitted_segments):
        return None
    above_c = np.empty((len(case_c), 3))
    for gyro in range(3):
        parameters = _fit(fitted_segments, readings[:, gyro])
        if parameters is None:
            return None
        for each in segments:
            own_readings = readings[each.rows, gyro]
            above_c[each.rows, gyro] = _above_optics(
                _with_initial_temperatures(parameters, each, own_readings), each
            )
        difference_c = (readings[:, gyro, 2] - readings[:, gyro, 0] - above_c[:, gyro])[fitted]
        if np.isfinite(difference_c).all() and not _is_scatter(
            difference_c, readings[fitted, gyro], up_body[fitted]
        ):
            return None
    return above_c


def _is_scatter(difference_c: FloatArray, readings: FloatArray, up_body: FloatArray) -> bool:
    """Whether differences (n,) are mostly scatter, not functions of time, temperature, its rate and attitude.

    The scatter is the smaller of the residual of a fit of these, and the second differences of neighbours.
    """
    count = len(difference_c)
    optics, rate = readings[:, :1] / _SCALE_C, readings[:, 1:2] / _SCALE_C
    time = np.linspace(-1.0, 1.0, count)
    smooth = np.polynomial.chebyshev.chebvander(time, min(count // _DWELLS_A_POLYNOMIAL, _MAX_DEGREE))
    columns = np.hstack([smooth, optics ** [1, 2, 3], rate, up_body, optics * up_body])
    values, _, rank, _ = np.linalg.lstsq(columns, difference_c, rcond=None)
    residual_variance = float(np.sum((difference_c - columns @ values) ** 2)) / max(count - int(rank), 1)
    neighbour_variance = float(np.mean(np.diff(difference_c, 2) ** 2)) / 6.0
    return float(np.mean(difference_c**2)) <= 2.0 * min(residual_variance, neighbour_variance)


@dataclass(frozen=True)
class _Segment:
    """Consecutive dwells: their slice of the table, and the inputs of the network."""

    rows: slice
    is_fitted: bool
    up_body: FloatArray
    driven_c: FloatArray
    step_h: FloatArray

    @classmethod
    def of(
        cls,
        start_s: FloatArray,
        end_s: FloatArray,
        case_c: FloatArray,
        up_body: FloatArray,
        is_fitted: bool,
        part: slice,
    ) -> _Segment:
        """Interpolate the case temperature by a spline of its integral, which keeps the dwells' means."""
        edges_h = np.append(start_s, end_s[-1]) / S_PER_H
        lengths_h = np.diff(edges_h)
        integrals = np.concatenate([[0.0], np.cumsum(case_c * lengths_h)])
        step_h = lengths_h / _STEPS_A_DWELL
        times_h = edges_h[:-1, np.newaxis] + (np.arange(_STEPS_A_DWELL) + 0.5) * step_h[:, np.newaxis]
        degree = max((min(_SPLINE_DEGREE, len(case_c)) - 1) // 2 * 2 + 1, 1)
        repeats, half = np.ones(degree + 1), (degree + 1) // 2  # no knots next to the ends
        inner = edges_h[half : len(edges_h) - half]
        knots = np.concatenate([edges_h[0] * repeats, inner, edges_h[-1] * repeats])
        factors = np.linalg.solve(b_splines(edges_h, knots, degree), integrals)
        slopes = degree * np.diff(factors) / (knots[degree + 1 : -1] - knots[1 : -degree - 1])
        driven_c = (b_splines(times_h.ravel(), knots[1:-1], degree - 1) @ slopes).reshape(times_h.shape)
        return cls(part, is_fitted, up_body, driven_c, step_h)

    def start(self, readings: FloatArray) -> FloatArray:
        """Initial temperatures of optics and electronics from the readings of one gyro (m, 3)."""
        optics_c = readings[0, 0] - 0.5 * _STEPS_A_DWELL * self.step_h[0] * readings[0, 1]
        board_c = readings[0, 2]
        return np.array([optics_c, board_c if np.isfinite(board_c) else optics_c + _START_ABOVE_OPTICS_C])

    def residuals(self, values: FloatArray, readings: FloatArray) -> FloatArray:
        """Model minus readings (..., m, 3): optics, slopes, electronics; NaN without a reading.

        ``values`` (..., parameters): several sets take less time in one call.
        """
        means = _simulate(np.atleast_2d(values), self.up_body, self.driven_c, self.step_h)
        return np.asarray(means.reshape(*values.shape[:-1], *readings.shape) - readings)


def _split_at_pauses(start_s: FloatArray, end_s: FloatArray, fitted: BoolArray) -> list[slice]:
    """Slices of the table without pauses, each entirely fitted or entirely not."""
    pauses = np.abs(start_s[1:] - end_s[:-1]) > _MAX_PAUSE * (end_s - start_s)[1:]
    cuts = np.flatnonzero(pauses | (fitted[1:] != fitted[:-1])) + 1
    return [slice(*pair) for pair in itertools.pairwise([0, *cuts.tolist(), len(start_s)])]


def _fit(segments: list[_Segment], readings: FloatArray) -> FloatArray | None:
    """Parameters of one gyro's network; None if it does not describe the readings (n, 3)."""
    from scipy.optimize import least_squares

    count = len(_PARAMETERS)

    def weighted(values: FloatArray) -> FloatArray:
        return _weighted(residuals(values))

    def residuals(values: FloatArray) -> FloatArray:
        parts = []
        for index, each in enumerate(segments):
            segment_values = np.concatenate(
                [values[..., :count], values[..., count + 2 * index :][..., :2]], axis=-1
            )
            parts.append(each.residuals(segment_values, readings[each.rows]))
        return np.concatenate(parts, axis=-2)

    def slopes(values: FloatArray) -> FloatArray:
        """Forward differences of the weighted residuals with the steps of scipy, in one call."""
        steps = _STEP * np.where(values >= 0.0, 1.0, -1.0) * np.maximum(1.0, np.abs(values))
        stepped = values + steps
        steps = np.where((stepped < lows) | (stepped > highs), -steps, steps)
        unchanged, *stepped_residuals = weighted(np.vstack([values, values + np.diag(steps)]))
        return np.asarray(
            ((np.array(stepped_residuals) - unchanged) / ((values + steps) - values)[:, np.newaxis]).T
        )

    lows, starts, highs, scales = np.array([each[1:] for each in _PARAMETERS]).T
    initial = [each.start(readings[each.rows]) for each in segments]
    lows = np.append(lows, [-100.0, -100.0] * len(initial))
    highs = np.append(highs, [150.0, 250.0] * len(initial))
    fitted = least_squares(
        weighted,
        np.concatenate([starts, *initial]),
        slopes,
        bounds=(lows, highs),
        x_scale=np.append(scales, [1.0, 3.0] * len(initial)),
        max_nfev=_MAX_EVALUATIONS,
    ).x
    sensor_count = 3 if np.isfinite(readings[:, 2]).all() else 2
    rms = np.sqrt(np.mean(residuals(fitted)[:, :sensor_count] ** 2, axis=0))
    return None if np.any(rms > _MAX_RMS[:sensor_count]) else np.asarray(fitted[:count])


def _with_initial_temperatures(parameters: FloatArray, segment: _Segment, readings: FloatArray) -> FloatArray:
    """Parameters with the initial temperatures that fit one segment best."""
    from scipy.optimize import least_squares

    def weighted(values: FloatArray) -> FloatArray:
        return _weighted(segment.residuals(np.append(parameters, values), readings))

    start = least_squares(weighted, segment.start(readings), max_nfev=_MAX_EVALUATIONS).x
    return np.append(parameters, start)


def _above_optics(values: FloatArray, segment: _Segment) -> FloatArray:
    optics_c, _, electronics_c = segment.residuals(values, np.zeros((len(segment.step_h), 3))).T
    return np.asarray(electronics_c - optics_c)


def _weighted(residuals: FloatArray) -> FloatArray:
    """Residuals (..., m, 3) divided by the sensor sigmas, as (..., 3 m); zero without a reading."""
    weighted: FloatArray = np.nan_to_num(residuals / _SENSOR_SIGMAS, nan=0.0)
    return weighted.reshape(*residuals.shape[:-2], -1)


@compiled
def _simulate(
    values: FloatArray, up_body: FloatArray, driven_c: FloatArray, step_h: FloatArray
) -> FloatArray:
    """Means of the optics, their slopes, and means of the electronics per dwell, by the midpoint rule.

    ``values`` (r, parameters): those of r runs. Returns (r, dwells, 3). The loop over runs is the inner one,
    since steps of different runs do not depend on each other and execute in parallel in the processor.
    """
    runs, (count, steps) = len(values), driven_c.shape
    means = np.zeros((runs, count, 3))
    optics, electronics = values[:, 11].copy(), values[:, 12].copy()
    for dwell in range(count):
        step, x, y, z = step_h[dwell], up_body[dwell, 0], up_body[dwell, 1], up_body[dwell, 2]
        initial_optics = optics.copy()
        for index in range(steps):
            case = driven_c[dwell, index]
            for run in range(runs):
                flow, to_case, optics_power, power, back_flow, loss, of_x, of_y, of_z, onset, width = values[
                    run, :11
                ]
                along = x * of_x + y * of_y + z * of_z
                middle_optics, middle_electronics = optics[run], electronics[run]
                for step_share in (0.5, 1.0):
                    share = along / (1.0 + np.exp((middle_optics - onset) / width))
                    heat = (middle_electronics - middle_optics) * (1.0 + share)
                    rise = flow * heat + to_case * (case - middle_optics) + optics_power
                    rise_electronics = power - back_flow * heat + loss * (case - middle_electronics)
                    if step_share == 0.5:
                        middle_optics = optics[run] + 0.5 * step * rise
                        middle_electronics = electronics[run] + 0.5 * step * rise_electronics
                optics[run] += step * rise
                electronics[run] += step * rise_electronics
                means[run, dwell, 0] += middle_optics / steps
                means[run, dwell, 2] += middle_electronics / steps
        means[:, dwell, 1] = (optics - initial_optics) / (steps * step)
    return means
