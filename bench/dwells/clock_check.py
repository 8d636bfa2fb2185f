"""Time counted by the INS against the arrival of its frames: finds a wrong ``epoch_period_s`` or time scale.

A period that is wrong by 4 % scales all times, and with them the biases of the level gyros, without a
misfit. Crystals differ by some 100 ppm, so that a larger difference of the rates is an error of the station
file. Frames arrive late, never early: the least delay of each part of a dwell counts, and a line through
these that neither single steps of a clock nor bursts of late frames move (Theil and Sen).
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np

from gyrobench.bench.foundations.arrays import FloatArray
from gyrobench.drivers.ins.signal_map import SignalMap

#: Parts of a dwell, and fewest epochs in each.
_PARTS, _MIN_EPOCHS = 12, 4
#: Rates of two sound clocks differ by less: two crystals with 200 ppm between them, and margin.
_MAX_RATE_ERROR = 5e-4
#: Arrival stamped when it is polled may drift by this within a dwell, s.
_POLL_S = 0.25
#: Jitter tilts the line by less than this multiple of its range over the dwell.
_SCATTERS = 2.0


def clock_fault(ins_time_s: FloatArray, arrival_s: FloatArray, signals: SignalMap) -> str:
    """What is wrong if the time of the INS does not run as its frames arrive, and what to do; else empty.

    ``ins_time_s``, ``arrival_s``: shape (n,), of the epochs of a dwell. Where the station maps neither time
    nor count of epochs, or the frames have no times of arrival, nothing is compared.
    """
    if signals.time_s is None and signals.epoch_counter is None:
        return ""
    known = np.isfinite(ins_time_s) & np.isfinite(arrival_s)
    time_s, arrival_s = ins_time_s[known], arrival_s[known]
    # Frames in a few bursts, or without stamps, say nothing about the rate.
    if len(np.unique(arrival_s)) < _PARTS * _MIN_EPOCHS:
        return ""
    line = _line(time_s, arrival_s)
    if abs(line.rate_error) <= _MAX_RATE_ERROR + (_POLL_S + _SCATTERS * line.scatter_s) / line.span_s:
        return ""
    rate, span_s = 1.0 + line.rate_error, line.span_s
    if signals.time_s is not None:
        return (
            f"{span_s:.0f} s of arrival are {span_s / rate:.5g} s on the clock of the INS. Check scale and "
            f"unit of ins.signals.time_s: {rate:.4g} times the present scale fits"
        )
    return (
        f"the INS sends an epoch every {signals.epoch_period_s * rate:.4g} s by the arrival of its frames, "
        f"ins.signals.epoch_period_s is {signals.epoch_period_s:g} s. Correct epoch_period_s, or the output "
        "rate of the INS"
    )


@dataclass(frozen=True)
class _Line:
    """Line of arrival over time of the INS."""

    rate_error: float  #: Its slope less 1.
    scatter_s: float  #: Range of the earliest frames of the parts about it.
    span_s: float  #: Time from the first part to the last by arrival, without steps of its clock.


def _line(time_s: FloatArray, arrival_s: FloatArray) -> _Line:
    """The median slope of all pairs of parts, or of adjacent ones, whichever is nearer to 1.

    The first is the more accurate one; the second a single step of either clock does not move.
    """
    parts = np.array_split(np.arange(len(time_s)), _PARTS)
    rate, scatter_s, span_s = 1.0, 0.0, 0.0
    errors: tuple[float, float] = (0.0, 0.0)
    for _ in range(2):  # which frame of a part is the earliest depends on the rate
        delay_s = arrival_s - rate * time_s
        earliest = np.array([part[np.argmin(delay_s[part])] for part in parts])
        at_s, came_s = time_s[earliest], arrival_s[earliest]
        pairs = [(a, b) for a, b in combinations(range(_PARTS), 2) if at_s[a] != at_s[b]]
        slopes = {
            pair: (came_s[pair[1]] - came_s[pair[0]]) / (at_s[pair[1]] - at_s[pair[0]]) for pair in pairs
        }
        adjacent = [slope for (a, b), slope in slopes.items() if b == a + 1]
        if not adjacent:
            return _Line(0.0, 0.0, 1.0)  # a clock of the INS that stands still
        rate = float(np.median(list(slopes.values())))
        errors = rate - 1.0, float(np.median(adjacent)) - 1.0
        scatter_s = float(np.ptp(came_s - rate * at_s))
        span_s = _PARTS * float(np.median(np.abs(np.diff(came_s))))
    return _Line(min(errors, key=abs), scatter_s, span_s)
