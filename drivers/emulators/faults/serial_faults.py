"""Faults of a serial line and of what hangs on it.

Without ``for_s`` a disturbance touches the next ``replies``, with it all replies in that time.
"""

from __future__ import annotations

from functools import partial
from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import Field
from typing_extensions import override

from gyrobench.drivers.emulators.acl_syntax import ErrorCode
from gyrobench.drivers.emulators.acutrol3000 import Acutrol3000Emulator
from gyrobench.drivers.emulators.dialect import Restartable, SpeaksModbus
from gyrobench.drivers.emulators.faults.fault import BenchParts, End, Fault, Occurrence
from gyrobench.drivers.emulators.faults.faulty_serial import Exchange, FaultySerial, Reply
from gyrobench.drivers.emulators.faults.timing import Count, Lasting
from gyrobench.drivers.emulators.world.undeclared_effects import Positive

LineName = Literal["table", "chamber"]
_CRC_BYTES = 2


class LineFault(Fault):
    """A disturbance of exchanges."""

    lasting: ClassVar[Lasting] = Lasting.UNTIL_USED

    target: LineName = Field(description="whose line: table or chamber")
    replies: Count = Field(1, description="without for_s: how many replies it touches")

    def disturb(self, exchange: Exchange, bench: BenchParts, random: np.random.Generator) -> Reply | None:
        """Give what comes in place of the right reply; None leaves the exchange alone."""
        raise NotImplementedError

    @override
    def begin(self, bench: BenchParts, occurrence: Occurrence) -> End:
        line = bench.lines[self.target]
        left = self.replies

        def disturbance(exchange: Exchange) -> Reply | None:
            nonlocal left
            reply = self.disturb(exchange, bench, occurrence.random)
            if reply is not None:
                occurrence.record()
                left -= 1
                if self.for_s is None and left == 0:
                    line.disturbances.remove(disturbance)
            return reply

        line.disturbances.append(disturbance)
        return partial(line.disturbances.remove, disturbance) if self.for_s is not None else None


class LostReply(LineFault):
    """The instrument does what it was told, and its reply is lost."""

    fault: Literal["lost_reply"]

    @override
    def disturb(self, exchange: Exchange, bench: BenchParts, random: np.random.Generator) -> Reply | None:
        return Reply(b"") if exchange.answer else None


class LostRequest(LineFault):
    """The request is lost: nothing is done and nothing is answered."""

    fault: Literal["lost_request"]

    @override
    def disturb(self, exchange: Exchange, bench: BenchParts, random: np.random.Generator) -> Reply | None:
        return Reply(b"")


class LateReply(LineFault):
    """The reply comes later than usual; what is asked meanwhile is answered after it."""

    fault: Literal["late_reply"]
    delay_s: Positive = Field(description="how much later the reply comes, s")

    @override
    def disturb(self, exchange: Exchange, bench: BenchParts, random: np.random.Generator) -> Reply | None:
        return Reply(exchange.answer, self.delay_s) if exchange.answer else None


class HalfReply(LineFault):
    """Only the first half of the reply comes."""

    fault: Literal["half_reply"]

    @override
    def disturb(self, exchange: Exchange, bench: BenchParts, random: np.random.Generator) -> Reply | None:
        return Reply(exchange.answer[: len(exchange.answer) // 2]) if exchange.answer else None


class EarlierReply(LineFault):
    """The reply to the request before comes once more, in place of the right one."""

    fault: Literal["earlier_reply"]

    @override
    def disturb(self, exchange: Exchange, bench: BenchParts, random: np.random.Generator) -> Reply | None:
        return Reply(exchange.earlier_reply) if exchange.answer and exchange.earlier_reply else None


class Garbage(LineFault):
    """Random bytes come before the reply, or in place of it."""

    fault: Literal["garbage"]
    bytes: Count = Field(default=8, description="how many random bytes come")
    instead: bool = Field(default=False, description="in place of the reply, not before it")

    @override
    def disturb(self, exchange: Exchange, bench: BenchParts, random: np.random.Generator) -> Reply | None:
        if not exchange.answer:
            return None
        return Reply(random.bytes(self.bytes) + (b"" if self.instead else exchange.answer))


class DamagedReply(LineFault):
    """One bit is wrong in each of so many bytes of the reply."""

    fault: Literal["damaged_reply"]
    bytes: Count = Field(default=1, description="in how many bytes one bit is wrong")

    @override
    def disturb(self, exchange: Exchange, bench: BenchParts, random: np.random.Generator) -> Reply | None:
        if not exchange.answer:
            return None
        data = bytearray(exchange.answer)
        for place in random.choice(len(data), min(self.bytes, len(data)), replace=False).tolist():
            data[place] ^= 1 << int(random.integers(8))
        return Reply(bytes(data))


class WrongCrc(LineFault):
    """The check sum of a Modbus reply is wrong, its content right."""

    fault: Literal["wrong_crc"]
    target: Literal["chamber"] = Field(
        default="chamber", description="whose line; only the chamber's can have it"
    )

    @override
    def check(self, bench: BenchParts) -> None:
        bench.able("chamber", SpeaksModbus)

    @override
    def disturb(self, exchange: Exchange, bench: BenchParts, random: np.random.Generator) -> Reply | None:
        answer = exchange.answer
        return Reply(answer[:-_CRC_BYTES] + bytes(b ^ 0xFF for b in answer[-_CRC_BYTES:])) if answer else None


class ExceptionCode(LineFault):
    """The chamber controller does nothing and answers with a Modbus exception code."""

    fault: Literal["exception_code"]
    target: Literal["chamber"] = Field(
        default="chamber", description="whose line; only the chamber's can have it"
    )
    code: Annotated[int, Field(ge=1, le=255)] = Field(6, description="4 device failure, 6 busy")

    @override
    def check(self, bench: BenchParts) -> None:
        bench.able("chamber", SpeaksModbus)

    @override
    def disturb(self, exchange: Exchange, bench: BenchParts, random: np.random.Generator) -> Reply | None:
        if len(exchange.request) <= _CRC_BYTES:
            return None
        return Reply(bench.able("chamber", SpeaksModbus).refusal(exchange.request[1], self.code))


class ErrorWord(LineFault):
    """The table controller does nothing and answers with an error word and its text."""

    fault: Literal["error_word"]
    target: Literal["table"] = Field(default="table", description="whose line; only the table's can have it")
    error: Literal["syntax", "unknown_command", "parameter_out_of_range", "not_available"] = Field(
        default="not_available", description="what the table answers"
    )

    @override
    def check(self, bench: BenchParts) -> None:
        bench.able("table", Acutrol3000Emulator)

    @override
    def disturb(self, exchange: Exchange, bench: BenchParts, random: np.random.Generator) -> Reply | None:
        return Reply(bench.able("table", Acutrol3000Emulator).refusal(ErrorCode[self.error.upper()]))


class PortGone(Fault):
    """The port is unplugged; whoever had it open has to open it anew after it is back."""

    fault: Literal["port_gone"]
    target: LineName = Field(description="whose line: table or chamber")

    @override
    def begin(self, bench: BenchParts, occurrence: Occurrence) -> End:
        connection = bench.lines[self.target].connection
        connection.cut()
        occurrence.record()
        return connection.mend


class InstrumentRestarts(Fault):
    """The instrument loses power, is silent for ``for_s``, and comes back with its defaults.

    The table's brakes stop it and its servos are open, limits and modes reset. The chamber's outputs
    are off (and with them the INS, where an event output feeds it), settings as last saved.
    """

    fault: Literal["instrument_restarts"]
    target: LineName = Field(description="whose line: table or chamber")
    for_s: Positive = Field(10.0, description="time that it takes to boot")

    @override
    def check(self, bench: BenchParts) -> None:
        bench.able(self.target, Restartable)

    @override
    def begin(self, bench: BenchParts, occurrence: Occurrence) -> End:
        line: FaultySerial = bench.lines[self.target]
        instrument = bench.able(self.target, Restartable)
        line.powered = False
        occurrence.record()
        instrument.power_off(occurrence.now_s())

        def come_back() -> None:
            line.powered = True
            instrument.power_on(occurrence.now_s())

        return come_back


SerialFault = (
    LostReply
    | LostRequest
    | LateReply
    | HalfReply
    | EarlierReply
    | Garbage
    | DamagedReply
    | WrongCrc
    | ExceptionCode
    | ErrorWord
    | PortGone
    | InstrumentRestarts
)
