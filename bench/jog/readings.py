"""The readings of the bench as text: on one screen, or on one line."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from gyrobench.bench.engine.live_bench import LiveBench
from gyrobench.bench.foundations.arrays import FloatArray
from gyrobench.bench.jog.manual_limits import ManualLimits
from gyrobench.bench.navigation.positions import POSITIONS
from gyrobench.drivers.ins.ins_status import InsStatus
from gyrobench.drivers.ins.readout import Alignment, InsMode

#: Cosine of the largest tilt at which the unit counts as in a position.
_MIN_COSINE = math.cos(math.radians(0.1))


def readings(bench: LiveBench, tripped: Sequence[str]) -> list[str]:
    """All readings of the instruments, in lines of at most 80 columns."""
    now = bench.readings
    angles, rates = bench.table_angles(), bench.station.table_axes_of(now.table.rate_dps)
    servo = "servos closed" if now.table.is_servoed else "servos open"
    single = bench.station.file.rate_table.is_single_axis
    lines = [
        f"Table      {name} {angle:9.4f} deg  {rate:8.4f} deg/s"
        for name, angle, rate in zip(("outer", "inner"), angles, rates, strict=True)
        if not (single and name == "outer")
    ]
    lines.append(f"           {servo}; the unit is {_position(bench)}")
    chamber = now.chamber
    lines.append(
        f"Chamber    air {chamber.temperature_c:.1f} degC, set point {_known(chamber.set_point_c, '.1f')}"
        f"{_switched(chamber.is_on)}"
    )
    lines += _ins_lines(now.ins)
    lines.append(f"Faults     {'; '.join([*now.table_faults, *now.chamber_alarms]) or 'none'}")
    lines.append(f"Interlocks {', '.join(tripped) or 'none tripped'}")
    return lines


def _ins_lines(ins: InsStatus) -> list[str]:
    if not math.isfinite(ins.age_s):
        return ["INS        sends no frames"]
    velocity = (
        f"{name} {_known(each, '+.4f')}" for name, each in zip("ENU", ins.velocity_enu_mps, strict=True)
    )
    return [
        f"INS        {mode_words(ins)}, last frame {ins.age_s:.1f} s ago",
        f"           velocity   {'  '.join(velocity)} m/s",
        f"           gyros      {_xyz(ins.optics_c)} degC, case {_known(ins.case_c, '.1f')} degC",
        f"           boards     {_xyz(ins.electronics_c)} degC",
    ]


def watch_line(bench: LiveBench) -> str:
    """The readings that change, on one line of at most 80 columns."""
    now = bench.readings
    outer, inner = bench.table_angles()
    ins = now.ins
    velocity = " ".join(_known(each, "+.3f") for each in ins.velocity_enu_mps[:2])
    return (
        f"{now.asked_s:6.0f} s {outer:8.3f} {inner:8.3f} deg  air {now.chamber.temperature_c:5.1f}  "
        f"gyros {_known(float(np.mean(ins.optics_c)), '5.1f')}  {velocity}  {_short_mode(ins)}"
    )


def _position(bench: LiveBench) -> str:
    C_nb = bench.station.table.attitude(*bench.table_angles())
    for name, position in POSITIONS.items():
        if C_nb[2, position.up_axis] * position.up_sign > _MIN_COSINE:
            return f"in {name}, azimuth {_azimuth_deg(C_nb, position.C_nb()):.2f} deg"
    return "in none of the six positions"


def limit_lines(limits: ManualLimits) -> list[str]:
    """The limits of commands, one line an axis and one for the chamber."""
    lines = [
        f"{name:8} {axis.low_deg:g} to {axis.high_deg:g} deg, at most {axis.rate_dps:g} deg/s"
        for name, axis in limits.axes.items()
    ]
    air = f"{limits.low_c:g} to {limits.high_c:g} degC, at most {limits.ramp_c_per_min:g} degC/min"
    return [*lines, f"{'chamber':8} {air}"]


def mode_words(ins: InsStatus) -> str:
    """Mode and alignment of the INS, in words."""
    if ins.mode is InsMode.UNKNOWN:
        return "mode unknown"
    aligned = {
        Alignment.NONE: ", not aligned",
        Alignment.COARSE: ", coarsely aligned",
        Alignment.FINE: ", finely aligned",
    }
    return f"{ins.mode.name.lower()}{aligned.get(ins.alignment, '')}"


def _short_mode(ins: InsStatus) -> str:
    return "silent" if not math.isfinite(ins.age_s) else ins.mode.name.lower()


def _azimuth_deg(C_nb: FloatArray, C_zero: FloatArray) -> float:
    turn = C_nb @ C_zero.T
    return math.degrees(math.atan2(turn[1, 0], turn[0, 0])) % 360.0


def _known(value: float | None, form: str) -> str:
    return "-" if value is None or not math.isfinite(value) else format(value, form)


def _xyz(values: FloatArray) -> str:
    return "  ".join(
        f"{axis} {_known(float(value), '.2f')}" for axis, value in zip("xyz", values, strict=True)
    )


def _switched(is_on: bool | None) -> str:
    return {True: " degC, on", False: " degC, off", None: " degC"}[is_on]
