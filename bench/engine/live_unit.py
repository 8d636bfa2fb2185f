"""One unit on the bench: the frames that its INS sends, its state, its interlocks."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Protocol, TypeVar

from gyrobench.bench.engine.bench_state import Readings, UnitState
from gyrobench.bench.engine.interlocks.watch import InterlockWatch, Trip
from gyrobench.bench.foundations.clock import Clock
from gyrobench.bench.foundations.errors import InstrumentError, NoReplyError, SignalMapError
from gyrobench.bench.navigation.positions import AXES
from gyrobench.bench.navigation.table_axes import Angles
from gyrobench.bench.station.instruments import CHAMBER, RATE_TABLE
from gyrobench.bench.station.station import Station
from gyrobench.drivers.frames import FrameBlock, concatenate
from gyrobench.drivers.ins.attitude import EulerSequence
from gyrobench.drivers.ins.can_ins import CanIns
from gyrobench.drivers.ins.ins_status import InsStatus
from gyrobench.drivers.ins.readout import InsMode

if TYPE_CHECKING:
    from gyrobench.bench.runs.can_log import CanLog
    from gyrobench.bench.runs.telemetry import Telemetry

#: If the epoch count of an INS is off by more than this, it has restarted or lost its count.
_EPOCH_COUNT_TOLERANCE_S = 3.0
#: Two mismatching periods are equal if they differ by less than this relative amount; a period is plausible
#: within this factor of the declared one.
_SAME_PERIOD, _MAX_PERIOD_RATIO = 0.03, 20.0
#: A match over a time of this multiple of the tolerance confirms the declared period.
_CONFIRMED_RATIO = 4.0
#: A CAN bus that is silent for this long may be disconnected without an error.
BUS_SILENCE_S = 4.0
#: Maximum age of the last frame of an INS that has started.
_FRESH_S = 2.0

#: Columns of the telemetry that come from the INS.
_INS_COLUMNS = (*(f"{part}_{axis}_c" for part in ("gyro", "board") for axis in AXES), "case_c", "ins_mode")

_T = TypeVar("_T")


@dataclass
class Capture:
    """Frames, chamber temperatures, table angles and neighbours of a dwell since its alignment began."""

    log_part: int
    chamber_c: list[float] = field(default_factory=list)
    table_deg: list[Angles] = field(default_factory=list)
    neighbours_on: list[int] = field(default_factory=list)
    _blocks: list[FrameBlock] = field(default_factory=list)
    count: int = 0  #: number of data frames so far

    def add(self, block: FrameBlock) -> None:
        """Keep the data frames of a block."""
        self._blocks.append(block.data_frames())
        self.count += len(self._blocks[-1])

    def frames(self, first: int = 0) -> FrameBlock:
        """Return the data frames so far, from index ``first`` on."""
        block, block_start = len(self._blocks), self.count
        while block_start > first:
            block -= 1
            block_start -= len(self._blocks[block])
        return concatenate(self._blocks[block:]).take(slice(first - block_start, None))


class PollingBench(Protocol):
    """Interface of the bench that polls a unit."""

    clock: Clock

    def query(self, instrument: str, ask: Callable[[], _T]) -> _T | None:
        """Return an instrument's answer, or None after a failure, which is reported."""

    def handle_failure(self, error: InstrumentError) -> None:
        """Report a failed exchange; the instrument is reopened until it answers."""

    def neighbours_on(self, unit: LiveUnit) -> int | None:
        """Number of other units that are on, as far as is known; None on a bench with one unit."""


class LiveUnit:
    """One unit on a bench that is polled.

    ``station`` is the station with this unit alone, ``absent`` names the instruments that were not opened.
    ``can_log`` and ``telemetry`` record everything received and read; None for a unit that is not recorded.
    """

    def __init__(
        self,
        bench: PollingBench,
        station: Station,
        ins: CanIns,
        absent: Collection[str],
        can_log: CanLog | None,
        telemetry: Telemetry | None,
    ) -> None:
        self._bench = bench
        self.station = station
        self.ins = ins
        self.name = ins.name  #: in messages
        self.state = UnitState(station)
        self.capture: Capture | None = None  #: frames of the dwell in progress
        #: Why it is temporarily not measured, and its trips affect no other unit; empty if it is measured.
        self.set_aside_reason = ""
        self.readings: Readings  #: newest answers; set by :meth:`observe`
        self._can_log = can_log
        self._telemetry = telemetry
        self._watch = InterlockWatch(station, bench.clock, {RATE_TABLE, CHAMBER, *absent})
        self._mode = InsMode.UNKNOWN
        #: Time of reading, s, epoch count, and age of the last frame, s.
        self._epochs: tuple[float, int, float] | None = None
        self._other_period_s = math.nan  #: epoch period by the last count that did not match
        ins.on_frames = self._store_frames

    @property
    def has_readings(self) -> bool:
        """Whether there are readings."""
        return hasattr(self, "readings")

    def poll(self) -> None:
        """Receive the frames that have arrived."""
        self._bench.query(self.name, self.ins.poll)

    def status(self) -> InsStatus:
        """State of the INS with the frames that have arrived by now."""
        self.poll()
        return self.ins.status()

    def choose_euler_sequence(self, declared: str) -> Iterator[None] | None:
        """Begin to select the Euler sequence that is regular in this position, or the one declared.

        None if it is selected already, or the INS has only one.
        """
        if not self.ins.supports("set_euler_sequence"):
            return None
        y_is_vertical = self.state.position in ("y_up", "y_down")
        regular = EulerSequence.PRY_231 if y_is_vertical else EulerSequence.RPY_321
        sequence = regular if declared == "automatic" else EulerSequence(declared)
        is_set = self.status().euler_sequence is sequence
        return None if is_set else self.ins.set_euler_sequence_stepwise(sequence)

    def forget(self) -> None:
        """Discard what the INS sent before its supply was switched on."""
        self.poll()
        self.ins.forget()
        self._mode, self._epochs = InsMode.UNKNOWN, None

    def has_started(self) -> bool:
        """Whether the INS sends frames and is past its boot."""
        status = self.status()
        return status.age_s < _FRESH_S and status.mode is not InsMode.BOOT

    def check_identifiers(self) -> None:
        """Raise SignalMapError if the INS sends identifiers of the DBC in the other format, 11 or 29 bits."""
        if self.ins.has_other_format:
            other_frames = self.ins.describe_foreign_frames()
            raise SignalMapError(f"{self.name}: {other_frames}. Correct the DBC file, or the INS's output")

    def write_waiting(self, now_s: float) -> None:
        """Write the buffered frames to the log if no others have followed for some seconds."""
        if self._can_log:
            self._can_log.write_waiting(now_s)

    def begin(self, readings: Readings) -> None:
        """Take the first readings."""
        self.readings = readings
        self._watch.observe(readings)

    def observe(self, readings: Readings, row: dict[str, float]) -> None:
        """Process the bench's readings with this unit's INS status, and the bench's telemetry ``row``."""
        self.begin(readings)
        self._notice_restart(readings)
        self._notice_silent_bus(readings)
        if self._telemetry:
            self._telemetry.add(row | _telemetry_of(readings.ins))
        if self.capture and readings.chamber_s >= readings.polled_s:
            self.capture.chamber_c.append(readings.chamber.temperature_c)
        if self.capture and readings.table_s >= readings.polled_s:
            self.capture.table_deg.append(self.station.table_axes_of(readings.table.position_deg))
        if self.capture and (neighbours_on := self._bench.neighbours_on(self)) is not None:
            self.capture.neighbours_on.append(neighbours_on)

    @property
    def is_on(self) -> bool:
        """Whether the INS is on and sends; for a dropped unit, whether it did when it was dropped."""
        return self.state.expected.ins_on and self.readings.ins.age_s <= BUS_SILENCE_S

    @property
    def is_silent(self) -> bool:
        """Whether the INS should send frames, and its bus may be disconnected without an error."""
        return self.state.expected.ins_on and self.ins.status().age_s > BUS_SILENCE_S

    def trips(self) -> list[Trip]:
        """Return the interlocks of this unit that are tripped."""
        trips = self._watch.trips(self._bench.clock.now(), self.state.expected)
        return [replace(trip, unit=self.station.number) for trip in trips] if trips else trips

    def untripped_since_s(self, name: str) -> float | None:
        """Time since which an interlock has not been tripped for this unit; None while it is tripped."""
        return self._watch.untripped_since_s(name)

    def _notice_restart(self, readings: Readings) -> None:
        """Detect an INS that restarted: it left its mode without a command, or its count of epochs jumped."""
        mode, epochs = readings.ins.mode, readings.ins.epochs
        was_working = self._mode in (InsMode.ALIGN, InsMode.NAVIGATE)
        has_left_mode = was_working and mode in (InsMode.BOOT, InsMode.STANDBY)
        if has_left_mode or self._has_count_jumped(readings):
            self.state.restarted()
        if mode is not InsMode.UNKNOWN:
            self._mode = mode
        if epochs is not None:
            self._epochs = (readings.polled_s, epochs, readings.ins.age_s)

    def _has_count_jumped(self, readings: Readings) -> bool:
        """Whether the count of epochs contradicts the time since the last reading.

        Raises SignalMapError if it gives the same wrong period twice, which no restart does.
        """
        ins, previous = readings.ins, self._epochs
        if ins.epochs is None or previous is None:
            return False
        elapsed_s = readings.polled_s - previous[0]
        epochs = (ins.epochs - previous[1]) % ins.epoch_modulus
        wrap_s = ins.epoch_modulus * ins.epoch_period_s
        error_s = (epochs * ins.epoch_period_s - elapsed_s + wrap_s / 2.0) % wrap_s - wrap_s / 2.0
        tolerance_s = _EPOCH_COUNT_TOLERANCE_S + ins.age_s + previous[2]
        if abs(error_s) <= tolerance_s:
            if elapsed_s >= _CONFIRMED_RATIO * tolerance_s:
                self._other_period_s = math.nan
            return False
        period_s = elapsed_s / max(epochs, 1)
        if abs(period_s / self._other_period_s - 1.0) < _SAME_PERIOD:
            is_emulated = self.station.file.ins.is_emulated
            remedy = "choose the --world that belongs to it" if is_emulated else "the output rate of the INS"
            if self.station.file.speed > 1.0:
                remedy += (
                    "; or give `gyrobench emulate` the --speed of the station file: it had another one, or "
                    "this computer is too slow for it"
                )
            raise SignalMapError(
                f"{self.name}: counts an epoch in {period_s:.3g} s, not in {ins.epoch_period_s:g} s. Correct "
                f"epoch_period_s of the signal map in the station file, or {remedy}"
            )
        is_plausible = 1.0 / _MAX_PERIOD_RATIO < period_s / ins.epoch_period_s < _MAX_PERIOD_RATIO
        self._other_period_s = period_s if is_plausible else math.nan
        return True

    def _notice_silent_bus(self, readings: Readings) -> None:
        """Report an INS that has fallen silent as a failed exchange, so that its bus is reopened.

        Its silence until the poll counts: what has been read since may have taken long.
        """
        if self.state.expected.ins_on and readings.ins.age_s > BUS_SILENCE_S:
            other_frames = f"; {frames}" if (frames := self.ins.describe_foreign_frames()) else ""
            silence = f"has sent nothing for {readings.ins.age_s:.0f} s{other_frames}"
            self._bench.handle_failure(NoReplyError(self.name, silence))

    def begin_capture(self) -> None:
        """Start to keep the frames of a dwell; the raw log starts a new part."""
        self.poll()
        if self._can_log:
            self._can_log.cut()
        self.capture = Capture(self._can_log.next_part if self._can_log else 0)

    def begin_window(self, is_first: bool) -> None:
        """Discard the dwell's table readings before this window; before the first one, all its readings."""
        if self.capture:
            self.capture.table_deg.clear()
            if is_first:
                self.capture.chamber_c.clear()
                self.capture.neighbours_on.clear()

    def end_capture(self) -> FrameBlock:
        """Stop keeping frames and return them, with log and telemetry written to the disk."""
        self.poll()
        frames = self.capture.frames() if self.capture else concatenate([])
        self.capture = None
        if self._can_log and self._telemetry:
            self._can_log.sync()
            self._telemetry.flush()
        return frames

    def captured_frames(self) -> int:
        """Return the number of data frames of the dwell in progress so far."""
        self.poll()
        return self.capture.count if self.capture else 0

    def _store_frames(self, block: FrameBlock) -> None:
        if self._can_log:
            self._can_log.write(block)
        if self.capture:
            self.capture.add(block)


def _telemetry_of(ins: InsStatus) -> dict[str, float]:
    """Values of an INS by the columns of the telemetry."""
    values = (*ins.optics_c, *ins.electronics_c, ins.case_c, float(ins.mode))
    return dict(zip(_INS_COLUMNS, values, strict=True))
