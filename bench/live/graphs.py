"""What a view draws: profile, position, the dwell under way, and the bins that fill."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Sequence

from rich.text import Text

from gyrobench.bench.live.axes_drawing import axes_drawing
from gyrobench.bench.live.directions import directions
from gyrobench.bench.live.picture import Picture
from gyrobench.bench.live.picture_parts import FillingBin, WindowTrace
from gyrobench.bench.live.plot import Curve, plot
from gyrobench.bench.navigation.positions import POSITIONS
from gyrobench.bench.procedure.timeline import hours_minutes

_CHAMBER, _GYRO, _NORTH = "cyan", "yellow", "magenta"
_AXES_WIDTH = 24
#: Up to so many rows the drawing of the axes needs for itself.
_WITHOUT_ANGLES = 8
_ARCSEC = 3600.0
_BIN_LABEL_WIDTH, _BIN_WIDTH = 11, 11
_LEAST_C, _LEAST_MMPS, _LEAST_ARCSEC = 4.0, 0.5, 0.5


def profile_graph(picture: Picture, width: int, height: int, is_ascii: bool) -> list[Text]:
    """Temperatures as they were until now, and by plan from now on."""
    measured, planned = picture.measured, picture.planned
    end_s = max(picture.now_s + picture.left_s, picture.now_s, 1.0)
    to_come = [index for index, time_s in enumerate(planned.time_s) if time_s >= picture.plan_now_s]
    future_s = [planned.time_s[index] + picture.behind_s for index in to_come]
    curves = [
        Curve(future_s, [planned.chamber_c[index] for index in to_come], _CHAMBER, is_dotted=True),
        Curve(future_s, [planned.gyro_c[index] for index in to_come], _GYRO, is_dotted=True),
        Curve(measured.time_s, measured.chamber_c, _CHAMBER, "c"),
        Curve(measured.time_s, measured.gyro_x_c, _GYRO, "g"),
    ]
    title = Text.assemble(
        ("  degC  ", "dim"),
        ("c chamber", _CHAMBER),
        "  ",
        ("g gyro x", _GYRO),
        ("  from now on: plan", "dim"),
    )
    labels = ("0:00", f"{hours_minutes(end_s)} h")
    now = None if picture.state.is_over else picture.now_s
    return [title, *plot(curves, width, height - 1, (0.0, end_s), labels, _LEAST_C, is_ascii, now)]


def dwell_graphs(picture: Picture, width: int, height: int, is_ascii: bool) -> list[Text]:
    """Position, velocity and heading side by side."""
    each = (width - _AXES_WIDTH - 2) // 2
    windows = picture.dwell.windows if picture.dwell else ()
    position = _position(picture, height, is_ascii)
    if not windows:
        why = "the INS has not navigated yet" if picture.dwell else "no dwell is under way"
        return _beside([position, [Text(why, "dim")]], (_AXES_WIDTH, 2 * each + 1), height)
    velocity = _velocity(windows, each, height, is_ascii)
    heading = _heading(windows, each, height, is_ascii)
    return _beside([position, velocity, heading], (_AXES_WIDTH, each, each), height)


def bins_table(picture: Picture, height: int, plus_minus: str) -> list[Text]:
    """The X gyro's bins, those nearest to its temperature; nothing while all are empty."""
    bins = [each for each in picture.bins if each.gyro == "x"]
    filled = {(each.low_c, each.high_c) for each in bins if each.count}
    if not filled or height < 2:
        return []
    now_c = picture.bench.gyro_c[0] if picture.bench else math.nan
    nearest = sorted(filled, key=lambda ends: abs(ends[0] - now_c) if math.isfinite(now_c) else ends[0])
    positions = [name for name in POSITIONS if any(each.position == name for each in bins)]
    head = f"{'x gyro, C':<{_BIN_LABEL_WIDTH}}" + "".join(f"{name:>{_BIN_WIDTH}}" for name in positions)
    rows = [_bin_row(bins, ends, positions, plus_minus) for ends in sorted(nearest[: height - 1])]
    return [Text(head, "dim"), *rows]


def _bin_row(
    bins: Sequence[FillingBin], ends: tuple[float, float], positions: Sequence[str], plus_minus: str
) -> Text:
    row = Text(f"{f'{ends[0]:g}..{ends[1]:g}':<{_BIN_LABEL_WIDTH}}")
    for name in positions:
        (one,) = (each for each in bins if each.position == name and each.low_c == ends[0])
        text = f"{1e3 * one.bias_dph:z.1f}{plus_minus}{1e3 * one.sigma_dph:.1f}" if one.count else "."
        row.append(f"{text:>{_BIN_WIDTH}}", "" if one.count else "dim")
    return row


def _position(picture: Picture, height: int, is_ascii: bool) -> list[Text]:
    attitude = picture.attitude
    if attitude is None:
        return [Text("the table is unknown", "dim")]
    azimuth = "" if math.isnan(attitude.azimuth_deg) else f" at {attitude.azimuth_deg:g} deg"
    title = Text(f"{attitude.position}{azimuth}" if attitude.position else "no position yet", "bold")
    words = textwrap.wrap(directions(attitude), _AXES_WIDTH, break_on_hyphens=False)
    below = [Text(line, "dim") for line in words]
    if picture.bench and height > _WITHOUT_ANGLES:
        angles = f"{picture.bench.outer_deg:.2f}, {picture.bench.inner_deg:.2f}"
        below.append(Text(f"table {angles}", "dim"))
    drawing = axes_drawing(attitude, _AXES_WIDTH, height - 1 - len(below), is_ascii)
    return [title, *drawing, *below]


def _velocity(windows: Sequence[WindowTrace], width: int, height: int, is_ascii: bool) -> list[Text]:
    time_s, end_s = _joined_time_s(windows)
    east = [1e3 * value for window in windows for value in (*window.velocity_east_mps, math.nan)]
    north = [1e3 * value for window in windows for value in (*window.velocity_north_mps, math.nan)]
    curves = [Curve(time_s, east, _CHAMBER, "E"), Curve(time_s, north, _NORTH, "N")]
    title = Text.assemble(("mm/s  ", "dim"), ("E East", _CHAMBER), "  ", ("N North", _NORTH))
    labels = ("0", f"{end_s / 60.0:.2g} min")
    return [title, *plot(curves, width, height - 1, (0.0, end_s), labels, _LEAST_MMPS, is_ascii)]


def _heading(windows: Sequence[WindowTrace], width: int, height: int, is_ascii: bool) -> list[Text]:
    time_s, end_s = _joined_time_s(windows)
    change = [_ARCSEC * value for window in windows for value in (*window.heading_change_deg, math.nan)]
    title = Text("change of heading, arcsec", "dim")
    labels = ("0", f"{end_s / 60.0:.2g} min")
    curves = [Curve(time_s, change, _GYRO, "H")]
    return [title, *plot(curves, width, height - 1, (0.0, end_s), labels, _LEAST_ARCSEC, is_ascii)]


def _joined_time_s(windows: Sequence[WindowTrace]) -> tuple[list[float], float]:
    """Times of all windows one after the other, broken between them, and the end of the last."""
    time_s: list[float] = []
    begin_s = 0.0
    for window in windows:
        time_s += [*(begin_s + each for each in window.time_s), math.nan]
        begin_s += max(window.planned_s, *window.time_s[-1:], 1.0)
    return time_s, begin_s or 1.0


def _beside(blocks: Sequence[Sequence[Text]], widths: Sequence[int], height: int) -> list[Text]:
    lines = []
    for number in range(height):
        line = Text()
        for block, width in zip(blocks, widths, strict=True):
            part = block[number].copy() if number < len(block) else Text()
            part.truncate(width, pad=True)
            line = Text.assemble(line, " ", part) if line else part
        lines.append(line)
    return lines
