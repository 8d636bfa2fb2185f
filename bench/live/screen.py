"""The whole picture on a terminal: what there is room for, the most important first."""

from __future__ import annotations

from rich.text import Text

from gyrobench.bench.live.graphs import bins_table, dwell_graphs, profile_graph
from gyrobench.bench.live.headlines import (
    attention,
    bias_line,
    headline,
    message_lines,
    readings_line,
    sigma_line,
    step_line,
)
from gyrobench.bench.live.picture import Picture

WIDEST, TALLEST = 80, 40
#: Least and most rows of what can be drawn larger or smaller.
_PROFILE_ROWS, _DWELL_ROWS, _BIN_ROWS = (6, 11), (7, 11), (2, 9)
_MOST_MESSAGES = 5


def screen(picture: Picture, width: int, height: int, is_ascii: bool) -> list[Text]:
    """Lines that show a picture, none wider than ``width`` and no more than ``height``.

    State, time left, what is wrong, and the open question are always there; then come step, readings
    and live bias, the profile, the dwell with its position, the bins, and messages.
    """
    plus_minus = "+-" if is_ascii else "±"
    top = [headline(picture, width), *attention(picture, width)]
    lines = [step_line(picture)]
    if picture.bench:
        lines.append(readings_line(picture.bench))
    bias = [bias_line(picture, plus_minus)]
    rows = _shares(height - len(top) - len(lines) - len(bias), picture)
    if picture.dwell and rows["sigma"]:
        bias.append(sigma_line(picture.dwell.estimates, width, is_ascii))
    if rows["profile"]:
        lines += profile_graph(picture, width, rows["profile"], is_ascii)
    if rows["dwell"]:
        lines += dwell_graphs(picture, width, rows["dwell"], is_ascii)
    lines += [*bias, *bins_table(picture, rows["bins"], plus_minus)]
    lines += message_lines(picture, rows["messages"])
    shown = [*top, *lines][:height]
    for line in shown:
        line.truncate(width, overflow="ellipsis")
        line.no_wrap = True
    return shown


def _shares(room: int, picture: Picture) -> dict[str, int]:
    """So many rows for each part: first each gets its least, in the order of importance, then its most."""
    filled = len({each.low_c for each in picture.bins if each.count and each.gyro == "x"})
    wishes = {
        "profile": _PROFILE_ROWS,
        "dwell": _DWELL_ROWS,
        "bins": (_BIN_ROWS[0], min(_BIN_ROWS[1], 1 + filled)) if filled else (0, 0),
        "sigma": (1, 1) if picture.dwell and len(picture.dwell.estimates) > 1 else (0, 0),
        "messages": (min(1, len(picture.messages)), min(_MOST_MESSAGES, len(picture.messages))),
    }
    rows = dict.fromkeys(wishes, 0)
    for part, (least, _) in wishes.items():
        if least <= room:
            rows[part] = least
            room -= least
    while room > 0:
        growing = [part for part, (_, most) in wishes.items() if 0 < rows[part] < most]
        if not growing:
            break
        for part in growing[:room]:
            rows[part] += 1
            room -= 1
    return rows
