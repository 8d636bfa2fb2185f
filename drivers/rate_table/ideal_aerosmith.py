"""Driver of an Ideal Aerosmith single-axis table (1270VS and similar) over RS-232.

A command is three letters and a number, ended by a carriage return. A prompt ends each reply; a
question mark in it means that the command was refused. Source: programs for such tables; there is
no public manual. So the driver makes few assumptions:

* The prompt of ``JOG`` comes when the table has stopped, or with the next ``STA``: the driver does not
  wait for it.
* Programs disagree whether ``MCO`` is 0 or 1 for a complete motion: the driver uses position and velocity.
* The meaning of ``STA`` is unknown. The driver uses it to check that the controller replies, and reads no
  fault from it. An axis that stands still off its target counts as not under servo control.
* The position is assumed not to wrap at full turns.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from gyrobench.bench.foundations.errors import FaultError, RefusedError
from gyrobench.drivers.rate_table import (
    AxisLimits,
    NoOptions,
    TableDialect,
    TableReading,
    await_standstill,
    require_rest,
)
from gyrobench.drivers.serial_line import LineDefaults, SerialLine
from gyrobench.drivers.text_line import TextLine

_PROMPT = b">"
_DECIMALS = 4
#: Largest errors of position and rate of an axis at its target.
_POSITION_TOLERANCE_DEG, _STANDSTILL_DPS = 0.002, 0.002
#: An axis that stands still off its target for longer than this is stuck.
_STUCK_S = 5.0
_POLL_S = 0.2
#: A prompt that takes longer than this is expected together with a later reply.
_PROMPT_TIME_S = 0.2


class IdealAerosmith:
    """A table with one axis; implements :class:`gyrobench.drivers.rate_table.RateTable`.

    ``axis`` is the bench's number of the axis; the controller has none.
    """

    def __init__(self, line: SerialLine, axis: int = 1) -> None:
        self._line = line
        self._axis = axis
        self._text = TextLine(line, b"\r", _PROMPT)
        self._prompt_is_pending = True  # an earlier program may have left the table turning
        self._acceleration_dps2: float | None = None
        self._target_deg = math.nan
        self._standstill_since_s: float | None = None

    def identify(self) -> str:
        """Return a fixed text: the controller has no identification query, but must reply to ``STA``."""
        self._value("STA")
        return "Ideal Aerosmith single-axis table; no serial number available"

    def prepare(self) -> None:
        """Switch the motor on and restore the acceleration limit.

        Raises FaultError if the controller refuses to switch it on.
        """
        try:
            self._command("SRV1")
        except RefusedError as error:
            raise FaultError(
                self._line.instrument, "its motor can't be switched on. Look at its panel and emergency stop."
            ) from error
        if self._acceleration_dps2 is not None:
            self._command(f"ACL{_format_number(self._acceleration_dps2)}")

    def set_limits(self, rate_dps: float, acceleration_dps2: float, jerk_dps3: float) -> None:  # noqa: ARG002
        """Limit every later motion; the jerk can't be limited."""
        self._command(f"VEL{_format_number(rate_dps)}")
        self._command(f"ACL{_format_number(acceleration_dps2)}")
        self._acceleration_dps2 = acceleration_dps2

    def limits(self) -> tuple[AxisLimits, ...]:
        """Raise RefusedError: the controller has no query for its limits."""
        raise RefusedError(self._line.instrument, "has no query for its limits; read them from its panel")

    def move_to(self, angles_deg: Mapping[int, float], rate_dps: float) -> None:
        """Start to move the axis to an absolute angle."""
        target_deg = angles_deg[self._axis]
        self._command(f"VEL{_format_number(rate_dps)}")
        self._target_deg, self._standstill_since_s = target_deg, None
        self._command(f"MOV{_format_number(target_deg)}")

    def in_position(self) -> bool:
        """Whether the axis stands at the target of the last move.

        Raises FaultError if it stands still off its target.
        """
        position_deg, rate_dps = self._value("PPO"), self._value("PVE")
        if abs(rate_dps) > _STANDSTILL_DPS:
            self._standstill_since_s = None
            return False
        if abs(position_deg - self._target_deg) <= _POSITION_TOLERANCE_DEG:
            return True
        now_s = self._line.clock.now()
        if self._standstill_since_s is None:
            self._standstill_since_s = now_s
        elif now_s - self._standstill_since_s > _STUCK_S:
            raise FaultError(
                self._line.instrument,
                f"stands still at {position_deg:.3f} deg; {self._target_deg:.3f} deg was commanded. Check "
                "that its motor is on and nothing blocks it.",
            )
        return False

    def turn_at(self, axis: int, rate_dps: float) -> None:  # noqa: ARG002 - there is only one axis
        """Turn at a constant rate until the next command."""
        command = f"JOG{_format_number(rate_dps)}"
        self._text.send(command)
        prompt = self._text.more(command, _PROMPT_TIME_S, may_be_empty=True)
        self._prompt_is_pending = prompt is None
        if prompt is not None and b"?" in prompt:
            raise self._refused(command, prompt)

    def read(self) -> TableReading:
        """Read position, then velocity; servo state and faults can't be read."""
        return TableReading((self._value("PPO"),), (self._value("PVE"),), faults=())

    def stop(self) -> None:
        """Begin a controlled stop."""
        self._command("STO")
        self._target_deg = math.nan

    def release(self) -> None:
        """Stop, wait for rest, and switch the motor off even if an error occurs.

        Raises FaultError if the axis did not come to rest; its motor is off.
        """
        try:
            self.stop()
            rates_dps = await_standstill(
                self._line.clock, lambda: (self._value("PVE"),), _STANDSTILL_DPS, _POLL_S
            )
        finally:
            self._command("SRV0")
        require_rest(self._line.instrument, rates_dps, _STANDSTILL_DPS, "its motor was switched off")

    def close(self) -> None:
        """Close the line; the table continues unchanged."""
        self._line.close()

    def _value(self, query: str) -> float:
        """Query a number; skips late prompts without a number."""
        reply = self._text.ask(query)
        value = reply.rpartition(b"\r")[2].strip()  # some controllers echo the query first
        if b"?" in value:
            raise self._refused(query, reply)
        self._prompt_is_pending = False
        return self._text.number(query, value)

    def _command(self, command: str) -> None:
        """Send a command; wait for its prompt, and for a pending prompt of an earlier command."""
        self._text.send(command)
        replies = [self._text.receive(command, may_be_empty=True)]
        if self._prompt_is_pending:
            self._prompt_is_pending = False
            second = self._text.more(command, _PROMPT_TIME_S, may_be_empty=True)
            replies += [] if second is None else [second]
        for reply in replies:
            if b"?" in reply:
                raise self._refused(command, reply)
            if reply not in (b"", command.encode("ascii")):
                raise self._text.unexpected(command, reply)

    def _refused(self, request: str, reply: bytes) -> RefusedError:
        text = reply.decode("ascii", errors="backslashreplace")
        return RefusedError(self._line.instrument, f"{request} was refused: {text!r}")


def _format_number(value: float) -> str:
    """Format a decimal number without trailing zeros: 10.5, 90."""
    text = f"{value:.{_DECIMALS}f}".rstrip("0").rstrip(".")
    return "0" if text == "-0" else text


DIALECT = TableDialect(
    lambda line, axes, _: IdealAerosmith(line, *axes), NoOptions, LineDefaults(baudrate=9600), max_axes=1
)
