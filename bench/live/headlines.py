"""What a view says in words: state, time left, what is wrong, the step, the present values."""

from __future__ import annotations

import math
import textwrap

from rich.text import Text

from gyrobench.bench.live.picture import Picture, RunState
from gyrobench.bench.live.picture_parts import BenchNow, LiveBias
from gyrobench.bench.navigation.positions import AXES
from gyrobench.bench.procedure.timeline import hours_minutes

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
_ALARM = "bold red"
#: A text that a person has to act on is shown in so many lines at most.
_MOST_LINES = 3
#: Answers older than this are said to be old.
_OLD_S = 30.0


def headline(picture: Picture, width: int) -> Text:
    """Name, unit, state, and time left: what matters most."""
    unit = f", unit {picture.unit}" if picture.unit else ""
    times = f"{hours_minutes(picture.now_s)} h"
    if not picture.state.is_over:
        times += f", {hours_minutes(picture.left_s)} h left"
    right = Text.assemble((picture.state.upper(), _STATE_STYLES[picture.state]), f"  {times}")
    left = Text(f"{picture.name}{unit}", "bold")
    left.truncate(max(0, width - len(right) - 2), overflow="ellipsis", pad=True)
    return Text.assemble(left, "  ", right)


def attention(picture: Picture, width: int) -> list[Text]:
    """What is wrong, why the run does not go on, and what is asked; nothing where all is well."""
    lines: list[Text] = []
    question = picture.question.text if picture.question else ""
    # What led to a hold is told by its alarms, as long as they last.
    is_told = picture.reason in question or (picture.alarms and picture.state is not RunState.PAUSED)
    if picture.reason and not (is_told and not picture.state.is_over):
        lines += _folded(picture.reason, width, "", "bold")
    for alarm in picture.alarms:
        if alarm.text not in question:
            lines += _folded(f"{alarm.name.replace('_', ' ')}: {alarm.text}", width, "ALARM ", _ALARM)
    if picture.question:
        lines += _folded(question, width, "", _ALARM)
        lines.append(Text(f"Type one of: {', '.join(picture.question.answers)}", _ALARM))
    return lines


def step_line(picture: Picture) -> Text:
    """The step under way, and how far it is."""
    step = picture.step
    if step is None:
        return Text("no step is under way", "dim")
    of = f"step {step.number}/{step.count}"
    elapsed_s = max(0.0, picture.now_s - step.started_s)
    label = f"{step.label}: " if step.label else ""
    return Text.assemble(
        f"{of}  {label}",
        (step.description, "bold"),
        f"  {_minutes(elapsed_s)} of {_minutes(step.planned_s)}" if step.planned_s >= 1.0 else "",
    )


def readings_line(bench: BenchNow) -> Text:
    """Temperatures and what the INS does; answers that are old say so."""
    set_c = "off" if math.isnan(bench.chamber_set_c) else f"set {bench.chamber_set_c:.1f}"
    parts = [
        f"chamber {_degrees(bench.chamber_c)}, {set_c}{_old(bench.chamber_age_s)}",
        f"INS {bench.ins_mode}{_old(bench.ins_age_s)}",
        f"table{old}" if (old := _old(bench.table_age_s)) else "",
        f"gyros {' '.join(map(_degrees, bench.gyro_c))} degC",
    ]
    return Text("  ".join(part for part in parts if part))


def bias_line(picture: Picture, plus_minus: str) -> Text:
    """The live estimate of the dwell under way."""
    dwell, live = picture.dwell, picture.live_bias
    if dwell is None:
        return Text(f"dwells measured: {len(picture.dwells)} of {picture.dwell_count}", "dim")
    head = f"dwell {dwell.number}/{dwell.count}  "
    if live is None:
        return Text.assemble(head, ("the bias can be told after the turn", "dim"))
    pairs = zip(AXES, live.bias_dph, live.sigma_dph, strict=True)
    values = "  ".join(f"{axis} {1e3 * b:+z.2f}{plus_minus}{1e3 * s:.2f}" for axis, b, s in pairs)
    return Text.assemble(head, (values, "bold"), "  0.001 deg/h")


def sigma_line(estimates: tuple[LiveBias, ...], width: int, is_ascii: bool) -> Text:
    """How the largest of the three uncertainties has shrunk, first to last."""
    sigmas = [1e3 * max(each.sigma_dph) for each in estimates]
    head, tail = f"sigma {sigmas[0]:.1f} ", f" {sigmas[-1]:.1f}"
    room = width - len(head) - len(tail)
    shown = sigmas[:: max(1, math.ceil(len(sigmas) / room))]
    blocks = "_.-=^" if is_ascii else "▁▂▃▄▅▆▇█"
    top = max(shown)
    bars = "".join(blocks[min(len(blocks) - 1, int(len(blocks) * each / top))] for each in shown)
    return Text.assemble((head, "dim"), (bars, "cyan"), (tail, "dim"))


def message_lines(picture: Picture, count: int) -> list[Text]:
    """The newest messages, the last below."""
    newest = picture.messages[-count:] if count else ()
    return [Text.assemble((f"{hours_minutes(each.time_s):>6s} ", "dim"), each.text) for each in newest]


def _folded(text: str, width: int, head: str, style: str) -> list[Text]:
    lines = textwrap.wrap(head + text, width, subsequent_indent=" " * len(head))
    if len(lines) > _MOST_LINES:
        lines = [*lines[: _MOST_LINES - 1], lines[_MOST_LINES - 1][: width - 4] + " ..."]
    return [Text(line, style) for line in lines]


def _minutes(time_s: float) -> str:
    """Minutes and seconds, or hours and minutes of what takes longer."""
    if time_s >= 3600.0:
        return f"{hours_minutes(time_s)} h"
    return f"{int(time_s) // 60}:{int(time_s) % 60:02d}"


def _degrees(value_c: float) -> str:
    return "-" if math.isnan(value_c) else f"{value_c:.1f}"


def _old(age_s: float) -> str:
    if math.isnan(age_s):
        return " (not heard)"
    return f" ({age_s:.0f} s old)" if age_s > _OLD_S else ""
