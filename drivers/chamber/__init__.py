"""Thermal chambers: the interface that the bench uses; each other module is one dialect."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Generic, Protocol, TypeVar

from gyrobench.bench.foundations.documents import StrictModel
from gyrobench.drivers.serial_line import LineDefaults, SerialLine

OptionsT = TypeVar("OptionsT", bound=StrictModel)


@dataclass(frozen=True)
class ChamberReading:
    """One poll of a chamber."""

    temperature_c: float  #: Air temperature.
    set_point_c: float | None = None  #: The controller's set point; None if it can't be read.
    is_on: bool | None = None  #: Whether the temperature is controlled; None if it can't be read.


class Chamber(Protocol):
    """A thermal chamber; every method may raise an InstrumentError of the bench."""

    def identify(self) -> str:
        """Name of the controller, for the run's provenance."""

    def read(self) -> ChamberReading:
        """Measure the air; read set point and on or off back from the controller.

        Raises FaultError if the controller's temperature sensor is faulty.
        """

    def alarms(self) -> list[str]:
        """Active alarms and sensor errors, in words."""

    def clear_alarms(self) -> None:
        """Clear latched alarms and sensor errors, if there are any; those with a present cause stay."""

    def limits_c(self) -> tuple[float, float]:
        """Lowest and highest set point that the controller accepts.

        Raises RefusedError if they can't be read.
        """

    def set_temperature(self, temperature_c: float, rate_c_per_min: float | None) -> None:
        """Command a temperature, approached at that rate, or as fast as possible with None.

        Both are rounded to the controller's resolution. Raises RefusedError if a value is not finite or
        outside the controller's limits (nothing is sent then), or the controller does not keep what was
        written.
        """

    def set_point_c(self) -> float:
        """Temperature last commanded."""

    def switch(self, on: bool) -> None:
        """Switch the chamber's temperature control on or off."""

    def switch_event(self, number: int, on: bool) -> None:
        """Switch one of the controller's event outputs, counted from 1."""

    def is_event_on(self, number: int) -> bool:
        """Whether one of the controller's event outputs is on."""

    def close(self) -> None:
        """Close the line to the controller; the chamber continues unchanged."""


@dataclass(frozen=True)
class ChamberDialect(Generic[OptionsT]):
    """One dialect; offered as an entry point of the group ``gyrobench.chambers``."""

    #: Makes the driver from the line to the controller and the options; the driver closes the line.
    open: Callable[[SerialLine, OptionsT], Chamber]
    options: type[OptionsT]  #: Additional keys in the station file's section ``chamber``.
    line: LineDefaults = field(default_factory=LineDefaults)  #: Usual settings of such a controller's line.
