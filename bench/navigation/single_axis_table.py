"""Kinematics of a table with a single axis: the unit is mounted anew where two axes would turn it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from gyrobench.bench.foundations.arrays import FloatArray
from gyrobench.bench.navigation.attitude import UP
from gyrobench.bench.navigation.positions import POSITIONS
from gyrobench.bench.navigation.table_axes import TwoAxisTable, named_direction

_TOLERANCE = 1e-6


@dataclass(frozen=True, eq=False)
class SingleAxisTable(TwoAxisTable):
    """A table whose outer axis is a stand: it is at zero and stays there."""

    @classmethod
    def about(cls, axis_enu: FloatArray, C_mount: FloatArray, limits_deg: tuple[float, float]) -> Self:
        """Make a table that turns about one axis.

        Parameters
        ----------
        axis_enu : ndarray, shape (3,)
            Unit vector of the axis along East, North or Up; positive angles turn about it.
        C_mount : ndarray, shape (3, 3)
            Attitude ``C_nb`` of the unit at angle zero.
        limits_deg : tuple of float
            Lowest and highest angle.

        Raises
        ------
        DocumentError
            ``C_mount`` is no rotation.
        """
        stand = np.roll(np.abs(axis_enu), 1)  # any direction perpendicular to the axis
        return cls(stand, axis_enu, C_mount, (0.0, 0.0), limits_deg)

    def reaches(self, C_nb: FloatArray) -> bool:
        """Whether some angle, limits apart, gives this attitude: the axis keeps its place in the unit."""
        carried = C_nb @ self.C_mount.T @ self.inner_axis_enu
        return bool(np.allclose(carried, self.inner_axis_enu, atol=_TOLERANCE))

    def _why_not(self, C_nb: FloatArray) -> str:  # noqa: ARG002 - as with two axes
        axis = named_direction(self.inner_axis_enu)
        reached = [name for name, position in POSITIONS.items() if self.reaches(position.C_nb())]
        positions = ", ".join(reached) or "no position"
        turns = "" if abs(self.inner_axis_enu @ UP) > 1.0 - _TOLERANCE else ", and no turn about Up"
        return (
            f"the table can't reach this attitude: it has a single axis, which points {axis}. With the unit "
            f"mounted as rate_table.mounting says it reaches {positions} at azimuth 0"
            f"{turns}. Measure the others in runs of their own, with unit and rate_table.mounting changed"
        )
