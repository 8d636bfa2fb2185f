"""Temperature sensors that keep a plausible value while the gyros' temperatures change.

One dwell does not show them: soaked gyros hardly change. From dwell to dwell everything in the INS follows
the chamber, so a sensor that stands still to the last bit in a dwell, and has not gone along with the
others since an earlier dwell, is stuck. Switching the INS off and on may not free it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from gyrobench.bench.bias.dwell_table import DwellRow
from gyrobench.bench.navigation.positions import AXES

#: Slope of a sensor that stands still, K/h: nothing but rounding of the arithmetic.
_STILL_C_PER_H = 1e-6
_SAME_C = 1e-6
#: From one dwell to another a sensor may change by this much more or less than the rest of the INS, K.
_FROM_INS_K = 5.0
#: No sensor shows the same in two dwells between which the chamber's air changed by this much, K.
_FROM_CHAMBER_K = 15.0


def stuck_sensors(rows: Sequence[DwellRow]) -> Iterator[tuple[int, str]]:
    """Find sensors of the gyros' optics that are stuck at the end of a run.

    Parameters
    ----------
    rows : sequence of DwellRow
        Of one run so far, in the order of time.

    Yields
    ------
    int, str
        Index of a dwell whose temperature is not to be believed, and why.
    """
    if not rows:
        return
    for axis in range(3):
        since = _still_since(rows, axis)
        earlier = [row for row in rows[_last_told(rows, since, axis) : -1] if row.unit == rows[-1].unit]
        apart_k = [_apart_k(row, rows[-1], axis) for row in earlier if np.isfinite(row.gyro_c[axis])]
        if since < len(rows) and max(apart_k, default=0.0) > 1.0:
            for index in range(since, len(rows)):
                yield (
                    index,
                    f"the temperature of the {AXES[axis]} gyro keeps still to the last bit at "
                    f"{rows[index].gyro_c[axis]:.2f} degC while the other temperatures change, so its bias "
                    "belongs to no bin: its sensor is stuck",
                )


def _still_since(rows: Sequence[DwellRow], axis: int) -> int:
    """Index of the first of the last dwells in which a sensor stood still at one value."""
    since = len(rows)
    while since and _is_still(rows[since - 1], axis) and _is_same(rows[since - 1], rows[-1], axis):
        since -= 1
    return since


def _last_told(rows: Sequence[DwellRow], since: int, axis: int) -> int:
    """Index of the last dwell before ``since`` in which a sensor told a temperature; 0 for none."""
    before = max(since - 1, 0)
    while before and not np.isfinite(rows[before].gyro_c[axis]):
        before -= 1
    return before


def _apart_k(earlier: DwellRow, later: DwellRow, axis: int) -> float:
    """How far a sensor went another way than the rest, as a share of what it may."""
    changes = np.subtract(later.gyro_c, earlier.gyro_c)
    moving = [changes[k] for k in range(3) if k != axis and not _is_still(later, k)]
    rest = np.array([*moving, later.board_c[axis] - earlier.board_c[axis], later.case_c - earlier.case_c])
    rest = rest[np.isfinite(rest)]
    apart = abs(changes[axis] - float(np.median(rest))) / _FROM_INS_K if len(rest) else 0.0
    chamber_k = abs(later.chamber_c - earlier.chamber_c)
    if _is_still(earlier, axis) and _is_same(earlier, later, axis) and chamber_k > _FROM_CHAMBER_K:
        apart = max(apart, chamber_k / _FROM_CHAMBER_K)
    return apart


def _is_still(row: DwellRow, axis: int) -> bool:
    return abs(row.gyro_rate_c_per_h[axis]) < _STILL_C_PER_H


def _is_same(one: DwellRow, other: DwellRow, axis: int) -> bool:
    return one.unit == other.unit and abs(one.gyro_c[axis] - other.gyro_c[axis]) < _SAME_C
