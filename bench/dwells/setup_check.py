"""Scale and axes of the velocities and sign of the latitude, tested on what the INS itself navigates.

Signs and axes are tested before, see :mod:`gyrobench.bench.dwells.sign_check`. More mistakes of a station
file let a dwell look good:

* Velocities with a wrong scale make the biases of the level gyros wrong by the same factor; in axes turned
  about Up, as wander azimuth or grid axes, part of one level bias becomes part of the other. The tilt since
  the begin of a window lets gravity in, ``dV_E/dt = g r_N + 2 W_U V_N + constant`` and ``dV_N/dt = -g r_E -
  2 W_U V_E + constant``, so that a regression of both velocities on both integrals of the tilt gives a matrix
  (2, 2): the identity, a scale or a rotation. Earth rate and damping by the INS are free in it, transient and
  temperature slope of the accelerometers have their prior uncertainty; noise of the attitude, which makes a
  regression's slope smaller, is subtracted from its moment.
* A steady drift of each accelerometer is free in each dwell: to velocity it is what a bias of a level gyro is
  to the tilt. From window to window it may change by its prior uncertainty, or by as much as the windows show
  where the velocities are right. What is left for the matrix is the random walk of the gyros, and what a
  turn does not change the sign of.
* The heading turns by ``V_E tan(latitude)/R``. What another latitude makes of it looks like a bias with a
  slope, so that of an INS which sends its latitude it is compared with the station's.
* A latitude of the wrong hemisphere turns the Coriolis acceleration, and the rate of the heading, round.
  The full error model is fitted with both latitudes. It shows in proportion to what it does to the biases:
  little in a unit with accelerometer biases of some micro-g.

What one dwell leaves open, all dwells of a run decide together.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from gyrobench.bench.bias.bias_filter import Damping, chi2_at, estimate_state_space
from gyrobench.bench.bias.dwell import Dwell, NavigationWindow
from gyrobench.bench.bias.noise_model import NoiseModel, rounding_sigma
from gyrobench.bench.bias.parameters import PriorKnowledge
from gyrobench.bench.bias.statistics import chi2_p_value
from gyrobench.bench.bias.window_filter import EPOCH_S, TRANSIENT_S
from gyrobench.bench.foundations.arrays import UG_TO_MPS2, FloatArray
from gyrobench.bench.foundations.errors import MeasurementError, SignalMapError
from gyrobench.bench.navigation.attitude import rotation_vector_enu
from gyrobench.bench.navigation.earth import EARTH_RATE
from gyrobench.bench.navigation.error_model import Site
from gyrobench.bench.navigation.positions import AXES

#: A scale, or an angle in rad, is wrong if it is off by more than this many standard uncertainties, as one in
#: a hundred thousand good units is whose uncertainty is stated a tenth too large, and by more than this.
_MIN_SIGMAS, _MIN_ERROR = 4.2, 0.03
#: Accelerometers drift more than expected below this probability.
_MIN_DRIFT_P_VALUE = 1e-5
#: Other differences of the matrix from the identity reduce what speaks for one cause by this factor at most.
_MAX_LEFT = 4.0
#: Angles tried at once, and how finely, rad.
_ANGLES, _ANGLE_STEP = 73, 1e-5
#: Largest share of the tilt's moment that noise of the attitude may have.
_MAX_NOISE_SHARE = 0.1
#: A drift of an accelerometer of which nothing is known beforehand, as a multiple of its prior uncertainty.
_WIDE_DRIFT = 1e4
#: Means of the epochs of a window that the regression uses, and epochs for the two latitudes.
_MEANS, _LATITUDE_EPOCHS = 60, 60
#: Output without any noise, m/s.
_MIN_WHITE_MPS = 1e-6
#: The opposite latitude is right if chi2 is less by this much there, and explained by the noise.
_MIN_CHI2_GAIN, _MAX_CHI2_PER_DATUM = 30.0, 1.5
#: Latitudes of INS and station differ by more than an INS drifts while it navigates on the bench, rad.
_MAX_LATITUDE_APART = math.radians(0.05)
_VELOCITIES = ("ins.signals.velocity_east", "ins.signals.velocity_north")
#: Parameters of a window: matrix by rows, Earth rate, damping, drift of the acceleration East and North; last
#: the velocity. Those of a dwell have the drift of each accelerometer, then its changes East and North in
#: each window. Prior uncertainty of the Earth rate about Up over its size, and of damping, 1/s.
_MATRIX, _DRIFT, _OF_WINDOW = slice(0, 4), slice(6, 8), 8
_OF_DWELL, _PRIOR_RATE, _PRIOR_DAMPING = 9, 1.0, 0.01
#: The first of them where the latitude is that of the station.
_LATITUDE_RATE = 0.1
#: What multiplies a velocity by each factor.
_UNITS = {
    0.5: "half the scale", 2.0: "twice the scale", 10.0: "ten times the scale", 0.1: "a tenth of the scale",
    1.0 / 0.514444: "knots taken for m/s", 0.514444: "m/s taken for knots",
    3.6: "km/h taken for m/s", 1.0 / 3.6: "m/s taken for km/h",
    1.0 / 0.3048: "ft/s taken for m/s", 0.3048: "m/s taken for ft/s",
    100.0: "cm/s taken for m/s", 0.01: "m/s taken for cm/s",
    1000.0: "mm/s taken for m/s", 0.001: "m/s taken for mm/s",
}  # fmt: skip
_MAX_NAMED_SIGMAS, _MAX_NAMED_SHARE = 2.0, 0.02


@dataclass(frozen=True, eq=False, slots=True)
class SetupEvidence:
    """What one dwell shows of the set-up."""

    #: matrix, covariance: Shapes (4,), (4, 4). By rows: velocity East and North of what the tilt leads to
    #: East and North; right velocities have the identity.
    matrix: FloatArray
    covariance: FloatArray
    #: damping, drift, drift_sigma: Of velocities that are right, by the tilt. Drift of the accelerometers,
    #: body axes, shape (3,), m/s^3; uncertainty of the measurement, and of what is expected, shape (2, 3).
    damping: Damping
    drift: FloatArray
    drift_sigma: FloatArray
    latitude: float  #: Declared, rad.
    opposite_gain: float  #: By how much chi2 is less at the opposite latitude.


def setup_evidence(
    dwell: Dwell, site: Site, noise: NoiseModel, prior: PriorKnowledge, heading_step_rad: float
) -> SetupEvidence | None:
    """What a dwell without jumps of the output shows; None where that is nothing.

    ``heading_step_rad``: resolution of the attitude.
    """
    # A station may declare less than a unit has.
    usual = PriorKnowledge()
    wide = replace(
        prior,
        accelerometer_drift=max(prior.accelerometer_drift, usual.accelerometer_drift),
        accelerometer_transient=max(prior.accelerometer_transient, usual.accelerometer_transient),
        accelerometer_slope=max(prior.accelerometer_slope, usual.accelerometer_slope),
    )
    moments, attitude_noise, count, apart = _dwell_moments(dwell, site.gravity, noise, wide, heading_step_rad)
    if (attitude_noise > _MAX_NOISE_SHARE * np.diag(moments)[_MATRIX]).any() or not np.isfinite(
        moments
    ).all():
        return None
    values, rows, chi2 = _solved(moments, attitude_noise)
    scatter = max(1.0, chi2 / (count - _OF_WINDOW))
    if len(dwell.windows) > 1:
        scatter = max(scatter, (chi2 - apart) / (_OF_WINDOW * (len(dwell.windows) - 1)))
    covariance = np.asarray(scatter * np.linalg.inv(rows)[_MATRIX, _MATRIX])
    if not (np.linalg.eigvalsh(covariance) > 0.0).all():
        return None
    others, others_covariance = _where_right(moments, site.latitude)
    sigma = np.sqrt(scatter * np.diag(others_covariance))
    return SetupEvidence(
        matrix=values[_MATRIX],
        covariance=covariance,
        damping=Damping(float(others[1]), float(sigma[1])),
        drift=others[2:5] * wide.accelerometer_drift,
        drift_sigma=wide.accelerometer_drift * np.stack([sigma[2:5], np.ones(3)]),
        latitude=site.latitude,
        opposite_gain=_opposite_gain(dwell, site, noise, prior),
    )


def setup_fault(several: Sequence[SetupEvidence]) -> str:
    """What is wrong with the set-up by the dwells together, and what to do; empty where nothing is."""
    if not several:
        return ""
    return _velocity_fault(several) or _latitude_fault(several)


def latitude_fault(sent: float, site: Site) -> str:
    """What is wrong if the INS sends another latitude than the station's, both rad; empty if it does not.

    Smaller errors show in the data, see :mod:`gyrobench.bench.dwells.run_results`.
    """
    if not abs(sent - site.latitude) > _MAX_LATITUDE_APART:  # NaN where it sends none
        return ""
    return (
        f"the INS uses a latitude of {math.degrees(sent):.4f} deg, location.latitude_deg is "
        f"{math.degrees(site.latitude):.4f} deg. Correct the one that is wrong"
    )


def raise_setup_fault(evidence: SetupEvidence | None) -> None:
    """Raises SignalMapError where one dwell by itself contradicts the set-up."""
    if evidence and (fault := setup_fault([evidence])):
        raise SignalMapError(fault)


def drift_fault(evidence: SetupEvidence) -> str:
    """That the accelerometers drift more in a dwell than expected; empty if they do not."""
    expected = np.linalg.norm(evidence.drift_sigma, axis=0)
    # That of a vertical axis is not observable, and adds nothing.
    if chi2_p_value(2, float(((evidence.drift / expected) ** 2).sum())) > _MIN_DRIFT_P_VALUE:
        return ""
    axis = int(np.argmax(np.abs(evidence.drift) / expected))
    drift, sigma = np.array([evidence.drift[axis], evidence.drift_sigma[0, axis]]) * 3600.0 / UG_TO_MPS2
    return (
        f"the {AXES[axis]} accelerometer drifts by {drift:.0f} ± {sigma:.0f} ug/h against the tilt of the "
        "INS, more than ins.uncertainty.accelerometer_drift_ug_per_h allows for: a level gyro seems to have "
        f"{math.degrees(1e-6 * abs(drift)):.3f} deg/h more. Measure where the temperature has settled, or "
        "declare that drift. If the bias follows the temperature, declare accelerometer_slope_ug_per_c"
    )


def measured_scale(several: Sequence[SetupEvidence]) -> tuple[float, float]:
    """Scale of the velocities by the dwells together, and its standard uncertainty."""
    return _scale(*_pooled(several), np.ones(2))


def _pooled(several: Sequence[SetupEvidence]) -> tuple[FloatArray, FloatArray]:
    """Matrix (4,) of several dwells, and its information (4, 4)."""
    matrices = np.array([each.matrix for each in several])
    inverses = np.linalg.inv(np.array([each.covariance for each in several]))
    information = inverses.sum(axis=0)
    matrix = np.linalg.solve(information, np.einsum("nij,nj->i", inverses, matrices))
    chi2 = float(np.einsum("ni,nij,nj->", matrices - matrix, inverses, matrices - matrix))
    return matrix, information / max(1.0, chi2 / max(4 * (len(several) - 1), 1))


def _scale(matrix: FloatArray, information: FloatArray, chosen: FloatArray) -> tuple[float, float]:
    """Common scale of the velocities chosen by ones (2,), if nothing else is wrong, and its uncertainty."""
    along = np.diag(chosen).ravel()
    weight = float(along @ information @ along)
    return 1.0 + float(along @ information @ (matrix - np.eye(2).ravel())) / weight, weight**-0.5


def _rotation(angle: float | FloatArray) -> FloatArray:
    """Matrix by rows (..., 4) of velocities turned about Up."""
    c, s = np.cos(angle), np.sin(angle)
    return np.stack([c, -s, s, c], axis=-1)


def _angle(matrix: FloatArray, information: FloatArray) -> tuple[float, float, float]:
    """Angle about Up if nothing else is wrong, and its uncertainty, rad; by how much chi2 is less there."""

    def chi2(angle: FloatArray) -> FloatArray:
        away = _rotation(angle) - matrix
        return np.asarray(np.einsum("ni,ij,nj->n", away, information, away))

    angle, width = 0.0, math.pi
    while width > _ANGLE_STEP:
        tried = angle + width * np.linspace(-1.0, 1.0, _ANGLES)
        angle, width = float(tried[np.argmin(chi2(tried))]), 4.0 * width / _ANGLES
    change = _rotation(angle + 0.5 * math.pi)
    right, found = chi2(np.array([0.0, angle]))
    return angle, float(change @ information @ change) ** -0.5, float(right - found)


def _velocity_fault(several: Sequence[SetupEvidence]) -> str:
    matrix, information = _pooled(several)
    found = [(*_scale(matrix, information, chosen), chosen) for chosen in (np.ones(2), *np.eye(2))]
    value, sigma, chosen = max(found, key=lambda each: abs(each[0] - 1.0) / each[1])
    angle, angle_sigma, angle_gain = _angle(matrix, information)
    gain = ((value - 1.0) / sigma) ** 2
    is_turned = angle_gain > gain
    if is_turned:
        gain = angle_gain
    # Disturbed accelerometers make a matrix that is neither a scale nor a rotation.
    away = matrix - np.eye(2).ravel()
    left = float(away @ information @ away) - gain
    gain /= min(max(1.0, left / 3.0), _MAX_LEFT)
    if gain <= _MIN_SIGMAS**2 or (abs(angle) if is_turned else abs(value - 1.0)) <= _MIN_ERROR:
        return ""
    if is_turned:
        return (
            f"{' and '.join(_VELOCITIES)} are turned by {math.degrees(angle):.3g} ± "
            f"{math.degrees(angle_sigma):.1g} deg about Up against what the tilt of the INS leads to, as in "
            "wander azimuth or grid axes: parts of the biases of the level gyros are exchanged. Map signals "
            "of the velocities East and North, or set the INS to send those"
        )
    names = [name for name, of in zip(_VELOCITIES, chosen, strict=True) if of]
    has = "have" if len(names) > 1 else "has"
    return (
        f"{' and '.join(names)} {has} a wrong scale: {value:.3g} ± {sigma:.1g} times what the tilt of the "
        f"INS leads to{_named(value, sigma)}. The biases of the level gyros are wrong by the same factor. "
        "Correct the scale or unit in the DBC or the station file"
    )


def _named(value: float, sigma: float) -> str:
    """Units that fit a scale."""
    limit = max(_MAX_NAMED_SIGMAS * sigma, _MAX_NAMED_SHARE * abs(value))
    near = sorted((abs(value - ratio), text) for ratio, text in _UNITS.items() if abs(value - ratio) < limit)
    return f", as {' or '.join(text for _, text in near)}" if near else ""


def _latitude_fault(several: Sequence[SetupEvidence]) -> str:
    gain, latitude_deg = sum(each.opposite_gain for each in several), math.degrees(several[0].latitude)
    if gain < _MIN_CHI2_GAIN:
        return ""
    return (
        f"location.latitude_deg has the wrong sign: at {-latitude_deg:g} deg, not {latitude_deg:g} deg, "
        f"the error model leaves {gain:.3g} less of the chi2 of the navigation. Correct the station file"
    )


def _opposite_gain(dwell: Dwell, site: Site, noise: NoiseModel, prior: PriorKnowledge) -> float:
    """By how much chi2 is less at the opposite latitude; 0 where neither latitude explains the data.

    A bias step fits neither latitude, but may reduce chi2 at the opposite one.
    """
    try:
        windows = tuple(
            each.thinned(max(EPOCH_S, each.duration_s / _LATITUDE_EPOCHS)) for each in dwell.windows
        )
    except MeasurementError:
        return 0.0
    thinned, opposite = replace(dwell, windows=windows), replace(site, latitude=-site.latitude)
    declared, other = (chi2_at(thinned, place, noise, prior) for place in (site, opposite))
    count, gain = 3 * sum(len(each.time_s) for each in windows), declared - other
    if min(declared, other) > _MAX_CHI2_PER_DATUM * count:
        return 0.0
    return 0.0 if gain > 0.0 and _has_step(dwell, opposite, noise, prior) else gain


def _has_step(dwell: Dwell, site: Site, noise: NoiseModel, prior: PriorKnowledge) -> bool:
    """Whether a bias steps if the dwell was measured at this site; unknown without a turn."""
    try:
        return estimate_state_space(dwell, site, noise, prior).probable_step is not None
    except MeasurementError:
        return False


def _dwell_moments(
    dwell: Dwell, gravity: float, noise: NoiseModel, prior: PriorKnowledge, step_rad: float
) -> tuple[FloatArray, FloatArray, int, float]:
    """Moments (n + 1, n + 1) of the n parameters of a dwell and the velocity, white.

    And what noise of the attitude adds to those of the matrix (4,), the number of white data, and chi2 if
    each window had its own parameters.
    """
    size = _OF_DWELL + 2 * len(dwell.windows)
    moments, attitude_noise, count, apart = np.zeros((size + 1, size + 1)), np.zeros(4), 0, 0.0
    for number, window in enumerate(dwell.windows):
        of_window, added, data = _moments(window.thinned(EPOCH_S), gravity, noise, prior, step_rad)
        place = np.zeros((_OF_WINDOW + 1, size + 1))
        place[: _DRIFT.start, : _DRIFT.start] = np.eye(_DRIFT.start)
        place[_DRIFT, _DRIFT.start : _OF_DWELL] = window.C_nb[0, :2]
        place[_DRIFT, _OF_DWELL + 2 * number :][:, :2] = np.eye(2)
        place[-1, -1] = 1.0
        moments += place.T @ of_window @ place
        attitude_noise, count = attitude_noise + added, count + data
        apart += _solved(of_window, added)[2]
    return moments, attitude_noise, count, apart


def _solved(moments: FloatArray, attitude_noise: FloatArray) -> tuple[FloatArray, FloatArray, float]:
    """Parameters (n,) of a window or dwell, their information (n, n), and chi2."""
    rows, left = moments[:-1, :-1] + np.diag(_prior(len(moments) - 1)), moments[:-1, -1]
    exact = rows - np.diag(np.pad(attitude_noise, (0, len(left) - 4)))
    values = np.asarray(np.linalg.solve(exact, left))
    return values, exact, float(moments[-1, -1] - 2.0 * left @ values + values @ rows @ values)


def _where_right(moments: FloatArray, latitude: float) -> tuple[FloatArray, FloatArray]:
    """Parameters (n - 4,) beside the matrix where that is the identity at this latitude; their covariance."""
    prior, right = _prior(len(moments) - 1)[4:], np.append(np.eye(2), math.sin(latitude))
    prior[0] = _LATITUDE_RATE**-2.0
    covariance = np.asarray(np.linalg.inv(moments[4:-1, 4:-1] + np.diag(prior)))
    found = covariance @ (moments[4:-1, -1] - moments[4:-1, :5] @ right)
    found[0] += right[-1]
    return found, covariance


def _prior(count: int) -> FloatArray:
    """Information (n,) on the parameters of a window or dwell that is known beforehand."""
    prior = np.full(count, _WIDE_DRIFT**-2.0)
    prior[_MATRIX], prior[4:6], prior[_OF_DWELL:] = 0.0, (_PRIOR_RATE**-2.0, _PRIOR_DAMPING**-2.0), 1.0
    return prior


def _moments(
    window: NavigationWindow, gravity: float, noise: NoiseModel, prior: PriorKnowledge, step_rad: float
) -> tuple[FloatArray, FloatArray, int]:
    """Moments (9, 9) of the parameters of a window and the velocity, white.

    And what noise of the attitude adds to those of the matrix (4,), and the number of white data.
    """
    count = len(window.time_s) // max(1, len(window.time_s) // _MEANS)
    every = len(window.time_s) // count
    time_s = window.time_s - window.time_s[0]
    rotation = rotation_vector_enu(window.C_nb, window.C_nb[0])
    velocity = window.velocity_enu_mps[:, :2]
    tilt = gravity * np.stack([rotation[:, 1], -rotation[:, 0]], axis=-1)
    turned = 2.0 * EARTH_RATE * np.stack([velocity[:, 1], -velocity[:, 0]], axis=-1)

    def means(values: FloatArray) -> FloatArray:
        return np.asarray(values[: count * every].reshape(count, every, -1).mean(axis=1))

    def integral(values: FloatArray) -> FloatArray:
        steps = 0.5 * np.diff(time_s)[:, np.newaxis] * (values[1:] + values[:-1])
        return means(np.vstack([np.zeros(2), np.cumsum(steps, axis=0)]))

    begin_s, middle_s = time_s[: count * every : every], means(time_s)[:, 0]
    length_s = time_s[-1] / len(time_s) * every
    walk = np.minimum.outer(begin_s, begin_s) + 0.5 * length_s
    np.fill_diagonal(walk, begin_s + length_s / 3.0)
    walk_root = np.linalg.cholesky(walk)
    warmed_k = np.zeros(len(time_s))
    if window.accelerometer_c is not None:
        warmed_k = window.accelerometer_c - window.accelerometer_c[0]
    known = (
        prior.accelerometer_transient * TRANSIENT_S * np.exp(-middle_s / TRANSIENT_S),
        prior.accelerometer_slope * integral(np.column_stack([warmed_k, warmed_k]))[:, 0],
    )
    white = max(noise.velocity_white, _MIN_WHITE_MPS) ** 2 / every * np.eye(count)
    others = sum(np.outer(each, each) for each in known) + white
    of_tilt = np.array([gravity**2 * EPOCH_S * _angle_noise(rotation[:, of], step_rad) for of in (1, 0)])
    signals = integral(turned), -integral(velocity)
    moments, added = np.zeros((_OF_WINDOW + 1,) * 2), np.zeros(4)
    line = np.stack([np.ones(count), middle_s / middle_s[-1]], axis=-1)
    for axis in range(2):
        root = np.linalg.cholesky((noise.velocity_random_walk**2 + of_tilt[axis]) * walk + others)
        rows = np.zeros((count, _OF_WINDOW + 1))
        rows[:, 2 * axis : 2 * axis + 2] = integral(tilt)
        rows[:, 4:6] = np.stack([each[:, axis] for each in signals], axis=-1)
        rows[:, _DRIFT.start + axis] = 0.5 * prior.accelerometer_drift * middle_s**2
        rows[:, -1] = means(velocity)[:, axis]
        whitened = np.linalg.solve(root, np.hstack([line, rows, walk_root]))
        base = np.linalg.qr(whitened[:, :2])[0]
        whitened -= base @ (base.T @ whitened)
        rows, walked = whitened[:, 2 : _OF_WINDOW + 3], whitened[:, _OF_WINDOW + 3 :]
        moments += rows.T @ rows
        added[2 * axis : 2 * axis + 2] = of_tilt * float((walked**2).sum())
    return moments, added, 2 * (count - 2)


def _angle_noise(angle: FloatArray, step_rad: float) -> float:
    """Variance of the white noise of an angle (n,), rad^2."""
    changes = 1 + np.count_nonzero(np.diff(angle))
    return max(
        float(np.mean(np.diff(angle, 2) ** 2)) / 6.0, rounding_sigma(step_rad, len(angle) / changes) ** 2
    )
