"""python-can interface ``emulator``: an emulated INS as a CAN bus."""

from __future__ import annotations

import math
import re
from collections import deque
from typing import Any

import can

from gyrobench.bench.foundations.errors import DocumentError, GyrobenchError
from gyrobench.drivers.emulators.bench import ADDRESS_KEYS, BenchAddress, bench_at
from gyrobench.drivers.emulators.can_ins import CanChannel
from gyrobench.drivers.frames import FrameBlock, concatenate

_CHANNEL = re.compile(r"ins(?:-([2-9]|[1-9][0-9]))?")


class EmulatorBus(can.BusABC):
    """A bus with an emulated INS on it, on the bench's clock.

    Channel ``ins`` is the first unit on the table; ``ins-2``, ``ins-3`` and so on are further units. The
    options are the address of the bench, see :mod:`gyrobench.drivers.emulators.bench`, and

    * ``frames``: a name in :data:`gyrobench.drivers.emulators.can_ins.SHIPPED_FORMATS`, or of a package;
    * ``power_event``: the chamber's event output that powers the unit, instead of that in the world file;
    * ``unit`` and ``identifier_offset``: connect the unit of that number to this channel, with the offset
      added to its identifiers. All clients of a channel receive the frames of all units on it;
    * ``epoch_period_s``: the epoch period that the client expects, s.

    Raises can.CanInitializationError if there is no such channel, clock, world or list of faults, or the
    epoch period of the world differs from the expected one.
    """

    def __init__(
        self,
        channel: str = "ins",
        frames: str = "",
        power_event: int | None = None,
        unit: int | None = None,
        identifier_offset: int = 0,
        epoch_period_s: float | None = None,
        **options: Any,
    ) -> None:
        address = BenchAddress(**{key: options.pop(key) for key in ADDRESS_KEYS if key in options})
        match = _CHANNEL.fullmatch(channel)
        if match is None:
            raise can.CanInitializationError(
                f"no emulated CAN channel {channel!r}; available: ins, and ins-2 to ins-99 for further units"
            )
        number = int(match[1] or 1) if unit is None else unit
        try:
            self._bench = bench_at(address)
            self._bench.advance()
            self._bench.ensure_units(number)
            self._unit = self._bench.units[number - 1]
            _check_period(address.world, self._unit.world.file.ins.epoch_period_s, epoch_period_s)
            if frames:
                self._unit.ins.use_format(frames)
            if power_event is not None:
                self._unit.power_event = power_event
        except GyrobenchError as error:
            raise can.CanInitializationError(str(error)) from error
        self._channel = self._bench.channels.setdefault(channel, CanChannel())
        self._channel.connect(self._unit, identifier_offset)
        self._generation = self._channel.generation
        self.keeps_frames = self._bench.keeps_frames
        self._blocks: list[FrameBlock] = []
        #: Frames taken from the blocks by :meth:`recv` but not yet returned.
        self._messages: deque[can.Message] = deque()
        self.channel_info = f"emulated INS {number}, world {address.world}, seed {address.seed}"
        super().__init__(channel, **options)
        self._channel.listeners.append(self._blocks.append)

    def send(self, msg: can.Message, timeout: float | None = None) -> None:  # noqa: ARG002
        """Send a frame to the INS; it arrives immediately."""
        self._bench.advance(self._channel.units)
        self._check_bus()
        self._channel.receive(msg)

    def recv(self, timeout: float | None = None) -> can.Message | None:
        """Wait for a frame that passes the filters; None if none came in ``timeout`` seconds.

        Overrides python-can's method, which uses the wall clock.
        """
        clock = self._bench.clock
        end_s = math.inf if timeout is None else clock.now() + timeout
        if not (self._messages or self._blocks):
            self._bench.advance(self._channel.units)
        while True:
            self._check_bus()
            while self._messages or self._blocks:
                if not self._messages:
                    self._messages.extend(self._channel.in_order(self._blocks).messages())
                    self._blocks.clear()
                message = self._messages.popleft()
                if self._matches_filters(message):
                    return message
            remaining_s = end_s - clock.now()
            if remaining_s <= 0.0:
                return None
            clock.sleep(min(self._unit.world.file.ins.epoch_period_s, remaining_s))
            self._bench.advance(self._channel.units)

    def recv_block(self) -> FrameBlock:
        """Return all frames that have arrived and pass the filters, without waiting."""
        self._bench.advance(self._channel.units)
        self._check_bus()
        frames = self._channel.in_order(self._blocks)
        self._blocks.clear()
        if self._messages:
            frames = concatenate([FrameBlock.from_messages(self._messages), frames])
            self._messages.clear()
        return frames if self.filters is None else frames.matching(self.filters)

    def _check_bus(self) -> None:
        if self._channel.generation != self._generation:
            raise can.CanOperationError("bus-off: the controller has left the bus; reopen it")

    def shutdown(self) -> None:
        """Leave the bus; the INS continues."""
        listeners = self._channel.listeners
        if self._blocks.append in listeners:
            listeners.remove(self._blocks.append)
        super().shutdown()


def _check_period(world: str, period_s: float, expected_s: float | None) -> None:
    """Raise DocumentError if the world's epoch period differs from the one that the client expects, s."""
    if expected_s is not None and not math.isclose(period_s, expected_s, rel_tol=1e-6):
        raise DocumentError(
            f"{world}: the INS of this world sends an epoch in {period_s:g} s, the station expects one in "
            f"{expected_s:g} s. Choose a world and a station that belong together, as quick and quick, or "
            "correct epoch_period_s in one of them"
        )
