"""The ACL, the command language of the Acutrol 3000 (manual TM-8004): its text, and the commands of an axis.

A message consists of units ``:MAIN:Sub argument,argument`` separated by ``;``. A unit without a leading
colon continues in the node of the previous unit. Keywords may be abbreviated; an ambiguous abbreviation means
the first match in the list below. Several values in one answer are separated by ``;``, as the manual shows
for the oscillator.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import lru_cache, partial
from typing import NamedTuple

from gyrobench.drivers.emulators.acl_axis import AclAxis, AclError, ErrorCode, ServoMode, refuse_if

MAX_MESSAGE_CHARACTERS = 32768
_MAX_NUMBER_CHARACTERS = 28
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d{1,3})?", re.ASCII)
_HEADER = re.compile(r"(\*[A-Za-z]+|:?[A-Za-z]+(:[A-Za-z]+)*)(\??)", re.ASCII)

#: The keywords, in the order in which an abbreviation is matched.
_KEYWORDS: dict[str, tuple[str, ...]] = {
    "INTERLOCK": ("CLOSE", "OPEN", "RESET"),
    "MODE": ("POSITION", "RATE", "ARATE", "SYNTHESIS", "TRACK", "OFF", "HOME"),
    "DEMAND": ("POSITION", "RATE", "ACCELERATION", "DELTAPOSITION", "SHORTVECTOR", "VECTOR"),
    "LIMIT": ("RATE", "ACCELERATION", "HIGHPOSITION", "LOWPOSITION", "VTRIP", "GLOBAL", "ABSOLUTE"),
    "READ": ("POSITION", "RATE", "ACCELERATION", "VECTOR", "SHORTVECTOR", "VARIABLE"),
    "STATUS": ("CSR", "ECP", "MSG"),
    "QUERY": ("ERROR", "SYSTEM"),
    "UTILITY": ("LOCKOUT", "FORMAT"),
}

Argument = float | str
Arguments = Sequence[Argument]
#: Executes a unit; returns the answer to a query, an empty text for a command.
Handler = Callable[[Arguments], str]
#: Handlers by keywords and whether the unit is a query.
Handlers = dict[tuple[tuple[str, ...], bool], Handler]

_LIMIT_DECIMALS = 4
_REGISTER = re.compile(r"A(\d+)(STATE|DYN|SWFLT|INTLK)", re.ASCII)
_SINGLE_LIMITS = {
    "RATE": "rate_dps",
    "ACCELERATION": "acceleration_dps2",
    "HIGHPOSITION": "high_deg",
    "LOWPOSITION": "low_deg",
}


class Unit(NamedTuple):
    """One command or query, with its keywords in full."""

    header: tuple[str, ...]
    is_query: bool
    arguments: tuple[Argument, ...]


def parse_message(text: str) -> tuple[Unit, ...]:
    """Split a message into its units. Raises AclError if the text is not valid ACL."""
    units = []
    node: tuple[str, ...] = ()
    for part in text.split(";"):
        unit = _parse_unit(part.strip(), node)
        if not unit.header[0].startswith("*"):
            node = unit.header[:-1]
        units.append(unit)
    return tuple(units)


def _parse_unit(text: str, node: tuple[str, ...]) -> Unit:
    header_text, *rest = text.split(maxsplit=1) if text else [""]
    match = _HEADER.fullmatch(header_text)
    if match is None:
        raise AclError(ErrorCode.SYNTAX)
    arguments = tuple(_parse_argument(word.strip()) for word in rest[0].split(",")) if rest else ()
    return Unit(_full_header(match[1], node), bool(match[3]), arguments)


def _full_header(header: str, node: tuple[str, ...]) -> tuple[str, ...]:
    header = header.upper()
    if header.startswith("*"):
        return (header,)
    path = () if header.startswith(":") else node
    for word in header.removeprefix(":").split(":"):
        path = (*path, _keyword(word, path))
    return path


def _keyword(word: str, path: tuple[str, ...]) -> str:
    keywords = _KEYWORDS if not path else _KEYWORDS[path[0]] if len(path) == 1 else ()
    keyword = _find_keyword(word, tuple(keywords))
    if keyword is None:
        raise AclError(ErrorCode.UNKNOWN_COMMAND)
    return keyword


def _find_keyword(word: str, keywords: tuple[str, ...]) -> str | None:
    """Return the first keyword that starts with the word, ignoring case; None if there is none."""
    return next((keyword for keyword in keywords if word and keyword.startswith(word.upper())), None)


def _parse_argument(word: str) -> Argument:
    if _NUMBER.fullmatch(word):
        refuse_if(len(word) >= _MAX_NUMBER_CHARACTERS, ErrorCode.WRONG_PARAMETER_TYPE)
        if not math.isfinite(value := float(word)):
            raise AclError(ErrorCode.PARAMETER_OUT_OF_RANGE)
        return value
    refuse_if(not word, ErrorCode.SYNTAX)
    return word.upper()


def format_nr2(value: float, decimals: int) -> str:
    """Format a number as NR2: fixed point, without exponent, plus sign or negative zero."""
    return f"{value:z.{decimals}f}"


def _number(argument: Argument) -> float:
    """Return an argument as a number; raises AclError if it is none."""
    if isinstance(argument, str):
        raise AclError(ErrorCode.WRONG_PARAMETER_TYPE)
    return argument


def whole_number(argument: Argument) -> int:
    """Return an argument as an integer; raises AclError if it is none."""
    value = _number(argument)
    refuse_if(not value.is_integer())
    return int(value)


def expect(arguments: Arguments, *counts: int) -> None:
    """Raise AclError unless the number of arguments is one of ``counts``."""
    if len(arguments) not in counts:
        raise AclError(ErrorCode.WRONG_PARAMETER_COUNT)


class AxisCommands:
    """Handlers of the commands and queries that address an axis."""

    def __init__(self, axes: Mapping[int, AclAxis], decimals: int) -> None:
        self._axes = dict(axes)
        self._decimals = decimals
        self._axis = lru_cache(maxsize=512)(self._find_axis)
        self._register = lru_cache(maxsize=512)(self._find_register)

    def handlers(self) -> Handlers:
        """Return the handlers of all commands and queries."""
        commands: dict[str, Handler] = {
            "INTERLOCK CLOSE": self._axis_command(0, AclAxis.close),
            "INTERLOCK OPEN": self._axis_command(0, AclAxis.open),
            "INTERLOCK RESET": self._reset,
            "MODE": self._set_mode,
            "MODE HOME": self._axis_command(0, AclAxis.home),
            **{
                f"MODE {mode.name}": self._axis_command(0, partial(AclAxis.set_mode, mode=mode))
                for mode in ServoMode
            },
            "DEMAND POSITION": self._axis_command(1, AclAxis.demand_position),
            "DEMAND RATE": self._axis_command(1, AclAxis.demand_rate),
            "DEMAND ACCELERATION": self._axis_command(1, AclAxis.demand_acceleration),
            "DEMAND DELTAPOSITION": self._axis_command(1, AclAxis.demand_delta),
            "DEMAND SHORTVECTOR": self._axis_command(2, _demand_short_vector),
            "DEMAND VECTOR": self._axis_command(3, _demand_vector),
            "LIMIT": self._set_mode_limits,
            "LIMIT VTRIP": self._limit_setter(AclAxis.set_trip_rate),
            "LIMIT GLOBAL": self._axis_command(4, _set_global_limits),
            "STATUS ECP": self._legacy_status,
        }
        queries: dict[str, Handler] = {
            "INTERLOCK": self._axis_query(lambda axis: axis.interlock),
            "MODE": self._axis_query(lambda axis: axis.mode.name.capitalize()),
            "DEMAND POSITION": self._axis_numbers_query(lambda axis: (axis.demands.position_deg,)),
            "DEMAND RATE": self._axis_numbers_query(lambda axis: (axis.demands.rate_dps,)),
            "DEMAND ACCELERATION": self._axis_numbers_query(lambda axis: (axis.demands.acceleration_dps2,)),
            "LIMIT": self._mode_limits,
            "LIMIT VTRIP": self._limit_query(lambda axis, mode: axis.trip_rates_dps[mode]),
            "LIMIT ABSOLUTE": self._axis_query(_absolute_limits),
            "STATUS CSR": self._status_register,
            "STATUS ECP": self._legacy_status,
        }
        for name, bound in _SINGLE_LIMITS.items():
            commands[f"LIMIT {name}"] = self._limit_setter(partial(_set_bound, bound))
            queries[f"LIMIT {name}"] = self._limit_query(partial(_limit_value, bound))
        reads = {
            "READ POSITION": self._axis_numbers_query(lambda axis: axis.state[:1]),
            "READ RATE": self._axis_numbers_query(lambda axis: axis.state[1:2]),
            "READ ACCELERATION": self._axis_numbers_query(lambda axis: axis.state[2:]),
            "READ SHORTVECTOR": self._axis_numbers_query(lambda axis: axis.state[:2]),
            "READ VECTOR": self._axis_numbers_query(lambda axis: axis.state),
            "READ VARIABLE": self._variable,
        }
        # the question mark of a read may be omitted
        kinds = ((False, commands | reads), (True, queries | reads))
        return {
            (tuple(header.split()), is_query): handler
            for is_query, handlers in kinds
            for header, handler in handlers.items()
        }

    def _find_axis(self, argument: Argument) -> AclAxis:
        axis_number = whole_number(argument)
        refuse_if(axis_number not in self._axes)
        return self._axes[axis_number]

    def _addressed_axes(self, argument: Argument) -> list[AclAxis]:
        return list(self._axes.values()) if argument == "ALL" else [self._axis(argument)]

    def _axis_command(self, count: int, act: Callable[..., None]) -> Handler:
        """Make the handler of a command with an axis or ALL, and then ``count`` numbers."""

        def command(arguments: Arguments) -> str:
            expect(arguments, count + 1)
            values = [_number(argument) for argument in arguments[1:]]
            for axis in self._addressed_axes(arguments[0]):
                act(axis, *values)
            return ""

        return command

    def _axis_query(self, answer: Callable[[AclAxis], str]) -> Handler:
        def query(arguments: Arguments) -> str:
            expect(arguments, 1)
            return answer(self._axis(arguments[0]))

        return query

    def _axis_numbers_query(self, values: Callable[[AclAxis], Iterable[float]]) -> Handler:
        return self._axis_query(
            lambda axis: ";".join([format_nr2(value, self._decimals) for value in values(axis)])
        )

    def _reset(self, arguments: Arguments) -> str:
        """Reset all axes, even if a client names a single one."""
        expect(arguments, 0, 1)
        for argument in arguments:
            self._addressed_axes(argument)
        for axis in self._axes.values():
            axis.reset()
        return ""

    def _set_mode(self, arguments: Arguments) -> str:
        expect(arguments, 2)
        mode = _mode(arguments[1])
        for axis in self._addressed_axes(arguments[0]):
            axis.set_mode(mode)
        return ""

    def _set_mode_limits(self, arguments: Arguments) -> str:
        expect(arguments, 5)
        values = [_number(argument) for argument in arguments[2:]]
        bounds = dict(zip(("rate_dps", "acceleration_dps2", "jerk_dps3"), values, strict=True))
        for axis in self._addressed_axes(arguments[0]):
            axis.set_limits(_mode(arguments[1]), **bounds)
        return ""

    def _mode_limits(self, arguments: Arguments) -> str:
        expect(arguments, 2)
        limits = self._axis(arguments[0]).limits[_mode(arguments[1])]
        return _limit_values(limits.rate_dps, limits.acceleration_dps2, limits.jerk_dps3)

    def _limit_setter(self, act: Callable[[AclAxis, ServoMode, float], None]) -> Handler:
        """Make the handler of a command with a mode, an axis or ALL, and a number."""

        def command(arguments: Arguments) -> str:
            expect(arguments, 3)
            for axis in self._addressed_axes(arguments[1]):
                act(axis, _mode(arguments[0]), _number(arguments[2]))
            return ""

        return command

    def _limit_query(self, value: Callable[[AclAxis, ServoMode], float]) -> Handler:
        def query(arguments: Arguments) -> str:
            expect(arguments, 2)
            return _limit_values(value(self._axis(arguments[1]), _mode(arguments[0])))

        return query

    def _variable(self, arguments: Arguments) -> str:
        expect(arguments, 1)
        axis_number, variable = divmod(whole_number(arguments[0]), 1000)
        axis = self._axis(float(axis_number))
        state = axis.state
        following_error_deg = axis.following_error_deg
        values = {
            8: state.position_deg - following_error_deg,
            30: following_error_deg,
            82: state.position_deg,
            83: state.rate_dps,
            165: state.position_deg,
            166: state.position_deg,
            176: state.acceleration_dps2,
        }
        refuse_if(variable not in values)
        return format_nr2(values[variable], self._decimals)

    def _status_register(self, arguments: Arguments) -> str:
        expect(arguments, 1, 2)
        value = self._register(str(arguments[0]))()
        if len(arguments) == 1:
            return str(value)
        bit = whole_number(arguments[1])
        refuse_if(not 0 <= bit < 32)
        return str(value >> bit & 1)

    def _find_register(self, name: str) -> Callable[[], int]:
        """Return the function that reads a status register; ACP, SUP and RI are always zero."""
        if name == "SI":
            return lambda: sum(axis.faulted << _number - 1 for _number, axis in self._axes.items())
        if name in ("ACP", "SUP", "RI"):
            return lambda: 0
        match = _REGISTER.fullmatch(name)
        if match is None:
            raise AclError(ErrorCode.PARAMETER_OUT_OF_RANGE)
        axis = self._axis(float(match[1]))
        registers: dict[str, Callable[[], int]] = {
            "STATE": axis.state_register,
            "DYN": axis.dynamics_register,
            "SWFLT": lambda: axis.software_faults,
            "INTLK": lambda: axis.latched_interlocks,
        }
        return registers[match[2]]

    def _legacy_status(self, arguments: Arguments) -> str:
        expect(arguments, 2)
        axis, word = self._axis(arguments[0]), whole_number(arguments[1])
        refuse_if(word not in (1, 2))
        return str(int(axis.mode) if word == 1 else axis.legacy_register())


def _mode(argument: Argument) -> ServoMode:
    name = _find_keyword(str(argument), tuple(ServoMode.__members__))
    if name is None:
        raise AclError(ErrorCode.PARAMETER_OUT_OF_RANGE)
    return ServoMode[name]


def _set_bound(bound: str, axis: AclAxis, mode: ServoMode, value: float) -> None:
    axis.set_limits(mode, **{bound: value})


def _limit_value(bound: str, axis: AclAxis, mode: ServoMode) -> float:
    return float(getattr(axis.limits[mode], bound))


def _limit_values(*values: float) -> str:
    return ";".join(format_nr2(value, _LIMIT_DECIMALS) for value in values)


def _absolute_limits(axis: AclAxis) -> str:
    absolute = axis.absolute_limits
    dynamic = (absolute.rate_dps, absolute.acceleration_dps2, absolute.jerk_dps3)
    return _limit_values(*dynamic, absolute.low_deg, absolute.high_deg, max(axis.trip_rates_dps.values()))


def _set_global_limits(
    axis: AclAxis, low_deg: float, high_deg: float, trip_dps: float, tracking_error_deg: float
) -> None:
    refuse_if(tracking_error_deg <= 0.0)
    for mode in ServoMode:
        axis.set_limits(mode, low_deg=low_deg, high_deg=high_deg)
        axis.set_trip_rate(mode, trip_dps)
    axis.tracking_error_limit_deg = tracking_error_deg


def _demand_short_vector(axis: AclAxis, position_deg: float, rate_dps: float) -> None:
    axis.demand_position(position_deg)
    axis.demand_rate(rate_dps)


def _demand_vector(axis: AclAxis, position_deg: float, rate_dps: float, acceleration_dps2: float) -> None:
    _demand_short_vector(axis, position_deg, rate_dps)
    axis.demand_acceleration(acceleration_dps2)
