"""Temperatures of a run as a view shows them: by plan, and as they were."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from gyrobench.bench.foundations.arrays import FloatArray
from gyrobench.bench.live.picture import MOST_MEASURED, MOST_PLANNED
from gyrobench.bench.live.picture_parts import MeasuredProfile, PlannedProfile, PositionSpan
from gyrobench.bench.procedure.plan import Plan
from gyrobench.bench.procedure.timeline import position_spans, temperature_profile

#: Columns of the telemetry that make a measured profile, in its order.
COLUMNS = ("time_s", "chamber_set_c", "chamber_c", "gyro_x_c", "gyro_y_c", "gyro_z_c")


def planned_profile(plan: Plan) -> PlannedProfile:
    """Temperatures and positions that a plan expects."""
    time_s, chamber_c, gyro_c = (_thinned(each, MOST_PLANNED) for each in temperature_profile(plan))
    spans = tuple(PositionSpan(float(start), float(end), name) for start, end, name in position_spans(plan))
    return PlannedProfile(time_s, chamber_c, gyro_c, spans)


def measured_profile(rows: Sequence[tuple[float, ...]]) -> MeasuredProfile:
    """Profile from rows in the order of its series."""
    return (
        MeasuredProfile(*(tuple(series) for series in zip(*rows, strict=True))) if rows else MeasuredProfile()
    )


def profile_of_telemetry(telemetry: Mapping[str, FloatArray]) -> MeasuredProfile:
    """Profile of a run that has been recorded."""
    return MeasuredProfile(*(_thinned(telemetry[name], MOST_MEASURED) for name in COLUMNS))


def _thinned(values: FloatArray, most: int) -> tuple[float, ...]:
    """So many values at most, evenly chosen, with the first and the last."""
    if len(values) > most:
        values = values[np.linspace(0, len(values) - 1, most).round().astype(int)]
    return tuple(map(float, values))
