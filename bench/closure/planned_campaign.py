"""The campaign that a plan would give: its dwells with times, positions and temperatures, without biases."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from gyrobench.bench.closure.campaign import Campaign
from gyrobench.bench.closure.temperature_forecast import forecast_temperatures
from gyrobench.bench.closure.temperature_record import TemperatureRecord
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
    """What of a unit decides how well its dwells show an effect.

    Attributes
    ----------
    angle_random_walk_deg_per_sqrt_h : float
        Noise of each gyro.
    is_noise_declared : bool
        Whether the station declares it; else it is taken as typical.
    has_boards, has_case : bool
        Whether the temperatures of the gyros' electronics and of the case are measured.
    """

    angle_random_walk_deg_per_sqrt_h: float = TYPICAL_RANDOM_WALK
    is_noise_declared: bool = False
    has_boards: bool = True
    has_case: bool = True


@dataclass(frozen=True)
class _Navigation:
    """The navigation of one dwell, from the start of its first window to the end of its last."""

    position: str
    cycle: int
    run: int
    start_s: float
    end_s: float
    navigates_s: float
    since_power_on_s: float
    set_c: float


def planned_campaign(plan: Plan, unit: PlannedUnit) -> Campaign:
    """Predict the dwells of a plan.

    The biases are zero. Their uncertainty is that of the angle random walk over the time that a
    dwell navigates. The accelerometers are left out: to the level gyros they add some 6 % in windows
    of 10 min, and more in shorter ones.

    Parameters
    ----------
    plan : Plan
        Dwells that verify a calibration are left out.
    unit : PlannedUnit
        The unit under test.

    Raises
    ------
    MeasurementError
        The plan has no dwell that measures a bias.
    """
    navigations = list(_navigations(plan.steps))
    if not navigations:
        raise MeasurementError(
            f"{plan.procedure.procedure} has no dwell that measures a bias (align, navigate, turn, "
            "navigate), so there is no effect to look for"
        )
    forecast = forecast_temperatures(plan)

    def gather(name: str) -> FloatArray:
        return np.array([getattr(each, name) for each in navigations], dtype=np.float64)

    start_s, end_s = gather("start_s"), gather("end_s")

    def mean_of(values: FloatArray, *, measured: bool = True) -> FloatArray:
        return forecast.means(values, start_s, end_s) if measured else np.full(len(start_s), math.nan)

    first_c, last_c = np.interp([start_s, end_s], forecast.time_s, forecast.optics_c)
    sigma_dph = unit.angle_random_walk_deg_per_sqrt_h / np.sqrt(gather("navigates_s") / _S_PER_H)
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
        if bench.position is not None and not windows[0].is_verification:
            yield _Navigation(
                position=bench.position,
                cycle=windows[0].cycle,
                run=run,
                start_s=windows[0].start_s,
                end_s=windows[-1].end_s,
                navigates_s=sum(window.duration_s for window in windows),
                since_power_on_s=windows[0].start_s - power_on_s,
                set_c=math.nan if bench.set_point_c is None else bench.set_point_c,
            )


def _for_gyros(values: FloatArray) -> FloatArray:
    """The same values (n,) for all three gyros: (n, 3)."""
    return np.repeat(values[:, np.newaxis], 3, axis=1)
