"""Rate tables: the interface that the bench uses; each other module is one dialect.

Angles are in degrees and count through full turns; axes have their controller's numbers 1, 2, ...
Calls return at once while a motion continues.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Generic, Protocol, TypeVar

from gyrobench.bench.foundations.clock import Clock, Deadline
from gyrobench.bench.foundations.documents import StrictModel
from gyrobench.bench.foundations.errors import FaultError, NoReplyError, ReplyError
from gyrobench.drivers.serial_line import LineDefaults, SerialLine

_OptionsT = TypeVar("_OptionsT", bound=StrictModel)

#: Time allowed to come to rest after a stop.
MAX_STOP_S = 30.0


@dataclass(frozen=True, slots=True)
class TableReading:
    """All axes at one moment, in ascending order of their numbers."""

    position_deg: tuple[float, ...]
    rate_dps: tuple[float, ...]
    is_servoed: bool = True  #: Whether all axes are under servo control.
    faults: tuple[str, ...] = field(kw_only=True)  #: Latched faults, in words.


@dataclass(frozen=True, slots=True)
class AxisLimits:
    """The controller's limits of one axis, which no command exceeds."""

    rate_dps: float
    acceleration_dps2: float
    jerk_dps3: float
    low_deg: float
    high_deg: float
    trip_dps: float  #: Rate at which it switches the power off.


class RateTable(Protocol):
    """A table with one or more axes.

    Every method may raise NoReplyError, ReplyError, RefusedError and ConnectionFailedError of
    :mod:`gyrobench.bench.foundations.errors`.
    """

    def identify(self) -> str:
        """Maker, model, serial number and firmware, as the controller reports them.

        The same text at each call.
        """

    def prepare(self) -> None:
        """Clear latched faults, close the servos and set the limits given before, if any.

        Raises FaultError if a servo does not close.
        """

    def set_limits(self, rate_dps: float, acceleration_dps2: float, jerk_dps3: float) -> None:
        """Limit every later motion of every axis."""

    def limits(self) -> tuple[AxisLimits, ...]:
        """Read the controller's limits of each axis, in ascending order of their numbers.

        Raises RefusedError if they can't be read.
        """

    def move_to(self, angles_deg: Mapping[int, float], rate_dps: float) -> None:
        """Start to move axes to absolute angles, all at the same moment.

        An angle 360 deg away is a full turn away, and the sign of the difference is the direction
        of the turn: axes must be set up with position limits, not as continuous axes.
        """

    def in_position(self) -> bool:
        """Whether all axes of the last move have reached their angles.

        Raises FaultError if an axis is not under servo control and will not reach its angle.
        """

    def turn_at(self, axis: int, rate_dps: float) -> None:
        """Turn one axis at a constant rate until the next command."""

    def read(self) -> TableReading:
        """Position and rate of all axes at one moment, and the latched faults."""

    def stop(self) -> None:
        """Begin a controlled stop of all axes."""

    def release(self) -> None:
        """Stop, wait for rest, and open the servos: the state in which to leave the table."""

    def close(self) -> None:
        """Close the line; the table continues unchanged."""


class NoOptions(StrictModel):
    """Options of a dialect without additional keys."""


@dataclass(frozen=True)
class TableDialect(Generic[_OptionsT]):
    """One dialect; offered as an entry point of the group ``gyrobench.rate_tables``."""

    #: Makes the driver from the line to the controller, the numbers of the axes in use in ascending order,
    #: and the options; the driver closes the line.
    open: Callable[[SerialLine, Sequence[int], _OptionsT], RateTable]
    options: type[_OptionsT]  #: Additional keys in the station file's section ``rate_table``.
    line: LineDefaults = field(default_factory=LineDefaults)  #: Usual settings of such a controller's line.
    max_axes: int = 9  #: Largest number of axes of such a controller.


def await_standstill(
    clock: Clock, read_rates_dps: Callable[[], Sequence[float]], standstill_dps: float, poll_s: float
) -> tuple[float, ...]:
    """Wait until no axis turns faster than ``standstill_dps``, at most :data:`MAX_STOP_S`.

    Returns
    -------
    tuple of float
        Rates at the end; NaN where they can't be read, since the table may still turn then.
    """
    deadline = Deadline(clock, MAX_STOP_S)
    while not _rest(rates_dps := _readable(read_rates_dps), standstill_dps) and not deadline.expired():
        clock.sleep(poll_s)
    return rates_dps


def require_rest(instrument: str, rates_dps: Sequence[float], standstill_dps: float, done: str) -> None:
    """Raise FaultError unless the rates of :func:`await_standstill` are those of a table at rest.

    ``done`` says in what state the table was left, such as "its motor was switched off".
    """
    if _rest(rates_dps, standstill_dps):
        return
    if any(math.isnan(rate_dps) for rate_dps in rates_dps):
        turns = f"its rate can't be read {MAX_STOP_S:g} s after the stop and it may still turn"
    else:
        turns = f"still turns at {max(rates_dps, key=abs):.3g} deg/s {MAX_STOP_S:g} s after the stop"
    raise FaultError(
        instrument, f"{turns}; {done}. Stay clear of it until it rests, and use its emergency stop."
    )


def _readable(read_rates_dps: Callable[[], Sequence[float]]) -> tuple[float, ...]:
    try:
        return tuple(read_rates_dps())
    except (NoReplyError, ReplyError):
        return (math.nan,)


def _rest(rates_dps: Sequence[float], standstill_dps: float) -> bool:
    return all(abs(rate_dps) <= standstill_dps for rate_dps in rates_dps)
