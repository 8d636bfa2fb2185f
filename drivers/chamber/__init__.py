"""Thermal chambers: the interface that the bench uses.

Each other module of this folder is one dialect, except :mod:`text_chamber`, the base class of dialects with
text commands, and :mod:`software_ramp`, ramps for controllers without them. Temperatures are in degrees
Celsius.
"""

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
    """State of a chamber at one poll."""

    temperature_c: float  #: Measured air temperature.
    set_point_c: float | None = None  #: Set point held by the controller; None if it can't be read.
    is_on: bool | None = None  #: Whether temperature control is on; None if it can't be read.
    alarms: tuple[str, ...] = field(kw_only=True)  #: Active alarms as text for the operator; empty if none.


class RunsProfiles(Protocol):
    """A controller that can run a temperature profile (a program) stored in it."""

    def running_profile(self) -> str:
        """Describe the profile that runs or is paused; empty if there is none, or that can't be read."""

    def end_profile(self) -> None:
        """End the running profile."""


class Chamber(RunsProfiles, Protocol):
    """A thermal chamber; each dialect implements this protocol.

    Commands set absolute states, so the bench may repeat any of them after a failed exchange. Settings are
    read back where the controller allows. A call ends within 30 s, also if the controller is silent.
    Each method may raise these errors of :mod:`gyrobench.bench.foundations.errors`:

    * NoReplyError: no complete reply arrived in time;
    * ReplyError: a reply could not be interpreted;
    * RefusedError: the controller refused a command, or does not hold the value that was written;
    * ConnectionFailedError: the port could not be used.
    """

    #: Whether the controller ramps its set point; assumed True if a driver does not define it.
    can_ramp: bool

    def identify(self) -> str:
        """Return the controller's model, serial number and firmware, as far as reported, in one line.

        Returns the same text at each call: the bench compares it with that of an interrupted run.
        """

    def read(self) -> ChamberReading:
        """Read air temperature, alarms, set point, and whether temperature control is on.

        Raises FaultError if the controller's temperature sensor is faulty; the message contains all alarms.
        """

    def clear_alarms(self) -> None:
        """Clear latched alarms and sensor errors, if any; alarms whose cause persists stay active."""

    def limits_c(self) -> tuple[float, float]:
        """Read the lowest and the highest set point that the controller accepts.

        Raises RefusedError if the controller can't report them.
        """

    def set_temperature(self, temperature_c: float, rate_c_per_min: float | None) -> None:
        """Command a set point, approached at ``rate_c_per_min`` or, if that is None, as fast as possible.

        Both are rounded to the controller's resolution. Does not switch the chamber on. Raises RefusedError
        if a value is not finite or outside the controller's limits, a rate is given but ``can_ramp`` is
        False, a profile runs, the controller's settings have changed since it was opened, or it does not
        hold the value that was written.
        """

    def set_point_c(self) -> float:
        """Read the set point last commanded: the end of a ramp, not its present value."""

    def switch(self, on: bool) -> None:
        """Switch temperature control on or off; raises RefusedError while a profile runs."""

    def switch_event(self, number: int, on: bool) -> None:
        """Switch an event output of the controller by its number, from 1.

        Raises RefusedError if there is no such output.
        """

    def is_event_on(self, number: int) -> bool:
        """Whether an event output of the controller is on; raises RefusedError if there is no such output."""

    def close(self) -> None:
        """Close the line without any command; the chamber continues unchanged."""


class ChamberOptions(StrictModel):
    """Station file keys common to chambers whose controller can run a profile."""

    running_profile: Literal["refuse", "end"] = Field(
        "refuse",
        description="a profile that the controller runs by itself: refuse to use the chamber, or end it",
    )


def running_profile(chamber: Chamber) -> str:
    """Describe the profile that a chamber runs; empty if none, or if its driver lacks this method."""
    return str(getattr(chamber, "running_profile", str)())


def require_no_profile(chamber: RunsProfiles, instrument: str, end: bool) -> None:
    """End a running profile if ``end``, else raise RefusedError, as it overrides the set point.

    Also raises RefusedError if the profile runs on after it was ended.
    """
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

    Raises RefusedError if a profile runs and ``end_profiles`` is False; to switch off, the output is
    switched before that check.
    """
    if not on:
        chamber.switch_event(output, on)
    require_no_profile(chamber, instrument, end_profiles)
    if on:
        chamber.switch_event(output, on)


@dataclass(frozen=True)
class ChamberDialect(Generic[_OptionsT]):
    """One dialect; registered as an entry point of the group ``gyrobench.chambers``."""

    #: Returns the driver. Arguments: the open line to the controller, and the options. The driver owns the
    #: line and closes it.
    open: Callable[[SerialLine, _OptionsT], Chamber]
    options: type[_OptionsT]  #: Additional keys in the station file's section ``chamber``.
    line: LineDefaults = field(default_factory=LineDefaults)  #: Default line settings of this controller.
