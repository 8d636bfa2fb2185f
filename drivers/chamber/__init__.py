"""Thermal chambers: the interface that the bench uses; each other module is one dialect."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Generic, Literal, Protocol, TypeVar

from pydantic import Field

from gyrobench.bench.foundations.documents import StrictModel
from gyrobench.bench.foundations.errors import RefusedError
from gyrobench.drivers.serial_line import LineDefaults, SerialLine

_OptionsT = TypeVar("_OptionsT", bound=StrictModel)


@dataclass(frozen=True)
class ChamberReading:
    """One poll of a chamber."""

    temperature_c: float  #: Air temperature.
    set_point_c: float | None = None  #: The controller's set point; None if it can't be read.
    is_on: bool | None = None  #: Whether the temperature is controlled; None if it can't be read.
    alarms: tuple[str, ...] = field(kw_only=True)  #: Active alarms, in words.


class RunsProfiles(Protocol):
    """A controller that may run a profile (a program) by itself."""

    def running_profile(self) -> str:
        """Describe the profile that it runs; empty if none, or it can't be read."""

    def end_profile(self) -> None:
        """End that profile."""


class Chamber(RunsProfiles, Protocol):
    """A thermal chamber; every method may raise an InstrumentError of the bench."""

    can_ramp: bool  #: Whether the controller ramps its set point; assumed where a driver lacks it.

    def identify(self) -> str:
        """Name of the controller, for the run's provenance.

        The same text at each call.
        """

    def read(self) -> ChamberReading:
        """Measure the air; read alarms, set point, and on or off back from the controller.

        Raises FaultError if the controller's temperature sensor is faulty, with all alarms in its message.
        """

    def clear_alarms(self) -> None:
        """Clear latched alarms and sensor errors, if there are any; those with a present cause stay."""

    def limits_c(self) -> tuple[float, float]:
        """Lowest and highest set point that the controller accepts.

        Raises RefusedError if they can't be read.
        """

    def set_temperature(self, temperature_c: float, rate_c_per_min: float | None) -> None:
        """Command a temperature, approached at that rate, or as fast as possible with None.

        Both are rounded to the controller's resolution. Raises RefusedError if a value is not finite or
        outside the controller's limits, a rate is given to one that can't ramp, the controller has a profile
        or other settings than when it was opened, or it does not keep what was written.
        """

    def set_point_c(self) -> float:
        """Temperature last commanded."""

    def switch(self, on: bool) -> None:
        """Switch the chamber's temperature control on or off; raises RefusedError while a profile runs."""

    def switch_event(self, number: int, on: bool) -> None:
        """Switch one of the controller's event outputs, counted from 1."""

    def is_event_on(self, number: int) -> bool:
        """Whether one of the controller's event outputs is on."""

    def close(self) -> None:
        """Close the line to the controller; the chamber continues unchanged."""


class ChamberOptions(StrictModel):
    """Additional keys in the station file that chambers with profiles share."""

    running_profile: Literal["refuse", "end"] = Field(
        "refuse",
        description="a profile that the controller runs by itself: refuse to use the chamber, or end it",
    )


def running_profile(chamber: Chamber) -> str:
    """Describe the profile that a chamber runs; a driver without this method reports none."""
    return str(getattr(chamber, "running_profile", str)())


def require_no_profile(chamber: RunsProfiles, instrument: str, end: bool) -> None:
    """End a profile that the controller runs by itself, or raise RefusedError: it overrides the set point."""
    profile = chamber.running_profile()
    if profile and end:
        chamber.end_profile()
        profile = chamber.running_profile()
    if profile:
        raise RefusedError(
            instrument,
            f"runs {profile}, which overrides its set point. End it at the panel, or set "
            "chamber.running_profile: end.",
        )


def switch_output(chamber: Chamber, output: int, on: bool, end_profiles: bool, instrument: str) -> None:
    """Switch the event output of a chamber's machinery, which a running profile may switch too.

    Raises RefusedError while a profile runs that is not to be ended; off it is switched before.
    """
    if not on:
        chamber.switch_event(output, on)
    require_no_profile(chamber, instrument, end_profiles)
    if on:
        chamber.switch_event(output, on)


@dataclass(frozen=True)
class ChamberDialect(Generic[_OptionsT]):
    """One dialect; offered as an entry point of the group ``gyrobench.chambers``."""

    #: Makes the driver from the line to the controller and the options; the driver closes the line.
    open: Callable[[SerialLine, _OptionsT], Chamber]
    options: type[_OptionsT]  #: Additional keys in the station file's section ``chamber``.
    line: LineDefaults = field(default_factory=LineDefaults)  #: Usual settings of such a controller's line.
