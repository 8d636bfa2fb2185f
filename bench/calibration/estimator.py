"""Systematic calibration: all coefficients from navigation errors over a list of rotations with rests.

The unit rests at one place between rotations. Integrated from an attitude found by gravity and the Earth's
rate, the velocity at rest has to be zero, and whole turns have to lead back to the attitude before. What is
left is explained by the coefficients, by the attitude at the start and, as an option, by the places of the
accelerometers in the unit and their delay: generalised least squares, linearised at the solution (Gauss and
Newton). Recordings in separate attitudes, as of a tumble test, and rotations on a table are one problem:
coefficients are common, the attitude at the start is each recording's.

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
from typing import Any

import numpy as np

from gyrobench.bench.bias.statistics import Chi2Test, chi2_p_value, chi2_test
from gyrobench.bench.calibration.coefficients import (
    BESIDE,
    COEFFICIENTS,
    COUNT,
    CoefficientEstimate,
    SensorErrors,
)
from gyrobench.bench.calibration.information import (
    BIAS_DRIFT,
    IS_FORCE_SCALE,
    IS_GYRO_SCALE,
    CalibrationOptions,
    Information,
    integrated_sections,
)
from gyrobench.bench.calibration.recording import (
    IncrementRecording,
    RecordedRotation,
    Rest,
    SensorNoise,
    find_rests,
    find_rotations,
    measure_noise,
)
from gyrobench.bench.calibration.section import IncrementSection
from gyrobench.bench.calibration.strapdown import UNKNOWNS, Trajectory
from gyrobench.bench.foundations.arrays import BoolArray, FloatArray
from gyrobench.bench.foundations.errors import MeasurementError
from gyrobench.bench.navigation.attitude import rotation_matrices
from gyrobench.bench.navigation.earth import EARTH_RATE
from gyrobench.bench.navigation.error_model import Site
from gyrobench.bench.navigation.positions import AXES

#: Rounds of linearisation; the last one changes the weighted sum of squares by less than this, and each
#: observed unknown by less than this part of its standard uncertainty.
_MAX_ROUNDS, _CONVERGED, _MAX_STEP = 15, 0.1, 0.05
#: Scale factor errors and misalignments beyond this are wrong units, signs or axes.
_MAX_ELEMENT = 0.25
#: Sample rates of recordings that count as one.
_MAX_RATE_RATIO = 1.01
#: The opposite latitude is named where it reduces chi2 to this part; largest factor on the uncertainties.
_OPPOSITE, _MAX_WIDENING = 0.1, 10.0
#: Below this probability the noise alone does not explain the residuals.
MIN_P_VALUE = 1e-3
#: Smallest relative error of the time that is looked for.
_MIN_TIME_ERROR = 3e-4
#: Least eigenvalue of a correlation matrix, above rounding.
_MIN_EIGENVALUE = 1e-9
#: Options that may explain a misfit, with the option of ``gyrobench calibrate``.
_BESIDE_COEFFICIENTS: tuple[tuple[dict[str, Any], str], ...] = (
    ({"quadratic": True}, "quadratic terms of the accelerometers (--quadratic)"),
    ({"lever_arms": True}, "places of the accelerometers (--lever-arms)"),
    ({"delay": True}, "a delay of the accelerometers (--delay)"),
    ({"bias_drift": BIAS_DRIFT}, "a drift of the gyro biases (--drift)"),
)
_GYRO_SCALES = np.flatnonzero(IS_GYRO_SCALE)
#: Relative step of the variances whose contributions are derived, and those of the noise.
_VARIANCE_STEP = 1e-3
_NOISE = ("angle_random_walk", "velocity_random_walk", "white_angle", "white_velocity")
#: Epochs at rest over which residuals are summed for the test of fit.
_FIT_EPOCHS = 60


@dataclass(frozen=True, eq=False)
class Calibration(CoefficientEstimate):
    """Coefficients of one unit from its recordings, and what they rest on."""

    noise: SensorNoise  #: As measured at rest or declared.
    recordings: tuple[IncrementRecording, ...]
    rests: tuple[tuple[Rest, ...], ...]  #: Of each recording.
    rotations: tuple[tuple[RecordedRotation, ...], ...]  #: Of each recording.
    gravity: tuple[float, float]  #: Assumed gravity and its standard uncertainty, m/s^2.
    #: Test that the noise explains what the coefficients leave of the velocity. Where it does not, the
    #: uncertainties are larger by the root of chi2 over its degrees of freedom.
    fit: Chi2Test
    sections: tuple[IncrementSection, ...]  #: Of each recording, between rests.
    starts: tuple[FloatArray, ...]  #: Attitude ``C_nb`` (3, 3) at the start of each.
    unknowns: FloatArray  #: Shape (34,). Values that the increments are freed of, observed or not.
    trajectories: tuple[Trajectory, ...]  #: Of the sections, at values close to these.
    #: Shapes (n, n). Parts of the covariance by the uncertainty of gravity, latitude and time.
    by_site: Mapping[str, FloatArray]
    #: What the data contradict: the noise, or whole turns and rotations each other; empty for nothing.
    findings: tuple[str, ...] = ()


def calibrate(
    recordings: Sequence[IncrementRecording],
    site: Site,
    options: CalibrationOptions | None = None,
    rests: Sequence[Sequence[Rest]] | None = None,
) -> Calibration:
    """Estimate all coefficients.

    ``recordings``: of one unit, at one sample rate. ``rests``: of each recording; by default those found in
    it. Raises MeasurementError if the unit does not rest long enough, sample rates differ, or no coefficients
    explain the increments.
    """
    options = options or CalibrationOptions()
    gravity = options.gravity or site.gravity
    rates_hz = [1.0 / each.interval_s for each in recordings]
    if max(rates_hz) > _MAX_RATE_RATIO * min(rates_hz):
        raise MeasurementError(
            f"the sample rates of the recordings differ: {min(rates_hz):.4g} to {max(rates_hz):.4g} Hz. "
            "Calibrate recordings of one rate together"
        )
    rests = [find_rests(each) for each in recordings] if rests is None else rests
    rotations = [find_rotations(*each) for each in zip(recordings, rests, strict=True)]
    noise = measure_noise(recordings, rests)
    if options.walks is not None:
        walk, velocity_walk = options.walks
        noise = replace(
            noise, angle_random_walk=np.full(3, walk), velocity_random_walk=np.full(3, velocity_walk)
        )
    _check_force(recordings, rests, gravity)
    bias = _first_bias(recordings, rests)

    def problem_with(
        rotations: Sequence[Sequence[RecordedRotation]], options: CalibrationOptions
    ) -> _Problem:
        sections = [
            IncrementSection.between_rests(*each) for each in zip(recordings, rests, rotations, strict=True)
        ]
        return _Problem(sections, bias, noise, site, options)

    if options.whole_turns is not None and any(
        turn.is_long and not turn.is_spin for turns in rotations for turn in turns
    ):
        # Scale factors may be so wrong that whole turns seem to end elsewhere.
        first = problem_with(rotations, replace(options, whole_turns=None)).solve()
        errors = SensorErrors.from_vector(first.common[:COUNT])
        rotations = [
            find_rotations(each, its, errors.removed(each.angle, each.velocity, each.interval_s)[0])
            for each, its in zip(recordings, rests, strict=True)
        ]
    problem = problem_with(rotations, options)
    sections = problem.sections
    found, findings, offset = problem.solve(), [], np.zeros(3)
    is_observed = found.is_observed
    if all(turn.kind == "disturbance" for turns in rotations for turn in turns):
        is_observed[:COUNT] &= [each.sensor != "gyro" or each.kind == "bias" for each in COEFFICIENTS]
    if not any(recording.has_vertical for recording in recordings):
        is_observed[:COUNT] &= ~np.array(IS_FORCE_SCALE)
    _check_size(found.values, is_observed)
    spun = sorted({turn.axis for turns in rotations for turn in turns if turn.is_spin})
    if options.whole_turns is not None and spun:
        problem, found, offset, contradiction = problem.with_turns_checked(found, spun)
        findings += [contradiction] * bool(contradiction)
    covariance, test = found.covariance, found.fit
    if test.p_value < MIN_P_VALUE:
        problem.check_alternatives(found)
        widening = float(np.sqrt(test.chi2 / test.dof))
        if widening > _MAX_WIDENING and is_observed[:COUNT].any():
            raise MeasurementError(
                f"the residuals are {widening:.3g} times the noise, at most {_MAX_WIDENING:g} times is "
                f"accepted. {problem.explanation(found)}"
            )
        covariance = covariance * widening**2
        findings.append(
            f"noise does not explain the velocity at rest (p = {test.p_value:.1g}); uncertainties are "
            f"multiplied by {widening:.2f}. {problem.explanation(found)}"
        )
    covariance = covariance.copy()
    covariance[_GYRO_SCALES, _GYRO_SCALES] += offset**2
    coefficients = tuple((*COEFFICIENTS, *BESIDE)[each] for each in options.columns)
    count = len(coefficients)
    by_site = found.information.site_parts(site, options)
    return Calibration(
        values=found.values[:count],
        covariance=covariance[:count, :count] + sum(by_site.values()),
        is_observed=is_observed[:count],
        coefficients=coefficients,
        noise=noise,
        recordings=tuple(recordings),
        rests=tuple(map(tuple, rests)),
        rotations=tuple(map(tuple, rotations)),
        gravity=(gravity, options.gravity_sigma),
        fit=test,
        sections=tuple(sections),
        starts=tuple(found.starts),
        unknowns=found.common,
        trajectories=tuple(found.trajectories),
        by_site=by_site,
        findings=tuple(findings),
    )


@dataclass(frozen=True, eq=False)
class _Solution:
    #: values, covariance, is_observed: Of all unknowns, attitudes at the starts included.
    values: FloatArray
    covariance: FloatArray
    is_observed: BoolArray
    common: FloatArray  #: Shape (34,).
    starts: list[FloatArray]
    fit: Chi2Test
    information: Information
    trajectories: list[Trajectory]


@dataclass(frozen=True, eq=False)
class _Problem:
    """What the coefficients are estimated from."""

    sections: Sequence[IncrementSection]
    bias: FloatArray  #: Shape (3,). Of the gyros, rad/s, where to begin.
    noise: SensorNoise
    site: Site
    options: CalibrationOptions

    def solve(self) -> _Solution:
        """Estimate all unknowns. Raises MeasurementError if that does not converge."""
        used = self.options.columns
        common, first = np.zeros(UNKNOWNS), SensorErrors(gyro_bias=self.bias)
        common[:COUNT] = first.vector()
        starts = [each.aligned(first) for each in self.sections]
        beside = 6 if self.options.bias_drift else 3
        origin, left = np.concatenate([common[used], np.zeros(beside * len(self.sections))]), np.inf
        for _ in range(_MAX_ROUNDS):
            trajectories = integrated_sections(self.sections, starts, common, self.site, self.options)
            found = Information.of(self.sections, trajectories, common, self.noise, self.site, self.options)
            values, covariance, is_observed = found.solve(origin)
            attitudes = values[len(used) :].reshape(-1, 3)[: len(starts)]
            step = np.concatenate([values[: len(used)] - common[used], attitudes.ravel()])
            before, left = left, float(np.linalg.norm(found.root @ [*values, 0.0, -1.0]) ** 2)
            common[used] = values[: len(used)]
            origin[len(used) : len(step)] -= attitudes.ravel()
            starts = [turn @ start for turn, start in zip(rotation_matrices(attitudes), starts, strict=True)]
            # Sizes count in units of the residuals where these exceed the noise.
            excess = max(1.0, left / sum(map(len, found.blocks)))
            is_still = np.abs(step) < _MAX_STEP * np.sqrt(excess * np.diag(covariance))[: len(step)]
            if abs(left - before) < _CONVERGED * excess and is_still[is_observed[: len(step)]].all():
                fit = _test_fit(values, covariance, found.blocks)
                return _Solution(values, covariance, is_observed, common, starts, fit, found, trajectories)
        raise MeasurementError(
            f"the estimate does not converge in {_MAX_ROUNDS} rounds: the increments do not follow from "
            "rotations between rests at one place. Check signs, axes and units in the import map"
        )

    def with_turns_checked(
        self, found: _Solution, spun: Sequence[int]
    ) -> tuple[_Problem, _Solution, FloatArray, str]:
        """The same problem, and its solution, with whole turns as uncertain as rotations and noise show.

        Also by how much the scale factors of whole turns contradict the others (3,), zero where they do not,
        and that as text. A scale factor that depends on the rate is no fault of the rests. It makes turns at
        several rates scatter, and those at one rate contradict the rotations, as a table does that returns
        elsewhere. ``spun``: the gyros that were spun.
        """
        offset, text = self._contradiction(found, spun)
        if not text and found.fit.p_value >= MIN_P_VALUE:
            return self, found, offset, ""
        alone = replace(self, options=replace(self.options, whole_turns=None)).solve()
        spins = [
            spin
            for section, start in zip(self.sections, alone.starts, strict=True)
            for spin in section.spin_errors(start, alone.common, self.site)
        ]
        if not spins or not (text or alone.fit.p_value >= MIN_P_VALUE):
            return self, found, offset, ""
        left = []
        for axis in {spin.axis for spin in spins}:
            error, path = np.array([(each.error, each.path) for each in spins if each.axis == axis]).T
            left += list(error - path * (path @ error) / (path @ path) + path * offset[axis])
        turns = float(np.hypot(self.options.whole_turns or 0.0, np.sqrt(np.mean(np.square(left)))))
        widened = replace(self, options=replace(self.options, whole_turns=turns))
        return widened, widened.solve(), offset, text

    def _contradiction(self, found: _Solution, spun: Sequence[int]) -> tuple[FloatArray, str]:
        """Scale factors (3,) of whole turns less the others, and that as text; zero where noise explains it.

        The covariance of the difference is that of a part of the data less that of all (Hausman 1978).
        """
        offset, options = np.zeros(3), replace(self.options, whole_turns=None)
        known = self.sections, found.trajectories, found.common
        others = Information.of(*known, self.noise, self.site, options)
        origin = np.zeros(len(found.values))
        origin[: len(options.columns)] = found.common[options.columns]
        values, others_covariance, is_observed = others.solve(origin)
        axes = [axis for axis in spun if is_observed[_GYRO_SCALES[axis]]]
        places = [_GYRO_SCALES[axis] for axis in axes]
        if not places:
            return offset, ""
        difference = found.values[places] - values[places]
        covariance = (others_covariance - found.covariance)[np.ix_(places, places)]
        scales = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
        squares, directions = np.linalg.eigh(covariance / np.outer(scales, scales))
        parts = (directions.T @ (difference / scales)) ** 2 / np.maximum(squares, _MIN_EIGENVALUE)
        p_value = chi2_p_value(len(places), float(parts.sum()))
        if p_value >= MIN_P_VALUE:
            return offset, ""
        # All data are a weighted mean of both.
        share = 1.0 - np.diag(found.covariance)[places] / np.diag(others_covariance)[places]
        offset[axes] = difference / np.maximum(share, _MIN_EIGENVALUE)
        apart = ", ".join(f"{AXES[axis]} {1e6 * offset[axis]:+.2g} ppm" for axis in axes)
        return offset, (
            f"whole turns contradict the rotations (p = {p_value:.1g}): scale factors of whole turns less "
            f"those of rotations are {apart}. Their uncertainties include it. Check that the table returns "
            "to where it was, and whether the scale factors depend on the rate"
        )

    def explanation(self, found: _Solution) -> str:
        """What would explain a misfit, as advice."""
        alternatives = [
            (replace(self, options=replace(self.options, **chosen)), what)
            for chosen, what in _BESIDE_COEFFICIENTS
            if self.options.are_explained and not all(getattr(self.options, name) for name in chosen)
        ]
        latitude = self.site.latitude + found.information.latitude_correction()
        if abs(latitude) < 0.5 * np.pi:
            what = f"a latitude of {np.rad2deg(latitude):.3f} deg"
            alternatives.insert(0, (replace(self, site=replace(self.site, latitude=latitude)), what))
        for problem, what in alternatives:
            try:
                other = problem.solve()
            except MeasurementError:
                continue
            if other.fit.p_value >= MIN_P_VALUE or other.fit.chi2 < _OPPOSITE * found.fit.chi2:
                falls = f"chi2 falls from {found.fit.chi2:.3g} to {other.fit.chi2:.3g}"
                return f"{what[0].upper()}{what[1:]} would explain it: {falls}"
        others = "; gyrobench calibrate has --lever-arms, --delay, --quadratic"
        return (
            "Check latitude, gravity, signs and times, and whether the unit drifts, moves at rest or has "
            f"biases that follow attitude{others * self.options.are_explained}"
        )

    def check_alternatives(self, found: _Solution) -> None:
        """Raise MeasurementError if a mistake in the map explains what the noise does not."""
        opposite = replace(self.site, latitude=-self.site.latitude)
        alternatives = [
            (
                replace(self, site=opposite),
                "at the opposite latitude. Correct either 'calibration.latitude_deg' or the signs of all "
                "accelerometers in the import map",
            )
        ]
        # A wrong interval makes scale factors alike: of increments the accelerometers', of rates the gyros'.
        for sensor, of_rates in (("accelerometer", False), ("gyro", True)):
            chosen = [each.name == f"{sensor}_scale_factor" for each in COEFFICIENTS]
            scale = 1.0 + float(found.values[:COUNT][chosen].mean())
            factor = 1.0 / scale if of_rates else scale
            if abs(factor - 1.0) > _MIN_TIME_ERROR:
                text = (
                    f"if samples are {self.sections[0].interval_s * factor:.4g} s apart and not "
                    f"{self.sections[0].interval_s:.4g} s. Correct 'time' in the import map"
                )
                retimed = [each.retimed(factor, of_rates) for each in self.sections]
                alternatives.append((replace(self, sections=retimed), text))
        for problem, text in alternatives:
            try:
                other = problem.solve()
            except MeasurementError:
                continue
            if other.fit.chi2 < _OPPOSITE * found.fit.chi2:
                raise MeasurementError(f"chi2 is {found.fit.chi2:.3g}, and {other.fit.chi2:.3g} {text}")


def covariances_by_source(
    calibration: Calibration, site: Site, options: CalibrationOptions
) -> Mapping[str, FloatArray]:
    """Covariances (21, 21) of the coefficients by source of error; their sum is the calibration's.

    At the gains of least covariance a small change of a source's variance changes the covariance as it does
    at fixed gains, for the gains are at a minimum. So what a source contributes is the derivative of the
    covariance with respect to the logarithm of its variance. ``options`` are those of the calibration.
    """
    larger = float(np.sqrt(1.0 + _VARIANCE_STEP))

    known = calibration.sections, calibration.trajectories, calibration.unknowns

    def information(noise: str = "", whole_turns: float | None = options.whole_turns) -> Information:
        changed = {noise: getattr(calibration.noise, noise) * larger} if noise else {}
        assumed = replace(calibration.noise, **changed), site, replace(options, whole_turns=whole_turns)
        return Information.of(*known, *assumed)

    def covariance(found: Information) -> FloatArray:
        return np.asarray(found.solve()[1][:COUNT, :COUNT])

    unchanged = information()  # with the same rounding as the others
    base = covariance(unchanged)
    parts = {name: covariance(information(name)) for name in _NOISE}
    if options.whole_turns is not None:
        parts["table_return"] = covariance(information(whole_turns=options.whole_turns * larger))
    is_drift = np.arange(len(unchanged.sizes)) >= len(unchanged.sizes) - unchanged.drifts
    for name, chosen in (("assumed_size", ~is_drift), ("bias_drift", is_drift)):
        if chosen.any():
            sizes = np.where(chosen, larger, 1.0) * unchanged.sizes
            parts[name] = covariance(replace(unchanged, sizes=sizes))
    parts = {name: (part - base) / _VARIANCE_STEP for name, part in parts.items()}
    # The step leaves a thousandth.
    factors = np.sqrt(np.diag(base) / np.sum([np.diag(part) for part in parts.values()], axis=0))
    parts = {name: part * np.outer(factors, factors) for name, part in parts.items()}
    by_site = {name: part[:COUNT, :COUNT] for name, part in calibration.by_site.items()}
    beyond = calibration.covariance[:COUNT, :COUNT] - base - sum(by_site.values())
    # Where nothing is contradicted what is left is rounding.
    return parts | by_site | {"misfit": beyond if calibration.findings else np.zeros_like(base)}


def _check_force(
    recordings: Sequence[IncrementRecording], rests: Sequence[Sequence[Rest]], gravity: float
) -> None:
    """Raise MeasurementError if the accelerometers are not in the unit that the map states."""
    force = np.median(
        [
            np.linalg.norm(recording.velocity[rest.begin : rest.end].mean(axis=0)) / recording.interval_s
            for recording, stretches in zip(recordings, rests, strict=True)
            for rest in stretches
        ]
    )
    if abs(force / gravity - 1.0) > _MAX_ELEMENT:
        raise MeasurementError(
            f"the specific force at rest is {force:.4g} m/s^2, gravity {gravity:.4g} m/s^2. Check "
            "'calibration.accelerometers.unit' and 'time' in the import map"
        )


def _check_size(values: FloatArray, is_observed: BoolArray) -> None:
    """Raise MeasurementError at elements of the matrices that no sensor has."""
    for each, value, observed in zip(COEFFICIENTS, values[:COUNT], is_observed[:COUNT], strict=True):
        if observed and each.kind != "bias" and abs(value) > _MAX_ELEMENT:
            columns = "gyro" if each.sensor == "gyro" else "calibration.accelerometers"
            raise MeasurementError(
                f"{each.sensor} {each.kind.replace('_', ' ')} {each.axis} is {value:.3g}, at most "
                f"{_MAX_ELEMENT:g} is possible. Check unit, signs and axes of '{columns}' in the import map"
            )


def _first_bias(recordings: Sequence[IncrementRecording], rests: Sequence[Sequence[Rest]]) -> FloatArray:
    """Gyro biases that exceed the Earth's rate by far; zero otherwise."""
    rates = [
        recording.angle[rest.begin : rest.end].mean(axis=0) / recording.interval_s
        for recording, stretches in zip(recordings, rests, strict=True)
        for rest in stretches
    ]
    mean = np.mean(rates, axis=0)
    return np.asarray(mean if np.linalg.norm(mean) > 3.0 * EARTH_RATE else np.zeros(3))


def _test_fit(values: FloatArray, covariance: FloatArray, blocks: Sequence[FloatArray]) -> Chi2Test:
    """Test that the noise explains the residuals, summed over minutes."""
    sums = np.vstack([_sums(each) for each in blocks])
    sums = sums[sums.any(axis=1)]  # without those of what is not measured
    return chi2_test(sums[:, -1] - sums[:, :-2] @ values, sums[:, :-2], covariance)


def _sums(rows: FloatArray) -> FloatArray:
    """White rows summed over blocks of a minute, which show a slow misfit."""
    size, columns = 3 * _FIT_EPOCHS, rows.shape[1]
    blocks = rows[: len(rows) // size * size].reshape(-1, _FIT_EPOCHS, 3, columns)
    return np.asarray(blocks.sum(axis=1).reshape(-1, columns) / np.sqrt(_FIT_EPOCHS))
