"""Modbus RTU master: reads and writes the holding registers of one device.

Frames and exception codes: MODBUS Application Protocol V1.1b3; CRC and silent interval: MODBUS
over Serial Line V1.02.

The reply to a read does not name its register, so a late reply could be taken for the reply to the next
request. After a failed exchange, therefore, nothing is sent until the line has been silent for the reply
time-out, and the next reply is accepted only if no other follows it, as replies come in the order of the
requests. Two cases can't be detected: a late reply after which the right one is lost, and a second copy of a
reply that arrives after the next request.

Many two-wire adapters echo what is sent (local echo). The first read detects that; each later exchange
expects the echo. Without the detection, the echo of a write would pass for its reply.
"""

from __future__ import annotations

import struct
from enum import IntEnum
from functools import lru_cache

from gyrobench.bench.foundations.clock import Deadline
from gyrobench.bench.foundations.errors import NoReplyError, RefusedError, ReplyError
from gyrobench.drivers.serial_line import NEXT_REPLY_S, SerialLine

#: A frame ends with a silence of 3.5 characters, 4 ms at 9600 baud.
PAUSE_AFTER_READ_S = 0.005
#: Time in which controllers store a written value; they do not receive meanwhile.
_PAUSE_AFTER_WRITE_S = 0.03

_READ, _WRITE = 3, 6
_EXCEPTION_BIT = 0x80
_EXCEPTION_FRAME_BYTES = 5
_ILLEGAL_ADDRESS = 2
_EXCEPTIONS = {1: "illegal function", 2: "illegal data address", 3: "illegal data value", 4: "device failure"}


def _crc_entry(byte: int) -> int:
    for _ in range(8):
        byte = (byte >> 1) ^ 0xA001 if byte & 1 else byte >> 1
    return byte


_CRC_TABLE = tuple(_crc_entry(byte) for byte in range(256))


@lru_cache(maxsize=1024)
def crc16(data: bytes) -> int:
    """CRC-16/MODBUS; zero for an intact frame."""
    crc = 0xFFFF
    for byte in data:
        crc = (crc >> 8) ^ _CRC_TABLE[(crc ^ byte) & 0xFF]
    return crc


@lru_cache(maxsize=1024)
def append_crc(content: bytes) -> bytes:
    """Append the CRC, low byte first."""
    return content + crc16(content).to_bytes(2, "little")


@lru_cache(maxsize=1024)
def _read_request(address: int, register: int, count: int) -> tuple[bytes, bytes]:
    """Content of a request for registers, and the first bytes of its reply."""
    return struct.pack(">BBHH", address, _READ, register, count), bytes((address, _READ, 2 * count))


class UnknownRegisterError(RefusedError):
    """The device has no such register."""


class ModbusRtu:
    """Reads and writes registers of the device at one address of a line, 1 to 247; a read comes first."""

    def __init__(self, line: SerialLine, address: int, reply_timeout_s: float) -> None:
        self._line = line
        self._address = address
        self._reply_timeout_s = reply_timeout_s
        self._next_request_s = line.clock.now()
        self._out_of_sync = False
        self._has_echo = False

    def read(self, register: int, count: int = 1) -> tuple[int, ...]:
        """Read successive registers as signed 16-bit numbers.

        Raises RefusedError if the device replied with an exception, UnknownRegisterError for that of an
        illegal address. Raises ReplyError, NoReplyError or ConnectionFailedError if there was no valid reply.
        """
        request, start = _read_request(self._address, register, count)
        reply = self._exchange(request, start, len(start) + 2 * count + 2, PAUSE_AFTER_READ_S)
        if reply[1] & _EXCEPTION_BIT:
            raise self._refused(reply, f"read {_label(register)}")
        return struct.unpack(f">{count}h", reply[len(start) : -2])

    def write(self, register: int, value: int) -> None:
        """Write one register as a signed 16-bit number; raises as :meth:`read`."""
        request = struct.pack(">BBHh", self._address, _WRITE, register, value)
        reply = self._exchange(request, request, len(request) + 2, _PAUSE_AFTER_WRITE_S)
        if reply[1] & _EXCEPTION_BIT:
            raise self._refused(reply, f"write {value} to {_label(register)}")

    def _exchange(self, request: bytes, start: bytes, size: int, pause_s: float) -> bytes:
        """Send a request; returns its reply, of ``size`` bytes that begin with ``start``, or an exception."""
        clock = self._line.clock
        clock.sleep_until(self._next_request_s)
        may_be_late = self._out_of_sync
        if may_be_late:
            self._line.await_silence(self._reply_timeout_s)
        self._out_of_sync = True
        self._next_request_s = clock.now() + self._reply_timeout_s
        self._line.discard_input()
        self._line.write(append_crc(request))
        reply = self._receive(request, size)
        if crc16(reply) != 0:
            raise self._unexpected(request, reply, "the CRC is wrong; check cable, baud rate and parity")
        if not reply.startswith(start) and reply[:2] != bytes((self._address, request[1] | _EXCEPTION_BIT)):
            raise self._unexpected(request, reply, "another device or function replied; check the address")
        if may_be_late and self._another_reply_follows():
            raise self._unexpected(request, reply, "it is the late reply to an earlier request")
        self._out_of_sync = False
        self._next_request_s = clock.now() + pause_s
        return reply

    def _receive(self, request: bytes, size: int) -> bytes:
        """Receive the reply to a request, of ``size`` bytes, or an exception; skips the adapter's echo."""
        deadline = Deadline(self._line.clock, self._reply_timeout_s)
        sent = append_crc(request)
        if self._has_echo and (echo := self._read(len(sent), deadline)) != sent:
            raise self._unexpected(request, echo, "the adapter echoed other bytes; check for another master")
        reply = self._read(_EXCEPTION_FRAME_BYTES, deadline)
        if request[1] == _READ and sent.startswith(reply) and not self._has_echo:
            reply += self._read(min(size, len(sent)) - len(reply), deadline)
            if sent.startswith(reply):
                self._has_echo = True
                self._read(len(sent) - len(reply), deadline)
                reply = self._read(_EXCEPTION_FRAME_BYTES, deadline)
        if reply[1] & _EXCEPTION_BIT:
            return reply
        return reply + self._read(size - len(reply), deadline)

    def _read(self, count: int, deadline: Deadline) -> bytes:
        settings = f"this baud rate and Modbus address {self._address}"
        return self._line.read(count, deadline, settings) if count else b""

    def _another_reply_follows(self) -> bool:
        """Whether further bytes arrive within :data:`NEXT_REPLY_S`."""
        try:
            self._line.read(1, Deadline(self._line.clock, NEXT_REPLY_S))
        except NoReplyError:
            return False
        return True

    def _unexpected(self, request: bytes, reply: bytes, problem: str) -> ReplyError:
        return ReplyError(
            self._line.instrument,
            f"sent {request.hex(' ')}, received {reply.hex(' ')} on {self._line.address}: {problem}",
        )

    def _refused(self, reply: bytes, attempt: str) -> RefusedError:
        code = reply[2]
        meaning = _EXCEPTIONS.get(code, "unknown")
        refusal = UnknownRegisterError if code == _ILLEGAL_ADDRESS else RefusedError
        return refusal(self._line.instrument, f"refused to {attempt}: exception {code:02d}, {meaning}")


def _label(register: int) -> str:
    name = f" ({register.name.replace('_', ' ').lower()})" if isinstance(register, IntEnum) else ""
    return f"register {int(register)}{name}"
