"""Commands of the INS as CAN frames (the station file's ``ins.commands``).

A command is a message of the DBC and the values of its signals. The placeholders ``$sequence``, ``$on``,
``$axis``, ``$index`` and ``$value`` are replaced by values when the command is sent. The numbers of a
:class:`~gyrobench.drivers.ins.compensation.Compensation` are sent one by one.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Self

import can
import numpy as np
from pydantic import Field, model_validator

from gyrobench.bench.foundations.documents import DocumentProblem, StrictModel
from gyrobench.bench.foundations.errors import DocumentError
from gyrobench.bench.foundations.yaml_nodes import KeyPath
from gyrobench.drivers.frames import EXTENDED_ID
from gyrobench.drivers.ins.attitude import EulerSequence
from gyrobench.drivers.ins.compensation import CORRECTION_SIZE, TERMS, Compensation, correction_axes
from gyrobench.drivers.ins.dbc_codec import DbcCodec


class Command(StrictModel):
    """A message and the values of its signals, in the DBC's units."""

    message: str = Field(description="message of the DBC")
    values: dict[str, float | str] = Field(description="value of each of its signals")

    def frame(self, codec: DbcCodec, placeholders: Mapping[str, float]) -> can.Message:
        """Build the frame, with ``placeholders``: the value of each placeholder by its name."""
        values = {
            name: placeholders[value] if isinstance(value, str) else value
            for name, value in self.values.items()
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
    """Indices of the terms beyond the polynomial, named as in compensation.yaml."""

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
    def _check_terms_complete(self) -> Self:
        for name, companions in _REQUIRED_WITH.items():
            missing = [other for other in companions if getattr(self, other) is None]
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
    """First of the eight indices of each other coefficient of a sensor: T^0 to T^3, rate, x, y, z of Up."""

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

    def first_indices(self) -> list[int]:
        """First indices of all coefficients of one axis, in the order of the keys."""
        return [*self.gyro, self.accelerometer_bias, *self.accelerometer]

    def indices(self) -> list[int]:
        """Indices of all numbers of these coefficients, without their limits."""
        return [first + offset for first in self.first_indices() for offset in range(CORRECTION_SIZE)]

    def limits_of(self, compensation: Compensation) -> dict[int, int]:
        """Index of each coefficient's lowest temperature, by its first index; empty if none has limits."""
        is_used = any(each.range_c is not None for each in compensation.coefficients.values())
        if self.limits is None or not is_used:
            return {}
        return {first: self.limits + 2 * order for order, first in enumerate(self.first_indices())}


def _index_list(index: int | list[int] | None) -> list[int]:
    return [] if index is None else index if isinstance(index, list) else [index]


#: Number of temperature limits of all coefficients in :class:`CorrectionIndices`.
_LIMIT_COUNT = 14
#: Largest errors by rounding in the signals: of a polynomial, deg/h; of another number, relative.
_MAX_ROUNDING_DPH, _MAX_RELATIVE_ROUNDING = 1e-4, 0.01
#: Distance from its limits at which a compensation is evaluated to show the extrapolation, K.
_EXTRAPOLATION_K = 10.0
#: Relative rounding error of a 32-bit floating-point number, rounded up.
_FLOAT32_ROUNDING = 1e-6


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
    def _check_indices_unique(self) -> Self:
        keys = [f"T^{index}" for index in range(self.coefficients)]
        key_by_index = dict(enumerate(keys))
        indices = {"lowest_index": self.lowest_index, "highest_index": self.highest_index, **dict(self.terms)}
        key_indices = [(key, each) for key, index in indices.items() for each in _index_list(index)]
        if self.others is not None:
            key_indices += [("others", each) for each in self.others.indices()]
            first = self.others.limits
            key_indices += [
                ("others.limits", first + each) for each in range(_LIMIT_COUNT) if first is not None
            ]
        for key, index in key_indices:
            if index in key_by_index:
                raise ValueError(
                    f"{key} and {key_by_index[index]} both have the index {index}: each number needs its own"
                )
            key_by_index[index] = key
        return self

    def supported_terms(self) -> list[str]:
        """Names of the terms that the INS supports."""
        return [term for term, name in TERMS.items() if getattr(self.terms, name) is not None]

    def unsupported(self, compensation: Compensation) -> list[str]:
        """Parts of a compensation that the INS does not support, as text."""
        supported = self.supported_terms()
        supported += compensation.corrections_in_use() if self.others is not None else ()
        parts = [term for term in compensation.terms() if term not in supported]
        if self.others is not None and self.others.limits is None:
            for name in compensation.corrections_in_use():
                axis = correction_axes(name)[1]
                if compensation.coefficients[name].exceeds(
                    compensation.low_c[axis], compensation.high_c[axis]
                ):
                    parts.append(f"temperature limits of {name}")
        degree = int(np.flatnonzero(compensation.polynomial_dph.any(axis=0)).max(initial=0))
        if degree >= self.coefficients:
            parts.insert(0, f"a polynomial of degree {degree}")
        return parts

    def extrapolation(self, compensation: Compensation) -> str:
        """Describe how far an INS without the temperature limits may extrapolate; empty if it gets them.

        A clause for a sentence or a note.
        """
        missing = [key for key in ("lowest_index", "highest_index") if getattr(self, key) is None]
        if not missing or not compensation.polynomial_dph[:, 1:].any():
            return ""
        beyond_dph = max(
            abs(np.polyval(row[::-1], limit_c + offset_k) - np.polyval(row[::-1], limit_c))
            for limits, offset_k in (
                (compensation.low_c, -_EXTRAPOLATION_K),
                (compensation.high_c, _EXTRAPOLATION_K),
            )
            for row, limit_c in zip(compensation.polynomial_dph, limits, strict=True)
        )
        return (
            f"the INS does not get the temperature limits ({' and '.join(missing)} of load_compensation): "
            f"{_EXTRAPOLATION_K:g} K outside {compensation.low_c.min():z.0f} to "
            f"{compensation.high_c.max():z.0f} °C it may subtract {beyond_dph:.2g} deg/h more or less than "
            "was measured at the limit"
        )

    def altered_numbers(self, codec: DbcCodec, compensation: Compensation) -> list[str]:
        """Numbers of a compensation that the signals would clip or round too much, as text.

        Rounding may change the polynomial by at most 1e-4 deg/h and any other number by at most 1 %.
        """
        signals = {value: name for name, value in self.values.items() if isinstance(value, str)}
        decoders = {each: codec.decoder(self.message, name) for each, name in signals.items()}
        altered = []
        for axis, numbers in enumerate(self.numbers(compensation)):
            hottest_c = max(abs(compensation.low_c[axis]), abs(compensation.high_c[axis]), 1.0)
            error_dph = size_dph = 0.0
            for index, value in numbers.items():
                intended = {"$axis": float(axis), "$index": float(index), "$value": float(value)}
                data = bytes(self.frame(codec, intended).data)
                sent = {name: decode(data) for name, decode in decoders.items()}
                error = abs(sent.get("$value", value) - value)
                if index < self.coefficients:
                    error_dph += error * hottest_c**index
                    size_dph += abs(value) * hottest_c**index
                is_altered = index >= self.coefficients and error > _MAX_RELATIVE_ROUNDING * abs(value)
                if is_altered or any(
                    sent.get(name, intended[name]) != intended[name] for name in ("$axis", "$index")
                ):
                    altered.append(f"the number {index} of the {'xyz'[axis]} axis")
            if error_dph > max(_MAX_ROUNDING_DPH, _FLOAT32_ROUNDING * size_dph):
                altered.append(f"the polynomial of the {'xyz'[axis]} gyro ({error_dph:.2g} deg/h are lost)")
        return altered

    def numbers(self, compensation: Compensation) -> list[dict[int, float]]:
        """Numbers of a compensation by index, one dictionary for each gyro, in the order of the indices."""
        return [self._numbers(compensation, axis) for axis in range(3)]

    def _numbers(self, compensation: Compensation, axis: int) -> dict[int, float]:
        coefficients = compensation.polynomial_dph[axis, : self.coefficients]
        numbers = dict.fromkeys(range(self.coefficients), 0.0) | dict(enumerate(coefficients))
        indices = {"low_c": self.lowest_index, "high_c": self.highest_index, **dict(self.terms)}
        for name, index in indices.items():
            if index is not None:
                values = np.atleast_1d(getattr(compensation, name)[axis])
                numbers.update(zip(np.atleast_1d(index).tolist(), values.tolist(), strict=True))
        if self.others is not None and compensation.corrections_in_use():
            numbers |= dict.fromkeys(self.others.indices(), 0.0)
            limits = self.others.limits_of(compensation)
            numbers |= dict.fromkeys(limits.values(), 0.0) | dict.fromkeys(
                (i + 1 for i in limits.values()), 0.0
            )
            for name, each in compensation.coefficients.items():
                sensor, sensor_axis, sensed = correction_axes(name)
                if sensor_axis == axis:
                    row = self.others.gyro if sensor == "gyro" else self.others.accelerometer
                    first = self.others.accelerometer_bias if sensed is None else row[sensed]
                    numbers |= dict(enumerate(each.numbers().tolist(), first))
                    if each.range_c is not None and first in limits:
                        numbers |= dict(enumerate(each.range_c, limits[first]))
        return dict(sorted(numbers.items()))


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


_PLACEHOLDERS = {
    "set_euler_sequence": {"$sequence"},
    "send_increments": {"$on"},
    "load_compensation": {"$axis", "$index", "$value"},
}


def check_commands(commands: CommandMap, codec: DbcCodec, location: KeyPath = ()) -> list[DocumentProblem]:
    """Find the problems of a command map with a DBC; ``location`` is that of the map in its file."""
    problems = []
    for name in CommandMap.model_fields:
        command: Command | None = getattr(commands, name)
        if command is None:
            continue
        placeholders = _PLACEHOLDERS.get(name, set())
        used = {value for value in command.values.values() if isinstance(value, str)}
        if missing := sorted(placeholders - used):
            problems.append(
                DocumentProblem(
                    (*location, name, "values"), f"no signal has {', '.join(missing)}: give it to one"
                )
            )
        for signal, value in command.values.items():
            value_location = (*location, name, "values", signal)
            if isinstance(value, str) and value not in placeholders:
                allowed = f"a number or {', '.join(sorted(placeholders))}" if placeholders else "a number"
                problems.append(DocumentProblem(value_location, f"expected {allowed}; found '{value}'"))
            try:
                codec.signal(command.message, signal)
            except DocumentError as error:
                problems.append(DocumentProblem(value_location, str(error)))
    return problems
