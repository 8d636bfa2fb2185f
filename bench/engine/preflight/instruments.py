"""Preflight check of rate table and chamber, and the first check of each instrument: it answers."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from gyrobench.bench.foundations.errors import FaultError, InstrumentError, RefusedError
from gyrobench.bench.station.check import Check
from gyrobench.bench.station.station import Station
from gyrobench.drivers.chamber import Chamber
from gyrobench.drivers.rate_table import AxisLimits, RateTable

#: The first check of each instrument.
ANSWERS = "answers"

_TABLE, _CHAMBER = "rate table", "chamber"


def answered(subject: str, identification: str, expected: str) -> Check:
    """Check whether an instrument that answered is the one in the station file."""
    return Check.of(
        subject,
        ANSWERS,
        expected in identification,
        identification
        if expected in identification
        else f"identifies as {identification}, which lacks {expected!r}",
        "Connect the right instrument, or correct `identity` in the station file.",
    )


def unanswered(subject: str, error: InstrumentError) -> Check:
    """Report why an instrument does not answer."""
    return Check.of(
        subject,
        ANSWERS,
        False,
        str(error).removeprefix(f"{subject}: "),
        "Nothing else is checked until it answers.",
    )


def failed(subject: str, what: str, error: InstrumentError) -> Check:
    """Report that a later request failed."""
    found = str(error).removeprefix(f"{subject}: ")
    return Check.of(subject, what, False, found, "Check its line, and repeat the check.")


def table_checks(station: Station, table: Callable[[], RateTable]) -> Iterator[Check]:
    """Check whether the table answers, has no faults, and allows the station's limits.

    Parameters
    ----------
    table : callable
        Returns the driver, or raises where it can't be opened.
    """
    try:
        opened = table()
        yield answered(_TABLE, opened.identify(), station.file.rate_table.identity)
    except InstrumentError as error:
        yield unanswered(_TABLE, error)
        return
    try:
        faults = opened.faults()
        yield Check.of(
            _TABLE,
            "no faults",
            not faults,
            f"reports {', '.join(faults) or 'none'}",
            "Find the cause and clear it at the controller.",
        )
    except InstrumentError as error:
        yield failed(_TABLE, "no faults", error)
    yield _table_limits(station, opened)


def _table_limits(station: Station, table: RateTable) -> Check:
    try:
        limits = table.limits()
    except RefusedError as error:
        return Check.skipped(_TABLE, "limits", f"the controller does not report them ({error})")
    except InstrumentError as error:
        return failed(_TABLE, "limits", error)
    section = station.file.rate_table
    by_axis = dict(zip(section.axis_numbers, limits, strict=True))
    problems = [*_exceeded(station, "inner", by_axis[section.inner_axis_number])]
    if not section.is_single_axis:
        problems = [*_exceeded(station, "outer", by_axis[section.outer_axis_number]), *problems]
    return Check.of(
        _TABLE,
        "limits",
        not problems,
        "; ".join(problems) or "the controller allows the station file's limits",
        "Reduce rate_table.limits in the station file, or increase the controller's absolute limits.",
    )


def _exceeded(station: Station, axis: str, allowed: AxisLimits) -> Iterator[str]:
    """Limits of the station file that an axis's controller does not allow."""
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


def chamber_checks(station: Station, chamber: Callable[[], Chamber]) -> Iterator[Check]:
    """Check whether the chamber answers, has no alarms, and accepts the station's set points.

    Parameters
    ----------
    chamber : callable
        Returns the driver, or raises where it can't be opened.
    """
    try:
        opened = chamber()
        yield answered(_CHAMBER, opened.identify(), station.file.chamber.identity)
    except InstrumentError as error:
        yield unanswered(_CHAMBER, error)
        return
    for what, check in (
        ("no alarms", _chamber_alarms),
        ("air temperature", _chamber_air),
        ("limits", _chamber_limits),
    ):
        try:
            yield check(station, opened, what)
        except InstrumentError as error:
            yield failed(_CHAMBER, what, error)


def _chamber_alarms(station: Station, chamber: Chamber, what: str) -> Check:  # noqa: ARG001 - as the others
    alarms = chamber.alarms()
    return Check.of(
        _CHAMBER,
        what,
        not alarms,
        f"reports {', '.join(alarms) or 'none'}",
        "Find the cause and clear it at the controller.",
    )


def _chamber_air(station: Station, chamber: Chamber, what: str) -> Check:
    try:
        air_c = chamber.read().temperature_c
    except FaultError as error:
        return Check.skipped(_CHAMBER, what, str(error).removeprefix(f"{_CHAMBER}: "))
    limits = station.file.chamber.limits
    low_c, high_c = station.file.interlocks.chamber_air.range_c((limits.low_c, limits.high_c))
    return Check.of(
        _CHAMBER,
        what,
        low_c <= air_c <= high_c,
        f"{air_c:.1f} degC, interlock limits {low_c:g} and {high_c:g} degC",
        "Check sensor and controller; bring the air into this range before a run.",
    )


def _chamber_limits(station: Station, chamber: Chamber, what: str) -> Check:
    try:
        low_c, high_c = chamber.limits_c()
    except RefusedError as error:
        return Check.skipped(_CHAMBER, what, f"the controller does not report them ({error})")
    limits = station.file.chamber.limits
    return Check.of(
        _CHAMBER,
        what,
        low_c <= limits.low_c and limits.high_c <= high_c,
        f"{low_c:g} to {high_c:g} degC in the controller, {limits.low_c:g} to {limits.high_c:g} degC in the "
        "station file",
        "Reduce chamber.limits in the station file, or extend the controller's set point limits.",
    )
