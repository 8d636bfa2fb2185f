"""Forecasts the rows of a block's dwells: temperatures and expected uncertainties."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cached_property

import numpy as np

from gyrobench.bench.bias.dwell_table import DwellRow
from gyrobench.bench.closure.campaign import campaign_of
from gyrobench.bench.closure.unit_thermal import ELECTRONICS_ABOVE_OPTICS_K, Course, UnitThermal
from gyrobench.bench.foundations.arrays import S_PER_H, FloatArray, Triple, triple
from gyrobench.bench.investigation.external_bench import BlockPlan, ChamberStep, DwellStep, PowerStep
from gyrobench.bench.navigation.positions import POSITIONS
from gyrobench.bench.procedure.estimate import ThermalEstimate

_STEP_S = 60.0
_MAX_STEPS = 20_000
#: Name of the additional column with the power of the supply.
_SUPPLY_W = "supply_w"


class Forecast:
    """Thermal model of a unit, fitted to its measured dwells, and its state at the end of the last dwell.

    ``measured``: the dwells in the order of time; ``campaign``: the same as arrays; ``noise_scale``: ratio of
    their noise to the stated uncertainties; ``correlation_factor``: :attr:`Problem.correlation_factor`.
    """

    def __init__(
        self,
        measured: Sequence[DwellRow],
        noise_scale: FloatArray | float = 1.0,
        correlation_factor: float = 1.0,
    ) -> None:
        self.measured, self.campaign = measured, campaign_of(measured)
        self.noise_scale, self.correlation_factor = noise_scale, correlation_factor
        self._typical_s = float(np.median([row.end_s - row.start_s for row in measured]))
        self._sigma_dph = np.nanmedian([row.sigma_dph for row in measured], axis=0)

    @cached_property
    def _thermal_model(self) -> tuple[UnitThermal, Course | None]:
        return UnitThermal.typical(ThermalEstimate()).fitted_to(self.campaign)

    @cached_property
    def _above_optics(self) -> tuple[FloatArray, FloatArray] | None:
        """Offset (3,) and factor (3,) from modelled to measured temperature of electronics above optics.

        The offset is that of the last dwell, since deviations from the model last longer than a block.
        """
        measured_k, (_, course) = self.campaign.above_optics_c, self._thermal_model
        if measured_k is None:
            return None
        if course is None:
            return measured_k[-1] - ELECTRONICS_ABOVE_OPTICS_K, np.ones(3)
        above_k = course.electronics_c - course.optics_c
        above_k = course.means(above_k, self.campaign.start_s, self.campaign.end_s)
        pairs = zip(above_k.T, measured_k.T, strict=True)
        factors = np.array([np.polyfit(modelled_k, target_k, 1)[0] for modelled_k, target_k in pairs])
        return measured_k[-1] - factors * above_k[-1], factors

    def rows(self, plan: BlockPlan) -> list[DwellRow]:
        """Rows of the planned dwells.

        Their biases are zero. Columns that the table lacks are NaN, except for the temperature of the
        electronics if the thermal network gives it. The power of the supply is the last one multiplied by the
        factor of the plan.
        """
        thermal, measured_course = self._thermal_model
        time_s, set_c, power, up_body = _inputs(plan, self.measured)
        course = thermal.course(time_s, set_c, power, up_body, measured_course and measured_course.end)
        power_on_s, is_on = plan.start_s - plan.state.since_power_on_s, plan.state.powered
        since_power_on_s = list[float]()
        for step in plan.steps:
            if isinstance(step, PowerStep):
                power_on_s = step.start_s if step.on and not is_on else power_on_s
                is_on = step.on
            elif isinstance(step, DwellStep):
                since_power_on_s.append(step.start_s - power_on_s)
        return self._rows(plan.dwells, course, since_power_on_s, power)

    def _rows(
        self, steps: Sequence[DwellStep], course: Course, since_power_on_s: Sequence[float], power: FloatArray
    ) -> list[DwellRow]:
        last = self.measured[-1]
        supply_w = dict(last.other).get(_SUPPLY_W)
        edges_s = np.array([[step.start_s, step.end_s] for step in steps]).reshape(-1, 2).T

        def means(values: FloatArray, reference: float | Triple = 0.0) -> FloatArray:
            mask = 1.0 if np.isfinite(np.mean(reference)) else math.nan
            return mask * course.means(values, *edges_s)

        optics_c, electronics_c = means(course.optics_c), means(course.electronics_c, last.board_c)
        if self._above_optics is not None:
            offsets, factors = self._above_optics
            electronics_c = optics_c + offsets + factors * means(course.electronics_c - course.optics_c)
        rate_c_per_h = course.changes_c(*edges_s) / (edges_s[1] - edges_s[0])[:, np.newaxis] * S_PER_H
        factors = course.means(power, *edges_s)
        set_c, air_c, case_c = (
            means(values, reference).tolist()
            for values, reference in (
                (course.air_c, last.chamber_set_c),
                (course.air_c, last.chamber_c),
                (course.case_c, last.case_c),
            )
        )
        return [
            DwellRow(
                unit=last.unit,
                run=step.run,
                dwell=step.dwell,
                cycle=step.cycle,
                position=step.position,
                start_s=step.start_s,
                end_s=step.end_s,
                since_power_on_s=since_power_on_s[index],
                gyro_c=triple(optics_c[index]),
                gyro_rate_c_per_h=triple(rate_c_per_h[index]),
                bias_dph=(0.0, 0.0, 0.0),
                sigma_dph=triple(self._sigma_dph * math.sqrt(self._typical_s / (step.end_s - step.start_s))),
                azimuth_deg=step.azimuth_deg if math.isfinite(last.azimuth_deg) else math.nan,
                chamber_set_c=set_c[index],
                chamber_c=air_c[index],
                case_c=case_c[index],
                board_c=triple(electronics_c[index]),
                other=() if supply_w is None else ((_SUPPLY_W, supply_w * float(factors[index])),),
            )
            for index, step in enumerate(steps)
        ]


def chamber_c(rows: Sequence[DwellRow]) -> FloatArray:
    """Temperature of the chamber in each dwell, degC, without dwells that have no temperature.

    The set point, otherwise the air, otherwise the temperature that a typical unit would be following.
    """
    typical = ThermalEstimate()
    gyro_c = np.array([row.gyro_c for row in rows]).mean(axis=1)
    rate_c_per_h = np.array([row.gyro_rate_c_per_h for row in rows]).mean(axis=1)
    followed_c = gyro_c + rate_c_per_h * typical.time_constant_s / S_PER_H
    candidates_c = np.array([[row.chamber_set_c, row.chamber_c] for row in rows])
    candidates_c = np.column_stack([candidates_c, followed_c - typical.self_heating_c])
    first_known_c = candidates_c[np.arange(len(rows)), np.argmax(np.isfinite(candidates_c), axis=1)]
    return np.asarray(first_known_c[np.isfinite(first_known_c)])


def _inputs(
    plan: BlockPlan, rows: Sequence[DwellRow]
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Times (m,), set point (m,), power (m,), and Up in body axes (m, 3) over a block."""
    begin_s, last_c = min(rows[-1].end_s, plan.start_s), float(chamber_c(rows)[-1])
    count = min(max(round((plan.steps[-1].end_s - begin_s) / _STEP_S), 2), _MAX_STEPS)
    time_s = np.linspace(begin_s, plan.steps[-1].end_s, count + 1)
    set_c, power = np.full_like(time_s, last_c), np.full_like(time_s, float(plan.state.powered))
    if plan.start_s > begin_s:  # from the last dwell to the state before the first step
        start_c = last_c if plan.state.chamber_c is None else plan.state.chamber_c
        set_c = np.interp(time_s, [begin_s, plan.start_s], [last_c, start_c])
    up_body = np.tile(POSITIONS[plan.state.position].C_nb()[2], (len(time_s), 1))
    for step in plan.steps:
        is_later = time_s >= step.start_s
        if isinstance(step, PowerStep):
            power[is_later] = (step.factor or 1.0) if step.on else 0.0
        elif isinstance(step, ChamberStep):
            last_c = float(set_c[is_later][0])
            set_c[is_later] = np.interp(time_s[is_later], [step.start_s, step.end_s], [last_c, step.to_c])
        elif isinstance(step, DwellStep):
            up_body[is_later] = POSITIONS[step.position].C_nb()[2]
    return time_s, set_c, power, up_body
