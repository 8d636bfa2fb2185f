"""Quantities that a search can explain: three coefficients of one kind, with their unit and labels."""

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
    """Three coefficients that are searched together, such as the biases of the three gyros.

    Names that end in ``_dph`` are those of gyro biases. For another quantity, variables with these names have
    its own :attr:`unit`, and files get names with its own :attr:`suffix`.
    """

    name: str  #: ``gyro_scale_factor``; for misalignments that of the first one: ``gyro_misalignment_xy``.
    sensor: str  #: "gyro" or "accelerometer".
    label: str  #: "bias", "scale factor" or "misalignment".
    unit: str  #: Unit of its values.
    coefficients: tuple[str, str, str]  #: Names with the axis: ``gyro_scale_factor_x``.
    row: str = "dwell"  #: Meaning of a row: "dwell", or "plateau" if rotations measure the coefficients.

    @property
    def axes(self) -> tuple[str, ...]:
        """Axis of each coefficient; for misalignments the sensor and the axis that it senses: "xy"."""
        return tuple(each.rpartition("_")[2] for each in self.coefficients)

    @property
    def sensors(self) -> tuple[int, ...]:
        """Index of the sensor of each coefficient: 0 for x."""
        return tuple(AXES.index(axis[0]) for axis in self.axes)

    @property
    def suffix(self) -> str:
        """Unit as a suffix of names: "dph", "ppm"."""
        return _SUFFIXES.get(self.unit, self.unit)

    @property
    def is_gyro_bias(self) -> bool:
        """Whether this is the gyro biases, which every dwell table has."""
        return self.name == "gyro_bias"

    @property
    def headings(self) -> tuple[str, ...]:
        """Heading of each coefficient on pages: "X gyro", "X accelerometer", "xy"."""
        if len(self.axes[0]) > 1:
            return self.axes
        return tuple(gyro_label(axis).replace("gyro", self.sensor) for axis in self.axes)

    def place(self, axes: Sequence[str]) -> str:
        """Names of some axes in a sentence: "x and y gyros"; for misalignments "xy and yz"."""
        names = listed(axes)
        return names if len(self.axes[0]) > 1 else f"{names} {self.sensor}{'s' if len(axes) > 1 else ''}"

    def restated(self, sentence: str) -> str:
        """Sentence about the bias, rewritten for this quantity."""
        return sentence if self.label == "bias" else sentence.replace("bias", self.label)

    def in_rows(self, sentence: str) -> str:
        """Sentence about dwells, rewritten for plateaus if rows are plateaus."""
        return sentence if self.row == "dwell" else sentence.replace("dwell", self.row)

    def in_unit(self, document: Any) -> Any:
        """Document with this quantity's unit as suffix of its keys in place of deg/h."""
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
    quantities = []
    for name in dict.fromkeys(each.name for each in COEFFICIENTS):
        coefficients = [each for each in COEFFICIENTS if each.name == name]
        is_single_quantity = len(coefficients) == len(AXES)
        # Six misalignments: first those of each sensor with the next axis, then with the previous one.
        ordered = coefficients if is_single_quantity else sorted(coefficients, key=_steps_to_axis)
        for first in range(0, len(coefficients), 3):
            x, y, z = (f"{name}_{each.axis}" for each in ordered[first : first + 3])
            label = coefficients[0].kind.replace("_", " ")
            quantities.append(
                Quantity(
                    name if is_single_quantity else x,
                    coefficients[0].sensor,
                    label,
                    coefficients[0].unit,
                    (x, y, z),
                )
            )
    return quantities


#: All quantities that can be searched: the 21 coefficients, three by three.
QUANTITIES = tuple(_quantities())
GYRO_BIAS = QUANTITIES[0]


def quantity(name: str) -> Quantity:
    """Look up a quantity by its name or by the name of one of its coefficients.

    Raises DocumentError if there is none.
    """
    for each in QUANTITIES:
        if name == each.name or name in each.coefficients or each.name.startswith(f"{name}_"):
            return each
    names = [each.name for each in QUANTITIES]
    raise DocumentError(
        f"there is no coefficient {name!r}{did_you_mean(name, names)}. Name one of {listed(names)}"
    )
