"""python-can interface ``emulator``: the emulated INS as a CAN bus."""

from __future__ import annotations

import math
from collections import deque
from typing import Any

import can

from gyrobench.bench.foundations.errors import GyrobenchError
from gyrobench.drivers.emulators.bench import ADDRESS_KEYS, BenchAddress, emulated_bench
from gyrobench.drivers.frames import FrameBlock, concatenate


class EmulatorBus(can.BusABC):
    """A bus with the emulated INS on it, on the bench's clock.

    The options are the address of the bench, see :mod:`gyrobench.drivers.emulators.bench`, and ``frames``: a
    name in :data:`gyrobench.drivers.emulators.can_ins.CAN_FORMATS`. Raises can.CanInitializationError if
    there is no such channel, clock, world or list of faults.
    """

    def __init__(self, channel: str = "ins", frames: str = "", **options: Any) -> None:
        address = BenchAddress(**{key: options.pop(key) for key in ADDRESS_KEYS if key in options})
        if channel != "ins":
            raise can.CanInitializationError(f"no emulated CAN channel {channel!r}; available: ins")
        try:
            self._bench = emulated_bench(address)
            self._bench.advance()
            if frames:
                self._bench.ins.use_format(frames)
        except GyrobenchError as error:
            raise can.CanInitializationError(str(error)) from error
        self._connection = self._bench.connections["ins"]
        self._generation = self._connection.generation
        self.keeps_frames = self._bench.keeps_frames
        self._blocks: list[FrameBlock] = []
        #: Frames of the oldest block, once :meth:`recv` is used.
        self._messages: deque[can.Message] = deque()
        self.channel_info = f"emulated INS, world {address.world}, seed {address.seed}"
        super().__init__(channel, **options)
        self._bench.bus.listeners.append(self._blocks.append)

    def send(self, msg: can.Message, timeout: float | None = None) -> None:  # noqa: ARG002
        """Send a frame to the INS; it arrives immediately."""
        self._bench.advance()
        self._check_bus()
        self._bench.bus.receive(msg)

    def recv(self, timeout: float | None = None) -> can.Message | None:
        """Wait for a frame that passes the filters; None if none came in ``timeout`` seconds.

        Overrides python-can's method, which uses the wall clock.
        """
        clock = self._bench.clock
        end_s = math.inf if timeout is None else clock.now() + timeout
        if not (self._messages or self._blocks):
            self._bench.advance()
        while True:
            self._check_bus()
            while self._messages or self._blocks:
                if not self._messages:
                    self._messages.extend(self._blocks.pop(0).messages())
                message = self._messages.popleft()
                if self._matches_filters(message):
                    return message
            remaining_s = end_s - clock.now()
            if remaining_s <= 0.0:
                return None
            clock.sleep(min(self._bench.world.file.ins.epoch_period_s, remaining_s))
            self._bench.advance()

    def recv_block(self) -> FrameBlock:
        """Take all frames that have arrived and pass the filters, without waiting."""
        self._bench.advance()
        self._check_bus()
        frames = concatenate(self._blocks)
        self._blocks.clear()
        if self._messages:
            frames = concatenate([FrameBlock.from_messages(self._messages), frames])
            self._messages.clear()
        return frames if self.filters is None else frames.matching(self.filters)

    def _check_bus(self) -> None:
        if self._connection.generation != self._generation:
            raise can.CanOperationError("bus-off: the controller has left the bus; reopen it")

    def shutdown(self) -> None:
        """Leave the bus; the INS continues."""
        listeners = self._bench.bus.listeners
        if self._blocks.append in listeners:
            listeners.remove(self._blocks.append)
        super().shutdown()
