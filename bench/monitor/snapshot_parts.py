"""Parts of a snapshot that follow from the plan and the tables of a run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields

import numpy as np

from gyrobench.bench.bias.bins import bin_biases
from gyrobench.bench.bias.dwell_table import DwellRow
from gyrobench.bench.foundations.arrays import FloatArray
from gyrobench.bench.foundations.text import flag_text
from gyrobench.bench.monitor.snapshot import (
    MAX_MEASURED,
    MAX_PLANNED,
    LiveBin,
    MeasuredProfile,
    PlannedProfile,
    PositionSpan,
    SnapshotDwell,
)
from gyrobench.bench.procedure.plan import Plan
from gyrobench.bench.procedure.timeline import position_spans, temperature_profile


def planned_profile(plan: Plan) -> PlannedProfile:
    """Planned temperatures and positions."""
    time_s, chamber_c, gyro_c = (_evenly_chosen(each, MAX_PLANNED) for each in temperature_profile(plan))
    spans = []
    for start_s, end_s, name in position_spans(plan):
        dwells = (each.dwell for each in plan.steps if start_s <= each.start_s < end_s and each.dwell)
        spans.append(PositionSpan(float(start_s), float(end_s), name, tuple(dict.fromkeys(dwells))))
    return PlannedProfile(time_s, chamber_c, gyro_c, tuple(spans))


def profile_of_telemetry(telemetry: Mapping[str, FloatArray]) -> MeasuredProfile:
    """Profile of a run from its telemetry, whose columns have the names of its series."""
    return MeasuredProfile(
        *(_evenly_chosen(telemetry[each.name], MAX_MEASURED) for each in fields(MeasuredProfile))
    )


def _evenly_chosen(values: FloatArray, max_count: int) -> tuple[float, ...]:
    """At most ``max_count`` values, evenly chosen, with the first and the last."""
    if len(values) > max_count:
        values = values[np.linspace(0, len(values) - 1, max_count).round().astype(int)]
    return tuple(map(float, values))


def snapshot_dwells(rows: Sequence[DwellRow]) -> tuple[SnapshotDwell, ...]:
    """Summary of each dwell."""
    return tuple(
        SnapshotDwell(
            row.dwell, row.cycle, row.position, row.gyro_c, row.bias_dph, row.sigma_dph, flag_text(row.flags)
        )
        for row in rows
    )


def live_bins(rows: Sequence[DwellRow], width_c: float) -> tuple[LiveBin, ...]:
    """Bins of the dwells without flags, including empty bins between them."""
    return tuple(
        LiveBin(row.gyro, row.position, row.bin_low_c, row.bin_high_c, row.bias_dph, row.sigma_dph, row.count)
        for row in bin_biases([each for each in rows if not each.flags], width_c)
    )
