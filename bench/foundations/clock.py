"""The clock of a run: wall time or virtual time.

Engine, drivers and emulators read and wait on the same clock object. On the virtual clock a wait takes no
real time: it advances ``now()``, and an emulator simulates the elapsed time when it next receives a request.
No other module reads the time or sleeps.

The clock of a resumed run keeps the epoch of the run, and ``now()`` starts after the last recorded time.
"""

from __future__ import annotations

import itertools
import time
from abc import ABC, abstractmethod
from collections.abc import Hashable
from datetime import UTC, datetime, timedelta
from weakref import WeakValueDictionary

#: Calendar time at which every virtual run starts, so that equal runs write equal files.
VIRTUAL_EPOCH = datetime(2000, 1, 1, tzinfo=UTC)
#: A resumed run starts at least this long after its last record.
RESUME_STEP_S = 1.0

#: On Linux a clock that continues while the host is suspended: the chamber continues too, and a clock that
#: stops would hide the hours between two readings.
_MONOTONIC = getattr(time, "CLOCK_BOOTTIME", time.CLOCK_MONOTONIC)

_numbers = itertools.count(1)
_clocks: WeakValueDictionary[str, Clock] = WeakValueDictionary()


class Clock(ABC):
    """Monotonic time of a run in seconds, with the corresponding calendar time.

    Attributes
    ----------
    name : str
        Name for :func:`find_clock`, as in the address ``emulator://table?clock=NAME``.
    is_virtual : bool
        Whether waiting takes no real time.
    speed : float
        Seconds of this clock per second of the host. Divide a duration by it before the host waits for it,
        as for a port's time-out.
    companions : dict
        Objects that are kept alive as long as this clock, such as an emulated bench.
    """

    is_virtual: bool
    speed: float = 1.0

    def __init__(self) -> None:
        self.name = f"clock-{next(_numbers)}"
        self.companions: dict[Hashable, object] = {}
        _clocks[self.name] = self

    @abstractmethod
    def now(self) -> float:
        """Seconds since the run began; never decreases."""

    @abstractmethod
    def sleep(self, duration_s: float) -> None:
        """Wait; a duration of zero or less returns at once."""

    @property
    @abstractmethod
    def epoch(self) -> datetime:
        """Calendar time (UTC) at ``now() == 0``."""

    @abstractmethod
    def calendar_offset_s(self) -> float:
        """Time by which the host's calendar is ahead of :meth:`utc`."""

    def sleep_until(self, time_s: float) -> None:
        """Wait until ``now()`` is at least ``time_s``."""
        self.sleep(time_s - self.now())

    def utc(self) -> datetime:
        """Calendar time (UTC) now."""
        return self.epoch + timedelta(seconds=self.now())


class WallClock(Clock):
    """Monotonic real time; setting the host's calendar does not change waits.

    Parameters
    ----------
    epoch : datetime, optional
        Calendar time (UTC) at ``now() == 0``; by default such that ``utc()`` is the host's calendar time at
        the start.
    start_s : float
        Initial ``now()``.
    speed : float
        Above 1 for an emulated bench that runs faster than real time; ``utc()`` then runs ahead of the
        calendar.
    """

    is_virtual = False

    def __init__(self, epoch: datetime | None = None, start_s: float = 0.0, speed: float = 1.0) -> None:
        super().__init__()
        self.speed = speed
        self._start_s = start_s
        self._started_at_s = time.clock_gettime(_MONOTONIC)
        self._calendar_at_start = _calendar()
        self._epoch = epoch or self._calendar_at_start - timedelta(seconds=start_s)

    @classmethod
    def resumed(cls, epoch: datetime, last_s: float, speed: float = 1.0) -> WallClock:
        """Make the clock of a resumed run. ``epoch`` is that of the run, ``last_s`` the last recorded time.

        It starts at the host's calendar time, or after the last record if the calendar was set back.
        """
        return cls(epoch, max(last_s + RESUME_STEP_S, (_calendar() - epoch).total_seconds()), speed)

    def now(self) -> float:
        """Seconds since the run began."""
        return self._start_s + self.speed * (time.clock_gettime(_MONOTONIC) - self._started_at_s)

    def sleep(self, duration_s: float) -> None:
        """Wait in real time."""
        if duration_s > 0.0:
            time.sleep(duration_s / self.speed)

    @property
    def epoch(self) -> datetime:
        """Calendar time at which the run began."""
        return self._epoch

    def calendar_offset_s(self) -> float:
        """Time by which the host's calendar is ahead of :meth:`utc`.

        With a speed above 1, the offset at the start plus the changes of the calendar since.
        """
        at_start_s = (self._calendar_at_start - self._epoch).total_seconds() - self._start_s
        calendar_s = (_calendar() - self._calendar_at_start).total_seconds()
        return at_start_s + calendar_s - (time.clock_gettime(_MONOTONIC) - self._started_at_s)


class VirtualClock(Clock):
    """Virtual time that starts at ``start_s`` and advances only by waiting."""

    is_virtual = True

    def __init__(self, start_s: float = 0.0) -> None:
        super().__init__()
        self._now_s = start_s

    def now(self) -> float:
        """Start of the clock plus the seconds waited."""
        return self._now_s

    def sleep(self, duration_s: float) -> None:
        """Advance the time at once."""
        if duration_s > 0.0:
            self._now_s += duration_s

    def sleep_until(self, time_s: float) -> None:
        """Advance to exactly ``time_s``, without the rounding error of a difference."""
        if time_s > self._now_s:
            self._now_s = time_s

    @property
    def epoch(self) -> datetime:
        """The same calendar time for every virtual run."""
        return VIRTUAL_EPOCH

    def calendar_offset_s(self) -> float:
        """Zero: a virtual run has a separate calendar."""
        return 0.0


def parse_utc(text: object) -> datetime | None:
    """Parse a calendar time in ISO 8601, UTC if it names no zone; None if it is not valid."""
    try:
        moment = datetime.fromisoformat(str(text))
    except ValueError:
        return None
    return moment if moment.tzinfo else moment.replace(tzinfo=UTC)


class Deadline:
    """End of a time budget on a clock; passed down so that nested waits share the budget."""

    def __init__(self, clock: Clock, duration_s: float) -> None:
        self._clock = clock
        self.duration_s = duration_s
        self._end_s = clock.now() + duration_s

    def remaining_s(self) -> float:
        """Remaining time, at least zero."""
        return max(0.0, self._end_s - self._clock.now())

    def expired(self) -> bool:
        """Whether the time is over."""
        return self._clock.now() >= self._end_s


def find_clock(name: str) -> Clock:
    """Find a clock by name. Raises KeyError if no clock of that name exists."""
    return _clocks[name]


def _calendar() -> datetime:
    return datetime.now(UTC)
