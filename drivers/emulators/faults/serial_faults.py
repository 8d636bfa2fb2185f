"""Faults of a serial line and of the instrument behind it.

A disturbance affects the next ``replies`` replies; with ``for_s``, instead, all replies in that time.
"""

from __future__ import annotations

from functools import partial
from typing import Annotated, Literal

import numpy as np
from pydantic import Field
from typing_extensions import override

from gyrobench.drivers.emulators.acl_axis import ErrorCode
from gyrobench.drivers.emulators.acutrol3000 import Acutrol3000Emulator
from gyrobench.drivers.emulators.dialect import Restartable, SpeaksModbus
from gyrobench.drivers.emulators.faults.fault import (
    BenchParts,
    Count,
    End,
    Exchange,
    Fault,
    FaultySerial,
    Occurrence,
    Persistence,
    Reply,
)
from gyrobench.drivers.emulators.world.undeclared_effects import Positive

Target = Annotated[Literal["table", "chamber"], Field(description="affected line: table or chamber")]
_CRC_BYTES = 2


class LineFault(Fault):
    """A disturbance of exchanges."""

    immediate = False
    persistence = Persistence.UNTIL_USED

    target: Target
    replies: Count = Field(1, description="without for_s: number of affected replies")

    def _disturb(self, exchange: Exchange, bench: BenchParts, random: np.random.Generator) -> Reply | None:
        """Return the reply in place of the correct one; None leaves the exchange unchanged."""
        raise NotImplementedError

    def _begin(self, bench: BenchParts, occurrence: Occurrence) -> End:
        line = bench.lines[self.target]
        remaining = self.replies

        def disturb(exchange: Exchange) -> Reply | None:
            nonlocal remaining
            reply = self._disturb(exchange, bench, occurrence.random)
            if reply is not None:
                occurrence.record()
                remaining -= 1
                if self.for_s is None and remaining == 0:
                    line.disturbances.remove(disturb)
            return reply

        line.disturbances.append(disturb)
        return partial(line.disturbances.remove, disturb) if self.for_s is not None else None


class LostReply(LineFault):
    """The instrument executes the request, and its reply is lost."""

    fault: Literal["lost_reply"]

    def _disturb(self, exchange: Exchange, bench: BenchParts, random: np.random.Generator) -> Reply | None:
        return Reply(b"") if exchange.answer else None


class LostRequest(LineFault):
    """The request is lost: the instrument neither executes nor answers it."""

    fault: Literal["lost_request"]

    def _disturb(self, exchange: Exchange, bench: BenchParts, random: np.random.Generator) -> Reply | None:
        return Reply(b"")


class LateReply(LineFault):
    """The reply comes later than usual; later requests are answered after it."""

    fault: Literal["late_reply"]
    delay_s: Positive = Field(description="additional delay of the reply, s")

    def _disturb(self, exchange: Exchange, bench: BenchParts, random: np.random.Generator) -> Reply | None:
        return Reply(exchange.answer, self.delay_s) if exchange.answer else None


class HalfReply(LineFault):
    """Only the first half of the reply comes."""

    fault: Literal["half_reply"]

    def _disturb(self, exchange: Exchange, bench: BenchParts, random: np.random.Generator) -> Reply | None:
        return Reply(exchange.answer[: len(exchange.answer) // 2]) if exchange.answer else None


class EarlierReply(LineFault):
    """The reply to the previous request is repeated, in place of the correct one."""

    fault: Literal["earlier_reply"]

    def _disturb(self, exchange: Exchange, bench: BenchParts, random: np.random.Generator) -> Reply | None:
        return Reply(exchange.earlier_reply) if exchange.answer and exchange.earlier_reply else None


class Garbage(LineFault):
    """Random bytes come before the reply, or in place of it."""

    fault: Literal["garbage"]
    bytes: Count = Field(8, description="number of random bytes")
    instead: bool = Field(False, description="in place of the reply instead of before it")

    def _disturb(self, exchange: Exchange, bench: BenchParts, random: np.random.Generator) -> Reply | None:
        if not exchange.answer:
            return None
        return Reply(random.bytes(self.bytes) + (b"" if self.instead else exchange.answer))


class DamagedReply(LineFault):
    """One bit is wrong in each of ``bytes`` bytes of the reply."""

    fault: Literal["damaged_reply"]
    bytes: Count = Field(1, description="number of bytes with a wrong bit")

    def _disturb(self, exchange: Exchange, bench: BenchParts, random: np.random.Generator) -> Reply | None:
        if not exchange.answer:
            return None
        data = bytearray(exchange.answer)
        for index in random.choice(len(data), min(self.bytes, len(data)), replace=False).tolist():
            data[index] ^= 1 << int(random.integers(8))
        return Reply(bytes(data))


class WrongCrc(LineFault):
    """The CRC of a Modbus reply is wrong, its content correct."""

    requires = ("chamber", SpeaksModbus)
    fault: Literal["wrong_crc"]
    target: Literal["chamber"] = Field("chamber", description="affected line: the chamber's")

    def _disturb(self, exchange: Exchange, bench: BenchParts, random: np.random.Generator) -> Reply | None:
        answer = exchange.answer
        return Reply(answer[:-_CRC_BYTES] + bytes(b ^ 0xFF for b in answer[-_CRC_BYTES:])) if answer else None


class ExceptionCode(LineFault):
    """The chamber controller refuses the request with a Modbus exception code."""

    requires = ("chamber", SpeaksModbus)
    fault: Literal["exception_code"]
    target: Literal["chamber"] = Field("chamber", description="affected line: the chamber's")
    code: Annotated[int, Field(ge=1, le=255)] = Field(6, description="4 device failure, 6 busy")

    def _disturb(self, exchange: Exchange, bench: BenchParts, random: np.random.Generator) -> Reply | None:
        if len(exchange.request) <= _CRC_BYTES:
            return None
        return Reply(
            bench.require_capability("chamber", SpeaksModbus).refusal(exchange.request[1], self.code)
        )


class ErrorWord(LineFault):
    """The table controller refuses the request with an error word and its text."""

    requires = ("table", Acutrol3000Emulator)
    fault: Literal["error_word"]
    target: Literal["table"] = Field("table", description="affected line: the table's")
    error: Literal["syntax", "unknown_command", "parameter_out_of_range", "not_available"] = Field(
        "not_available", description="error word of the answer"
    )

    def _disturb(self, exchange: Exchange, bench: BenchParts, random: np.random.Generator) -> Reply | None:
        return Reply(
            bench.require_capability("table", Acutrol3000Emulator).refusal(ErrorCode[self.error.upper()])
        )


class PortGone(Fault):
    """The port is unplugged; clients must reopen it when it is back."""

    fault: Literal["port_gone"]
    target: Target

    def _begin(self, bench: BenchParts, occurrence: Occurrence) -> End:
        connection = bench.lines[self.target].connection
        connection.disconnect()
        return connection.reconnect


class InstrumentRestarts(Fault):
    """The instrument loses power, is silent for ``for_s``, and restarts with its defaults.

    The table's brakes stop it and its servos are open, limits and modes reset. The chamber's outputs
    are off (and with them the INS, where an event output feeds it), settings as last saved.
    """

    fault: Literal["instrument_restarts"]
    target: Target
    for_s: Positive = Field(10.0, description="boot time, s")

    @override
    def check(self, bench: BenchParts) -> None:
        bench.require_capability(self.target, Restartable)

    def _begin(self, bench: BenchParts, occurrence: Occurrence) -> End:
        line: FaultySerial = bench.lines[self.target]
        instrument = bench.require_capability(self.target, Restartable)
        line.powered = False
        instrument.power_off(occurrence.now_s())

        def restart() -> None:
            line.powered = True
            instrument.power_on(occurrence.now_s())

        return restart
