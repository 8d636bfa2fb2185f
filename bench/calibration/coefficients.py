"""The coefficients of the sensors' error model, and the body frame in which they are given.

A triad measures ``m + b + M m``, where m is the true rate or specific force in the body frame, b the biases
and M the matrix of scale factor errors (diagonal) and misalignments: the paper's (1) and (2). ``M[i, j]`` is
how much sensor i senses of axis j. These are 24 coefficients in a body frame given from outside, as by a
case or a table. Increments alone know no such frame: here body x is the input axis of the x accelerometer,
and that of the y accelerometer lies in the plane of x and y. Then the accelerometers' matrix is lower
triangular, and 21 coefficients are independent.

References
----------
Yu et al., "The Six-Position Calibration Technique of Gyro Bias for Rotational Inertial Navigation System
Based on Ring Laser Gyroscope", equations (1) and (2).
Camberlein and Mazzanti, "Calibration technique for laser gyro strapdown inertial navigation systems",
Symposium Gyro Technology, Stuttgart 1985: body frame fixed to the accelerometers.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Self

import numpy as np

from gyrobench.bench.foundations.arrays import RADPS_TO_DPH, UG_TO_MPS2, FloatArray
from gyrobench.bench.navigation.positions import AXES

_RAD_TO_ARCSEC = 3600.0 * 180.0 / np.pi
#: Elements of the accelerometers' matrix that are free, by rows.
LOWER = np.tril_indices(3)


@dataclass(frozen=True)
class Coefficient:
    """One coefficient."""

    sensor: str  #: "gyro" or "accelerometer".
    kind: str  #: "bias", "scale_factor" or "misalignment".
    axis: str  #: "x"; of a misalignment the sensor and the axis that it senses: "xy".
    unit: str  #: Unit in tables.
    per_si: float  #: Value in that unit for a value of 1 in SI (rad/s, m/s^2, 1, rad).
    size: float  #: Size of a large error, SI; an estimate that rests on it is not observed.

    @property
    def name(self) -> str:
        """Name in tables: ``gyro_bias``, ``accelerometer_misalignment``, ..."""
        return f"{self.sensor}_{self.kind}"


def _bias(sensor: str, axis: str) -> Coefficient:
    if sensor == "gyro":
        return Coefficient(sensor, "bias", axis, "deg/h", RADPS_TO_DPH, 0.002)
    return Coefficient(sensor, "bias", axis, "ug", 1.0 / UG_TO_MPS2, 0.1)


def _element(sensor: str, i: int, j: int) -> Coefficient:
    if i == j:
        return Coefficient(sensor, "scale_factor", AXES[i], "ppm", 1e6, 0.01)
    return Coefficient(sensor, "misalignment", AXES[i] + AXES[j], "arcsec", _RAD_TO_ARCSEC, 0.01)


#: The 21 independent coefficients, in the order of vectors.
COEFFICIENTS: tuple[Coefficient, ...] = (
    *(_bias("gyro", axis) for axis in AXES),
    *(_element("gyro", i, j) for i in range(3) for j in range(3)),
    *(_bias("accelerometer", axis) for axis in AXES),
    *(_element("accelerometer", int(i), int(j)) for i, j in zip(*LOWER, strict=True)),
)
COUNT = len(COEFFICIENTS)
_GYRO_BIAS, _GYRO_MATRIX = slice(0, 3), slice(3, 12)
_FORCE_BIAS, _FORCE_MATRIX = slice(12, 15), slice(15, 21)


def _nothing() -> FloatArray:
    return np.zeros(3)


def _no_matrix() -> FloatArray:
    return np.zeros((3, 3))


@dataclass(frozen=True, eq=False)
class SensorErrors:
    """Errors of three gyros and three accelerometers, SI."""

    gyro_bias: FloatArray = field(default_factory=_nothing)  #: Shape (3,), rad/s.
    gyro_matrix: FloatArray = field(
        default_factory=_no_matrix
    )  #: Shape (3, 3). Scale factors, misalignments.
    force_bias: FloatArray = field(default_factory=_nothing)  #: Shape (3,), m/s^2, of the accelerometers.
    force_matrix: FloatArray = field(default_factory=_no_matrix)  #: Shape (3, 3), of the accelerometers.

    @classmethod
    def from_vector(cls, values: FloatArray) -> Self:
        """Errors whose :data:`COEFFICIENTS` have these values (21,), SI."""
        force = np.zeros((3, 3))
        force[LOWER] = values[_FORCE_MATRIX]
        return cls(values[_GYRO_BIAS], values[_GYRO_MATRIX].reshape(3, 3), values[_FORCE_BIAS], force)

    def vector(self) -> FloatArray:
        """Values (21,) of :data:`COEFFICIENTS`, SI, after a change to the accelerometers' body frame."""
        here, _ = self.in_accelerometer_frame()
        return np.concatenate(
            [here.gyro_bias, here.gyro_matrix.ravel(), here.force_bias, here.force_matrix[LOWER]]
        )

    def in_accelerometer_frame(self) -> tuple[SensorErrors, FloatArray]:
        """The same sensors in the body frame fixed to the accelerometers, and the rotation (3, 3) to it.

        With ``I + M = L Q``, L lower triangular, the accelerometers measure ``L (Q f)``: Q turns vectors of
        the given frame into the accelerometers' one.
        """
        upper = np.linalg.qr((np.eye(3) + self.force_matrix).T)
        signs = np.sign(np.diag(upper.R))
        return self.turned((upper.Q * signs).T), (upper.Q * signs).T

    def turned(self, rotation: FloatArray) -> SensorErrors:
        """The same sensors in another body frame, to which ``rotation`` (3, 3) turns vectors of this one."""
        gyro, force = (
            (np.eye(3) + matrix) @ rotation.T - np.eye(3) for matrix in (self.gyro_matrix, self.force_matrix)
        )
        return SensorErrors(self.gyro_bias, gyro, self.force_bias, force)

    def removed(
        self, angle: FloatArray, velocity: FloatArray, interval_s: float
    ) -> tuple[FloatArray, FloatArray]:
        """True increments (n, 3) of angle (rad) and velocity (m/s) from measured ones."""
        return (
            _removed(angle, self.gyro_bias, self.gyro_matrix, interval_s),
            _removed(velocity, self.force_bias, self.force_matrix, interval_s),
        )


def _removed(measured: FloatArray, bias: FloatArray, matrix: FloatArray, interval_s: float) -> FloatArray:
    return np.ascontiguousarray((measured - bias * interval_s) @ np.linalg.inv(np.eye(3) + matrix).T)
