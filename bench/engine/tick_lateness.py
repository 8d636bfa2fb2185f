"""How late the ticks of a run are, as a histogram."""

from __future__ import annotations

import math

import numpy as np

#: Bins of lateness are of equal width in its logarithm; below the first edge a tick counts as on time.
_LOWEST_S, _DECADES, _PER_DECADE = 1e-5, 8, 50


class TickLateness:
    """Histogram of how late ticks were; a percentile is accurate to the width of a bin, 5 %."""

    def __init__(self) -> None:
        self._counts = [0] * (_DECADES * _PER_DECADE + 1)
        self._max_s = 0.0
        self._missed = 0
        self._last_s: float | None = None

    def add(self, due_s: float, now_s: float, period_s: float) -> None:
        """Count the tick that was due at ``due_s`` and came at ``now_s``."""
        late_s, bin_index = now_s - due_s, 0
        if late_s > _LOWEST_S:
            bin_index = min(math.ceil(_PER_DECADE * math.log10(late_s / _LOWEST_S)), len(self._counts) - 1)
        self._counts[bin_index] += 1
        if late_s > self._max_s:
            self._max_s = late_s
        if self._last_s is not None and due_s - self._last_s > 1.5 * period_s:
            self._missed += round((due_s - self._last_s) / period_s) - 1
        self._last_s = due_s

    def summary(self) -> dict[str, float | int]:
        """Return the numbers of ticks and of ticks missed because one took too long, and the lateness, s."""
        return {
            "count": sum(self._counts),
            "missed": self._missed,
            "late_median_s": self._late_s(0.5),
            "late_99_percent_s": self._late_s(0.99),
            "late_max_s": round(self._max_s, 6),
        }

    def _late_s(self, share: float) -> float:
        """Lateness that ``share`` of the ticks do not exceed, s."""
        total = sum(self._counts)
        bin_index = int(np.searchsorted(np.cumsum(self._counts), share * total)) if total else 0
        late_s = _LOWEST_S * 10.0 ** (bin_index / _PER_DECADE) if bin_index else 0.0
        return round(min(late_s, self._max_s), 6)
