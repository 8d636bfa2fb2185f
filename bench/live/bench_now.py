"""Present values of the bench as a view shows them."""

from __future__ import annotations

import math

from gyrobench.bench.engine.live_bench import LiveBench
from gyrobench.bench.live.picture_parts import Alarm, Attitude, BenchNow


def bench_now(bench: LiveBench) -> BenchNow:
    """What the instruments said last, and how old that is."""
    readings, now_s = bench.readings, bench.clock.now()
    outer_deg, inner_deg = bench.table_angles()
    outer_dps, inner_dps = bench.station.table_axes_of(readings.table.rate_dps)
    set_c = bench.commanded_c
    ins_age_s = readings.ins.age_s + now_s - readings.asked_s
    return BenchNow(
        chamber_set_c=math.nan if set_c is None else set_c,
        chamber_c=readings.chamber.temperature_c,
        gyro_c=tuple(readings.ins.optics_c.tolist()),
        electronics_c=tuple(readings.ins.electronics_c.tolist()),
        case_c=readings.ins.case_c,
        outer_deg=outer_deg,
        inner_deg=inner_deg,
        outer_rate_dps=outer_dps,
        inner_rate_dps=inner_dps,
        ins_mode=readings.ins.mode.name.lower(),
        table_age_s=now_s - readings.table_s,
        chamber_age_s=now_s - readings.chamber_s,
        ins_age_s=ins_age_s if math.isfinite(ins_age_s) else math.nan,
    )


def attitude_now(bench: LiveBench, position: str, azimuth_deg: float) -> Attitude:
    """How the unit stands by the table's angles, and where it was sent."""
    east, north, up = bench.station.table.attitude(*bench.table_angles()).tolist()
    return Attitude(position, azimuth_deg % 360.0, (tuple(east), tuple(north), tuple(up)))


def alarms_now(bench: LiveBench) -> tuple[Alarm, ...]:
    """Interlocks that are tripped, and instruments that do not answer."""
    tripped = (Alarm(trip.name, trip.text) for trip in bench.trips())
    silent = (Alarm(name, f"the {name} does not answer; it is asked again") for name in bench.silent)
    return (*tripped, *silent)
