"""Compares the time counted by the INS with the arrival of its frames, to find wrong periods and time scales.

If the period of the epochs is wrong by 4 %, all times and with them the biases of the level gyros have a
wrong scale, without a misfit. A wrong period of the increments scales the rates and specific forces. Crystals
differ by some 100 ppm, so a larger difference of the rates is an error of the station file. Frames arrive
late, never early. Therefore a line is fitted to the earliest arrival in each part of a dwell, robust against
single steps of a clock and bursts of late frames (Theil and Sen).
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np

from gyrobench.bench.foundations.arrays import FloatArray, IntArray
from gyrobench.drivers.ins.signal_map import SignalMap

#: Parts of a dwell, and fewest epochs in each.
_PARTS, _MIN_EPOCHS = 12, 4
#: Largest difference of the rates of two correct clocks: 200 ppm between two crystals, and margin.
_MAX_RATE_ERROR = 5e-4
#: Largest drift within a dwell of arrival times that are stamped by polling, s.
_MAX_POLL_DRIFT_S = 0.25
#: Largest effect of jitter on the slope of the line, as a multiple of its range over the dwell.
_MAX_SCATTER_FACTOR = 2.0
#: Fewest resets of the clock in a dwell that may be due to a wrong rate.
_MIN_RESETS = 4
#: Resets per epoch that no unit has.
_MIN_RESET_SHARE = 0.5


def clock_fault(ins_time_s: FloatArray, arrival_s: FloatArray, segment: IntArray, signals: SignalMap) -> str:
    """Message if the time of the INS does not agree with the arrival of its frames; else empty.

    ``ins_time_s``, ``arrival_s``, ``segment``: shape (n,), of the epochs of a dwell, ``segment`` with the
    number of resets before. Nothing is compared if the station maps neither time nor count of epochs, or the
    frames have no times of arrival.
    """
    if signals.time_s is None and signals.epoch_counter is None:
        return ""
    is_valid = np.isfinite(ins_time_s) & np.isfinite(arrival_s)
    time_s, arrival_s = ins_time_s[is_valid], arrival_s[is_valid]
    rate = _rate_over_resets(time_s, arrival_s, segment[is_valid])
    if rate == 1.0 and _is_spread(arrival_s):
        line = _line(time_s, arrival_s)
        rate = 1.0 + line.rate_error if line.is_wrong else 1.0
    if rate == 1.0:
        return _contradicted_count(segment, signals)
    if signals.time_s is not None:
        return (
            f"the time of the INS runs at {1.0 / rate:.4g} times the rate of the bench's clock. Check scale "
            f"and unit of ins.signals.time_s: {rate:.4g} times the present scale fits"
        )
    return _period_text("an epoch", "ins.signals.epoch_period_s", signals.epoch_period_s, rate)


def _contradicted_count(segment: IntArray, signals: SignalMap) -> str:
    """Message if most times that the INS sends contradict the count of its epochs; else empty.

    Restarts and damaged counts are single; the epochs between two contradictory times are lost.
    """
    resets = len(np.unique(segment)) - 1
    if resets < max(_MIN_RESETS, _MIN_RESET_SHARE * len(segment)):
        return ""
    return (
        f"the time of the INS contradicts the count of its epochs {resets} times in a dwell: "
        f"ins.signals.epoch_period_s ({signals.epoch_period_s:g} s) is not the period of its epochs, or "
        "ins.signals.epoch_counter counts something else. Correct the station file"
    )


def increments_fault(sent: FloatArray, arrival_s: FloatArray, period_s: float) -> str:
    """Message if increments do not arrive at the declared period; else empty.

    ``sent``, shape (2, n): samples sent so far, counted in two ways; lost samples disturb the first count,
    jitter the second, and a wrong period both. ``arrival_s``: shape (n,).
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
    """Whether frames arrived at enough different times to determine a rate."""
    return int(np.count_nonzero(np.diff(arrival_s))) + 1 >= _PARTS * _MIN_EPOCHS


def _period_text(name: str, key: str, period_s: float, rate: float) -> str:
    return (
        f"the INS sends {name} every {period_s * rate:.3g} s by the arrival of its frames, {key} is "
        f"{period_s:g} s. Correct {key.split('.')[-1]}, or the output rate of the INS"
    )


def _rate_over_resets(time_s: FloatArray, arrival_s: FloatArray, segment: IntArray) -> float:
    """Rate of arrival over the time of the INS, if it is the same from reset to reset of its clock; else 1.

    A time at another rate contradicts the count of epochs repeatedly, which looks like resets.
    """
    _, first = np.unique(segment, return_index=True)
    changes_s, arrival_changes_s = np.diff(time_s[first]), np.diff(arrival_s[first])
    if len(changes_s) < _MIN_RESETS or not (arrival_changes_s > 0.0).all():
        return 1.0
    rates = changes_s / arrival_changes_s
    rate = float(np.median(rates))
    return 1.0 / rate if rate > 0.0 and np.ptp(rates) < abs(rate - 1.0) else 1.0


@dataclass(frozen=True)
class _Line:
    """Line of arrival over time of the INS."""

    rate_error: float  #: Slope minus 1.
    scatter_s: float  #: Range of the earliest arrivals in the parts about the line.
    span_s: float  #: Time from the first part to the last by arrival, without steps of its clock.

    @property
    def is_wrong(self) -> bool:
        """Whether the rate error is larger than that of two correct clocks."""
        if self.span_s == 0.0:  # as in a log of an adapter whose time stamps went back
            return False
        margin = (_MAX_POLL_DRIFT_S + _MAX_SCATTER_FACTOR * self.scatter_s) / self.span_s
        return abs(self.rate_error) > _MAX_RATE_ERROR + margin


def _line(time_s: FloatArray, arrival_s: FloatArray) -> _Line:
    """Line with the median slope of all pairs of parts, or of adjacent ones, whichever is nearer to 1.

    The first is more accurate; the second is robust against a single step of either clock.
    """
    parts = np.array_split(np.arange(len(time_s)), _PARTS)
    rate, scatter_s, span_s = 1.0, 0.0, 0.0
    errors: tuple[float, float] = (0.0, 0.0)
    for _ in range(2):  # which frame of a part is the earliest depends on the rate
        delay_s = arrival_s - rate * time_s
        earliest = np.array([part[np.argmin(delay_s[part])] for part in parts])
        ins_times_s, arrival_times_s = time_s[earliest], arrival_s[earliest]
        pairs = [(a, b) for a, b in combinations(range(_PARTS), 2) if ins_times_s[a] != ins_times_s[b]]
        slopes = {
            pair: (arrival_times_s[pair[1]] - arrival_times_s[pair[0]])
            / (ins_times_s[pair[1]] - ins_times_s[pair[0]])
            for pair in pairs
        }
        adjacent = [slope for (a, b), slope in slopes.items() if b == a + 1]
        if not adjacent:
            return _Line(0.0, 0.0, 1.0)  # the clock of the INS does not run
        rate = float(np.median(list(slopes.values())))
        errors = rate - 1.0, float(np.median(adjacent)) - 1.0
        scatter_s = float(np.ptp(arrival_times_s - rate * ins_times_s))
        span_s = _PARTS * float(np.median(np.abs(np.diff(arrival_times_s))))
    return _Line(min(errors, key=abs), scatter_s, span_s)
