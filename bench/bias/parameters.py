"""Parameters of a dwell, in the order of the least-squares problem, and the error model that they are of.

First the parameters that dwells can share, then those of each window.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np

from gyrobench.bench.bias.noise_model import NoiseModel
from gyrobench.bench.foundations.arrays import (
    ARCSEC_TO_RAD,
    DPH_TO_RADPS,
    STANDARD_GRAVITY,
    UG_TO_MPS2,
    FloatArray,
    IntArray,
)
from gyrobench.bench.foundations.errors import DocumentError
from gyrobench.bench.navigation.error_model import INPUTS, Site

#: Indices of the parameters that dwells can share: biases of the gyros and their slopes with temperature,
#: accelerometer biases (body axes), rate North and Up fixed in the navigation frame, gyro error matrix by
#: rows.
GYRO_BIAS, GYRO_SLOPE, ACCELEROMETER_BIAS = slice(0, 3), slice(3, 6), slice(6, 9)
NAVIGATION_RATE, GYRO_MATRIX = slice(9, 11), slice(11, 20)
#: Drift of the accelerometer biases, m/s^3, body axes.
ACCELEROMETER_DRIFT = slice(20, 23)
#: Slopes of the accelerometer biases with their temperature, m/s^2/K, body axes.
ACCELEROMETER_SLOPE = slice(23, 26)
#: Rate at which the INS damps its velocity, 1/s: zero if it is free inertial.
DAMPING = 26
COMMON_COUNT = 27

#: Indices of the parameters of each window: constant of the heading; jumps of velocity East and North and of
#: the attitude error East, North and Up at its start; transient of the acceleration East and North after the
#: turn before it.
HEADING, VELOCITY, ATTITUDE, TRANSIENT = 0, slice(1, 3), slice(3, 6), slice(6, 8)
PER_WINDOW = 8
#: Attitude error about Up at the start of the first window.
FIRST_HEADING_ERROR = COMMON_COUNT + ATTITUDE.stop - 1

#: Prior of a gyro's bias, rad/s, so wide that it only keeps the problem regular.
WIDE_GYRO_BIAS = 0.01
_HEADING_SIGMA, _VELOCITY_SIGMA, _FIRST_ATTITUDE_SIGMA = 1.0, 10.0, 0.1


def inputs(C_nb: FloatArray, rate_body: FloatArray, count: int) -> FloatArray:
    """Input of the error model, (5, count), for a unit of each of ``count`` parameters.

    ``C_nb`` (3, 3): attitude; ``rate_body`` (3,): rotation against inertial space in body axes, rad/s.
    """
    columns = np.zeros((INPUTS, count))
    columns[:3, GYRO_BIAS] = C_nb
    columns[3:, ACCELEROMETER_BIAS] = C_nb[:2]
    columns[1:3, NAVIGATION_RATE] = np.eye(2)
    columns[:3, GYRO_MATRIX] = np.multiply.outer(C_nb, rate_body).reshape(3, 9)
    # A steady drift changes the velocity as the bias of the level gyro across it does: no fit separates them.
    columns[0, ACCELEROMETER_DRIFT] = -C_nb[1] / STANDARD_GRAVITY
    columns[1, ACCELEROMETER_DRIFT] = C_nb[0] / STANDARD_GRAVITY
    return columns


def transients(windows: int) -> IntArray:
    """Indices of the transients of all windows after the first."""
    first = COMMON_COUNT + PER_WINDOW * np.arange(1, windows)
    return np.add.outer(first, np.arange(PER_WINDOW)[TRANSIENT]).ravel()


def prior_root(prior: PriorKnowledge, windows: int, earth_rate: FloatArray) -> FloatArray:
    """Root ``L`` (p, p) of the parameters' prior covariance ``L @ L.T``.

    Parameters that only the data determine (initial errors, headings, jumps of velocity) have a prior so wide
    that it only keeps the problem regular. ``windows``: number of windows. ``earth_rate`` (3,): rotation of
    the Earth in ENU, rad/s, whose components in the INS depend on the latitude.
    """
    root = np.zeros((COMMON_COUNT + PER_WINDOW * windows,) * 2)
    sigmas = np.diagonal(root).copy()
    sigmas[GYRO_BIAS], sigmas[GYRO_SLOPE] = WIDE_GYRO_BIAS, prior.bias_slope
    sigmas[ACCELEROMETER_BIAS] = prior.accelerometer_bias
    sigmas[ACCELEROMETER_DRIFT] = prior.accelerometer_drift
    sigmas[ACCELEROMETER_SLOPE] = prior.accelerometer_slope
    matrix = np.full((3, 3), prior.gyro_misalignment)
    np.fill_diagonal(matrix, prior.gyro_scale_factor)
    sigmas[GYRO_MATRIX] = matrix.ravel()
    for window in range(windows):
        window_sigmas = sigmas[COMMON_COUNT + PER_WINDOW * window :][:PER_WINDOW]
        window_sigmas[HEADING], window_sigmas[VELOCITY] = _HEADING_SIGMA, _VELOCITY_SIGMA
        window_sigmas[ATTITUDE] = prior.tilt_step if window else _FIRST_ATTITUDE_SIGMA
        window_sigmas[TRANSIENT] = prior.accelerometer_transient if window else 0.0
    np.fill_diagonal(root, sigmas)
    root[NAVIGATION_RATE, NAVIGATION_RATE.start] = prior.latitude * np.array([earth_rate[2], -earth_rate[1]])
    return root


_ARCMIN = 60.0 * ARCSEC_TO_RAD


@dataclass(frozen=True)
class PriorKnowledge:
    """Standard uncertainties of the error sources other than gyro biases and noise, SI.

    Each enters the estimate as a parameter with this prior, so the bias's uncertainty includes it.

    Raises DocumentError if a value is negative or not a number.
    """

    accelerometer_bias: float = 1000.0 * UG_TO_MPS2  #: m/s^2; so large that the data determine it.
    #: gyro_scale_factor, gyro_misalignment: Errors of the gyros, which act in the turn and on the Earth's
    #: rotation; 1 and rad.
    gyro_scale_factor: float = 5e-6
    gyro_misalignment: float = 2.0 * ARCSEC_TO_RAD
    tilt_step: float = 1.0 * ARCSEC_TO_RAD  #: Tilt of the sensors on their mount in a turn, rad.
    #: Error of the latitude that the INS uses, rad: 20 arcsec of deflection of the vertical, not surveyed.
    latitude: float = 0.33 * _ARCMIN
    #: Change of a gyro's bias with its temperature within a dwell, rad/s/K.
    bias_slope: float = 0.001 * DPH_TO_RADPS
    #: rad; couples gravity into level accelerometers, so that their biases seem to differ between positions.
    #: Observable only in a solution of several dwells.
    accelerometer_misalignment: float = 5.0 * ARCSEC_TO_RAD
    #: Change of an accelerometer's bias in a dwell, m/s^3; not observable in a single dwell.
    accelerometer_drift: float = 20.0 * UG_TO_MPS2 / 3600.0
    #: Change of an accelerometer's bias by a turn, which decays, m/s^2; estimated only if it is significant.
    accelerometer_transient: float = 20.0 * UG_TO_MPS2
    #: Change of an accelerometer's bias with its temperature within a dwell, m/s^2/K, besides the drift.
    accelerometer_slope: float = 0.0

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if not (np.isfinite(value) and value >= 0.0):
                raise DocumentError(f"prior knowledge: {field.name} must not be negative; found {value}")

    def with_larger_gyro_errors(self, factor: float, scale_factor_ratio: float = 1.0) -> PriorKnowledge:
        """Copy with the errors of the gyros' matrix multiplied by a factor, its scale factors by both."""
        return replace(
            self,
            gyro_scale_factor=factor * scale_factor_ratio * self.gyro_scale_factor,
            gyro_misalignment=factor * self.gyro_misalignment,
        )

    @classmethod
    def from_datasheet(
        cls,
        accelerometer_bias_ug: float = 1000.0,
        gyro_scale_factor_ppm: float = 5.0,
        gyro_misalignment_arcsec: float = 2.0,
        tilt_step_arcsec: float = 1.0,
        latitude_arcmin: float = 0.33,
        bias_slope_dph_per_c: float = 0.001,
        accelerometer_misalignment_arcsec: float = 5.0,
        accelerometer_drift_ug_per_h: float = 20.0,
        accelerometer_transient_ug: float = 20.0,
        accelerometer_slope_ug_per_c: float = 0.0,
    ) -> PriorKnowledge:
        """Make the prior knowledge from values in the units of data sheets."""
        return cls(
            accelerometer_bias_ug * UG_TO_MPS2,
            gyro_scale_factor_ppm * 1e-6,
            gyro_misalignment_arcsec * ARCSEC_TO_RAD,
            tilt_step_arcsec * ARCSEC_TO_RAD,
            latitude_arcmin * _ARCMIN,
            bias_slope_dph_per_c * DPH_TO_RADPS,
            accelerometer_misalignment_arcsec * ARCSEC_TO_RAD,
            accelerometer_drift_ug_per_h * UG_TO_MPS2 / 3600.0,
            accelerometer_transient_ug * UG_TO_MPS2,
            accelerometer_slope_ug_per_c * UG_TO_MPS2,
        )


@dataclass(frozen=True)
class ErrorModel:
    """Error model of an INS at rest: where it stands, its noise, and prior knowledge of its other errors."""

    site: Site
    noise: NoiseModel
    prior: PriorKnowledge = PriorKnowledge()

    def at_latitude(self, latitude: float) -> ErrorModel:
        """The model for another latitude, rad."""
        return replace(self, site=replace(self.site, latitude=latitude))
