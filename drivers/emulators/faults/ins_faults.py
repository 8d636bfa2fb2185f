"""Faults of the INS itself.

The shipped DBC has whole numbers alone, so a NaN can't be sent: the lowest number of 32 bits stands
for an output that does not exist, as receivers of such frames agree.
"""

from __future__ import annotations

import struct
from typing import Annotated, ClassVar, Literal

import can
from pydantic import Field
from typing_extensions import override

from gyrobench.drivers.emulators.can_formats.gyrobench_ins import HEADING, ROLL_PITCH, VELOCITY_NE
from gyrobench.drivers.emulators.faults.can_faults import filter_while
from gyrobench.drivers.emulators.faults.fault import BenchParts, End, Fault, Occurrence
from gyrobench.drivers.emulators.faults.timing import Lasting
from gyrobench.drivers.emulators.world.inertial_unit import Mode

Signal = Literal["velocity_north", "velocity_east", "roll", "pitch", "heading"]
Sensor = Literal[
    "case", "optics_x", "optics_y", "optics_z", "electronics_x", "electronics_y", "electronics_z"
]
Signals = Annotated[list[Signal], Field(min_length=1)]

#: Frame and first byte of each signal, 32 bits with a sign.
_PLACES: dict[str, tuple[int, int]] = {
    "velocity_north": (VELOCITY_NE, 0),
    "velocity_east": (VELOCITY_NE, 4),
    "roll": (ROLL_PITCH, 0),
    "pitch": (ROLL_PITCH, 4),
    "heading": (HEADING, 0),
}
_ALL: list[Signal] = ["velocity_north", "velocity_east", "roll", "pitch", "heading"]
_SENSORS: tuple[Sensor, ...] = (
    "case", "optics_x", "optics_y", "optics_z", "electronics_x", "electronics_y", "electronics_z",
)  # fmt: skip
_INVALID = struct.pack("<i", -(2**31))
_LARGEST = struct.pack("<i", 2**31 - 1)
_SENSOR_LIMIT_C = 327.67


class InsRestarts(Fault):
    """The INS's supply drops out for a moment: it boots, its counters begin anew, what was loaded is lost."""

    lasting: ClassVar[Lasting] = Lasting.MOMENT

    fault: Literal["ins_restarts"]

    @override
    def begin(self, bench: BenchParts, occurrence: Occurrence) -> End:
        if bench.world.unit.powered:
            bench.world.power_unit(False)
            bench.world.power_unit(True)
            bench.ins.count_anew()
            occurrence.record()
        return None


class FallsBackToAlignment(Fault):
    """The INS begins to align anew although nobody told it to."""

    lasting: ClassVar[Lasting] = Lasting.MOMENT

    fault: Literal["falls_back_to_alignment"]

    @override
    def begin(self, bench: BenchParts, occurrence: Occurrence) -> End:
        if bench.world.unit.mode is Mode.NAVIGATE:
            bench.world.unit.align()
            occurrence.record()
        return None


class AlignmentNeverDone(Fault):
    """Alignment goes on without ever coming to a result."""

    fault: Literal["alignment_never_done"]

    @override
    def begin(self, bench: BenchParts, occurrence: Occurrence) -> End:
        unit = bench.world.unit
        unit.never_aligns = True
        occurrence.record()

        def end() -> None:
            unit.never_aligns = False

        return end


class OutputFault(Fault):
    """Signals of the navigation output that say something else, while counters go on."""

    signals: Signals = Field(_ALL, description="which signals of the navigation output")

    def value(self, right: bytes, first: bytes) -> bytes:
        """Give what is sent in place of the right value; ``first`` was right when the fault began."""
        raise NotImplementedError

    @override
    def begin(self, bench: BenchParts, occurrence: Occurrence) -> End:
        first: dict[str, bytes] = {}

        def replaced(messages: list[can.Message]) -> list[can.Message]:
            for message in messages:
                for signal in self.signals:
                    identifier, place = _PLACES[signal]
                    if message.arbitration_id == identifier:
                        right = bytes(message.data[place : place + 4])
                        value = self.value(right, first.setdefault(signal, right))
                        message.data[place : place + 4] = value
                        occurrence.record()
            return messages

        return filter_while(bench.bus, replaced)


class StuckOutput(OutputFault):
    """Signals keep the value that they had."""

    fault: Literal["stuck_output"]

    @override
    def value(self, right: bytes, first: bytes) -> bytes:
        return first


class InvalidOutput(OutputFault):
    """Signals hold the number that stands for no value: -2^31."""

    fault: Literal["invalid_output"]

    @override
    def value(self, right: bytes, first: bytes) -> bytes:
        return _INVALID


class SaturatedOutput(OutputFault):
    """Signals hold the largest number that they can: 2^31 - 1."""

    fault: Literal["saturated_output"]

    @override
    def value(self, right: bytes, first: bytes) -> bytes:
        return _LARGEST


class SensorFault(Fault):
    """A temperature sensor that does not read its temperature; the INS's own compensation uses it too."""

    sensor: Sensor = Field(description="which temperature sensor")

    def reading_c(self, bench: BenchParts) -> float:
        """What it reads from now on."""
        raise NotImplementedError

    @override
    def begin(self, bench: BenchParts, occurrence: Occurrence) -> End:
        place = _SENSORS.index(self.sensor)
        broken = bench.world.broken_sensors
        broken[place] = self.reading_c(bench)
        occurrence.record()

        def end() -> None:
            broken.pop(place, None)

        return end


class TemperatureSensorBroken(SensorFault):
    """A temperature sensor reads the end of its range."""

    fault: Literal["temperature_sensor_broken"]
    end: Literal["high", "low"] = Field(default="high", description="which end of its range it reads")

    @override
    def reading_c(self, bench: BenchParts) -> float:
        return _SENSOR_LIMIT_C if self.end == "high" else -_SENSOR_LIMIT_C


class TemperatureSensorFrozen(SensorFault):
    """A temperature sensor keeps the plausible value that it had."""

    fault: Literal["temperature_sensor_frozen"]

    @override
    def reading_c(self, bench: BenchParts) -> float:
        return float(bench.world.thermal.nodes_c[_SENSORS.index(self.sensor)])


InsFault = (
    InsRestarts
    | FallsBackToAlignment
    | AlignmentNeverDone
    | StuckOutput
    | InvalidOutput
    | SaturatedOutput
    | TemperatureSensorBroken
    | TemperatureSensorFrozen
)
