"""The six positions in which the gyros are measured, and their attitudes.

The directions below reproduce all signs of the paper's equations (10) and (12) to (16).

References
----------
Yu et al., "The Six-Position Calibration Technique of Gyro Bias for Rotational Inertial
Navigation System Based on Ring Laser Gyroscope", section 4.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Literal, TypeVar

import numpy as np

from gyrobench.bench.foundations.arrays import FloatArray
from gyrobench.bench.navigation.attitude import UP, rotation_matrix

#: Names of the six positions in files.
PositionName = Literal["z_up", "z_down", "y_up", "y_down", "x_up", "x_down"]
#: Body axes, in the order of arrays.
AXES = ("x", "y", "z")
_HALF_TURN_TOLERANCE_DEG = 0.5

_DwellT = TypeVar("_DwellT")

_DIRECTIONS = {
    "E": (1.0, 0.0, 0.0),
    "W": (-1.0, 0.0, 0.0),
    "N": (0.0, 1.0, 0.0),
    "S": (0.0, -1.0, 0.0),
    "U": (0.0, 0.0, 1.0),
    "D": (0.0, 0.0, -1.0),
}


@dataclass(frozen=True)
class Position:
    """One of the six positions."""

    name: str  #: Key of the position in files: "z_up", "x_down", ...
    directions: str  #: Directions of body x, y and z at azimuth 0, as three letters out of E, W, N, S, U, D.

    @property
    def up_axis(self) -> int:
        """Index of the vertical body axis: 0 for x, 1 for y, 2 for z."""
        return next(index for index, letter in enumerate(self.directions) if letter in "UD")

    @property
    def up_sign(self) -> int:
        """+1 if the vertical body axis points up, -1 if it points down."""
        return 1 if "U" in self.directions else -1

    def C_nb(self, azimuth_rad: float = 0.0) -> FloatArray:  # noqa: N802
        """Attitude (3, 3) after a turn by ``azimuth_rad`` about Up from azimuth 0."""
        at_zero = np.array([_DIRECTIONS[letter] for letter in self.directions]).T
        return rotation_matrix(UP, azimuth_rad) @ at_zero if azimuth_rad else at_zero


#: The six positions by name, in the order of the paper.
POSITIONS: Mapping[str, Position] = MappingProxyType(
    {
        position.name: position
        for position in (
            Position("z_up", "ENU"),
            Position("z_down", "WND"),
            Position("y_up", "EUS"),
            Position("y_down", "EDN"),
            Position("x_up", "UEN"),
            Position("x_down", "DWN"),
        )
    }
)


def position_label(name: str) -> str:
    """Name of a position as the paper writes it: "Z-Up" for "z_up"."""
    return "-".join(part.capitalize() for part in name.split("_"))


def gyro_label(gyro: str) -> str:
    """Name of a gyro as the paper writes it: "X gyro" for "x"."""
    return f"{gyro.upper()} gyro"


def half_turn_pairs(
    dwells: Iterable[_DwellT],
    azimuth_deg: Callable[[_DwellT], float],
    are_comparable: Callable[[_DwellT, _DwellT], bool] = lambda _first, _second: True,
) -> list[tuple[_DwellT, _DwellT | None]]:
    """Pair each dwell with the first unpaired comparable one half a turn from it; None if there is none."""
    pairs: list[tuple[_DwellT, _DwellT | None]] = []
    unpaired: list[_DwellT] = []
    for each in dwells:
        for other in unpaired:
            deviation_deg = (azimuth_deg(each) - azimuth_deg(other)) % 360.0 - 180.0
            if abs(deviation_deg) < _HALF_TURN_TOLERANCE_DEG and are_comparable(other, each):
                unpaired.remove(other)
                pairs.append((other, each))
                break
        else:
            unpaired.append(each)
    return pairs + [(each, None) for each in unpaired]
