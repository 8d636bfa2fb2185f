"""What the dwells of a calibration say at any temperature."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np

from gyrobench.bench.bias.dwell_table import DwellRow, Triple
from gyrobench.bench.bias.prior import PriorKnowledge
from gyrobench.bench.bias.verification.estimators import KnownAccelerometers
from gyrobench.bench.bias.verification.temperature_curve import TemperatureCurve
from gyrobench.bench.bias.weighted_mean import weighted_mean
from gyrobench.bench.foundations.arrays import RADPS_TO_DPH, STANDARD_GRAVITY, UG_TO_MPS2
from gyrobench.bench.navigation.positions import AXES, POSITIONS

#: How far the bias of an accelerometer may change with temperature beyond where it was measured, ug/K.
_ACCELEROMETER_SLOPE_UG = 10.0


class Calibration:
    """Biases of gyros and accelerometers by position and temperature of the gyros.

    Parameters
    ----------
    rows : iterable of DwellRow
        Dwells of one unit, in any order; those with flags are left out.
    prior : PriorKnowledge
        What is known where nothing was measured.
    """

    def __init__(self, rows: Iterable[DwellRow], prior: PriorKnowledge) -> None:
        self._rows = [row for row in rows if not row.flags]
        self._prior = prior

    def gyro_dph(self, position: str, axis: int, temperature_c: float) -> tuple[float, float] | None:
        """Bias of a gyro and its standard uncertainty, deg/h; None where it was not measured near."""
        points = [
            (row.gyro_c[axis], row.bias_dph[axis], row.sigma_dph[axis])
            for row in self._rows
            if row.position == position
        ]
        return TemperatureCurve(points, self._prior.bias_slope * RADPS_TO_DPH).at(temperature_c)

    def accelerometers(self, position: str, gyro_c: Triple) -> KnownAccelerometers:
        """Accelerometer biases in a position; prior knowledge where they were not measured near.

        Parameters
        ----------
        position : str
            Key of :data:`gyrobench.bench.navigation.positions.POSITIONS`.
        gyro_c : tuple of float
            Temperatures of the gyros; each stands for that of the accelerometer beside it.
        """
        known = [self._accelerometer_ug(position, axis, gyro_c[axis]) for axis in range(len(AXES))]
        bias, sigma = UG_TO_MPS2 * np.array(known).T
        return KnownAccelerometers(bias, sigma)

    def _accelerometer_ug(self, position: str, axis: int, temperature_c: float) -> tuple[float, float]:
        """Bias of one accelerometer; gravity that its misalignment lets in is part of it.

        That part is another one in other positions, and the same for all dwells of a position.
        """
        gravity_ug = self._prior.accelerometer_misalignment * STANDARD_GRAVITY / UG_TO_MPS2
        measured = {name: self._in_position(name, axis, temperature_c) for name in POSITIONS}
        own = measured.pop(position)
        values = [own] if own else []
        others = [each for each in measured.values() if each]
        if others:
            mean = weighted_mean(
                [value for value, _ in others], [math.hypot(sigma, gravity_ug) for _, sigma in others]
            )
            values.append((mean.value, math.hypot(mean.sigma, gravity_ug)))
        if not values:
            return 0.0, self._prior.accelerometer_bias / UG_TO_MPS2
        together = weighted_mean([value for value, _ in values], [sigma for _, sigma in values])
        return together.value, together.sigma

    def _in_position(self, position: str, axis: int, temperature_c: float) -> tuple[float, float] | None:
        """Measured bias of one accelerometer; one that stays vertical is not measured."""
        if POSITIONS[position].up_axis == axis:
            return None
        points = [
            (row.gyro_c[axis], row.accelerometer_ug[axis], row.accelerometer_sigma_ug[axis])
            for row in self._rows
            if row.position == position
        ]
        return TemperatureCurve(points, _ACCELEROMETER_SLOPE_UG).at(temperature_c)
