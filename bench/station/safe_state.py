"""The safe state, in which the bench is left at any end of a run."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from enum import StrEnum

from gyrobench.bench.foundations.errors import ConnectionFailedError, InstrumentError, RefusedError
from gyrobench.bench.station.instruments import CHAMBER, RATE_TABLE, Outputs, within
from gyrobench.bench.station.station import Station
from gyrobench.drivers.chamber import Chamber

#: Time limits, far beyond what healthy instruments need. A release waits for rest.
_EXCHANGE_TIME_S = 20.0
_RELEASE_TIME_S = 60.0

#: Period at which the chamber's set point is moved to its safe value, s.
RAMP_PERIOD_S = 1.0
#: Meanwhile, period at which an action that failed is repeated.
_REPEAT_PERIOD_S = 5.0
#: A chamber that does not answer for longer has failed.
_SILENCE_S = 60.0
#: Begin of why the action of a chamber failed that was switched off instead.
_REFUSED = "it was commanded off, as it refuses its set point"
#: A set point so close is the safe value: controllers may have whole degrees.
_RESOLUTION_C = 0.6


class SafePart(StrEnum):
    """What an action makes safe."""

    TABLE_AT_REST = "table at rest"
    TABLE_RELEASED = "table released"
    CHAMBER = "chamber"
    CHAMBER_OFF = "chamber off"
    UNIT = "unit"


_CHAMBER = (SafePart.CHAMBER, SafePart.CHAMBER_OFF)


@dataclass(frozen=True)
class SafeAction:
    """One action on the way to the safe state."""

    what: str
    part: SafePart
    problem: str = ""  #: Why it failed; empty if not.
    first_problem: str = ""  #: Why its first attempt failed; empty if not.

    @property
    def instrument(self) -> str:
        """Instrument that it commands."""
        return RATE_TABLE if self.part in (SafePart.TABLE_AT_REST, SafePart.TABLE_RELEASED) else CHAMBER

    @property
    def has_switched_off(self) -> bool:
        """Whether the chamber was switched off in an attempt, as it refused its set point."""
        return any(_REFUSED in problem for problem in (self.problem, self.first_problem))

    @property
    def text(self) -> str:
        """The action, or that it failed and why."""
        return f"FAILED: {self.what}: {self.problem}" if self.problem else self.what


@dataclass(frozen=True)
class _Step:
    action: SafeAction  #: If it succeeds.
    limit_s: float
    apply: Callable[[], object]


def make_safe(
    station: Station,
    instruments: Outputs,
    release_table: bool = True,
    only: Collection[str] | None = None,
    meanwhile: Callable[[], object] = lambda: None,
    chamber_off: bool = False,
) -> list[SafeAction]:
    """Stop the table, bring chamber and unit to their safe state, release the table.

    In this order, because a table is released only at rest. Each action is attempted regardless of the ones
    before, within its time limit, and a second time if it failed, through a reopened port if the port was
    lost or does not respond. None raises. ``release_table`` opens the servos too, which is not needed before
    the first step. ``only`` has the ``what`` of the actions to take, by default all; ``meanwhile`` is called
    repeatedly while waiting. ``chamber_off``: the chamber is switched off too, as one that does not control
    its air.
    """
    steps = _steps(station, instruments, release_table, chamber_off)
    chosen = (step for step in steps if only is None or step.action.what in only)
    return [_taken(step, instruments, meanwhile) for step in chosen]


def repeat(
    station: Station, instruments: Outputs, failed: Collection[SafeAction], meanwhile: Callable[[], object]
) -> list[SafeAction]:
    """Take actions again that failed, as :func:`make_safe`."""
    return make_safe(
        station,
        instruments,
        only=[action.what for action in failed],
        meanwhile=meanwhile,
        chamber_off=any(action.part is SafePart.CHAMBER_OFF for action in failed),
    )


def finish_ramp(
    station: Station,
    instruments: Outputs,
    actions: Iterable[SafeAction],
    meanwhile: Callable[[], object] = lambda: None,
) -> Iterator[list[SafeAction]]:
    """Move the chamber's set point to its safe value where its controller does not ramp; may take an hour.

    Yields the actions that were taken since, with ``RAMP_PERIOD_S`` to be waited at each yield: that of the
    set point, which counts as failed until the ramp has ended well, and ``actions`` that had failed, which
    are repeated. Yields nothing where there is no ramp. ``meanwhile`` is called during an exchange that takes
    long.
    """
    if not instruments.is_ramping:
        return
    clock, safe_c = instruments.clock, station.file.safe_state.chamber_c
    steps = _steps(station, instruments, release_table=False)
    (chamber,) = (step for step in steps if step.action.part in _CHAMBER)
    failed = [action for action in actions if action.problem and action.part is not chamber.action.part]

    def check_end() -> None:
        held_c = instruments.chamber.set_point_c()
        if safe_c is None or abs(held_c - safe_c) > _RESOLUTION_C:
            raise RefusedError(CHAMBER, f"its set point is {held_c:g} degC instead. Check its panel.")

    moved, repeated = chamber.action, list[SafeAction]()
    answered_s = repeated_s = clock.now()
    while instruments.is_ramping and clock.now() - answered_s < _SILENCE_S:
        yield [replace(moved, problem=moved.problem or "is still on its way there"), *repeated]
        moved, repeated = _taken(replace(chamber, apply=instruments.advance_ramp), instruments, meanwhile), []
        if not moved.problem:
            answered_s = clock.now()
        if failed and clock.now() - repeated_s >= _REPEAT_PERIOD_S:
            repeated = repeat(station, instruments, failed, meanwhile)
            failed = [action for action in repeated if action.problem]
            repeated_s = clock.now()
    if not moved.problem:
        ended = _taken(replace(chamber, apply=check_end), instruments, meanwhile)
        # A ramp that was refused has no second attempt, and its reason says more.
        moved = replace(ended, problem=ended.problem and (moved.first_problem or ended.problem))
    yield [moved, *repeated]


def _steps(
    station: Station, instruments: Outputs, release_table: bool, chamber_off: bool = False
) -> list[_Step]:
    safe = station.file.safe_state
    steps: list[_Step] = []

    def add(part: SafePart, what: str, apply: Callable[[], None], limit_s: float = _EXCHANGE_TIME_S) -> None:
        steps.append(_Step(SafeAction(what, part), limit_s, apply))

    add(SafePart.TABLE_AT_REST, "rate table stopped", lambda: instruments.table.stop())
    safe_c = safe.chamber_c
    if safe_c is not None:
        ramp = station.file.chamber.limits.ramp_c_per_min
        add(
            SafePart.CHAMBER,
            f"chamber's set point at {safe_c:g} degC",
            lambda: _set_or_off(instruments.chamber, safe_c, ramp),
        )
    if chamber_off or safe_c is None:
        add(SafePart.CHAMBER_OFF, "chamber switched off", lambda: instruments.chamber.switch(False))
    if safe.unit == "off":
        what = "INS switched off" if len(station.units) == 1 else "all INS switched off"
        add(SafePart.UNIT, what, lambda: instruments.power_unit(False))
    else:
        add(SafePart.UNIT, "INS left as it is", lambda: None)
    if release_table:
        what = "rate table's servos off"
        add(SafePart.TABLE_RELEASED, what, lambda: instruments.table.release(), _RELEASE_TIME_S)
    return steps


def _set_or_off(chamber: Chamber, temperature_c: float, ramp_c_per_min: float) -> None:
    """Command a set point; a chamber that refuses it is switched off and not reported safe."""
    try:
        chamber.set_temperature(temperature_c, ramp_c_per_min)
    except RefusedError as error:
        with suppress(RefusedError):  # off, but a profile that runs may switch it on again
            chamber.switch(False)
        raise RefusedError(CHAMBER, f"{_REFUSED}: {error.message}") from error


def _taken(step: _Step, instruments: Outputs, meanwhile: Callable[[], object]) -> SafeAction:
    first = _problem(step, instruments, step.apply, meanwhile)
    if first is None:
        return step.action

    def again() -> None:
        if isinstance(first, ConnectionFailedError):
            instruments.reopen(step.action.instrument)
        step.apply()

    second = _problem(step, instruments, again, meanwhile)
    return replace(step.action, problem="" if second is None else _text(second), first_problem=_text(first))


def _problem(
    step: _Step, instruments: Outputs, apply: Callable[[], object], meanwhile: Callable[[], object]
) -> Exception | None:
    try:
        within(instruments.clock, step.limit_s, step.action.instrument, apply, meanwhile=meanwhile)
    except Exception as error:  # noqa: BLE001 - nothing may keep the next action from being tried
        return error
    return None


def _text(error: Exception) -> str:
    if isinstance(error, InstrumentError):
        return str(error)
    return f"unexpected {type(error).__name__}: {error}"
