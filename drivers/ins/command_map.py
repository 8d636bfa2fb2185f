"""Which frame carries which command: the station file's ``ins.commands``.

A command is a message of the DBC and the values of its signals. A value that is not known before
the command is given stands as ``$sequence``, ``$axis``, ``$index`` or ``$value``.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Self

import can
import numpy as np
from pydantic import Field, model_validator

from gyrobench.bench.foundations.documents import Location, Problem, StrictModel
from gyrobench.bench.foundations.errors import DocumentError
from gyrobench.drivers.ins.attitude import EulerSequence
from gyrobench.drivers.ins.compensation import TERMS, Compensation
from gyrobench.drivers.ins.dbc_codec import DbcCodec
from gyrobench.drivers.ins.frames import EXTENDED_ID


class Command(StrictModel):
    """A message and the values of its signals, in the DBC's units."""

    message: str = Field(description="message of the DBC")
    values: dict[str, float | str] = Field(description="value of each of its signals")

    def frame(self, codec: DbcCodec, given: Mapping[str, float]) -> can.Message:
        """Build the frame, with the ``given`` values in place of their names."""
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
    """Sets the Euler sequence; ``$sequence`` is one of the two numbers."""

    rpy_321: int = Field(default=0, description="the INS's number for roll, pitch, yaw")
    pry_231: int = Field(default=1, description="the INS's number for pitch, roll, yaw")

    def number(self, sequence: EulerSequence) -> int:
        """Look up the INS's number for a sequence."""
        return self.rpy_321 if sequence is EulerSequence.RPY_321 else self.pry_231


Vector = Annotated[list[int], Field(min_length=3, max_length=3)]


class TermIndices(StrictModel):
    """Indices of what the INS takes beyond the polynomial, named as in :class:`Compensation`."""

    rate_dph_per_c_per_h: int | None = Field(default=None, description="index: rate of the temperature")
    rate_limit_c_per_h: int | None = Field(default=None, description="index: highest rate used")
    gradient_dph_per_k: int | None = Field(default=None, description="index: electronics above optics")
    difference_low_k: int | None = Field(default=None, description="index: lowest difference used")
    difference_high_k: int | None = Field(default=None, description="index: highest difference used")
    saturating_dph_per_k: Vector | None = Field(
        default=None, description="indices: difference along Up, below the onset"
    )
    growing_dph_per_k: Vector | None = Field(
        default=None, description="indices: difference along Up, the more the colder"
    )
    onset_c: int | None = Field(default=None, description="index: temperature of the onset")
    onset_width_c: int | None = Field(default=None, description="index: width of the onset")
    gravity_dph_per_g: Vector | None = Field(default=None, description="indices: gravity along x, y, z")
    warm_up_dph: int | None = Field(default=None, description="index: bias at power-on")
    warm_up_s: int | None = Field(default=None, description="index: time constant of the warm-up")
    hysteresis_dph_per_k: int | None = Field(default=None, description="index: play of the temperature")
    half_width_k: int | None = Field(default=None, description="index: half width of the play")

    @model_validator(mode="after")
    def _whole_terms(self) -> Self:
        for name, others in _BELONGING.items():
            missing = [other for other in others if getattr(self, other) is None]
            if getattr(self, name) is not None and missing:
                raise ValueError(f"{name} needs {' and '.join(missing)} too")
        return self


_BELONGING = {
    "saturating_dph_per_k": ("onset_c", "onset_width_c"),
    "growing_dph_per_k": ("onset_c", "onset_width_c"),
    "warm_up_dph": ("warm_up_s",),
    "hysteresis_dph_per_k": ("half_width_k",),
}


class CoefficientCommand(Command):
    """Loads one number of the compensation: ``$value`` at ``$index`` for the gyro ``$axis``.

    The coefficient of degree k in the temperature of the gyro's optics has the index k.
    """

    coefficients: int = Field(description="how many coefficients the INS takes for a gyro")
    lowest_index: int | None = Field(default=None, description="index of the lowest temperature of validity")
    highest_index: int | None = Field(
        default=None, description="index of the highest temperature of validity"
    )
    terms: TermIndices = Field(
        default=TermIndices(), description="indices of the terms that the INS takes beyond the polynomial"
    )

    def takes(self) -> list[str]:
        """Names of the terms that the INS takes."""
        return [term for term, name in TERMS.items() if getattr(self.terms, name) is not None]

    def refuses(self, compensation: Compensation) -> list[str]:
        """What a compensation has that the INS does not take, in words."""
        taken = self.takes()
        refused = [term for term in compensation.terms() if term not in taken]
        degree = int(np.flatnonzero(compensation.polynomial_dph.any(axis=0)).max(initial=0))
        if degree >= self.coefficients:
            refused.insert(0, f"a polynomial of degree {degree}")
        return refused

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
        return dict(sorted(numbers.items()))


class CommandMap(StrictModel):
    """Commands that the INS knows."""

    standby: Command | None = Field(default=None, description="leaves navigation")
    align: Command | None = Field(default=None, description="begins an alignment")
    navigate: Command | None = Field(default=None, description="begins to navigate")
    set_euler_sequence: SequenceCommand | None = Field(
        default=None, description="chooses the Euler angles that it sends"
    )
    clear_compensation: Command | None = Field(default=None, description="takes the compensation out")
    load_compensation: CoefficientCommand | None = Field(
        default=None, description="loads one number of a compensation"
    )
    apply_compensation: Command | None = Field(default=None, description="puts what was loaded into use")


_GIVEN = {"set_euler_sequence": {"$sequence"}, "load_compensation": {"$axis", "$index", "$value"}}


def check_commands(commands: CommandMap, codec: DbcCodec, at: Location = ()) -> list[Problem]:
    """List what does not fit the DBC, with the map standing at ``at`` in its file."""
    problems = []
    for name in CommandMap.model_fields:
        command: Command | None = getattr(commands, name)
        if command is None:
            continue
        given = _GIVEN.get(name, set())
        for signal, value in command.values.items():
            here = (*at, name, "values", signal)
            if isinstance(value, str) and value not in given:
                known = f"a number or {', '.join(sorted(given))}" if given else "a number"
                problems.append(Problem(here, f"expected {known}; found '{value}'"))
            try:
                codec.signal(command.message, signal)
            except DocumentError as error:
                problems.append(Problem(here, str(error)))
    return problems
