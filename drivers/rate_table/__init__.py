"""Rate tables: what the bench asks of one; each other module here speaks one dialect.

Angles are in degrees and count on through full turns; axes have the numbers 1, 2, ... that their
controller gives them. Calls return at once: motion goes on by itself.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol


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
