"""A Modbus RTU server with holding registers.

Frames and exception codes: MODBUS Application Protocol V1.1b3; CRC and silent interval: MODBUS
over Serial Line V1.02.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache

from pymodbus.framer.rtu import FramerRTU
from pymodbus.pdu import DecodePDU, ExceptionResponse, ModbusPDU
from pymodbus.pdu.register_message import (
    ReadHoldingRegistersRequest,
    ReadHoldingRegistersResponse,
    WriteMultipleRegistersRequest,
    WriteMultipleRegistersResponse,
    WriteSingleRegisterRequest,
    WriteSingleRegisterResponse,
)

#: Silence that ends a frame: longer than the 3.5 characters of the standard, to allow for the latency of a
#: computer's serial port.
_SILENT_INTERVAL_S = 0.05

_BROADCAST = 0
_EXCEPTION_BIT = 0x80
_ILLEGAL_FUNCTION, _ILLEGAL_ADDRESS, _ILLEGAL_VALUE = 1, 2, 3
_MAX_WRITTEN = 123
_REQUESTS: dict[int, type[ModbusPDU]] = {
    request.function_code: request
    for request in (ReadHoldingRegistersRequest, WriteSingleRegisterRequest, WriteMultipleRegistersRequest)
}


@dataclass(frozen=True)
class HoldingRegister:
    """One signed 16-bit register.

    ``write`` is None for a read-only register; ``allowed`` tests whether a value may be written.
    """

    read: Callable[[], int]
    write: Callable[[int], None] | None = None
    allowed: Callable[[int], bool] = lambda _: True


_framer = FramerRTU(DecodePDU(is_server=True))


def _encode_frame(address: int, reply: ModbusPDU) -> bytes:
    reply.dev_id = address
    return _framer.buildFrame(reply)


def exception_frame(address: int, function: int, code: int) -> bytes:
    """Return the frame in which the device at an address refuses a function."""
    return _encode_frame(address, ExceptionResponse(function, code))


@lru_cache(maxsize=1024)
def _register_reply(address: int, numbers: tuple[int, ...]) -> bytes:
    return _encode_frame(address, ReadHoldingRegistersResponse(registers=list(numbers)))


# Cached, as a poll repeats its requests, and most replies, for hours.
@lru_cache(maxsize=1024)
def _first_frame(received: bytes) -> tuple[bytes, bool]:
    """Find a complete frame.

    Returns the intact frame without its CRC, else empty bytes; and whether the received bytes can be dropped.
    The function code determines the length; with an unknown code, all bytes since the last silence are the
    frame.
    """
    if len(received) < FramerRTU.MIN_SIZE:
        return b"", False
    kind = _REQUESTS.get(received[1])
    size = kind.calculateRtuFrameSize(received) if kind else len(received)
    if not size or len(received) < size:
        return b"", False
    is_intact = FramerRTU.compute_CRC(received[:size]) == 0
    return received[: size - 2] if is_intact else b"", is_intact or kind is not None


@lru_cache(maxsize=1024)
def _decode_request(function: int, content: bytes) -> ModbusPDU:
    """Decode a request, which callers must not change; raises ValueError or struct.error."""
    request = _REQUESTS[function]()
    request.decode(content)
    return request


class ModbusRtuDevice:
    """Answers requests for holding registers: functions 03, 06 and 16.

    ``address`` is the device's address on the line, 1 to 247.
    """

    def __init__(self, registers: Mapping[int, HoldingRegister], address: int) -> None:
        self._registers = registers
        self._address = address
        self._received = bytearray()
        self._received_s = 0.0

    def feed(self, data: bytes, now_s: float) -> bytes:
        """Receive bytes at time ``now_s``; returns the reply to the request that they complete."""
        if now_s - self._received_s > _SILENT_INTERVAL_S:
            self._received.clear()
        self._received_s = now_s
        self._received += data
        frame, is_over = _first_frame(bytes(self._received))
        if is_over:
            self._received.clear()
        if not frame or frame[0] not in (self._address, _BROADCAST) or frame[1] & _EXCEPTION_BIT:
            return b""
        reply = self._execute(frame[1], frame[2:])
        return b"" if frame[0] == _BROADCAST else reply

    def _execute(self, function: int, content: bytes) -> bytes:
        """Execute a request; returns the frame of the reply."""
        if function not in _REQUESTS:
            return exception_frame(self._address, function, _ILLEGAL_FUNCTION)
        try:
            request = _decode_request(function, content)
        except (ValueError, struct.error):
            return exception_frame(self._address, function, _ILLEGAL_VALUE)
        first, values = request.address, request.registers
        match request:
            case ReadHoldingRegistersRequest():
                return self._read(function, first, request.count)
            case WriteSingleRegisterRequest():
                answer: ModbusPDU = WriteSingleRegisterResponse(address=first, registers=values)
            case WriteMultipleRegistersRequest():
                answer = WriteMultipleRegistersResponse(address=first, count=request.count)
                count = len(values)
                sizes_agree = request.count == count and request.byte_count == 2 * count
                if not 1 <= count <= _MAX_WRITTEN or not sizes_agree:
                    return exception_frame(self._address, function, _ILLEGAL_VALUE)
        failure = self._write(first, values)
        return (
            exception_frame(self._address, function, failure)
            if failure
            else _encode_frame(self._address, answer)
        )

    def _read(self, function: int, first: int, count: int) -> bytes:
        try:
            registers = [self._registers[address] for address in range(first, first + count)]
        except KeyError:
            return exception_frame(self._address, function, _ILLEGAL_ADDRESS)
        return _register_reply(self._address, tuple([register.read() & 0xFFFF for register in registers]))

    def _write(self, first: int, values: Sequence[int]) -> int:
        """Write successive registers up to a refused value; returns an exception code, or zero."""
        registers = [self._registers.get(first + offset) for offset in range(len(values))]
        if not all(register and register.write for register in registers):
            return _ILLEGAL_ADDRESS
        for register, value in zip(registers, map(_signed, values), strict=True):
            if register and register.write:
                if not register.allowed(value):
                    return _ILLEGAL_VALUE
                register.write(value)
        return 0


def _signed(number: int) -> int:
    return number - 0x10000 if number & 0x8000 else number
