"""Wrappers that put faults between an emulated instrument and its clients: serial line and CAN bus."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import can

from gyrobench.drivers.emulators.can_ins import CanInsEmulator
from gyrobench.drivers.emulators.dialect import Connection, SerialInstrument
from gyrobench.drivers.frames import FrameBlock


class Reply(NamedTuple):
    """What comes from the instrument, and its delay beyond the usual latency."""

    data: bytes
    delay_s: float = 0.0


@dataclass
class Exchange:
    """One request, the reply to the previous one, and how to get the correct answer."""

    request: bytes
    earlier_reply: bytes
    ask: Callable[[], bytes]

    @cached_property
    def answer(self) -> bytes:
        """The correct reply; the instrument executes the request when this is first read."""
        return self.ask()


#: Gives the reply in place of the correct one; None leaves the exchange unchanged.
Disturbance = Callable[[Exchange], Reply | None]
#: Makes the frames that arrive from those that were sent; does not change these.
FrameFilter = Callable[[FrameBlock], FrameBlock]


class FaultySerial:
    """An emulated instrument with disturbances of its exchanges."""

    def __init__(self, instrument: SerialInstrument) -> None:
        self._instrument = instrument
        self.latency_s = instrument.latency_s  #: Latency of the reply that :meth:`feed` last returned.
        self.connection = Connection()  #: The plug.
        self.powered = True  #: Whether the instrument receives and answers at all.
        self.disturbances: list[Disturbance] = []  #: Only the first one that acts on an exchange is applied.
        self._earlier_reply = b""

    def feed(self, data: bytes, now_s: float) -> bytes:
        """Take bytes; see :class:`gyrobench.drivers.emulators.dialect.SerialInstrument`."""
        self.latency_s = self._instrument.latency_s
        if not self.powered:
            return b""
        exchange = Exchange(data, self._earlier_reply, lambda: self._instrument.feed(data, now_s))
        for disturbance in tuple(self.disturbances):
            reply = disturbance(exchange)
            if reply is not None:
                break
        else:
            reply = Reply(exchange.answer)
        if "answer" in vars(exchange):
            self._earlier_reply = exchange.answer or self._earlier_reply
        self.latency_s += reply.delay_s
        return reply.data


class FaultyCan:
    """The emulated INS behind filters of its frames; a CanNode."""

    def __init__(self, ins: CanInsEmulator) -> None:
        self._ins = ins
        self.listeners: list[Callable[[FrameBlock], None]] = []
        self.connection = Connection()  #: Broken while the controller is bus-off.
        self.filters: list[FrameFilter] = []  #: Filters of the frames, applied in this order.
        ins.listeners.append(self._forward)

    def receive(self, message: can.Message) -> None:
        """Take a frame to the INS."""
        if not self.connection.broken:
            self._ins.receive(message)

    def _forward(self, frames: FrameBlock) -> None:
        if self.connection.broken:
            return
        for frame_filter in tuple(self.filters):
            frames = frame_filter(frames)
        if len(frames):
            for listener in self.listeners:
                listener(frames)
