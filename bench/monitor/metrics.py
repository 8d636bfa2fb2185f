"""Metrics of runs for Prometheus: the numbers of their snapshots under documented names with units.

Source of the naming rules: the Prometheus documentation on metric and label naming, and OpenMetrics 1.0.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from types import SimpleNamespace
from typing import TYPE_CHECKING

from gyrobench.bench.foundations.packages import require
from gyrobench.bench.monitor.run_list import verdict_in
from gyrobench.bench.monitor.snapshot import UNKNOWN, RunSnapshot, RunState, UnitStatus
from gyrobench.bench.navigation.positions import AXES
from gyrobench.bench.runs.folder import RunFolder

if TYPE_CHECKING:
    from pathlib import Path

CONTENT_TYPE = "text/plain; version=0.0.4; charset=utf-8"

#: Meaning of each metric by name, and its labels in addition to ``run``, the name of the run folder.
METRICS: dict[str, tuple[str, tuple[str, ...]]] = {
    "gyrobench_run_info": ("Always 1; the labels describe the run.", ("procedure", "station", "unit")),
    "gyrobench_run_state": ("1 for the present state of the run, 0 for the others.", ("state",)),
    "gyrobench_run_age_seconds": ("Time since the run wrote its last snapshot.", ()),
    "gyrobench_run_elapsed_seconds": ("Time since the start, on the run's clock.", ()),
    "gyrobench_run_left_seconds": ("Planned time that remains.", ()),
    "gyrobench_run_behind_plan_seconds": ("Delay behind the plan, as after a hold.", ()),
    "gyrobench_dwells_planned": ("Dwells of the plan.", ()),
    "gyrobench_dwells_measured": ("Dwells completed, with and without flags.", ("unit",)),
    "gyrobench_dwells_flagged": ("Completed dwells with flags.", ("unit",)),
    "gyrobench_temperature_celsius": (
        "Last temperature that a sensor reported, or the set point.",
        ("sensor", "unit"),
    ),
    "gyrobench_table_angle_degrees": ("Last angle of a table axis.", ("axis",)),
    "gyrobench_table_rate_degrees_per_second": ("Last rate of a table axis.", ("axis",)),
    "gyrobench_reply_age_seconds": ("Time since the last reply of an instrument.", ("instrument", "unit")),
    "gyrobench_bias_degrees_per_hour": ("Bias in the last completed dwell.", ("gyro", "position", "unit")),
    "gyrobench_bias_sigma_degrees_per_hour": ("Its standard uncertainty.", ("gyro", "position", "unit")),
    "gyrobench_live_bias_degrees_per_hour": (
        "Present estimate of the dwell in progress; of several units that of the first.",
        ("gyro", "unit"),
    ),
    "gyrobench_live_bias_sigma_degrees_per_hour": ("Its standard uncertainty.", ("gyro", "unit")),
    "gyrobench_unit_dropped": ("1 for a unit of several that is left out of the run, else 0.", ("unit",)),
    "gyrobench_alarm": ("1 for each active alarm: an interlock or an instrument.", ("name",)),
    "gyrobench_verdict": ("1 for the verdict on the unit, after the end of the run.", ("verdict", "unit")),
}


#: Metric, value, and values of its labels except ``run``.
_Sample = tuple[str, float, tuple[str, ...]]


def metrics_text(runs: Iterable[tuple[Path, RunSnapshot, float]]) -> bytes:
    """Metrics of runs in the text format of Prometheus.

    ``runs``: run folder, its snapshot, and the age of that in seconds. Raises MissingPackageError if the
    package prometheus-client is not installed.
    """
    core, exposition = require("prometheus_client.core"), require("prometheus_client.exposition")
    families = {
        name: core.GaugeMetricFamily(name, meaning, labels=("run", *labels))
        for name, (meaning, labels) in METRICS.items()
    }
    for folder, snapshot, age_s in runs:
        for metric, value, labels in _samples(folder, snapshot, age_s):
            if math.isfinite(value):
                families[metric].add_metric((folder.name, *labels), value)
    return bytes(exposition.generate_latest(SimpleNamespace(collect=families.values)))


def _samples(folder: Path, snapshot: RunSnapshot, age_s: float) -> Iterator[_Sample]:
    """All samples of one run."""
    yield "gyrobench_run_info", 1.0, (snapshot.procedure, snapshot.station, snapshot.unit)
    for state in RunState:
        yield "gyrobench_run_state", state is snapshot.state, (state.value,)
    yield "gyrobench_run_age_seconds", age_s, ()
    yield "gyrobench_run_elapsed_seconds", snapshot.now_s, ()
    yield "gyrobench_run_left_seconds", snapshot.left_s, ()
    yield "gyrobench_run_behind_plan_seconds", snapshot.behind_s, ()
    yield "gyrobench_dwells_planned", snapshot.dwell_count, ()
    for alarm in snapshot.alarms:
        yield "gyrobench_alarm", 1.0, (alarm.name,)
    yield from _bench_samples(snapshot)
    for unit in snapshot.units or (_single_unit(snapshot),):
        yield from _unit_samples(unit)
        run = RunFolder(folder).unit(unit.number) if snapshot.units else RunFolder(folder)
        if verdict := verdict_in(run.path):
            yield "gyrobench_verdict", 1.0, (verdict, unit.number)
    for unit in snapshot.units:
        yield "gyrobench_unit_dropped", bool(unit.dropped), (unit.number,)
    if live := snapshot.live_bias:
        for axis, bias_dph, sigma_dph in zip(AXES, live.bias_dph, live.sigma_dph, strict=True):
            labels = (axis, snapshot.unit)
            yield "gyrobench_live_bias_degrees_per_hour", bias_dph, labels
            yield "gyrobench_live_bias_sigma_degrees_per_hour", sigma_dph, labels


def _bench_samples(snapshot: RunSnapshot) -> Iterator[_Sample]:
    """Samples of the instruments' last readings."""
    bench = snapshot.bench
    if bench is None:
        return
    for sensor, value in (("chamber_air", bench.chamber_c), ("chamber_set_point", bench.chamber_set_c)):
        yield "gyrobench_temperature_celsius", value, (sensor, "")
    yield "gyrobench_temperature_celsius", bench.case_c, ("case", snapshot.unit)
    for axis, value in zip(AXES, bench.electronics_c, strict=True):
        yield "gyrobench_temperature_celsius", value, (f"electronics_{axis}", snapshot.unit)
    for axis, angle_deg, rate_dps in (
        ("outer", bench.outer_deg, bench.outer_rate_dps),
        ("inner", bench.inner_deg, bench.inner_rate_dps),
    ):
        yield "gyrobench_table_angle_degrees", angle_deg, (axis,)
        yield "gyrobench_table_rate_degrees_per_second", rate_dps, (axis,)
    for instrument, age_s in (("rate_table", bench.table_age_s), ("chamber", bench.chamber_age_s)):
        yield "gyrobench_reply_age_seconds", age_s, (instrument, "")


def _single_unit(snapshot: RunSnapshot) -> UnitStatus:
    """Status of the unit of a run with a single unit."""
    bench = snapshot.bench
    last = snapshot.dwells[-1] if snapshot.dwells else None
    return UnitStatus(
        number=snapshot.unit,
        ins_mode=bench.ins_mode if bench else "",
        gyro_c=bench.gyro_c if bench else UNKNOWN,
        dwells=snapshot.finished_dwells,
        bias_dph=last.bias_dph if last else UNKNOWN,
        sigma_dph=last.sigma_dph if last else UNKNOWN,
        flags=last.flags if last else "",
        position=last.position if last else "",
        flagged=sum(bool(dwell.flags) for dwell in snapshot.dwells),
        ins_age_s=bench.ins_age_s if bench else math.nan,
    )


def _unit_samples(unit: UnitStatus) -> Iterator[_Sample]:
    """Samples of one unit."""
    yield "gyrobench_dwells_measured", unit.dwells, (unit.number,)
    yield "gyrobench_dwells_flagged", unit.flagged, (unit.number,)
    yield "gyrobench_reply_age_seconds", unit.ins_age_s, ("ins", unit.number)
    values = zip(AXES, unit.gyro_c, unit.bias_dph, unit.sigma_dph, strict=True)
    for axis, gyro_c, bias_dph, sigma_dph in values:
        yield "gyrobench_temperature_celsius", gyro_c, (f"gyro_{axis}", unit.number)
        labels = (axis, unit.position, unit.number)
        yield "gyrobench_bias_degrees_per_hour", bias_dph, labels
        yield "gyrobench_bias_sigma_degrees_per_hour", sigma_dph, labels
