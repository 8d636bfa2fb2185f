"""Kinematics of a table with two axes or one: attitude for given axis angles, and angles for an attitude.

The outer axis is fixed in the laboratory and carries the inner axis, which is perpendicular to it and
carries the unit. With a level outer axis, all six positions can be reached at azimuths 0 and 180 deg. With a
vertical outer axis, all azimuths can be reached, but only in the four positions in which the body axis along
the inner axis is level.
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
        """Tables with one axis or both reversed, each with the names of these axes."""
        yield ("inner_axis",), replace(self, inner_axis_enu=-self.inner_axis_enu)
        if self.outer_limits_deg[0] < self.outer_limits_deg[1]:
            outer = replace(self, outer_axis_enu=-self.outer_axis_enu)
            yield ("outer_axis",), outer
            yield ("inner_axis", "outer_axis"), replace(outer, inner_axis_enu=-self.inner_axis_enu)

    def angles(self, C_nb: FloatArray, turns_deg: Sequence[TurnOrMove] = ()) -> Angles:
        """Axis angles for an attitude.

        ``C_nb`` (3, 3): the attitude. ``turns_deg``: turns about Up, and moves of both axes, that will
        follow; of equivalent angles those are chosen from which all of them stay within the limits (see
        :meth:`turn`). Result: outer and inner angle, each in (-180, 180] unless the limits exclude that.
        Raises DocumentError if the table with this mounting can't reach the attitude, or not within the
        limits.
        """
        outer, inner = self._principal_angles(C_nb)
        for start in _equivalent_angles(outer, inner):
            if self._is_within_limits(start) and self._allows_turns(start, turns_deg):
                return start
        turns = ", ".join(map(turn_text, turns_deg))
        room = f" and have room for turns of {turns} deg" if turns else ""
        raise DocumentError(
            f"the table can't reach outer {outer:g} deg, inner {inner:g} deg within the limits "
            f"(outer {_range_text(self.outer_limits_deg)}, inner {_range_text(self.inner_limits_deg)}){room}"
        )

    def turn(self, from_angles: Angles, angle_deg: float) -> Angles:
        """Axis angles after a turn about Up.

        If one axis is vertical, only this axis moves, by exactly the angle and direction of the turn. If both
        are level, a turn of 180 deg moves both; the inner axis moves with the sign of ``angle_deg`` if the
        limits allow it. Raises DocumentError if the attitude after the turn can't be reached, or not within
        the limits.
        """
        target = self._angles_after(from_angles, angle_deg)
        if target is None:
            raise DocumentError(
                f"a turn of {angle_deg:g} deg from outer {from_angles[0]:g} deg, inner {from_angles[1]:g} "
                f"deg leaves the table's limits (outer {_range_text(self.outer_limits_deg)}, "
                f"inner {_range_text(self.inner_limits_deg)}); start from equivalent angles or turn the "
                "other way"
            )
        return target

    def path(self, from_angles: Angles, to_angles: Angles) -> FloatArray:
        """Attitudes (k, 3, 3) on the path between two pairs of angles, with both axes moving at once."""
        longest_deg = float(np.abs(np.subtract(to_angles, from_angles)).max())
        steps = max(1, int(np.ceil(longest_deg / _PATH_STEP_DEG)))
        return self.attitude(*np.linspace(from_angles, to_angles, steps + 1).T)

    def reaches(self, C_nb: FloatArray) -> bool:
        """Whether any axis angles give this attitude, regardless of limits."""
        inner_axis_after = C_nb @ self.C_mount.T @ self.inner_axis_enu
        return bool(abs(inner_axis_after @ self.outer_axis_enu) < _TOLERANCE)

    def _principal_angles(self, C_nb: FloatArray) -> Angles:
        if not self.reaches(C_nb):
            raise DocumentError(self._unreachable_text(C_nb))
        from_zero = C_nb @ self.C_mount.T
        outer = _angle_deg(self.outer_axis_enu, self.inner_axis_enu, from_zero @ self.inner_axis_enu)
        inner_turn = rotation_matrix(self.outer_axis_enu, -np.deg2rad(outer)) @ from_zero
        return outer, _angle_deg(self.inner_axis_enu, self.outer_axis_enu, inner_turn @ self.outer_axis_enu)

    def _allows_turns(self, start: Angles, turns_deg: Sequence[TurnOrMove]) -> bool:
        angles: Angles | None = start
        for turn_deg in turns_deg:
            angles = angles and self._angles_after(angles, turn_deg)
        return angles is not None

    def _angles_after(self, start: Angles, angle_deg: TurnOrMove) -> Angles | None:
        if isinstance(angle_deg, tuple):
            angles_after = (start[0] + angle_deg[0], start[1] + angle_deg[1])
            return angles_after if self._is_within_limits(angles_after) else None
        principal = self._principal_angles(rotation_matrix(UP, np.deg2rad(angle_deg)) @ self.attitude(*start))
        inner_axis = rotation_matrix(self.outer_axis_enu, np.deg2rad(start[0])) @ self.inner_axis_enu
        outer_up, inner_up = (_up_sign(axis) for axis in (self.outer_axis_enu, inner_axis))
        both_level = not (outer_up or inner_up)
        target = (start[0] + angle_deg * outer_up, start[1] + angle_deg * (1 if both_level else inner_up))
        candidates = [
            candidate for candidate in _equivalent_angles(*principal) if self._is_within_limits(candidate)
        ]
        if not both_level:
            candidates = [
                candidate for candidate in candidates if np.allclose(candidate, target, atol=_TOLERANCE)
            ]
        return min(candidates, key=lambda candidate: _angle_distance(candidate, target), default=None)

    def _is_within_limits(self, angles: Angles) -> bool:
        limits = (self.outer_limits_deg, self.inner_limits_deg)
        return all(low <= angle <= high for angle, (low, high) in zip(angles, limits, strict=True))

    def _unreachable_text(self, C_nb: FloatArray) -> str:
        body_axis = self.C_mount.T @ self.inner_axis_enu
        tilt = np.rad2deg(np.arccos(np.clip(C_nb @ body_axis @ self.outer_axis_enu, -1.0, 1.0)))
        reached = [name for name, position in POSITIONS.items() if self.reaches(position.C_nb())]
        return (
            f"the table can't reach this attitude: the body axis along the inner axis "
            f"({_vector_text(body_axis, AXES)}) would have to lie at {tilt:.1f} deg to the outer axis "
            f"({_direction_text(self.outer_axis_enu)}), but always stays perpendicular to "
            f"it. At azimuth 0 this mounting reaches {', '.join(reached) or 'none of the six positions'}; "
            "mount the unit another way for the rest"
        )


def turn_text(turn: TurnOrMove) -> str:
    """Text such as ``90``, or ``outer 90`` for a move of one axis."""
    if isinstance(turn, tuple):
        return " ".join(f"{axis} {deg:g}" for axis, deg in zip(("outer", "inner"), turn, strict=True) if deg)
    return f"{turn:g}"


def _direction_text(vector_enu: FloatArray) -> str:
    """Text such as ``East`` or ``-Up``; for an oblique vector, its components."""
    return _vector_text(vector_enu, ("East", "North", "Up"))


def _angle_deg(axis: FloatArray, start: FloatArray, end: FloatArray) -> float:
    """Angle of the turn about ``axis`` that takes ``start``, perpendicular to it, to ``end``; (-180, 180]."""
    angle = np.rad2deg(np.arctan2(axis @ np.cross(start, end), start @ end))
    rounded = round(float(angle), _ANGLE_DECIMALS) + 0.0
    return rounded if rounded > -180.0 else rounded + 360.0


def _equivalent_angles(outer: float, inner: float) -> list[Angles]:
    """Angles of the same attitude, by full turns: the smallest first, positive before negative."""
    turns = range(-_MAX_TURNS, _MAX_TURNS + 1)
    candidates = [(outer + 360.0 * i, inner + 360.0 * j) for i in turns for j in turns]
    return sorted(
        candidates,
        key=lambda candidate: (abs(candidate[0]) + abs(candidate[1]), -candidate[0], -candidate[1]),
    )


def _angle_distance(candidate: Angles, target: Angles) -> float:
    """Distance of two pairs of angles, rounded so that equal distances compare equal."""
    return round(abs(candidate[0] - target[0]) + abs(candidate[1] - target[1]), _ANGLE_DECIMALS)


def _up_sign(axis: FloatArray) -> int:
    """+1 for an axis that points up, -1 for down, 0 for any other."""
    vertical = float(axis @ UP)
    return int(np.sign(vertical)) if abs(vertical) > 1.0 - _TOLERANCE else 0


def _vector_text(vector: FloatArray, names: tuple[str, ...]) -> str:
    """Text such as ``x`` or ``-z``; for an oblique vector, its components."""
    index = int(np.argmax(np.abs(vector)))
    if abs(vector[index]) < 1.0 - _TOLERANCE:
        return np.array2string(vector, precision=4)
    return f"{'-' if vector[index] < 0.0 else ''}{names[index]}"


def _range_text(limits_deg: tuple[float, float]) -> str:
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
        """Whether any angle gives this attitude, regardless of limits; the axis is fixed in the unit."""
        inner_axis_after = C_nb @ self.C_mount.T @ self.inner_axis_enu
        return bool(np.allclose(inner_axis_after, self.inner_axis_enu, atol=_TOLERANCE))

    def _unreachable_text(self, C_nb: FloatArray) -> str:  # noqa: ARG002
        axis = _direction_text(self.inner_axis_enu)
        reached = [name for name, position in POSITIONS.items() if self.reaches(position.C_nb())]
        positions = ", ".join(reached) or "no position"
        turns = "" if abs(self.inner_axis_enu @ UP) > 1.0 - _TOLERANCE else ", and no turn about Up"
        return (
            f"the table can't reach this attitude: it has a single axis, which points {axis}. With the unit "
            f"mounted as rate_table.mounting says it reaches {positions} at azimuth 0"
            f"{turns}. Measure the others in separate runs, with unit and rate_table.mounting changed"
        )
