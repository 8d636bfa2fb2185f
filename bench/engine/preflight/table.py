"""Preflight of the rate table."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from gyrobench.bench.engine.preflight.answer import answered, failed, unanswered
from gyrobench.bench.foundations.errors import InstrumentError, RefusedError
from gyrobench.bench.station.check import Check
from gyrobench.bench.station.station import Station
from gyrobench.drivers.rate_table import AxisLimits, RateTable

_SUBJECT, _LIMITS = "rate table", "its limits"
_NARROW = "Narrow rate_table.limits in the station file, or widen the controller's absolute limits."


def table_checks(station: Station, table: Callable[[], RateTable]) -> Iterator[Check]:
    """Look whether it answers, reports nothing wrong, and can do what the station allows.

    Parameters
    ----------
    table : callable
        Gives the driver, or raises where it can't be opened.
    """
    try:
        opened = table()
        yield answered(_SUBJECT, opened.identify(), station.file.rate_table.identity)
    except InstrumentError as error:
        yield unanswered(_SUBJECT, error)
        return
    try:
        faults = opened.faults()
        yield Check.of(
            _SUBJECT,
            "no faults",
            not faults,
            f"reports {', '.join(faults) or 'none'}",
            "Find the cause and clear it at the controller.",
        )
    except InstrumentError as error:
        yield failed(_SUBJECT, "no faults", error)
    yield _limits(station, opened)


def _limits(station: Station, table: RateTable) -> Check:
    try:
        limits = table.limits()
    except RefusedError as error:
        return Check.skipped(_SUBJECT, _LIMITS, f"the controller does not tell them ({error})")
    except InstrumentError as error:
        return failed(_SUBJECT, _LIMITS, error)
    section = station.file.rate_table
    of_axis = dict(zip(section.axis_numbers, limits, strict=True))
    problems = [*_beyond(station, "inner", of_axis[section.inner_axis_number])]
    if not section.is_single_axis:
        problems = [*_beyond(station, "outer", of_axis[section.outer_axis_number]), *problems]
    return Check.of(
        _SUBJECT,
        _LIMITS,
        not problems,
        "; ".join(problems) or "the controller allows all that the station file does",
        _NARROW,
    )


def _beyond(station: Station, axis: str, own: AxisLimits) -> Iterator[str]:
    """Say what the station allows an axis and the controller does not."""
    section = station.file.rate_table
    limits = section.limits
    for name, ours, theirs, unit in (
        ("rate", limits.rate_dps, own.rate_dps, "deg/s"),
        ("rate, which trips,", limits.rate_dps, own.trip_dps, "deg/s"),
        ("acceleration", limits.acceleration_dps2, own.acceleration_dps2, "deg/s2"),
        ("jerk", limits.jerk_dps3, own.jerk_dps3, "deg/s3"),
    ):
        if ours > theirs:
            yield f"{axis} axis: {name} {ours:g} {unit} in the station file, {theirs:g} in the controller"
    low_deg, high_deg = section.outer_limits_deg if axis == "outer" else section.inner_limits_deg
    if low_deg < own.low_deg or high_deg > own.high_deg:
        yield (
            f"{axis} axis: {low_deg:g} to {high_deg:g} deg in the station file, "
            f"{own.low_deg:g} to {own.high_deg:g} deg in the controller"
        )
