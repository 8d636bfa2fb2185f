"""A serial instrument on a bad line: faults between its port and whoever talks to it."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import NamedTuple

from gyrobench.drivers.emulators.serial_instrument import Connection, SerialInstrument


class Reply(NamedTuple):
    """What comes from the instrument, so much later than usual."""

    data: bytes
    delay_s: float = 0.0


class Exchange:
    """One request, and the answer that the instrument would give.

    Attributes
    ----------
    request : bytes
        What was sent.
    earlier_reply : bytes
        The reply to the request before.
    """

    def __init__(self, request: bytes, earlier_reply: bytes, ask: Callable[[], bytes]) -> None:
        self.request = request
        self.earlier_reply = earlier_reply
        self._ask = ask

    @cached_property
    def answer(self) -> bytes:
        """The right reply; the instrument carries the request out when this is first asked for."""
        return self._ask()


#: Gives the reply in place of the right one; None leaves the exchange as it is.
Disturbance = Callable[[Exchange], Reply | None]


class FaultySerial:
    """An emulated instrument with disturbances of its exchanges.

    Attributes
    ----------
    latency_s : float
        Time that the reply which :meth:`feed` last returned takes.
    powered : bool
        Whether the instrument hears and answers at all.
    connection : Connection
        The plug.
    disturbances : list of callable
        The first one that acts on an exchange is the only one.
    """

    def __init__(self, instrument: SerialInstrument) -> None:
        self._instrument = instrument
        self.latency_s = instrument.latency_s
        self.connection = Connection()
        self.powered = True
        self.disturbances: list[Disturbance] = []
        self._earlier_reply = b""

    def feed(self, data: bytes, now_s: float) -> bytes:
        """Take bytes; see :class:`gyrobench.drivers.emulators.serial_instrument.SerialInstrument`."""
        self.latency_s = self._instrument.latency_s
        if not self.powered:
            return b""
        if not self.disturbances:
            reply = self._instrument.feed(data, now_s)
            self._earlier_reply = reply or self._earlier_reply
            return reply
        exchange = Exchange(data, self._earlier_reply, lambda: self._instrument.feed(data, now_s))
        reply, delay_s = self._disturbed(exchange)
        self.latency_s += delay_s
        return reply

    def _disturbed(self, exchange: Exchange) -> Reply:
        for disturbance in tuple(self.disturbances):
            reply = disturbance(exchange)
            if reply is not None:
                if "answer" in vars(exchange):
                    self._earlier_reply = exchange.answer or self._earlier_reply
                return reply
        self._earlier_reply = exchange.answer or self._earlier_reply
        return Reply(exchange.answer)
