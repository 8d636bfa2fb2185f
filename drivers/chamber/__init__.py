"""Thermal chambers: what the bench asks of one, whatever its controller."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Generic, Protocol, TypeVar

from gyrobench.bench.foundations.documents import StrictModel
from gyrobench.drivers.serial_line import LineDefaults, SerialLine


@dataclass(frozen=True)
class ChamberReading:
    """What one poll of a chamber gives.

    Attributes
    ----------
    temperature_c : float
        The air.
    set_point_c : float or None
        Where the controller says it is to go; None if it does not tell.
    is_on : bool or None
        Whether the temperature is controlled at all; None if it does not tell.
    """

    temperature_c: float
    set_point_c: float | None = None
    is_on: bool | None = None


class Chamber(Protocol):
    """A thermal chamber.

    Every method may raise an :class:`~gyrobench.bench.foundations.errors.InstrumentError`.
    """

    def identify(self) -> str:
        """Name of the controller, for the run's provenance."""
        ...

    def read(self) -> ChamberReading:
        """Measure the air, and read set point and on or off back from the controller.

        Raises
        ------
        FaultError
            The controller's temperature sensor is faulty.
        """
        ...

    def alarms(self) -> list[str]:
        """Active alarms and sensor errors, in words; empty when all is well."""
        ...

    def clear_alarms(self) -> None:
        """Clear alarms and sensor errors that are latched; those whose cause is still there stay.

        Does nothing where the controller latches none.
        """
        ...

    def limits_c(self) -> tuple[float, float]:
        """Lowest and highest set point that the controller accepts.

        Raises
        ------
        RefusedError
            The controller does not tell them.
        """
        ...

    def set_temperature(self, temperature_c: float, rate_c_per_min: float | None) -> None:
        """Command a temperature, approached at that rate, or as fast as possible with None.

        Both are rounded to the controller's resolution.

        Raises
        ------
        RefusedError
            A value is outside the controller's limits or no finite number (nothing has been
            sent then), or the controller does not hold what was written.
        """
        ...

    def set_point_c(self) -> float:
        """Temperature last commanded."""
        ...

    def switch(self, on: bool) -> None:
        """Switch the chamber's temperature control on or off."""
        ...

    def switch_event(self, number: int, on: bool) -> None:
        """Switch one of the controller's event outputs, counted from 1."""
        ...

    def is_event_on(self, number: int) -> bool:
        """Whether one of the controller's event outputs is switched on."""
        ...

    def close(self) -> None:
        """Close the line to the controller; the chamber goes on as it is."""
        ...


OptionsT = TypeVar("OptionsT", bound=StrictModel)


@dataclass(frozen=True)
class ChamberDialect(Generic[OptionsT]):
    """One dialect; offered as an entry point of the group ``gyrobench.chambers``.

    Attributes
    ----------
    open : callable
        Makes the driver from the line to the controller and the options; the driver closes the line.
    options : type of StrictModel
        The keys of its own in the station file's section ``chamber``.
    line : LineDefaults
        How such a controller is usually reached.
    """

    open: Callable[[SerialLine, OptionsT], Chamber]
    options: type[OptionsT]
    line: LineDefaults = field(default_factory=LineDefaults)
