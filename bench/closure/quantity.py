"""What a search explains: three coefficients of one kind, with their unit and words."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from gyrobench.bench.calibration.coefficients import COEFFICIENTS, SensorCoefficient
from gyrobench.bench.foundations.errors import DocumentError
from gyrobench.bench.foundations.text import did_you_mean, listed
from gyrobench.bench.navigation.positions import AXES, gyro_label

_SUFFIXES = {"deg/h": "dph"}


@dataclass(frozen=True)
class Quantity:
    """Three coefficients that a search takes together, as the biases of the three gyros.

    Names of numbers that end in ``_dph`` are of gyro biases; a search of another quantity holds its values
    there in its own :attr:`unit`, and writes them with its own :attr:`suffix`.
    """

    name: str  #: ``gyro_scale_factor``; of misalignments with the first of them: ``gyro_misalignment_xy``.
    sensor: str  #: "gyro" or "accelerometer".
    label: str  #: "bias", "scale factor" or "misalignment".
    unit: str  #: Of its values.
    coefficients: tuple[str, str, str]  #: Names with the axis: ``gyro_scale_factor_x``.
    row: str = "dwell"  #: What has one value of each: "dwell", or "plateau" where rotations measure it.

    @property
    def axes(self) -> tuple[str, ...]:
        """Axis of each; of misalignments the sensor and the axis that it senses: "xy"."""
        return tuple(each.rpartition("_")[2] for each in self.coefficients)

    @property
    def sensors(self) -> tuple[int, ...]:
        """Index of the sensor of each: 0 for x."""
        return tuple(AXES.index(axis[0]) for axis in self.axes)

    @property
    def suffix(self) -> str:
        """Unit as names end with it: "dph", "ppm"."""
        return _SUFFIXES.get(self.unit, self.unit)

    @property
    def is_gyro_bias(self) -> bool:
        """Whether it is the biases of the gyros, which every dwell table has."""
        return self.name == "gyro_bias"

    @property
    def headings(self) -> tuple[str, ...]:
        """Name of each on pages: "X gyro", "X accelerometer", "xy"."""
        if len(self.axes[0]) > 1:
            return self.axes
        return tuple(gyro_label(axis).replace("gyro", self.sensor) for axis in self.axes)

    def place(self, axes: Sequence[str]) -> str:
        """Some of the three in a sentence: "x and y gyros"; of misalignments "xy and yz"."""
        names = listed(axes)
        return names if len(self.axes[0]) > 1 else f"{names} {self.sensor}{'s' if len(axes) > 1 else ''}"

    def restated(self, sentence: str) -> str:
        """A sentence about the bias as one about this quantity."""
        return sentence if self.label == "bias" else sentence.replace("bias", self.label)

    def in_rows(self, sentence: str) -> str:
        """A sentence about dwells as one about what has the values."""
        return sentence if self.row == "dwell" else sentence.replace("dwell", self.row)

    def in_unit(self, document: Any) -> Any:
        """A document with names that end in this quantity's unit in place of deg/h."""
        if self.is_gyro_bias:
            return document
        if isinstance(document, dict):
            return {
                key.replace("_dph", f"_{self.suffix}"): self.in_unit(each) for key, each in document.items()
            }
        return [self.in_unit(each) for each in document] if isinstance(document, list) else document


def _steps_to_axis(each: SensorCoefficient) -> int:
    return (AXES.index(each.axis[-1]) - AXES.index(each.axis[0])) % len(AXES)


def _quantities() -> list[Quantity]:
    found = []
    for name in dict.fromkeys(each.name for each in COEFFICIENTS):
        mine = [each for each in COEFFICIENTS if each.name == name]
        is_one = len(mine) == len(AXES)
        # Of six misalignments those of each sensor with the next axis, then those with the one before.
        ordered = mine if is_one else sorted(mine, key=_steps_to_axis)
        for first in range(0, len(mine), 3):
            x, y, z = (f"{name}_{each.axis}" for each in ordered[first : first + 3])
            label = mine[0].kind.replace("_", " ")
            found.append(Quantity(name if is_one else x, mine[0].sensor, label, mine[0].unit, (x, y, z)))
    return found


#: All quantities that can be searched: the 21 coefficients, three by three.
QUANTITIES = tuple(_quantities())
GYRO_BIAS = QUANTITIES[0]


def quantity(name: str) -> Quantity:
    """Look up the quantity with a name, or that has a coefficient with that name.

    Raises DocumentError if there is none.
    """
    for each in QUANTITIES:
        if name == each.name or name in each.coefficients or each.name.startswith(f"{name}_"):
            return each
    names = [each.name for each in QUANTITIES]
    raise DocumentError(
        f"there is no coefficient {name!r}{did_you_mean(name, names)}. Name one of {listed(names)}"
    )
