"""Rows of the dwells of a block before they are measured: forecast temperatures, expected uncertainties."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from gyrobench.bench.bias.dwell_table import DwellRow, Triple
from gyrobench.bench.closure.campaign import Campaign
from gyrobench.bench.closure.thermal_course import Course, UnitThermal
from gyrobench.bench.foundations.arrays import FloatArray
from gyrobench.bench.investigation.external_bench import BlockPlan, ChamberStep, DwellStep, PowerStep
from gyrobench.bench.navigation.positions import POSITIONS
from gyrobench.bench.procedure.estimate import ThermalEstimate

_STEP_S = 60.0
_MAX_STEPS = 20_000
_S_PER_H = 3600.0


class Forecast:
    """A unit as its dwells show it: lags and temperature rises, and its state at the end of the last dwell.

    ``rows`` are the dwells in the order of time, ``campaign`` the same as arrays.
    """

    def __init__(self, rows: Sequence[DwellRow], campaign: Campaign) -> None:
        self._rows = rows
        self.thermal, course = UnitThermal.typical(ThermalEstimate()).fitted_to(campaign)
        self._start = None if course is None else course.end
        self._typical_s = float(np.median([row.end_s - row.start_s for row in rows]))
        self._sigma_dph = np.nanmedian([row.sigma_dph for row in rows], axis=0)

    def rows(self, plan: BlockPlan) -> list[DwellRow]:
        """Rows of the planned dwells; their biases are zero, and what the table lacks is NaN."""
        last = self._rows[-1]
        time_s, set_c, power, up_body = _inputs(plan, last)
        course = self.thermal.course(time_s, set_c, power, up_body, self._start)
        power_on_s, is_on = plan.start_s - plan.state.since_power_on_s, plan.state.powered
        found = []
        for step in plan.steps:
            if isinstance(step, PowerStep):
                power_on_s = step.start_s if step.on and not is_on else power_on_s
                is_on = step.on
            elif isinstance(step, DwellStep):
                found.append(self._row(step, course, step.start_s - power_on_s))
        return found

    def _row(self, step: DwellStep, course: Course, since_power_on_s: float) -> DwellRow:
        last, duration_s = self._rows[-1], step.end_s - step.start_s
        edges_s = np.array([step.start_s]), np.array([step.end_s])

        def mean(values: FloatArray, like: float | Triple) -> FloatArray:
            known = np.isfinite(np.mean(like))
            return course.means(values, *edges_s)[0] if known else np.full(values.shape[1:], math.nan)

        ends_c = [np.interp([step.start_s, step.end_s], course.time_s, each) for each in course.optics_c.T]
        return DwellRow(
            unit=last.unit,
            run=step.run,
            dwell=step.dwell,
            cycle=step.cycle,
            position=step.position,
            start_s=step.start_s,
            end_s=step.end_s,
            since_power_on_s=since_power_on_s,
            gyro_c=_triple(mean(course.optics_c, last.gyro_c)),
            gyro_rate_c_per_h=_triple([(end - begin) / duration_s * _S_PER_H for begin, end in ends_c]),
            bias_dph=(0.0, 0.0, 0.0),
            sigma_dph=_triple(self._sigma_dph * math.sqrt(self._typical_s / duration_s)),
            azimuth_deg=step.azimuth_deg if math.isfinite(last.azimuth_deg) else math.nan,
            chamber_set_c=float(mean(course.air_c, last.chamber_set_c)),
            chamber_c=float(mean(course.air_c, last.chamber_c)),
            case_c=float(mean(course.case_c, last.case_c)),
            board_c=_triple(mean(course.electronics_c, last.board_c)),
        )


def _inputs(plan: BlockPlan, last: DwellRow) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Times (m,), set point, power, and Up in body axes (m, 3), over a block."""
    begin_s = min(last.end_s, plan.start_s)
    count = min(max(round((plan.steps[-1].end_s - begin_s) / _STEP_S), 2), _MAX_STEPS)
    time_s = np.linspace(begin_s, plan.steps[-1].end_s, count + 1)
    first_c = last.chamber_set_c if np.isfinite(last.chamber_set_c) else last.chamber_c
    set_c, power = np.full_like(time_s, first_c), np.full_like(time_s, float(plan.state.powered))
    if plan.start_s > begin_s:  # from the last dwell to the state before the first step
        start_c = first_c if plan.state.chamber_c is None else plan.state.chamber_c
        set_c = np.interp(time_s, [begin_s, plan.start_s], [first_c, start_c])
    up_body = np.tile(POSITIONS[plan.state.position].C_nb()[2], (len(time_s), 1))
    for step in plan.steps:
        later = time_s >= step.start_s
        if isinstance(step, PowerStep):
            power[later] = (step.factor or 1.0) if step.on else 0.0
        elif isinstance(step, ChamberStep):
            first_c = float(set_c[later][0])
            set_c[later] = np.interp(time_s[later], [step.start_s, step.end_s], [first_c, step.to_c])
        elif isinstance(step, DwellStep):
            up_body[later] = POSITIONS[step.position].C_nb()[2]
    return time_s, set_c, power, up_body


def _triple(values: FloatArray | Sequence[float]) -> Triple:
    x, y, z = map(float, values)
    return x, y, z
