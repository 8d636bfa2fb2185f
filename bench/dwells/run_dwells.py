"""The dwells of a run, one after the other: what only several of them show, and what is kept of each.

A run of a thousand hours has thousands of dwells. Their rows and what the joint solution needs are small;
the navigation that tells the noise is kept of some dwells only, evenly spread over the run.
"""

from __future__ import annotations

from dataclasses import replace

from gyrobench.bench.dwells.dwell import MeasuredDwell
from gyrobench.bench.dwells.stuck_sensors import stuck_sensors

#: So many dwells tell the noise as well as any larger number.
_MOST_WITH_NAVIGATION = 128


def add_dwell(dwells: list[MeasuredDwell], measured: MeasuredDwell) -> None:
    """Add the next dwell of a run.

    A temperature sensor that turns out to be stuck flags the dwells since it is, earlier ones too.
    """
    dwells.append(measured)
    for index, flag in stuck_sensors([each.row for each in dwells]):
        row = dwells[index].row
        if flag not in row.flags:
            flags = "; ".join(text for text in (row.flags, flag) if text)
            dwells[index] = replace(dwells[index], row=replace(row, flags=flags))
    _keep_navigation_of_some(dwells)


def _keep_navigation_of_some(dwells: list[MeasuredDwell]) -> None:
    spacing, last = _spacing(len(dwells)), len(dwells) - 1
    first = 0 if spacing != _spacing(last) else last
    for index in range(first, len(dwells)):
        if index % spacing and dwells[index].windows:
            dwells[index] = replace(dwells[index], windows=())


def _spacing(count: int) -> int:
    """Smallest power of two that leaves few enough."""
    return 1 << max(0, (max(count, 1) - 1) // _MOST_WITH_NAVIGATION).bit_length()
