"""An emulated socketcand daemon with the emulated INS on its only bus.

socketcand carries CAN over TCP as text in angle brackets. This one knows what python-can says: ``open``,
``rawmode`` and ``send``, and ``echo``; frames go out as ``< frame ID SECONDS DATA >``. Another command, or
one in the wrong state, is answered with an error.
"""

from __future__ import annotations

import re

import can

from gyrobench.drivers.emulators.can_ins import CanNode
from gyrobench.drivers.emulators.serial_instrument import Connection

BUS_NAME = "can0"
_COMMAND = re.compile(rb"<\s*([^<>]*?)\s*>")
_LONGEST_COMMAND = 200
_SEND = re.compile(r"send ([0-9A-Fa-f]{1,8}) ([0-8])((?: [0-9A-Fa-f]{1,2})*)")
_BASE_DIGITS = 3
_OK = b"< ok >"


class SocketcandDaemon:
    """The daemon between a TCP connection and the INS's bus.

    Parameters
    ----------
    bus : CanNode
        The bus with the INS on it.
    connection : Connection
        Broken while the daemon's controller is bus-off; the bus has to be opened anew then.
    """

    latency_s = 0.0

    def __init__(self, bus: CanNode, connection: Connection) -> None:
        self._bus = bus
        self._connection = connection
        self._opened_number: int | None = None
        self._raw = False
        self._line = b""
        self._received = bytearray()
        bus.listeners.append(self._on_bus)

    def greet(self) -> bytes:
        """Begin with a new client."""
        self._opened_number, self._raw = None, False
        self._line = b""
        self._received.clear()
        return b"< hi >"

    def feed(self, data: bytes, now_s: float) -> bytes:  # noqa: ARG002
        """Take bytes; see :class:`gyrobench.drivers.emulators.serial_instrument.SerialInstrument`."""
        self._line += data
        reply, end = b"", 0
        for command in _COMMAND.finditer(self._line):
            reply += self._obey(command[1].decode("ascii", "replace"))
            end = command.end()
        self._line = self._line[end:][-_LONGEST_COMMAND:]
        return reply

    def from_bus(self) -> bytes:
        """Frames received from the bus since the last call."""
        frames = bytes(self._received)
        self._received.clear()
        return frames

    @property
    def _is_open(self) -> bool:
        return self._opened_number == self._connection.number

    def _obey(self, command: str) -> bytes:
        if command == f"open {BUS_NAME}" and not self._connection.broken:
            self._opened_number = self._connection.number
            return _OK
        if command == "rawmode" and self._is_open:
            self._raw = True
            return _OK
        if command == "echo":
            return b"< echo >"
        if self._raw and self._is_open and (sent := _SEND.fullmatch(command)):
            return self._send(sent)
        return b"< error unknown command >"

    def _send(self, sent: re.Match[str]) -> bytes:
        data = bytes(int(byte, 16) for byte in sent[3].split())
        try:
            message = can.Message(
                arbitration_id=int(sent[1], 16),
                data=data,
                is_extended_id=len(sent[1]) > _BASE_DIGITS,
                check=True,
            )
        except ValueError:
            return b"< error wrong frame >"
        if len(data) != int(sent[2]):
            return b"< error wrong frame >"
        self._bus.receive(message)
        return b""

    def _on_bus(self, messages: list[can.Message]) -> None:
        if self._raw and self._is_open:
            for message in messages:
                self._received += (
                    f"< frame {message.arbitration_id:03X} {message.timestamp:.6f} "
                    f"{message.data.hex().upper()} >".encode()
                )
