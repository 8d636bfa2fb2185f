"""Systematic calibration: all coefficients from navigation errors over a list of rotations with rests.

The unit rests at one place between rotations. Integrated from an initial attitude determined by gravity and
the Earth's rate, the velocity at rest must be zero, and whole turns must lead back to the attitude before.
The deviations are explained by the coefficients, by errors of the initial attitude and, as an option, by the
positions of the accelerometers in the unit and their delay: generalised least squares, linearised at the
solution (Gauss and Newton). Recordings in separate attitudes, as of a tumble test, and rotations on a table
form one problem: coefficients are common, and each recording has its own initial attitude.

References
----------
Savage, "Improved Strapdown Inertial Sensor Calibration Procedures", Strapdown Associates, WBN-14020 (2014):
calibration from rotations between rests, sensed by the accelerometers alone.
Camberlein and Mazzanti, "Calibration technique for laser gyro strapdown inertial navigation systems",
Symposium Gyro Technology, Stuttgart 1985.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from gyrobench.bench.bias.statistics import Chi2Test, solve
from gyrobench.bench.calibration.coefficients import (
    COEFFICIENTS,
    COUNT,
    OPTIONAL_PARAMETERS,
    CoefficientEstimate,
    SensorErrors,
)
from gyrobench.bench.calibration.increment_recording import (
    IncrementRecording,
    RecordedRotation,
    SensorNoise,
    find_rotations,
    measure_noise,
)
from gyrobench.bench.calibration.information import (
    IS_FORCE_SCALE,
    CalibrationOptions,
    Information,
    gyros_spun_both_ways,
)
from gyrobench.bench.calibration.problem import UNEXPLAINED_P_VALUE, CalibrationProblem, Estimates
from gyrobench.bench.calibration.section import IncrementSection
from gyrobench.bench.calibration.strapdown import ASYMMETRIES, G_SENSITIVITIES, QUADRATIC, Trajectory
from gyrobench.bench.calibration.whole_turns import GYRO_SCALES, check_turns
from gyrobench.bench.foundations.arrays import RADPS_TO_DPH, BoolArray, FloatArray
from gyrobench.bench.foundations.errors import MeasurementError
from gyrobench.bench.navigation.earth import EARTH_RATE
from gyrobench.bench.navigation.error_model import Site
from gyrobench.bench.navigation.positions import AXES

#: Largest scale factor error or misalignment; larger ones are due to wrong units, signs or axes.
_MAX_ELEMENT = 0.25
#: Largest ratio of the sample rates of recordings that count as equal.
_MAX_RATE_RATIO = 1.01
#: Largest factor on the uncertainties.
_MAX_WIDENING = 10.0
#: Smallest tilt, rad, that is compared with the angles of the gyros, and their smallest share of it.
_MIN_TILT, _MIN_ANGLE_SHARE = 0.2, 0.5
#: Relative step of the variances whose contributions are derived, and those of the noise.
_VARIANCE_STEP = 1e-3
#: Usual sensitivity of a ring laser gyro's bias to the specific force, s/m, and none. Rotations are too few
#: to show it if it increases the uncertainty of a coefficient by this factor.
_SENSITIVITY_PER_SI = OPTIONAL_PARAMETERS[G_SENSITIVITIES.start - COUNT].per_si
USUAL_SENSITIVITY, _NO_SENSITIVITY = 0.01 / _SENSITIVITY_PER_SI, 1e-9 / _SENSITIVITY_PER_SI
_MIN_SENSITIVE_GROWTH = 1.6
_QUADRATICS = range(QUADRATIC.start, QUADRATIC.stop)
#: A quadratic term of an accelerometer is noted from this number of standard uncertainties on.
_SIGNIFICANT_SIGMAS = 4.0
#: Coning between samples counts from this number of standard deviations of its mean on.
_MIN_CONING_SIGMAS = 5.0
_NOISE = ("angle_random_walk", "velocity_random_walk", "white_angle", "white_velocity")


@dataclass(frozen=True, eq=False)
class Calibration(CoefficientEstimate):
    """Coefficients of one unit, with the recordings and assumptions from which they were estimated."""

    #: Data and assumptions: noise as measured at rest or declared; options as given, with g-sensitivities if
    #: they are significant.
    problem: CalibrationProblem
    recordings: tuple[IncrementRecording, ...]
    rotations: tuple[tuple[RecordedRotation, ...], ...]  #: Of each recording.
    #: Test that the noise explains the residuals of the velocity. If it does not, the uncertainties are
    #: multiplied by the root of chi2 over its degrees of freedom.
    fit: Chi2Test
    starts: tuple[FloatArray, ...]  #: Attitude ``C_nb`` (3, 3) at the start of each section.
    common: FloatArray  #: Shape (46,). Parameters common to all recordings, SI, observed or not.
    trajectories: tuple[Trajectory, ...]  #: Of the sections, at values close to these.
    #: Shapes (n, n). Parts of the covariance due to the uncertainty of gravity, latitude and time.
    site_covariances: Mapping[str, FloatArray]
    #: Contradictions: of the residuals to the noise, of whole turns to rotations, and vibration that the
    #: samples do not resolve; empty for none.
    findings: tuple[str, ...]
    notes: tuple[str, ...]  #: Parameters estimated in addition because they are significant.


def calibrate(
    recordings: Sequence[IncrementRecording], site: Site, options: CalibrationOptions | None = None
) -> Calibration:
    """Estimate all coefficients of a unit from its recordings.

    ``recordings``: of one unit, at one sample rate. Raises MeasurementError if the unit does not rest long
    enough, sample rates differ, or no coefficients explain the increments.
    """
    options = options or CalibrationOptions()
    _check_rates(recordings)
    noise = measure_noise(recordings)
    if options.walks is not None:
        walk, velocity_walk = (np.full(3, each) for each in options.walks)
        noise = replace(noise, angle_random_walk=walk, velocity_random_walk=velocity_walk)
    _check_force(recordings, options.gravity or site.gravity)
    _check_angle(recordings)
    rotations, problem = _problem(recordings, noise, site, options)
    options = problem.options
    estimates, note = problem.solve(), ""
    if options.g_sensitivity is None and estimates.fit.p_value < UNEXPLAINED_P_VALUE:
        problem, estimates, note = problem.with_g_sensitivity(estimates)
        options = problem.options
    shift, hidden_parts, hidden_note = _hidden_sensitivity(problem, estimates)
    turns = [turn for each in rotations for turn in each]
    is_observed = estimates.is_observed
    if all(turn.kind == "disturbance" for turn in turns):
        is_observed[:COUNT] &= [each.sensor != "gyro" or each.kind == "bias" for each in COEFFICIENTS]
    if not any(recording.has_vertical for recording in recordings):
        is_observed[:COUNT] &= ~np.array(IS_FORCE_SCALE)
    _check_size(estimates.values, is_observed)
    spun_axes = sorted({turn.axis for turn in turns if turn.is_spin})
    offset, contradiction = np.zeros(3), ""
    checked_problem = problem
    if options.whole_turns is not None and spun_axes:
        checked_problem, estimates, offset, contradiction = check_turns(problem, estimates, spun_axes)
    widening, misfit = _widening(checked_problem, estimates, is_observed)
    covariance = estimates.covariance * widening**2
    covariance[GYRO_SCALES, GYRO_SCALES] += offset**2
    # Terms that are allowed for without being asked for are not listed.
    listed = [k for k, each in enumerate(options.columns) if options.quadratic or each not in _QUADRATICS]
    coefficients = tuple((*COEFFICIENTS, *OPTIONAL_PARAMETERS)[options.columns[k]] for k in listed)
    both_listed = np.ix_(listed, listed)
    parts = {**problem.site_covariances(estimates.information), **hidden_parts}
    site_covariances = {name: part[both_listed] for name, part in parts.items()}
    quadratic = _quadratic_note(estimates.values, covariance, options)
    coning = _coning_finding(recordings, np.where(is_observed[:3], np.sqrt(np.diag(covariance)[:3]), np.inf))
    return Calibration(
        values=estimates.values[listed] + shift[listed],
        covariance=covariance[both_listed] + sum(site_covariances.values()),
        is_observed=is_observed[listed],
        coefficients=coefficients,
        problem=problem,
        recordings=tuple(recordings),
        rotations=tuple(map(tuple, rotations)),
        fit=estimates.fit,
        starts=tuple(estimates.starts),
        common=estimates.common,
        trajectories=tuple(estimates.trajectories),
        site_covariances=site_covariances,
        findings=tuple(filter(None, (contradiction, misfit, coning))),
        notes=tuple(filter(None, (note, hidden_note, quadratic))),
    )


def _hidden_sensitivity(
    problem: CalibrationProblem, estimates: Estimates
) -> tuple[FloatArray, Mapping[str, FloatArray], str]:
    """Effect of gyro biases that follow the specific force, if the rotations are too few to show them.

    Shift of the estimates if sensitivities of the usual size are allowed for, the covariance that they add,
    by source, and a note; none if they are estimated, or the effect is small.
    """
    no_effect: tuple[FloatArray, Mapping[str, FloatArray], str]
    no_effect = np.zeros(len(problem.options.columns)), {}, ""
    if problem.options.g_sensitivity is not None:
        return no_effect
    with_sensitivity = problem.with_options(g_sensitivity=True)
    options = with_sensitivity.options
    trajectories = with_sensitivity.integrate(estimates.starts, estimates.common)
    information = with_sensitivity.information(trajectories, estimates.common)
    is_sensitivity = np.zeros(len(information.sizes), dtype=bool)
    is_sensitivity[: len(options.columns)] = [
        each in range(G_SENSITIVITIES.start, G_SENSITIVITIES.stop) for each in options.columns
    ]
    kept = np.flatnonzero(~is_sensitivity)[: len(problem.options.columns)]
    solutions = []
    for size in (_NO_SENSITIVITY, USUAL_SENSITIVITY):
        sizes = np.where(is_sensitivity, size, information.sizes)
        values, covariance, _ = replace(information, sizes=sizes).solve()
        solutions.append((values[kept], covariance[np.ix_(kept, kept)]))
    (values, covariance), (with_values, with_covariance) = solutions
    growth = np.sqrt(np.diag(with_covariance) / np.diag(covariance))[:COUNT]
    growth[~estimates.is_observed[:COUNT]] = 1.0
    if growth.max() < _MIN_SENSITIVE_GROWTH:
        return no_effect
    each = COEFFICIENTS[int(growth.argmax())]
    note = (
        "too few rotations to show gyro biases that follow the specific force: the uncertainties allow "
        f"for {USUAL_SENSITIVITY * _SENSITIVITY_PER_SI:.2g} deg/h for each g, which makes that of the "
        f"{each.sensor} {each.kind.replace('_', ' ')} {each.axis} {growth.max():.2g} times as large"
    )
    return with_values - values, {"g_sensitivity": with_covariance - covariance}, note


def _problem(
    recordings: Sequence[IncrementRecording], noise: SensorNoise, site: Site, options: CalibrationOptions
) -> tuple[list[list[RecordedRotation]], CalibrationProblem]:
    """Rotations found in each recording, and the least-squares problem with them."""
    mean_rate = np.concatenate([each.rest_means()[0] for each in recordings]).mean(axis=0)
    bias = mean_rate if np.linalg.norm(mean_rate) > 3.0 * EARTH_RATE else np.zeros(3)

    def problem(options: CalibrationOptions) -> CalibrationProblem:
        sections = [IncrementSection.between_rests(*each) for each in zip(recordings, rotations, strict=True)]
        return CalibrationProblem(sections, noise, site, options, bias)

    rotations = [find_rotations(each) for each in recordings]
    if options.whole_turns is not None and any(
        turn.is_long and not turn.is_spin for turns in rotations for turn in turns
    ):
        # Uncorrected scale factors may be so wrong that whole turns do not seem to return to their start.
        without_turns = problem(replace(options, whole_turns=None)).solve()
        errors = SensorErrors.from_vector(without_turns.common[:COUNT])
        rotations = [
            find_rotations(each, errors.corrected(each.angle, each.velocity, each.interval_s)[0])
            for each in recordings
        ]
    if options.asymmetries is None:
        spun_axes = [(turn.axis, turn.path) for turns in rotations for turn in turns if turn.is_spin]
        options = replace(options, asymmetries=gyros_spun_both_ways(spun_axes))
    return rotations, problem(options)


def _widening(problem: CalibrationProblem, estimates: Estimates, is_observed: BoolArray) -> tuple[float, str]:
    """Factor on the uncertainties with which the noise explains the residuals, and a finding about it.

    Raises MeasurementError if it is too large, or as :meth:`CalibrationProblem.explanation`.
    """
    if estimates.fit.p_value >= UNEXPLAINED_P_VALUE:
        return 1.0, ""
    explanation = problem.explanation(estimates)
    factor = float(np.sqrt(estimates.fit.chi2 / estimates.fit.dof))
    if factor > _MAX_WIDENING and is_observed[:COUNT].any():
        raise MeasurementError(
            f"the residuals are {factor:.3g} times the noise, at most {_MAX_WIDENING:g} times is "
            f"accepted. {explanation}"
        )
    return factor, (
        f"noise does not explain the velocity at rest (p = {estimates.fit.p_value:.1g}); uncertainties are "
        f"multiplied by {factor:.2f}. {explanation}"
    )


def _quadratic_note(values: FloatArray, covariance: FloatArray, options: CalibrationOptions) -> str:
    """Note of significant quadratic terms of the accelerometers that were not asked for; else empty."""
    if options.quadratic is not None:
        return ""
    term_texts = []
    for number, column in enumerate(options.columns):
        if column in _QUADRATICS:
            each = OPTIONAL_PARAMETERS[column - COUNT]
            value, sigma = np.array([values[number], np.sqrt(covariance[number, number])]) * each.per_si
            if abs(value) > _SIGNIFICANT_SIGMAS * sigma:
                term_texts.append(f"{each.axis} {value:+.3g} ± {sigma:.1g}")
    if not term_texts:
        return ""
    return (
        f"the accelerometers have quadratic terms, in ug/g2: {', '.join(term_texts)}. The coefficients allow "
        "for them; the accelerometer biases are those without specific force"
    )


def _coning_finding(recordings: Sequence[IncrementRecording], sigmas: FloatArray) -> str:
    """Finding if coning between the samples passes for a gyro bias; ``sigmas`` (3,): of the biases, rad/s.

    The strapdown computes coning from each increment and the one before. The coefficients of an expansion in
    the frequency that uses one more increment show what it leaves.
    """
    products = [np.zeros((0, 3))]
    for recording in recordings:
        for rest in recording.rests if recording.has_vertical else ():
            angle = recording.angle[rest.begin : rest.end]
            products.append(np.cross(angle[:-2] - 2.0 * angle[1:-1], angle[2:]) / 60.0 / recording.interval_s)
    rates = np.concatenate(products)
    if not len(rates):
        return ""
    mean, noise = np.abs(rates.mean(axis=0)), rates.std(axis=0) / np.sqrt(len(rates))
    excess = mean / np.maximum(sigmas, _MIN_CONING_SIGMAS * noise)
    axis = int(np.argmax(excess))
    if excess[axis] <= 1.0:
        return ""
    return (
        f"vibration at rest cones faster than the samples resolve: the bias of the {AXES[axis]} gyro is "
        f"wrong by at least {mean[axis] * RADPS_TO_DPH:.2g} deg/h, {mean[axis] / sigmas[axis]:.2g} standard "
        "uncertainties. Remove the source of vibration, or have increments sent at a higher rate"
    )


def covariances_by_source(calibration: Calibration) -> Mapping[str, FloatArray]:
    """Covariances (21, 21) of the coefficients by source of error; their sum is the calibration's.

    The gains minimise the covariance, so a small change of a source's variance changes the covariance as if
    the gains were fixed. The contribution of a source is therefore the derivative of the covariance with
    respect to the logarithm of its variance.
    """
    larger, problem = float(np.sqrt(1.0 + _VARIANCE_STEP)), calibration.problem

    def information(problem: CalibrationProblem) -> Information:
        return problem.information(calibration.trajectories, calibration.common)

    def covariance(estimates: Information) -> FloatArray:
        return np.asarray(estimates.solve()[1][:COUNT, :COUNT])

    unchanged = information(problem)  # with the same rounding as the others
    base, parts = covariance(unchanged), {}
    for name in _NOISE:
        noise = replace(problem.noise, **{name: getattr(problem.noise, name) * larger})
        parts[name] = covariance(information(replace(problem, noise=noise)))
    if (turns := problem.options.whole_turns) is not None:
        parts["table_return"] = covariance(information(problem.with_options(whole_turns=turns * larger)))
    for name, is_scaled in {"assumed_size": ~unchanged.is_prior, **unchanged.priors}.items():
        if is_scaled.any():
            sizes = np.where(is_scaled, larger, 1.0) * unchanged.sizes
            parts[name] = covariance(replace(unchanged, sizes=sizes))
    parts = {name: (part - base) / _VARIANCE_STEP for name, part in parts.items()}
    # The finite step leaves an error of a thousandth.
    factors = np.sqrt(np.diag(base) / np.sum([np.diag(part) for part in parts.values()], axis=0))
    parts = {name: part * np.outer(factors, factors) for name, part in parts.items()}
    site_covariances = {name: part[:COUNT, :COUNT] for name, part in calibration.site_covariances.items()}
    remainder = calibration.covariance[:COUNT, :COUNT] - base - sum(site_covariances.values())
    # Without findings the remainder is rounding.
    return parts | site_covariances | {"misfit": remainder if calibration.findings else np.zeros_like(base)}


def bias_per_asymmetry(calibration: Calibration) -> FloatArray:
    """Change (3, k) of the gyro biases, rad/s, for an asymmetry of 1 in each gyro without an estimate of it.

    An asymmetry looks like a bias if rotations in both directions do not separate the two.
    """
    problem = calibration.problem.with_options(asymmetries=(0, 1, 2))
    trajectories = problem.integrate(calibration.starts, calibration.common)
    estimates = problem.information(trajectories, calibration.common)
    omitted_columns = [
        problem.options.columns.index(ASYMMETRIES.start + axis)
        for axis in range(3)
        if axis not in (calibration.problem.options.asymmetries or ())
    ]
    kept_columns = np.delete(np.arange(len(estimates.sizes)), omitted_columns)
    rows, sizes = estimates.root[:, kept_columns], np.diag(estimates.sizes[kept_columns])
    shifts = [solve(rows, estimates.root[:, each], sizes)[0][:3] for each in omitted_columns]
    return np.array(shifts).reshape(-1, 3).T


def _check_rates(recordings: Sequence[IncrementRecording]) -> None:
    """Raise MeasurementError if the sample rates differ."""
    rates_hz = [1.0 / each.interval_s for each in recordings]
    if max(rates_hz) > _MAX_RATE_RATIO * min(rates_hz):
        raise MeasurementError(
            f"the sample rates of the recordings differ: {min(rates_hz):.4g} to {max(rates_hz):.4g} Hz. "
            "Calibrate recordings of one rate together"
        )


def _check_force(recordings: Sequence[IncrementRecording], gravity: float) -> None:
    """Raise MeasurementError if the specific force does not have the unit stated in the map."""
    force = np.median(np.linalg.norm(np.concatenate([each.rest_means()[1] for each in recordings]), axis=1))
    if abs(force / gravity - 1.0) > _MAX_ELEMENT:
        raise MeasurementError(
            f"the specific force at rest is {force:.4g} m/s^2, gravity {gravity:.4g} m/s^2. Check "
            "'calibration.accelerometers.unit' and 'time' in the import map; of a run, ins.signals and DBC"
        )


def _check_angle(recordings: Sequence[IncrementRecording]) -> None:
    """Raise MeasurementError if the gyros measure far smaller rotations than the specific force."""
    by_force, by_gyros = [], []
    for recording in recordings:
        _, forces = recording.rest_means()
        ups = forces / np.linalg.norm(forces, axis=1, keepdims=True)
        by_force += np.arccos(np.clip((ups[1:] * ups[:-1]).sum(axis=1), -1.0, 1.0)).tolist()
        for before, after in pairwise(recording.rests):
            by_gyros.append(np.linalg.norm(recording.angle[before.end : after.begin], axis=1).sum())
    # Disturbances between rests are small, and the specific force does not show turns about the vertical.
    is_tilted = np.array(by_force) > _MIN_TILT
    if not is_tilted.any():
        return
    force, gyros = np.median(np.degrees([by_force, by_gyros])[:, is_tilted], axis=1)
    if gyros < _MIN_ANGLE_SHARE * force:
        raise MeasurementError(
            f"from rest to rest the specific force turns by {force:.3g} deg and the gyros by {gyros:.2g} "
            "deg. Check 'gyro.unit' in the import map; of a run, ins.signals and DBC"
        )


def _check_size(values: FloatArray, is_observed: BoolArray) -> None:
    """Raise MeasurementError if an element of the matrices is impossibly large."""
    for each, value, observed in zip(COEFFICIENTS, values[:COUNT], is_observed[:COUNT], strict=True):
        if observed and each.kind != "bias" and abs(value) > _MAX_ELEMENT:
            columns = "gyro" if each.sensor == "gyro" else "calibration.accelerometers"
            raise MeasurementError(
                f"{each.sensor} {each.kind.replace('_', ' ')} {each.axis} is {value:.3g}, at most "
                f"{_MAX_ELEMENT:g} is possible. Check unit, signs and axes of '{columns}' in the import map; "
                "of a run, those of ins.signals, and whether the table turns as its angles say"
            )
