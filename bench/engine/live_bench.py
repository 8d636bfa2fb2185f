"""The bench while a run lasts: instruments, time, and what was read last."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import can

from bench.clock import Clock
from bench.engine.stop import StopRequest
from bench.errors import FaultError, NoReplyError
from bench.run_store.can_log import CanLog
from bench.run_store.telemetry import Telemetry
from bench.station.instruments import Instruments
from bench.station.station import Station
from drivers.ins.frames import FrameBlock, concatenate
from drivers.ins.ins_status import InsStatus
from drivers.ins.readout import InsMode
from drivers.rate_table import TableReading

_FRAMES_PER_BLOCK = 2000
#: How far beyond the station's limits the air may overshoot.
_CHAMBER_MARGIN_C = 5.0
_INS_SILENCE_S = 5.0


@dataclass(frozen=True)
class Readings:
    """What the instruments said when they were last asked.

    Attributes
    ----------
    time_s : float
        When that was, on the run's clock.
    """

    time_s: float
    table: TableReading
    chamber_c: float
    ins: InsStatus


@dataclass
class Capture:
    """Frames, chamber temperatures and table angles since an alignment began."""

    log_part: int
    chamber_c: list[float] = field(default_factory=list)
    table_deg: list[tuple[float, float]] = field(default_factory=list)
    _blocks: list[FrameBlock] = field(default_factory=list)
    _messages: list[can.Message] = field(default_factory=list)

    def add(self, messages: list[can.Message]) -> None:
        """Keep frames; as arrays, since a dwell has tens of thousands of them."""
        self._messages += messages
        if len(self._messages) >= _FRAMES_PER_BLOCK:
            self._pack()

    def count(self) -> int:
        """Number of data frames so far."""
        self._pack()
        return sum(map(len, self._blocks))

    def frames(self, first: int = 0) -> FrameBlock:
        """Data frames so far, from a number on."""
        self._pack()
        blocks, start = self._blocks, 0
        while blocks and start + len(blocks[0]) <= first:
            start += len(blocks[0])
            blocks = blocks[1:]
        return concatenate(blocks).take(slice(first - start, None))

    def _pack(self) -> None:
        if self._messages:
            self._blocks.append(FrameBlock.from_messages(self._messages))
            self._messages = []


class LiveBench:
    """The opened instruments on the run's clock, polled at every tick.

    Parameters
    ----------
    station, instruments
        The bench and its opened instruments.
    clock : Clock
        The run's clock.
    can_log, telemetry
        Where everything received and read goes.
    stop : StopRequest
        Looked at in every tick.

    Attributes
    ----------
    readings : Readings
        From the last time that the instruments were asked; set by :meth:`start`.
    chamber_set_c : float or None
        What the chamber was last told; None while it is off.
    capture : Capture or None
        The frames of the dwell under way.
    ins_expected : bool
        Whether the INS is on, so that its silence is a fault.
    step, dwell : int
        Where the run is, for the telemetry; 0 where it is nowhere.
    """

    def __init__(
        self,
        station: Station,
        instruments: Instruments,
        clock: Clock,
        can_log: CanLog,
        telemetry: Telemetry,
        stop: StopRequest,
    ) -> None:
        self.station = station
        self.instruments = instruments
        self.clock = clock
        self.readings: Readings
        self.chamber_set_c: float | None = None
        self.capture: Capture | None = None
        self.ins_expected = False
        self.step = 0
        self.dwell = 0
        self._can_log = can_log
        self._telemetry = telemetry
        self._stop = stop
        instruments.ins.on_frames = self._received

    def start(self) -> None:
        """Make the table ready to move and ask all instruments for the first time."""
        self.instruments.table.prepare()
        self.readings = self.read_instruments()

    def tick(self) -> None:
        """Wait for the next tick, taking what the INS sends; ask the instruments when it is time.

        Ticks are the multiples of the station's period.

        Raises
        ------
        RunStoppedError
            The run is to stop.
        InstrumentError
            An instrument does not answer or reports a fault.
        """
        self._stop.check()
        tick_s = self.station.tick_s
        next_tick_s = tick_s * (math.floor(self.clock.now() / tick_s + 1e-9) + 1)
        while (now_s := self.clock.now()) < next_tick_s:
            self.clock.sleep_until(min(next_tick_s, now_s + self.station.poll_period_s))
            self.instruments.ins.poll()
        if self.clock.now() - self.readings.time_s >= self.station.instruments_period_s - 1e-6:
            self.readings = self.read_instruments()

    def read_instruments(self) -> Readings:
        """Ask table, chamber and INS, and keep what they say in the telemetry.

        Raises
        ------
        FaultError
            An instrument reports a fault, or the chamber's air is outside the station's limits.
        NoReplyError
            The INS is on and has gone silent.
        """
        self.instruments.ins.poll()
        faults = self.instruments.table.faults()
        if faults:
            raise FaultError(
                "rate table", f"reports {', '.join(faults)}. Find the cause before the next run."
            )
        readings = Readings(
            self.clock.now(),
            self.instruments.table.read(),
            self.instruments.chamber.read().temperature_c,
            self.instruments.ins.status(),
        )
        self._check_chamber(readings.chamber_c)
        self._check_ins(readings.ins)
        self._telemetry.add(self._telemetry_row(readings))
        if self.capture:
            self.capture.chamber_c.append(readings.chamber_c)
            self.capture.table_deg.append(self.station.table_axes_of(readings.table.position_deg))
        return readings

    def _check_chamber(self, chamber_c: float) -> None:
        alarms = self.instruments.chamber.alarms()
        if alarms:
            raise FaultError("chamber", f"reports {', '.join(alarms)}. Find the cause before the next run.")
        limits = self.station.file.chamber.limits
        if not limits.low_c - _CHAMBER_MARGIN_C <= chamber_c <= limits.high_c + _CHAMBER_MARGIN_C:
            raise FaultError(
                "chamber",
                f"its air is at {chamber_c:.1f} degC, outside the station's {limits.low_c:g} to "
                f"{limits.high_c:g} degC. Check controller, sensor and door.",
            )

    def _check_ins(self, status: InsStatus) -> None:
        if not self.ins_expected:
            return
        if status.age_s > _INS_SILENCE_S:
            raise NoReplyError(
                "INS", f"has sent nothing for {status.age_s:.0f} s. Check its power, the bus and the cable."
            )
        if status.mode is InsMode.FAULT:
            raise FaultError("INS", "reports a fault. Read its own diagnostics.")

    def begin_capture(self) -> None:
        """Keep the frames from here on for a dwell; the raw log starts a new part."""
        self.instruments.ins.poll()
        self._can_log.cut()
        self.capture = Capture(self._can_log.next_part)

    def end_capture(self) -> None:
        """Stop keeping frames; frames and telemetry so far are on the disk when this returns."""
        self.capture = None
        self._can_log.cut()
        self._telemetry.flush()

    def captured_frames(self) -> int:
        """Number of data frames of the dwell under way that have arrived by now."""
        self.instruments.ins.poll()
        return self.capture.count() if self.capture else 0

    def _received(self, messages: list[can.Message]) -> None:
        self._can_log.write(messages)
        if self.capture:
            self.capture.add(messages)

    def _telemetry_row(self, readings: Readings) -> tuple[float, ...]:
        ins = readings.ins
        outer, inner = self.station.table_axes_of(readings.table.position_deg)
        outer_rate, inner_rate = self.station.table_axes_of(readings.table.rate_dps)
        set_c = math.nan if self.chamber_set_c is None else self.chamber_set_c
        return (
            readings.time_s, set_c, readings.chamber_c, outer, inner, outer_rate, inner_rate,
            *ins.optics_c.tolist(), *ins.electronics_c.tolist(), ins.case_c,
            float(ins.mode), float(self.step), float(self.dwell),
        )  # fmt: skip
