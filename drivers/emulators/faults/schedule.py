"""When one fault begins and ends, worked out from its timing: no clock, no bench."""

from __future__ import annotations

import math

import numpy as np

from gyrobench.drivers.emulators.faults.timing import Timing


class Schedule:
    """Begins and ends of one entry in the order of time, one occurrence after the other.

    Parameters
    ----------
    timing : Timing
        The entry.
    random : Generator
        Spacing of ``every_s``: exponential gaps, so at any moment the next is equally near.
    start_s : float
        Where the bench begins. What was over by then does not come; what still lasts begins there.

    Attributes
    ----------
    next_s : float
        Next moment at which something is due; infinite for none that is known.
    """

    def __init__(self, timing: Timing, random: np.random.Generator, start_s: float = 0.0) -> None:
        self._timing = timing
        self._random = random
        self._left = timing.most
        self._phases = 0
        self._in_phase = False
        self._begin_s = self._first(start_s)
        self._end_s: float | None = None

    @property
    def next_s(self) -> float:
        """Next moment at which something is due."""
        return self._begin_s if self._end_s is None else self._end_s

    def observe(self, in_phase: bool, now_s: float) -> None:
        """Tell whether the bench is in the phase of ``during``."""
        if in_phase == self._in_phase:
            return
        self._in_phase = in_phase
        if not in_phase:
            self._begin_s = math.inf  # too short for after_s
            return
        self._phases += 1
        if self._phases >= self._timing.nth and self._left > 0 and self._end_s is None:
            self._begin_s = now_s + self._timing.after_s

    def begins(self, now_s: float) -> bool:
        """Whether the next occurrence is due; it counts as begun then."""
        if self._end_s is not None or now_s < self._begin_s:
            return False
        begin_s, duration_s = self._begin_s, self._timing.duration_s
        self._left -= 1
        self._end_s = begin_s + duration_s if duration_s > 0.0 else None
        self._begin_s = math.inf
        if self._left > 0 and self._timing.every_s is not None:
            self._begin_s = begin_s + max(duration_s, self._gap_s(self._timing.every_s))
        return True

    def ends(self, now_s: float) -> bool:
        """Whether the present occurrence is over; it counts as ended then."""
        if self._end_s is None or now_s < self._end_s:
            return False
        self._end_s = None
        return True

    def _first(self, start_s: float) -> float:
        timing = self._timing
        if timing.at_s is not None:
            over = timing.at_s < start_s and timing.at_s + timing.duration_s <= start_s
            return math.inf if over else timing.at_s
        if timing.every_s is not None:
            return max(start_s, timing.from_s) + self._gap_s(timing.every_s)
        return math.inf

    def _gap_s(self, mean_s: float) -> float:
        return float(self._random.exponential(mean_s))
