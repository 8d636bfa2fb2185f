"""Preflight of the thermal chamber."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from gyrobench.bench.engine.preflight.answer import answered, failed, unanswered
from gyrobench.bench.foundations.errors import FaultError, InstrumentError, RefusedError
from gyrobench.bench.station.check import Check
from gyrobench.bench.station.station import Station
from gyrobench.drivers.chamber import Chamber

_SUBJECT = "chamber"


def chamber_checks(station: Station, chamber: Callable[[], Chamber]) -> Iterator[Check]:
    """Look whether it answers, has no alarm, and takes the set points that the station allows.

    Parameters
    ----------
    chamber : callable
        Gives the driver, or raises where it can't be opened.
    """
    try:
        opened = chamber()
        yield answered(_SUBJECT, opened.identify(), station.file.chamber.identity)
    except InstrumentError as error:
        yield unanswered(_SUBJECT, error)
        return
    for what, look in (("no alarms", _alarms), ("its air", _air), ("its limits", _limits)):
        try:
            yield look(station, opened, what)
        except InstrumentError as error:
            yield failed(_SUBJECT, what, error)


def _alarms(station: Station, chamber: Chamber, what: str) -> Check:  # noqa: ARG001 - as the others
    alarms = chamber.alarms()
    return Check.of(
        _SUBJECT,
        what,
        not alarms,
        f"reports {', '.join(alarms) or 'none'}",
        "Find the cause and clear it at the controller.",
    )


def _air(station: Station, chamber: Chamber, what: str) -> Check:
    try:
        air_c = chamber.read().temperature_c
    except FaultError as error:
        return Check.skipped(_SUBJECT, what, str(error).removeprefix(f"{_SUBJECT}: "))
    limits = station.file.chamber.limits
    low_c, high_c = station.file.interlocks.chamber_air.range_c((limits.low_c, limits.high_c))
    return Check.of(
        _SUBJECT,
        what,
        low_c <= air_c <= high_c,
        f"is at {air_c:.1f} degC, interlock at {low_c:g} and {high_c:g} degC",
        "Check sensor and controller; let it come into this range before a run.",
    )


def _limits(station: Station, chamber: Chamber, what: str) -> Check:
    try:
        low_c, high_c = chamber.limits_c()
    except RefusedError as error:
        return Check.skipped(_SUBJECT, what, f"the controller does not tell them ({error})")
    ours = station.file.chamber.limits
    return Check.of(
        _SUBJECT,
        what,
        low_c <= ours.low_c and ours.high_c <= high_c,
        f"{low_c:g} to {high_c:g} degC in the controller, {ours.low_c:g} to {ours.high_c:g} degC in the "
        "station file",
        "Narrow chamber.limits in the station file, or widen the controller's own limits of its set point.",
    )
