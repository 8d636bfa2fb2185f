"""The coefficients of the sensors' error model, and the body frame in which they are given.

A triad measures ``m + b + M m``, where m is the true rate or specific force in the body frame, b the biases
and M the matrix of scale factor errors (diagonal) and misalignments: the paper's (1) and (2). ``M[i, j]`` is
the sensitivity of sensor i to axis j. These are 24 coefficients in a body frame given externally, as by a
case or a table. Increments do not determine such a frame. Here, body x is the input axis of the x
accelerometer, and that of the y accelerometer lies in the plane of x and y. Then the accelerometers' matrix
is lower triangular, and 21 coefficients are independent. The gyros may define the body frame in the same way;
:meth:`SensorErrors.rotated` converts to any other frame, as of a case.

References
----------
Yu et al., "The Six-Position Calibration Technique of Gyro Bias for Rotational Inertial Navigation System
Based on Ring Laser Gyroscope", equations (1) and (2).
Camberlein and Mazzanti, "Calibration technique for laser gyro strapdown inertial navigation systems",
Symposium Gyro Technology, Stuttgart 1985: body frame fixed to the accelerometers.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Self

import numpy as np

from gyrobench.bench.foundations.arrays import (
    RAD_TO_ARCSEC,
    RADPS_TO_DPH,
    STANDARD_GRAVITY,
    UG_TO_MPS2,
    BoolArray,
    FloatArray,
    IntArray,
)
from gyrobench.bench.foundations.text import format_number
from gyrobench.bench.navigation.positions import AXES

#: Word in tables for a coefficient that the measurement does not determine.
NOT_OBSERVABLE = "not observable"
#: Elements of a matrix by rows: those of the triad that defines the body frame, and all.
LOWER, _ALL = np.tril_indices(3), np.nonzero(np.ones((3, 3)))


@dataclass(frozen=True)
class SensorCoefficient:
    """One coefficient of the error model, or an optional parameter."""

    sensor: str  #: "gyro" or "accelerometer".
    kind: str  #: "bias", "scale_factor" or "misalignment"; or the kind of an optional parameter.
    axis: str  #: "x"; for a misalignment, the sensor and the axis to which it is sensitive: "xy".
    unit: str  #: Unit in tables.
    per_si: float  #: Value in that unit for a value of 1 in SI (rad/s, m/s^2, 1, rad).
    size: float  #: A large error, SI, as prior; an estimate that depends on it is not observed.

    @property
    def name(self) -> str:
        """Name in tables: ``gyro_bias``, ``accelerometer_misalignment``, ..."""
        return f"{self.sensor}_{self.kind}"


def _bias(sensor: str, axis: str) -> SensorCoefficient:
    if sensor == "gyro":
        return SensorCoefficient(sensor, "bias", axis, "deg/h", RADPS_TO_DPH, 0.002)
    return SensorCoefficient(sensor, "bias", axis, "ug", 1.0 / UG_TO_MPS2, 0.1)


def _element(sensor: str, i: int, j: int) -> SensorCoefficient:
    if i == j:
        return SensorCoefficient(sensor, "scale_factor", AXES[i], "ppm", 1e6, 0.01)
    return SensorCoefficient(sensor, "misalignment", AXES[i] + AXES[j], "arcsec", RAD_TO_ARCSEC, 0.01)


def _coefficients(gyro: Sequence[IntArray], force: Sequence[IntArray]) -> tuple[SensorCoefficient, ...]:
    """Coefficients with these elements of the matrices."""
    return (
        *(_bias("gyro", axis) for axis in AXES),
        *(_element("gyro", i, j) for i, j in zip(*gyro, strict=True)),
        *(_bias("accelerometer", axis) for axis in AXES),
        *(_element("accelerometer", i, j) for i, j in zip(*force, strict=True)),
    )


#: The 21 independent coefficients in the body frame of the accelerometers, in the order of vectors.
COEFFICIENTS = _coefficients(_ALL, LOWER)
#: The 21 independent coefficients in the body frame of the gyros.
_GYRO_FRAME_COEFFICIENTS = _coefficients(LOWER, _ALL)
_DPH_PER_G = RADPS_TO_DPH * STANDARD_GRAVITY
#: Parameters that may be estimated in addition: positions of the accelerometers in the unit (lever arms),
#: their delay relative to the gyros, and their quadratic terms, ``K2 f^2``; sensitivities of the gyro biases
#: to specific force, ``G f``, by acceleration or by convection that depends on attitude; asymmetries of the
#: gyro scale factors, positive minus negative direction.
OPTIONAL_PARAMETERS = (
    *(
        SensorCoefficient("accelerometer", "lever_arm", AXES[i] + AXES[j], "mm", 1e3, 0.2)
        for i, j in zip(*_ALL, strict=True)
    ),
    SensorCoefficient("accelerometer", "delay", "", "ms", 1e3, 0.01),
    *(
        SensorCoefficient("accelerometer", "quadratic", axis, "ug/g2", STANDARD_GRAVITY**2 / UG_TO_MPS2, 1e-4)
        for axis in AXES
    ),
    *(
        SensorCoefficient("gyro", "g_sensitivity", AXES[i] + AXES[j], "deg/h/g", _DPH_PER_G, 1e-4)
        for i, j in zip(*_ALL, strict=True)
    ),
    *(SensorCoefficient("gyro", "scale_factor_asymmetry", axis, "ppm", 1e6, 1e-5) for axis in AXES),
)
COUNT = len(COEFFICIENTS)
_GYRO_BIAS, _GYRO_MATRIX = slice(0, 3), slice(3, 12)
_FORCE_BIAS, _FORCE_MATRIX = slice(12, 15), slice(15, 21)


@dataclass(frozen=True, eq=False)
class SensorErrors:
    """Errors of three gyros and three accelerometers, SI."""

    #: gyro_bias, force_bias: Shapes (3,), rad/s and m/s^2, of gyros and accelerometers.
    #: gyro_matrix, force_matrix: Shapes (3, 3), their scale factors and misalignments.
    gyro_bias: FloatArray = field(default_factory=lambda: np.zeros(3))
    gyro_matrix: FloatArray = field(default_factory=lambda: np.zeros((3, 3)))
    force_bias: FloatArray = field(default_factory=lambda: np.zeros(3))
    force_matrix: FloatArray = field(default_factory=lambda: np.zeros((3, 3)))

    @classmethod
    def from_vector(cls, values: FloatArray) -> Self:
        """Errors whose :data:`COEFFICIENTS` have these values (21,), SI."""
        force = np.zeros((3, 3))
        force[LOWER] = values[_FORCE_MATRIX]
        return cls(values[_GYRO_BIAS], values[_GYRO_MATRIX].reshape(3, 3), values[_FORCE_BIAS], force)

    def vector(self) -> FloatArray:
        """Values (21,) of :data:`COEFFICIENTS`, SI, after a change to the accelerometers' body frame."""
        converted, _ = self.in_accelerometer_frame()
        return _stacked(converted, _ALL, LOWER)

    def in_accelerometer_frame(self) -> tuple[SensorErrors, FloatArray]:
        """Errors of the same sensors in the accelerometers' body frame, and the rotation (3, 3) to it."""
        rotation = _rotation_to_lower(self.force_matrix)
        return self.rotated(rotation), rotation

    def in_gyro_frame(self) -> tuple[SensorErrors, FloatArray]:
        """Errors of the same sensors in the gyros' body frame, and the rotation (3, 3) to it."""
        rotation = _rotation_to_lower(self.gyro_matrix)
        return self.rotated(rotation), rotation

    def gyro_frame_vector(self) -> FloatArray:
        """Values (21,) of the coefficients in the gyros' body frame, SI."""
        converted, _ = self.in_gyro_frame()
        return _stacked(converted, LOWER, _ALL)

    def rotated(self, rotation: FloatArray) -> SensorErrors:
        """Errors of the same sensors in another body frame; ``rotation`` (3, 3) converts vectors to it."""
        gyro, force = (
            (np.eye(3) + matrix) @ rotation.T - np.eye(3) for matrix in (self.gyro_matrix, self.force_matrix)
        )
        return SensorErrors(self.gyro_bias, gyro, self.force_bias, force)

    def correction(self, interval_s: float) -> FloatArray:
        """Matrices (2, 3, 4) that convert measured increments (x, y, z, 1) to true angles and velocities."""
        inverses = np.linalg.inv(np.eye(3) + np.array([self.gyro_matrix, self.force_matrix]))
        biases = np.array([self.gyro_bias, self.force_bias])[:, :, np.newaxis]
        return np.concatenate([inverses, -interval_s * inverses @ biases], axis=2)

    def corrected(
        self, angle: FloatArray, velocity: FloatArray, interval_s: float
    ) -> tuple[FloatArray, FloatArray]:
        """Increments (n, 3) of angle (rad) and velocity (m/s) corrected for these errors."""
        gyro, force = self.correction(interval_s)
        return angle @ gyro[:, :3].T + gyro[:, 3], velocity @ force[:, :3].T + force[:, 3]


def _stacked(errors: SensorErrors, gyro: Sequence[IntArray], force: Sequence[IntArray]) -> FloatArray:
    """Biases and these elements of the matrices."""
    gyro_elements, force_elements = errors.gyro_matrix[*gyro], errors.force_matrix[*force]
    return np.concatenate([errors.gyro_bias, gyro_elements, errors.force_bias, force_elements])


def _rotation_to_lower(matrix: FloatArray) -> FloatArray:
    """Rotation (3, 3) to the body frame in which a triad's matrix is lower triangular.

    With ``I + M = L Q``, L lower triangular, the triad measures ``L (Q v)``: Q converts vectors of the given
    frame to the triad's.
    """
    upper = np.linalg.qr((np.eye(3) + matrix).T)
    return np.asarray((upper.Q * np.sign(np.diag(upper.R))).T)


@dataclass(frozen=True, eq=False)
class CoefficientEstimate:
    """Coefficients of one unit with their uncertainties."""

    #: values, covariance, is_observed: Shapes (n,), (n, n), (n,). Of the ``coefficients``, SI; meaningless if
    #: not observed.
    values: FloatArray
    covariance: FloatArray
    is_observed: BoolArray
    coefficients: tuple[SensorCoefficient, ...] = field(default=COEFFICIENTS, kw_only=True)
    #: Shapes (n, n). Covariances by source, which add up to the covariance; empty if it is not split.
    parts: Mapping[str, FloatArray] = field(default_factory=dict, kw_only=True)

    @property
    def sigmas(self) -> FloatArray:
        """Standard uncertainties (n,), SI."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    @property
    def correlations(self) -> FloatArray:
        """Correlation coefficients (n, n)."""
        return np.asarray(self.covariance / np.outer(self.sigmas, self.sigmas))

    @property
    def frame(self) -> str:
        """Sensors that define the body frame: "accelerometers" or "gyros"."""
        return "gyros" if self.coefficients[:COUNT] == _GYRO_FRAME_COEFFICIENTS else "accelerometers"

    def in_gyro_frame(self) -> Self:
        """Convert an estimate in the accelerometers' body frame to that of the gyros.

        A converted coefficient is observed if all coefficients on which it depends are.
        """

        def converted(values: FloatArray) -> FloatArray:
            return SensorErrors.from_vector(values).gyro_frame_vector()

        is_observed = self.is_observed[:COUNT]
        values = np.where(is_observed, self.values[:COUNT], 0.0)
        steps = _DERIVATIVE_STEP * np.array([each.size for each in COEFFICIENTS])
        jacobian = np.eye(len(self.values))
        for column, step in zip(jacobian[:COUNT, :COUNT].T, np.diag(steps), strict=True):
            above, below = (converted(values + sign * step) for sign in (1.0, -1.0))
            column[:] = (above - below) / (2.0 * step.sum())
        is_dependent = np.abs(jacobian[:COUNT, :COUNT]) > _MIN_DERIVATIVE
        return replace(
            self,
            values=np.concatenate([converted(values), self.values[COUNT:]]),
            covariance=jacobian @ self.covariance @ jacobian.T,
            is_observed=np.concatenate(
                [~is_dependent[:, ~is_observed].any(axis=1), self.is_observed[COUNT:]]
            ),
            coefficients=(*_GYRO_FRAME_COEFFICIENTS, *self.coefficients[COUNT:]),
            parts={name: jacobian @ part @ jacobian.T for name, part in self.parts.items()},
        )


#: Step of a numerical derivative, relative to the sizes of the coefficients; and the smallest derivative that
#: counts as a dependence, since smaller ones are of second order.
_DERIVATIVE_STEP, _MIN_DERIVATIVE = 1e-3, 0.1


def correlation_cells(values: FloatArray) -> list[str]:
    """Cells of correlation coefficients (n,); empty for NaN."""
    return [format_number(round(float(value), 4)) if np.isfinite(value) else "" for value in values]
