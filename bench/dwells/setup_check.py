"""Scale of the velocities and sign of the station's latitude, tested on what the INS itself navigates.

Signs and axes are tested before, see :mod:`gyrobench.bench.dwells.sign_check`. More mistakes of a station
file let a dwell look good:

* Velocities with a wrong scale make the biases of the level gyros wrong by the same factor. The tilt since
  the begin of a window lets gravity in, ``dV_E/dt = g r_N + 2 W_U V_N + constant`` and ``dV_N/dt = -g r_E -
  2 W_U V_E + constant``, so that a regression of the velocity on the integral of the tilt gives its scale.
  Earth rate and damping by the INS are free in it; drift, transient and temperature slope of the
  accelerometers have their prior uncertainty; noise of the attitude, which makes a regression's slope
  smaller, is subtracted from its moment.
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

from gyrobench.bench.bias.bias_filter import chi2_at, estimate_state_space
from gyrobench.bench.bias.dwell import Dwell, NavigationWindow
from gyrobench.bench.bias.noise_model import NoiseModel, rounding_sigma
from gyrobench.bench.bias.parameters import PriorKnowledge
from gyrobench.bench.bias.window_filter import EPOCH_S, TRANSIENT_S
from gyrobench.bench.foundations.arrays import FloatArray
from gyrobench.bench.foundations.errors import MeasurementError, SignalMapError
from gyrobench.bench.navigation.attitude import rotation_vector_enu
from gyrobench.bench.navigation.earth import EARTH_RATE
from gyrobench.bench.navigation.error_model import Site

#: A scale is wrong if it is off by more than this many standard uncertainties, as one in a hundred thousand
#: good units is, and by more than this share.
_MIN_SIGMAS, _MIN_SCALE_ERROR = 4.4, 0.03
#: Largest share of the tilt's moment that noise of the attitude may have.
_MAX_NOISE_SHARE = 0.1
#: Means of the epochs of a window that the regression uses, and epochs for the two latitudes.
_MEANS, _LATITUDE_EPOCHS = 60, 60
#: Output without any noise, m/s.
_MIN_WHITE_MPS = 1e-6
#: The opposite latitude is right if chi2 is less by this much there, and explained by the noise.
_MIN_CHI2_GAIN, _MAX_CHI2_PER_DATUM = 30.0, 1.5
#: Latitudes of INS and station differ by more than an INS drifts while it navigates on the bench, rad.
_MAX_LATITUDE_APART = math.radians(0.05)
_VELOCITIES = ("ins.signals.velocity_east", "ins.signals.velocity_north")
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
    """What one dwell shows of the set-up; a scale without information is left out."""

    #: scale, covariance: Shapes (2,), (2, 2). Velocity East and North over what the tilt leads to.
    scale: FloatArray
    covariance: FloatArray
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
    regressions = zip(
        *(
            _regression(window.thinned(EPOCH_S), site.gravity, noise, wide, heading_step_rad)
            for window in dwell.windows
        ),
        strict=True,
    )
    moments, attitude_noise, counts = (np.sum(each, axis=0) for each in regressions)
    size = len(moments) - 1
    rows, left = moments[:size, :size], moments[:size, size]
    if (attitude_noise > _MAX_NOISE_SHARE * np.diag(rows)[:2]).any() or not np.isfinite(moments).all():
        return None
    rows = rows - np.diag([*attitude_noise, *np.zeros(size - 2)])
    values = np.linalg.solve(rows, left)
    chi2 = moments[size, size] - 2.0 * left @ values + values @ moments[:size, :size] @ values
    covariance = max(1.0, chi2 / (counts - size)) * np.linalg.inv(rows)[:2, :2]
    if not (np.linalg.eigvalsh(covariance) > 0.0).all():
        return None
    return SetupEvidence(values[:2], covariance, site.latitude, _opposite_gain(dwell, site, noise, prior))


def setup_fault(several: Sequence[SetupEvidence]) -> str:
    """What is wrong with the set-up by the dwells together, and what to do; empty where nothing is."""
    if not several:
        return ""
    return _scale_fault(several) or _latitude_fault(several)


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


def measured_scale(several: Sequence[SetupEvidence]) -> tuple[float, float]:
    """Scale of the velocities by the dwells together, and its standard uncertainty."""
    return _common(*_pooled(several), np.ones(2))


def _pooled(several: Sequence[SetupEvidence]) -> tuple[FloatArray, FloatArray]:
    scales = np.array([each.scale for each in several])
    inverses = np.linalg.inv(np.array([each.covariance for each in several]))
    covariance = np.linalg.inv(inverses.sum(axis=0))
    scale = covariance @ np.einsum("nij,nj->i", inverses, scales)
    chi2 = float(np.einsum("ni,nij,nj->", scales - scale, inverses, scales - scale))
    return scale, covariance * max(1.0, chi2 / max(2 * (len(several) - 1), 1))


def _common(scale: FloatArray, covariance: FloatArray, chosen: FloatArray) -> tuple[float, float]:
    """Common scale of the velocities chosen by ones (2,), if others have none, and its uncertainty."""
    inverse = np.linalg.inv(covariance)
    weight = float(chosen @ inverse @ chosen)
    return 1.0 + float(chosen @ inverse @ (scale - 1.0)) / weight, weight**-0.5


def _scale_fault(several: Sequence[SetupEvidence]) -> str:
    pooled = _pooled(several)
    found = [(*_common(*pooled, chosen), chosen) for chosen in (np.ones(2), *np.eye(2))]
    value, sigma, chosen = max(found, key=lambda each: abs(each[0] - 1.0) / each[1])
    if abs(value - 1.0) <= max(_MIN_SIGMAS * sigma, _MIN_SCALE_ERROR):
        return ""
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


def _regression(
    window: NavigationWindow, gravity: float, noise: NoiseModel, prior: PriorKnowledge, step_rad: float
) -> tuple[FloatArray, FloatArray, int]:
    """Moments (5, 5) of scale East, scale North, Earth rate, damping and velocity, white; see the module.

    And what noise of the attitude adds to those of the two scales, and the number of white data.
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
    warmed_k = np.zeros(len(time_s))
    if window.accelerometer_c is not None:
        warmed_k = window.accelerometer_c - window.accelerometer_c[0]
    known = (
        0.5 * prior.accelerometer_drift * middle_s**2,
        prior.accelerometer_transient * TRANSIENT_S * np.exp(-middle_s / TRANSIENT_S),
        prior.accelerometer_slope * integral(np.column_stack([warmed_k, warmed_k]))[:, 0],
    )
    white = max(noise.velocity_white, _MIN_WHITE_MPS) ** 2 / every * np.eye(count)
    others = sum(np.outer(each, each) for each in known) + white
    signals = integral(tilt), integral(turned), -integral(velocity), means(velocity)
    moments, added = np.zeros((5, 5)), np.zeros(2)
    line = np.stack([np.ones(count), middle_s / middle_s[-1]], axis=-1)
    for axis in range(2):
        angle = rotation[:, 1 - axis]
        changes = 1 + np.count_nonzero(np.diff(angle))
        of_angle = max(
            float(np.mean(np.diff(angle, 2) ** 2)) / 6.0, rounding_sigma(step_rad, len(angle) / changes) ** 2
        )
        of_tilt = gravity**2 * of_angle * EPOCH_S
        root = np.linalg.cholesky((noise.velocity_random_walk**2 + of_tilt) * walk + others)
        base = np.linalg.qr(np.linalg.solve(root, line))[0]
        rows = np.zeros((count, 5))
        rows[:, axis] = signals[0][:, axis]
        rows[:, 2:] = np.stack([each[:, axis] for each in signals[1:]], axis=-1)
        rows, walked = (
            each - base @ (base.T @ each)
            for each in (np.linalg.solve(root, rows), np.linalg.solve(root, np.linalg.cholesky(walk)))
        )
        moments += rows.T @ rows
        added[axis] = of_tilt * float((walked**2).sum())
    return moments, added, 2 * (count - 2)
