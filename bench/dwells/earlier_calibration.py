"""An earlier calibration: its dwells, and the biases interpolated from them at any temperature."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gyrobench.bench.bias.dwell_table import DwellRow, noise_and_common, read_dwells
from gyrobench.bench.bias.parameters import PriorKnowledge
from gyrobench.bench.bias.statistics import weighted_mean
from gyrobench.bench.foundations.arrays import (
    RADPS_TO_DPH,
    STANDARD_GRAVITY,
    UG_TO_MPS2,
    FloatArray,
    Triple,
    rms,
)
from gyrobench.bench.foundations.errors import DocumentError
from gyrobench.bench.navigation.positions import AXES, POSITIONS
from gyrobench.bench.runs.folder import RunFolder

#: Standard uncertainty of the slope of an accelerometer bias outside the temperatures measured, ug/K, unless
#: a larger one is declared.
_ACCELEROMETER_SLOPE_UG = 10.0


@dataclass(frozen=True, eq=False)
class AccelerometerBiases:
    """Accelerometer biases of the calibration, m/s^2, body axes."""

    #: bias, sigma: Shape (3,). Values and standard uncertainties.
    bias: FloatArray
    sigma: FloatArray

    def along(self, direction: FloatArray) -> tuple[float, float]:
        """Bias and standard uncertainty along a unit vector (3,) in body axes."""
        return float(direction @ self.bias), float(np.linalg.norm(direction * self.sigma))


class EarlierCalibration:
    """Biases of gyros and accelerometers by position and temperature of the gyros.

    ``rows``: of one unit, in any order; those with flags are left out. ``prior``: prior knowledge, used for
    biases that were not measured.
    """

    def __init__(self, rows: Iterable[DwellRow], prior: PriorKnowledge) -> None:
        self._rows = [row for row in rows if not row.flags]
        self._prior = prior

    def gyro_dph(self, position: str, axis: int, temperature_c: float) -> tuple[float, float] | None:
        """Bias of a gyro and its standard uncertainty, deg/h; None if not measured near this temperature."""
        fields = ("bias_dph", "sigma_dph", "common_sigma_dph")
        return self._mean_in_position(
            position, axis, temperature_c, fields, self._prior.bias_slope * RADPS_TO_DPH
        )

    def _mean_in_position(
        self, position: str, axis: int, temperature_c: float, fields: tuple[str, str, str], slope: float
    ) -> tuple[float, float] | None:
        """Mean over dwells and its standard uncertainty, of which the common part does not average out.

        ``fields``: of the values, their standard uncertainties and the common part of these.
        """
        rows = [row for row in self._rows if row.position == position]
        noise, common = (each[:, axis] for each in noise_and_common(rows, *fields[1:]))
        points = [
            (row.gyro_c[axis], getattr(row, fields[0])[axis], float(each))
            for row, each in zip(rows, noise, strict=True)
        ]
        mean = InterpolatedCurve(points, slope).at(temperature_c)
        return (mean[0], math.hypot(mean[1], rms(common[~np.isnan(noise)]))) if mean else None

    def accelerometers(self, position: str, gyro_c: Triple) -> AccelerometerBiases:
        """Accelerometer biases in a position; by prior knowledge if not measured near these temperatures.

        ``position``: key of :data:`gyrobench.bench.navigation.positions.POSITIONS`. ``gyro_c``: temperatures
        of the gyros; each is taken for that of the accelerometer of the same axis.
        """
        biases_ug = [self._accelerometer_ug(position, axis, gyro_c[axis]) for axis in range(len(AXES))]
        bias, sigma = UG_TO_MPS2 * np.array(biases_ug).T
        return AccelerometerBiases(bias, sigma)

    def _accelerometer_ug(self, position: str, axis: int, temperature_c: float) -> tuple[float, float]:
        """Bias of one accelerometer and its uncertainty, ug, including gravity through its misalignment.

        That part differs between positions, and is the same for all dwells of one position.
        """
        gravity_ug = self._prior.accelerometer_misalignment * STANDARD_GRAVITY / UG_TO_MPS2
        measured = {name: self._in_position(name, axis, temperature_c) for name in POSITIONS}
        in_this_position = measured.pop(position)
        values = [in_this_position] if in_this_position else []
        in_other_positions = [each for each in measured.values() if each]
        if in_other_positions:
            mean = weighted_mean(
                [value for value, _ in in_other_positions],
                [math.hypot(sigma, gravity_ug) for _, sigma in in_other_positions],
            )
            values.append((mean.value, math.hypot(mean.sigma, gravity_ug)))
        if not values:
            return 0.0, self._prior.accelerometer_bias / UG_TO_MPS2
        combined = weighted_mean([value for value, _ in values], [sigma for _, sigma in values])
        return combined.value, combined.sigma

    def _in_position(self, position: str, axis: int, temperature_c: float) -> tuple[float, float] | None:
        """Measured bias of one accelerometer; None for the vertical one."""
        if POSITIONS[position].up_axis == axis:
            return None
        slope_ug = max(_ACCELEROMETER_SLOPE_UG, self._prior.accelerometer_slope / UG_TO_MPS2)
        fields = ("accelerometer_ug", "accelerometer_sigma_ug", "accelerometer_common_sigma_ug")
        return self._mean_in_position(position, axis, temperature_c, fields, slope_ug)


#: Range beyond the outermost temperatures measured in which a curve has values, K.
MAX_EXTRAPOLATION_K = 2.0
#: Values within this temperature range are averaged, K.
_MAX_GROUP_RANGE_K = 5.0

# If the scatter of values about their mean has a smaller p-value, it raises the uncertainty of the mean.
_MIN_P_VALUE = 0.01


class InterpolatedCurve:
    """Piecewise linear interpolation over temperature, with standard uncertainty.

    Values at nearly the same temperature are averaged. The error of a line across a gap is estimated by the
    next term of Newton's interpolation, from the second difference of the neighbouring values beyond its
    noise. With only two temperatures, the change from one to the other is taken for a parabola that is level
    at one end.

    ``points``: temperature in degrees Celsius, value, standard uncertainty; those with NaN are skipped.
    ``slope_sigma``: standard uncertainty of the slope outside the temperatures measured, per K.
    """

    def __init__(self, points: Iterable[tuple[float, float, float]], slope_sigma: float) -> None:
        self._slope_sigma = slope_sigma
        measured = sorted(point for point in points if not any(map(math.isnan, point)))
        nodes = [_mean_node(group) for group in _group_by_temperature(measured)]
        self._temperature_c, self._value, self._sigma = np.array(nodes).reshape(-1, 3).T
        self._ends_c = (measured[0][0], measured[-1][0]) if measured else (math.inf, -math.inf)

    def at(self, temperature_c: float) -> tuple[float, float] | None:
        """Value and standard uncertainty; None outside the range of temperatures by more than 2 K."""
        first_c, last_c = self._ends_c
        if not first_c - MAX_EXTRAPOLATION_K <= temperature_c <= last_c + MAX_EXTRAPOLATION_K:
            return None
        nodes = self._temperature_c
        if nodes[0] < temperature_c < nodes[-1]:
            return self._between(temperature_c)
        end = 0 if temperature_c <= nodes[0] else -1
        extrapolation_sigma = self._slope_sigma * abs(temperature_c - nodes[end])
        return float(self._value[end]), math.hypot(self._sigma[end], extrapolation_sigma)

    def _between(self, temperature_c: float) -> tuple[float, float]:
        nodes = self._temperature_c
        low = int(np.searchsorted(nodes, temperature_c, side="right")) - 1
        above_c, below_c = temperature_c - nodes[low], nodes[low + 1] - temperature_c
        shares = np.array([below_c, above_c]) / (above_c + below_c)
        pair = slice(low, low + 2)
        noise = np.linalg.norm(shares * self._sigma[pair])
        return float(shares @ self._value[pair]), math.hypot(noise, self._curvature(low) * above_c * below_c)

    def _curvature(self, low: int) -> float:
        """Second divided difference at the gap above a node: the largest of those that include the gap."""
        nodes = self._temperature_c
        if len(nodes) == 2:
            weights = np.array([-1.0, 1.0]) / (nodes[1] - nodes[0]) ** 2
            return self._excess_over_noise(slice(0, 2), weights)
        curvatures = []
        for first in range(max(low - 1, 0), min(low + 1, len(nodes) - 2)):
            triple = slice(first, first + 3)
            differences = nodes[triple][:, np.newaxis] - nodes[triple] + np.eye(3)
            curvatures.append(self._excess_over_noise(triple, 1.0 / differences.prod(axis=1)))
        return max(curvatures)

    def _excess_over_noise(self, nodes: slice, weights: FloatArray) -> float:
        """Absolute value of a weighted sum of values, without the contribution of their noise."""
        total, noise = weights @ self._value[nodes], np.linalg.norm(weights * self._sigma[nodes])
        return math.sqrt(max(float(total**2 - noise**2), 0.0))


def _group_by_temperature(
    points: Iterable[tuple[float, float, float]],
) -> list[list[tuple[float, float, float]]]:
    """Split points in the order of temperature into groups of nearly one temperature each."""
    groups: list[list[tuple[float, float, float]]] = []
    for point in points:
        if groups and point[0] - groups[-1][0][0] <= _MAX_GROUP_RANGE_K:
            groups[-1].append(point)
        else:
            groups.append([point])
    return groups


def _mean_node(group: list[tuple[float, float, float]]) -> tuple[float, float, float]:
    temperatures, values, sigmas = zip(*group, strict=True)
    mean = weighted_mean(values, sigmas)
    scatter = math.sqrt(mean.chi2_reduced) if mean.p_value < _MIN_P_VALUE else 1.0
    return weighted_mean(temperatures, sigmas).value, mean.value, mean.sigma * scatter


def read_calibration(path: Path) -> list[DwellRow]:
    """Read the dwells of a calibration.

    ``path``: a run folder, also of several units, or a dwell table. Raises DocumentError if there is no dwell
    table, it is wrong, or none of its dwells gave a bias.
    """
    folder = RunFolder(path)
    tables = [each.dwells for each in folder.unit_folders or [folder]] if path.is_dir() else [path]
    if not all(table.is_file() for table in tables):
        problem = (
            f"holds no {folder.dwells.name}, so it is not a calibration"
            if path.is_dir()
            else "does not exist"
        )
        raise DocumentError(f"{path}: {problem}. Give a run folder or the dwell table of a calibration")
    rows = [row for table in tables for row in read_dwells(table)]
    if all(row.flags for row in rows):
        raise DocumentError(f"{tables[0]}: has no dwell that gave a bias. Give another calibration")
    return rows
