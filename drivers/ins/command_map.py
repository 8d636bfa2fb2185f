"""Commands of the INS as CAN frames (the station file's ``ins.commands``).

A command is a message of the DBC and the values of its signals; ``$sequence``, ``$on``, ``$axis``, ``$index``
and ``$value`` stand for values that are known when it is sent. Those of a
:class:`~gyrobench.drivers.ins.compensation.Compensation` are sent one by one.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Self

import can
import numpy as np
from pydantic import Field, model_validator

from gyrobench.bench.foundations.documents import DocumentProblem, KeyPath, StrictModel
from gyrobench.bench.foundations.errors import DocumentError
from gyrobench.drivers.frames import EXTENDED_ID
from gyrobench.drivers.ins.attitude import EulerSequence
from gyrobench.drivers.ins.compensation import CORRECTION_NUMBERS, TERMS, Compensation, correction_place
from gyrobench.drivers.ins.dbc_codec import DbcCodec


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

    def indices(self) -> list[int]:
        """Indices of all numbers of these coefficients but their limits."""
        return [first + place for first in self.firsts() for place in range(CORRECTION_NUMBERS)]

    def limits_of(self, compensation: Compensation) -> dict[int, int]:
        """Index of the lowest temperature of each coefficient, by its first index; none where unused."""
        is_used = any(each.range_c is not None for each in compensation.coefficients.values())
        if self.limits is None or not is_used:
            return {}
        return {first: self.limits + 2 * place for place, first in enumerate(self.firsts())}


def _as_list(index: int | list[int] | None) -> list[int]:
    return [] if index is None else index if isinstance(index, list) else [index]


#: Indices of the limits of all coefficients in :class:`CorrectionIndices`.
_LIMITS = 14
#: What signals of too few bits may take off a polynomial, deg/h, and off other numbers, relative.
_MAX_LOST_DPH, _MAX_LOST = 1e-4, 0.01
#: How far beyond its limits a compensation is evaluated, K, to state what an INS without them does there.
_BEYOND_K = 10.0
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
            named += [("others", each) for each in self.others.indices()]
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
                axis = correction_place(name)[1]
                if compensation.coefficients[name].exceeds(
                    compensation.low_c[axis], compensation.high_c[axis]
                ):
                    parts.append(f"temperature limits of {name}")
        degree = int(np.flatnonzero(compensation.polynomial_dph.any(axis=0)).max(initial=0))
        if degree >= self.coefficients:
            parts.insert(0, f"a polynomial of degree {degree}")
        return parts

    def extrapolation(self, compensation: Compensation) -> str:
        """What an INS that does not get the limits of temperature may subtract beyond them; empty with them.

        A clause, for a sentence or a note.
        """
        missing = [key for key in ("lowest_index", "highest_index") if getattr(self, key) is None]
        if not missing or not compensation.polynomial_dph[:, 1:].any():
            return ""
        beyond_dph = max(
            abs(np.polyval(row[::-1], at_c + off_k) - np.polyval(row[::-1], at_c))
            for limits, off_k in ((compensation.low_c, -_BEYOND_K), (compensation.high_c, _BEYOND_K))
            for row, at_c in zip(compensation.polynomial_dph, limits, strict=True)
        )
        return (
            f"the INS does not get the temperature limits ({' and '.join(missing)} of load_compensation): "
            f"{_BEYOND_K:g} K outside {compensation.low_c.min():z.0f} to {compensation.high_c.max():z.0f} °C "
            f"it may subtract {beyond_dph:.2g} deg/h more or less than was measured at the limit"
        )

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
            numbers |= dict.fromkeys(self.others.indices(), 0.0)
            limits = self.others.limits_of(compensation)
            numbers |= dict.fromkeys(limits.values(), 0.0) | dict.fromkeys(
                (i + 1 for i in limits.values()), 0.0
            )
            for name, each in compensation.coefficients.items():
                sensor, sensor_axis, sensed = correction_place(name)
                if sensor_axis == axis:
                    first = self.others.first(sensor, sensed)
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
