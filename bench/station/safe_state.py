"""The safe state, to which the bench is brought at any end of a run."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from enum import StrEnum

from gyrobench.bench.foundations.errors import ConnectionFailedError, InstrumentError, RefusedError
from gyrobench.bench.station.instruments import CHAMBER, RATE_TABLE, Outputs
from gyrobench.bench.station.station import Station
from gyrobench.bench.station.time_limit import LimitedCall
from gyrobench.drivers.chamber import Chamber

#: Time limits, far longer than healthy instruments need. A release waits until the table is at rest.
_EXCHANGE_TIME_S = 20.0
_RELEASE_TIME_S = 60.0

#: Period at which the chamber's set point is moved to its safe value, s.
RAMP_PERIOD_S = 1.0
#: Period at which a failed action is repeated during the ramp, s.
_REPEAT_PERIOD_S = 5.0
#: A chamber that does not answer for this long has failed.
_SILENCE_S = 60.0
#: Start of the problem text of a chamber that was switched off, as it refused its set point.
_REFUSED = "it was commanded off, as it refuses its set point"
#: A set point this close counts as the safe value: controllers may have whole degrees.
_RESOLUTION_C = 0.6


class SafePart(StrEnum):
    """Part of the bench that an action makes safe."""

    TABLE_AT_REST = "table at rest"
    TABLE_RELEASED = "table released"
    CHAMBER = "chamber"
    CHAMBER_OFF = "chamber off"
    UNIT = "unit"


_CHAMBER = (SafePart.CHAMBER, SafePart.CHAMBER_OFF)


@dataclass(frozen=True)
class SafeAction:
    """One action that brings the bench to its safe state."""

    what: str
    part: SafePart
    problem: str = ""  #: Why it failed; empty if it succeeded.
    first_problem: str = ""  #: Why its first attempt failed; empty if it succeeded.

    @property
    def instrument(self) -> str:
        """Instrument that the action commands."""
        return RATE_TABLE if self.part in (SafePart.TABLE_AT_REST, SafePart.TABLE_RELEASED) else CHAMBER

    @property
    def has_switched_off(self) -> bool:
        """Whether the chamber was switched off in an attempt because it refused its set point."""
        return any(_REFUSED in problem for problem in (self.problem, self.first_problem))

    @property
    def text(self) -> str:
        """The action, or that it failed and why."""
        return f"FAILED: {self.what}: {self.problem}" if self.problem else self.what


@dataclass(frozen=True)
class _Step:
    action: SafeAction  #: Result if it succeeds.
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

    The order matters, because a table is released only at rest. Each action is attempted regardless of the
    earlier ones, within its time limit, and a second time if it failed, through a reopened port if the port
    was lost or does not respond. No action raises. ``release_table`` opens the servos too, which is not
    needed before the first step. ``only`` selects actions by their ``what``, by default all. ``meanwhile`` is
    called repeatedly while waiting. ``chamber_off``: also switch off the chamber, as for one that does not
    control its air.
    """
    steps = _steps(station, instruments, release_table, chamber_off)
    selected = (step for step in steps if only is None or step.action.what in only)
    return [_perform(step, instruments, meanwhile) for step in selected]


def repeat(
    station: Station, instruments: Outputs, failed: Collection[SafeAction], meanwhile: Callable[[], object]
) -> list[SafeAction]:
    """Repeat failed actions; see :func:`make_safe`."""
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
    """Move the chamber's set point to its safe value if its controller does not ramp; may take an hour.

    Yields the actions performed since the last yield; the caller waits ``RAMP_PERIOD_S`` each time. They are
    the action of the set point, which counts as failed until the ramp has ended at its value, and repeats of
    those in ``actions`` that had failed. Yields nothing if there is no ramp. ``meanwhile`` is called during a
    long exchange.
    """
    if not instruments.is_ramping:
        return
    clock, safe_c = instruments.clock, station.file.safe_state.chamber_c
    steps = _steps(station, instruments, release_table=False)
    (chamber,) = (step for step in steps if step.action.part in _CHAMBER)
    failed = [action for action in actions if action.problem and action.part is not chamber.action.part]

    def check_end() -> None:
        set_point_c = instruments.chamber.set_point_c()
        if safe_c is None or abs(set_point_c - safe_c) > _RESOLUTION_C:
            raise RefusedError(CHAMBER, f"its set point is {set_point_c:g} degC instead. Check its panel.")

    ramp_action, repeated = chamber.action, list[SafeAction]()
    answered_s = repeated_s = clock.now()
    while instruments.is_ramping and clock.now() - answered_s < _SILENCE_S:
        yield [replace(ramp_action, problem=ramp_action.problem or "is still being ramped"), *repeated]
        ramp_step = replace(chamber, apply=instruments.advance_ramp)
        ramp_action, repeated = _perform(ramp_step, instruments, meanwhile), []
        if not ramp_action.problem:
            answered_s = clock.now()
        if failed and clock.now() - repeated_s >= _REPEAT_PERIOD_S:
            repeated = repeat(station, instruments, failed, meanwhile)
            failed = [action for action in repeated if action.problem]
            repeated_s = clock.now()
    if not ramp_action.problem:
        end_action = _perform(replace(chamber, apply=check_end), instruments, meanwhile)
        # A refused ramp is not attempted again, and its reason is more specific.
        ramp_action = replace(
            end_action, problem=end_action.problem and (ramp_action.first_problem or end_action.problem)
        )
    yield [ramp_action, *repeated]


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
    """Command a set point; a chamber that refuses it is switched off and reported as not safe."""
    try:
        chamber.set_temperature(temperature_c, ramp_c_per_min)
    except RefusedError as error:
        with suppress(RefusedError):  # a running profile may switch it on again
            chamber.switch(False)
        raise RefusedError(CHAMBER, f"{_REFUSED}: {error.message}") from error


def _perform(step: _Step, instruments: Outputs, meanwhile: Callable[[], object]) -> SafeAction:
    first_error = _error_of(step, instruments, step.apply, meanwhile)
    if first_error is None:
        return step.action

    def repeat_step() -> None:
        if isinstance(first_error, ConnectionFailedError):
            instruments.reopen(step.action.instrument)
        step.apply()

    second_error = _error_of(step, instruments, repeat_step, meanwhile)
    return replace(
        step.action,
        problem="" if second_error is None else _text(second_error),
        first_problem=_text(first_error),
    )


def _error_of(
    step: _Step, instruments: Outputs, apply: Callable[[], object], meanwhile: Callable[[], object]
) -> Exception | None:
    try:
        call = LimitedCall(instruments.clock, step.limit_s, step.action.instrument, apply)
        call.result(meanwhile=meanwhile)
    except Exception as error:  # noqa: BLE001 - the next action must be attempted in any case
        return error
    return None


def _text(error: Exception) -> str:
    if isinstance(error, InstrumentError):
        return str(error)
    return f"unexpected {type(error).__name__}: {error}"
