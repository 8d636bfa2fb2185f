"""Time counted by the INS against the arrival of its frames: finds wrong periods and a wrong time scale.

A period of the epochs that is wrong by 4 % scales all times, and with them the biases of the level gyros,
without a misfit. One of the increments scales the rates and specific forces. Crystals differ by some 100 ppm,
so that a larger difference of the rates is an error of the station file. Frames arrive late, never early: the
least delay of each part of a dwell counts, and a line through these that neither single steps of a clock nor
bursts of late frames move (Theil and Sen).
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np

from gyrobench.bench.foundations.arrays import FloatArray, IntArray
from gyrobench.drivers.ins.signal_map import SignalMap

#: Parts of a dwell, and fewest epochs in each.
_PARTS, _MIN_EPOCHS = 12, 4
#: Rates of two sound clocks differ by less: two crystals with 200 ppm between them, and margin.
_MAX_RATE_ERROR = 5e-4
#: Arrival stamped when it is polled may drift by this within a dwell, s.
_POLL_S = 0.25
#: Jitter tilts the line by less than this multiple of its range over the dwell.
_SCATTERS = 2.0
#: Fewest resets of the clock in a dwell that may be a wrong rate.
_MIN_RESETS = 4


def clock_fault(ins_time_s: FloatArray, arrival_s: FloatArray, segment: IntArray, signals: SignalMap) -> str:
    """What is wrong if the time of the INS does not run as its frames arrive, and what to do; else empty.

    ``ins_time_s``, ``arrival_s``, ``segment``: shape (n,), of the epochs of a dwell, ``segment`` with the
    number of resets before. Where the station maps neither time nor count of epochs, or the frames have no
    times of arrival, nothing is compared.
    """
    if signals.time_s is None and signals.epoch_counter is None:
        return ""
    known = np.isfinite(ins_time_s) & np.isfinite(arrival_s)
    time_s, arrival_s = ins_time_s[known], arrival_s[known]
    rate = _rate_over_resets(time_s, arrival_s, segment[known])
    if rate == 1.0 and _is_spread(arrival_s):
        line = _line(time_s, arrival_s)
        rate = 1.0 + line.rate_error if line.is_wrong else 1.0
    if rate == 1.0:
        return ""
    if signals.time_s is not None:
        return (
            f"the time of the INS runs at {1.0 / rate:.4g} times the rate of the bench's clock. Check scale "
            f"and unit of ins.signals.time_s: {rate:.4g} times the present scale fits"
        )
    return _period_text("an epoch", "ins.signals.epoch_period_s", signals.epoch_period_s, rate)


def increments_fault(sent: FloatArray, arrival_s: FloatArray, period_s: float) -> str:
    """What is wrong if increments do not arrive at the declared period, and what to do; else empty.

    ``sent``, shape (2, n): samples sent so far, counted in two ways; lost samples disturb the first and
    jitter the second, a wrong period both. ``arrival_s``: shape (n,).
    """
    if not _is_spread(arrival_s[np.isfinite(arrival_s)]):
        return ""
    lines = [_line(period_s * count, arrival_s) for count in sent]
    errors = [line.rate_error for line in lines]
    if not all(line.is_wrong for line in lines) or min(errors) < 0.0 < max(errors):
        return ""
    rate = 1.0 + min(lines, key=lambda line: line.scatter_s).rate_error
    return _period_text("increments", "ins.signals.increments.period_s", period_s, rate)


def _is_spread(arrival_s: FloatArray) -> bool:
    """Whether frames arrived often enough: in a few bursts, or without stamps, they say nothing of a rate."""
    return int(np.count_nonzero(np.diff(arrival_s))) + 1 >= _PARTS * _MIN_EPOCHS


def _period_text(what: str, key: str, period_s: float, rate: float) -> str:
    return (
        f"the INS sends {what} every {period_s * rate:.3g} s by the arrival of its frames, {key} is "
        f"{period_s:g} s. Correct {key.split('.')[-1]}, or the output rate of the INS"
    )


def _rate_over_resets(time_s: FloatArray, arrival_s: FloatArray, segment: IntArray) -> float:
    """Arrival over time of the INS where that is the same from reset to reset of its clock; else 1.

    A time at another rate contradicts the count of epochs again and again, which looks like resets.
    """
    _, first = np.unique(segment, return_index=True)
    changes_s, passed_s = np.diff(time_s[first]), np.diff(arrival_s[first])
    if len(changes_s) < _MIN_RESETS or not (passed_s > 0.0).all():
        return 1.0
    rates = changes_s / passed_s
    rate = float(np.median(rates))
    return 1.0 / rate if rate > 0.0 and np.ptp(rates) < abs(rate - 1.0) else 1.0


@dataclass(frozen=True)
class _Line:
    """Line of arrival over time of the INS."""

    rate_error: float  #: Its slope less 1.
    scatter_s: float  #: Range of the earliest frames of the parts about it.
    span_s: float  #: Time from the first part to the last by arrival, without steps of its clock.

    @property
    def is_wrong(self) -> bool:
        """Whether two sound clocks do not differ as much."""
        margin = (_POLL_S + _SCATTERS * self.scatter_s) / self.span_s
        return abs(self.rate_error) > _MAX_RATE_ERROR + margin


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
