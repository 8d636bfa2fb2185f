"""Emulator of the Acutrol 3000 table controller at its serial port or TCP socket.

Sources: command language manual TM-8004; TM-9374A for the prefix of the replies. The reply to a message is
an error code and a length, 32 bits each, and then a text: the answers to its queries separated by ``;``, or
``OK``.

Assumptions where the public manuals are silent: the error codes; the reply to a refused message contains the
error's text; a message with a wrong keyword is refused as a whole, but one that an axis refuses is executed
up to that unit; the status request enable register initially has the interlock bit set.
"""

from __future__ import annotations

import struct
from collections import deque
from collections.abc import Callable, Mapping
from functools import lru_cache, partial
from typing import Literal

from gyrobench.drivers.emulators.acl_axis import AclAxis, AclError, ErrorCode, SoftwareFault, refuse_if
from gyrobench.drivers.emulators.acl_commands import (
    MAX_MESSAGE_CHARACTERS,
    Arguments,
    AxisCommands,
    Handler,
    Handlers,
    expect,
    parse_message,
    whole_number,
)
from gyrobench.drivers.emulators.dialect import TableEmulation
from gyrobench.drivers.emulators.world.table_axis import TableAxis

_ERRORS_KEPT = 32
_MAX_VARIABLES = 8
_COMMAND_ERROR, _EXECUTION_ERROR, _POWER_ON = 1 << 5, 1 << 4, 1 << 7
_INTERLOCK_SUMMARY, _EVENT_SUMMARY, _MASTER_SUMMARY, _ERRORS_QUEUED = 1 << 0, 1 << 5, 1 << 6, 1 << 7


class Acutrol3000Emulator:
    """The emulated controller with its axes.

    ``axes`` have position limits. ``word_order`` is the byte order of the two words before each reply,
    ``decimals`` the number of decimals in replies.
    """

    latency_s = 0.004

    def __init__(
        self,
        axes: Mapping[int, TableAxis],
        *,
        word_order: Literal["little", "big"] = "little",
        identity: str = "Acutronic R&D USA,Acutrol3000,0,gyrobench emulator",
        decimals: int = 6,
    ) -> None:
        self.axes = {number: AclAxis(axis) for number, axis in sorted(axes.items())}
        self._prefix = struct.Struct("<II" if word_order == "little" else ">II")
        self._identity = identity
        self._errors: deque[ErrorCode] = deque(maxlen=_ERRORS_KEPT)
        self._set_defaults()
        self._handlers = {**AxisCommands(self.axes, decimals).handlers(), **self._system_handlers()}
        self._calls = lru_cache(maxsize=512)(self._find_calls)

    def _set_defaults(self) -> None:
        self._buffer = b""
        self._overlong = False
        self._errors.clear()
        self._events, self._events_enabled = _POWER_ON, 0
        self._requests_enabled = _INTERLOCK_SUMMARY
        self._locked_out = False

    def is_servoed(self, axis: int) -> bool:
        """Whether the servo of an axis is closed."""
        return self.axes[axis].closed

    def power_off(self, now_s: float) -> None:
        """Lose power: the servos open; limits, modes and registers return to their defaults."""
        for axis in self.axes.values():
            axis.begin_frame(now_s)
            axis.power_cycle()
        self._set_defaults()

    def power_on(self, now_s: float) -> None:
        """Restart."""

    def refusal(self, code: ErrorCode) -> bytes:
        """Return the reply that refuses a message with this code."""
        return self._encode_reply(code, code.text)

    def feed(self, data: bytes, now_s: float) -> bytes:
        """Receive bytes; returns the replies to the messages that they complete."""
        *messages, self._buffer = (self._buffer + data).split(b"\n")
        replies = b""
        for message in messages:
            too_long, self._overlong = self._overlong or len(message) > MAX_MESSAGE_CHARACTERS, False
            replies += self._reply(message.strip(), too_long, now_s)
        if len(self._buffer) > MAX_MESSAGE_CHARACTERS:
            self._buffer, self._overlong = b"", True
        return replies

    def trip(self, axis: int, fault: SoftwareFault, now_s: float) -> None:
        """Open the servo of an axis because of a fault that the controller detects; a reset clears it."""
        self.axes[axis].begin_frame(now_s)
        self.axes[axis].trip(fault)

    def open_interlock(self, axis: int, now_s: float, bit: int = 0) -> None:
        """Open a hardware interlock (a bit of ``AnINTLK``): the servo of the axis opens."""
        self.axes[axis].begin_frame(now_s)
        self.axes[axis].open_interlock(bit)

    def close_interlock(self, axis: int, bit: int = 0) -> None:
        """Close the hardware interlock again; the axis needs a reset and a close command."""
        self.axes[axis].close_interlock(bit)

    def _reply(self, message: bytes, too_long: bool, now_s: float) -> bytes:
        if not message and not too_long:
            return b""
        code = ErrorCode.NONE
        try:
            refuse_if(too_long, ErrorCode.MESSAGE_TOO_LONG)
            text = self._execute(message.decode("latin-1"), now_s)
        except AclError as error:
            code, text = error.code, error.code.text
            self._errors.append(code)
            is_execution = code >= ErrorCode.PARAMETER_OUT_OF_RANGE
            self._events |= _EXECUTION_ERROR if is_execution else _COMMAND_ERROR
        return self._encode_reply(code, text)

    def _encode_reply(self, code: ErrorCode, text: str) -> bytes:
        body = text.encode("ascii")
        return self._prefix.pack(code, len(body)) + body

    def _execute(self, message: str, now_s: float) -> str:
        for axis in self.axes.values():
            axis.begin_frame(now_s)
        answers = [handle(arguments) for handle, arguments in self._calls(message)]
        text = ";".join(filter(None, answers)) or "OK"
        refuse_if(len(text) > MAX_MESSAGE_CHARACTERS, ErrorCode.MESSAGE_TOO_LONG)
        return text

    def _find_calls(self, message: str) -> list[tuple[Handler, Arguments]]:
        """Return handler and arguments of each unit of a message. Raises AclError if one is unknown."""
        units = parse_message(message)
        refuse_if(sum(unit.header == ("READ", "VARIABLE") for unit in units) > _MAX_VARIABLES)
        try:
            return [(self._handlers[unit.header, unit.is_query], unit.arguments) for unit in units]
        except KeyError:
            raise AclError(ErrorCode.UNKNOWN_COMMAND) from None

    def _system_handlers(self) -> Handlers:
        return {
            (("*IDN",), True): self._answer(lambda: self._identity),
            (("*STB",), True): self._answer(lambda: str(self._status_byte())),
            (("*ESR",), True): self._answer(self._take_events),
            (("*ESE",), True): self._answer(lambda: str(self._events_enabled)),
            (("*SRE",), True): self._answer(lambda: str(self._requests_enabled)),
            (("*ESE",), False): partial(self._enable, "_events_enabled", 0xFF),
            (("*SRE",), False): partial(self._enable, "_requests_enabled", ~_MASTER_SUMMARY),
            (("*CLS",), False): self._answer(self._clear_status),
            (("STATUS", "MSG"), True): self._next_error,
            (("QUERY", "ERROR"), True): self._error_text,
            (("QUERY", "SYSTEM"), True): self._answer(
                lambda: ",".join(str(int(number)) for number in (len(self._errors), *self._errors))
            ),
            (("UTILITY", "LOCKOUT"), False): self._set_lockout,
            (("UTILITY", "LOCKOUT"), True): self._answer(lambda: "ON" if self._locked_out else "OFF"),
            (("UTILITY", "FORMAT"), False): self._refuse_format,
        }

    @staticmethod
    def _answer(value: Callable[[], str]) -> Handler:
        def query(arguments: Arguments) -> str:
            expect(arguments, 0)
            return value()

        return query

    def _status_byte(self) -> int:
        value = _INTERLOCK_SUMMARY if any(axis.faulted for axis in self.axes.values()) else 0
        value |= _EVENT_SUMMARY if self._events & self._events_enabled else 0
        value |= _ERRORS_QUEUED if self._errors else 0
        return value | (_MASTER_SUMMARY if value & self._requests_enabled else 0)

    def _take_events(self) -> str:
        events, self._events = self._events, 0
        return str(events)

    def _clear_status(self) -> str:
        self._events = 0
        self._errors.clear()
        return ""

    def _enable(self, register: str, mask: int, arguments: Arguments) -> str:
        expect(arguments, 1)
        value = whole_number(arguments[0])
        refuse_if(not 0 <= value <= 255)
        setattr(self, register, value & mask)
        return ""

    def _next_error(self, arguments: Arguments) -> str:
        expect(arguments, 1)
        refuse_if(arguments[0] != "QERROR")
        code = self._errors.popleft() if self._errors else ErrorCode.NONE
        return f"{int(code)},{code.text}"

    def _error_text(self, arguments: Arguments) -> str:
        expect(arguments, 1)
        try:
            return ErrorCode(whole_number(arguments[0])).text
        except ValueError:
            raise AclError(ErrorCode.PARAMETER_OUT_OF_RANGE) from None

    def _set_lockout(self, arguments: Arguments) -> str:
        expect(arguments, 1)
        refuse_if(arguments[0] not in ("ON", "OFF"))
        self._locked_out = arguments[0] == "ON"
        return ""

    def _refuse_format(self, _: Arguments) -> str:
        """Raise AclError: binary numbers are available only on the GPIB."""
        raise AclError(ErrorCode.NOT_AVAILABLE)


DIALECT = TableEmulation(Acutrol3000Emulator)
