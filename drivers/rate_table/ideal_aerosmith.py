"""Driver of an Ideal Aerosmith single-axis table (1270VS and alike) over RS-232.

A command is three letters and a number, ended by a carriage return; a prompt ends each reply, and a
question mark in it says that the command was refused. Source: programs that drive such tables; there
is no public manual. So the driver relies on little:

* ``JOG`` gives its prompt when the table has been stopped or with the next ``STA``: it is not waited for.
* Programs disagree whether ``MCO`` answers 0 or 1 for a motion that is complete. It is not asked:
  position and velocity tell.
* What the number of ``STA`` means is not known. It tells that the controller answers; no fault is read
  from it. An axis that stands still elsewhere than it was sent is taken for one without servo.
* The position is taken to count on through full turns.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from gyrobench.bench.foundations.documents import StrictModel
from gyrobench.bench.foundations.errors import FaultError, RefusedError
from gyrobench.drivers.rate_table import (
    AxisLimits,
    TableDialect,
    TableReading,
    await_standstill,
    require_rest,
)
from gyrobench.drivers.serial_line import LineDefaults, SerialLine
from gyrobench.drivers.text_line import TextLine

_PROMPT = b">"
_DECIMALS = 4
#: Where a move has come to its end.
_REACHED_DEG, _STANDSTILL_DPS = 0.002, 0.002
#: An axis that stands still for so long short of its target will not go there.
_STUCK_S = 5.0
_POLL_S = 0.2
#: A prompt that does not come within this time is held back.
_HELD_BACK_S = 0.2


class IdealAerosmith:
    """A table with one axis; implements :class:`gyrobench.drivers.rate_table.RateTable`.

    Parameters
    ----------
    line : SerialLine
        The line to the controller; closed by :meth:`close`.
    axis : int
        Number by which the axis is called here; the controller has none.
    reply_timeout_s : float
        Time allowed from a command to the end of its reply.
    """

    def __init__(self, line: SerialLine, axis: int = 1, reply_timeout_s: float = 1.0) -> None:
        self._line = line
        self._axis = axis
        self._text = TextLine(line, b"\r", _PROMPT, reply_timeout_s)
        self._owes_prompt = True  # whoever spoke last may have left the table turning
        self._acceleration_dps2: float | None = None
        self._target_deg = math.nan
        self._still_since_s: float | None = None

    def identify(self) -> str:
        """Say what it is taken for: the controller does not tell, but has to answer."""
        return f"Ideal Aerosmith single-axis table, status {self._value('STA'):g}; it tells no serial number"

    def prepare(self) -> None:
        """Switch the motor on, set the limits given before.

        Raises
        ------
        FaultError
            The controller refuses it.
        """
        try:
            self._command("SRV1")
        except RefusedError as error:
            raise FaultError(
                self._line.instrument, "its motor can't be switched on. Look at its panel and emergency stop."
            ) from error
        if self._acceleration_dps2 is not None:
            self._command(f"ACL{_plain(self._acceleration_dps2)}")

    def set_limits(self, rate_dps: float, acceleration_dps2: float, jerk_dps3: float) -> None:  # noqa: ARG002
        """Bound every motion; the jerk can't be set."""
        self._command(f"VEL{_plain(rate_dps)}")
        self._command(f"ACL{_plain(acceleration_dps2)}")
        self._acceleration_dps2 = acceleration_dps2

    def limits(self) -> tuple[AxisLimits, ...]:
        """Raise RefusedError: the controller does not tell them."""
        raise RefusedError(self._line.instrument, "no command asks for its limits; look at its panel")

    def move_to(self, angles_deg: Mapping[int, float], rate_dps: float) -> None:
        """Start to move the axis to an absolute angle."""
        target_deg = angles_deg[self._axis]
        self._command(f"VEL{_plain(rate_dps)}")
        self._target_deg, self._still_since_s = target_deg, None
        self._command(f"MOV{_plain(target_deg)}")

    def in_position(self) -> bool:
        """Whether the axis stands where the last move sent it.

        Raises
        ------
        FaultError
            It stands still elsewhere.
        """
        position_deg, rate_dps = self._value("PPO"), self._value("PVE")
        if abs(rate_dps) > _STANDSTILL_DPS:
            self._still_since_s = None
            return False
        if abs(position_deg - self._target_deg) <= _REACHED_DEG:
            return True
        now_s = self._line.clock.now()
        if self._still_since_s is None:
            self._still_since_s = now_s
        elif now_s - self._still_since_s > _STUCK_S:
            raise FaultError(
                self._line.instrument,
                f"stands still at {position_deg:.3f} deg, where {self._target_deg:.3f} deg was commanded. Is "
                "its motor on, and nothing in its way?",
            )
        return False

    def turn_at(self, axis: int, rate_dps: float) -> None:  # noqa: ARG002 - there is one
        """Turn at a constant rate until told otherwise."""
        command = f"JOG{_plain(rate_dps)}"
        self._text.send(command)
        prompt = self._text.more(command, _HELD_BACK_S, may_be_empty=True)
        self._owes_prompt = prompt is None
        if prompt is not None and b"?" in prompt:
            raise self._refused(command, prompt)

    def read(self) -> TableReading:
        """Position and velocity, one after the other; whether the servo holds is not told."""
        return TableReading((self._value("PPO"),), (self._value("PVE"),))

    def faults(self) -> list[str]:
        """Nothing: what the status means is not known, only that there is one."""
        self._value("STA")
        return []

    def stop(self) -> None:
        """Begin a controlled stop."""
        self._command("STO")
        self._target_deg = math.nan

    def release(self) -> None:
        """Stop, wait for rest but not for ever, switch the motor off.

        Raises
        ------
        FaultError
            The axis did not come to rest; its motor is off.
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
        """Close the line; the table stays as it is."""
        self._line.close()

    def _value(self, query: str) -> float:
        """Ask for a number; prompts without one, held back from before, are passed over."""
        reply = self._text.ask(query)
        value = reply.rpartition(b"\r")[2].strip()  # a controller may repeat the query before
        if b"?" in value:
            raise self._refused(query, reply)
        self._owes_prompt = False
        return self._text.number(query, value)

    def _command(self, command: str) -> None:
        """Give a command and wait for its prompt, and for one that was held back before."""
        self._text.send(command)
        replies = [self._text.receive(command, may_be_empty=True)]
        if self._owes_prompt:
            self._owes_prompt = False
            second = self._text.more(command, _HELD_BACK_S, may_be_empty=True)
            replies += [] if second is None else [second]
        for reply in replies:
            if b"?" in reply:
                raise self._refused(command, reply)
            if reply not in (b"", command.encode("ascii")):
                raise self._text.unexpected(command, reply)

    def _refused(self, request: str, reply: bytes) -> RefusedError:
        shown = reply.decode("ascii", errors="backslashreplace")
        return RefusedError(self._line.instrument, f"{request} was refused: {shown!r}")


def _plain(value: float) -> str:
    """Decimal number without zeros at its end: 10.5, 90."""
    text = f"{value:.{_DECIMALS}f}".rstrip("0").rstrip(".")
    return "0" if text == "-0" else text


class IdealAerosmithOptions(StrictModel):
    """No keys of its own."""


def _open(line: SerialLine, axes: Sequence[int], options: IdealAerosmithOptions) -> IdealAerosmith:  # noqa: ARG001
    (axis,) = axes
    return IdealAerosmith(line, axis)


DIALECT = TableDialect(_open, IdealAerosmithOptions, LineDefaults(baudrate=9600), most_axes=1)
