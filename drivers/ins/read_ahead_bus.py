"""A CAN bus that is read by a thread, so that its adapter's buffer does not overflow between two polls.

Linux holds some 300 frames for a SocketCAN socket, and drops those that follow. The bench polls once a
second, and less often while an instrument does not reply.
"""

from __future__ import annotations

import threading
from collections import deque

import can

from gyrobench.drivers.frames import FrameBlock

_READ_PERIOD_S = 0.005
#: Most frames that wait for a poll: ten seconds of a full bus of 1 Mbit/s. Further ones stay in the adapter.
_MAX_WAITING = 100_000
_END_S = 5.0
#: A thread reads every few milliseconds; a poll waits no longer for it.
_READER_TIME_S = 0.1


def await_reader(has_read: threading.Event) -> None:
    """Let a thread read again that sets ``has_read`` after each time it read.

    A poll without frames needs that: if this process was stopped, so was the thread.
    """
    for _ in range(2):  # the first time it may have read before this call
        has_read.clear()
        has_read.wait(_READER_TIME_S)


class ReadAheadBus(can.BusABC):
    """Another bus, whose frames a thread reads; closes that bus with itself."""

    def __init__(self, bus: can.BusABC) -> None:
        super().__init__("")
        self._bus = bus
        self.channel_info = bus.channel_info
        self._waiting: deque[can.Message] = deque()
        self._error: Exception | None = None  # the thread reads on when recv_block has raised it
        self._stopping, self._has_read = threading.Event(), threading.Event()
        self._thread = threading.Thread(target=self._read_all, daemon=True)
        self._thread.start()

    def _read_all(self) -> None:
        while not self._stopping.wait(_READ_PERIOD_S):
            try:
                while self._error is None and len(self._waiting) < _MAX_WAITING:
                    if (message := self._bus.recv(0.0)) is None:
                        break
                    self._waiting.append(message)
            except Exception as error:  # noqa: BLE001 - raised by recv_block
                self._error = error
            self._has_read.set()

    def recv_block(self) -> FrameBlock:
        """Return the frames that have arrived; see :func:`gyrobench.drivers.ins.can_bus.block_receiver`."""
        if not self._waiting and self._error is None:
            await_reader(self._has_read)
        error = self._error  # first: the frames before an error are returned before it is raised
        messages = [self._waiting.popleft() for _ in range(len(self._waiting))]
        if error is not None and not messages:
            self._error = None
            raise error
        return FrameBlock.from_messages(messages)

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Send a frame; raises what the bus does."""
        self._bus.send(msg, timeout)

    def shutdown(self) -> None:
        """Stop reading and close the bus."""
        self._stopping.set()
        self._thread.join(_END_S)
        super().shutdown()
        self._bus.shutdown()
