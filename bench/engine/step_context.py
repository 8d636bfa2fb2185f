"""What the actions of the steps share: pauses, exchanges that are repeated, and commands to all units."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator, Sequence
from typing import TypeVar

from gyrobench.bench.engine.measured_unit import MeasuredUnit
from gyrobench.bench.engine.run_context import RunContext
from gyrobench.bench.engine.units import Units
from gyrobench.bench.foundations.errors import ConnectionFailedError, FaultError, InstrumentError
from gyrobench.bench.navigation.table_axes import TurnOrMove
from gyrobench.bench.station.instruments import CHAMBER, RATE_TABLE
from gyrobench.drivers.ins.can_ins import POLL_PERIOD_S

#: What an action is: it yields once a tick.
Ticks = Iterator[None]
_T = TypeVar("_T")

#: Pause before a failed exchange is tried again.
_RETRY_PAUSE_S = 2.0


class StepContext:
    """The run, its bench and its units, as the actions use them."""

    def __init__(self, run: RunContext, units: Units) -> None:
        self.run = run
        self.bench = run.bench
        self.units = units
        self.retries = 0  #: How often a failed exchange of the step in progress is repeated.
        self.continuing_answer = ""  #: Answer to the open question with which the run continues.
        self.answer_by_command: str | None = None  #: Given by the command `continue`.
        #: Turns until the next position: the table goes to angles from which they stay within its limits.
        self.next_turns_deg: Sequence[TurnOrMove] = ()

    def pause(self, duration_s: float) -> Ticks:
        """Wait; a duration of zero or less takes no tick."""
        end_s = self.bench.clock.now() + duration_s
        while self.bench.clock.now() < end_s - 1e-6:
            yield

    def with_retries(self, exchange: Callable[[], _T]) -> Generator[None, None, _T]:
        """Return the result of an exchange with an instrument, which is repeated as often as the step allows.

        Every command of the drivers may be repeated: it sets a final state, not a change.
        """
        instruments = {RATE_TABLE, CHAMBER}
        for remaining_tries in range(self.retries, -1, -1):
            while any(map(self.bench.is_reopening, instruments)):  # an exchange would block the ticks
                yield
            try:
                return exchange()
            except FaultError:
                raise
            except InstrumentError as error:
                if not remaining_tries:
                    raise
                yield from self._prepare_retry([error])
                instruments.add(error.instrument)
        raise AssertionError("the last try returns or raises")

    def command_all(self, command: Callable[[MeasuredUnit], Ticks | None]) -> Ticks:
        """Command all units at once and wait for their confirmations.

        ``command`` returns None if none is needed. A failed command is repeated as often as the step allows;
        then its unit is dropped, or the error raised. A unit that is dropped or set aside between two tries
        is left out.
        """
        waiting = {unit: ticks for unit in self.units.measuring if (ticks := command(unit)) is not None}
        for remaining_tries in range(self.retries, -1, -1):
            yield from self._await_buses(waiting)
            retried = []
            for unit, error in self._exchange_all(waiting).items():
                if remaining_tries and not isinstance(error, FaultError):
                    retried.append(error)
                    waiting[unit] = command(unit) or iter(())
                else:
                    self.units.fail(unit, error)
            if waiting:
                yield from self._prepare_retry(retried)

    def read_table(self) -> Ticks:
        """Read the table; repeated at each tick until it answers."""
        begin_s = self.bench.clock.now()
        self.bench.read_table()
        while self.bench.readings.table_s < begin_s:
            yield
            self.bench.read_table()

    def _exchange_all(self, waiting: dict[MeasuredUnit, Ticks]) -> dict[MeasuredUnit, InstrumentError]:
        """Poll until each command is confirmed or has failed; empties ``waiting`` and returns the errors."""
        errors: dict[MeasuredUnit, InstrumentError] = {}
        while waiting:
            for unit, ticks in list(waiting.items()):
                try:
                    next(ticks)
                except StopIteration:
                    del waiting[unit]
                except InstrumentError as error:
                    del waiting[unit]
                    errors[unit] = error
            if waiting:
                self.bench.clock.sleep(POLL_PERIOD_S)
        return errors

    def _prepare_retry(self, errors: Sequence[InstrumentError]) -> Ticks:
        """Record failed exchanges, reopen lost ports, and pause."""
        for error in errors:
            self.run.record_retry(error)
            if isinstance(error, ConnectionFailedError):
                self.bench.reopen(error.instrument)
        yield from self.pause(_RETRY_PAUSE_S)

    def _await_buses(self, waiting: dict[MeasuredUnit, Ticks]) -> Ticks:
        """Wait until no thread opens the bus of a waiting unit; removes units that are measured no more."""
        while True:
            measuring = self.units.measuring
            for unit in [each for each in waiting if each not in measuring]:
                del waiting[unit]
            if not any(self.bench.is_reopening(unit.live.name) for unit in waiting):
                return
            yield
