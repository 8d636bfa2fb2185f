"""Temperatures of the dwells of a block, forecast by lags that are fitted to the dwells measured.

The air follows the set point, the case the air, and each gyro's optics the case, each by a lag of first
order; the unit's own heat raises case and optics. The electronics are above the optics by a value for each
position.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import least_squares
from scipy.signal import lfilter

from gyrobench.bench.bias.dwell_table import DwellRow, Triple
from gyrobench.bench.closure.temperatures import set_point_path
from gyrobench.bench.foundations.arrays import FloatArray
from gyrobench.bench.investigation.external_bench import BlockPlan, ChamberStep, DwellStep, PowerStep
from gyrobench.bench.navigation.positions import POSITIONS

_STEP_S = 60.0
_MAX_STEPS = 20_000
_S_PER_H = 3600.0
#: Lower bound, start and upper bound of the lags of air, case and optics, h, and of the heating, K.
_LAGS_H = ((0.005, 0.05, 1.0), (0.02, 0.3, 6.0), (0.05, 0.7, 12.0))
_HEATING_K = (-5.0, 8.0, 60.0)
#: Rate of the ramps between dwells, degC/h.
_RAMP_C_PER_H = (3.0, 60.0, 600.0)


@dataclass(frozen=True)
class _Course:
    """Inputs and temperatures at equal steps."""

    time_s: FloatArray  #: Shape (m,).
    set_c: FloatArray  #: Shape (m,). Ramped set point.
    power: FloatArray  #: Shape (m,). Dissipation relative to the usual one.


@dataclass(frozen=True)
class _State:
    """Temperatures of air, case and optics (three gyros), degC."""

    air_c: float
    case_c: float
    gyro_c: FloatArray


@dataclass(frozen=True)
class ThermalModel:
    """Lags and heating of one unit in its chamber."""

    #: lags_h, case_heating_k: Lags of air, case and optics; case above air.
    lags_h: FloatArray
    case_heating_k: float
    gyro_heating_k: FloatArray  #: Shape (3,). Optics above the case.
    rms_c: float  #: Rms of the optics' residuals in the dwells measured.

    def simulate(self, course: _Course, start: _State) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Air (m,), case (m,) and optics (m, 3) from a state at the first instant, degC."""
        step_h = float(course.time_s[1] - course.time_s[0]) / _S_PER_H
        keep = np.exp(-step_h / self.lags_h)

        def followed(goal: FloatArray, kept: float, from_c: float) -> FloatArray:
            return np.asarray(
                lfilter([1.0 - kept], [1.0, -kept], goal, zi=[kept * from_c])[0], dtype=np.float64
            )

        air_c = followed(course.set_c, keep[0], start.air_c)
        case_c = followed(air_c + self.case_heating_k * course.power, keep[1], start.case_c)
        gyros = [
            followed(case_c + heating_k * course.power, keep[2], from_c)
            for heating_k, from_c in zip(self.gyro_heating_k, start.gyro_c, strict=True)
        ]
        return air_c, case_c, np.stack(gyros, axis=1)


def fit_thermal_model(rows: Sequence[DwellRow]) -> ThermalModel:
    """Fit lags and heating to the temperatures of dwells, in the order of time."""
    course_with, start = _measured_courses(rows), _first_state(rows)
    start_s, end_s = (np.array([getattr(row, name) for row in rows]) for name in ("start_s", "end_s"))
    case_c = np.array([row.case_c for row in rows])
    air_c = np.array([row.chamber_c for row in rows])
    gyro_c = np.array([row.gyro_c for row in rows])

    def model(values: FloatArray) -> ThermalModel:
        return ThermalModel(np.exp(values[:3]), float(values[3]), values[4:7], math.nan)

    def residuals(values: FloatArray) -> FloatArray:
        course = course_with(float(np.exp(values[7])))
        air, case, optics = model(values).simulate(course, start)
        parts = [
            _means(course.time_s, air, start_s, end_s) - air_c,
            _means(course.time_s, case, start_s, end_s) - case_c,
            *(
                _means(course.time_s, each, start_s, end_s) - seen
                for each, seen in zip(optics.T, gyro_c.T, strict=True)
            ),
        ]
        return np.asarray(np.nan_to_num(np.concatenate(parts), nan=0.0))

    bounds = [*(np.log(each) for each in _LAGS_H), _HEATING_K, *([_HEATING_K] * 3), np.log(_RAMP_C_PER_H)]
    low, first, high = np.array(bounds).T
    fitted = least_squares(residuals, first, bounds=(low, high), loss="soft_l1", max_nfev=60).x
    rms_c = float(np.sqrt(np.mean(residuals(fitted)[-3 * len(rows) :] ** 2)))
    return replace(model(fitted), rms_c=rms_c)


def forecast_dwells(rows: Sequence[DwellRow], plan: BlockPlan, model: ThermalModel) -> list[DwellRow]:
    """Rows of the planned dwells: forecast temperatures, expected uncertainties, and biases of zero."""
    course = _planned_course(rows, plan)
    last = rows[-1]
    gyro_c = np.array([plan.state.gyro_x_c, plan.state.gyro_y_c, plan.state.gyro_z_c])
    case_c = last.case_c if np.isfinite(last.case_c) else float(np.mean(gyro_c - model.gyro_heating_k))
    air_c = last.chamber_c if np.isfinite(last.chamber_c) else float(course.set_c[0])
    air, case, optics = model.simulate(course, _State(air_c, case_c, gyro_c))
    above_k = _electronics_above_optics(rows)
    power_on_s = last.start_s - last.since_power_on_s
    sigma_dph = np.nanmedian([row.sigma_dph for row in rows], axis=0)
    typical_s = float(np.median([row.end_s - row.start_s for row in rows]))
    found = []
    for step in plan.steps:
        if isinstance(step, PowerStep) and step.on and not _is_on_before(plan, step):
            power_on_s = step.start_s
        if not isinstance(step, DwellStep):
            continue
        edges = np.array([step.start_s]), np.array([step.end_s])

        def mean(values: FloatArray, edges: tuple[FloatArray, FloatArray] = edges) -> float:
            return float(_means(course.time_s, values, *edges)[0])

        ends = [np.interp([step.start_s, step.end_s], course.time_s, each) for each in optics.T]
        factor = mean(course.power)
        mine_c = _triple([mean(each) for each in optics.T])
        found.append(
            DwellRow(
                unit=last.unit,
                run=step.run,
                dwell=step.dwell,
                cycle=step.cycle,
                position=step.position,
                start_s=step.start_s,
                end_s=step.end_s,
                since_power_on_s=step.start_s - power_on_s,
                gyro_c=mine_c,
                gyro_rate_c_per_h=_triple(
                    [float(each[1] - each[0]) / (step.end_s - step.start_s) * _S_PER_H for each in ends]
                ),
                bias_dph=(0.0, 0.0, 0.0),
                sigma_dph=_triple(sigma_dph * math.sqrt(typical_s / (step.end_s - step.start_s))),
                azimuth_deg=step.azimuth_deg if math.isfinite(last.azimuth_deg) else math.nan,
                chamber_set_c=mean(course.set_c) if math.isfinite(last.chamber_set_c) else math.nan,
                chamber_c=mean(air) if math.isfinite(last.chamber_c) else math.nan,
                case_c=mean(case) if math.isfinite(last.case_c) else math.nan,
                board_c=_triple(np.array(mine_c) + factor * above_k[step.position]),
            )
        )
    return found


def _measured_courses(rows: Sequence[DwellRow]) -> Callable[[float], _Course]:
    """Set point and power over the dwells measured, by the rate of the ramps between them, degC/h.

    Between two dwells the set point is ramped at once and then held, as procedures do.
    """
    columns = ("start_s", "end_s", "chamber_set_c", "chamber_c", "since_power_on_s")
    start_s, end_s, set_c, air_c, since_s = (
        np.array([getattr(row, each) for row in rows]) for each in columns
    )
    set_c = np.where(np.isfinite(set_c), set_c, air_c)
    known = np.isfinite(set_c)
    path_c = set_point_path(start_s[known], end_s[known], set_c[known], air_c[known])
    samples = (np.arange(path_c.shape[1]) + 0.5) / path_c.shape[1]
    instants_s = start_s[known, np.newaxis] + (end_s - start_s)[known, np.newaxis] * samples
    time_s = _grid(float(start_s[0]), float(end_s[-1]))
    power = np.ones_like(time_s)
    for before_s, after_s, on_s in zip(end_s[:-1], start_s[1:], (start_s - since_s)[1:], strict=True):
        if before_s < on_s <= after_s:
            power[(time_s > before_s) & (time_s < on_s)] = 0.0
    from_s, to_s = instants_s[:-1, -1], instants_s[1:, 0]
    from_c, to_c = path_c[:-1, -1], path_c[1:, 0]

    def course(ramp_c_per_h: float) -> _Course:
        arrived_s = np.minimum(from_s + np.abs(to_c - from_c) / ramp_c_per_h * _S_PER_H, to_s)
        knots_s = np.concatenate([instants_s.ravel(), arrived_s])
        knots_c = np.concatenate([path_c.ravel(), to_c])
        order = np.argsort(knots_s, kind="stable")
        return _Course(time_s, np.interp(time_s, knots_s[order], knots_c[order]), power)

    return course


def _planned_course(rows: Sequence[DwellRow], plan: BlockPlan) -> _Course:
    last = rows[-1]
    first_c = last.chamber_set_c if np.isfinite(last.chamber_set_c) else last.chamber_c
    time_s = _grid(plan.start_s, plan.steps[-1].end_s)
    set_c, power = np.full_like(time_s, first_c), np.ones_like(time_s)
    for step in plan.steps:
        later, inside = time_s >= step.start_s, (time_s >= step.start_s) & (time_s < step.end_s)
        if isinstance(step, PowerStep):
            power[later] = (step.factor or 1.0) if step.on else 0.0
        elif isinstance(step, ChamberStep):
            from_c = set_c[inside][0] if inside.any() else first_c
            set_c[inside] = np.interp(time_s[inside], [step.start_s, step.end_s], [from_c, step.to_c])
            set_c[time_s >= step.end_s] = step.to_c
    return _Course(time_s, set_c, power)


def _is_on_before(plan: BlockPlan, step: PowerStep) -> bool:
    before = [each for each in plan.steps if isinstance(each, PowerStep) and each.end_s <= step.start_s]
    return before[-1].on if before else plan.state.powered


def _first_state(rows: Sequence[DwellRow]) -> _State:
    first = rows[0]
    half_h = 0.5 * (first.end_s - first.start_s) / _S_PER_H
    gyro_c = np.array(first.gyro_c) - half_h * np.array(first.gyro_rate_c_per_h)
    air_c = first.chamber_c if np.isfinite(first.chamber_c) else first.chamber_set_c
    return _State(air_c, first.case_c if np.isfinite(first.case_c) else float(gyro_c.mean()), gyro_c)


def _electronics_above_optics(rows: Sequence[DwellRow]) -> dict[str, FloatArray]:
    """Electronics above optics in each position, mean of the dwells; of a new one, the mean of all."""
    above_k = np.array([row.board_c for row in rows]) - np.array([row.gyro_c for row in rows])
    names = np.array([row.position for row in rows])
    found = {name: above_k[names == name] for name in POSITIONS}
    return {name: (mine if len(mine) else above_k).mean(axis=0) for name, mine in found.items()}


def _grid(first_s: float, last_s: float) -> FloatArray:
    count = min(max(round((last_s - first_s) / _STEP_S), 2), _MAX_STEPS)
    return np.linspace(first_s, last_s, count + 1)


def _means(time_s: FloatArray, values: FloatArray, start_s: FloatArray, end_s: FloatArray) -> FloatArray:
    """Means of values at equal steps (m,) over intervals, shape (n,)."""
    area = np.concatenate([[0.0], np.cumsum(0.5 * (values[1:] + values[:-1]) * np.diff(time_s))])
    edges = np.interp(np.stack([start_s, end_s]), time_s, area)
    return np.asarray((edges[1] - edges[0]) / (end_s - start_s))


def _triple(values: FloatArray | Sequence[float]) -> Triple:
    x, y, z = map(float, values)
    return x, y, z
