"""Not more than so many messages of the same in an hour."""

from __future__ import annotations

from collections import defaultdict, deque

_HOUR_S = 3600.0


class Quota:
    """Counts messages by what they are about.

    Parameters
    ----------
    most_per_hour : int
        So many of the same pass.
    """

    def __init__(self, most_per_hour: int) -> None:
        self._most = most_per_hour
        self._passed: defaultdict[str, deque[float]] = defaultdict(deque)

    def lets_pass(self, about: str, now_s: float) -> bool:
        """Whether one more passes now; it counts if it does."""
        passed = self._passed[about]
        while passed and now_s - passed[0] >= _HOUR_S:
            passed.popleft()
        if len(passed) >= self._most:
            return False
        passed.append(now_s)
        return True
