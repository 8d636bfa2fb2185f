"""The one clock of a run: real, or virtual.

Engine, drivers and emulators all read and wait on the same clock object. On the virtual clock a
wait takes no time at all: it moves ``now()`` on, and an emulator works out what happened in
between when it is next spoken to. No other module reads the time or sleeps.
"""

from __future__ import annotations

import itertools
import time
from abc import ABC, abstractmethod
from datetime import UTC, datetime, timedelta
from weakref import WeakValueDictionary

#: Calendar time at which every virtual run starts, so that equal runs leave equal files.
VIRTUAL_EPOCH = datetime(2000, 1, 1, tzinfo=UTC)

_numbers = itertools.count(1)
_clocks: WeakValueDictionary[str, Clock] = WeakValueDictionary()


class Clock(ABC):
    """Monotonic time of a run, in seconds, with the calendar time that belongs to it.

    Attributes
    ----------
    name : str
        A name under which :func:`clock_named` finds this object, so that an address such as
        ``emulator://table?clock=NAME`` can say which clock an emulator lives on.
    is_virtual : bool
        Whether waiting takes no real time.
    """

    is_virtual: bool

    def __init__(self) -> None:
        self.name = f"clock-{next(_numbers)}"
        _clocks[self.name] = self

    @abstractmethod
    def now(self) -> float:
        """Seconds since this clock was made; never goes back."""

    @abstractmethod
    def sleep(self, duration_s: float) -> None:
        """Wait; a duration of zero or less returns at once."""

    @property
    @abstractmethod
    def epoch(self) -> datetime:
        """Calendar time (UTC) at ``now() == 0``."""

    def sleep_until(self, time_s: float) -> None:
        """Wait until ``now()`` is at least ``time_s``."""
        self.sleep(time_s - self.now())

    def utc(self) -> datetime:
        """Calendar time (UTC) now."""
        return self.epoch + timedelta(seconds=self.now())


class WallClock(Clock):
    """Real time: monotonic, so that a clock set forward or back changes no wait."""

    is_virtual = False

    def __init__(self) -> None:
        super().__init__()
        self._start = time.monotonic()
        self._epoch = datetime.now(UTC)

    def now(self) -> float:
        """Seconds since this clock was made."""
        return time.monotonic() - self._start

    def sleep(self, duration_s: float) -> None:
        """Wait in real time."""
        if duration_s > 0.0:
            time.sleep(duration_s)

    @property
    def epoch(self) -> datetime:
        """Calendar time at which this clock was made."""
        return self._epoch


class VirtualClock(Clock):
    """Time that passes only when somebody waits."""

    is_virtual = True

    def __init__(self) -> None:
        super().__init__()
        self._now_s = 0.0

    def now(self) -> float:
        """Seconds waited on this clock so far."""
        return self._now_s

    def sleep(self, duration_s: float) -> None:
        """Move on without waiting."""
        if duration_s > 0.0:
            self._now_s += duration_s

    def sleep_until(self, time_s: float) -> None:
        """Move on to exactly ``time_s``, without the rounding of a difference."""
        self._now_s = max(self._now_s, time_s)

    @property
    def epoch(self) -> datetime:
        """The same calendar time for every virtual run."""
        return VIRTUAL_EPOCH


class Deadline:
    """A moment on a clock, passed down so that nested waits share one budget of time."""

    def __init__(self, clock: Clock, duration_s: float) -> None:
        self._clock = clock
        self.duration_s = duration_s
        self._end_s = clock.now() + duration_s

    def remaining_s(self) -> float:
        """Time left, not below zero."""
        return max(0.0, self._end_s - self._clock.now())

    def expired(self) -> bool:
        """Whether the time is over."""
        return self._clock.now() >= self._end_s


def clock_named(name: str) -> Clock:
    """Find the clock of that name.

    Raises
    ------
    KeyError
        No clock of that name is in use.
    """
    return _clocks[name]
