"""Rate tables: what the bench asks of one; each other module here speaks one dialect.

Angles are in degrees and count on through full turns; axes have the numbers 1, 2, ... that their
controller gives them. Calls return at once: motion goes on by itself.
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


@dataclass(frozen=True, slots=True)
class TableReading:
    """All axes at one moment, in ascending order of their numbers.

    Attributes
    ----------
    is_servoed : bool
        Whether all axes are under servo control.
    """

    position_deg: tuple[float, ...]
    rate_dps: tuple[float, ...]
    is_servoed: bool = True


@dataclass(frozen=True, slots=True)
class AxisLimits:
    """What the controller allows one axis at most, whatever it is told.

    Attributes
    ----------
    trip_dps : float
        Rate at which it takes the power off.
    """

    rate_dps: float
    acceleration_dps2: float
    jerk_dps3: float
    low_deg: float
    high_deg: float
    trip_dps: float


class RateTable(Protocol):
    """A table with one or more axes.

    Every method may raise NoReplyError, ReplyError, RefusedError and ConnectionFailedError of
    :mod:`gyrobench.bench.foundations.errors`.
    """

    def identify(self) -> str:
        """Maker, model, serial number and firmware, as the controller says them."""
        ...

    def prepare(self) -> None:
        """Clear old faults, close the servos and set the limits given before, if any.

        Raises
        ------
        FaultError
            A servo does not close.
        """
        ...

    def set_limits(self, rate_dps: float, acceleration_dps2: float, jerk_dps3: float) -> None:
        """Bound every motion of every axis from now on."""
        ...

    def limits(self) -> tuple[AxisLimits, ...]:
        """Read the controller's own limits of each axis, in ascending order of their numbers.

        Raises
        ------
        RefusedError
            The controller does not tell them.
        """
        ...

    def move_to(self, angles_deg: Mapping[int, float], rate_dps: float) -> None:
        """Start to move axes to absolute angles, all at the same moment.

        An angle 360 deg away is a full turn away, and the sign of the difference is the direction
        of the turn: axes have to be set up as axes with limits, not as continuous ones.
        """
        ...

    def in_position(self) -> bool:
        """Whether the axes of the last move are all where it sent them.

        Raises
        ------
        FaultError
            An axis is not under servo control and will not get there.
        """
        ...

    def turn_at(self, axis: int, rate_dps: float) -> None:
        """Turn one axis at a constant rate until told otherwise."""
        ...

    def read(self) -> TableReading:
        """Position and rate of all axes, taken at one moment."""
        ...

    def faults(self) -> list[str]:
        """Say what is wrong, in words; empty when nothing is."""
        ...

    def stop(self) -> None:
        """Begin a controlled stop of all axes."""
        ...

    def release(self) -> None:
        """Stop, wait for rest, and open the servos: the state to leave the table in."""
        ...

    def close(self) -> None:
        """Close the line; the table stays as it is."""
        ...


OptionsT = TypeVar("OptionsT", bound=StrictModel)


@dataclass(frozen=True)
class TableDialect(Generic[OptionsT]):
    """One dialect; offered as an entry point of the group ``gyrobench.rate_tables``.

    Attributes
    ----------
    open : callable
        Makes the driver from the line to the controller, the numbers of the axes in use in
        ascending order, and the options; the driver closes the line.
    options : type of StrictModel
        The keys of its own in the station file's section ``rate_table``.
    line : LineDefaults
        How such a controller is usually reached.
    most_axes : int
        How many axes such a controller has at most.
    """

    open: Callable[[SerialLine, Sequence[int], OptionsT], RateTable]
    options: type[OptionsT]
    line: LineDefaults = field(default_factory=LineDefaults)
    most_axes: int = 9


#: Longest wait for rest.
LONGEST_S = 30.0


def await_standstill(
    clock: Clock, read_rates_dps: Callable[[], Sequence[float]], standstill_dps: float, poll_s: float
) -> tuple[float, ...]:
    """Wait until all axes rest, but not for ever.

    Parameters
    ----------
    read_rates_dps : callable
        Asks the table for the rate of each axis.
    standstill_dps : float
        An axis that turns no faster rests.
    poll_s : float
        Time between two looks.

    Returns
    -------
    tuple of float
        Rates at the end; NaN where none could be read, since the table may still turn then.
    """
    deadline = Deadline(clock, LONGEST_S)
    while not _rest(rates_dps := _known(read_rates_dps), standstill_dps) and not deadline.expired():
        clock.sleep(poll_s)
    return rates_dps


def require_rest(instrument: str, rates_dps: Sequence[float], standstill_dps: float, done: str) -> None:
    """Raise FaultError where the rates of :func:`await_standstill` are none of a table at rest.

    Parameters
    ----------
    done : str
        What was done all the same, for people: "its motor was switched off".
    """
    if not _rest(rates_dps, standstill_dps):
        raise FaultError(
            instrument,
            f"{turns_still(rates_dps, LONGEST_S)}; {done}. Keep away from it until it rests, and use its "
            "emergency stop.",
        )


def turns_still(rates_dps: Sequence[float], waited_s: float) -> str:
    """Say that a table still turns, or may do so.

    Parameters
    ----------
    rates_dps : sequence of float
        Last known rate of each axis; NaN where none could be read.
    waited_s : float
        Time since the stop.
    """
    if any(math.isnan(rate_dps) for rate_dps in rates_dps):
        return f"tells no rate {waited_s:g} s after the stop and may still turn"
    fastest_dps = max(rates_dps, key=abs)
    return f"still turns at {fastest_dps:.3g} deg/s {waited_s:g} s after the stop"


def _known(read_rates_dps: Callable[[], Sequence[float]]) -> tuple[float, ...]:
    try:
        return tuple(read_rates_dps())
    except (NoReplyError, ReplyError):
        return (math.nan,)


def _rest(rates_dps: Sequence[float], standstill_dps: float) -> bool:
    return all(abs(rate_dps) <= standstill_dps for rate_dps in rates_dps)
