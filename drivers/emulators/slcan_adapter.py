"""An emulated serial-line CAN adapter (slcan, the LAWICEL protocol) with the emulated INS on its bus.

Every line ends with a carriage return. ``O`` opens and ``C`` closes the channel, ``Sn`` and ``sxxyy``
set the bit rate, ``V`` and ``N`` tell version and number; ``tiiildd..`` and ``Tiiiiiiiildd..`` are data
frames in either direction. A good command is answered with CR (``z``/``Z`` before it for a frame), a
bad one with BEL.
"""

from __future__ import annotations

import can

from drivers.emulators.can_ins import CanInsEmulator

_OK, _ERROR = b"\r", b"\a"
_LONGEST_LINE = 64
_DATA_FRAME = re.compile(r"(?:t([0-9A-F]{3})|T([0-9A-F]{8}))([0-8])((?:[0-9A-F]{2})*)", re.ASCII | re.IGNORECASE)
#: Settings without effect here: bit rate, no time stamps, acceptance code and mask.
_SETTING = re.compile(r"S[0-8]|s[0-9A-F]{4}|Y[25]|Z0|[Mm][0-9A-F]{8}|", re.ASCII | re.IGNORECASE)


class SlcanAdapter:
    """The adapter between a serial line and the INS's bus.

    Parameters
    ----------
    ins : CanInsEmulator
        What is on the bus.
    """

    latency_s = 0.0

    def __init__(self, ins: CanInsEmulator) -> None:
        self._ins = ins
        self._open = False
        self._line = bytearray()
        self._received = bytearray()
        ins.listeners.append(self._on_bus)

    def feed(self, data: bytes, now_s: float) -> bytes:  # noqa: ARG002
        """Take bytes from the line; see :class:`drivers.emulators.serial_instrument.SerialInstrument`."""
        reply = bytearray()
        for byte in data:
            if byte == _OK[0]:
                reply += self._obey(self._line.decode("ascii", "replace"))
                self._line.clear()
            elif len(self._line) < _LONGEST_LINE:
                self._line.append(byte)
        return bytes(reply)

    def from_bus(self) -> bytes:
        """Frames received from the bus since the last call, as lines."""
        lines = bytes(self._received)
        self._received.clear()
        return lines

    def _obey(self, line: str) -> bytes:
        match line[:1]:
            case "O" | "L":
                self._open = True
            case "C":
                self._open = False
            case "V":
                return b"V1013\r"
            case "N":
                return b"NEMUL\r"
            case "t" | "T" if self._open:
                return self._send(line)
            case "S" | "s" | "Y" | "Z" | "M" | "m" | "":
                pass
            case _:
                return _ERROR
        return _OK

    def _send(self, line: str) -> bytes:
        digits = 3 if line[0] == "t" else 8
        try:
            identifier = int(line[1 : 1 + digits], 16)
            length = int(line[1 + digits])
            data = bytes.fromhex(line[2 + digits :])
        except (ValueError, IndexError):
            return _ERROR
        if length != len(data) or length > 8:
            return _ERROR
        extended = line[0] == "T"
        try:
            message = can.Message(arbitration_id=identifier, data=data, is_extended_id=extended, check=True)
        except ValueError:
            return _ERROR
        self._ins.receive(message)
        return b"Z\r" if extended else b"z\r"

    def _on_bus(self, messages: list[can.Message]) -> None:
        if self._open:
            for message in messages:
                self._received += (
                    f"t{message.arbitration_id:03X}{message.dlc}{message.data.hex().upper()}\r".encode()
                )
