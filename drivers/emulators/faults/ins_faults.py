"""Faults of the INS itself.

The signals of the shipped DBC are integers and can't carry NaN; by convention the lowest 32-bit integer
means an invalid output.
"""

from __future__ import annotations

import struct
from functools import partial
from typing import Annotated, ClassVar, Literal, get_args

import numpy as np
from pydantic import Field

from gyrobench.drivers.emulators.can_formats.gyrobench_ins import HEADING, ROLL_PITCH, VELOCITY_NE
from gyrobench.drivers.emulators.faults.can_faults import filter_while
from gyrobench.drivers.emulators.faults.fault import BenchParts, End, Fault, Occurrence, Persistence
from gyrobench.drivers.emulators.world.inertial_unit import Mode
from gyrobench.drivers.frames import FrameBlock

Signal = Literal["velocity_north", "velocity_east", "roll", "pitch", "heading"]
Sensor = Literal[
    "case", "optics_x", "optics_y", "optics_z", "electronics_x", "electronics_y", "electronics_z"
]
Signals = Annotated[list[Signal], Field(min_length=1)]

#: Frame and first byte of each signal, a signed 32-bit integer.
_SIGNAL_BYTES: dict[str, tuple[int, int]] = {
    "velocity_north": (VELOCITY_NE, 0),
    "velocity_east": (VELOCITY_NE, 4),
    "roll": (ROLL_PITCH, 0),
    "pitch": (ROLL_PITCH, 4),
    "heading": (HEADING, 0),
}
_ALL_SIGNALS: list[Signal] = list(get_args(Signal))
_SENSORS: tuple[Sensor, ...] = get_args(Sensor)
_SENSOR_LIMIT_C = 327.67


class InsRestarts(Fault):
    """The INS's supply drops out for a moment: it boots, resets its counters and loses its compensation."""

    immediate = False
    persistence = Persistence.MOMENTARY

    fault: Literal["ins_restarts"]

    def _begin(self, bench: BenchParts, occurrence: Occurrence) -> End:
        if bench.world.unit.powered:
            bench.world.power_unit(False)
            bench.world.power_unit(True)
            bench.ins.format.reset_counters()
            occurrence.record()
        return None


class InsSupplyLost(Fault):
    """The INS's supply fails: it is off, also while the chamber's event output is on."""

    fault: Literal["ins_supply_lost"]

    def _begin(self, bench: BenchParts, occurrence: Occurrence) -> End:
        bench.world.lose_supply()
        bench.ins.format.reset_counters()
        return bench.world.restore_supply


class FallsBackToAlignment(Fault):
    """The INS restarts its alignment without a command."""

    immediate = False
    persistence = Persistence.MOMENTARY

    fault: Literal["falls_back_to_alignment"]

    def _begin(self, bench: BenchParts, occurrence: Occurrence) -> End:
        if bench.world.unit.mode is Mode.NAVIGATE:
            bench.world.unit.align()
            occurrence.record()
        return None


class AlignmentNeverDone(Fault):
    """Alignment never reaches a result."""

    fault: Literal["alignment_never_done"]

    def _begin(self, bench: BenchParts, occurrence: Occurrence) -> End:
        unit = bench.world.unit
        unit.never_aligns = True
        return partial(setattr, unit, "never_aligns", False)


class _OutputFault(Fault):
    """Signals of the navigation output are wrong, while counters continue."""

    immediate = False
    #: Value sent in place of the correct one; None for the correct value when the fault began.
    value: ClassVar[bytes | None] = None
    signals: Signals = Field(_ALL_SIGNALS, description="affected signals of the navigation output")

    def _begin(self, bench: BenchParts, occurrence: Occurrence) -> End:
        first: dict[str, bytes] = {}

        def replace_signals(frames: FrameBlock) -> FrameBlock:
            data = frames.data.copy()
            for signal in self.signals:
                identifier, first_byte = _SIGNAL_BYTES[signal]
                affected = np.flatnonzero(frames.arbitration_id == identifier)
                if len(affected):
                    signal_bytes = slice(first_byte, first_byte + 4)
                    correct = data[affected[0], signal_bytes].tobytes()
                    value = self.value or first.setdefault(signal, correct)
                    data[affected, signal_bytes] = np.frombuffer(value, np.uint8)
                    occurrence.record()
            return frames.with_fields(data=data)

        return filter_while(bench.bus, replace_signals)


class StuckOutput(_OutputFault):
    """Signals keep their last value."""

    fault: Literal["stuck_output"]


class InvalidOutput(_OutputFault):
    """Signals hold the number for an invalid value: -2^31."""

    value = struct.pack("<i", -(2**31))
    fault: Literal["invalid_output"]


class SaturatedOutput(_OutputFault):
    """Signals hold the largest number: 2^31 - 1."""

    value = struct.pack("<i", 2**31 - 1)
    fault: Literal["saturated_output"]


class SensorFault(Fault):
    """A temperature sensor reads a wrong value; the INS's own compensation uses it too."""

    sensor: Sensor = Field(description="faulty temperature sensor")

    def _reading_c(self, bench: BenchParts) -> float:
        """Constant reading during the fault."""
        raise NotImplementedError

    def _begin(self, bench: BenchParts, occurrence: Occurrence) -> End:
        index = _SENSORS.index(self.sensor)
        broken_sensors = bench.world.broken_sensors
        broken_sensors[index] = self._reading_c(bench)

        def end() -> None:
            broken_sensors.pop(index, None)

        return end


class TemperatureSensorBroken(SensorFault):
    """A temperature sensor reads the end of its range."""

    fault: Literal["temperature_sensor_broken"]
    end: Literal["high", "low"] = Field("high", description="end of its range that it reads")

    def _reading_c(self, bench: BenchParts) -> float:
        return _SENSOR_LIMIT_C if self.end == "high" else -_SENSOR_LIMIT_C


class TemperatureSensorFrozen(SensorFault):
    """A temperature sensor keeps its last, plausible value."""

    fault: Literal["temperature_sensor_frozen"]

    def _reading_c(self, bench: BenchParts) -> float:
        return float(bench.world.thermal.nodes_c[_SENSORS.index(self.sensor)])
