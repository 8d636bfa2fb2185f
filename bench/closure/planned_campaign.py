"""The dwells that a plan would give: times, positions and forecast temperatures, without biases."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from gyrobench.bench.closure.campaign import Campaign
from gyrobench.bench.closure.temperatures import TemperatureRecord, lag
from gyrobench.bench.foundations.arrays import FloatArray
from gyrobench.bench.foundations.errors import MeasurementError
from gyrobench.bench.navigation.positions import POSITIONS
from gyrobench.bench.procedure.plan import Plan, PlannedStep
from gyrobench.bench.procedure.steps import Navigate, PowerOn

#: Angle random walk of a ring laser gyro of navigation grade, deg/sqrt(h), where the station declares none.
TYPICAL_RANDOM_WALK = 0.001
_S_PER_H = 3600.0


@dataclass(frozen=True)
class PlannedUnit:
    """Properties of a unit that determine the uncertainty of its dwells."""

    angle_random_walk_deg_per_sqrt_h: float = TYPICAL_RANDOM_WALK  #: Angle random walk of each gyro.
    is_noise_declared: bool = False  #: Whether the station declares it; otherwise it is typical.
    #: has_boards, has_case: Whether the temperatures of the electronics and of the case are measured.
    has_boards: bool = True
    has_case: bool = True


@dataclass(frozen=True)
class _Navigation:
    """The navigation of one dwell, from the start of its first window to the end of its last one."""

    position: str
    azimuth_deg: float
    cycle: int
    run: int
    start_s: float
    end_s: float
    navigation_s: float
    since_power_on_s: float
    set_c: float


def planned_campaign(plan: Plan, unit: PlannedUnit) -> Campaign:
    """Predict the dwells of a plan.

    The biases are zero. Their uncertainty is the angle random walk over the navigation time of a dwell.
    Accelerometer noise is neglected: it adds about 6 % for the level gyros in windows of 10 min, more in
    shorter ones. Dwells of a calibration check are left out. Raises MeasurementError if the plan has no dwell
    that measures a bias.
    """
    navigations = list(_navigations(plan.steps))
    if not navigations:
        raise MeasurementError(
            f"{plan.procedure.procedure} has no dwell that measures a bias (align, navigate, turn, "
            "navigate). Separability can't be evaluated"
        )
    forecast = forecast_temperatures(plan)

    def gather(name: str) -> FloatArray:
        return np.array([getattr(each, name) for each in navigations], dtype=np.float64)

    start_s, end_s = gather("start_s"), gather("end_s")

    def mean_of(values: FloatArray, *, measured: bool = True) -> FloatArray:
        return forecast.means(values, start_s, end_s) if measured else np.full(len(start_s), math.nan)

    first_c, last_c = np.interp([start_s, end_s], forecast.time_s, forecast.optics_c)
    sigma_dph = unit.angle_random_walk_deg_per_sqrt_h / np.sqrt(gather("navigation_s") / _S_PER_H)
    return Campaign(
        run_names=tuple(f"power-on {number + 1}" for number in range(navigations[-1].run + 1)),
        position=tuple(each.position for each in navigations),
        dwell=np.arange(1, len(navigations) + 1),
        cycle=np.array([each.cycle for each in navigations]),
        run=np.array([each.run for each in navigations]),
        up_body=np.array([POSITIONS[each.position].C_nb()[2] for each in navigations]),
        start_s=start_s,
        end_s=end_s,
        since_power_on_s=gather("since_power_on_s"),
        set_c=gather("set_c"),
        air_c=mean_of(forecast.air_c),
        case_c=mean_of(forecast.case_c, measured=unit.has_case),
        gyro_c=_for_gyros(mean_of(forecast.optics_c)),
        rate_c_per_h=_for_gyros(_S_PER_H * (last_c - first_c) / (end_s - start_s)),
        board_c=np.stack(
            [mean_of(each, measured=unit.has_boards) for each in forecast.electronics_c.T], axis=1
        ),
        bias_dph=np.zeros((len(navigations), 3)),
        sigma_dph=_for_gyros(sigma_dph),
        record=TemperatureRecord(forecast.time_s, _for_gyros(forecast.optics_c)),
        unit="planned",
        held_out=np.zeros(len(navigations), dtype=bool),
        azimuth_deg=gather("azimuth_deg"),
    )


def _navigations(steps: Sequence[PlannedStep]) -> Iterator[_Navigation]:
    run, power_on_s = -1, 0.0
    for dwell, group in itertools.groupby(steps, key=lambda planned: planned.dwell):
        members = list(group)
        if dwell is None:
            for planned in members:
                if isinstance(planned.step, PowerOn):
                    run, power_on_s = run + 1, planned.start_s
            continue
        windows = [planned for planned in members if isinstance(planned.step, Navigate)]
        bench = windows[0].before
        if bench.position is not None and not windows[0].is_calibration_check:
            yield _Navigation(
                position=bench.position,
                azimuth_deg=bench.azimuth_deg,
                cycle=windows[0].cycle,
                run=run,
                start_s=windows[0].start_s,
                end_s=windows[-1].end_s,
                navigation_s=sum(window.duration_s for window in windows),
                since_power_on_s=windows[0].start_s - power_on_s,
                set_c=math.nan if bench.set_point_c is None else bench.set_point_c,
            )


def _for_gyros(values: FloatArray) -> FloatArray:
    """Values (n,) repeated for the three gyros: (n, 3)."""
    return np.repeat(values[:, np.newaxis], 3, axis=1)


#: Share of the gyros' lag behind the air that the case takes, and of their self-heating.
CASE_LAG_SHARE = 0.2
CASE_HEATING_SHARE = 0.35
#: Temperature of the electronics above the optics in a powered unit, and its lag.
ELECTRONICS_ABOVE_OPTICS_K = 12.0
_ELECTRONICS_LAG_SHARE = 0.25
#: Share of the electronics' heat that flows to the case; the rest flows to the optics.
CASE_SHARE_OF_ELECTRONICS = 0.7
#: Relative reduction of that temperature by convection if the optics are directly above the electronics,
#: and the directions from electronics to optics of the x, y and z gyro, perpendicular to its axis.
CONVECTION_SHARE = 0.08
_TO_OPTICS_BODY = np.sqrt(0.5) * np.array([[0.0, 1.0, 1.0], [1.0, 0.0, 1.0], [1.0, 1.0, 0.0]])
_STEPS_A_LAG = 20
_MAX_STEP_S = 60.0
_MAX_STEPS = 20_000
#: Samples of a mean over a dwell.
_INSTANTS = 21


@dataclass(frozen=True)
class TemperatureForecast:
    """Temperatures at equal steps of time, degC."""

    time_s: FloatArray  #: Shape (m,). Over the whole plan.
    #: air_c, case_c, optics_c: Shape (m,). Chamber air, case, and optics (equal for the three gyros).
    air_c: FloatArray
    case_c: FloatArray
    optics_c: FloatArray
    electronics_c: FloatArray  #: Shape (m, 3). The electronics of each gyro.

    def means(self, values: FloatArray, start_s: FloatArray, end_s: FloatArray) -> FloatArray:
        """Means of values at all times (m,) over n intervals, shape (n,)."""
        instants_s = np.linspace(start_s, end_s, _INSTANTS)
        return np.asarray(np.interp(instants_s, self.time_s, values).mean(axis=0))


def forecast_temperatures(plan: Plan) -> TemperatureForecast:
    """Forecast the temperatures over a plan by first-order lags, from the bench state before its first step.

    The chamber air follows the ramped set point, the case the air, the optics the case. Self-heating
    raises case and optics above the air, and electronics above the optics; lag and self-heating are
    those of ``unit.thermal`` in the station file, divided between case and optics as in a typical
    navigation-grade unit. The dependence of convection on attitude, some tenths of a kelvin, enters
    only the electronics.
    """
    thermal = plan.steps[0].before.thermal
    step_s = min(_MAX_STEP_S, thermal.time_constant_s / _STEPS_A_LAG)
    time_s = np.linspace(0.0, plan.duration_s, min(_MAX_STEPS, max(2, 1 + round(plan.duration_s / step_s))))
    set_c, power, up_body = _inputs(plan.steps, time_s)
    heating_c = power * thermal.self_heating_c
    case_lag_s = CASE_LAG_SHARE * thermal.time_constant_s

    def followed(goal: FloatArray, lag_s: float) -> FloatArray:
        columns = goal.reshape(len(goal), -1)
        return np.asarray(columns + lag(columns, time_s, lag_s)).reshape(goal.shape)

    air_c = followed(set_c, thermal.air_lag_s)
    case_c = followed(air_c + CASE_HEATING_SHARE * heating_c, case_lag_s)
    optics_goal_c = case_c + (1.0 - CASE_HEATING_SHARE) * heating_c
    optics_c = followed(optics_goal_c, thermal.time_constant_s - case_lag_s)
    around_c = optics_c + CASE_SHARE_OF_ELECTRONICS * (optics_goal_c - optics_c)
    above_k = np.outer(power, np.full(3, ELECTRONICS_ABOVE_OPTICS_K))
    above_k *= 1.0 - CONVECTION_SHARE * up_body @ _TO_OPTICS_BODY.T
    electronics_c = followed(
        around_c[:, np.newaxis] + above_k, _ELECTRONICS_LAG_SHARE * thermal.time_constant_s
    )
    return TemperatureForecast(time_s, air_c, case_c, optics_c, electronics_c)


def _inputs(steps: tuple[PlannedStep, ...], time_s: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Ramped set point, power (0 or 1), and Up in body axes (m, 3), at all times."""
    ends_s = np.array([planned.end_s for planned in steps])
    index = np.minimum(np.searchsorted(ends_s, time_s), len(steps) - 1)
    set_c, power, up_body = np.empty_like(time_s), np.empty_like(time_s), np.zeros((len(time_s), 3))
    for number, (step, now_s) in enumerate(zip(index.tolist(), time_s.tolist(), strict=True)):
        planned = steps[step]
        since_s = max(now_s - planned.start_s, 0.0)
        # Until the first step the bench is at rest.
        bench = planned.step.after(planned.before, since_s) if number else planned.before
        set_c[number], power[number] = bench.chamber_c, bench.powered
        if bench.position is not None:
            up_body[number] = POSITIONS[bench.position].C_nb()[2]
    return set_c, power, up_body
