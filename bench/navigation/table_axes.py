"""Kinematics of a table with two axes or one: which axis angles give which attitude, and how to turn.

The outer axis is fixed in the laboratory and carries the inner axis, which is perpendicular to it and
carries the unit. With the outer axis level all six positions can be reached at azimuths 0 and 180 deg;
with the outer axis vertical every azimuth, but only in the four positions in which the body axis along
the inner axis stays level.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from gyrobench.bench.foundations.arrays import FloatArray
from gyrobench.bench.foundations.errors import DocumentError
from gyrobench.bench.navigation.attitude import UP, rotation_matrices, rotation_matrix
from gyrobench.bench.navigation.positions import AXES, POSITIONS

#: Angles of the outer and the inner axis, deg.
Angles = tuple[float, float]

#: A turn about Up, or a change of the angles of outer and inner axis, deg.
TurnOrMove = float | Angles

#: Range of an axis with slip rings.
_UNLIMITED = (-np.inf, np.inf)

_TOLERANCE = 1e-6
_ANGLE_DECIMALS = 9
_MAX_TURNS = 3
_PATH_STEP_DEG = 10.0


@dataclass(frozen=True, eq=False)
class TwoAxisTable:
    """A two-axis table with a unit mounted on it.

    Raises DocumentError if the axes are not perpendicular unit vectors or ``C_mount`` is not a rotation.
    """

    #: outer_axis_enu, inner_axis_enu: Shape (3,). Unit vectors of the two axes with both angles at zero;
    #: positive angles turn about them.
    outer_axis_enu: FloatArray
    inner_axis_enu: FloatArray
    C_mount: FloatArray  #: Shape (3, 3). Attitude ``C_nb`` of the unit with both angles at zero.
    #: outer_limits_deg, inner_limits_deg: Lowest and highest angle of each axis.
    outer_limits_deg: tuple[float, float] = _UNLIMITED
    inner_limits_deg: tuple[float, float] = _UNLIMITED

    def __post_init__(self) -> None:
        axes = np.stack([self.outer_axis_enu, self.inner_axis_enu])
        if not np.allclose(axes @ axes.T, np.eye(2), atol=_TOLERANCE):
            raise DocumentError(
                f"the table's axes must be two perpendicular unit vectors; found {axes.tolist()}"
            )
        C = self.C_mount
        if not (np.allclose(C @ C.T, np.eye(3), atol=_TOLERANCE) and np.linalg.det(C) > 0.0):
            raise DocumentError(
                "the mounting must be a right-handed rotation: three perpendicular body axes x, y and z"
            )

    def attitude(self, outer_deg: ArrayLike, inner_deg: ArrayLike) -> FloatArray:
        """Attitudes ``C_nb`` (..., 3, 3) of the unit at these axis angles (...)."""
        outer, inner = (
            rotation_matrices(np.multiply.outer(np.deg2rad(angle_deg), axis))
            for angle_deg, axis in ((outer_deg, self.outer_axis_enu), (inner_deg, self.inner_axis_enu))
        )
        return outer @ inner @ self.C_mount

    def reversed_axes(self) -> Iterator[tuple[tuple[str, ...], TwoAxisTable]]:
        """Tables with one axis or both in the opposite direction, and the names of these axes."""
        yield ("inner_axis",), replace(self, inner_axis_enu=-self.inner_axis_enu)
        if self.outer_limits_deg[0] < self.outer_limits_deg[1]:
            outer = replace(self, outer_axis_enu=-self.outer_axis_enu)
            yield ("outer_axis",), outer
            yield ("inner_axis", "outer_axis"), replace(outer, inner_axis_enu=-self.inner_axis_enu)

    def angles(self, C_nb: FloatArray, turns_deg: Sequence[TurnOrMove] = ()) -> Angles:
        """Axis angles that give an attitude.

        ``C_nb`` (3, 3): attitude wanted. ``turns_deg``: turns about Up, and moves of both axes, that will
        follow one another; of equivalent angles those are taken that leave room for them within the limits
        (see :meth:`turn`). Result: outer and inner angle, each in (-180, 180] unless the limits exclude that.
        Raises DocumentError if no angles of this table and mounting give the attitude, or none within the
        limits.
        """
        outer, inner = self._principal_angles(C_nb)
        for start in _nearest_first(outer, inner):
            if self._allows(start) and self._has_room(start, turns_deg):
                return start
        turns = ", ".join(map(turn_text, turns_deg))
        room = f" and have room for turns of {turns} deg" if turns else ""
        raise DocumentError(
            f"the table can't reach outer {outer:g} deg, inner {inner:g} deg within the limits "
            f"(outer {_range(self.outer_limits_deg)}, inner {_range(self.inner_limits_deg)}){room}"
        )

    def turn(self, from_angles: Angles, angle_deg: float) -> Angles:
        """Axis angles after a turn about Up.

        Where one axis is vertical it alone moves, by exactly the turn and in the sense asked. Where both are
        level a turn of 180 deg moves both; the inner axis then takes the sign of ``angle_deg`` if the limits
        allow. Raises DocumentError if the attitude after the turn can't be reached, or not within the limits.
        """
        target = self._turned(from_angles, angle_deg)
        if target is None:
            raise DocumentError(
                f"a turn of {angle_deg:g} deg from outer {from_angles[0]:g} deg, inner {from_angles[1]:g} "
                f"deg leaves the table's limits (outer {_range(self.outer_limits_deg)}, "
                f"inner {_range(self.inner_limits_deg)}); start from equivalent angles or turn the other way"
            )
        return target

    def path(self, from_angles: Angles, to_angles: Angles) -> FloatArray:
        """Attitudes (k, 3, 3) on the way between two pairs of angles, both axes moving at once."""
        longest_deg = float(np.abs(np.subtract(to_angles, from_angles)).max())
        steps = max(1, int(np.ceil(longest_deg / _PATH_STEP_DEG)))
        return self.attitude(*np.linspace(from_angles, to_angles, steps + 1).T)

    def reaches(self, C_nb: FloatArray) -> bool:
        """Whether some axis angles, limits apart, give this attitude."""
        carried = C_nb @ self.C_mount.T @ self.inner_axis_enu
        return bool(abs(carried @ self.outer_axis_enu) < _TOLERANCE)

    def _principal_angles(self, C_nb: FloatArray) -> Angles:
        if not self.reaches(C_nb):
            raise DocumentError(self._why_not(C_nb))
        from_zero = C_nb @ self.C_mount.T
        outer = _angle_deg(self.outer_axis_enu, self.inner_axis_enu, from_zero @ self.inner_axis_enu)
        inner_turn = rotation_matrix(self.outer_axis_enu, -np.deg2rad(outer)) @ from_zero
        return outer, _angle_deg(self.inner_axis_enu, self.outer_axis_enu, inner_turn @ self.outer_axis_enu)

    def _has_room(self, start: Angles, turns_deg: Sequence[TurnOrMove]) -> bool:
        angles: Angles | None = start
        for turn_deg in turns_deg:
            angles = angles and self._turned(angles, turn_deg)
        return angles is not None

    def _turned(self, start: Angles, angle_deg: TurnOrMove) -> Angles | None:
        if isinstance(angle_deg, tuple):
            moved = (start[0] + angle_deg[0], start[1] + angle_deg[1])
            return moved if self._allows(moved) else None
        principal = self._principal_angles(rotation_matrix(UP, np.deg2rad(angle_deg)) @ self.attitude(*start))
        inner_axis = rotation_matrix(self.outer_axis_enu, np.deg2rad(start[0])) @ self.inner_axis_enu
        outer_up, inner_up = (_upward(axis) for axis in (self.outer_axis_enu, inner_axis))
        both_level = not (outer_up or inner_up)
        wanted = (start[0] + angle_deg * outer_up, start[1] + angle_deg * (1 if both_level else inner_up))
        options = [option for option in _nearest_first(*principal) if self._allows(option)]
        if not both_level:
            options = [option for option in options if np.allclose(option, wanted, atol=_TOLERANCE)]
        return min(options, key=lambda option: _distance(option, wanted), default=None)

    def _allows(self, angles: Angles) -> bool:
        limits = (self.outer_limits_deg, self.inner_limits_deg)
        return all(low <= angle <= high for angle, (low, high) in zip(angles, limits, strict=True))

    def _why_not(self, C_nb: FloatArray) -> str:
        body_axis = self.C_mount.T @ self.inner_axis_enu
        tilt = np.rad2deg(np.arccos(np.clip(C_nb @ body_axis @ self.outer_axis_enu, -1.0, 1.0)))
        reached = [name for name, position in POSITIONS.items() if self.reaches(position.C_nb())]
        return (
            f"the table can't reach this attitude: the body axis along the inner axis "
            f"({_named(body_axis, AXES)}) would have to lie at {tilt:.1f} deg to the outer axis "
            f"({_named_direction(self.outer_axis_enu)}), but always stays perpendicular to "
            f"it. At azimuth 0 this mounting reaches {', '.join(reached) or 'none of the six positions'}; "
            "mount the unit another way for the rest"
        )


def turn_text(turn: TurnOrMove) -> str:
    """``90``, or ``outer 90`` for a move of one axis."""
    if isinstance(turn, tuple):
        return " ".join(f"{axis} {deg:g}" for axis, deg in zip(("outer", "inner"), turn, strict=True) if deg)
    return f"{turn:g}"


def _named_direction(vector_enu: FloatArray) -> str:
    """``East``, ``-Up`` or, for an oblique vector, its components."""
    return _named(vector_enu, ("East", "North", "Up"))


def _angle_deg(axis: FloatArray, start: FloatArray, end: FloatArray) -> float:
    """Angle of the turn about ``axis`` that takes ``start``, perpendicular to it, to ``end``; (-180, 180]."""
    angle = np.rad2deg(np.arctan2(axis @ np.cross(start, end), start @ end))
    rounded = round(float(angle), _ANGLE_DECIMALS) + 0.0
    return rounded if rounded > -180.0 else rounded + 360.0


def _nearest_first(outer: float, inner: float) -> list[Angles]:
    """Add full turns, which give the same attitude: the smallest angles first, positive before negative."""
    turns = range(-_MAX_TURNS, _MAX_TURNS + 1)
    options = [(outer + 360.0 * i, inner + 360.0 * j) for i in turns for j in turns]
    return sorted(options, key=lambda option: (abs(option[0]) + abs(option[1]), -option[0], -option[1]))


def _distance(option: Angles, wanted: Angles) -> float:
    """How far apart two pairs of angles are, rounded so that equal distances compare equal."""
    return round(abs(option[0] - wanted[0]) + abs(option[1] - wanted[1]), _ANGLE_DECIMALS)


def _upward(axis: FloatArray) -> int:
    """+1 for an axis that points up, -1 for down, 0 for any other."""
    vertical = float(axis @ UP)
    return int(np.sign(vertical)) if abs(vertical) > 1.0 - _TOLERANCE else 0


def _named(vector: FloatArray, names: tuple[str, ...]) -> str:
    """``x``, ``-z`` or, for an oblique vector, its components."""
    index = int(np.argmax(np.abs(vector)))
    if abs(vector[index]) < 1.0 - _TOLERANCE:
        return np.array2string(vector, precision=4)
    return f"{'-' if vector[index] < 0.0 else ''}{names[index]}"


def _range(limits_deg: tuple[float, float]) -> str:
    return f"{limits_deg[0]:g} to {limits_deg[1]:g} deg"


@dataclass(frozen=True, eq=False)
class SingleAxisTable(TwoAxisTable):
    """A table whose outer axis is fixed at zero."""

    @classmethod
    def about(cls, axis_enu: FloatArray, C_mount: FloatArray, limits_deg: tuple[float, float]) -> Self:
        """Make a table that turns about one axis.

        Raises DocumentError if ``C_mount`` is not a rotation.

        Parameters
        ----------
        axis_enu : ndarray, shape (3,)
            Unit vector of the axis along East, North or Up; positive angles turn about it.
        C_mount : ndarray, shape (3, 3)
            Attitude ``C_nb`` of the unit at angle zero.
        limits_deg : tuple of float
            Lowest and highest angle.
        """
        fixed = np.roll(np.abs(axis_enu), 1)  # any direction perpendicular to the axis
        return cls(fixed, axis_enu, C_mount, (0.0, 0.0), limits_deg)

    def reaches(self, C_nb: FloatArray) -> bool:
        """Whether some angle, limits apart, gives this attitude: the axis keeps its place in the unit."""
        carried = C_nb @ self.C_mount.T @ self.inner_axis_enu
        return bool(np.allclose(carried, self.inner_axis_enu, atol=_TOLERANCE))

    def _why_not(self, C_nb: FloatArray) -> str:  # noqa: ARG002
        axis = _named_direction(self.inner_axis_enu)
        reached = [name for name, position in POSITIONS.items() if self.reaches(position.C_nb())]
        positions = ", ".join(reached) or "no position"
        turns = "" if abs(self.inner_axis_enu @ UP) > 1.0 - _TOLERANCE else ", and no turn about Up"
        return (
            f"the table can't reach this attitude: it has a single axis, which points {axis}. With the unit "
            f"mounted as rate_table.mounting says it reaches {positions} at azimuth 0"
            f"{turns}. Measure the others in separate runs, with unit and rate_table.mounting changed"
        )
