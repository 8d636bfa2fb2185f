"""The bench while a run lasts: instruments, time, and what was read last."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import can

from bench.clock import Clock
from bench.engine.stop import StopRequest
from bench.errors import FaultError
from bench.run_store.can_log import CanLog
from bench.run_store.telemetry import Telemetry
from bench.station.instruments import Instruments
from bench.station.station import Station
from drivers.ins.frames import FrameBlock, concatenate
from drivers.ins.ins_status import InsStatus
from drivers.rate_table import TableReading

#: Half of the shortest time between two frames on a bus of 1 Mbit/s: an edge between two frames.
_FRAME_EDGE_S = 25e-6
_FRAMES_PER_BLOCK = 2000


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
    """Frames and chamber temperatures since an alignment began."""

    frames_from: float
    chamber_c: list[float] = field(default_factory=list)
    _blocks: list[FrameBlock] = field(default_factory=list)
    _messages: list[can.Message] = field(default_factory=list)

    def add(self, messages: list[can.Message]) -> None:
        """Keep frames; as arrays, since a dwell has tens of thousands of them."""
        self._messages += messages
        if len(self._messages) >= _FRAMES_PER_BLOCK:
            self._blocks.append(FrameBlock.from_messages(self._messages))
            self._messages = []

    def frames(self) -> FrameBlock:
        """All frames so far."""
        return concatenate([*self._blocks, FrameBlock.from_messages(self._messages)])


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
        self.step = 0
        self.dwell = 0
        self._can_log = can_log
        self._telemetry = telemetry
        self._stop = stop
        self._last_frame_s = 0.0
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
            Table or chamber reports a fault.
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
        self._telemetry.add(self._telemetry_row(readings))
        if self.capture:
            self.capture.chamber_c.append(readings.chamber_c)
        return readings

    def begin_capture(self) -> None:
        """Keep the frames from here on for a dwell; the raw log starts a new part."""
        self._can_log.cut()
        self.capture = Capture(self.frame_edge())

    def end_capture(self) -> None:
        """Stop keeping frames; those so far are on the disk when this returns."""
        self.capture = None
        self._can_log.cut()

    def frame_edge(self) -> float:
        """CAN time stamp between the last frame received and the next one."""
        self.instruments.ins.poll()
        return self._last_frame_s + _FRAME_EDGE_S

    def _received(self, messages: list[can.Message]) -> None:
        self._last_frame_s = messages[-1].timestamp
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
