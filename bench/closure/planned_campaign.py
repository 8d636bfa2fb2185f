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
from gyrobench.bench.bias.dwell_table import DwellRow
from gyrobench.bench.bias.verdicts import JudgedQuantity, Judgement
from gyrobench.bench.closure.campaign import Campaign
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


def planned_campaign(plan: Plan, unit: UnitProperties) -> Campaign:
    """Predict the dwells of a plan.

    The biases are zero. Their uncertainty is the angle random walk over the navigation time of a dwell.
    Accelerometer noise is neglected: it adds about 6 % for the level gyros in windows of 10 min, more in
    shorter ones. Dwells of a calibration check are omitted. Raises MeasurementError if no dwell of the plan
    measures a bias.
    """
    navigations = list(_navigations(plan.steps))
    if not navigations:
        raise MeasurementError(
            f"{plan.procedure.procedure} has no dwell that measures a bias (align, navigate, turn, "
            "navigate). Separability can't be evaluated"
        )
    forecast = forecast_temperatures(plan, unit.thermal)

    def gather(name: str) -> FloatArray:
        return np.array([getattr(each, name) for each in navigations], dtype=np.float64)

    start_s, end_s = gather("start_s"), gather("end_s")

    def mean_of(values: FloatArray, *, measured: bool = True) -> FloatArray:
        return (
            forecast.means(values, start_s, end_s)
            if measured
            else np.full((len(start_s), *values.shape[1:]), math.nan)
        )

    walk = np.broadcast_to(unit.angle_random_walk_deg_per_sqrt_h, 3)
    sigma_dph = walk / np.sqrt(gather("navigation_s") / S_PER_H)[:, np.newaxis]
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
        gyro_c=mean_of(forecast.optics_c),
        rate_c_per_h=S_PER_H * forecast.changes_c(start_s, end_s) / (end_s - start_s)[:, np.newaxis],
        board_c=mean_of(forecast.electronics_c, measured=unit.has_boards),
        bias_dph=np.zeros((len(navigations), 3)),
        sigma_dph=sigma_dph,
        common_sigma_dph=np.zeros_like(sigma_dph),
        record=TemperatureRecord(forecast.time_s, forecast.optics_c, air_c=forecast.air_c),
        unit="planned",
        held_out=np.zeros(len(navigations), dtype=bool),
        azimuth_deg=gather("azimuth_deg"),
    )


def unreachable_limits(plan: Plan, unit: UnitProperties) -> list[str]:
    """Sentences on acceptance limits that no unit can be shown to meet, even one without any bias.

    From the angle random walk only, see :func:`planned_campaign`; other contributions increase the
    uncertainty.
    """
    limits = plan.procedure.acceptance
    if limits is None or not any(_navigations(plan.steps)):
        return []
    campaign = planned_campaign(plan, unit)
    rows = [
        DwellRow(
            unit=campaign.unit,
            run=str(campaign.run[index]),
            dwell=index,
            cycle=int(campaign.cycle[index]),
            position=position,
            start_s=float(campaign.start_s[index]),
            end_s=float(campaign.end_s[index]),
            since_power_on_s=float(campaign.since_power_on_s[index]),
            gyro_c=triple(campaign.gyro_c[index]),
            gyro_rate_c_per_h=triple(campaign.rate_c_per_h[index]),
            bias_dph=triple(campaign.bias_dph[index]),
            sigma_dph=triple(campaign.sigma_dph[index]),
            chamber_set_c=float(campaign.set_c[index]),
        )
        for index, position in enumerate(campaign.position)
    ]
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
    if count_above := int((campaign.sigma_dph > max_sigma_dph).any(axis=1).sum()):
        texts.append(
            f"bias_sigma_dph: up to {campaign.sigma_dph.max():.2g} deg/h, above the limit of "
            f"{max_sigma_dph:g} deg/h in {count_above} of {counted(len(rows), 'dwell')}"
        )
    return texts


def _navigations(steps: Sequence[PlannedStep]) -> Iterator[_Navigation]:
    run, power_on_s = -1, 0.0
    for dwell, group in itertools.groupby(steps, key=lambda planned: planned.dwell):
        members = list(group)
        if dwell is None or not members[0].purpose.gives_bias:
            for planned in members:
                if isinstance(planned.step, PowerOn):
                    run, power_on_s = run + 1, planned.start_s
            continue
        windows = [planned for planned in members if isinstance(planned.step, Navigate)]
        bench = windows[0].before
        if bench.position is not None and windows[0].purpose is not DwellPurpose.CALIBRATION_CHECK:
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
