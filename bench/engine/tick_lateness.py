"""How late the engine's ticks are against their grid."""

from __future__ import annotations

import math

import numpy as np

#: Bins are evenly wide in the logarithm; what is earlier than the first edge counts as on time.
_LOWEST_S, _DECADES, _PER_DECADE = 1e-5, 8, 50


class TickLateness:
    """Counts ticks by how late they were; its size does not grow with the run.

    A percentile is right to the width of a bin, 5 %.
    """

    def __init__(self) -> None:
        self._counts = np.zeros(_DECADES * _PER_DECADE + 1, np.int64)
        self._longest_s = 0.0
        self._missed = 0
        self._last_s: float | None = None

    def add(self, due_s: float, now_s: float, period_s: float) -> None:
        """Count the tick that was due at ``due_s`` and came at ``now_s``; between ticks lies ``period_s``."""
        late_s = max(0.0, now_s - due_s)
        place = math.ceil(_PER_DECADE * math.log10(max(late_s, _LOWEST_S) / _LOWEST_S))
        self._counts[min(place, len(self._counts) - 1)] += 1
        self._longest_s = max(self._longest_s, late_s)
        if self._last_s is not None:
            self._missed += round((due_s - self._last_s) / period_s) - 1
        self._last_s = due_s

    def summary(self) -> dict[str, float | int]:
        """Number of ticks, how many were missed since the one before took too long, and lateness in s."""
        return {
            "count": int(self._counts.sum()),
            "missed": self._missed,
            "late_median_s": self._late_s(0.5),
            "late_99_percent_s": self._late_s(0.99),
            "late_max_s": round(self._longest_s, 6),
        }

    def _late_s(self, share: float) -> float:
        """Lateness that this share of the ticks keeps below."""
        total = self._counts.sum()
        place = int(np.searchsorted(np.cumsum(self._counts), share * total)) if total else 0
        late_s = _LOWEST_S * 10.0 ** (place / _PER_DECADE) if place else 0.0
        return round(min(late_s, self._longest_s), 6)
