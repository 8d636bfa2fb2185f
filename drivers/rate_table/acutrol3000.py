"""Driver of the Acutronic Acutrol 3000 table controller, on RS-232 or its TCP socket.

Sources: manuals TM-8004 (command language, registers) and TM-9374A (error word and length before a
reply). They do not give the byte order of the two words over TCP and RS-232. On a continuous axis
the controller takes the shortest way to a position, so the direction of a turn of 180 deg is
undefined: axes must be set up with position limits, where the demanded angle decides the direction.

A reply does not name its request, and replies come in the order of the requests. So after a failed
exchange a status register is read a number of times that no other query has: what arrives before that
reply belongs to earlier requests.
"""

from __future__ import annotations

import math
import re
import struct
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields
from itertools import cycle
from typing import TypeVar

from gyrobench.bench.foundations.clock import Deadline
from gyrobench.bench.foundations.errors import FaultError, NoReplyError, RefusedError, ReplyError
from gyrobench.drivers.rate_table import (
    AxisLimits,
    NoOptions,
    TableDialect,
    TableReading,
    await_standstill,
    require_rest,
)
from gyrobench.drivers.serial_line import LineDefaults, SerialLine

_ReplyT = TypeVar("_ReplyT")

_REGISTERS = re.compile(r"\d{1,10}(;\d{1,10})*", re.ASCII)
#: Modes whose limits bound the motions of this driver: Off (controlled stop), Position, Rate.
_LIMITED_MODES = ("O", "P", "R")
_MAX_SERVO_CLOSE_S = 5.0
_STANDSTILL_DPS = 0.01
_POLL_S = 0.1
#: Ends an incomplete message in the controller's buffer in a way that can't be executed.
_INVALID_MESSAGE = b"~\r\n"
#: Late replies are skipped for at most this many reply time-outs: a stop may wait for it.
_MAX_SKIP = 6
#: Numbers of values in the replies that mark the end of late ones; more than in any other reply.
_MARKS = range(31, 64)


_PREFIX_BYTES = 8
#: Longest message: of a nonzero length read in both byte orders, one always exceeds it.
_MAX_MESSAGE_BYTES = 32768
_WORDS = {"little": struct.Struct("<II"), "big": struct.Struct(">II")}

_STATE_SERVOED = 1 << 4
_DYNAMICS_POSITION_COMPLETE = 1 << 8

#: Bits of ``AnSTATE`` for an abort.
_ABORTS = {6: "software abort", 7: "hardware abort"}
#: Bits of ``AnSWFLT``.
SOFTWARE_FAULTS = {
    0: "software abort",
    1: "rate trip",
    2: "tracking error",
    3: "servo frame time",
    5: "miscorrelation",
    6: "CRC error",
    7: "fine feedback lost",
    8: "coarse feedback lost",
    9: "self test failed",
}
#: Bits of ``AnINTLK``.
_INTERLOCKS = {
    0: "user interlock 1",
    1: "user interlock 2",
    2: "user interlock 3",
    3: "output PGOUT3",
    6: "power amplifier does not acknowledge",
    7: "auxiliary interlock 1",
    8: "auxiliary interlock 2",
    9: "master interlock or front panel",
    10: "DMA synchronisation",
    11: "software watchdog",
    12: "clock watchdog",
    13: "serial data link",
    14: "servo interlock link",
    15: "10 kHz lock",
}


class Acutrol3000:
    """A table behind an Acutrol 3000; implements :class:`gyrobench.drivers.rate_table.RateTable`."""

    def __init__(self, line: SerialLine, axes: Sequence[int] = (1, 2), reply_timeout_s: float = 2.0) -> None:
        self._line = line
        self._axes = tuple(sorted(axes))
        self._reply_timeout_s = reply_timeout_s
        self._framing = ReplyFraming()
        self._out_of_step = False
        self._marks = cycle(_MARKS)
        self._is_new = True
        self._limits: tuple[float, float, float] | None = None
        self._moved = self._axes
        positions_and_rates = ":Read:" + ";".join(f"Position? {n};Rate? {n}" for n in self._axes)
        self._read_query = f"{positions_and_rates};{self._status_query('STATE', 'SWFLT', 'INTLK')}"
        self._done_query = self._status_query("STATE", "DYN")

    def identify(self) -> str:
        """Reply to ``*IDN?``."""
        return self._exchange("*IDN?", str)

    def prepare(self) -> None:
        """Lock the front panel out, clear faults, close the servos, set the limits given before."""
        self._command(":Utility:Lockout ON")
        self._command(":Interlock:Reset")
        try:
            self._command(self._each_axis(":Interlock:", "Close"))
        except RefusedError as error:
            raise self._no_servo() from error
        self._await_servo()
        if self._limits is not None:
            self.set_limits(*self._limits)

    def set_limits(self, rate_dps: float, acceleration_dps2: float, jerk_dps3: float) -> None:
        """Limit positioning, turning and stopping of every axis."""
        bounds = ",".join(map(_number, (rate_dps, acceleration_dps2, jerk_dps3)))
        self._command(";".join(f":Limit {n},{mode},{bounds}" for n in self._axes for mode in _LIMITED_MODES))
        self._limits = (rate_dps, acceleration_dps2, jerk_dps3)

    def limits(self) -> tuple[AxisLimits, ...]:
        """Read the absolute limits of each axis."""
        count = len(fields(AxisLimits))
        query = ":Limit:" + ";".join(f"Absolute? {n}" for n in self._axes)
        values = self._exchange(query, lambda text: _finite_numbers(text, count * len(self._axes)))
        return tuple(AxisLimits(*values[i : i + count]) for i in range(0, len(values), count))

    def move_to(self, angles_deg: Mapping[int, float], rate_dps: float) -> None:
        """Start to move axes to absolute angles, in one message and so in one servo frame."""
        axes = tuple(sorted(angles_deg))
        # Demands come first: a mode entered with an old demand would start towards it.
        self._command(
            ":Limit:"
            + ";".join(f"Rate P,{n},{_number(rate_dps)}" for n in axes)
            + ";:Demand:"
            + ";".join(f"Position {n},{_number(angles_deg[n])}" for n in axes)
            + ";:Mode:"
            + ";".join(f"Position {n}" for n in axes)
        )
        self._moved = axes

    def in_position(self) -> bool:
        """Whether the position profile of every axis last moved is complete."""
        values = self._progress()
        if not all(state & _STATE_SERVOED for state, _ in values.values()):
            raise self._no_servo()
        return all(values[n][1] & _DYNAMICS_POSITION_COMPLETE for n in self._moved)

    def turn_at(self, axis: int, rate_dps: float) -> None:
        """Turn one axis at a constant rate until the next command."""
        self._command(f":Demand:Rate {axis},{_number(rate_dps)};:Mode:Rate {axis}")

    def read(self) -> TableReading:
        """Position, rate, servo state, latched faults and open interlocks of all axes in one servo frame."""
        return self._exchange(self._read_query, self._reading)

    def stop(self) -> None:
        """Begin a controlled stop of all axes; the servos stay closed."""
        message = self._each_axis(":Mode:", "Off")
        if self._out_of_step:  # skipping late replies takes seconds, so it is sent before that too
            self._line.write(_INVALID_MESSAGE + message.encode("ascii") + b"\r\n")
        self._command(message)

    def release(self) -> None:
        """Stop, wait for rest, open the servos in any case, unlock the front panel.

        Raises FaultError: an axis did not come to rest; the servos are open.
        """
        try:
            self.stop()
            rates_dps = await_standstill(
                self._line.clock, lambda: self.read().rate_dps, _STANDSTILL_DPS, _POLL_S
            )
        finally:
            self._command(self._each_axis(":Interlock:", "Open"))
        self._command(":Utility:Lockout OFF")
        require_rest(self._line.instrument, rates_dps, _STANDSTILL_DPS, "its servos were opened")

    def close(self) -> None:
        """Close the line; the table continues unchanged."""
        self._line.close()

    def _each_axis(self, node: str, command: str) -> str:
        return node + ";".join(f"{command} {n}" for n in self._axes)

    def _status_query(self, *registers: str) -> str:
        return ":Status:" + ";".join(f"CSR? A{n}{register}" for n in self._axes for register in registers)

    def _reading(self, text: str) -> TableReading:
        values, count = text.split(";"), 2 * len(self._axes)
        motion = _finite_numbers(";".join(values[:count]), count)
        status = self._by_axis(";".join(values[count:]), 3)
        faults = [
            f"axis {axis}: {fault}" for axis, registers in status.items() for fault in _faults(*registers)
        ]
        is_servoed = all(state & _STATE_SERVOED for state, *_ in status.values())
        return TableReading(motion[0::2], motion[1::2], is_servoed, faults=tuple(faults))

    def _await_servo(self) -> None:
        clock = self._line.clock
        deadline = Deadline(clock, _MAX_SERVO_CLOSE_S)
        while not all(state & _STATE_SERVOED for state, _ in self._progress().values()):
            if deadline.expired():
                raise self._no_servo()
            clock.sleep(_POLL_S)

    def _no_servo(self) -> FaultError:
        causes = "; ".join(self.read().faults) or "the controller reports no fault"
        return FaultError(
            self._line.instrument,
            f"an axis is not under servo control ({causes}). Clear the cause and prepare the table again.",
        )

    def _progress(self) -> dict[int, tuple[int, ...]]:
        """State and dynamics of each axis."""
        return self._exchange(self._done_query, lambda text: self._by_axis(text, 2))

    def _by_axis(self, text: str, count: int) -> dict[int, tuple[int, ...]]:
        numbers = _whole_numbers(text, count * len(self._axes))
        return {n: numbers[i * count : (i + 1) * count] for i, n in enumerate(self._axes)}

    def _command(self, message: str) -> None:
        self._exchange(message, _acknowledgement)

    def _exchange(self, message: str, parse: Callable[[str], _ReplyT]) -> _ReplyT:
        """Send a message and return its parsed reply; the first message is sent twice if it fails.

        The program that used the line before may have left half a message in the controller, or a
        reply under way. ``parse`` raises ValueError for a text that is no reply to this message.
        """
        if self._is_new:
            self._is_new = False
            try:
                return self._exchange_once(message, parse)
            except (NoReplyError, ReplyError, RefusedError):
                self._out_of_step = True
        return self._exchange_once(message, parse)

    def _exchange_once(self, message: str, parse: Callable[[str], _ReplyT]) -> _ReplyT:
        line = self._line
        problem = self._skip_late_replies() if self._out_of_step else ""
        line.discard_input()
        self._out_of_step = True
        line.write(message.encode("ascii") + b"\r\n")
        if problem:  # sent nevertheless, since it may be a stop
            raise NoReplyError(
                line.instrument, f"{message} was sent, its reply can't be identified: {problem}"
            )
        code, text = self._reply(message)
        if code:
            self._out_of_step = False
            raise RefusedError(line.instrument, f"{message} was refused with error {code} {text}".rstrip())
        try:
            reply = parse(text)
        except ValueError:
            raise self._unexpected(message, text) from None
        self._out_of_step = False
        return reply

    def _reply(self, message: str) -> tuple[int, str]:
        """Error code and text of the next reply."""
        line, deadline = self._line, Deadline(self._line.clock, self._reply_timeout_s)
        try:
            prefix = line.read(_PREFIX_BYTES, deadline)
            decoded = self._framing.decode(prefix)
            if decoded is None:
                raise self._unexpected(message, prefix.hex(" "))
            code, length = decoded
            body = line.read(length, deadline) if length else b""
        except NoReplyError as error:
            raise NoReplyError(line.instrument, f"no complete reply to {message}: {error.message}") from error
        return code, body.decode("ascii", errors="backslashreplace").strip()

    def _skip_late_replies(self) -> str:
        """Discard the replies to earlier requests; returns why that did not succeed, empty if it did."""
        line, deadline = self._line, Deadline(self._line.clock, _MAX_SKIP * self._reply_timeout_s)
        count = next(self._marks)
        mark = ":Status:" + ";".join([f"CSR? A{self._axes[0]}STATE"] * count)
        line.write(_INVALID_MESSAGE)
        try:
            line.await_silence(self._reply_timeout_s)
            line.write(mark.encode("ascii") + b"\r\n")
            while not deadline.expired():
                code, text = self._reply(mark)
                if not code and len(text.split(";")) == count:
                    return ""
            return f"other replies arrive for more than {deadline.duration_s:g} s"
        except (NoReplyError, ReplyError) as error:
            return error.message.replace(mark, f"{count} status queries")

    def _unexpected(self, message: str, reply: str) -> ReplyError:
        return ReplyError(
            self._line.instrument, f"{message} was answered by {reply!r}. Does another program use this line?"
        )


def _number(value: float) -> str:
    return f"{value:.6f}"


def _faults(state: int, software: int, interlock: int) -> list[str]:
    """Return faults and open interlocks in the registers of an axis; an abort where these give no cause."""
    found = set_bits(software, SOFTWARE_FAULTS, "software fault")
    found += set_bits(interlock, _INTERLOCKS, "interlock")
    return found or [name for bit, name in _ABORTS.items() if state >> bit & 1]


def _acknowledgement(text: str) -> None:
    # Some firmware sends an empty line instead of OK.
    if text not in ("OK", ""):
        raise ValueError


def _finite_numbers(text: str, count: int) -> tuple[float, ...]:
    values = tuple(map(float, text.replace(",", ";").split(";")))
    if len(values) != count or not all(map(math.isfinite, values)):
        raise ValueError
    return values


def _whole_numbers(text: str, count: int) -> tuple[int, ...]:
    if not _REGISTERS.fullmatch(text):
        raise ValueError
    values = tuple(map(int, text.split(";")))
    if len(values) != count:
        raise ValueError
    return values


class ReplyFraming:
    """Reads the prefix of replies in the byte order of the first one."""

    def __init__(self) -> None:
        self._order: str | None = None

    def decode(self, prefix: bytes) -> tuple[int, int] | None:
        """Error code and length of the text, or None if no such reply exists.

        A prefix that is plausible only in the other byte order gives None, and the next prefix
        detects the order again.
        """
        if self._order is not None:
            code, length = _WORDS[self._order].unpack(prefix)
            if length <= _MAX_MESSAGE_BYTES:
                return code, length
            self._order = None
            return None
        readings = {order: words.unpack(prefix) for order, words in _WORDS.items()}
        plausible = {order: each for order, each in readings.items() if each[1] <= _MAX_MESSAGE_BYTES}
        if len(plausible) == 1:
            (self._order,) = plausible
        return min(plausible.values(), default=None)


def set_bits(register: int, names: Mapping[int, str], other: str) -> list[str]:
    """Names of the bits that are set; ``other`` and the number for one without a name."""
    return [names.get(bit, f"{other} {bit}") for bit in range(register.bit_length()) if register >> bit & 1]


DIALECT = TableDialect(lambda line, axes, _: Acutrol3000(line, axes), NoOptions, LineDefaults(tcp_port=9878))
