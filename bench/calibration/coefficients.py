"""The coefficients of the sensors' error model, and the body frame in which they are given.

A triad measures ``m + b + M m``, where m is the true rate or specific force in the body frame, b the biases
and M the matrix of scale factor errors (diagonal) and misalignments: the paper's (1) and (2). ``M[i, j]`` is
how much sensor i senses of axis j. These are 24 coefficients in a body frame given from outside, as by a
case or a table. Increments alone know no such frame: here body x is the input axis of the x accelerometer,
and that of the y accelerometer lies in the plane of x and y. Then the accelerometers' matrix is lower
triangular, and 21 coefficients are independent. Gyros may fix the body frame in the same way instead; any
other frame, as of a case, follows by :meth:`SensorErrors.turned`.

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
)
from gyrobench.bench.navigation.positions import AXES

#: Elements of the accelerometers' matrix that are free, by rows.
LOWER = np.tril_indices(3)


@dataclass(frozen=True)
class SensorCoefficient:
    """One coefficient."""

    sensor: str  #: "gyro" or "accelerometer".
    kind: str  #: "bias", "scale_factor" or "misalignment"; or what is estimated beside them.
    axis: str  #: "x"; of a misalignment the sensor and the axis that it senses: "xy".
    unit: str  #: Unit in tables.
    per_si: float  #: Value in that unit for a value of 1 in SI (rad/s, m/s^2, 1, rad).
    size: float  #: Size of a large error, SI; an estimate that rests on it is not observed.

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


_ALL = tuple((i, j) for i in range(3) for j in range(3))
_LOWER = tuple((int(i), int(j)) for i, j in zip(*LOWER, strict=True))


def _coefficients(
    gyro: Sequence[tuple[int, int]], force: Sequence[tuple[int, int]]
) -> tuple[SensorCoefficient, ...]:
    return (
        *(_bias("gyro", axis) for axis in AXES),
        *(_element("gyro", *place) for place in gyro),
        *(_bias("accelerometer", axis) for axis in AXES),
        *(_element("accelerometer", *place) for place in force),
    )


#: The 21 independent coefficients in the body frame of the accelerometers, in the order of vectors.
COEFFICIENTS = _coefficients(_ALL, _LOWER)
#: The same in the body frame of the gyros.
_GYRO_FRAME_COEFFICIENTS = _coefficients(_LOWER, _ALL)
_DPH_PER_G = RADPS_TO_DPH * STANDARD_GRAVITY
#: What may be estimated beside them: places of the accelerometers in the unit, their delay against the gyros,
#: and their quadratic terms, ``K2 f^2``; biases of the gyros that follow the specific force, ``G f``, by
#: acceleration or by heat that rises to another side in another attitude; asymmetries of their scale factors,
#: those in positive direction less those in negative.
BESIDE = (
    *(
        SensorCoefficient("accelerometer", "lever_arm", AXES[i] + AXES[j], "mm", 1e3, 0.2)
        for i in range(3)
        for j in range(3)
    ),
    SensorCoefficient("accelerometer", "delay", "", "ms", 1e3, 0.01),
    *(
        SensorCoefficient("accelerometer", "quadratic", axis, "ug/g2", STANDARD_GRAVITY**2 / UG_TO_MPS2, 1e-4)
        for axis in AXES
    ),
    *(
        SensorCoefficient("gyro", "g_sensitivity", AXES[i] + AXES[j], "deg/h/g", _DPH_PER_G, 1e-4)
        for i in range(3)
        for j in range(3)
    ),
    *(SensorCoefficient("gyro", "scale_factor_asymmetry", axis, "ppm", 1e6, 1e-5) for axis in AXES),
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
    #: Shape (3, 3). Scale factors and misalignments.
    gyro_matrix: FloatArray = field(default_factory=_no_matrix)
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
        """The same sensors in the body frame fixed to the accelerometers, and the rotation (3, 3) to it."""
        rotation = _rotation_to_lower(self.force_matrix)
        return self.turned(rotation), rotation

    def in_gyro_frame(self) -> tuple[SensorErrors, FloatArray]:
        """The same sensors in the body frame fixed to the gyros, and the rotation (3, 3) to it."""
        rotation = _rotation_to_lower(self.gyro_matrix)
        return self.turned(rotation), rotation

    def turned(self, rotation: FloatArray) -> SensorErrors:
        """The same sensors in another body frame, to which ``rotation`` (3, 3) turns vectors of this one."""
        gyro, force = (
            (np.eye(3) + matrix) @ rotation.T - np.eye(3) for matrix in (self.gyro_matrix, self.force_matrix)
        )
        return SensorErrors(self.gyro_bias, gyro, self.force_bias, force)

    def removal(self, interval_s: float) -> FloatArray:
        """Matrices (2, 3, 4) that give true increments of angle and velocity from measured ones and 1."""
        inverses = np.linalg.inv(np.eye(3) + np.array([self.gyro_matrix, self.force_matrix]))
        biases = np.array([self.gyro_bias, self.force_bias])[:, :, np.newaxis]
        return np.concatenate([inverses, -interval_s * inverses @ biases], axis=2)

    def removed(
        self, angle: FloatArray, velocity: FloatArray, interval_s: float
    ) -> tuple[FloatArray, FloatArray]:
        """True increments (n, 3) of angle (rad) and velocity (m/s) from measured ones."""
        gyro, force = self.removal(interval_s)
        return angle @ gyro[:, :3].T + gyro[:, 3], velocity @ force[:, :3].T + force[:, 3]


def _rotation_to_lower(matrix: FloatArray) -> FloatArray:
    """Rotation (3, 3) to the body frame in which a triad's matrix is lower triangular.

    With ``I + M = L Q``, L lower triangular, the triad measures ``L (Q v)``: Q turns vectors of the given
    frame into the triad's.
    """
    upper = np.linalg.qr((np.eye(3) + matrix).T)
    return np.asarray((upper.Q * np.sign(np.diag(upper.R))).T)


@dataclass(frozen=True, eq=False)
class CoefficientEstimate:
    """Coefficients of one unit with their uncertainties."""

    #: values, covariance, is_observed: Shapes (n,), (n, n), (n,). Of the ``coefficients``, SI; without
    #: meaning where not observed.
    values: FloatArray
    covariance: FloatArray
    is_observed: BoolArray
    coefficients: tuple[SensorCoefficient, ...] = field(default=COEFFICIENTS, kw_only=True)
    #: Shapes (n, n). Covariances by source, which add up to the covariance; empty where it is not split.
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
        """Sensors that the body frame is fixed to: "accelerometers" or "gyros"."""
        return "gyros" if self.coefficients[:COUNT] == _GYRO_FRAME_COEFFICIENTS else "accelerometers"

    def in_gyro_frame(self) -> Self:
        """The estimate, from the accelerometers' body frame, in that of the gyros.

        A coefficient is observed there if all those are that it depends on.
        """
        is_observed = self.is_observed[:COUNT]
        values = np.where(is_observed, self.values[:COUNT], 0.0)
        steps = _STEP * np.array([each.size for each in COEFFICIENTS])
        jacobian = np.eye(len(self.values))
        jacobian[:COUNT, :COUNT] = np.column_stack(
            [
                (_gyro_frame_vector(values + step) - _gyro_frame_vector(values - step)) / (2.0 * step.sum())
                for step in np.diag(steps)
            ]
        )
        rests_on_unseen = (np.abs(jacobian[:COUNT, :COUNT]) > _MIN_SHARE)[:, ~is_observed].any(axis=1)
        return replace(
            self,
            values=np.concatenate([_gyro_frame_vector(values), self.values[COUNT:]]),
            covariance=jacobian @ self.covariance @ jacobian.T,
            is_observed=np.concatenate([~rests_on_unseen, self.is_observed[COUNT:]]),
            coefficients=(*_GYRO_FRAME_COEFFICIENTS, *self.coefficients[COUNT:]),
            parts={name: jacobian @ part @ jacobian.T for name, part in self.parts.items()},
        )


#: Step of a numerical derivative, in sizes of the coefficients; smaller derivatives are of second order.
_STEP, _MIN_SHARE = 1e-3, 0.1


def _gyro_frame_vector(values: FloatArray) -> FloatArray:
    there, _ = SensorErrors.from_vector(values).in_gyro_frame()
    return np.concatenate(
        [there.gyro_bias, there.gyro_matrix[LOWER], there.force_bias, there.force_matrix.ravel()]
    )
