"""Coefficients of a calibration for a terminal of 80 columns, readable without colour."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence

import numpy as np
from rich.console import Group, RenderableType
from rich.text import Text

from gyrobench.bench.calibration.coefficients import COEFFICIENTS, COUNT, NOT_OBSERVABLE
from gyrobench.bench.calibration.estimator import Calibration, bias_per_asymmetry
from gyrobench.bench.calibration.increment_recording import SensorNoise
from gyrobench.bench.calibration.problem import UNEXPLAINED_P_VALUE
from gyrobench.bench.calibration.results import (
    CoefficientRow,
    RestRate,
    coefficient_rows,
    common_scale_notes,
    expected_rows,
    rest_rates,
    strongest_correlations,
)
from gyrobench.bench.calibration.rotation_list import ExpectedUncertainties, RotationList
from gyrobench.bench.calibration.spins import SpinScaleFactor
from gyrobench.bench.foundations.arrays import (
    DEG_PER_SQRT_H_TO_SI,
    RAD_TO_ARCMIN,
    RADPS_TO_DPH,
    UG_PER_SQRT_HZ_TO_SI,
)
from gyrobench.bench.foundations.text import counted, decimals_of, listed, plain_name
from gyrobench.bench.navigation.earth import earth_rate_enu
from gyrobench.bench.navigation.positions import AXES
from gyrobench.bench.report.number_format import p_text
from gyrobench.bench.report.terminal.tables import plain_table, topics

_MIN_CORRELATION, _MAX_CORRELATIONS = 0.9, 5
_MAX_LISTED_RESTS = 6
_MAX_LISTED_ROTATIONS = 3
_NOT_TURNED = "the unit was not turned. Turn it about two axes between rests"
_OTHER_ROTATIONS = "no rotation distinguishes them. gyrobench plan --observability shows which would"
#: The effect of 1 ppm of asymmetry on a bias is stated if it exceeds this number of standard uncertainties.
_MIN_ASYMMETRY_SIGMAS = 0.3


def calibration_summary(
    calibration: Calibration,
    spins: Sequence[SpinScaleFactor],
    has_whole_turns: bool,
    excluded_samples: tuple[int, int],
) -> RenderableType:
    """Table of coefficients, with data, assumptions and goodness of fit of the calibration.

    ``has_whole_turns``: whether the map states how the table returns after whole turns.
    ``excluded_samples``: number of samples that are not used, and of all samples.
    """
    headers = ("Coefficient", "Axis", "Unit", "Value", "Standard uncertainty")
    spin_topics = [_spin_topic(each) for each in spins]
    if has_whole_turns and not spins:
        spin_topics = [("Spins", "none found: 'whole_turns_arcsec' of the import map is not used")]
    table = plain_table(headers, 3, map(_coefficient_cells, coefficient_rows(calibration)), fold=False)
    return Group(
        Text(f"Coefficients in the body frame of the {calibration.frame}", style="bold"),
        table,
        Text(),
        topics([*_topics(calibration, excluded_samples), *spin_topics]),
    )


def expected_summary(
    rotations: RotationList,
    expected: ExpectedUncertainties,
    noise: SensorNoise,
    site_sigmas: tuple[float, float],
) -> RenderableType:
    """Table of the expected uncertainty of each coefficient for a list of rotations.

    ``site_sigmas``: included uncertainties of gravity, m/s^2, and latitude, rad.
    """
    rows = [
        (
            plain_name(row["coefficient"]),
            row["axis"],
            row["unit"],
            NOT_OBSERVABLE if row["sigma"] is None else f"{row['sigma']:.{decimals_of(row['sigma'])}f}",
        )
        for row in expected_rows(expected)
    ]
    title = (
        f"{rotations.rotation_list}: {counted(len(rotations.rotations), 'rotation')} in "
        f"{expected.duration_s / 60.0:.0f} min, expected uncertainties"
    )
    angle_walk = noise.angle_random_walk[0] / DEG_PER_SQRT_H_TO_SI
    velocity_walk = noise.velocity_random_walk[0] / UG_PER_SQRT_HZ_TO_SI
    assumptions = (
        f"Noise: angle random walk {angle_walk:.2g} deg/sqrt(h), velocity random walk {velocity_walk:.2g} "
        f"µg/sqrt(Hz), velocity at rest {1e3 * noise.white_velocity[0]:.2g} mm/s at 1 Hz. "
        f"Included: gravity {site_sigmas[0]:.1g} m/s^2, latitude {site_sigmas[1] * RAD_TO_ARCMIN:.2g} arcmin."
    )
    headers = ("Coefficient", "Axis", "Unit", "Standard uncertainty")
    return Group(
        Text(title, style="bold"), plain_table(headers, 3, rows, fold=False), Text(), Text(assumptions)
    )


def _coefficient_cells(row: CoefficientRow) -> tuple[str, ...]:
    labels = plain_name(row.coefficient), row.axis, row.unit
    if row.value is None or row.sigma is None:
        return *labels, NOT_OBSERVABLE, ""
    decimals = decimals_of(row.sigma)
    return *labels, f"{row.value:z.{decimals}f}", f"{row.sigma:.{decimals}f}"


def _topics(calibration: Calibration, excluded_samples: tuple[int, int]) -> Iterator[tuple[str, str]]:
    rests = rest_rates(calibration)
    kinds = Counter(turn.kind for turns in calibration.rotations for turn in turns)
    for each in calibration.findings:
        yield "Check", f"{each}."
    yield from _data_topics(calibration, rests, kinds, excluded_samples)
    yield from _input_topics(calibration)
    up_dph = earth_rate_enu(calibration.problem.site.latitude)[2] * RADPS_TO_DPH
    for rest in rests if len(rests) <= _MAX_LISTED_RESTS else ():
        yield (
            "At rest",
            f"from {rest.start_s:.0f} s for {rest.duration_s:.0f} s: rate {rest.rate_dph:.3f} deg/h, "
            f"vertical {rest.up_rate_dph:.3f} ± {rest.up_sigma_dph:.3f} deg/h (Earth {up_dph:.3f}), "
            "biases included",
        )
    yield "Fit", _fit_sentence(calibration)
    correlations = strongest_correlations(calibration, _MIN_CORRELATION)[:_MAX_CORRELATIONS]
    if correlations:
        texts = [
            f"{plain_name(a.name)} {a.axis} and {plain_name(b.name)} {b.axis} {value:+.2f}"
            for a, b, value in correlations
        ]
        yield "Correlated", "; ".join(texts)
    yield from (("Check", note) for note in common_scale_notes(calibration))
    if text := _asymmetry_text(calibration):
        yield "Asymmetry", text
    if text := _vibration_text(calibration):
        yield "Vibration", text
    axes_by_name: dict[str, list[str]] = {}
    for row in coefficient_rows(calibration):
        if row.finding:
            axes_by_name.setdefault(plain_name(row.coefficient), []).append(row.axis)
    if axes_by_name:
        unobservable = "; ".join(f"{name} {', '.join(axes)}" for name, axes in axes_by_name.items())
        is_turned = kinds["rotation"] or kinds["spin"]
        yield "Not observable", f"{unobservable}: {_OTHER_ROTATIONS if is_turned else _NOT_TURNED}"


def _data_topics(
    calibration: Calibration,
    rests: Sequence[RestRate],
    kinds: Counter[str],
    excluded_samples: tuple[int, int],
) -> Iterator[tuple[str, str]]:
    """Rests and rotations found in the log, excluded samples, and noise."""
    at_rest_s = sum(rest.duration_s for rest in rests)
    counts = [counted(len(rests), "rest"), *(counted(count, kind) for kind, count in kinds.items())]
    yield "Found", f"{listed(counts)}; {at_rest_s:.0f} s at rest"
    yield "Axes", _axes_text(calibration)
    if excluded_samples[0]:
        share = 100.0 * excluded_samples[0] / excluded_samples[1]
        yield (
            "Left out",
            f"{excluded_samples[0]} of {excluded_samples[1]} samples ({share:.2g} %): missing, not a number, "
            "repeated, or in a part with less than a minute at rest",
        )
    noise = calibration.problem.noise
    yield (
        "Noise",
        f"x, y, z: angle random walk {_xyz_text(noise.angle_random_walk / DEG_PER_SQRT_H_TO_SI)} "
        f"deg/sqrt(h), white angle {_xyz_text(1e6 * noise.white_angle)} urad, velocity random walk "
        f"{_xyz_text(noise.velocity_random_walk / UG_PER_SQRT_HZ_TO_SI)} ug/sqrt(Hz)",
    )


def _axes_text(calibration: Calibration) -> str:
    """The axis up at the start and the first rotations, by which a reader notices exchanged axes."""
    up = calibration.starts[0][2]
    axis = int(np.abs(up).argmax())
    turns = [turn for turn in calibration.rotations[0] if turn.kind != "disturbance"][:_MAX_LISTED_ROTATIONS]
    parts = [f"{AXES[axis]} {'up' if up[axis] > 0.0 else 'down'} at the start"]
    if turns:
        texts = [f"{AXES[turn.axis]} by {np.rad2deg(turn.path):+.0f} deg" for turn in turns]
        parts.append(f"first turned about {listed(texts)}")
    return (
        f"{', then '.join(parts)}. Compare that with what was done: the data do not show whether axes of "
        "both triads are exchanged alike"
    )


def _input_topics(calibration: Calibration) -> Iterator[tuple[str, str]]:
    """Contributions of the errors of gravity, time and latitude to the uncertainties."""
    gravity, sigma = calibration.problem.gravity, calibration.problem.options.gravity_sigma
    yield (
        "Gravity",
        f"{gravity:.5f} ± {sigma:.1g} m/s^2: {1e6 * sigma / gravity:.2g} ppm of the accelerometer scale "
        "factors, included",
    )
    if "time" in calibration.site_covariances:
        sigmas = 1e6 * np.sqrt(np.diag(calibration.site_covariances["time"])[:COUNT])
        by_sensor = {
            each.sensor: sigma
            for each, sigma in zip(COEFFICIENTS, sigmas, strict=True)
            if each.kind == "scale_factor" and sigma > 0.0
        }
        parts = [f"{sigma:.2g} ppm of the {sensor} scale factors" for sensor, sigma in by_sensor.items()]
        yield "Time", f"clock and time stamps: {listed(parts)}, included"
    if "latitude" in calibration.site_covariances and calibration.is_observed[:3].any():
        variances = np.diag(calibration.site_covariances["latitude"])[:3][calibration.is_observed[:3]]
        yield (
            "Latitude",
            f"± {calibration.problem.options.latitude_sigma * RAD_TO_ARCMIN:.2g} arcmin: up to "
            f"{np.sqrt(variances.max()) * RADPS_TO_DPH:.2g} deg/h of the gyro biases, included",
        )


def _asymmetry_text(calibration: Calibration) -> str:
    """Effect of an asymmetry of the gyro scale factors that is not estimated; empty if small."""
    is_observed = calibration.is_observed[:3]
    bias_changes = 1e-6 * np.abs(bias_per_asymmetry(calibration))[is_observed]
    if not bias_changes.size:
        return ""
    largest_changes = bias_changes.max(axis=1)
    sigmas = float((largest_changes / calibration.sigmas[:3][is_observed]).max())
    if sigmas < _MIN_ASYMMETRY_SIGMAS:
        return ""
    return (
        f"not estimated for all gyros: 1 ppm would move a gyro bias by up to "
        f"{largest_changes.max() * RADPS_TO_DPH:.2g} deg/h, or {sigmas:.2g} standard uncertainties. "
        "--asymmetry estimates it"
    )


def _vibration_text(calibration: Calibration) -> str:
    """Possible effect of coning within the samples on the gyro biases; empty if below their uncertainty.

    Vibration of two axes with rms angles a and b, a quarter period apart, turns the third by w a b; half the
    sample rate is the highest frequency w that samples show.
    """
    white_angle = calibration.problem.noise.white_angle
    coning_rates = (
        np.pi / calibration.recordings[0].interval_s * np.roll(white_angle, -1) * np.roll(white_angle, -2)
    )
    sigmas = np.where(calibration.is_observed[:3], coning_rates / calibration.sigmas[:3], 0.0)
    axis = int(np.argmax(sigmas))
    if sigmas[axis] < 1.0:
        return ""
    return (
        f"if the white angle is vibration, coning between samples may pass for a bias of the {AXES[axis]} "
        f"gyro of up to {coning_rates[axis] * RADPS_TO_DPH:.2g} deg/h, or {sigmas[axis]:.2g} standard "
        "uncertainties; the log does not show it. Remove the source of vibration, or log increments at a "
        "higher rate"
    )


def _spin_topic(scale_factor: SpinScaleFactor) -> tuple[str, str]:
    rates = listed([f"{each.rate_dps:.3g}" for each in scale_factor.rates])
    text = (
        f"{counted(len(scale_factor.spins), 'spin')} at {rates} deg/s: "
        f"{scale_factor.scale_factor_ppm:.2f} ± {scale_factor.sigma_ppm:.2f} ppm (p "
        f"{p_text(scale_factor.p_value)})"
    )
    for each in scale_factor.rates:
        parts = [f"{each.deviation_ppm:+.2f} ± {each.deviation_sigma_ppm:.2f} ppm"] * (
            len(scale_factor.rates) > 1
        )
        if each.asymmetry_ppm is not None:
            parts.append(f"asymmetry {each.asymmetry_ppm:+.2f} ± {each.asymmetry_sigma_ppm:.2f} ppm")
        text += f"; {each.rate_dps:.3g} deg/s {', '.join(parts)}" if parts else ""
    return f"Spins {scale_factor.axis}", text


def _fit_sentence(calibration: Calibration) -> str:
    fit = calibration.fit
    if fit.dof == 0:
        return "not tested: the rests are too short"
    test = f"chi2 {fit.chi2:.0f} for {fit.dof} degrees of freedom, p {p_text(fit.p_value)}"
    if fit.p_value >= UNEXPLAINED_P_VALUE:
        return f"noise explains the velocity at rest ({test})"
    return f"{test}: see Check"


def _xyz_text(values: np.ndarray) -> str:
    return ", ".join(f"{value:.2g}" for value in values)
