"""The safe state, in which the bench is left at any end of a run."""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass

from gyrobench.bench.foundations.errors import ConnectionFailedError, InstrumentError
from gyrobench.bench.station.instruments import CHAMBER, RATE_TABLE, Outputs, within
from gyrobench.bench.station.station import Station

#: Time limits, far beyond what healthy instruments need. A release waits for rest.
_EXCHANGE_TIME_S = 20.0
_RELEASE_TIME_S = 60.0


@dataclass(frozen=True)
class SafeAction:
    """One action on the way to the safe state, why it failed, and why its first attempt did; empty if not."""

    what: str
    problem: str = ""
    first_problem: str = ""

    @property
    def text(self) -> str:
        """The action, or that it failed and why."""
        return f"FAILED: {self.what}: {self.problem}" if self.problem else self.what


@dataclass(frozen=True)
class _Step:
    what: str
    instrument: str
    limit_s: float
    apply: Callable[[], None]


def make_safe(
    station: Station,
    instruments: Outputs,
    release_table: bool = True,
    only: Collection[str] | None = None,
    meanwhile: Callable[[], object] = lambda: None,
) -> list[SafeAction]:
    """Stop the table, bring chamber and unit to their safe state, release the table.

    In this order, because a table is released only at rest. Each action is attempted regardless of the ones
    before, within its time limit, and a second time if it failed, through a reopened port if the port was
    lost or does not respond. None raises. ``release_table`` opens the servos too, which is not needed before
    the first step. ``only`` has the ``what`` of the actions to take, by default all; ``meanwhile`` is called
    repeatedly while waiting.
    """
    steps = _steps(station, instruments, release_table)
    return [_taken(step, instruments, meanwhile) for step in steps if only is None or step.what in only]


def _steps(station: Station, instruments: Outputs, release_table: bool) -> list[_Step]:
    safe = station.file.safe_state
    steps = [_Step("rate table stopped", RATE_TABLE, _EXCHANGE_TIME_S, lambda: instruments.table.stop())]

    def chamber(what: str, apply: Callable[[], None]) -> None:
        steps.append(_Step(what, CHAMBER, _EXCHANGE_TIME_S, apply))

    if safe.chamber_c is None:
        chamber("chamber switched off", lambda: instruments.chamber.switch(False))
    else:
        safe_c = safe.chamber_c
        ramp = station.file.chamber.limits.ramp_c_per_min
        chamber(
            f"chamber's set point at {safe_c:g} degC",
            lambda: instruments.chamber.set_temperature(safe_c, ramp),
        )
    if safe.unit == "off":
        chamber("INS switched off", lambda: instruments.power_unit(False))
    else:
        chamber("INS left as it is", lambda: None)
    if release_table:
        steps.append(
            _Step(
                "rate table's interlocks opened",
                RATE_TABLE,
                _RELEASE_TIME_S,
                lambda: instruments.table.release(),
            )
        )
    return steps


def _taken(step: _Step, instruments: Outputs, meanwhile: Callable[[], object]) -> SafeAction:
    first = _problem(step, instruments, step.apply, meanwhile)
    if first is None:
        return SafeAction(step.what)

    def again() -> None:
        if isinstance(first, ConnectionFailedError):
            instruments.reopen(step.instrument)
        step.apply()

    second = _problem(step, instruments, again, meanwhile)
    return SafeAction(step.what, "" if second is None else _text(second), _text(first))


def _problem(
    step: _Step, instruments: Outputs, apply: Callable[[], None], meanwhile: Callable[[], object]
) -> Exception | None:
    try:
        within(instruments.clock, step.limit_s, step.instrument, apply, meanwhile=meanwhile)
    except Exception as error:  # noqa: BLE001 - nothing may keep the next action from being tried
        return error
    return None


def _text(error: Exception) -> str:
    if isinstance(error, InstrumentError):
        return str(error)
    return f"unexpected {type(error).__name__}: {error}"
