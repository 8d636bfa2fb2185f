"""Temperatures of chamber and unit that a plan leads to, by a few lags of first order.

The chamber's air follows the ramped set point, the case follows the air, the optics follow the
case. Heat of the unit itself lifts case and optics above the air, and electronics above the optics.
How slow the gyros are and how much warmer than the chamber is what the station's file says under
``unit.thermal``; how that divides between case and optics is typical of a navigation grade unit.
Convection that depends on attitude is left out: it moves the temperatures by some tenths of a kelvin.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

from gyrobench.bench.foundations.arrays import FloatArray
from gyrobench.bench.navigation.positions import POSITIONS
from gyrobench.bench.procedure.plan import Plan, PlannedStep

#: Share of the gyros' lag behind the air that the case takes, and of their self-heating.
CASE_LAG_SHARE = 0.2
CASE_HEATING_SHARE = 0.35
#: How much warmer than the optics the electronics are in a unit that is on, and how soon.
ELECTRONICS_ABOVE_OPTICS_K = 12.0
_ELECTRONICS_LAG_SHARE = 0.25
#: Share of the case, the optics having the rest, in what the electronics give their heat to.
CASE_SHARE_OF_ELECTRONICS = 0.7
#: Share of that which convection takes away where the optics are straight above the electronics, and
#: the directions from the electronics to the optics of the x, y and z gyro, across its axis.
CONVECTION_SHARE = 0.08
_TO_OPTICS_BODY = np.sqrt(0.5) * np.array([[0.0, 1.0, 1.0], [1.0, 0.0, 1.0], [1.0, 1.0, 0.0]])
_STEPS_A_LAG = 20
_LONGEST_STEP_S = 60.0
_MOST_STEPS = 20_000
#: At which a mean over a dwell is taken.
_INSTANTS = 21


@dataclass(frozen=True)
class TemperatureForecast:
    """Temperatures at equal steps of time, degC.

    Attributes
    ----------
    time_s : ndarray, shape (m,)
        From the start of the plan to its end.
    air_c, case_c, optics_c : ndarray, shape (m,)
        The chamber's air, the unit's case, and the optics; all three gyros alike.
    electronics_c : ndarray, shape (m, 3)
        The electronics of each gyro.
    """

    time_s: FloatArray
    air_c: FloatArray
    case_c: FloatArray
    optics_c: FloatArray
    electronics_c: FloatArray

    @property
    def step_s(self) -> float:
        """Distance of the times."""
        return float(self.time_s[1] - self.time_s[0])

    def means(self, values: FloatArray, start_s: FloatArray, end_s: FloatArray) -> FloatArray:
        """Means of something known at all times (m,) over n stretches of time, shape (n,)."""
        instants_s = np.linspace(start_s, end_s, _INSTANTS)
        return np.asarray(np.interp(instants_s, self.time_s, values).mean(axis=0))


def forecast_temperatures(plan: Plan) -> TemperatureForecast:
    """Forecast the temperatures over a plan, from the bench that its first step starts on."""
    thermal = plan.steps[0].before.thermal
    step_s = min(_LONGEST_STEP_S, thermal.time_constant_s / _STEPS_A_LAG)
    time_s = np.linspace(0.0, plan.duration_s, min(_MOST_STEPS, max(2, 1 + round(plan.duration_s / step_s))))
    set_c, power, up_body = _inputs(plan.steps, time_s)
    heating_c = power * thermal.self_heating_c
    case_lag_s = CASE_LAG_SHARE * thermal.time_constant_s

    def followed(goal: FloatArray, lag_s: float) -> FloatArray:
        return _lagged(goal, float(time_s[1] - time_s[0]), lag_s)

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
    """Ramped set point, 1 where the unit is on, and Up in body axes (m, 3), at all times."""
    ends_s = np.array([planned.end_s for planned in steps])
    index = np.minimum(np.searchsorted(ends_s, time_s), len(steps) - 1)
    set_c, power, up_body = np.empty_like(time_s), np.empty_like(time_s), np.zeros((len(time_s), 3))
    for number, (step, now_s) in enumerate(zip(index.tolist(), time_s.tolist(), strict=True)):
        planned = steps[step]
        since_s = max(now_s - planned.start_s, 0.0)
        # Before the first step the bench is at rest as that step finds it.
        bench = planned.step.after(planned.before, since_s) if number else planned.before
        set_c[number], power[number] = bench.chamber_c, bench.powered
        if bench.position is not None:
            up_body[number] = POSITIONS[bench.position].C_nb()[2]
    return set_c, power, up_body


def _lagged(goal: FloatArray, step_s: float, lag_s: float) -> FloatArray:
    """First-order lag over time, along the first axis, of what was at rest before its first instant."""
    keep = np.exp(-step_s / lag_s)
    rise: FloatArray = lfilter([1.0 - keep], [1.0, -keep], goal - goal[0], axis=0)
    return np.asarray(rise + goal[0])
