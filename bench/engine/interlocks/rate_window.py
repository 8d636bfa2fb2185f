"""How fast a value changes, over a window long enough that noise and resolution do not count."""

from __future__ import annotations

import math
from collections import deque

#: Two periods, and some time by which a reading may be late.
_LEAST_PERIODS = 2.5


class RateWindow:
    """The newest values over some time.

    Parameters
    ----------
    window_s : float
        Time over which the change is taken.
    """

    def __init__(self, window_s: float) -> None:
        self._window_s = window_s
        self._values: deque[tuple[float, float]] = deque()

    @classmethod
    def for_readings(cls, window_s: float, period_s: float) -> RateWindow:
        """Make a window that holds three readings at least where one comes every ``period_s``."""
        return cls(max(window_s, _LEAST_PERIODS * period_s))

    def add(self, time_s: float, value: float) -> None:
        """Add a value; one that is not finite, or not newer than the last, is left out.

        After a gap longer than the window, the change before it tells nothing any more.
        """
        values = self._values
        if not math.isfinite(value) or (values and time_s <= values[-1][0]):
            return
        if values and time_s - values[-1][0] > self._window_s:
            values.clear()
        values.append((time_s, value))
        while time_s - values[0][0] > self._window_s:
            values.popleft()

    def per_s(self) -> float | None:
        """Change from the oldest to the newest value, per second; None until half the window is filled."""
        if not self._values:
            return None
        (first_s, first), (last_s, last) = self._values[0], self._values[-1]
        duration_s = last_s - first_s
        return (last - first) / duration_s if duration_s > 0.0 and duration_s >= self._window_s / 2 else None
