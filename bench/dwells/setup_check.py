"""Tests scale and axes of the velocities and the sign of the latitude with the navigation of the INS itself.

Signs and axes are tested before, see :mod:`gyrobench.bench.dwells.sign_check`. With other mistakes in a
station file a dwell still looks good:

* If the velocities have a wrong scale, the biases of the level gyros are wrong by the same factor. If their
  axes are rotated about Up, as wander azimuth or grid axes, parts of the level biases are exchanged. The
  regression on the tilt detects both, and a drift of the accelerometers
  (:mod:`gyrobench.bench.dwells.velocity_regression`). With several positions, so do drifts that seem to
  follow the biases of the level gyros.
* The heading turns by ``V_E tan(latitude)/R``. The effect of a wrong latitude on it looks like a bias with a
  slope, so the latitude of an INS that sends it is compared with that of the station.
* A latitude of the wrong hemisphere reverses the Coriolis acceleration and the rate of the heading. The full
  error model is fitted with both latitudes. The evidence is as large as the effect on the biases: small in a
  unit with accelerometer biases of some micro-g. Other latitudes are tried in the same way: one tens of
  degrees off, as a longitude entered in its place, shows in several dwells.

* At the singularity of its Euler sequence a heading and an angle are free: where the INS sends another
  sequence than declared, that angle stays near zero, and a tilt is taken for a change of heading.

If one dwell does not decide, all dwells of a run together do.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from gyrobench.bench.bias.bias_filter import dwell_chi2, estimate_state_space
from gyrobench.bench.bias.damping import Damping
from gyrobench.bench.bias.dwell import Dwell, NavigationWindow
from gyrobench.bench.bias.parameters import ErrorModel
from gyrobench.bench.bias.statistics import chi2_p_value
from gyrobench.bench.bias.window_filter import EPOCH_S
from gyrobench.bench.dwells.velocity_regression import VelocityRegression, velocity_regression
from gyrobench.bench.foundations.arrays import UG_TO_MPS2, FloatArray
from gyrobench.bench.foundations.errors import MeasurementError, SignalMapError
from gyrobench.bench.navigation.error_model import Site
from gyrobench.bench.navigation.positions import AXES
from gyrobench.drivers.ins.signal_map import SignalMap

#: A scale, or an angle in rad, is wrong if it is off by more than this number of standard uncertainties,
#: which noise exceeds with a probability of 3e-5, and by more than this value.
_MIN_SIGMAS, _MIN_ERROR = 4.2, 0.01
#: Accelerometers drift more than expected if the p-value is smaller.
_MIN_DRIFT_P_VALUE = 1e-5
#: Other deviations of the matrix from the identity reduce the evidence for a fault by at most this factor.
_MAX_GAIN_REDUCTION = 4.0
#: Fewest degrees of freedom of the drifts of all dwells, and p-value below which their scatter counts, not
#: the declared size; regularisation of their common part.
_MIN_DRIFT_DOF, _MIN_SCATTER_P_VALUE, _TINY_INFORMATION = 5, 0.1, 1e-9
#: Angles per step of the search, and its final width, rad.
_ANGLES, _ANGLE_STEP = 73, 1e-5
#: Epochs of a window in the comparison of the two latitudes.
_LATITUDE_EPOCHS = 60
#: The opposite latitude is correct if it reduces chi2 by at least this much, and the noise explains the rest.
_MIN_CHI2_GAIN, _MAX_CHI2_PER_DATUM = 30.0, 1.5
#: A bias that steps is tried instead of another latitude from this gain on; smaller ones are noise.
_MIN_STEP_GAIN = 1.0
#: With a smaller p-value, a latitude does not explain a dwell, or the INS damps its velocity.
_MAX_P_VALUE = 1e-3
#: Other latitudes that are tried, rad. One is nearer if it reduces chi2 by this much in as many dwells as
#: this, and by more in fewer.
_LATITUDES = np.radians([-60.0, -40.0, -20.0, 0.0, 20.0, 40.0, 60.0])
_MIN_NEARER_GAIN, _MIN_NEARER_DWELLS = 60.0, 6
_NO_GAINS = np.zeros(len(_LATITUDES))
#: Largest difference of the latitudes of INS and station, rad: more than an INS drifts on the bench.
_MAX_LATITUDE_DIFFERENCE = math.radians(0.05)
#: Largest angle from the singularity of an Euler sequence, and smallest plausible free angle there, rad.
_MAX_FROM_SINGULAR, _MIN_FREE_ANGLE = math.radians(0.5), math.radians(0.1)
_VELOCITIES = ("ins.signals.velocity_east", "ins.signals.velocity_north")
#: Velocities East and North that a scale multiplies.
_SCALED = np.array([[1.0, 1.0], [1.0, 0.0], [0.0, 1.0]])
#: Mistakes that multiply a velocity by each factor.
_UNITS = {
    0.5: "half the scale", 2.0: "twice the scale", 10.0: "ten times the scale", 0.1: "a tenth of the scale",
    1.0 / 0.514444: "knots taken for m/s", 0.514444: "m/s taken for knots",
    3.6: "km/h taken for m/s", 1.0 / 3.6: "m/s taken for km/h",
    1.0 / 0.3048: "ft/s taken for m/s", 0.3048: "m/s taken for ft/s",
    100.0: "cm/s taken for m/s", 0.01: "m/s taken for cm/s",
    1000.0: "mm/s taken for m/s", 0.001: "m/s taken for mm/s",
}  # fmt: skip
_MAX_UNIT_SIGMAS, _MAX_UNIT_SHARE = 2.0, 0.02


@dataclass(frozen=True, eq=False, slots=True)
class SetupEvidence:
    """Evidence of one dwell on the scale of the velocities and the latitude."""

    velocities: VelocityRegression
    latitude: float  #: Declared, rad.
    opposite_gain: float  #: Reduction of chi2 at the opposite latitude.
    latitude_gains: FloatArray  #: Shape (7,). The same at other latitudes.


def setup_evidence(
    dwell: Dwell, model: ErrorModel, heading_step_rad: float, is_latitude_sent: bool
) -> SetupEvidence | None:
    """Evidence of a dwell without jumps of the output; None if it has none.

    ``heading_step_rad``: resolution of the attitude. ``is_latitude_sent``: whether the INS sends its
    latitude, which is compared with the station's; then only the opposite one is tried.
    """
    velocities = velocity_regression(dwell, model, heading_step_rad)
    if velocities is None:
        return None
    gains = _latitude_gains(dwell, model, velocities.damping, is_latitude_sent)
    return SetupEvidence(velocities, model.site.latitude, *gains)


def setup_fault(dwells: Sequence[SetupEvidence]) -> str:
    """Message about a fault of the set-up that the dwells together reveal; empty if there is none."""
    if not dwells:
        return ""
    return _velocity_fault(dwells) or _latitude_fault(dwells)


def latitude_fault(sent: float, site: Site) -> str:
    """Message if the latitude that the INS sends is not that of the station, both rad; else empty.

    For smaller errors see :mod:`gyrobench.bench.dwells.latitude`.
    """
    if not abs(sent - site.latitude) > _MAX_LATITUDE_DIFFERENCE:  # NaN where it sends none
        return ""
    return (
        f"the INS uses a latitude of {math.degrees(sent):.4f} deg, location.latitude_deg is "
        f"{math.degrees(site.latitude):.4f} deg. Correct the one that is wrong"
    )


def sequence_fault(windows: Sequence[NavigationWindow], signals: SignalMap | None) -> str:
    """Message if the attitude contradicts a declared Euler sequence that never changes; else empty.

    In this sequence the free angle follows the tilt of a table or unit, in any direction, and changes by half
    a turn where the unit is turned by that.
    """
    euler = signals.attitude.euler if signals else None
    if euler is None or euler.sequence.fixed is None:
        return ""
    is_rpy = euler.sequence.fixed == "rpy_321"
    east, north, up = np.vstack([window.C_nb[:, 2] for window in windows]).T  # of Up in body axes
    singular, free = (north, np.arctan2(-east, up)) if is_rpy else (east, np.arctan2(north, up))
    if np.abs(singular).min() < math.cos(_MAX_FROM_SINGULAR) or np.abs(np.sin(free)).max() > _MIN_FREE_ANGLE:
        return ""
    angle, other = ("roll", "pry_231") if is_rpy else ("pitch", "rpy_321")
    return (
        f"ins.signals.attitude.euler.sequence is {euler.sequence.fixed}, in which {angle} is undefined in "
        f"this position, but it stays within {math.degrees(_MIN_FREE_ANGLE):.1f} deg of zero: the INS seems "
        f"to send {other} here, or sets {angle} to zero. Correct the sequence, or map a quaternion"
    )


def raise_setup_fault(evidence: SetupEvidence | None) -> None:
    """Raise SignalMapError if one dwell by itself contradicts the set-up."""
    if evidence and (fault := setup_fault([evidence])):
        raise SignalMapError(fault)


def drift_fault(velocities: VelocityRegression) -> str:
    """Flag if the accelerometers drift more in a dwell than expected; else empty."""
    expected = np.linalg.norm(velocities.drift_sigma, axis=0)
    # That of a vertical axis is not observable, and adds nothing.
    if chi2_p_value(2, float(((velocities.drift / expected) ** 2).sum())) > _MIN_DRIFT_P_VALUE:
        return ""
    axis = int(np.argmax(np.abs(velocities.drift) / expected))
    drift, sigma = np.array([velocities.drift[axis], velocities.drift_sigma[0, axis]]) * 3600.0 / UG_TO_MPS2
    return (
        f"the {AXES[axis]} accelerometer drifts by {drift:.0f} ± {sigma:.0f} ug/h against the tilt of the "
        "INS, more than ins.uncertainty.accelerometer_drift_ug_per_h allows for: a level gyro seems to have "
        f"{math.degrees(1e-6 * abs(drift)):.3f} deg/h more. Measure where the temperature has settled, or "
        "declare that drift. If the bias follows the temperature, declare accelerometer_slope_ug_per_c"
    )


def measured_scales(dwells: Sequence[SetupEvidence]) -> list[tuple[float, float]]:
    """Scales of the velocities by the dwells together, with standard uncertainties.

    Of both together, of that East alone and of that North alone, each if nothing else is wrong.
    """
    pooled = _pooled(dwells)
    return [_scale(*pooled, is_scaled) for is_scaled in _SCALED]


def _pooled(dwells: Sequence[SetupEvidence]) -> tuple[FloatArray, FloatArray]:
    """Mean matrix (4,) of several dwells, and its information (4, 4)."""
    matrices = np.array([each.velocities.matrix for each in dwells])
    inverses = np.linalg.inv(np.array([each.velocities.covariance for each in dwells]))
    information = inverses.sum(axis=0)
    matrix = np.linalg.solve(information, np.einsum("nij,nj->i", inverses, matrices))
    chi2 = float(np.einsum("ni,nij,nj->", matrices - matrix, inverses, matrices - matrix))
    information = information / max(1.0, chi2 / max(4 * (len(dwells) - 1), 1))
    products, by_drift = _information_of_drift([each.velocities for each in dwells])
    total = information + by_drift
    return np.linalg.solve(total, information @ matrix + by_drift @ np.eye(2).ravel() + products), total


def _information_of_drift(dwells: Sequence[VelocityRegression]) -> tuple[FloatArray, FloatArray]:
    """Information (4, 4) on the matrix in what seems to be a drift of the accelerometers.

    Also returns its product (4,) with the deviation from the identity. A drift that all dwells have in common
    is free.
    """
    normal, right_side, chi2 = np.zeros((7, 7)), np.zeros(7), 0.0
    dof = 2 * len(dwells) - len(normal)  # two axes are level
    if dof < _MIN_DRIFT_DOF:
        return np.zeros(4), np.zeros((4, 4))
    for each in dwells:
        rows = np.hstack([each.drift_response, np.sqrt(np.diag(each.drift_covariance).min()) * np.eye(3)])
        weighted = np.linalg.solve(each.drift_covariance, np.column_stack([rows, each.drift]))
        normal, right_side = normal + rows.T @ weighted[:, :7], right_side + rows.T @ weighted[:, 7]
        chi2 += float(each.drift @ weighted[:, 7])
    common = normal[:, 4:] @ np.linalg.inv(normal[4:, 4:] + _TINY_INFORMATION * np.eye(3))
    reduced, products = (normal - common @ normal[4:])[:4, :4], (right_side - common @ right_side[4:])[:4]
    unexplained = chi2 - float(right_side @ np.linalg.lstsq(normal, right_side)[0])
    if chi2_p_value(dof, unexplained) < _MIN_SCATTER_P_VALUE:
        from scipy.special import ndtr, stdtrit  # 50 MB, which most runs do without

        # Drifts larger than declared: their size is known from few dwells.
        sigmas = _MIN_SIGMAS / float(stdtrit(dof, ndtr(_MIN_SIGMAS)))
        reduced, products = (each * sigmas**2 * dof / unexplained for each in (reduced, products))
    return products, reduced


def _scale(matrix: FloatArray, information: FloatArray, is_scaled: FloatArray) -> tuple[float, float]:
    """Common scale of the velocities marked by ones (2,), if nothing else is wrong, and its uncertainty."""
    direction = np.diag(is_scaled).ravel()
    weight = float(direction @ information @ direction)
    return 1.0 + float(direction @ information @ (matrix - np.eye(2).ravel())) / weight, weight**-0.5


def _rotation(angle: float | FloatArray) -> FloatArray:
    """Matrix by rows (..., 4) of velocities turned about Up."""
    c, s = np.cos(angle), np.sin(angle)
    return np.stack([c, -s, s, c], axis=-1)


def _angle(matrix: FloatArray, information: FloatArray) -> tuple[float, float, float]:
    """Rotation angle about Up if nothing else is wrong, its uncertainty, rad, and the reduction of chi2."""

    def chi2(angle: FloatArray) -> FloatArray:
        residuals = _rotation(angle) - matrix
        return np.asarray(np.einsum("ni,ij,nj->n", residuals, information, residuals))

    angle, width = 0.0, math.pi
    while width > _ANGLE_STEP:
        angles = angle + width * np.linspace(-1.0, 1.0, _ANGLES)
        angle, width = float(angles[np.argmin(chi2(angles))]), 4.0 * width / _ANGLES
    change = _rotation(angle + 0.5 * math.pi)
    unrotated, rotated = chi2(np.array([0.0, angle]))
    return angle, float(change @ information @ change) ** -0.5, float(unrotated - rotated)


def _velocity_fault(dwells: Sequence[SetupEvidence]) -> str:
    matrix, information = _pooled(dwells)
    scales = [(*_scale(matrix, information, is_scaled), is_scaled) for is_scaled in _SCALED]
    value, sigma, is_scaled = max(scales, key=lambda each: abs(each[0] - 1.0) / each[1])
    angle, angle_sigma, angle_gain = _angle(matrix, information)
    gain = ((value - 1.0) / sigma) ** 2
    is_rotation = angle_gain > gain
    if is_rotation:
        gain = angle_gain
    # Disturbed accelerometers make a matrix that is neither a scale nor a rotation.
    deviation = matrix - np.eye(2).ravel()
    unexplained = float(deviation @ information @ deviation) - gain
    gain /= min(max(1.0, unexplained / 3.0), _MAX_GAIN_REDUCTION)
    if gain <= _MIN_SIGMAS**2 or (abs(angle) if is_rotation else abs(value - 1.0)) <= _MIN_ERROR:
        return ""
    if is_rotation:
        return (
            f"{' and '.join(_VELOCITIES)} are turned by {math.degrees(angle):.3g} ± "
            f"{math.degrees(angle_sigma):.1g} deg about Up relative to those that follow from the tilt of "
            "the INS, as in wander azimuth or grid axes: parts of the biases of the level gyros are "
            "exchanged. Map signals of the velocities East and North, or set the INS to send those"
        )
    names = [name for name, is_wrong in zip(_VELOCITIES, is_scaled, strict=True) if is_wrong]
    has = "have" if len(names) > 1 else "has"
    found = f"{value:.3g} ± {float(f'{sigma:.1g}'):g}"  # no exponent from 10 on
    return (
        f"{' and '.join(names)} {has} a wrong scale: {found} times the velocity "
        f"that follows from the tilt of the INS{_unit_text(value, sigma)}. The biases of the level gyros are "
        "wrong by the same factor. Correct the scale or unit in the DBC or the station file"
    )


def _unit_text(value: float, sigma: float) -> str:
    """Mistakes of units that fit a scale, for a message."""
    limit = max(_MAX_UNIT_SIGMAS * sigma, _MAX_UNIT_SHARE * abs(value))
    near = sorted((abs(value - ratio), text) for ratio, text in _UNITS.items() if abs(value - ratio) < limit)
    return f", as {' or '.join(text for _, text in near)}" if near else ""


def _latitude_fault(dwells: Sequence[SetupEvidence]) -> str:
    gain, latitude_deg = sum(each.opposite_gain for each in dwells), math.degrees(dwells[0].latitude)
    gains = np.sum([each.latitude_gains for each in dwells], axis=0)
    nearest = int(np.argmax(gains))
    required = _MIN_NEARER_GAIN * max(1.0, _MIN_NEARER_DWELLS / len(dwells))
    if gains[nearest] > max(required, gain + _MIN_CHI2_GAIN):
        nearest_deg = math.degrees(_LATITUDES[nearest])
        return (
            f"location.latitude_deg is not the latitude of the INS: at {nearest_deg:.0f} deg, not "
            f"{latitude_deg:g} deg, the chi2 of the navigation is lower by {gains[nearest]:.3g}. Correct the "
            "station file"
        )
    if gain < _MIN_CHI2_GAIN:
        return ""
    return (
        f"location.latitude_deg has the wrong sign: at {-latitude_deg:g} deg, not {latitude_deg:g} deg, "
        f"the chi2 of the navigation is lower by {gain:.3g}. Correct the station file"
    )


def _latitude_gains(
    dwell: Dwell, model: ErrorModel, damping: Damping, is_latitude_sent: bool
) -> tuple[float, FloatArray]:
    """Reduction of chi2 at the opposite latitude, and at others (7,); 0 if neither explains the data.

    A bias that steps, or differs between the windows, fits no latitude, but chi2 may be lower at another one.
    """
    try:
        windows = tuple(
            each.thinned(max(EPOCH_S, each.duration_s / _LATITUDE_EPOCHS)) for each in dwell.windows
        )
    except MeasurementError:
        return 0.0, _NO_GAINS
    thinned = replace(dwell, windows=windows)
    latitudes = [-model.site.latitude, *([] if is_latitude_sent else _LATITUDES.tolist())]
    models = [model.at_latitude(each) for each in latitudes]
    chi2, others = dwell_chi2(thinned, model), np.array([dwell_chi2(thinned, each) for each in models])
    limit = _MAX_CHI2_PER_DATUM * 3 * sum(len(each.time_s) for each in windows)
    gains = np.where(np.minimum(chi2, others) > limit, 0.0, chi2 - others)
    # The opposite latitude may be the exact one; the nearest of the others is not.
    if _is_step(dwell, (model, models[0]), damping, float(gains[0])):
        gains[0] = 0.0
    best = int(np.argmax(gains))
    if best and _is_step(dwell, (model, models[best]), damping, float(gains[best]), _MAX_P_VALUE):
        gains = np.zeros_like(gains)
    return float(gains[0]), _NO_GAINS if is_latitude_sent else gains[1:]


def _is_step(
    dwell: Dwell,
    models: tuple[ErrorModel, ErrorModel],
    damping: Damping,
    gain: float,
    max_p_value: float = 1.0,
) -> bool:
    """Whether a bias that steps explains the dwell better than the second model, with this gain.

    ``max_p_value``: that the second model may leave for the fit or the windows. False without a turn,
    and for the gain of noise.
    """
    if gain < _MIN_STEP_GAIN:
        return False
    try:
        here, other = (replace(estimate_state_space(dwell, each), damping=damping) for each in models)
    except MeasurementError:
        return False
    if other.probable_step is not None or other.damping.p_value < _MAX_P_VALUE:
        return other.probable_step is not None
    is_left = np.fmin(other.fit.p_value, other.steady_p_value) <= max_p_value
    p_value = np.fmin(here.steady_p_value, here.step.p_value if here.step else math.nan)
    return bool(is_left and p_value < math.exp(-0.5 * gain))
