"""The bench while a run lasts: instruments, time, and what was read last."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import Protocol, TypeVar

import can

from gyrobench.bench.engine.capture import Capture
from gyrobench.bench.engine.interlocks import Expected, InterlockWatch, Trip
from gyrobench.bench.engine.readings import Readings
from gyrobench.bench.engine.tick_lateness import TickLateness
from gyrobench.bench.foundations.clock import Clock
from gyrobench.bench.foundations.errors import (
    ConnectionFailedError,
    FaultError,
    InstrumentError,
    NoReplyError,
)
from gyrobench.bench.navigation.table_axes import Angles
from gyrobench.bench.station.instruments import Instruments
from gyrobench.bench.station.station import Station
from gyrobench.drivers.ins.can_bus import FrameBlock
from gyrobench.drivers.ins.readout import InsMode

#: How often an instrument that does not answer at the start is asked again, and how long in between.
_FIRST_ASKS, _FIRST_PAUSE_S = 5, 2.0
#: An INS whose count of epochs is off by more than this has started anew, or lost its count.
_COUNTS_ON_S = 3.0
#: A bus on which nothing was heard for so long may be one that went away without a word.
_DEAF_S = 4.0
#: A port that went away is opened anew this often.
_REOPEN_EVERY_S = 5.0

T = TypeVar("T")


class FrameLog(Protocol):
    """Where received frames go, as to a :class:`~gyrobench.bench.runs.can_log.CanLog`."""

    @property
    def next_part(self) -> int:
        """Number of the part that the next frame begins, after :meth:`cut`."""
        ...

    def write(self, messages: Iterable[can.Message]) -> None:
        """Add frames."""
        ...

    def cut(self) -> None:
        """End the present part."""
        ...


class ReadingsLog(Protocol):
    """Where readings go, as to a :class:`~gyrobench.bench.runs.telemetry.Telemetry`."""

    def add(self, row: tuple[float, ...]) -> None:
        """Add the values of one moment."""
        ...

    def flush(self) -> None:
        """Bring them to the disk."""
        ...


class LiveBench:
    """The opened instruments on the run's clock, polled at every tick.

    An instrument that does not answer when it is polled is asked again at the next tick; its last
    answer grows old meanwhile, until its interlock trips.

    Parameters
    ----------
    station, instruments
        The bench and its opened instruments.
    clock : Clock
        The run's clock.
    can_log, telemetry
        Where everything received and read goes.
    tell_failure : callable
        Takes the error of an exchange that failed, or None when the instrument of that name answers again.

    Attributes
    ----------
    readings : Readings
        Newest answers; set by :meth:`start`.
    expected : Expected
        What the instruments have been told, for the interlocks.
    capture : Capture or None
        The frames of the dwell under way.
    has_unit_restarted : bool
        Whether the INS was seen to start anew by itself since it was switched on.
    lateness : TickLateness
        How late ticks were.
    step, dwell : int
        Where the run is, for the telemetry; 0 where it is nowhere.
    """

    def __init__(
        self,
        station: Station,
        instruments: Instruments,
        clock: Clock,
        can_log: FrameLog,
        telemetry: ReadingsLog,
        tell_failure: Callable[[str, InstrumentError | None], None],
    ) -> None:
        self.station = station
        self.instruments = instruments
        self.clock = clock
        self.readings: Readings
        self.expected = Expected()
        self.capture: Capture | None = None
        self.has_unit_restarted = False
        self.lateness = TickLateness()
        self.step = 0
        self.dwell = 0
        self._can_log = can_log
        self._telemetry = telemetry
        self._tell_failure = tell_failure
        self._watch = InterlockWatch(station, clock)
        self._failing: list[str] = []
        self._next_reopen_s = 0.0
        self._next_reading_s = 0.0
        self._mode = InsMode.UNKNOWN
        self._epochs: tuple[float, int] | None = None
        instruments.ins.on_frames = self._received

    def start(self) -> None:
        """Ask all instruments for the first time.

        Raises
        ------
        InstrumentError
            One does not answer, although it was asked several times.
        """
        table = self._insist(self.instruments.table.read)
        faults = self._insist(self.instruments.table.faults)
        chamber = self._insist(self.instruments.chamber.read)
        alarms = self._insist(self.instruments.chamber.alarms)
        self.poll_ins()
        now_s = self.clock.now()
        self.readings = Readings(
            table, now_s, tuple(faults), chamber, now_s, tuple(alarms), self.instruments.ins.status(), now_s
        )
        self._next_reading_s = now_s + self.station.instruments_period_s
        self._watch.observe(self.readings)

    def _insist(self, ask: Callable[[], T]) -> T:
        for _ in range(_FIRST_ASKS - 1):
            try:
                return ask()
            except FaultError:
                raise
            except InstrumentError as error:
                self._failed(error)
                self.clock.sleep(_FIRST_PAUSE_S)
        return ask()

    def tick(self) -> None:
        """Wait for the next tick, then poll whatever is due."""
        tick_s = self.station.tick_s
        next_tick_s = tick_s * (math.floor(self.clock.now() / tick_s + 1e-9) + 1)
        while (now_s := self.clock.now()) < next_tick_s:
            self.clock.sleep_until(min(next_tick_s, now_s + self.station.poll_period_s))
            self.poll_ins()
        self.lateness.add(next_tick_s, now_s, tick_s)
        if self._failing:
            self._reopen()
        if self._failing or self.clock.now() >= self._next_reading_s - 1e-6:
            self.read_instruments()

    def trips(self) -> list[Trip]:
        """Interlocks that are tripped now."""
        return self._watch.trips(self.clock.now(), self.expected)

    def good_for_s(self, trips: Iterable[Trip]) -> float:
        """How long all of these interlocks have been good; zero if one is not."""
        since_s = [self._watch.good_since_s(trip.name) for trip in trips]
        now_s = self.clock.now()
        return min((0.0 if each_s is None else now_s - each_s for each_s in since_s), default=math.inf)

    def poll_ins(self) -> None:
        """Take the frames that have arrived."""
        self._asked("INS", self.instruments.ins.poll)

    def reopen(self, instrument: str) -> None:
        """Open a port anew that went away; tells if that fails."""
        self._asked(instrument, lambda: self.instruments.reopen(instrument))

    def _asked(self, instrument: str, ask: Callable[[], T]) -> T | None:
        try:
            answer = ask()
        except FaultError:
            return None  # it answers; what it reports is looked at by the interlocks
        except InstrumentError as error:
            self._failed(error)
            return None
        if instrument in self._failing:
            self._failing.remove(instrument)
            self._tell_failure(instrument, None)
        return answer

    def _failed(self, error: InstrumentError) -> None:
        if error.instrument not in self._failing:
            self._failing.append(error.instrument)
            self._tell_failure(error.instrument, error)

    def _reopen(self) -> None:
        """Open an instrument anew that does not answer: an adapter that was unplugged needs it."""
        if self.clock.now() < self._next_reopen_s:
            return
        self._next_reopen_s = self.clock.now() + _REOPEN_EVERY_S
        instrument = self._failing[0]
        self._failing.append(self._failing.pop(0))  # one at a time: it may take long
        with contextlib.suppress(ConnectionFailedError):  # said already, and still so
            self.instruments.reopen(instrument)

    def read_instruments(self) -> None:
        """Ask table, chamber and INS, and keep what they say in the telemetry."""
        self._next_reading_s = self.clock.now() + self.station.instruments_period_s
        self.poll_ins()
        asked_s = self.clock.now()
        readings = replace(self.readings, ins=self.instruments.ins.status(), asked_s=asked_s)
        table, chamber = self.instruments.table, self.instruments.chamber
        if (faults := self._asked("rate table", table.faults)) is not None:
            readings = replace(readings, table_faults=tuple(faults))
        if (of_table := self._asked("rate table", table.read)) is not None:
            readings = replace(readings, table=of_table, table_s=self.clock.now())
        if (alarms := self._asked("chamber", chamber.alarms)) is not None:
            readings = replace(readings, chamber_alarms=tuple(alarms))
        if (of_chamber := self._asked("chamber", chamber.read)) is not None:
            readings = replace(readings, chamber=of_chamber, chamber_s=self.clock.now())
        self.readings = readings
        self._watch.observe(readings)
        self._notice_restart(readings)
        self._notice_deaf_bus(readings)
        self._telemetry.add(self._telemetry_row(readings, asked_s))
        if self.capture and of_chamber is not None:
            self.capture.chamber_c.append(of_chamber.temperature_c)
        if self.capture and of_table is not None:
            self.capture.table_deg.append(self.table_angles())

    def read_table(self) -> None:
        """Ask the table alone, between the regular readings."""
        of_table = self._asked("rate table", lambda: self.instruments.table.read())
        if of_table is not None:
            self.readings = replace(self.readings, table=of_table, table_s=self.clock.now())

    def _notice_restart(self, readings: Readings) -> None:
        """See an INS that has started anew: left its work untold, or does not count on from before."""
        mode, epochs = readings.ins.mode, readings.ins.epochs
        worked = self._mode in (InsMode.ALIGN, InsMode.NAVIGATE)
        has_left = worked and mode in (InsMode.BOOT, InsMode.STANDBY)
        if self.expected.ins_on and (has_left or self._counts_anew(readings)):
            self.has_unit_restarted = True
        if mode is not InsMode.UNKNOWN:
            self._mode = mode
        if epochs is not None:
            self._epochs = (readings.asked_s, epochs)

    def _counts_anew(self, readings: Readings) -> bool:
        """Whether the count of epochs is another than the time since the last reading leads to expect."""
        ins, before = readings.ins, self._epochs
        if ins.epochs is None or before is None:
            return False
        passed_s = readings.asked_s - before[0]
        counted_s = ((ins.epochs - before[1]) % ins.epoch_modulus) * ins.epoch_period_s
        wrap_s = ins.epoch_modulus * ins.epoch_period_s
        off_s = (counted_s - passed_s + wrap_s / 2.0) % wrap_s - wrap_s / 2.0
        return abs(off_s) > _COUNTS_ON_S + ins.age_s

    def _notice_deaf_bus(self, readings: Readings) -> None:
        """Take a bus on which the INS has fallen silent for one that may need to be opened anew."""
        if self.expected.ins_on and readings.ins.age_s > _DEAF_S:
            self._failed(NoReplyError("INS", f"has sent nothing for {readings.ins.age_s:.0f} s"))

    def begin_capture(self) -> None:
        """Keep the frames from here on for a dwell; the raw log starts a new part."""
        self.poll_ins()
        self._can_log.cut()
        self.capture = Capture(self._can_log.next_part)

    def end_capture(self) -> FrameBlock:
        """Stop keeping frames and return them; log and telemetry so far are on the disk then."""
        frames = self.capture.frames() if self.capture else FrameBlock.from_messages([])
        self.capture = None
        self._can_log.cut()
        self._telemetry.flush()
        return frames

    def captured_frames(self) -> int:
        """Number of data frames of the dwell under way that have arrived by now."""
        self.poll_ins()
        return self.capture.count() if self.capture else 0

    def table_angles(self) -> Angles:
        """Outer and inner angle as last read."""
        return self.station.table_axes_of(self.readings.table.position_deg)

    @property
    def silent(self) -> tuple[str, ...]:
        """Instruments whose last exchange failed."""
        return tuple(self._failing)

    @property
    def commanded_c(self) -> float | None:
        """Set point of the chamber; None while nobody controls it."""
        return self.expected.chamber_set_c if self.expected.chamber_on else None

    def _received(self, messages: list[can.Message]) -> None:
        self._can_log.write(messages)
        if self.capture:
            self.capture.add(messages)

    def _telemetry_row(self, readings: Readings, asked_s: float) -> tuple[float, ...]:
        """Values of this moment; those of an instrument that did not answer are not known."""
        ins = readings.ins
        angles = (*self.table_angles(), *self.station.table_axes_of(readings.table.rate_dps))
        chamber_c = readings.chamber.temperature_c
        set_c = self.commanded_c
        return (
            asked_s,
            math.nan if set_c is None else set_c,
            chamber_c if readings.chamber_s >= asked_s else math.nan,
            *(angles if readings.table_s >= asked_s else (math.nan,) * len(angles)),
            *ins.optics_c.tolist(), *ins.electronics_c.tolist(), ins.case_c,
            float(ins.mode), float(self.step), float(self.dwell),
        )  # fmt: skip
