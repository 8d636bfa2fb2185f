"""Driver of the Acutronic Acutrol 3000 table controller, on RS-232 or its TCP socket.

Sources: manuals TM-8004 (command language, registers) and TM-9374A (error word and length before a
reply). They do not give the byte order of the two words over TCP and RS-232. On a continuous axis
the controller takes the shortest way to a position, so the direction of a turn of 180 deg is
undefined: axes must be set up with position limits, so that the demanded angle determines the direction.

A reply does not name its request, and replies come in the order of the requests. So after a failed
exchange the driver sends a marker: one message that reads a status register so many times that its reply
has a number of values that no other reply has. All replies before it belong to earlier requests.

Some adapters echo what is sent (local echo). The echo comes before the reply and is skipped.
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
#: Modes that this driver uses and whose limits it sets: Off (controlled stop), Position, Rate.
_LIMITED_MODES = ("O", "P", "R")
_MAX_SERVO_CLOSE_S = 5.0
_STANDSTILL_DPS = 0.01
_POLL_S = 0.1
#: Terminates an incomplete message in the controller's buffer such that it can't be executed.
_INVALID_MESSAGE = b"~\r\n"
#: Longest time to skip late replies, in reply time-outs; short, as a stop may have to wait for it.
_MAX_SKIP_TIMEOUTS = 6
#: Numbers of values in the replies to markers; more than in any other reply.
_MARKER_COUNTS = range(31, 64)


_PREFIX_BYTES = 8
#: Longest message. A nonzero length exceeds it in one of the two byte orders, which identifies the order.
_MAX_MESSAGE_BYTES = 32768
_WORDS = {"little": struct.Struct("<II"), "big": struct.Struct(">II")}

_STATE_SERVOED = 1 << 4
_DYNAMICS_POSITION_COMPLETE = 1 << 8

#: Bits of ``AnSTATE`` that report an abort.
_ABORT_BITS = {6: "software abort", 7: "hardware abort"}
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
        self._out_of_sync = False
        self._marker_counts = cycle(_MARKER_COUNTS)
        self._is_first_exchange = True
        self._limits: tuple[float, float, float] | None = None
        self._target_axes = self._axes
        positions_and_rates = ":Read:" + ";".join(f"Position? {n};Rate? {n}" for n in self._axes)
        self._read_query = f"{positions_and_rates};{self._status_query('STATE', 'SWFLT', 'INTLK')}"
        self._progress_query = self._status_query("STATE", "DYN")

    def identify(self) -> str:
        """Return the reply to ``*IDN?``."""
        return self._exchange("*IDN?", str)

    def prepare(self) -> None:
        """Lock the front panel, clear faults, close the servos, and restore the limits.

        Raises FaultError if a servo does not close.
        """
        self._command(":Utility:Lockout ON")
        self._command(":Interlock:Reset")
        try:
            self._command(self._message_to_axes(":Interlock:", "Close"))
        except RefusedError as error:
            raise self._servo_fault() from error
        self._await_servo()
        if self._limits is not None:
            self.set_limits(*self._limits)

    def set_limits(self, rate_dps: float, acceleration_dps2: float, jerk_dps3: float) -> None:
        """Limit moves, constant-rate turns and stops of every axis."""
        bounds = ",".join(map(_format_number, (rate_dps, acceleration_dps2, jerk_dps3)))
        self._command(";".join(f":Limit {n},{mode},{bounds}" for n in self._axes for mode in _LIMITED_MODES))
        self._limits = (rate_dps, acceleration_dps2, jerk_dps3)

    def limits(self) -> tuple[AxisLimits, ...]:
        """Read the absolute limits of each axis."""
        count = len(fields(AxisLimits))
        query = ":Limit:" + ";".join(f"Absolute? {n}" for n in self._axes)
        values = self._exchange(query, lambda text: _parse_floats(text, count * len(self._axes)))
        return tuple(AxisLimits(*values[i : i + count]) for i in range(0, len(values), count))

    def move_to(self, angles_deg: Mapping[int, float], rate_dps: float) -> None:
        """Start to move axes to absolute angles: one message, so all start in the same servo frame."""
        axes = tuple(sorted(angles_deg))
        # Demands come first: a mode entered with an old demand would start towards it.
        self._command(
            ":Limit:"
            + ";".join(f"Rate P,{n},{_format_number(rate_dps)}" for n in axes)
            + ";:Demand:"
            + ";".join(f"Position {n},{_format_number(angles_deg[n])}" for n in axes)
            + ";:Mode:"
            + ";".join(f"Position {n}" for n in axes)
        )
        self._target_axes = axes

    def in_position(self) -> bool:
        """Whether the position profile of every axis of the last move is complete.

        Raises FaultError if an axis is not under servo control.
        """
        values = self._progress()
        if not all(state & _STATE_SERVOED for state, _ in values.values()):
            raise self._servo_fault()
        return all(values[n][1] & _DYNAMICS_POSITION_COMPLETE for n in self._target_axes)

    def turn_at(self, axis: int, rate_dps: float) -> None:
        """Turn one axis at a constant rate until the next command."""
        self._command(f":Demand:Rate {axis},{_format_number(rate_dps)};:Mode:Rate {axis}")

    def read(self) -> TableReading:
        """Read position, rate, servo state, faults and interlocks of all axes in one servo frame."""
        return self._exchange(self._read_query, self._parse_reading)

    def stop(self) -> None:
        """Begin a controlled stop of all axes; the servos stay closed."""
        message = self._message_to_axes(":Mode:", "Off")
        if self._out_of_sync:  # skipping late replies takes seconds, so send it before that too
            self._line.write(_INVALID_MESSAGE + message.encode("ascii") + b"\r\n")
        self._command(message)

    def release(self) -> None:
        """Stop, wait for rest, open the servos even if an error occurs, and unlock the front panel.

        Raises FaultError if an axis did not come to rest; the servos are open.
        """
        try:
            self.stop()
            rates_dps = await_standstill(
                self._line.clock, lambda: self.read().rate_dps, _STANDSTILL_DPS, _POLL_S
            )
        finally:
            self._command(self._message_to_axes(":Interlock:", "Open"))
        self._command(":Utility:Lockout OFF")
        require_rest(self._line.instrument, rates_dps, _STANDSTILL_DPS, "its servos were opened")

    def close(self) -> None:
        """Close the line; the table continues unchanged."""
        self._line.close()

    def _message_to_axes(self, node: str, command: str) -> str:
        return node + ";".join(f"{command} {n}" for n in self._axes)

    def _status_query(self, *registers: str) -> str:
        return ":Status:" + ";".join(f"CSR? A{n}{register}" for n in self._axes for register in registers)

    def _parse_reading(self, text: str) -> TableReading:
        values, count = text.split(";"), 2 * len(self._axes)
        motion = _parse_floats(";".join(values[:count]), count)
        status = self._registers_by_axis(";".join(values[count:]), 3)
        faults = [
            f"axis {axis}: {fault}"
            for axis, registers in status.items()
            for fault in _fault_names(*registers)
        ]
        is_servoed = all(state & _STATE_SERVOED for state, *_ in status.values())
        return TableReading(motion[0::2], motion[1::2], is_servoed, faults=tuple(faults))

    def _await_servo(self) -> None:
        clock = self._line.clock
        deadline = Deadline(clock, _MAX_SERVO_CLOSE_S)
        while not all(state & _STATE_SERVOED for state, _ in self._progress().values()):
            if deadline.expired():
                raise self._servo_fault()
            clock.sleep(_POLL_S)

    def _servo_fault(self) -> FaultError:
        causes = "; ".join(self.read().faults) or "the controller reports no fault"
        return FaultError(
            self._line.instrument,
            f"an axis is not under servo control ({causes}). Clear the cause and prepare the table again.",
        )

    def _progress(self) -> dict[int, tuple[int, ...]]:
        """Read the registers ``STATE`` and ``DYN`` of each axis."""
        return self._exchange(self._progress_query, lambda text: self._registers_by_axis(text, 2))

    def _registers_by_axis(self, text: str, count: int) -> dict[int, tuple[int, ...]]:
        numbers = _parse_integers(text, count * len(self._axes))
        return {n: numbers[i * count : (i + 1) * count] for i, n in enumerate(self._axes)}

    def _command(self, message: str) -> None:
        self._exchange(message, _check_acknowledgement)

    def _exchange(self, message: str, parse: Callable[[str], _ReplyT]) -> _ReplyT:
        """Send a message and return its parsed reply; the first message on a line is repeated if it fails.

        An earlier program may have left half a message in the controller, or a reply that is still to
        arrive. ``parse`` raises ValueError if a text is not a reply to this message.
        """
        if self._is_first_exchange:
            self._is_first_exchange = False
            try:
                return self._exchange_once(message, parse)
            except (NoReplyError, ReplyError, RefusedError):
                self._out_of_sync = True
        return self._exchange_once(message, parse)

    def _exchange_once(self, message: str, parse: Callable[[str], _ReplyT]) -> _ReplyT:
        line = self._line
        problem = self._skip_late_replies() if self._out_of_sync else ""
        line.discard_input()
        self._out_of_sync = True
        line.write(message.encode("ascii") + b"\r\n")
        if problem:  # the message was sent all the same, since it may be a stop
            raise NoReplyError(
                line.instrument, f"{message} was sent, its reply can't be identified: {problem}"
            )
        code, text = self._reply(message)
        if code:
            self._out_of_sync = False
            raise RefusedError(line.instrument, f"{message} was refused with error {code} {text}".rstrip())
        try:
            reply = parse(text)
        except ValueError:
            raise self._unexpected(message, text) from None
        self._out_of_sync = False
        return reply

    def _reply(self, message: str) -> tuple[int, str]:
        """Read the next reply; returns its error code and text."""
        line, deadline = self._line, Deadline(self._line.clock, self._reply_timeout_s)
        try:
            prefix, sent = line.read(_PREFIX_BYTES, deadline), message.encode("ascii") + b"\r\n"
            if prefix.startswith(sent[:_PREFIX_BYTES]):  # an adapter with local echo
                echo = prefix + line.read(len(sent), deadline)
                prefix = echo.removeprefix(sent)[:_PREFIX_BYTES]
            decoded = self._framing.decode(prefix)
            if decoded is None:
                raise self._unexpected(message, prefix.hex(" "))
            code, length = decoded
            body = line.read(length, deadline) if length else b""
        except NoReplyError as error:
            raise NoReplyError(line.instrument, f"no complete reply to {message}: {error.message}") from error
        return code, body.decode("ascii", errors="backslashreplace").strip()

    def _skip_late_replies(self) -> str:
        """Discard the replies to earlier requests; returns the reason if that fails, else an empty text."""
        line, deadline = self._line, Deadline(self._line.clock, _MAX_SKIP_TIMEOUTS * self._reply_timeout_s)
        count = next(self._marker_counts)
        marker = ":Status:" + ";".join([f"CSR? A{self._axes[0]}STATE"] * count)
        line.write(_INVALID_MESSAGE)
        try:
            line.await_silence(self._reply_timeout_s)
            line.write(marker.encode("ascii") + b"\r\n")
            while not deadline.expired():
                code, text = self._reply(marker)
                if not code and len(text.split(";")) == count:
                    return ""
            return f"other replies arrive for more than {deadline.duration_s:g} s"
        except (NoReplyError, ReplyError) as error:
            return error.message.replace(marker, f"{count} status queries")

    def _unexpected(self, message: str, reply: str) -> ReplyError:
        return ReplyError(
            self._line.instrument, f"{message} was answered by {reply!r}. Does another program use this line?"
        )


def _format_number(value: float) -> str:
    return f"{value:.6f}"


def _fault_names(state: int, software: int, interlock: int) -> list[str]:
    """Faults and open interlocks in the registers of one axis; aborts if the registers show no cause."""
    names = set_bits(software, SOFTWARE_FAULTS, "software fault")
    names += set_bits(interlock, _INTERLOCKS, "interlock")
    return names or [name for bit, name in _ABORT_BITS.items() if state >> bit & 1]


def _check_acknowledgement(text: str) -> None:
    # Some firmware sends an empty line instead of OK.
    if text not in ("OK", ""):
        raise ValueError


def _parse_floats(text: str, count: int) -> tuple[float, ...]:
    values = tuple(map(float, text.replace(",", ";").split(";")))
    if len(values) != count or not all(map(math.isfinite, values)):
        raise ValueError
    return values


def _parse_integers(text: str, count: int) -> tuple[int, ...]:
    if not _REGISTERS.fullmatch(text):
        raise ValueError
    values = tuple(map(int, text.split(";")))
    if len(values) != count:
        raise ValueError
    return values


class ReplyFraming:
    """Decodes the prefix of replies; detects the byte order from the first one."""

    def __init__(self) -> None:
        self._order: str | None = None

    def decode(self, prefix: bytes) -> tuple[int, int] | None:
        """Decode a prefix to error code and length of the text; None if it is invalid.

        If the length is too large in the detected byte order, the next prefix detects the order again.
        """
        if self._order is not None:
            code, length = _WORDS[self._order].unpack(prefix)
            if length <= _MAX_MESSAGE_BYTES:
                return code, length
            self._order = None
            return None
        decoded = {order: words.unpack(prefix) for order, words in _WORDS.items()}
        plausible = {order: each for order, each in decoded.items() if each[1] <= _MAX_MESSAGE_BYTES}
        if len(plausible) == 1:
            (self._order,) = plausible
        return min(plausible.values(), default=None)


def set_bits(register: int, names: Mapping[int, str], unnamed: str) -> list[str]:
    """Names of the bits that are set; ``unnamed`` and the bit's number if it has no name."""
    return [names.get(bit, f"{unnamed} {bit}") for bit in range(register.bit_length()) if register >> bit & 1]


DIALECT = TableDialect(lambda line, axes, _: Acutrol3000(line, axes), NoOptions, LineDefaults(tcp_port=9878))
