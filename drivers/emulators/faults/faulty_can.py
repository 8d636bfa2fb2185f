"""The CAN bus with faults between the INS and whoever listens."""

from __future__ import annotations

from collections.abc import Callable

import can

from gyrobench.drivers.emulators.can_ins import CanInsEmulator
from gyrobench.drivers.emulators.serial_instrument import Connection

#: Makes the frames that arrive from those that were sent.
FrameFilter = Callable[[list[can.Message]], list[can.Message]]


class FaultyCan:
    """The emulated INS behind filters of its frames.

    Attributes
    ----------
    listeners : list of callable
        As those of :class:`gyrobench.drivers.emulators.can_ins.CanInsEmulator`.
    connection : Connection
        Broken while the controller is bus-off.
    filters : list of callable
        What the frames go through, in this order.
    """

    def __init__(self, ins: CanInsEmulator) -> None:
        self._ins = ins
        self.listeners: list[Callable[[list[can.Message]], None]] = []
        self.connection = Connection()
        self.filters: list[FrameFilter] = []
        ins.listeners.append(self._pass_on)

    def receive(self, message: can.Message) -> None:
        """Take a frame to the INS."""
        if not self.connection.broken:
            self._ins.receive(message)

    def _pass_on(self, messages: list[can.Message]) -> None:
        if self.connection.broken:
            return
        for each in tuple(self.filters):
            messages = each(messages)
        for listener in self.listeners:
            listener(messages)
