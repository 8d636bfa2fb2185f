"""An emulated serial-line CAN adapter (slcan, the LAWICEL protocol) with the emulated INS on its bus.

Every line ends with a carriage return. ``O`` opens the channel, ``L`` opens it to listen alone, ``C``
closes it, ``Sn`` and ``sxxyy`` set the bit rate, ``V`` and ``N`` tell version and number; ``tiiildd..``
and ``Tiiiiiiiildd..`` are data frames in either direction. A good command is answered with CR (``z``/``Z``
before it for a frame), a bad one with BEL.
"""

from __future__ import annotations

import re

import can

from gyrobench.drivers.emulators.can_ins import CanNode
from gyrobench.drivers.emulators.serial_instrument import Connection

_OK, _ERROR = b"\r", b"\a"
_LONGEST_LINE = 64
_DATA_FRAME = re.compile(
    r"(?:t(?P<base>[0-9A-Fa-f]{3})|T(?P<extended>[0-9A-Fa-f]{8}))"
    r"(?P<length>[0-8])(?P<data>(?:[0-9A-Fa-f]{2})*)"
)
#: Settings without effect here: bit rate, no time stamps, acceptance code and mask; the empty line.
_SETTING = re.compile(r"S[0-8]|s[0-9A-Fa-f]{4}|Z0|[Mm][0-9A-Fa-f]{8}|")


class SlcanAdapter:
    """The adapter between a serial line and the INS's bus.

    Parameters
    ----------
    bus : CanNode
        The bus with the INS on it.
    connection : Connection
        Broken while the adapter is bus-off; the channel has to be opened anew then.
    """

    latency_s = 0.0

    def __init__(self, bus: CanNode, connection: Connection) -> None:
        self._bus = bus
        self._connection = connection
        self._opened_number = connection.number
        self._open = self._listens_only = False
        self._line = bytearray()
        self._received = bytearray()
        bus.listeners.append(self._on_bus)

    def feed(self, data: bytes, now_s: float) -> bytes:  # noqa: ARG002
        """Take bytes from the line; see ``SerialInstrument.feed``."""
        reply = bytearray()
        for byte in data:
            if byte == _OK[0]:
                reply += self._obey(self._line.decode("ascii", "replace"))
                self._line.clear()
            elif len(self._line) <= _LONGEST_LINE:
                self._line.append(byte)
        return bytes(reply)

    def from_bus(self) -> bytes:
        """Frames received from the bus since the last call, as lines."""
        lines = bytes(self._received)
        self._received.clear()
        return lines

    def _obey(self, line: str) -> bytes:
        if self._connection.number != self._opened_number:
            self._open = False
        match line:
            case "O" | "L":
                if self._connection.broken:
                    return _ERROR
                self._opened_number = self._connection.number
                self._open, self._listens_only = True, line == "L"
                return _OK
            case "C":
                self._open = False
                return _OK
            case "V":
                return b"V1013\r"
            case "N":
                return b"NEMUL\r"
        if self._open and (frame := _DATA_FRAME.fullmatch(line)):
            return self._send(frame)
        return _OK if _SETTING.fullmatch(line) else _ERROR

    def _send(self, frame: re.Match[str]) -> bytes:
        data = bytes.fromhex(frame["data"])
        if int(frame["length"]) != len(data) or self._listens_only:
            return _ERROR
        extended = frame["base"] is None
        identifier = int(frame["extended"] if extended else frame["base"], 16)
        try:
            message = can.Message(arbitration_id=identifier, data=data, is_extended_id=extended, check=True)
        except ValueError:
            return _ERROR
        self._bus.receive(message)
        return b"Z\r" if extended else b"z\r"

    def _on_bus(self, messages: list[can.Message]) -> None:
        if self._open and self._connection.number == self._opened_number:
            for message in messages:
                self._received += (
                    f"t{message.arbitration_id:03X}{message.dlc}{message.data.hex().upper()}\r".encode()
                )
