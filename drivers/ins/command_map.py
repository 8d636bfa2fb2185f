"""Commands of the INS as CAN frames (the station file's ``ins.commands``), and the compensation they load.

A command is a message of the DBC and the values of its signals; ``$sequence``, ``$on``, ``$axis``, ``$index``
and ``$value`` stand for values that are known when it is sent.

A compensation is what the INS subtracts from its gyros: a polynomial in temperature, and physical terms.
With the temperature T of a gyro's optics, B of its electronics (board), and the unit vector Up in body
axes, the bias of gyro i is::

    polynomial_i(T)
    + rate_i dT/dt
    + gradient_i (B - T)
    + (saturating_i . Up) (B - T) / (1 + exp(-c))           c = (onset_i - T) / width_i
    + (growing_i . Up) (B - T) ln(1 + exp(c))
    + gravity_i . Up
    + warm_up_i exp(-t / tau_i)                             t: time since power-on
    + hysteresis_i (play_i(T) - T)

Any other coefficient of gyro and accelerometer i is::

    polynomial(T) + rate dT/dt + gravity . Up

Nothing is extrapolated: T, dT/dt and B - T are clipped to the fitted ranges. Other coefficients may have been
measured over fewer temperatures than the biases, and clip T to separate limits.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, fields
from types import MappingProxyType
from typing import Annotated, Self

import can
import numpy as np
from pydantic import Field, model_validator

from gyrobench.bench.foundations.arrays import BoolArray, FloatArray
from gyrobench.bench.foundations.documents import DocumentProblem, KeyPath, StrictModel
from gyrobench.bench.foundations.errors import DocumentError, MeasurementError
from gyrobench.drivers.frames import EXTENDED_ID
from gyrobench.drivers.ins.attitude import EulerSequence
from gyrobench.drivers.ins.dbc_codec import DbcCodec

#: Terms beyond the polynomial: name of the effect, and name of its coefficients.
TERMS = MappingProxyType(
    {
        "temperature_rate": "rate_dph_per_c_per_h",
        "thermal_gradient": "gradient_dph_per_k",
        "attitude_thermal": "saturating_dph_per_k",
        "attitude_thermal_growing": "growing_dph_per_k",
        "g_sensitivity": "gravity_dph_per_g",
        "warm_up": "warm_up_dph",
        "thermal_hysteresis": "hysteresis_dph_per_k",
    }
)

#: Scale that must be above zero where a term is used, by the coefficients of the term.
_SCALES = {
    "rate_dph_per_c_per_h": "rate_limit_c_per_h",
    "saturating_dph_per_k": "onset_width_c",
    "growing_dph_per_k": "onset_width_c",
    "warm_up_dph": "warm_up_s",
    "hysteresis_dph_per_k": "half_width_k",
}
_ON_DIFFERENCE = ("gradient_dph_per_k", "saturating_dph_per_k", "growing_dph_per_k")
_VECTORS = ("saturating_dph_per_k", "growing_dph_per_k", "gravity_dph_per_g")


#: Highest degree of the polynomials of :class:`Correction`, and their numbers in an INS.
CORRECTION_DEGREE = 3
_CORRECTION_NUMBERS = CORRECTION_DEGREE + 5
#: Temperatures of the dwells of one plateau may be this far from their mean, K.
_NEARLY_K = 5.0


def _zeros() -> FloatArray:
    return np.zeros(3)


def _zero_vectors() -> FloatArray:
    return np.zeros((3, 3))


@dataclass(frozen=True, eq=False)
class Correction:
    """What an INS takes as one coefficient, in the unit of its kind: ppm, arcsec or ug.

    Raises MeasurementError if a number is not finite, or there are too many or too few.
    """

    polynomial: FloatArray  #: Shape (k,), k at most 4. From degree 0 up, T in degC.
    rate_per_c_per_h: float = 0.0  #: Per dT/dt.
    gravity_per_g: FloatArray = field(default_factory=_zeros)  #: Shape (3,). Vector in body axes.
    #: Lowest and highest T at which it was measured, within those of the gyro's bias; None for those.
    range_c: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        if self.range_c is not None:
            low_c, high_c = self.range_c
            if not -np.inf < low_c <= high_c < np.inf:
                raise MeasurementError("compensation: low_c of a coefficient must not be above its high_c")
        is_shaped = 1 <= self.polynomial.size <= CORRECTION_DEGREE + 1 and self.gravity_per_g.shape == (3,)
        if not is_shaped or not np.isfinite(self.numbers()).all():
            raise MeasurementError(
                f"compensation: a coefficient takes finite numbers, 1 to {CORRECTION_DEGREE + 1} of the "
                "polynomial and 3 along gravity"
            )

    def exceeds(self, low_c: float, high_c: float) -> bool:
        """Whether the range from ``low_c`` to ``high_c`` goes clearly beyond that of a curve over T."""
        if self.range_c is None or not self.polynomial[1:].any():
            return False
        return low_c < self.range_c[0] - _NEARLY_K or high_c > self.range_c[1] + _NEARLY_K

    def numbers(self) -> FloatArray:
        """All numbers (8,) but the range in the order of an INS: polynomial, rate, gravity along x, y, z."""
        polynomial = np.pad(self.polynomial, (0, CORRECTION_DEGREE + 1 - self.polynomial.size))
        return np.concatenate([polynomial, [self.rate_per_c_per_h], self.gravity_per_g])


@dataclass(frozen=True, eq=False)
class Compensation:
    """Numbers of a compensation, by gyro (first dimension: x, y, z), in the formula of this module.

    Raises MeasurementError if a number is not finite, an array has another shape, limits are in the wrong
    order, or a term that is used has no width, time constant or limits.
    """

    polynomial_dph: FloatArray  #: Shape (3, k). Coefficients from degree 0 up, T in degrees Celsius.
    #: low_c, high_c: Shape (3,). Range of T.
    low_c: FloatArray
    high_c: FloatArray
    #: rate_dph_per_c_per_h, rate_limit_c_per_h: Shape (3,). Coefficient of dT/dt, and the largest absolute
    #: dT/dt.
    rate_dph_per_c_per_h: FloatArray = field(default_factory=_zeros)
    rate_limit_c_per_h: FloatArray = field(default_factory=_zeros)
    gradient_dph_per_k: FloatArray = field(default_factory=_zeros)  #: Shape (3,). Coefficient of B - T.
    #: difference_low_k, difference_high_k: Shape (3,). Range of B - T.
    difference_low_k: FloatArray = field(default_factory=_zeros)
    difference_high_k: FloatArray = field(default_factory=_zeros)
    #: saturating_dph_per_k, growing_dph_per_k: Shape (3, 3). Vectors in body axes of each gyro: constant
    #: below the onset, and growing with falling T.
    saturating_dph_per_k: FloatArray = field(default_factory=_zero_vectors)
    growing_dph_per_k: FloatArray = field(default_factory=_zero_vectors)
    #: onset_c, onset_width_c: Shape (3,). Temperature below which Up acts with B - T, and the width of the
    #: onset.
    onset_c: FloatArray = field(default_factory=_zeros)
    onset_width_c: FloatArray = field(default_factory=_zeros)
    #: Shape (3, 3). Vector in body axes of each gyro.
    gravity_dph_per_g: FloatArray = field(default_factory=_zero_vectors)
    #: warm_up_dph, warm_up_s: Shape (3,). Value at power-on, and time constant.
    warm_up_dph: FloatArray = field(default_factory=_zeros)
    warm_up_s: FloatArray = field(default_factory=_zeros)
    #: hysteresis_dph_per_k, half_width_k: Shape (3,). Coefficient of the play's distance from T, and its half
    #: width.
    hysteresis_dph_per_k: FloatArray = field(default_factory=_zeros)
    half_width_k: FloatArray = field(default_factory=_zeros)
    #: Standard uncertainties of the numbers by name, in the shapes of these; those of a gyro are
    #: correlated. An INS does not get them.
    sigma: Mapping[str, FloatArray] = field(default_factory=dict)
    #: Other coefficients by name: ``gyro_scale_factor_x``, ``gyro_misalignment_xy``,
    #: ``accelerometer_bias_x``, ``accelerometer_scale_factor_x``, ``accelerometer_misalignment_yx``. T and
    #: dT/dt are those of the gyro along the sensor's axis, and clipped as for its bias; T also to the
    #: coefficient's ``range_c``.
    coefficients: Mapping[str, Correction] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name in NUMBERS:
            self._check_array(name, getattr(self, name))
        for name, value in self.sigma.items():
            self._check_array(name, value, "sigma of ")
            if value.shape != getattr(self, name).shape or (value < 0.0).any():
                raise MeasurementError(
                    f"compensation: sigma of {name} must have as many numbers as {name}, none below zero"
                )
        for low, high in (("low_c", "high_c"), ("difference_low_k", "difference_high_k")):
            if (getattr(self, low) > getattr(self, high)).any():
                raise MeasurementError(f"compensation: {low} must not be above {high}")
        for name, scale in _SCALES.items():
            if (_used(getattr(self, name)) & (getattr(self, scale) <= 0.0)).any():
                raise MeasurementError(f"compensation: {name} needs {scale} above zero")
        for name, each in self.coefficients.items():
            axis = _correction_place(name)[1]
            if each.rate_per_c_per_h and not self.rate_limit_c_per_h[axis] > 0.0:
                raise MeasurementError(
                    f"compensation: the rate of {name} needs rate_limit_c_per_h above zero"
                )
        no_range = self.difference_low_k == self.difference_high_k
        for name in _ON_DIFFERENCE:
            if (_used(getattr(self, name)) & no_range).any():
                raise MeasurementError(f"compensation: {name} needs difference_low_k below difference_high_k")

    def terms(self) -> tuple[str, ...]:
        """Names of the :data:`TERMS` that are used, and of the other coefficients."""
        used = (term for term, name in TERMS.items() if np.any(getattr(self, name)))
        return (*used, *self.corrected())

    def corrected(self) -> tuple[str, ...]:
        """Names of the other coefficients that are not zero."""
        return tuple(name for name, each in self.coefficients.items() if each.numbers().any())

    def is_like(self, other: Compensation) -> bool:
        """Whether an INS gets the same numbers."""
        names = self.corrected()
        return (
            all(np.array_equal(getattr(self, name), getattr(other, name)) for name in NUMBERS)
            and set(names) == set(other.corrected())
            and all(
                np.array_equal(self.coefficients[name].numbers(), other.coefficients[name].numbers())
                and self.coefficients[name].range_c == other.coefficients[name].range_c
                for name in names
            )
        )

    def _check_array(self, name: str, value: FloatArray, of: str = "") -> None:
        shape: tuple[int, ...] = (3, 3) if name in _VECTORS else (3,)
        if name == "polynomial_dph":
            shape = (3, value.shape[-1])
        if value.shape != shape or not value.size:
            raise MeasurementError(f"compensation: {of}{name} has the shape {value.shape}, not {shape}")
        if not np.isfinite(value).all():
            raise MeasurementError(
                f"compensation: {of}{name} must hold finite numbers; found {value.tolist()}"
            )


#: Names of the numbers of a compensation.
NUMBERS = tuple(each.name for each in fields(Compensation) if each.name not in {"sigma", "coefficients"})
_SENSORS = {
    "gyro": ("scale_factor", "misalignment"),
    "accelerometer": ("bias", "scale_factor", "misalignment"),
}


def _correction_place(name: str) -> tuple[str, int, int | None]:
    """Sensor, its axis (0 for x), and the axis that a coefficient makes it sense; None for a bias.

    Raises MeasurementError if the name is not that of a coefficient.
    """
    sensor, _, rest = name.partition("_")
    kind, _, axes = rest.rpartition("_")
    places = ["xyz".find(axis) for axis in axes]
    is_pair = kind == "misalignment"
    if (
        kind not in _SENSORS.get(sensor, ())
        or -1 in places
        or len(places) != 1 + is_pair
        or (is_pair and places[0] == places[1])
    ):
        raise MeasurementError(f"compensation: {name} is not a coefficient")
    return sensor, places[0], None if kind == "bias" else places[-1]


def checksum(numbers: Iterable[float]) -> int:
    """CRC-32 of numbers as the INS stores them: little-endian 32-bit floats."""
    return zlib.crc32(b"".join(struct.pack("<f", number) for number in numbers))


def _used(coefficients: FloatArray) -> BoolArray:
    return np.asarray(np.any(coefficients.reshape(3, -1) != 0.0, axis=1))


class Command(StrictModel):
    """A message and the values of its signals, in the DBC's units."""

    message: str = Field(description="message of the DBC")
    values: dict[str, float | str] = Field(description="value of each of its signals")

    def frame(self, codec: DbcCodec, given: Mapping[str, float]) -> can.Message:
        """Build the frame, with ``given`` values for the placeholders."""
        values = {
            name: given[value] if isinstance(value, str) else value for name, value in self.values.items()
        }
        identifier = codec.arbitration_id(self.message)
        return can.Message(
            arbitration_id=identifier & ~EXTENDED_ID,
            is_extended_id=bool(identifier & EXTENDED_ID),
            data=codec.encode(self.message, values)[0].tobytes(),
        )


class SequenceCommand(Command):
    """Sets the Euler sequence, ``$sequence``."""

    rpy_321: int = Field(0, description="the INS's number for roll, pitch, yaw")
    pry_231: int = Field(1, description="the INS's number for pitch, roll, yaw")

    def number(self, sequence: EulerSequence) -> int:
        """Look up the INS's number for a sequence."""
        return self.rpy_321 if sequence is EulerSequence.RPY_321 else self.pry_231


IntVector = Annotated[list[int], Field(min_length=3, max_length=3)]


class TermIndices(StrictModel):
    """Indices of the terms beyond the polynomial, named as in :class:`Compensation`."""

    rate_dph_per_c_per_h: int | None = Field(None, description="index: rate of the temperature")
    rate_limit_c_per_h: int | None = Field(None, description="index: highest rate used")
    gradient_dph_per_k: int | None = Field(None, description="index: electronics above optics")
    difference_low_k: int | None = Field(None, description="index: lowest difference used")
    difference_high_k: int | None = Field(None, description="index: highest difference used")
    saturating_dph_per_k: IntVector | None = Field(
        None, description="indices: difference along Up, below the onset"
    )
    growing_dph_per_k: IntVector | None = Field(
        None, description="indices: difference along Up, the more the colder"
    )
    onset_c: int | None = Field(None, description="index: temperature of the onset")
    onset_width_c: int | None = Field(None, description="index: width of the onset")
    gravity_dph_per_g: IntVector | None = Field(None, description="indices: gravity along x, y, z")
    warm_up_dph: int | None = Field(None, description="index: bias at power-on")
    warm_up_s: int | None = Field(None, description="index: time constant of the warm-up")
    hysteresis_dph_per_k: int | None = Field(None, description="index: play of the temperature")
    half_width_k: int | None = Field(None, description="index: half width of the play")

    @model_validator(mode="after")
    def _whole_terms(self) -> Self:
        for name, others in _REQUIRED_WITH.items():
            missing = [other for other in others if getattr(self, other) is None]
            if getattr(self, name) is not None and missing:
                raise ValueError(f"{name} needs {' and '.join(missing)} too")
        return self


_REQUIRED_WITH = {
    "saturating_dph_per_k": ("onset_c", "onset_width_c"),
    "growing_dph_per_k": ("onset_c", "onset_width_c"),
    "warm_up_dph": ("warm_up_s",),
    "hysteresis_dph_per_k": ("half_width_k",),
}


class CorrectionIndices(StrictModel):
    """First of the eight indices of each other coefficient of a sensor: see :meth:`Correction.numbers`."""

    gyro: IntVector = Field(description="first indices: how much the gyro senses of rates about x, y, z")
    accelerometer_bias: int = Field(description="first index: bias of the accelerometer")
    accelerometer: IntVector = Field(
        description="first indices: how much the accelerometer senses of forces along x, y, z"
    )
    limits: int | None = Field(
        None,
        description="first of the 14 indices of the temperatures between which each is valid, lowest and "
        "highest: in the order of the keys above; 0 and 0 where those of the gyro's bias are",
    )

    def first(self, sensor: str, sensed: int | None) -> int:
        """First index of a coefficient."""
        if sensed is None:
            return self.accelerometer_bias
        return (self.gyro if sensor == "gyro" else self.accelerometer)[sensed]

    def firsts(self) -> list[int]:
        """First indices of all coefficients of a sensor's axis, in the order of the keys."""
        return [*self.gyro, self.accelerometer_bias, *self.accelerometer]


def _as_list(index: int | list[int] | None) -> list[int]:
    return [] if index is None else index if isinstance(index, list) else [index]


#: Indices of the limits of all coefficients in :class:`CorrectionIndices`.
_LIMITS = 14
#: What signals of too few bits may take off a polynomial, deg/h, and off other numbers, relative.
_MAX_LOST_DPH, _MAX_LOST = 1e-4, 0.01
#: Relative rounding of a floating-point number of 32 bits, rounded up.
_FLOAT32 = 1e-6


class CoefficientCommand(Command):
    """Loads one number of the compensation: ``$value`` at ``$index`` for the gyro ``$axis``.

    The coefficient of degree k in the temperature of the gyro's optics has the index k.
    """

    coefficients: int = Field(description="number of coefficients for a gyro")
    lowest_index: int | None = Field(None, description="index of the lowest temperature of validity")
    highest_index: int | None = Field(None, description="index of the highest temperature of validity")
    terms: TermIndices = Field(TermIndices(), description="indices of the terms beyond the polynomial")
    others: CorrectionIndices | None = Field(
        None,
        description="first of the eight indices of other coefficients: of T^0 to T^3, rate, x, y, z of Up",
    )

    @model_validator(mode="after")
    def _one_number_each(self) -> Self:
        keys = [f"T^{index}" for index in range(self.coefficients)]
        places = dict(enumerate(keys))
        indices = {"lowest_index": self.lowest_index, "highest_index": self.highest_index, **dict(self.terms)}
        named = [(key, each) for key, index in indices.items() for each in _as_list(index)]
        if self.others is not None:
            named += [("others", each) for each in self._indices_of_others(self.others)]
            first = self.others.limits
            named += [("others.limits", first + each) for each in range(_LIMITS) if first is not None]
        for key, index in named:
            if index in places:
                raise ValueError(
                    f"{key} and {places[index]} both have the index {index}: each number needs its own"
                )
            places[index] = key
        return self

    def supported_terms(self) -> list[str]:
        """Names of the terms that the INS supports."""
        return [term for term, name in TERMS.items() if getattr(self.terms, name) is not None]

    def unsupported(self, compensation: Compensation) -> list[str]:
        """Parts of a compensation that the INS does not support, in words."""
        supported = self.supported_terms()
        supported += compensation.corrected() if self.others is not None else ()
        parts = [term for term in compensation.terms() if term not in supported]
        if self.others is not None and self.others.limits is None:
            for name in compensation.corrected():
                axis = _correction_place(name)[1]
                if compensation.coefficients[name].exceeds(
                    compensation.low_c[axis], compensation.high_c[axis]
                ):
                    parts.append(f"temperature limits of {name}")
        degree = int(np.flatnonzero(compensation.polynomial_dph.any(axis=0)).max(initial=0))
        if degree >= self.coefficients:
            parts.insert(0, f"a polynomial of degree {degree}")
        return parts

    def altered(self, codec: DbcCodec, compensation: Compensation) -> list[str]:
        """Numbers of a compensation that the signals can't carry, in words: clipped, or rounded too much.

        A polynomial's numbers may lose as much together as changes a bias by 1e-4 deg/h, others a hundredth.
        """
        signals = {value: name for name, value in self.values.items() if isinstance(value, str)}
        decoders = {given: codec.decoder(self.message, name) for given, name in signals.items()}
        found = []
        for axis, numbers in enumerate(self.numbers(compensation)):
            hottest_c = max(abs(compensation.low_c[axis]), abs(compensation.high_c[axis]), 1.0)
            lost_dph = size_dph = 0.0
            for index, value in numbers.items():
                given = {"$axis": float(axis), "$index": float(index), "$value": float(value)}
                data = bytes(self.frame(codec, given).data)
                sent = {name: decode(data) for name, decode in decoders.items()}
                lost = abs(sent.get("$value", value) - value)
                if index < self.coefficients:
                    lost_dph += lost * hottest_c**index
                    size_dph += abs(value) * hottest_c**index
                is_lost = index >= self.coefficients and lost > _MAX_LOST * abs(value)
                if is_lost or any(sent.get(name, given[name]) != given[name] for name in ("$axis", "$index")):
                    found.append(f"the number {index} of the {'xyz'[axis]} axis")
            if lost_dph > max(_MAX_LOST_DPH, _FLOAT32 * size_dph):
                found.append(f"the polynomial of the {'xyz'[axis]} gyro ({lost_dph:.2g} deg/h are lost)")
        return found

    def numbers(self, compensation: Compensation) -> list[dict[int, float]]:
        """Numbers of each gyro by index, in the order of the indices."""
        return [self._numbers(compensation, axis) for axis in range(3)]

    def _numbers(self, compensation: Compensation, axis: int) -> dict[int, float]:
        coefficients = compensation.polynomial_dph[axis, : self.coefficients]
        numbers = dict.fromkeys(range(self.coefficients), 0.0) | dict(enumerate(coefficients))
        indices = {"low_c": self.lowest_index, "high_c": self.highest_index, **dict(self.terms)}
        for name, index in indices.items():
            if index is not None:
                values = np.atleast_1d(getattr(compensation, name)[axis])
                numbers.update(zip(np.atleast_1d(index).tolist(), values.tolist(), strict=True))
        if self.others is not None and compensation.corrected():
            numbers |= dict.fromkeys(self._indices_of_others(self.others), 0.0)
            limits = self._limits(self.others, compensation)
            numbers |= dict.fromkeys(limits.values(), 0.0) | dict.fromkeys(
                (i + 1 for i in limits.values()), 0.0
            )
            for name, each in compensation.coefficients.items():
                sensor, sensor_axis, sensed = _correction_place(name)
                if sensor_axis == axis:
                    first = self.others.first(sensor, sensed)
                    numbers |= dict(enumerate(each.numbers().tolist(), first))
                    if each.range_c is not None and first in limits:
                        numbers |= dict(enumerate(each.range_c, limits[first]))
        return dict(sorted(numbers.items()))

    @staticmethod
    def _indices_of_others(others: CorrectionIndices) -> list[int]:
        return [first + place for first in others.firsts() for place in range(_CORRECTION_NUMBERS)]

    @staticmethod
    def _limits(others: CorrectionIndices, compensation: Compensation) -> dict[int, int]:
        """Index of the lowest temperature of each coefficient, by its first index; none where unused."""
        is_used = any(each.range_c is not None for each in compensation.coefficients.values())
        if others.limits is None or not is_used:
            return {}
        return {first: others.limits + 2 * place for place, first in enumerate(others.firsts())}


class CommandMap(StrictModel):
    """Commands of the INS."""

    standby: Command | None = Field(None, description="leaves navigation")
    align: Command | None = Field(None, description="begins an alignment")
    navigate: Command | None = Field(None, description="begins to navigate")
    set_euler_sequence: SequenceCommand | None = Field(
        None, description="chooses the sequence of the Euler angles"
    )
    send_increments: Command | None = Field(
        None, description="begins, `$on` 1, or stops, 0, to send the increments of signals.increments"
    )
    clear_compensation: Command | None = Field(None, description="erases the compensation")
    load_compensation: CoefficientCommand | None = Field(
        None, description="loads one number of a compensation"
    )
    apply_compensation: Command | None = Field(None, description="puts the loaded compensation into use")


_GIVEN = {
    "set_euler_sequence": {"$sequence"},
    "send_increments": {"$on"},
    "load_compensation": {"$axis", "$index", "$value"},
}


def check_commands(commands: CommandMap, codec: DbcCodec, at: KeyPath = ()) -> list[DocumentProblem]:
    """Problems with the DBC of a map that is at ``at`` in its file."""
    problems = []
    for name in CommandMap.model_fields:
        command: Command | None = getattr(commands, name)
        if command is None:
            continue
        given = _GIVEN.get(name, set())
        if lacking := sorted(given - {value for value in command.values.values() if isinstance(value, str)}):
            problems.append(
                DocumentProblem((*at, name, "values"), f"no signal has {', '.join(lacking)}: give it to one")
            )
        for signal, value in command.values.items():
            here = (*at, name, "values", signal)
            if isinstance(value, str) and value not in given:
                known = f"a number or {', '.join(sorted(given))}" if given else "a number"
                problems.append(DocumentProblem(here, f"expected {known}; found '{value}'"))
            try:
                codec.signal(command.message, signal)
            except DocumentError as error:
                problems.append(DocumentProblem(here, str(error)))
    return problems
