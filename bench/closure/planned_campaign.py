"""Predicts the dwells of a plan: times, positions and forecast temperatures, without biases."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from gyrobench.bench.bias.acceptance import judge
from gyrobench.bench.bias.dwell import DwellPurpose
from gyrobench.bench.bias.dwell_table import NOT_MEASURED, DwellRow
from gyrobench.bench.bias.verdicts import JudgedQuantity, Judgement
from gyrobench.bench.closure.campaign import Campaign, campaign_of
from gyrobench.bench.closure.temperature_record import TemperatureRecord, lag
from gyrobench.bench.closure.unit_thermal import Course, UnitThermal
from gyrobench.bench.foundations.arrays import S_PER_H, FloatArray, triple
from gyrobench.bench.foundations.errors import MeasurementError
from gyrobench.bench.foundations.text import counted
from gyrobench.bench.navigation.positions import POSITIONS
from gyrobench.bench.procedure.plan import Plan, PlannedStep
from gyrobench.bench.procedure.steps import Navigate, PowerOn

_STEPS_A_LAG = 20
_MAX_STEP_S = 60.0
_MAX_STEPS = 20_000
#: Angle random walk of a ring laser gyro of navigation grade, deg/sqrt(h), if the station declares none.
_TYPICAL_RANDOM_WALK = 0.001
#: Keys of the limits of acceptance.
_LIMITS: Mapping[JudgedQuantity, str] = MappingProxyType(
    {
        "position difference": "position_difference_dph",
        "vertical difference": "vertical_difference_dph",
        "bias": "bias_dph",
    }
)


@dataclass(frozen=True)
class UnitProperties:
    """Properties of a unit that determine the uncertainty of its dwells."""

    #: Angle random walk: one number for all three gyros, or shape (3,).
    angle_random_walk_deg_per_sqrt_h: float | FloatArray = _TYPICAL_RANDOM_WALK
    noise_source: str = "a typical value, none is declared"  #: Source of the random walk, for messages.
    #: has_boards, has_case: Whether the temperatures of the electronics and of the case are measured.
    has_boards: bool = True
    has_case: bool = True
    thermal: UnitThermal | None = None  #: Its thermal model; None for that of a typical unit.


def planned_campaign(plan: Plan, unit: UnitProperties) -> Campaign:
    """Predict the dwells of a plan; see :func:`_planned_rows`.

    Dwells of a calibration check are omitted. Raises MeasurementError if no dwell measures a bias.
    """
    forecast = forecast_temperatures(plan, unit.thermal)
    rows = _planned_rows(plan, unit, forecast)
    if not rows:
        raise MeasurementError(
            f"{plan.procedure.procedure} has no dwell that measures a bias (align, navigate, turn, "
            "navigate). Separability can't be evaluated"
        )
    record = TemperatureRecord(forecast.time_s, forecast.optics_c, air_c=forecast.air_c)
    return campaign_of(rows, record, is_forecast=True)


def _planned_rows(plan: Plan, unit: UnitProperties, forecast: Course) -> list[DwellRow]:
    """Rows of the dwells of a plan that measure biases, with the ``forecast`` temperatures.

    The biases are zero. Their uncertainty is the angle random walk over the navigation time of a dwell.
    Accelerometer noise is neglected: it adds about 6 % for the level gyros in windows of 10 min, more in
    shorter ones.
    """
    walk = np.broadcast_to(unit.angle_random_walk_deg_per_sqrt_h, 3)
    rows = list[DwellRow]()
    for windows, power_ons, power_on_s in _navigations(plan.steps):
        first, start_s, end_s = windows[0], windows[0].start_s, windows[-1].end_s
        ends_s = np.array([start_s]), np.array([end_s])
        bench, navigation_s = first.before, sum(window.duration_s for window in windows)
        air_c, case_c, optics_c, electronics_c = (
            forecast.means(each, *ends_s)[0]
            for each in (forecast.air_c, forecast.case_c, forecast.optics_c, forecast.electronics_c)
        )
        rows.append(
            DwellRow(
                unit="planned",
                run=f"power-on {power_ons}",
                dwell=len(rows) + 1,
                cycle=first.cycle,
                position=bench.position or "",
                start_s=start_s,
                end_s=end_s,
                since_power_on_s=start_s - power_on_s,
                gyro_c=triple(optics_c),
                gyro_rate_c_per_h=triple(S_PER_H * forecast.changes_c(*ends_s)[0] / (end_s - start_s)),
                bias_dph=(0.0, 0.0, 0.0),
                sigma_dph=triple(walk / np.sqrt(navigation_s / S_PER_H)),
                azimuth_deg=bench.azimuth_deg,
                chamber_set_c=math.nan if bench.set_point_c is None else bench.set_point_c,
                chamber_c=float(air_c),
                case_c=float(case_c) if unit.has_case else math.nan,
                board_c=triple(electronics_c) if unit.has_boards else NOT_MEASURED,
            )
        )
    return rows


def unreachable_limits(plan: Plan, unit: UnitProperties) -> list[str]:
    """Sentences on acceptance limits that no unit can be shown to meet, even one without any bias.

    From the angle random walk only, see :func:`_planned_rows`; other contributions increase the uncertainty.
    """
    limits = plan.procedure.acceptance
    if limits is None or not any(_navigations(plan.steps)):
        return []
    rows = _planned_rows(plan, unit, forecast_temperatures(plan, unit.thermal))
    worst: dict[JudgedQuantity, Judgement] = {}
    for each in judge(rows, limits, width_c=plan.procedure.bin_width_c).judgements:
        worst_so_far = worst.get(each.quantity, each)
        worst[each.quantity] = max(worst_so_far, each, key=lambda judged: judged.at_most_dph)
    texts = [
        f"{_LIMITS[quantity]}: at best below {each.at_most_dph:.2g} deg/h ({100.0 * limits.confidence:g} %), "
        f"limit {each.limit_dph:g} deg/h"
        for quantity, each in worst.items()
        if each.verdict != "pass"
    ]
    max_sigma_dph = math.inf if limits.bias_sigma_dph is None else limits.bias_sigma_dph
    sigmas_dph = [max(row.sigma_dph) for row in rows]
    if count_above := sum(sigma_dph > max_sigma_dph for sigma_dph in sigmas_dph):
        texts.append(
            f"bias_sigma_dph: up to {max(sigmas_dph):.2g} deg/h, above the limit of "
            f"{max_sigma_dph:g} deg/h in {count_above} of {counted(len(rows), 'dwell')}"
        )
    return texts


def _navigations(steps: Sequence[PlannedStep]) -> Iterator[tuple[list[PlannedStep], int, float]]:
    """Windows of each dwell that measures a bias, number of power-ons before it, and time of the last one."""
    power_ons, power_on_s = 0, 0.0
    for dwell, group in itertools.groupby(steps, key=lambda planned: planned.dwell):
        members = list(group)
        if dwell is None or not members[0].purpose.gives_bias:
            for planned in members:
                if isinstance(planned.step, PowerOn):
                    power_ons, power_on_s = power_ons + 1, planned.start_s
            continue
        windows = [planned for planned in members if isinstance(planned.step, Navigate)]
        is_check = windows[0].purpose is DwellPurpose.CALIBRATION_CHECK
        if windows[0].before.position is not None and not is_check:
            yield windows, power_ons, power_on_s


def forecast_temperatures(plan: Plan, thermal: UnitThermal | None = None) -> Course:
    """Forecast the temperatures over a plan at equal time steps, from the bench state before its first step.

    The chamber air follows the ramped set point, and the unit follows the air. ``thermal``: by default that
    of a typical unit with the lag and self-heating of ``unit.thermal`` in the station file.
    """
    estimate = plan.steps[0].before.thermal
    step_s = min(_MAX_STEP_S, estimate.time_constant_s / _STEPS_A_LAG)
    time_s = np.linspace(0.0, plan.duration_s, min(_MAX_STEPS, max(2, 1 + round(plan.duration_s / step_s))))
    set_c, power, up_body = _inputs(plan.steps, time_s)
    air_c = set_c + lag(set_c[:, np.newaxis], time_s, estimate.air_lag_s)[:, 0]
    return (thermal or UnitThermal.typical(estimate)).course(time_s, air_c, power, up_body)


def _inputs(steps: tuple[PlannedStep, ...], time_s: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Ramped set point (m,), power (m,) (0 or 1), and Up in body axes (m, 3) at all times (m,)."""
    ends_s = np.array([planned.end_s for planned in steps])
    index = np.minimum(np.searchsorted(ends_s, time_s), len(steps) - 1)
    set_c, power, up_body = np.empty_like(time_s), np.empty_like(time_s), np.zeros((len(time_s), 3))
    for number, (step, now_s) in enumerate(zip(index.tolist(), time_s.tolist(), strict=True)):
        planned = steps[step]
        since_s = max(now_s - planned.start_s, 0.0)
        # The bench is at rest before the first step.
        bench = planned.step.after(planned.before, since_s) if number else planned.before
        set_c[number], power[number] = bench.chamber_c, bench.powered
        if bench.position is not None:
            up_body[number] = POSITIONS[bench.position].C_nb()[2]
    return set_c, power, up_body
