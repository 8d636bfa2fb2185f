"""Which signal of the DBC carries which quantity: the station file's ``ins.signals``.

A source is ``MESSAGE.SIGNAL``, or a mapping with that under ``signal`` and what has to be done to
it (``sign``, ``scale``, ``unit``).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from enum import StrEnum
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from gyrobench.bench.foundations.documents import Location, StrictModel


class Dimension(StrEnum):
    """What a quantity measures, and so which units its signal may have."""

    TIME = "time"
    SPEED = "speed"
    ANGLE = "angle"
    TEMPERATURE = "temperature"
    NUMBER = "number"


def _is_signal_name(value: str) -> str:
    message, dot, signal = value.partition(".")
    if not (message and dot and signal) or "." in signal:
        raise ValueError("expected MESSAGE.SIGNAL as the DBC file names them")
    return value


def _signal_alone(value: Any) -> Any:
    return {"signal": value} if isinstance(value, str) else value


def _sequence_alone(value: Any) -> Any:
    return {"fixed": value} if value in ("rpy_321", "pry_231") else _signal_alone(value)


def _value_alone(value: Any) -> Any:
    return [value] if isinstance(value, int) else value


SignalName = Annotated[
    str, Field(json_schema_extra={"pattern": r"^[^.]+\.[^.]+$"}), AfterValidator(_is_signal_name)
]
_SequenceName = Literal["rpy_321", "pry_231"]
#: One raw value or several that mean the same.
Values = Annotated[list[int], BeforeValidator(_value_alone, json_schema_input_type=int | list[int])]


class SignalSource(StrictModel):
    """A signal and what turns it into the quantity."""

    signal: SignalName = Field(description="MESSAGE.SIGNAL as the DBC file names them")
    sign: Literal[1, -1] = Field(default=1, description="-1 where the signal counts the other way")
    scale: float = Field(default=1.0, description="factor on the value in the unit of the DBC")
    unit: str | None = Field(default=None, description="unit to take instead of the DBC's")


Source = Annotated[
    SignalSource, BeforeValidator(_signal_alone, json_schema_input_type=SignalName | SignalSource)
]


class AxesMap(StrictModel):
    """One signal for each body axis."""

    x: Source = Field(description="signal of the x axis")
    y: Source = Field(description="signal of the y axis")
    z: Source = Field(description="signal of the z axis")


class SequenceMap(StrictModel):
    """The Euler sequence: fixed, or a signal with the values that stand for each."""

    fixed: _SequenceName | None = Field(default=None, description="the sequence, where it never changes")
    signal: SignalName | None = Field(default=None, description="the signal that tells")
    rpy_321: int = Field(default=0, description="its value for roll, pitch, yaw")
    pry_231: int = Field(default=1, description="its value for pitch, roll, yaw")

    @model_validator(mode="after")
    def _either(self) -> SequenceMap:
        if (self.fixed is None) == (self.signal is None):
            raise ValueError("expected rpy_321, pry_231 or the signal that tells")
        return self


class EulerMap(StrictModel):
    """Euler angles; :mod:`gyrobench.drivers.ins.attitude` says what they mean."""

    roll: Source = Field(description="signal of roll")
    pitch: Source = Field(description="signal of pitch")
    yaw: Source = Field(description="signal of yaw or heading")
    sequence: Annotated[
        SequenceMap,
        BeforeValidator(_sequence_alone, json_schema_input_type=_SequenceName | SignalName | SequenceMap),
    ] = Field(description="rpy_321, pry_231, or the signal that tells")
    yaw_positive: Literal["up", "down"] = Field(
        description="up: counter-clockwise seen from above; down: a heading, clockwise"
    )


class QuaternionMap(StrictModel):
    """A unit quaternion that turns body vectors into the navigation frame."""

    w: Source = Field(description="signal of w")
    x: Source = Field(description="signal of x")
    y: Source = Field(description="signal of y")
    z: Source = Field(description="signal of z")
    frames: Literal["rfu_to_enu", "frd_to_ned"] = Field(
        description="from which body axes into which navigation axes it turns"
    )


class AttitudeMap(StrictModel):
    """Attitude in one of its forms, and the signal that is zero where it means nothing."""

    euler: EulerMap | None = Field(default=None, description="attitude as Euler angles")
    quaternion: QuaternionMap | None = Field(default=None, description="attitude as a unit quaternion")
    valid: SignalName | None = Field(
        default=None, description="signal that is zero where the attitude means nothing"
    )

    @model_validator(mode="after")
    def _one_form(self) -> AttitudeMap:
        if (self.euler is None) == (self.quaternion is None):
            raise ValueError("expected one of: euler, quaternion")
        return self


class ModeMap(StrictModel):
    """What the INS is doing, by raw value; others count as booting."""

    signal: SignalName = Field(description="signal of the mode")
    standby: Values = Field(default_factory=list, description="raw values that mean standby")
    align: Values = Field(default_factory=list, description="raw values that mean align")
    navigate: Values = Field(description="raw values that mean navigate")
    fault: Values = Field(default_factory=list, description="raw values that mean fault")


class AlignmentMap(StrictModel):
    """How far alignment has come, by raw value; others count as none."""

    signal: SignalName = Field(description="signal of how far alignment has come")
    coarse: Values = Field(default_factory=list, description="raw values that mean coarse")
    fine: Values = Field(description="raw values that mean fine")


@dataclass(frozen=True)
class Quantity:
    """A mapped quantity: where in the map it stands and what it measures."""

    location: Location
    source: SignalSource
    dimension: Dimension


class SignalMap(StrictModel):
    """Signals of the INS's output."""

    time_s: Source | None = Field(
        default=None,
        description="time on the clock of the INS; without an epoch counter it has to come with every epoch",
    )
    time_ns: Source | None = Field(default=None, description="nanoseconds, added to time_s")
    epoch_counter: Source | None = Field(default=None, description="counter of epochs")
    epoch_period_s: float = Field(gt=0.0, le=10.0, description="time between epochs, s")
    epoch_messages: list[str] | None = Field(
        default=None,
        description="messages of one epoch in the order in which they are sent; by identifier if not given",
    )
    velocity_east: Source = Field(description="velocity East")
    velocity_north: Source = Field(description="velocity North")
    velocity_up: Source | None = Field(default=None, description="velocity Up")
    attitude: AttitudeMap = Field(description="attitude of the body axes")
    gyro_optics_temperature: AxesMap | None = Field(
        default=None, description="temperatures of the gyros' optics"
    )
    gyro_electronics_temperature: AxesMap | None = Field(
        default=None, description="temperatures of the gyros' electronics"
    )
    case_temperature: Source | None = Field(default=None, description="temperature of the case")
    mode: ModeMap | None = Field(
        default=None, description="what the INS is doing; other values count as booting"
    )
    alignment: AlignmentMap | None = Field(
        default=None, description="how far alignment has come; other values count as none"
    )
    compensation: SignalName | None = Field(
        default=None, description="not zero where a compensation is in use"
    )
    compensation_in_use: SignalName | None = Field(
        default=None, description="checksum that names the compensation in use, 0 where none is"
    )
    compensation_loaded: SignalName | None = Field(
        default=None,
        description="checksum of what has been loaded: CRC-32 of all numbers as little-endian "
        "32-bit floats, gyro by gyro in the order of their indices",
    )
    identity: dict[str, SignalName] = Field(
        default_factory=dict, description="numbers that say which INS this is, by name, such as serial_number"
    )

    @model_validator(mode="after")
    def _whole_seconds(self) -> SignalMap:
        if self.time_ns is not None and self.time_s is None:
            raise ValueError("time_ns is added to time_s, which is missing")
        return self

    @model_validator(mode="after")
    def _whole_epochs(self) -> SignalMap:
        absent = self.messages_of_epoch() - set(self.epoch_messages or self.messages_of_epoch())
        if absent:
            raise ValueError(f"epoch_messages lacks {', '.join(sorted(absent))}")
        return self

    def messages_of_epoch(self) -> set[str]:
        """Messages without which an epoch is not complete."""
        angles = self.attitude.euler or self.attitude.quaternion
        sources = [self.velocity_east, self.velocity_north, self.epoch_counter or self.time_s]
        sources += [source for _, source in angles or () if isinstance(source, SignalSource)]
        return {source.signal.partition(".")[0] for source in sources if source is not None}

    def quantities(self) -> dict[str, Quantity]:
        """Every mapped quantity by its path, such as ``attitude.euler.roll``."""
        return {".".join(map(str, found.location)): found for found in self._all()}

    def _all(self) -> Iterator[Quantity]:
        for name, dimension in _PLAIN.items():
            yield from _quantities(getattr(self, name), (name,), dimension)
        euler, quaternion = self.attitude.euler, self.attitude.quaternion
        if euler is not None:
            for name in ("roll", "pitch", "yaw"):
                yield Quantity(("attitude", "euler", name), getattr(euler, name), Dimension.ANGLE)
            yield from _states(euler.sequence.signal, ("attitude", "euler", "sequence"))
        if quaternion is not None:
            for name in "wxyz":
                yield Quantity(("attitude", "quaternion", name), getattr(quaternion, name), Dimension.NUMBER)
        yield from _states(self.attitude.valid, ("attitude", "valid"))
        yield from _states(self.mode.signal if self.mode else None, ("mode",))
        yield from _states(self.alignment.signal if self.alignment else None, ("alignment",))
        for name in ("compensation", "compensation_in_use", "compensation_loaded"):
            yield from _states(getattr(self, name), (name,))
        for name, signal in self.identity.items():
            yield from _states(signal, ("identity", name))


_PLAIN = {
    "time_s": Dimension.TIME,
    "time_ns": Dimension.TIME,
    "epoch_counter": Dimension.NUMBER,
    "velocity_east": Dimension.SPEED,
    "velocity_north": Dimension.SPEED,
    "velocity_up": Dimension.SPEED,
    "gyro_optics_temperature": Dimension.TEMPERATURE,
    "gyro_electronics_temperature": Dimension.TEMPERATURE,
    "case_temperature": Dimension.TEMPERATURE,
}


def _quantities(
    mapped: SignalSource | AxesMap | None, location: Location, dimension: Dimension
) -> Iterator[Quantity]:
    if isinstance(mapped, AxesMap):
        for axis in "xyz":
            yield Quantity((*location, axis), getattr(mapped, axis), dimension)
    elif mapped is not None:
        yield Quantity(location, mapped, dimension)


def _states(signal: str | None, location: Location) -> Iterator[Quantity]:
    if signal is not None:
        yield Quantity(location, SignalSource(signal=signal), Dimension.NUMBER)
