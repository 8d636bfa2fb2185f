"""Biases for a calibration check: from alignments, and from the navigation straight after one.

An INS that levelled and gyrocompassed itself starts with the attitude errors that its own sensors
make: tilts that hide the accelerometer biases, and a heading at which the East gyro's bias hides
behind the Earth's rotation. So the heading after alignment shows the East gyro, and the velocity
East of the navigation that follows shows the North gyro. An accelerometer bias ``a`` along the same
axis is not separable from the gyro's here: both show ``b - (W_U / g) a``, 0.9e-3 deg/h for 100 ug at
middle latitudes. What is known of ``a`` from the calibration is taken into account.

References
----------
Yu et al., "The Six-Position Calibration Technique of Gyro Bias for Rotational Inertial
Navigation System Based on Ring Laser Gyroscope", section 5: the two methods by name; how they are
evaluated is worked out here.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from gyrobench.bench.bias import parameters
from gyrobench.bench.bias.bias_filter import BiasFilter
from gyrobench.bench.bias.dwell import Dwell, NavigationWindow
from gyrobench.bench.bias.noise_model import NoiseModel
from gyrobench.bench.bias.paper import TURN_TOLERANCE, PolynomialTrend
from gyrobench.bench.bias.parameters import PriorKnowledge
from gyrobench.bench.bias.statistics import solve
from gyrobench.bench.foundations.arrays import RADPS_TO_DPH, FloatArray
from gyrobench.bench.foundations.errors import MeasurementError
from gyrobench.bench.navigation.attitude import UP, angle_between, rotation_matrix, rotation_vector_enu
from gyrobench.bench.navigation.earth import earth_rate_enu
from gyrobench.bench.navigation.error_model import Site

_EAST, _NORTH = np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0])


@dataclass(frozen=True)
class AxisBias:
    """Bias along one direction that an INS in one attitude shows."""

    direction: tuple[float, float, float]  #: Unit vector in body axes.
    #: bias_radps, sigma_radps: Bias along it and its standard uncertainty.
    bias_radps: float
    sigma_radps: float

    @property
    def bias_dph(self) -> float:
        """Bias, deg/h."""
        return self.bias_radps * RADPS_TO_DPH

    @property
    def sigma_dph(self) -> float:
        """Its standard uncertainty, deg/h."""
        return self.sigma_radps * RADPS_TO_DPH


@dataclass(frozen=True, eq=False)
class KnownAccelerometers:
    """Accelerometer biases of the calibration, m/s^2, body axes."""

    #: bias, sigma: Shape (3,). Values and standard uncertainties.
    bias: FloatArray
    sigma: FloatArray

    def along(self, direction: FloatArray) -> tuple[float, float]:
        """Bias and standard uncertainty along a unit vector (3,) in body axes."""
        return float(direction @ self.bias), float(np.linalg.norm(direction * self.sigma))


def bias_from_alignments(
    first: Dwell,
    second: Dwell,
    align_s: float,
    site: Site,
    noise: NoiseModel,
    prior: PriorKnowledge,
    accelerometers: KnownAccelerometers,
) -> AxisBias:
    """Bias of the gyro that points East, from two alignments half a turn apart.

    Each heading error is the bias over the Earth's horizontal rate; the table's own azimuth error is
    the same in both and drops out. Misalignment towards the vertical shows as bias.

    ``first`` and ``second``: navigation straight from the alignments, in one position. ``align_s``: length of
    each alignment, s; sets the noise of the heading. An INS that uses less of that time has more noise.
    Raises MeasurementError if the two are not half a turn apart.
    """
    _check_half_turn(first, second)
    _, rate_n, rate_u = earth_rate_enu(site.latitude)
    headings = [_heading_error(each) for each in (first, second)]
    sigmas = (
        noise.angle_random_walk / math.sqrt(2.0 * align_s),
        noise.heading_white * rate_n / math.sqrt(2.0),
        prior.tilt_step * rate_n / 2.0,
        prior.gyro_misalignment * rate_u,
    )
    shown = float(rate_n * (headings[0] - headings[1]) / 2.0)
    east = first.C_nb_table[0].T @ _EAST
    return _without_accelerometer(east, shown, math.hypot(*sigmas), site, accelerometers)


def bias_from_velocity(
    dwell: Dwell,
    align_s: float,
    site: Site,
    noise: NoiseModel,
    prior: PriorKnowledge,
    accelerometers: KnownAccelerometers,
) -> AxisBias:
    """Bias of the gyro that points North, from the navigation straight after an alignment.

    The full error model, started as the alignment leaves it, is fitted to the whole output.

    ``dwell``: with one window. ``align_s``: length of the alignment, s; sets the noise of the first attitude.
    Raises MeasurementError if there is not one window.
    """
    window = _only_window(dwell)
    bias_filter = BiasFilter(site, noise, prior)
    bias_filter.begin_window(window.time_s[0], window.C_nb[0])
    bias_filter.add(window)
    information = bias_filter.information()
    mean, root = _aligned_prior(window.C_nb[0], align_s, site, noise, prior, accelerometers)
    values, covariance = solve(information.rows, information.data - information.rows @ mean, root)
    north = window.C_nb[0].T @ _NORTH
    weights = north @ information.bias_at_mean
    return _axis_bias(north, float(weights @ (values + mean)), math.sqrt(weights @ covariance @ weights))


def bias_from_velocity_slope(
    dwell: Dwell, site: Site, noise: NoiseModel, accelerometers: KnownAccelerometers
) -> AxisBias:
    """Bias of the gyro that points North by the second slope of the velocity East over g.

    The paper's neglect of the Schuler loop and the Earth's rotation, for comparison. Raises MeasurementError
    if there is not one window.
    """
    window = _only_window(dwell)
    time = window.time_s - window.time_s[0]
    weights = PolynomialTrend(time, 2).weights / site.gravity
    shown = float(window.velocity_enu_mps[:, 0] @ weights)
    sigma = math.sqrt(float(noise.velocity_variance(time, weights, site.gravity)))
    return _without_accelerometer(window.C_nb[0].T @ _NORTH, shown, sigma, site, accelerometers)


def _check_half_turn(first: Dwell, second: Dwell) -> None:
    half_turned = rotation_matrix(UP, np.pi) @ first.C_nb_table[0]
    if angle_between(second.C_nb_table[0], half_turned) > TURN_TOLERANCE:
        raise MeasurementError(
            f"{first.position_name}: two alignments give a bias only if they are half a turn apart. "
            "Align once at an azimuth and once 180 deg from it"
        )


def _only_window(dwell: Dwell) -> NavigationWindow:
    if len(dwell.windows) != 1:
        raise MeasurementError(
            f"{dwell.position_name}: {len(dwell.windows)} windows of navigation; a calibration check has "
            "one, straight from the alignment"
        )
    return dwell.windows[0]


def _heading_error(dwell: Dwell) -> float:
    """Heading that the INS starts with, less that of the table, rad."""
    return float(rotation_vector_enu(dwell.windows[0].C_nb[:1], dwell.C_nb_table[0])[0, 2])


def _aligned_prior(
    C_nb: FloatArray,
    align_s: float,
    site: Site,
    noise: NoiseModel,
    prior: PriorKnowledge,
    accelerometers: KnownAccelerometers,
) -> tuple[FloatArray, FloatArray]:
    """Mean (p,) and root (p, p) of the covariance of the parameters after an alignment."""
    earth_rate = earth_rate_enu(site.latitude)
    level = noise.velocity_random_walk / site.gravity / math.sqrt(align_s)
    heading = noise.angle_random_walk / earth_rate[1] / math.sqrt(align_s)
    root = parameters.prior_root(prior, 1, earth_rate)
    root[parameters.ACCELEROMETER_BIAS, parameters.ACCELEROMETER_BIAS] = np.diag(accelerometers.sigma)
    attitude = np.arange(len(root))[parameters.COMMON :][parameters.ATTITUDE]
    root[attitude, attitude] = level, level, heading
    mean = np.zeros(len(root))
    mean[parameters.ACCELEROMETER_BIAS] = accelerometers.bias
    tie = np.zeros_like(root)
    tie[attitude] = _aligned_attitude(C_nb, earth_rate, site.gravity, len(root))
    return mean + tie @ mean, root + tie @ root


def _aligned_attitude(C_nb: FloatArray, earth_rate: FloatArray, gravity: float, count: int) -> FloatArray:
    """First attitude error (3, count) that a unit of each parameter makes: level, gyrocompassed."""
    _, rate_n, rate_u = earth_rate
    driven = parameters.inputs(C_nb, C_nb.T @ earth_rate, count)
    east_rate, tilt_n, tilt_e = driven[0], driven[3] / gravity, -driven[4] / gravity
    return np.stack([tilt_e, tilt_n, (rate_u * tilt_n - east_rate) / rate_n])


def _without_accelerometer(
    direction: FloatArray, shown: float, sigma: float, site: Site, accelerometers: KnownAccelerometers
) -> AxisBias:
    """Add what the accelerometer bias along ``direction`` takes from the bias that is shown."""
    factor = earth_rate_enu(site.latitude)[2] / site.gravity
    hidden, spread = accelerometers.along(direction)
    return _axis_bias(direction, shown + factor * hidden, math.hypot(sigma, factor * spread))


def _axis_bias(direction: FloatArray, bias: float, sigma: float) -> AxisBias:
    x, y, z = (float(value) for value in direction)
    return AxisBias((x, y, z), bias, sigma)
