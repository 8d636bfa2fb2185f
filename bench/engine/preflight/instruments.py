"""Preflight check of rate table and chamber, and the check of every instrument that it answers."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import TypeVar

from gyrobench.bench.foundations.errors import FaultError, InstrumentError, RefusedError
from gyrobench.bench.station.check_result import Check
from gyrobench.bench.station.instruments import CHAMBER, RATE_TABLE
from gyrobench.bench.station.station import Station
from gyrobench.drivers.chamber import Chamber, running_profile
from gyrobench.drivers.rate_table import AxisLimits, RateTable

#: The first check of each instrument.
ANSWERS = "answers"

_LIMITS = "limits"
#: Maximum difference of the air from the set point of a chamber that holds it.
_HOLDING_TOLERANCE_C = 2.0
_FIND_CAUSE = "Find the cause and clear it at the controller."

_DriverT = TypeVar("_DriverT", RateTable, Chamber)


def identity_check(subject: str, identification: str, expected: str = "") -> Check:
    """Check whether an instrument that answered is the one in the station file.

    Table and chamber are compared when they are opened.
    """
    is_expected = expected in identification
    found = identification if is_expected else f"identifies as {identification}, which lacks {expected!r}"
    advice = "Connect the right instrument, or correct `identity` in the station file."
    return Check.of(subject, ANSWERS, is_expected, found, advice)


def no_answer_check(subject: str, error: InstrumentError) -> Check:
    """Report why an instrument does not answer, or that it is another one."""
    advice = "Connect the right instrument; nothing else is checked until it answers."
    return Check.of(subject, ANSWERS, False, error.message, advice)


def failed_request_check(subject: str, what: str, error: InstrumentError) -> Check:
    """Report that a later request failed."""
    return Check.of(subject, what, False, error.message, "Check its line, and repeat the check.")


def table_checks(station: Station, table: Callable[[], RateTable]) -> Iterator[Check]:
    """Check whether the table answers, has no faults, and allows the station's limits.

    ``table`` returns the driver, or raises if it can't be opened.
    """
    checks = (("no faults", _table_faults), (_LIMITS, _table_limits))
    yield from _checks(RATE_TABLE, station, table, checks)


def chamber_checks(station: Station, chamber: Callable[[], Chamber]) -> Iterator[Check]:
    """Check whether the chamber answers, has no alarms, runs no profile, and takes set points and ramps.

    Its present set point is commanded again, which changes nothing; it keeps the station's fastest ramp.

    ``chamber`` returns the driver, or raises if it can't be opened.
    """
    checks = (
        ("no alarms", _chamber_alarms),
        ("air temperature", _chamber_air),
        (_LIMITS, _chamber_limits),
        ("no profile", _chamber_profile),
        ("set point", _chamber_set_point),
    )
    yield from _checks(CHAMBER, station, chamber, checks)


def _checks(
    subject: str,
    station: Station,
    driver: Callable[[], _DriverT],
    checks: Iterable[tuple[str, Callable[[Station, _DriverT], tuple[bool, str, str]]]],
) -> Iterator[Check]:
    """Perform each check; its function returns whether it passes, the finding, and the advice."""
    try:
        instrument = driver()
        yield identity_check(subject, instrument.identify())
    except InstrumentError as error:
        yield no_answer_check(subject, error)
        return
    for what, check in checks:
        try:
            yield Check.of(subject, what, *check(station, instrument))
        except _NotReportedError as error:
            yield Check.skipped(subject, what, error.message)
        except InstrumentError as error:
            yield failed_request_check(subject, what, error)


class _NotReportedError(InstrumentError):
    """The instrument does not report the quantity to be checked."""


def _table_faults(station: Station, table: RateTable) -> tuple[bool, str, str]:  # noqa: ARG001
    faults = table.read().faults
    return not faults, f"reports {', '.join(faults) or 'none'}", _FIND_CAUSE


def _table_limits(station: Station, table: RateTable) -> tuple[bool, str, str]:
    try:
        limits = table.limits()
    except RefusedError as error:
        raise _NotReportedError(RATE_TABLE, f"the controller does not report them ({error})") from error
    section = station.file.rate_table
    by_axis = dict(zip(section.axis_numbers, limits, strict=True))
    problems = [*_exceeded_limits(station, "inner", by_axis[section.inner_axis_number])]
    if not section.is_single_axis:
        problems = [*_exceeded_limits(station, "outer", by_axis[section.outer_axis_number]), *problems]
    found = "; ".join(problems) or "the controller allows the station file's limits"
    advice = "Reduce rate_table.limits in the station file, or increase the controller's absolute limits."
    return not problems, found, advice


def _exceeded_limits(station: Station, axis: str, allowed: AxisLimits) -> Iterator[str]:
    """Limits of the station file that the controller of an axis does not allow."""
    section = station.file.rate_table
    limits = section.limits
    for name, limit, allowed_limit, unit in (
        ("rate", limits.rate_dps, allowed.rate_dps, "deg/s"),
        ("rate trip", limits.rate_dps, allowed.trip_dps, "deg/s"),
        ("acceleration", limits.acceleration_dps2, allowed.acceleration_dps2, "deg/s2"),
        ("jerk", limits.jerk_dps3, allowed.jerk_dps3, "deg/s3"),
    ):
        if limit > allowed_limit:
            yield (
                f"{axis} axis: {name} {limit:g} {unit} in the station file, "
                f"{allowed_limit:g} in the controller"
            )
    low_deg, high_deg = section.outer_limits_deg if axis == "outer" else section.inner_limits_deg
    if low_deg < allowed.low_deg or high_deg > allowed.high_deg:
        yield (
            f"{axis} axis: {low_deg:g} to {high_deg:g} deg in the station file, "
            f"{allowed.low_deg:g} to {allowed.high_deg:g} deg in the controller"
        )


def _chamber_alarms(station: Station, chamber: Chamber) -> tuple[bool, str, str]:  # noqa: ARG001
    try:
        alarms = chamber.read().alarms
    except FaultError as error:
        return False, f"reports {error.message}", _FIND_CAUSE
    return not alarms, f"reports {', '.join(alarms) or 'none'}", _FIND_CAUSE


def _chamber_air(station: Station, chamber: Chamber) -> tuple[bool, str, str]:
    try:
        air_c = chamber.read().temperature_c
    except FaultError as error:
        raise _NotReportedError(CHAMBER, error.message) from error
    limits = station.file.chamber.limits
    low_c, high_c = station.file.interlocks.chamber_air.range_c((limits.low_c, limits.high_c))
    found = f"{air_c:.1f} degC, interlock limits {low_c:g} and {high_c:g} degC"
    advice = "Check sensor and controller; bring the air into this range before a run."
    return low_c <= air_c <= high_c, found, advice


def _chamber_limits(station: Station, chamber: Chamber) -> tuple[bool, str, str]:
    try:
        low_c, high_c = chamber.limits_c()
    except RefusedError as error:
        raise _NotReportedError(CHAMBER, f"the controller does not report them ({error})") from error
    limits = station.file.chamber.limits
    found = (
        f"{low_c:g} to {high_c:g} degC in the controller, {limits.low_c:g} to {limits.high_c:g} degC in the "
        "station file"
    )
    advice = "Reduce chamber.limits in the station file, or extend the controller's set point limits."
    return low_c <= limits.low_c and limits.high_c <= high_c, found, advice


def _chamber_profile(station: Station, chamber: Chamber) -> tuple[bool, str, str]:
    profile = running_profile(chamber)
    is_ended = getattr(station.file.chamber, "running_profile", "refuse") == "end"
    found = f"runs {profile}{'; a run ends it' if is_ended else ''}" if profile else "reports none"
    advice = "End it at its panel, or set chamber.running_profile: end."
    return is_ended or not profile, found, advice


def _chamber_set_point(station: Station, chamber: Chamber) -> tuple[bool, str, str]:
    """Command the present set point again with the station's fastest ramp."""
    limits, reading = station.file.chamber.limits, chamber.read()
    set_c = chamber.set_point_c()
    # Also if on or off can't be read.
    is_changing = reading.is_on is not False and abs(reading.temperature_c - set_c) > _HOLDING_TOLERANCE_C
    if running_profile(chamber) or is_changing:
        raise _NotReportedError(CHAMBER, "is not tried while the chamber changes its temperature")
    if not limits.low_c <= set_c <= limits.high_c:
        raise _NotReportedError(
            CHAMBER, f"is not tried: {set_c:g} degC is outside {limits.low_c:g} to {limits.high_c:g} degC"
        )
    can_ramp = getattr(chamber, "can_ramp", True)
    try:
        chamber.set_temperature(set_c, limits.ramp_c_per_min if can_ramp else None)
    except RefusedError as error:
        return False, error.message, "Every run commands set points with ramps."
    ramp_text = (
        f"the controller ramps and keeps {limits.ramp_c_per_min:g} degC/min as its ramp"
        if can_ramp
        else "the controller does not ramp, so the bench moves it in steps"
    )
    return True, f"{set_c:g} degC was accepted again; {ramp_text}", ""
