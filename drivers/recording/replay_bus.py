"""python-can interface ``replay``: a recorded CAN log as a bus."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import can

from gyrobench.bench.foundations.clock import Clock, WallClock, clock_named


class ReplayBus(can.BusABC):
    """A bus that replays the frames of a log with their time stamps and intervals.

    ``channel`` is a log that python-can reads: ``.log`` (candump), ``.asc``, ``.blf`` and others. Without the
    name of a clock it runs on wall time. Raises can.CanInitializationError if the log can't be read, or there
    is no such clock.
    """

    def __init__(self, channel: str, clock: str = "", **options: Any) -> None:
        try:
            self._clock: Clock = clock_named(clock) if clock else WallClock()
            self._log = can.LogReader(channel)
        except (OSError, ValueError, KeyError) as error:
            raise can.CanInitializationError(f"can't replay {channel}: {error}") from error
        self._frames: Iterator[can.Message] = (frame for frame in self._log if frame.is_rx)
        self._next = next(self._frames, None)
        first_s = self._next.timestamp if self._next else 0.0
        self._zero_s = self._clock.now() - first_s
        self.channel_info = f"recording {channel}"
        super().__init__(channel, **options)

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        raise NotImplementedError  # recv() replaces it

    def recv(self, timeout: float | None = None) -> can.Message | None:
        """Wait on the clock for a frame that passes the filters; None at the time-out.

        Overrides python-can's own, which takes the time from the wall clock.
        """
        end_s = None if timeout is None else self._clock.now() + timeout * self._clock.speed
        while self._next is not None:
            due_s = self._zero_s + self._next.timestamp
            if end_s is not None and due_s > end_s:
                break
            self._clock.sleep_until(due_s)
            frame, self._next = self._next, next(self._frames, None)
            if self._matches_filters(frame):
                return frame
        if end_s is not None:
            self._clock.sleep_until(end_s)
        return None

    def send(self, msg: can.Message, timeout: float | None = None) -> None:  # noqa: ARG002
        """Refuse: a recording has no receiver.

        Raises can.CanOperationError: always.
        """
        raise can.CanOperationError(f"a recording can't receive 0x{msg.arbitration_id:03X}")

    def shutdown(self) -> None:
        """Close the log."""
        self._log.stop()
        super().shutdown()
