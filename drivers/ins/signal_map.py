"""Assignment of DBC signals to quantities (the station file's ``ins.signals``), and its binding to a DBC.

A source is ``MESSAGE.SIGNAL``, or a mapping with that under ``signal`` and its conversion (``sign``,
``scale``, ``unit``). Bound values are in SI (m/s, rad, s), temperatures in degrees Celsius. A speed or a
temperature at an end of its field's range, or outside the DBC's range, is saturated or marked absent: NaN.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Any, Literal

import numpy as np
from cantools.database.can import Signal
from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from gyrobench.bench.foundations.arrays import FloatArray
from gyrobench.bench.foundations.documents import DocumentProblem, StrictModel
from gyrobench.bench.foundations.errors import DocumentError
from gyrobench.bench.foundations.yaml_nodes import KeyPath
from gyrobench.drivers.ins.dbc_codec import DbcCodec
from gyrobench.drivers.ins.units import UNITS, Dimension, usual_spelling


def _check_signal_name(value: str) -> str:
    message, dot, signal = value.partition(".")
    if not (message and dot and signal) or "." in signal:
        raise ValueError("expected MESSAGE.SIGNAL as the DBC file names them")
    if message.startswith("-"):
        raise ValueError(f"the opposite sign is written {{signal: {value[1:]}, sign: -1}}")
    return value


def _from_signal_name(value: Any) -> Any:
    return {"signal": value} if isinstance(value, str) else value


def _from_sequence_name(value: Any) -> Any:
    return {"fixed": value} if value in ("rpy_321", "pry_231") else _from_signal_name(value)


def _from_single_value(value: Any) -> Any:
    return [value] if isinstance(value, int) else value


def _from_single_bit(value: Any) -> Any:
    if isinstance(value, int):
        return (value, value)
    return tuple(value) if isinstance(value, list) else value


Bit = Annotated[int, Field(ge=0, le=63)]
SignalName = Annotated[
    str, Field(json_schema_extra={"pattern": r"^[^.]+\.[^.]+$"}), AfterValidator(_check_signal_name)
]
_SequenceName = Literal["rpy_321", "pry_231"]
#: One raw value or several with the same meaning.
Values = Annotated[list[int], BeforeValidator(_from_single_value, json_schema_input_type=int | list[int])]
#: First and last bit of a field in a signal's raw value, 0 for the lowest; or a single bit.
Bits = Annotated[
    tuple[Bit, Bit], BeforeValidator(_from_single_bit, json_schema_input_type=Bit | tuple[Bit, Bit])
]
_BITS_DESCRIPTION = "bit, or first and last bit, of the raw value that hold the quantity; 0 is the lowest"


class SignalSource(StrictModel):
    """A signal and its conversion to the quantity."""

    signal: SignalName = Field(description="MESSAGE.SIGNAL as the DBC file names them")
    sign: Literal[1, -1] = Field(1, description="-1 where the signal has the opposite sign")
    scale: float = Field(1.0, description="factor on the value in the unit of the DBC")
    unit: str | None = Field(None, description="unit in place of the DBC's")
    bits: Bits | None = Field(None, description=_BITS_DESCRIPTION)


Source = Annotated[
    SignalSource, BeforeValidator(_from_signal_name, json_schema_input_type=SignalName | SignalSource)
]


class AxesMap(StrictModel):
    """One signal for each body axis."""

    x: Source = Field(description="signal of the x axis")
    y: Source = Field(description="signal of the y axis")
    z: Source = Field(description="signal of the z axis")


class SequenceMap(StrictModel):
    """The Euler sequence: fixed, or given by a signal."""

    fixed: _SequenceName | None = Field(None, description="the sequence, where it never changes")
    signal: SignalName | None = Field(None, description="signal of the sequence")
    rpy_321: int = Field(0, description="its value for roll, pitch, yaw")
    pry_231: int = Field(1, description="its value for pitch, roll, yaw")

    @model_validator(mode="after")
    def _check_one_source(self) -> SequenceMap:
        if (self.fixed is None) == (self.signal is None):
            raise ValueError("expected rpy_321, pry_231 or the signal of the sequence")
        return self


class EulerMap(StrictModel):
    """Euler angles: roll about body y (forward), pitch about body x (right), yaw about the vertical."""

    roll: Annotated[Source, Dimension.ANGLE] = Field(description="signal of roll")
    pitch: Annotated[Source, Dimension.ANGLE] = Field(description="signal of pitch")
    yaw: Annotated[Source, Dimension.ANGLE] = Field(description="signal of yaw or heading")
    sequence: Annotated[
        SequenceMap,
        BeforeValidator(_from_sequence_name, json_schema_input_type=_SequenceName | SignalName | SequenceMap),
    ] = Field(
        description="rpy_321 (yaw, pitch, roll: usual), pry_231 (yaw, roll, pitch), or the signal of it"
    )
    yaw_positive: Literal["up", "down"] = Field(
        description="up: counter-clockwise seen from above; down: a heading, clockwise"
    )


class QuaternionMap(StrictModel):
    """A unit quaternion that transforms body vectors to the navigation frame."""

    w: Annotated[Source, Dimension.NUMBER] = Field(description="signal of w")
    x: Annotated[Source, Dimension.NUMBER] = Field(description="signal of x")
    y: Annotated[Source, Dimension.NUMBER] = Field(description="signal of y")
    z: Annotated[Source, Dimension.NUMBER] = Field(description="signal of z")
    frames: Literal["rfu_to_enu", "frd_to_ned"] = Field(
        description="body axes and navigation axes of the transformation"
    )


class AttitudeMap(StrictModel):
    """Attitude in one of two forms, and the signal that is zero where it is invalid."""

    euler: EulerMap | None = Field(None, description="attitude as Euler angles")
    quaternion: QuaternionMap | None = Field(None, description="attitude as a unit quaternion")
    valid: Annotated[Source | None, Dimension.NUMBER] = Field(
        None, description="signal that is zero where the attitude is invalid"
    )

    @model_validator(mode="after")
    def _check_one_form(self) -> AttitudeMap:
        if (self.euler is None) == (self.quaternion is None):
            raise ValueError("expected one of: euler, quaternion")
        return self


class ModeMap(StrictModel):
    """Mode of the INS by raw value; others count as booting."""

    signal: SignalName = Field(description="signal of the mode")
    bits: Bits | None = Field(None, description=_BITS_DESCRIPTION)
    standby: Values = Field(default_factory=list, description="raw values that mean standby")
    align: Values = Field(default_factory=list, description="raw values that mean align")
    navigate: Values = Field(description="raw values that mean navigate")
    fault: Values = Field(default_factory=list, description="raw values that mean fault")


class AlignmentMap(StrictModel):
    """Progress of alignment by raw value; others count as none."""

    signal: SignalName = Field(description="signal of the progress of alignment")
    bits: Bits | None = Field(None, description=_BITS_DESCRIPTION)
    coarse: Values = Field(default_factory=list, description="raw values that mean coarse")
    fine: Values = Field(description="raw values that mean fine")


class IncrementsMap(StrictModel):
    """Output of the inertial sensors in body axes, against inertial space, at an even rate.

    Increments since the sample before, or means over that time. Frames of one sample come in the order of
    their identifiers.
    """

    period_s: float = Field(gt=0.0, le=1.0, description="time between samples, s")
    angle: Annotated[AxesMap | None, Dimension.ANGLE] = Field(None, description="increments of angle")
    rate: Annotated[AxesMap | None, Dimension.ANGULAR_RATE] = Field(
        None, description="angular rates, in place of increments"
    )
    velocity: Annotated[AxesMap | None, Dimension.SPEED] = Field(
        None, description="increments of velocity: integral of specific force"
    )
    specific_force: Annotated[AxesMap | None, Dimension.ACCELERATION] = Field(
        None, description="specific forces, in place of increments"
    )
    counter: Annotated[Source | None, Dimension.NUMBER] = Field(
        None, description="counter of samples; without it lost samples show by the arrival of the others"
    )

    @model_validator(mode="after")
    def _check_one_of_each(self) -> IncrementsMap:
        for increment, mean in (("angle", "rate"), ("velocity", "specific_force")):
            if (getattr(self, increment) is None) == (getattr(self, mean) is None):
                raise ValueError(f"expected either {increment} or {mean}")
        return self


@dataclass(frozen=True)
class MappedQuantity:
    """A mapped quantity with its location in the map."""

    location: KeyPath
    source: SignalSource
    dimension: Dimension


class SignalMap(StrictModel):
    """Signals of the INS's output."""

    time_s: Annotated[Source | None, Dimension.TIME] = Field(
        None, description="time on the clock of the INS; sent with every epoch if there is no epoch counter"
    )
    time_ns: Annotated[Source | None, Dimension.TIME] = Field(
        None, description="nanoseconds, added to time_s"
    )
    epoch_counter: Annotated[Source | None, Dimension.NUMBER] = Field(None, description="counter of epochs")
    epoch_period_s: float = Field(gt=0.0, le=10.0, description="time between epochs, s")
    epoch_messages: list[str] | None = Field(
        None, description="messages of one epoch in the order in which they are sent; default: by identifier"
    )
    velocity_east: Annotated[Source, Dimension.SPEED] = Field(description="velocity East")
    velocity_north: Annotated[Source, Dimension.SPEED] = Field(description="velocity North")
    velocity_up: Annotated[Source | None, Dimension.SPEED] = Field(None, description="velocity Up")
    latitude: Annotated[Source | None, Dimension.ANGLE] = Field(
        None, description="latitude that the INS uses; has to be the station's"
    )
    attitude: AttitudeMap = Field(description="attitude of the body axes")
    gyro_optics_temperature: Annotated[AxesMap | None, Dimension.TEMPERATURE] = Field(
        None, description="temperatures of the gyros' optics"
    )
    gyro_electronics_temperature: Annotated[AxesMap | None, Dimension.TEMPERATURE] = Field(
        None, description="temperatures of the gyros' electronics"
    )
    case_temperature: Annotated[Source | None, Dimension.TEMPERATURE] = Field(
        None, description="temperature of the case"
    )
    increments: IncrementsMap | None = Field(None, description="output of gyros and accelerometers")
    mode: ModeMap | None = Field(None, description="mode of the INS; other values count as booting")
    alignment: AlignmentMap | None = Field(
        None, description="progress of alignment; other values count as none"
    )
    compensation: Annotated[Source | None, Dimension.NUMBER] = Field(
        None, description="not zero where a compensation is in use"
    )
    compensation_in_use: Annotated[SignalName | None, Dimension.NUMBER] = Field(
        None, description="checksum of the compensation in use, 0 for none"
    )
    compensation_loaded: Annotated[SignalName | None, Dimension.NUMBER] = Field(
        None,
        description="checksum of the loaded compensation: CRC-32 of all numbers as little-endian "
        "32-bit floats, gyro by gyro in the order of their indices",
    )
    identity: Annotated[dict[str, SignalName], Dimension.NUMBER] = Field(
        default_factory=dict, description="numbers that identify the INS, by name, such as serial_number"
    )

    @model_validator(mode="after")
    def _check_seconds(self) -> SignalMap:
        if self.time_ns is not None and self.time_s is None:
            raise ValueError("time_ns is added to time_s, which is missing")
        return self

    def messages_of_epoch(self) -> set[str]:
        """Names of the messages that a complete epoch must have."""
        angles = self.attitude.euler or self.attitude.quaternion
        sources = [self.velocity_east, self.velocity_north, self.epoch_counter or self.time_s]
        sources += [source for _, source in angles or () if isinstance(source, SignalSource)]
        return {source.signal.partition(".")[0] for source in sources if source is not None}

    def quantities(self) -> dict[str, MappedQuantity]:
        """All mapped quantities by path, such as ``attitude.euler.roll``."""
        return {".".join(map(str, each.location)): each for each in _quantities(self, ())}


def _quantities(
    mapped: Any, location: tuple[str, ...], dimension: Dimension | None = None
) -> Iterator[MappedQuantity]:
    """Yield the quantities of a part of the map; a key has the dimension with which it is annotated."""
    if isinstance(mapped, ModeMap | AlignmentMap | SequenceMap):
        bits = None if isinstance(mapped, SequenceMap) else mapped.bits
        mapped = mapped.signal and SignalSource(signal=mapped.signal, bits=bits)
        dimension = Dimension.NUMBER
    if isinstance(mapped, str) and dimension is not None:
        mapped = SignalSource(signal=mapped)
    if isinstance(mapped, SignalSource):
        if dimension is None:
            raise TypeError(f"the key {'.'.join(location)} is annotated with no Dimension")
        yield MappedQuantity(location, mapped, dimension)
    elif isinstance(mapped, dict):
        for name, signal in mapped.items():
            yield from _quantities(signal, (*location, name), dimension)
    elif isinstance(mapped, StrictModel):
        for name, field in type(mapped).model_fields.items():
            own = next((each for each in field.metadata if isinstance(each, Dimension)), dimension)
            yield from _quantities(getattr(mapped, name), (*location, name), own)


@dataclass(frozen=True)
class BoundSignal:
    """The signal of a quantity, and the linear conversion of its DBC value to SI."""

    message: str
    arbitration_id: int  #: Identifier of the message, as in frames.
    signal: Signal
    decode: Callable[[bytes], float]  #: Decodes the signal of one payload to the DBC's unit.
    gain: float  #: Factor from the DBC's unit to SI.
    offset: float  #: Added after the gain, SI.
    saturates: bool  #: Whether a value at an end of its range is NaN.
    bits: tuple[int, int] | None  #: First and last bit of the raw value that hold the quantity; None for all.

    def to_si(self, physical: FloatArray | float) -> FloatArray:
        """Convert one or more values in the DBC's unit to SI; NaN where the signal is saturated."""
        physical = physical if self.bits is None else self._bit_field(physical)
        values = np.asarray(physical * self.gain + self.offset, np.float64)
        if self.saturates:
            low, high = self._limits
            values = np.where((physical > low) & (physical < high), values, np.nan)
        return values

    @cached_property
    def decode_si(self) -> Callable[[bytes], float]:
        """Function that decodes the value of one payload to SI; see :meth:`to_si`."""
        decode, gain, offset = self.decode, self.gain, self.offset
        if self.bits is not None:
            return lambda data: float(self.to_si(decode(data)))
        if not self.saturates:
            return lambda data: decode(data) * gain + offset
        low, high = self._limits
        return lambda data: gain * physical + offset if low < (physical := decode(data)) < high else math.nan

    def _bit_field(self, physical: FloatArray | float) -> FloatArray:
        """Value of the bits of the raw value; NaN for NaN."""
        assert self.bits is not None  # noqa: S101 - the caller checks
        first, last = self.bits
        raw = np.rint((physical - self.signal.offset) / self.signal.scale)
        is_finite = np.isfinite(raw)
        field = np.where(is_finite, raw, 0.0).astype(np.int64) >> first & ((1 << (last - first + 1)) - 1)
        return np.where(is_finite, field, np.nan)

    @cached_property
    def _limits(self) -> tuple[float, float]:
        """Range of valid values in the DBC's unit."""
        signal = self.signal
        low, high = -np.inf, np.inf
        if not signal.conversion.is_float:
            first = -(2 ** (signal.length - 1)) if signal.is_signed else 0
            ends = [signal.offset + signal.scale * raw for raw in (first, first + 2**signal.length - 1)]
            # Half a step inwards, since the value at the end may be rounded.
            low, high = min(ends) + abs(signal.scale) / 2.0, max(ends) - abs(signal.scale) / 2.0
        if signal.minimum is not None and signal.maximum is not None and signal.minimum < signal.maximum:
            margin = abs(signal.scale) / 2.0 if not signal.conversion.is_float else 0.0
            low = max(low, float(signal.minimum) + margin)
            high = min(high, float(signal.maximum) - margin)
        return low, high

    @property
    def lsb(self) -> float:
        """Resolution of an integer signal, in SI; zero for a floating-point signal."""
        if self.bits is not None:
            return abs(self.gain)
        return 0.0 if self.signal.conversion.is_float else abs(self.signal.scale * self.gain)

    @cached_property
    def modulus(self) -> float:
        """Value at which an integer signal wraps, in SI; infinite for a floating-point signal."""
        if self.bits is not None:
            return self.lsb * 2.0 ** (self.bits[1] - self.bits[0] + 1)
        return np.inf if self.signal.conversion.is_float else self.lsb * 2.0**self.signal.length


def bind_signals(signal_map: SignalMap, codec: DbcCodec) -> dict[str, BoundSignal]:
    """Bind each mapped quantity to its signal, by the path of :meth:`SignalMap.quantities`.

    Raises DocumentError if a message or signal does not exist, its unit can't be converted, or it is mapped
    twice; the message lists all problems.
    """
    bound, problems = _bind(signal_map, codec)
    if problems:
        raise DocumentError("\n".join(f"ins.signals.{problem.text}" for problem in problems))
    return bound


def check_signals(signal_map: SignalMap, codec: DbcCodec, location: KeyPath = ()) -> list[DocumentProblem]:
    """Find the problems that :func:`bind_signals` raises; ``location`` is that of the map in its file."""
    problems = _bind(signal_map, codec)[1]
    return [DocumentProblem((*location, *each.location), each.message) for each in problems]


def _bind(signal_map: SignalMap, codec: DbcCodec) -> tuple[dict[str, BoundSignal], list[DocumentProblem]]:
    bound: dict[str, BoundSignal] = {}
    problems: list[DocumentProblem] = []
    for path, quantity in signal_map.quantities().items():
        try:
            bound[path] = _bind_one(quantity, codec)
        except DocumentError as error:
            problems.append(DocumentProblem(quantity.location, str(error)))
    problems += _doubly_mapped(signal_map)
    listed = signal_map.epoch_messages or []
    missing = sorted(name for name in signal_map.messages_of_epoch() - {*listed} if name in codec)
    if listed and missing:
        problems.append(DocumentProblem(("epoch_messages",), f"epoch_messages lacks {', '.join(missing)}"))
    for index, name in enumerate(listed):
        try:
            codec.arbitration_id(name)
        except DocumentError as error:
            problems.append(DocumentProblem(("epoch_messages", index), str(error)))
    return bound, problems


#: Roles that may share a signal with others: one status signal may hold several states.
_SHAREABLE_ROLES = ("mode", "alignment", "identity")
#: Largest number of bits of an integer that float64 represents exactly.
_MAX_EXACT_BITS = 52
#: Quantities that every epoch or sample has, which a multiplexed signal lacks in most of its frames.
_OF_EPOCH = (
    "velocity_east", "velocity_north", "epoch_counter", "attitude.quaternion", "increments",
    "attitude.euler.roll", "attitude.euler.pitch", "attitude.euler.yaw",
)  # fmt: skip


def _doubly_mapped(signal_map: SignalMap) -> list[DocumentProblem]:
    """Find measured quantities whose signal, or some bits of it, is already mapped to another role."""
    quantities = signal_map.quantities()
    sensors: dict[str, set[str]] = {}
    for path, quantity in quantities.items():
        if quantity.dimension is Dimension.TEMPERATURE:
            sensors.setdefault(path.partition(".")[0], set()).add(quantity.source.signal)
    roles_by_signal: dict[str, list[tuple[int, float, str]]] = {}
    problems = []
    for path, quantity in quantities.items():
        role = path.partition(".")[0]
        if role in sensors:  # a single sensor may be mapped to all three gyros, and to the case
            role = "temperature" if len(sensors[role]) == 1 else path
        elif role not in _SHAREABLE_ROLES:
            role = path
        low, high = quantity.source.bits or (0, math.inf)
        earlier = roles_by_signal.setdefault(quantity.source.signal, [])
        first = next((each for a, b, each in earlier if each != role and a <= high and low <= b), role)
        earlier.append((low, high, role))
        is_measured = quantity.dimension is not Dimension.NUMBER or path.startswith("attitude.quaternion.")
        if first != role and is_measured:
            problem = (
                f"the signal {quantity.source.signal} is already mapped to {first}. Each quantity has its "
                "separate signal: correct one of the two"
            )
            problems.append(DocumentProblem(quantity.location, problem))
    return problems


def _bind_one(quantity: MappedQuantity, codec: DbcCodec) -> BoundSignal:
    message, _, name = quantity.source.signal.partition(".")
    signal = codec.signal(message, name)
    gain, offset = _gain_and_offset(quantity, signal)
    factor, bits = quantity.source.sign * quantity.source.scale, quantity.source.bits
    if signal.multiplexer_ids is not None and ".".join(map(str, quantity.location)).startswith(_OF_EPOCH):
        raise DocumentError(f"the signal {quantity.source.signal} is multiplexed. Map one that is not")
    if bits is not None and not (bits[0] <= bits[1] < min(signal.length, _MAX_EXACT_BITS)):
        found = f"bits {bits[0]} to {bits[1]} are no part of them"
        raise DocumentError(f"the signal {quantity.source.signal} has bits 0 to {signal.length - 1}; {found}")
    if bits is not None and signal.conversion.is_float:
        raise DocumentError(f"the signal {quantity.source.signal} is floating-point and has no bit fields")
    is_sensor = quantity.location[0] == "increments" and quantity.dimension is not Dimension.NUMBER
    saturates = bits is None and (is_sensor or quantity.dimension in (Dimension.SPEED, Dimension.TEMPERATURE))
    return BoundSignal(
        message, codec.arbitration_id(message), signal, codec.decoder(message, name),
        factor * gain, factor * offset, saturates, bits,
    )  # fmt: skip


def _gain_and_offset(quantity: MappedQuantity, signal: Signal) -> tuple[float, float]:
    allowed = UNITS.get(quantity.dimension)
    if allowed is None:
        return 1.0, 0.0
    unit = quantity.source.unit if quantity.source.unit is not None else (signal.unit or "")
    conversion = allowed.get(usual_spelling(unit.strip()))
    if conversion is None:
        raise DocumentError(
            f"the signal {quantity.source.signal} has the unit '{unit}', not a unit of {quantity.dimension} "
            f"({', '.join(allowed)}). Give the unit with the keys 'unit' and 'scale' beside 'signal'."
        )
    return conversion
