"""The live view as lines of text; with little room, the most important parts only."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Sequence

from rich.text import Text

from gyrobench.bench.foundations.text import counted, hours_minutes
from gyrobench.bench.monitor.snapshot import (
    UNKNOWN,
    BenchReadings,
    LiveBias,
    LiveBin,
    NumberTriple,
    RunSnapshot,
    RunState,
    UnitStatus,
    WindowTrace,
    mean_known,
)
from gyrobench.bench.monitor.terminal_plot import PlotCurve, attitude_lines, plot
from gyrobench.bench.navigation.positions import AXES, POSITIONS

_STATE_STYLES = {
    RunState.STARTING: "bold cyan",
    RunState.RUNNING: "bold green",
    RunState.HOLDING: "bold yellow",
    RunState.PAUSED: "bold yellow",
    RunState.WAITING: "bold red",
    RunState.FINISHED: "bold green",
    RunState.STOPPED: "bold red",
    RunState.FAILED: "bold red",
}
_ALARM_STYLE = "bold red"
#: Largest number of lines of an alarm, a reason or a question.
_MAX_TEXT_LINES = 3
#: Readings older than this are marked.
_STALE_S = 30.0


def _headline(snapshot: RunSnapshot, width: int) -> Text:
    """Name, unit or number of units, state, and time remaining."""
    unit = f", unit {snapshot.unit}" if snapshot.unit else ""
    if snapshot.units:
        unit = f", {counted(len(snapshot.units), 'unit')}"
    times = f"{hours_minutes(snapshot.now_s)} h"
    if not snapshot.state.is_over:
        times += f", {hours_minutes(snapshot.left_s)} h left"
    right = Text.assemble((snapshot.state.upper(), _STATE_STYLES[snapshot.state]), f"  {times}")
    left = Text(f"{snapshot.name}{unit}", "bold")
    left.truncate(max(0, width - len(right) - 2), overflow="ellipsis", pad=True)
    return Text.assemble(left, "  ", right)


def _attention(snapshot: RunSnapshot, width: int) -> list[Text]:
    """Alarms, the reason why the run does not continue, and the open question; empty if there are none."""
    lines: list[Text] = []
    question = snapshot.question.text if snapshot.question else ""
    # Active alarms already state the reason of a hold.
    is_repeated = snapshot.reason in question or (snapshot.alarms and snapshot.state is not RunState.PAUSED)
    if snapshot.reason and not (is_repeated and not snapshot.state.is_over):
        lines += _wrap(snapshot.reason, width, "", "bold")
    for alarm in snapshot.alarms:
        if alarm.text not in question:
            lines += _wrap(f"{alarm.name.replace('_', ' ')}: {alarm.text}", width, "ALARM ", _ALARM_STYLE)
    if snapshot.question:
        lines += _wrap(question, width, "", _ALARM_STYLE)
        lines.append(Text(f"Type one of: {', '.join(snapshot.question.answers)}", _ALARM_STYLE))
    return lines


def _step_line(snapshot: RunSnapshot) -> Text:
    """The current step and its elapsed time."""
    step = snapshot.step
    if step is None:
        return Text("no step in progress", "dim")
    number_text = f"{'returning to ' if step.is_return else ''}step {step.number}/{step.count}"
    elapsed_s = max(0.0, snapshot.now_s - step.started_s)
    label = f"{step.label}: " if step.label else ""
    return Text.assemble(
        f"{number_text}  {label}",
        (step.description, "bold"),
        f"  {_duration_text(elapsed_s)} of {_duration_text(step.planned_s)}" if step.planned_s >= 1.0 else "",
    )


def _readings_line(bench: BenchReadings) -> Text:
    """Temperatures and mode of the INS; stale readings are marked with their age."""
    set_c = "off" if math.isnan(bench.chamber_set_c) else f"set {bench.chamber_set_c:.1f}"
    parts = [
        f"chamber {_temperature_text(bench.chamber_c)}, {set_c}{_stale_text(bench.chamber_age_s)}",
        f"INS {bench.ins_mode}{_stale_text(bench.ins_age_s)}",
        f"table{table_age}" if (table_age := _stale_text(bench.table_age_s)) else "",
        f"gyros {' '.join(map(_temperature_text, bench.gyro_c))} degC",
    ]
    return Text("  ".join(part for part in parts if part))


def _bias_line(snapshot: RunSnapshot, plus_minus: str) -> Text:
    """The live estimate of the current dwell."""
    dwell, live = snapshot.dwell, snapshot.live_bias
    if dwell is None:
        skipped = f" ({len(snapshot.skipped)} skipped)" if snapshot.skipped else ""
        count = f"{snapshot.finished_dwells} of {snapshot.dwell_count}{skipped}"
        return Text(f"dwells measured: {count}, biases in 0.001 deg/h", "dim")
    head = f"dwell {dwell.number}/{dwell.count}  "
    if live is None:
        return Text.assemble(head, ("bias observable after the turn", "dim"))
    return Text.assemble(head, (_biases(live, plus_minus), "bold"), "  0.001 deg/h")


def _biases(estimate: LiveBias | UnitStatus, plus_minus: str) -> str:
    """Bias of each gyro, in 0.001 deg/h."""
    values = zip(AXES, estimate.bias_dph, estimate.sigma_dph, strict=True)
    return "  ".join(
        f"{axis} {1e3 * bias:+z.2f}{plus_minus}{1e3 * sigma:.2f}" for axis, bias, sigma in values
    )


def _unit_lines(snapshot: RunSnapshot, plus_minus: str) -> list[Text]:
    """A line for each unit: number of dwells, biases of the newest dwell, or why the unit was dropped."""
    lines = []
    for unit in snapshot.units:
        head = f"unit {unit.number:<8}{unit.dwells:>4} dwells  "
        if unit.dropped:
            lines.append(Text.assemble(head, (f"dropped: {unit.dropped}", _ALARM_STYLE)))
            continue
        result = "flagged" if unit.flags else _biases(unit, plus_minus) if unit.position else ""
        lines.append(Text.assemble(head, f"{unit.ins_mode:<9} ", result))
    return lines


def _sigma_line(estimates: tuple[LiveBias, ...], width: int, is_ascii: bool) -> Text:
    """History of the largest uncertainty of the three gyros."""
    sigmas = [1e3 * max(each.sigma_dph) for each in estimates if all(map(math.isfinite, each.sigma_dph))]
    if not sigmas:
        return Text("sigma unknown", "dim")
    head, tail = f"sigma {sigmas[0]:.1f} ", f" {sigmas[-1]:.1f}"
    room = max(1, width - len(head) - len(tail))
    chosen = sigmas[:: max(1, math.ceil(len(sigmas) / room))]
    marks = "_.-=^" if is_ascii else "▁▂▃▄▅▆▇█"
    largest = max(chosen)
    bars = "".join(marks[min(len(marks) - 1, int(len(marks) * each / largest))] for each in chosen)
    return Text.assemble((head, "dim"), (bars, "cyan"), (tail, "dim"))


def _wrap(text: str, width: int, head: str, style: str) -> list[Text]:
    lines = textwrap.wrap(head + text, width, subsequent_indent=" " * len(head))
    if len(lines) > _MAX_TEXT_LINES:
        lines = [*lines[: _MAX_TEXT_LINES - 1], lines[_MAX_TEXT_LINES - 1][: width - 4] + " ..."]
    return [Text(line, style) for line in lines]


def _duration_text(time_s: float) -> str:
    """Duration in minutes and seconds, or in hours and minutes from one hour on."""
    if time_s >= 3600.0:
        return f"{hours_minutes(time_s)} h"
    return f"{int(time_s) // 60}:{int(time_s) % 60:02d}"


def _temperature_text(value_c: float) -> str:
    return "-" if math.isnan(value_c) else f"{value_c:.1f}"


def _stale_text(age_s: float) -> str:
    if math.isnan(age_s):
        return " (no data)"
    return f" ({age_s:.0f} s old)" if age_s > _STALE_S else ""


_CHAMBER_STYLE, _GYRO_STYLE, _NORTH_STYLE = "cyan", "yellow", "magenta"
_AXES_WIDTH = 24
#: With at most this number of rows the angles of the table are omitted.
_MAX_ROWS_WITHOUT_ANGLES = 8
_ARCSEC_PER_DEG = 3600.0
_BIN_LABEL_WIDTH, _BIN_WIDTH = 11, 11
_MIN_BIN_ROWS = 1 + len(AXES)
_MIN_SPAN_C, _MIN_SPAN_MMPS, _MIN_SPAN_ARCSEC = 4.0, 0.5, 0.5


def _profile_graph(snapshot: RunSnapshot, width: int, height: int, is_ascii: bool) -> list[Text]:
    """Measured temperatures until now, and planned ones from now on."""
    measured, planned = snapshot.measured, snapshot.planned
    end_s = max(snapshot.now_s + snapshot.left_s, snapshot.now_s, 1.0)
    future = [index for index, time_s in enumerate(planned.time_s) if time_s >= snapshot.plan_now_s]
    future_s = [planned.time_s[index] + snapshot.behind_s for index in future]
    curves = [
        PlotCurve(future_s, [planned.chamber_c[index] for index in future], _CHAMBER_STYLE, is_dotted=True),
        PlotCurve(future_s, [planned.gyro_c[index] for index in future], _GYRO_STYLE, is_dotted=True),
        PlotCurve(measured.time_s, measured.chamber_c, _CHAMBER_STYLE, "c"),
        PlotCurve(measured.time_s, measured.gyro_x_c, _GYRO_STYLE, "g"),
    ]
    title = Text.assemble(
        ("  degC  ", "dim"),
        ("c chamber", _CHAMBER_STYLE),
        "  ",
        ("g gyro x", _GYRO_STYLE),
        ("  from now on: plan", "dim"),
    )
    labels = ("0:00", f"{hours_minutes(end_s)} h")
    mark_s = None if snapshot.state.is_over else snapshot.now_s
    return [title, *plot(curves, width, height - 1, (0.0, end_s), labels, _MIN_SPAN_C, is_ascii, mark_s)]


def _dwell_graphs(snapshot: RunSnapshot, width: int, height: int, is_ascii: bool) -> list[Text]:
    """Position, velocity and heading side by side."""
    graph_width = (width - _AXES_WIDTH - 2) // 2
    windows = snapshot.dwell.windows if snapshot.dwell else ()
    position = _position_block(snapshot, height, is_ascii)
    if not windows:
        note = "the INS is not navigating yet" if snapshot.dwell else "no dwell in progress"
        return _side_by_side([position, [Text(note, "dim")]], (_AXES_WIDTH, 2 * graph_width + 1), height)
    time_s, end_s = _joined_time_s(windows)

    def graph(title: Text, values: dict[str, tuple[str, list[float]]], min_span: float) -> list[Text]:
        curves = [PlotCurve(time_s, series, style, letter) for letter, (style, series) in values.items()]
        labels = ("0", f"{end_s / 60.0:.2g} min")
        return [title, *plot(curves, graph_width, height - 1, (0.0, end_s), labels, min_span, is_ascii)]

    east = [1e3 * value for window in windows for value in (*window.velocity_east_mps, math.nan)]
    north = [1e3 * value for window in windows for value in (*window.velocity_north_mps, math.nan)]
    change = [
        _ARCSEC_PER_DEG * value for window in windows for value in (*window.heading_change_deg, math.nan)
    ]
    title = Text.assemble(("mm/s  ", "dim"), ("E East", _CHAMBER_STYLE), "  ", ("N North", _NORTH_STYLE))
    velocity = graph(title, {"E": (_CHAMBER_STYLE, east), "N": (_NORTH_STYLE, north)}, _MIN_SPAN_MMPS)
    heading = graph(Text("change of heading, arcsec", "dim"), {"H": (_GYRO_STYLE, change)}, _MIN_SPAN_ARCSEC)
    return _side_by_side([position, velocity, heading], (_AXES_WIDTH, graph_width, graph_width), height)


def _bins_table(snapshot: RunSnapshot, height: int, plus_minus: str) -> list[Text]:
    """Bins nearest to the temperature of the gyros, with all three gyros, for as many units as fit.

    Empty while all bins are empty.
    """
    tables = _filled_tables(snapshot)[: height // _MIN_BIN_ROWS]
    return [
        line
        for head, gyro_c, bins in tables
        for line in _unit_bins(head, mean_known(gyro_c), bins, height // len(tables), plus_minus)
    ]


def _filled_tables(snapshot: RunSnapshot) -> list[tuple[str, NumberTriple, list[LiveBin]]]:
    """Name, present temperatures and filled bins of each measured unit that has filled bins."""
    gyro_c = snapshot.bench.gyro_c if snapshot.bench else UNKNOWN
    tables = [(unit.number, unit.gyro_c, unit.bins) for unit in snapshot.units if not unit.dropped]
    filled = [
        (name, now_c, [each for each in bins if each.count])
        for name, now_c, bins in tables or [("gyro", gyro_c, snapshot.bins)]
    ]
    return [table for table in filled if table[-1]]


def _unit_bins(head: str, now_c: float, bins: list[LiveBin], height: int, plus_minus: str) -> list[Text]:
    """Table of the bins of one unit, those nearest to its temperature."""
    nearest = sorted(
        _ranges(bins), key=lambda ends: abs(sum(ends) / 2.0 - now_c) if math.isfinite(now_c) else ends[0]
    )
    positions = [name for name in POSITIONS if any(each.position == name for each in bins)]
    title = f"{f'{head}, C':<{_BIN_LABEL_WIDTH}}" + "".join(f"{name:>{_BIN_WIDTH}}" for name in positions)
    ranges = sorted(nearest[: (height - 1) // len(AXES)])
    rows = [_bin_row(bins, gyro, ends, positions, plus_minus) for ends in ranges for gyro in AXES]
    return [Text(title, "dim"), *rows]


def _ranges(bins: Sequence[LiveBin]) -> set[tuple[float, float]]:
    return {(each.low_c, each.high_c) for each in bins}


def _bin_row(
    bins: Sequence[LiveBin], gyro: str, ends: tuple[float, float], positions: Sequence[str], plus_minus: str
) -> Text:
    """Biases of one gyro in one temperature bin, for each position."""
    row = Text(f"{f'{gyro} {ends[0]:g}..{ends[1]:g}':<{_BIN_LABEL_WIDTH}}")
    by_position = {each.position: each for each in bins if each.gyro == gyro and each.low_c == ends[0]}
    for name in positions:
        bin_ = by_position.get(name)
        text = f"{1e3 * bin_.bias_dph:z.1f}{plus_minus}{1e3 * bin_.sigma_dph:.1f}" if bin_ else "."
        row.append(f"{text:>{_BIN_WIDTH}}", "" if bin_ else "dim")
    return row


def _position_block(snapshot: RunSnapshot, height: int, is_ascii: bool) -> list[Text]:
    """Position, drawing of the axes and angles of the table."""
    attitude = snapshot.attitude
    if attitude is None:
        return [Text("table angles unknown", "dim")]
    azimuth = "" if math.isnan(attitude.azimuth_deg) else f" at {attitude.azimuth_deg:g} deg"
    title = Text(f"{attitude.position}{azimuth}" if attitude.position else "no position", "bold")
    words = textwrap.wrap(attitude.directions(), _AXES_WIDTH, break_on_hyphens=False)
    lines_below = [Text(line, "dim") for line in words]
    if snapshot.bench and height > _MAX_ROWS_WITHOUT_ANGLES:
        angles = f"{snapshot.bench.outer_deg:.2f}, {snapshot.bench.inner_deg:.2f}"
        lines_below.append(Text(f"table {angles}", "dim"))
    drawing = attitude_lines(attitude, _AXES_WIDTH, height - 1 - len(lines_below), is_ascii)
    return [title, *drawing, *lines_below]


def _joined_time_s(windows: Sequence[WindowTrace]) -> tuple[list[float], float]:
    """Times of all windows in sequence, with NaN between windows, and the end of the last window."""
    time_s: list[float] = []
    begin_s = 0.0
    for window in windows:
        time_s += [*(begin_s + each for each in window.time_s), math.nan]
        begin_s += max(window.planned_s, *window.time_s[-1:], 1.0)
    return time_s, begin_s or 1.0


def _side_by_side(blocks: Sequence[Sequence[Text]], widths: Sequence[int], height: int) -> list[Text]:
    """Lines of blocks in columns of these widths."""
    lines = []
    for index in range(height):
        line = Text()
        for block, width in zip(blocks, widths, strict=True):
            cell = block[index].copy() if index < len(block) else Text()
            cell.truncate(width, pad=True)
            line = Text.assemble(line, " ", cell) if line else cell
        lines.append(line)
    return lines


MAX_WIDTH, MAX_HEIGHT = 240, 80
#: Smallest and largest number of rows of the profile and of the dwell.
_PROFILE_ROWS, _DWELL_ROWS = (5, 22), (6, 18)
_MAX_MESSAGE_ROWS = 5


def screen(snapshot: RunSnapshot, width: int, height: int, is_ascii: bool) -> list[Text]:
    """Lines that show a snapshot, at most ``height`` lines of at most ``width`` characters.

    State, time remaining, alarms and the open question are always shown; then, as space permits, step,
    readings, live bias and units, the profile, the dwell with its position, the bins, and messages.
    """
    plus_minus = "+-" if is_ascii else "±"
    top = [_headline(snapshot, width), *_attention(snapshot, width)]
    lines = [_step_line(snapshot)]
    if snapshot.bench:
        lines.append(_readings_line(snapshot.bench))
    bias = [_bias_line(snapshot, plus_minus), *_unit_lines(snapshot, plus_minus)]
    rows = _allocate_rows(height - len(top) - len(lines) - len(bias), snapshot)
    if snapshot.dwell and rows["sigma"]:
        bias.append(_sigma_line(snapshot.dwell.estimates, width, is_ascii))
    if rows["profile"]:
        lines += _profile_graph(snapshot, width, rows["profile"], is_ascii)
    if rows["dwell"]:
        lines += _dwell_graphs(snapshot, width, rows["dwell"], is_ascii)
    lines += [*bias, *_bins_table(snapshot, rows["bins"], plus_minus)]
    newest = snapshot.messages[-rows["messages"] :] if rows["messages"] else ()
    lines += [Text.assemble((f"{hours_minutes(each.time_s):>6s} ", "dim"), each.text) for each in newest]
    shown = [*top, *lines][:height]
    for line in shown:
        line.truncate(width, overflow="ellipsis")
        line.no_wrap = True
    return shown


def _allocate_rows(room: int, snapshot: RunSnapshot) -> dict[str, int]:
    """Number of rows of each part: first the minimum of each, by importance, then up to the maximum."""
    tables = _filled_tables(snapshot)
    max_bin_rows = sum(1 + len(AXES) * len(_ranges(bins)) for _, _, bins in tables)
    row_limits = {
        "profile": _PROFILE_ROWS,
        "dwell": _DWELL_ROWS,
        "bins": (min(_MIN_BIN_ROWS * len(tables), max_bin_rows), max_bin_rows),
        "sigma": (1, 1) if snapshot.dwell and len(snapshot.dwell.estimates) > 1 else (0, 0),
        "messages": (min(1, len(snapshot.messages)), min(_MAX_MESSAGE_ROWS, len(snapshot.messages))),
    }
    rows = dict.fromkeys(row_limits, 0)
    for part, (min_rows, _) in row_limits.items():
        if part == "bins":  # for as many units as fit
            min_rows = min(min_rows, max(room, _MIN_BIN_ROWS))
        if min_rows <= room:
            rows[part] = min_rows
            room -= min_rows
    while room > 0:
        growing = [part for part, (_, max_rows) in row_limits.items() if 0 < rows[part] < max_rows]
        if not growing:
            break
        for part in growing[:room]:
            rows[part] += 1
            room -= 1
    return rows
