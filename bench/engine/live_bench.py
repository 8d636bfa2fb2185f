"""The opened instruments on the run's clock: polled, recorded, watched by the interlocks."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from gyrobench.bench.engine.bench_state import BenchState, Readings
from gyrobench.bench.engine.interlocks.watch import SILENT_INSTRUMENT, InterlockWatch, Trip
from gyrobench.bench.engine.live_unit import BUS_SILENCE_S, LiveUnit
from gyrobench.bench.foundations.clock import Clock
from gyrobench.bench.foundations.errors import ConnectionFailedError, FaultError, InstrumentError, ReplyError
from gyrobench.bench.foundations.text import capitalised
from gyrobench.bench.navigation.table_axes import Angles
from gyrobench.bench.station.instruments import CHAMBER, RATE_TABLE, Instruments
from gyrobench.bench.station.interlocks import CHAMBER_OUT_OF_CONTROL
from gyrobench.bench.station.safe_state import SafeAction, make_safe, repeat
from gyrobench.bench.station.station import Station
from gyrobench.drivers.chamber import ChamberReading
from gyrobench.drivers.ins.can_bus import INSTRUMENT
from gyrobench.drivers.rate_table import TableReading

if TYPE_CHECKING:
    from gyrobench.bench.runs.can_log import CanLog
    from gyrobench.bench.runs.telemetry import Telemetry

#: How often an instrument that does not answer at the start is asked again, and the pause between.
_FIRST_TRIES, _FIRST_PAUSE_S = 5, 2.0
#: Minimum time between reports of frames that were lost or invalid.
_LOSS_PERIOD_S = 10.0
#: Pauses between attempts to reopen a lost port: each is twice the one before, up to the maximum, and the
#: first again after some time without attempts. An adapter is often back within seconds, before the silence
#: of its instrument trips.
_FIRST_REOPEN_PAUSE_S, _MAX_REOPEN_PAUSE_S, _REOPEN_RESET_S = 0.5, 5.0, 30.0
#: Attempts to reach an instrument that take longer are followed by a pause; a reopened port that answers
#: takes 1 s, in which it has to be silent.
_BRIEF_S = 2.5
#: Period at which a safe action that failed is repeated.
_REPEAT_PERIOD_S = 5.0
#: What to do about errors on a CAN bus.
CHECK_BUS = "Check bit rate, termination and cable."
#: The chamber's air counts as at its set point within this difference.
_REACHED_C = 2.0

_T = TypeVar("_T")
_ReadingT = TypeVar("_ReadingT", TableReading, ChamberReading)


class LiveBench:
    """The opened instruments of a bench, polled at every tick.

    An instrument that does not answer a poll is polled again at the next tick; its last answer ages
    meanwhile, until its interlock trips. ``recordings`` are the CAN log and telemetry of each unit, in the
    order of ``instruments``; ``telemetry`` is that of the whole bench if it has several units. Both are empty
    for a bench that is not recorded. ``report_failure`` is called with the instrument's name and the error of
    a failed exchange, or None when the instrument answers again.
    """

    def __init__(
        self,
        station: Station,
        instruments: Instruments,
        clock: Clock,
        recordings: Sequence[tuple[CanLog | None, Telemetry | None]],
        report_failure: Callable[[str, InstrumentError | None], None],
        telemetry: Telemetry | None = None,
    ) -> None:
        self.station = station
        self.instruments = instruments
        self.clock = clock
        self.readings: Readings  #: newest answers; set by start()
        self.state = BenchState(station)
        self.lateness = TickLateness()
        self._telemetry = telemetry
        self._report_failure = report_failure
        self._watch = InterlockWatch(station, clock, {INSTRUMENT, *instruments.absent})
        self._failing: list[str] = []
        self._causes: dict[str, str] = {}  # why the port of a failing instrument could not be reopened
        self._next_reopen_s, self._reopen_pause_s = -math.inf, _FIRST_REOPEN_PAUSE_S
        self._next_try_s: dict[str, float] = {}  # of table and chamber while they do not answer
        self._next_loss_s = 0.0
        self._next_reading_s = 0.0
        #: Safe actions that failed and have not succeeded since, by what they do.
        self.failed_safe_actions: dict[str, SafeAction] = {}
        self._next_safe_s = 0.0
        #: The units that are measured, in the order of the station file.
        self.units = [
            LiveUnit(self, each, instruments.units[each.instrument], instruments.absent, *recording)
            for each, recording in zip(
                (each for each in station.units if each.instrument in instruments.units),
                recordings or [(None, None)] * len(instruments.units),
                strict=True,
            )
        ]
        self._all_units = tuple(self.units)  # including dropped ones

    def start(self) -> None:
        """Read all instruments for the first time.

        Raises InstrumentError if one does not answer after several attempts.
        """
        table = self._query_at_start(self.instruments.table.read)
        chamber = self._query_at_start(self.instruments.chamber.read)
        statuses, now_s = [unit.status() for unit in self.units], self.clock.now()
        self.readings = Readings(table, now_s, chamber, now_s, statuses[0], now_s)
        self._next_reading_s = now_s + self.station.file.instruments_period_s
        self._watch.observe(self.readings)
        for unit, ins in zip(self.units, statuses, strict=True):
            unit.begin(replace(self.readings, ins=ins))

    def _query_at_start(self, ask: Callable[[], _T]) -> _T:
        for _ in range(_FIRST_TRIES - 1):
            try:
                return ask()
            except FaultError:
                raise
            except InstrumentError as error:
                self.handle_failure(error)
                self.clock.sleep(_FIRST_PAUSE_S)
        return ask()

    def tick(self) -> None:
        """Wait for the next tick, then poll the instruments that are due."""
        tick_s, clock = self.station.file.tick_s, self.clock
        next_tick_s = tick_s * (math.floor(clock.now() / tick_s + 1e-9) + 1)
        for unit in self.units:
            if not unit.ins.keeps_frames:
                break
        else:
            clock.sleep_until(next_tick_s)
        while (now_s := clock.now()) < next_tick_s:
            clock.sleep_until(min(next_tick_s, now_s + self.station.file.poll_period_s))
            self.poll_units()
        for unit in self.units:
            unit.write_waiting(now_s)
        if self.instruments.is_ramping and CHAMBER not in self._failing:
            self.query(CHAMBER, self.instruments.advance_ramp)
        self.lateness.add(next_tick_s, now_s, tick_s)
        if self._failing or self.instruments.reopenings:
            self._reopen()
        if next_tick_s >= self._next_reading_s - 1e-6:
            self.read_instruments()
            self._next_reading_s = next_tick_s + self.station.file.instruments_period_s
        elif self._failing:
            set_aside = {each.name for each in self.units if each.set_aside_reason}
            if not set_aside.issuperset(self._failing):
                self.read_instruments()

    def trips(self) -> list[Trip]:
        """Return the interlocks that are tripped.

        If readings are overdue, because this process was stopped or an exchange blocked it, an instrument
        that answered its last poll counts as silent only if it does not answer another one.
        """
        trips = self.present_trips()
        is_overdue = self.clock.now() > self._next_reading_s + self.station.file.tick_s
        if trips and is_overdue and all(self._answered_last_poll(trip) for trip in trips):
            self.read_instruments()
            trips = self.present_trips()
        return trips

    def present_trips(self) -> list[Trip]:
        """Return the interlocks that are tripped by the readings so far; exchanges nothing."""
        trips = self._watch.trips(self.clock.now(), self.state.expected)
        for unit in self.units:
            trips += [] if unit.set_aside_reason else unit.trips()
        return [self._with_cause(trip) for trip in trips]

    def _with_cause(self, trip: Trip) -> Trip:
        """Return a trip because of silence with the present problem of port or bus, if any, as its advice."""
        instrument = f"{SILENT_INSTRUMENT.get(trip.name, '')} {trip.unit}".rstrip()
        ins = self.instruments.units.get(instrument)
        cause = self._causes.get(instrument)
        if cause is None and ins is not None and (errors := ins.describe_bus_errors()):
            cause = f"{capitalised(errors)}. {CHECK_BUS}"
        if cause is None:
            return trip
        return replace(trip, findings=tuple(each._replace(advice=cause) for each in trip.findings))

    def _answered_last_poll(self, silence: Trip) -> bool:
        """Whether a trip is the silence of an instrument whose last exchange did not fail."""
        kind = SILENT_INSTRUMENT.get(silence.name)
        return kind is not None and not any(name.startswith(kind) for name in self._failing)

    def untripped_for_s(self, trips: Iterable[Trip]) -> float:
        """Time for which none of these interlocks has been tripped, s; zero while one is."""
        watches: list[InterlockWatch | LiveUnit] = [self._watch, *self.units]
        since_s = [each.untripped_since_s(trip.name) for trip in trips for each in watches]
        now_s = self.clock.now()
        return min((0.0 if each_s is None else now_s - each_s for each_s in since_s), default=math.inf)

    def poll_units(self) -> None:
        """Receive the frames that have arrived."""
        for unit in self.units:
            unit.poll()

    def leave_out(self, unit: LiveUnit) -> None:
        """Stop measuring a dropped unit, and close its bus."""
        unit.end_capture()
        self.instruments.end_reopening(unit.name)
        unit.ins.close()
        self.units = [each for each in self.units if each is not unit]
        self._failing = [name for name in self._failing if name != unit.name]

    def units_switched_off(self) -> None:
        """Record that the supplies of all units, including dropped ones, were switched off."""
        for unit in self._all_units:
            unit.state.switched_off()

    def neighbours_on(self, unit: LiveUnit) -> int | None:
        """Number of other units that are on, as far as is known; None on a bench with one unit."""
        if len(self.station.units) == 1:
            return None
        return sum(other.is_on for other in self._all_units if other is not unit)

    def reopen(self, instrument: str) -> None:
        """Reopen the port of an instrument, or begin to (:meth:`is_reopening`); a failure is reported."""
        if self.instruments.reopens_in_thread:
            self._try_reopen(instrument)
        else:
            self.query(instrument, lambda: self.instruments.reopen(instrument))

    def is_reopening(self, instrument: str) -> bool:
        """Whether threads try to reach an instrument until its port is open; ticks take their results."""
        waits = self.instruments.reopens_in_thread and not self._may_try(instrument)
        return waits or instrument in self.instruments.reopenings

    def query(self, instrument: str, ask: Callable[[], _T]) -> _T | None:
        """Return an instrument's answer, or None after a failure, which is reported.

        None also while a thread opens its port.
        """
        if instrument in self.instruments.reopenings:
            return None
        try:
            answer = ask()
        except FaultError:
            return None  # it answers; the interlocks evaluate its reported fault
        except InstrumentError as error:
            self.handle_failure(error)
            return None
        if instrument in self._failing and not self._sends_nothing(instrument):
            self._failing.remove(instrument)
            self._causes.pop(instrument, None)
            self._report_failure(instrument, None)
        return answer

    def _sends_nothing(self, instrument: str) -> bool:
        """Whether this is a silent INS: a poll without an error is then no answer."""
        return any(unit.is_silent for unit in self.units if unit.name == instrument)

    def handle_failure(self, error: InstrumentError) -> None:
        """Report a failed exchange; the instrument is reopened until it answers."""
        ins = self.instruments.units.get(error.instrument)
        if isinstance(error, ReplyError) and ins is not None and ins.status().age_s <= BUS_SILENCE_S:
            # Not reopened: a bus that receives frames would lose more of them.
            if self.clock.now() >= self._next_loss_s:
                self._next_loss_s = self.clock.now() + _LOSS_PERIOD_S
                self._report_failure(error.instrument, error)
                self._report_failure(error.instrument, None)
            return
        if error.instrument not in self._failing:
            self._failing.append(error.instrument)
            self._report_failure(error.instrument, error)

    def _reopen(self) -> None:
        """Reopen an instrument that does not answer, as an unplugged adapter requires."""
        reopenings = self.instruments.reopenings
        for instrument in sorted(reopenings):
            self._try_reopen(instrument)
            if instrument not in reopenings:  # it has the time of a pause to answer
                self._next_reopen_s = self.clock.now() + self._reopen_pause_s
        waiting = [each for each in self._failing if each not in reopenings]
        if not waiting:
            return
        begin_s, instrument = self.clock.now(), waiting[0]
        late_s = begin_s - self._next_reopen_s
        if late_s < 0.0 or not (self.instruments.reopens_in_thread or self._may_try(instrument)):
            return
        is_first = late_s > _REOPEN_RESET_S
        pause_s = _FIRST_REOPEN_PAUSE_S if is_first else min(2.0 * self._reopen_pause_s, _MAX_REOPEN_PAUSE_S)
        self._next_reopen_s, self._reopen_pause_s = begin_s + pause_s, pause_s
        self._failing.remove(instrument)
        self._failing.append(instrument)  # one at a time: it may take long
        self._try_reopen(instrument)

    def _try_reopen(self, instrument: str) -> None:
        """Reopen an instrument, or begin to, or take the result; a failure is reported once."""
        begin_s = self.clock.now()
        is_open = False
        try:
            is_open = self.instruments.try_reopen(instrument)
            if is_open:
                self._causes.pop(instrument, None)
        except ConnectionFailedError as error:
            self._causes[instrument] = capitalised(error.message)
            self.handle_failure(error)
        self._pause_tries(instrument, begin_s, is_open)

    def _may_try(self, instrument: str) -> bool:
        """Whether an instrument that does not answer may block the ticks again."""
        return instrument not in self._failing or self.clock.now() >= self._next_try_s.get(instrument, 0.0)

    def _pause_tries(self, instrument: str, begin_s: float, is_open: bool = False) -> None:
        """Leave an instrument alone until a thread has reached it.

        Without threads for as long as an attempt took: it blocks at most half of the time.
        """
        took_s = self.clock.now() - begin_s
        if self.instruments.reopens_in_thread:
            self._next_try_s[instrument] = begin_s if is_open else math.inf
        else:
            self._next_try_s[instrument] = begin_s + (2.0 * took_s if took_s > _BRIEF_S else took_s)

    def _try_query(self, instrument: str, ask: Callable[[], _T]) -> _T | None:
        """Query table or chamber, which takes long if it does not answer."""
        if not self._may_try(instrument):
            return None
        begin_s = self.clock.now()
        answer = self.query(instrument, ask)
        if answer is None:
            self._pause_tries(instrument, begin_s)
        return answer

    def read_instruments(self) -> None:
        """Read table, chamber and INS, and record the readings in the telemetry."""
        self._next_reading_s = self.clock.now() + self.station.file.instruments_period_s
        statuses = [unit.status() for unit in self.units]
        changes: dict[str, Any] = {"ins": statuses[0], "polled_s": (polled_s := self.clock.now())}
        table = self._query_plausible(RATE_TABLE, lambda: (self.instruments.table.read(), self.clock.now()))
        if table is not None:
            changes["table"], changes["table_s"] = table
        if (chamber := self._query_plausible(CHAMBER, self._chamber_reading)) is not None:
            changes["chamber"], changes["chamber_s"] = chamber
        self.readings = readings = replace(self.readings, **changes)
        self._watch.observe(readings)
        row = self._telemetry_row(readings, polled_s)
        if self._telemetry:
            self._telemetry.add(row)
        for unit, ins in zip(self.units, statuses, strict=True):
            unit.observe(readings if ins is readings.ins else replace(readings, ins=ins), row)

    def _chamber_reading(self) -> tuple[ChamberReading, float]:
        """Return a reading and its time; if the sensor is faulty, the last one with this alarm."""
        try:
            return self.instruments.chamber.read(), self.clock.now()
        except FaultError as error:
            return replace(self.readings.chamber, alarms=(error.message,)), self.readings.chamber_s

    def _query_plausible(
        self, instrument: str, ask: Callable[[], tuple[_ReadingT, float]]
    ) -> tuple[_ReadingT, float] | None:
        """Return a reading, read again if it is implausible; None after a failure.

        Lines of text have no checksum: a damaged byte looks like a fault or another value, and the trip that
        it causes may need the operator.
        """
        answer = self._try_query(instrument, ask)
        if answer is None or answer[0] in (self.readings.table, self.readings.chamber):
            return answer  # a reading received twice is not damaged
        is_implausible = self._watch.is_implausible(answer[0], self.state.expected)
        return self.query(instrument, ask) if is_implausible else answer

    def read_table(self) -> None:
        """Read only the table, between the regular readings."""
        reading = self._try_query(RATE_TABLE, lambda: self.instruments.table.read())
        if reading is not None:
            self.readings = replace(self.readings, table=reading, table_s=self.clock.now())

    def table_angles(self) -> Angles:
        """Return the outer and inner angles as last read, deg."""
        return self.station.table_axes_of(self.readings.table.position_deg)

    @property
    def silent(self) -> tuple[str, ...]:
        """Instruments whose last exchange failed."""
        return tuple(self._failing)

    def make_safe(
        self, release_table: bool = True, meanwhile: Callable[[], object] = lambda: None
    ) -> list[SafeAction]:
        """Bring all outputs to their safe values, calling ``meanwhile`` during the waits; never raises.

        A chamber that does not control its air, according to an interlock, is switched off too.
        """
        chamber_off = any(trip.name in CHAMBER_OUT_OF_CONTROL for trip in self.trips())
        actions = make_safe(
            self.station, self.instruments, release_table, meanwhile=meanwhile, chamber_off=chamber_off
        )
        self.failed_safe_actions = {}
        self._record_safe_actions(actions)
        return actions

    def repeat_safe_actions(self, meanwhile: Callable[[], object]) -> list[SafeAction]:
        """Repeat the safe actions that failed and whose instrument answers, every few seconds."""
        due = [
            action
            for action in self.failed_safe_actions.values()
            if action.instrument not in self._failing and self.clock.now() >= self._next_safe_s
        ]
        if not due:
            return []
        actions = repeat(self.station, self.instruments, due, meanwhile)
        self._record_safe_actions(actions)
        return actions

    def _record_safe_actions(self, actions: list[SafeAction]) -> None:
        self._next_safe_s = self.clock.now() + _REPEAT_PERIOD_S
        self.state.made_safe(actions)
        for unit in self.units:
            unit.state.made_safe(actions)
        for action in actions:
            self.failed_safe_actions.pop(action.what, None)
            if action.problem:
                self.failed_safe_actions[action.what] = action

    def check_set_point_reached(self) -> None:
        """Record that the chamber's air has reached the set point, so that it is expected to stay there."""
        set_c, air_c = self.state.commanded_c, self.readings.chamber.temperature_c
        if set_c is not None and abs(air_c - set_c) <= _REACHED_C:
            self.state.chamber_set_point_reached()

    def prepare_table(self) -> None:
        """Set the motion limits, clear latched faults and close the servos, unless that is done already.

        Raises InstrumentError if the table does not answer, or a servo does not close.
        """
        if self.state.expected.table_prepared:
            return
        table, limits = self.instruments.table, self.station.file.rate_table.limits
        table.set_limits(limits.rate_dps, limits.acceleration_dps2, limits.jerk_dps3)
        table.prepare()
        self.state.table_prepared()

    def _telemetry_row(self, readings: Readings, polled_s: float) -> dict[str, float]:
        """Known values of the bench at this moment, by the columns of its telemetry."""
        position, set_c = self.state.run_position, self.state.commanded_c
        row = {"time_s": polled_s, "step": float(position.step), "dwell": float(position.dwell)}
        if set_c is not None:
            row["chamber_set_c"] = set_c
        if readings.chamber_s >= polled_s:
            row["chamber_c"] = readings.chamber.temperature_c
        if readings.table_s >= polled_s:
            row["outer_deg"], row["inner_deg"] = self.table_angles()
            row["outer_rate_dps"], row["inner_rate_dps"] = self.station.table_axes_of(readings.table.rate_dps)
        return row


class TickLateness:
    """How late the ticks of a run came, counted to 10 us."""

    def __init__(self) -> None:
        self._counts: Counter[float] = Counter()  # ticks by their lateness, s
        self._max_s = 0.0
        self._missed = 0
        self._last_s = math.nan

    def add(self, due_s: float, now_s: float, period_s: float) -> None:
        """Count the tick that was due at ``due_s`` and came at ``now_s``."""
        late_s = now_s - due_s
        self._counts[round(late_s, 5) if late_s > 0.0 else 0.0] += 1
        if late_s > self._max_s:
            self._max_s = late_s
        if due_s - self._last_s > 1.5 * period_s:
            self._missed += round((due_s - self._last_s) / period_s) - 1
        self._last_s = due_s

    def summary(self) -> dict[str, float | int]:
        """Return the numbers of ticks and of ticks missed because one took too long, and the lateness, s."""
        late_s, counts = np.array(sorted(self._counts.items()) or [(0.0, 0)]).T
        ranks = np.searchsorted(np.cumsum(counts), np.array([0.5, 0.99]) * counts.sum())
        median_s, late_99_percent_s = late_s[ranks].tolist()
        return {
            "count": int(counts.sum()),
            "missed": self._missed,
            "late_median_s": median_s,
            "late_99_percent_s": late_99_percent_s,
            "late_max_s": round(self._max_s, 6),
        }
