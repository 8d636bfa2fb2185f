"""python-can interface ``replay``: a recorded CAN log as a bus."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import islice
from typing import Any

import can
import numpy as np

from gyrobench.bench.foundations.clock import Clock, WallClock, find_clock
from gyrobench.drivers.frames import FrameBlock, concatenate

#: Number of frames read from the log at once.
_BATCH_SIZE = 4096


class ReplayBus(can.BusABC):
    """A bus that replays the frames of a log with their time stamps and intervals.

    ``channel`` is the path of a log that python-can reads: ``.log`` (candump), ``.asc``, ``.blf`` and others.
    ``clock`` is the name of a clock; without it, the bus runs on wall time. Raises
    can.CanInitializationError if the log can't be read, or there is no such clock.
    """

    def __init__(self, channel: str, clock: str = "", **options: Any) -> None:
        try:
            self._clock: Clock = find_clock(clock) if clock else WallClock()
            self._log = can.LogReader(channel)
        except (OSError, ValueError, KeyError) as error:
            reason = getattr(error, "strerror", None) or error
            raise can.CanInitializationError(f"can't replay {channel}: {reason}") from error
        self._frames: Iterator[can.Message] = (frame for frame in self._log if frame.is_rx)
        self._buffered = concatenate([])
        first_s = self._buffered.timestamp_s[0] if self._fill_buffer() else 0.0
        self._zero_s = self._clock.now() - float(first_s)
        self.channel_info = f"recording {channel}"
        super().__init__(channel, **options)

    def _fill_buffer(self) -> bool:
        """Read from the log if the buffer is empty; returns whether the buffer has a frame."""
        while not len(self._buffered) and (messages := list(islice(self._frames, _BATCH_SIZE))):
            self._buffered = FrameBlock.from_messages(messages)
        return len(self._buffered) > 0

    def recv_block(self) -> FrameBlock:
        """Return the frames that are due and pass the filters."""
        due: list[FrameBlock] = []
        while self._fill_buffer():
            later = np.flatnonzero(self._zero_s + self._buffered.timestamp_s > self._clock.now())
            end = int(later[0]) if len(later) else len(self._buffered)
            due.append(self._buffered.take(slice(0, end)))
            self._buffered = self._buffered.take(slice(end, None))
            if len(later):
                break
        block = concatenate(due)
        return block.matching(self._filters) if self._filters else block

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        raise NotImplementedError  # recv() replaces it

    def recv(self, timeout: float | None = None) -> can.Message | None:
        """Wait on the clock for a frame that passes the filters; None at the time-out.

        Overrides python-can's method, which uses the wall clock.
        """
        end_s = None if timeout is None else self._clock.now() + timeout * self._clock.speed
        while self._fill_buffer():
            due_s = self._zero_s + float(self._buffered.timestamp_s[0])
            if end_s is not None and due_s > end_s:
                break
            self._clock.sleep_until(due_s)
            [frame] = self._buffered.take(slice(0, 1)).messages()
            self._buffered = self._buffered.take(slice(1, None))
            if self._matches_filters(frame):
                return frame
        if end_s is not None:
            self._clock.sleep_until(end_s)
        return None

    def send(self, msg: can.Message, timeout: float | None = None) -> None:  # noqa: ARG002
        """Raise can.CanOperationError: a recording has no receiver."""
        raise can.CanOperationError(f"a recording can't receive 0x{msg.arbitration_id:03X}")

    def shutdown(self) -> None:
        """Close the log."""
        self._log.stop()
        super().shutdown()
