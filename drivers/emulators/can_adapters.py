"""Emulated CAN adapters, slcan (LAWICEL protocol) and socketcand, with the emulated INS on their bus."""

from __future__ import annotations

import re
from abc import ABC, abstractmethod

import can

from gyrobench.drivers.emulators.can_ins import CanNode
from gyrobench.drivers.emulators.dialect import Connection
from gyrobench.drivers.frames import FrameBlock

#: Name of the bus that the socketcand daemon offers.
BUS_NAME = "can0"
_CR, _BEL = b"\r", b"\a"
_MAX_LINE, _MAX_COMMAND = 64, 200
_DATA_FRAME = re.compile(
    r"(?:t(?P<base>[0-9A-Fa-f]{3})|T(?P<extended>[0-9A-Fa-f]{8}))"
    r"(?P<length>[0-8])(?P<data>(?:[0-9A-Fa-f]{2})*)"
)
#: Commands without effect here: bit rate, time stamps off, acceptance code and mask; the empty line.
_SETTING = re.compile(r"S[0-8]|s[0-9A-Fa-f]{4}|Z0|[Mm][0-9A-Fa-f]{8}|")
_COMMAND = re.compile(rb"<\s*([^<>]*?)\s*>")
_SEND = re.compile(r"send ([0-9A-Fa-f]{1,8}) ([0-8])((?: [0-9A-Fa-f]{1,2})*)")
_BASE_DIGITS = 3


class CanAdapter(ABC):
    """An adapter between a byte stream and the INS's bus.

    ``connection`` is broken while the adapter is bus-off; the client must then reopen the bus.
    """

    latency_s = 0.0

    def __init__(self, bus: CanNode, connection: Connection) -> None:
        self._bus = bus
        self._connection = connection
        self._open_generation: int | None = None
        self._input = b""
        self._received = bytearray()
        bus.listeners.append(self._on_bus)

    @abstractmethod
    def feed(self, data: bytes, now_s: float) -> bytes:
        """Receive bytes; see :meth:`gyrobench.drivers.emulators.dialect.SerialInstrument.feed`."""

    def leave_bus(self) -> None:
        """Stop receiving frames from the bus."""
        self._bus.listeners.remove(self._on_bus)

    def from_bus(self) -> bytes:
        """Return the frames received from the bus since the last call, as bytes for the client."""
        frames = bytes(self._received)
        self._received.clear()
        return frames

    def _open_bus(self) -> bool:
        if not self._connection.broken:
            self._open_generation = self._connection.generation
        return not self._connection.broken

    @property
    def _is_open(self) -> bool:
        return self._open_generation == self._connection.generation

    def _send(self, identifier: str, extended: bool, data: bytes, length: str) -> bool:
        """Send a frame, with its identifier in hexadecimal, to the bus; returns False if it is invalid."""
        try:
            message = can.Message(
                arbitration_id=int(identifier, 16), data=data, is_extended_id=extended, check=True
            )
        except ValueError:
            return False
        if len(data) != int(length):
            return False
        self._bus.receive(message)
        return True

    def _on_bus(self, frames: FrameBlock) -> None:
        if self._is_open:
            self._received += self._encode(frames).encode()

    @abstractmethod
    def _encode(self, frames: FrameBlock) -> str:
        """Encode frames from the bus as text."""


class SlcanAdapter(CanAdapter):
    """An adapter on a serial line; every line ends with a carriage return.

    ``O`` opens the channel, ``L`` opens it in listen-only mode, ``C`` closes it, ``Sn`` and ``sxxyy`` set the
    bit rate, ``V`` and ``N`` read version and number; ``tiiildd..`` and ``Tiiiiiiiildd..`` are data frames in
    either direction. The answer to a valid command is CR (to a frame, ``z`` or ``Z`` and CR), to any other
    command BEL.
    """

    _listen_only = False

    def feed(self, data: bytes, now_s: float) -> bytes:  # noqa: ARG002
        """Receive bytes; returns the answers to the lines that they complete."""
        *lines, rest = (self._input + data).split(_CR)
        self._input = rest[: _MAX_LINE + 1]
        return b"".join(self._execute(line[: _MAX_LINE + 1].decode("ascii", "replace")) for line in lines)

    def _execute(self, line: str) -> bytes:
        match line:
            case "O" | "L":
                self._listen_only = line == "L"
                return _CR if self._open_bus() else _BEL
            case "C":
                self._open_generation = None
                return _CR
            case "V":
                return b"V1013\r"
            case "N":
                return b"NEMUL\r"
        if self._is_open and (frame := _DATA_FRAME.fullmatch(line)):
            extended = frame["base"] is None
            identifier = frame["extended"] if extended else frame["base"]
            data = bytes.fromhex(frame["data"])
            if self._listen_only or not self._send(identifier, extended, data, frame["length"]):
                return _BEL
            return b"Z\r" if extended else b"z\r"
        return _CR if _SETTING.fullmatch(line) else _BEL

    def _encode(self, frames: FrameBlock) -> str:
        rows = zip(frames.arbitration_id.tolist(), frames.length.tolist(), _hexadecimal(frames), strict=True)
        return "".join([f"t{identifier:03X}{length}{data}\r" for identifier, length, data in rows])


class SocketcandDaemon(CanAdapter):
    """The side of a socketcand daemon that serves one TCP client: CAN as text in angle brackets, one bus.

    It implements the commands that python-can uses: ``open``, ``rawmode``, ``send`` and ``echo``; frames are
    sent as ``< frame ID SECONDS DATA >``. The answer to an unknown command, or to one in the wrong state, is
    an error.
    """

    #: Sent to a new client.
    GREETING = b"< hi >"

    _raw = False

    def feed(self, data: bytes, now_s: float) -> bytes:  # noqa: ARG002
        """Receive bytes; returns the answers to the commands that they complete."""
        self._input += data
        reply, end = b"", 0
        for command in _COMMAND.finditer(self._input):
            reply += self._execute(command[1].decode("ascii", "replace"))
            end = command.end()
        self._input = self._input[end:][-_MAX_COMMAND:]
        return reply

    def _execute(self, command: str) -> bytes:
        if command == f"open {BUS_NAME}" and self._open_bus():
            return b"< ok >"
        if command == "rawmode" and self._is_open:
            self._raw = True
            return b"< ok >"
        if command == "echo":
            return b"< echo >"
        if self._raw and self._is_open and (sent := _SEND.fullmatch(command)):
            data = bytes(int(byte, 16) for byte in sent[3].split())
            valid = self._send(sent[1], len(sent[1]) > _BASE_DIGITS, data, sent[2])
            return b"" if valid else b"< error wrong frame >"
        return b"< error unknown command >"

    def _encode(self, frames: FrameBlock) -> str:
        if not self._raw:
            return ""
        times_s = frames.timestamp_s.tolist()
        rows = zip(frames.arbitration_id.tolist(), times_s, _hexadecimal(frames), strict=True)
        return "".join([f"< frame {number:03X} {time_s:.6f} {data} >" for number, time_s, data in rows])


def _hexadecimal(frames: FrameBlock) -> list[str]:
    """Data bytes of each frame in hexadecimal."""
    digits = frames.data.tobytes().hex().upper()
    return [digits[16 * k : 16 * k + 2 * length] for k, length in enumerate(frames.length.tolist())]
