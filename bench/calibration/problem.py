"""The least-squares problem of the coefficients, and alternative explanations of its residuals.

Another latitude, a wrong time, optional parameters or whole turns that contradict the rotations: each
alternative is the same problem with one assumption changed.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from gyrobench.bench.bias.statistics import Chi2Test, chi2_p_value, chi2_test
from gyrobench.bench.calibration.coefficients import COEFFICIENTS, COUNT, OPTIONAL_PARAMETERS, SensorErrors
from gyrobench.bench.calibration.increment_recording import SensorNoise
from gyrobench.bench.calibration.information import (
    ATTITUDE_ERROR,
    BIAS_DRIFT,
    FORCE_SCALE,
    IS_FORCE_SCALE,
    IS_GYRO_SCALE,
    MIN_SINGULAR_VALUE,
    USUAL_QUADRATIC,
    CalibrationOptions,
    Information,
)
from gyrobench.bench.calibration.section import IncrementSection
from gyrobench.bench.calibration.strapdown import (
    ATTITUDE,
    DRIFT,
    G_SENSITIVITIES,
    LATITUDE,
    PARAMETER_COUNT,
    QUADRATIC,
    Trajectory,
)
from gyrobench.bench.calibration.whitening import white_rows
from gyrobench.bench.foundations.arrays import DPH_TO_RADPS, STANDARD_GRAVITY, BoolArray, FloatArray
from gyrobench.bench.foundations.errors import MeasurementError
from gyrobench.bench.foundations.text import capitalised
from gyrobench.bench.navigation.attitude import rotation_matrices
from gyrobench.bench.navigation.error_model import Site

#: Iterations of the linearisation, and conditions of convergence: largest change of chi-square, and of each
#: observed parameter in standard uncertainties.
_MAX_ROUNDS, _MAX_CHI2_CHANGE, _MAX_STEP_SIGMAS = 15, 0.1, 0.05
#: After a step that multiplies chi-square by more than the first factor, steps are restricted to directions
#: that the data determine better by the second factor.
_MAX_CHI2_GROWTH, _DIRECTION_FACTOR = 2.0, 10.0
#: An alternative explains the residuals if it reduces chi2 to this share. A chi2 below this multiple of its
#: degrees of freedom can't fall that far, unless the noise is less than half of the declared one.
_EXPLAINED_SHARE, _MIN_CHI2_PER_DOF = 0.1, 2.5
#: If the error of the latitude is smaller than this, rad, its correction reduces chi2 by the square of the
#: error in standard uncertainties; chi2 of sums over minutes by at most this multiple of it.
_SMALL_ANGLE, _MAX_CHI2_RATIO = 0.01, 2.0
#: Explanations are equally good if their chi2, with 2 for each parameter, differ by less: odds of 100 to 1.
_MAX_CHI2_APART = 9.2
#: A latitude is converged if the next step does not reduce chi2 below this share.
_CONVERGED_SHARE = 0.5
#: The noise does not explain the residuals if their p-value is smaller.
UNEXPLAINED_P_VALUE = 1e-3
#: Smallest relative error of the time that is tested.
_MIN_TIME_ERROR = 3e-4
#: Largest sensitivity of a ring laser gyro to the specific force, s/m: 0.5 deg/h/g. A larger one is due to a
#: mistake in the set-up, such as a wrong latitude, whose rate along Up is a rate along the specific force.
_MAX_G_SENSITIVITY = 0.5 * DPH_TO_RADPS / STANDARD_GRAVITY
#: A sensitivity is reported, and may be a rate Up, if it exceeds these numbers of standard uncertainties.
_REPORTED_SIGMAS, _SIGNIFICANT_SIGMAS = 3.0, 4.0
_SENSITIVITIES = OPTIONAL_PARAMETERS[G_SENSITIVITIES.start - COUNT : G_SENSITIVITIES.stop - COUNT]
#: Options that may explain a misfit, with descriptions and the options of ``gyrobench calibrate``.
_EXPLANATIONS: tuple[tuple[dict[str, Any], str, str], ...] = (
    ({"quadratic": True}, "quadratic terms of the accelerometers", "--quadratic"),
    ({"lever_arms": True}, "places of the accelerometers", "--lever-arms"),
    ({"delay": True}, "a delay of the accelerometers", "--delay"),
    ({"g_sensitivity": True}, "gyro biases that follow the specific force", "--g-sensitivity"),
    ({"asymmetries": (0, 1, 2)}, "asymmetries of the gyros' scale factors", "--asymmetry"),
    ({"bias_drift": BIAS_DRIFT}, "a drift of the gyro biases", "--drift"),
)
#: Prior of the mean of the accelerometers' scale factors if the vertical force is not measured: nearly zero.
_COMMON_SCALE = 1e-9
#: Epochs at rest over which residuals are summed for the goodness-of-fit test.
_FIT_EPOCHS = 60


@dataclass(frozen=True, eq=False)
class Estimates:
    """Estimates of all parameters of a problem, and their fit.

    The parameters are the coefficients, optional parameters, initial attitudes and drifts of the biases.
    """

    #: values, covariance, is_observed: Of all parameters.
    values: FloatArray
    covariance: FloatArray
    is_observed: BoolArray
    common: FloatArray  #: Shape (46,). Parameters common to all recordings, SI.
    starts: list[FloatArray]  #: Attitudes (3, 3) at the start of each section.
    fit: Chi2Test
    information: Information
    trajectories: list[Trajectory]


@dataclass(frozen=True, eq=False)
class _Point:
    """Point at which a problem is linearised."""

    values: FloatArray  #: Of all parameters; those of attitudes are corrections to ``starts``, here zero.
    starts: list[FloatArray]  #: Attitudes (3, 3) at the start of each section.
    origin: FloatArray  #: Values near which parameters stay if the data do not determine them.

    def advance(self, step: FloatArray, first: int) -> _Point:
        """Point moved by ``step``; attitude corrections start at index ``first``."""
        turns = slice(first, first + 3 * len(self.starts))
        values, origin = self.values + step, self.origin.copy()
        values[turns] = 0.0
        origin[turns] -= step[turns]
        attitudes = rotation_matrices(step[turns].reshape(-1, 3))
        return _Point(values, [turn @ C for turn, C in zip(attitudes, self.starts, strict=True)], origin)


@dataclass(frozen=True, eq=False)
class CalibrationProblem:
    """Data and assumptions from which the coefficients are estimated."""

    sections: Sequence[IncrementSection]
    noise: SensorNoise
    site: Site
    options: CalibrationOptions
    #: Shape (3,). Initial values of the gyro biases, rad/s.
    initial_bias: FloatArray = field(default_factory=lambda: np.zeros(3))

    @property
    def gravity(self) -> float:
        """Local gravity, m/s^2."""
        return self.options.gravity or self.site.gravity

    def with_options(self, **changes: Any) -> CalibrationProblem:
        """Problem with other values of some :class:`CalibrationOptions`."""
        return replace(self, options=replace(self.options, **changes))

    def solve(self) -> Estimates:
        """Estimate all parameters. Raises MeasurementError if the iteration does not converge."""
        columns, initial_errors = self.options.columns, SensorErrors(gyro_bias=self.initial_bias)
        common = np.zeros(PARAMETER_COUNT)
        common[:COUNT] = initial_errors.vector()
        per_section = 6 if self.options.bias_drift else 3
        initial = np.concatenate([common[columns], np.zeros(per_section * len(self.sections))])
        starts = [each.initial_attitude(initial_errors) for each in self.sections]
        point = trial = _Point(initial, starts, initial)
        lowest_chi2, next_chi2, min_singular_value = np.inf, np.inf, MIN_SINGULAR_VALUE
        for _ in range(_MAX_ROUNDS):
            common[columns] = trial.values[: len(columns)]
            trial_trajectories = self.integrate(trial.starts, common)
            linear = self.information(trial_trajectories, common)
            if (chi2 := linear.chi2(trial.values)) < _MAX_CHI2_GROWTH * lowest_chi2:
                point, information, trajectories, lowest_chi2 = trial, linear, trial_trajectories, chi2
                values, covariance, is_observed = information.solve(point.origin)
            elif np.isfinite(lowest_chi2):
                min_singular_value *= _DIRECTION_FACTOR
            else:
                break
            step = information.project_observable(values - point.values, min_singular_value)
            trial, chi2_before = point.advance(step, len(columns)), next_chi2
            next_chi2 = information.chi2(point.values + step)
            # If the residuals exceed the noise, tolerances scale with them.
            excess = max(1.0, next_chi2 / sum(map(len, information.blocks)))
            is_converged = np.abs(step) < _MAX_STEP_SIGMAS * np.sqrt(excess * np.diag(covariance))
            if abs(next_chi2 - chi2_before) < _MAX_CHI2_CHANGE * excess and is_converged[is_observed].all():
                common[columns] = trial.values[: len(columns)]
                fit = _test_fit(values, covariance, information.blocks)
                return Estimates(
                    values, covariance, is_observed, common, trial.starts, fit, information, trajectories
                )
        raise MeasurementError(
            "the estimate does not converge: the increments do not follow from rotations between rests at "
            "one place. Check signs, axes and units in the import map; of a run, those of ins.signals, and "
            "whether the table turns as its angles say"
        )

    def integrate(self, starts: Sequence[FloatArray], common: FloatArray) -> list[Trajectory]:
        """Trajectory of each section from its initial attitude (3, 3), corrected for ``common`` (46,)."""
        all_columns = range(LATITUDE)
        drifts = all_columns[DRIFT] if self.options.bias_drift else ()
        columns = [*self.options.columns, *all_columns[ATTITUDE], *drifts, LATITUDE]
        return [
            section.integrate(start, common, self.site.latitude, self.gravity, columns)
            for section, start in zip(self.sections, starts, strict=True)
        ]

    def information(self, trajectories: Sequence[Trajectory], common: FloatArray) -> Information:
        """Linearised rows of the trajectories that :meth:`integrate` gives with the same ``common`` (46,)."""
        options, used, blocks = self.options, self.options.columns, []
        for number, (section, trajectory) in enumerate(zip(self.sections, trajectories, strict=True)):
            rows, data = white_rows(
                section, trajectory, self.noise, self.site.latitude, options.whole_turns, options.heading
            )
            section_rows = rows[:, len(used) : -1].reshape(len(rows), -1, 3)
            rows_by_section = np.zeros((len(rows), section_rows.shape[1], len(self.sections), 3))
            rows_by_section[:, :, number] = section_rows
            parts = rows[:, : len(used)], rows_by_section.reshape(len(rows), -1), rows[:, -1:]
            blocks.append(np.column_stack([*parts, data + rows[:, : len(used)] @ common[used]]))
        has_vertical = [section.epochs.has_vertical for section in self.sections]
        if not any(has_vertical):
            # If gravity replaces the vertical force, the mean of the scale factors is not observable.
            mean = np.zeros((1, blocks[0].shape[1]))
            mean[0, np.flatnonzero(IS_FORCE_SCALE)] = 1.0 / _COMMON_SCALE
            blocks.append(mean)
        sizes = np.array([each.size for each in (*COEFFICIENTS, *OPTIONAL_PARAMETERS)])
        if not all(has_vertical):
            sizes[np.flatnonzero(IS_FORCE_SCALE)] = FORCE_SCALE
        if options.quadratic is None:
            sizes[QUADRATIC] = USUAL_QUADRATIC
        count = 3 * len(self.sections)
        drifts = count if options.bias_drift else 0
        own_sizes = [ATTITUDE_ERROR] * count + [options.bias_drift] * drifts
        columns = np.array([*used, *[PARAMETER_COUNT] * count, *[DRIFT.start] * drifts])
        priors = {"bias_drift": np.equal(columns, DRIFT.start)}
        if options.quadratic is None:
            priors["quadratic"] = np.isin(columns, range(QUADRATIC.start, QUADRATIC.stop))
        return Information(blocks, np.array([*sizes[used], *own_sizes]), priors)

    def site_covariances(self, information: Information) -> Mapping[str, FloatArray]:
        """Covariances of coefficients and optional parameters due to assumed gravity, latitude and time.

        The residuals hardly depend on errors of these assumptions.
        """
        options = self.options
        # An error of gravity acts as an error of all three scale factors.
        is_scale = np.isin(options.columns, np.flatnonzero(IS_FORCE_SCALE))
        shifts = {"gravity": is_scale * options.gravity_sigma / self.gravity}
        if options.latitude_sigma:
            shifts["latitude"] = options.latitude_sigma * information.latitude_shift()[: len(options.columns)]
        if any(options.scales_by_time):
            is_gyro_scale = np.isin(options.columns, np.flatnonzero(IS_GYRO_SCALE))
            by_gyro, by_force = options.scales_by_time
            shifts["time"] = by_gyro * is_gyro_scale + by_force * is_scale
        return {name: np.outer(shift, shift) for name, shift in shifts.items()}

    def with_g_sensitivity(self, estimates: Estimates) -> tuple[CalibrationProblem, Estimates, str]:
        """Problem and solution with gyro biases that follow the specific force, and a note about them.

        Unchanged and without a note if these do not explain the residuals, if noise or another latitude may
        explain them, or if they are larger than those of a ring laser gyro. Raises MeasurementError if
        a mistake in the map explains the residuals.
        """
        with_sensitivity = self.with_options(g_sensitivity=True)
        other = _explaining_solution(with_sensitivity, estimates)
        if other is None or other.fit.p_value < UNEXPLAINED_P_VALUE:
            return self, estimates, ""
        values, columns = other.common[G_SENSITIVITIES], with_sensitivity.options.columns
        indices = [columns.index(each) for each in range(G_SENSITIVITIES.start, G_SENSITIVITIES.stop)]
        covariance = other.covariance[np.ix_(indices, indices)]
        # As in an F-test: with larger noise, nine more parameters reduce chi2 by correspondingly more.
        gain = (estimates.fit.chi2 - other.fit.chi2) * other.fit.dof / other.fit.chi2
        is_implausible = (
            chi2_p_value(len(indices), gain) >= UNEXPLAINED_P_VALUE
            or np.abs(values).max() > _MAX_G_SENSITIVITY
            or self._may_be_rate_up(other, values, covariance)
        )
        if is_implausible:
            return self, estimates, ""
        self._check_alternatives(estimates, self._solutions_at_other_intervals(estimates))
        latitude = self.at_estimated_latitude(estimates)
        if latitude is not None and _explaining_solution(latitude, estimates) is not None:
            return self, estimates, ""
        sigmas = np.sqrt(np.diag(covariance))
        terms_text = ", ".join(
            f"{each.axis[0]} gyro {value * each.per_si:+.2g} ± {sigma * each.per_si:.1g} along {each.axis[1]}"
            for each, value, sigma in zip(_SENSITIVITIES, values, sigmas, strict=True)
            if abs(value) > _REPORTED_SIGMAS * sigma
        )
        text = (
            f"the gyro biases follow the specific force (p = {estimates.fit.p_value:.1g} without that), in "
            f"deg/h for each g: {terms_text}. The coefficients allow for this; the gyro biases are those "
            "without specific force"
        )
        return with_sensitivity, other, text

    def _may_be_rate_up(self, other: Estimates, values: FloatArray, covariance: FloatArray) -> bool:
        """Whether sensitivities (9,) may be due to an error of the latitude, or a bias that lags attitude.

        An equal sensitivity of all gyros along their own axes is a rate Up. It may be due to such an error if
        it is significant and larger than the other sensitivities.
        """
        mean, (correction, sigma) = np.eye(3).ravel() / 3.0, other.information.latitude_correction()
        up = abs(float(mean @ values))
        residual = np.sqrt(np.sum((values - 3.0 * mean * (mean @ values)) ** 2) / (len(values) - 1))
        return bool(
            (up > _SIGNIFICANT_SIGMAS * np.sqrt(mean @ covariance @ mean) and up > residual)
            or abs(correction) > _SIGNIFICANT_SIGMAS * np.hypot(sigma, self.options.latitude_sigma)
        )

    def explanation(self, estimates: Estimates) -> str:
        """Advice: an alternative that would explain a misfit, or reduce it.

        Raises MeasurementError if a mistake in the map explains it.
        """
        retimed = self._solutions_at_other_intervals(estimates)
        self._check_alternatives(estimates, retimed)
        alternatives = [
            (problem, f"{description} (gyrobench calibrate {option})", _solution(problem))
            for chosen, description, option in _EXPLANATIONS
            if not all(getattr(self.options, name) for name in chosen)
            for problem in [self.with_options(**chosen)]
        ]
        interval_s = self.sections[0].interval_s
        for problem, other in retimed:
            other_s = problem.sections[0].interval_s
            description = (
                f"samples {other_s:.6g} s apart and not {interval_s:.6g} s ('time' in the import map; of a "
                "run, ins.signals.increments.period_s)"
            )
            alternatives.insert(0, (problem, description, other))
        if (converged := self._at_converged_latitude(estimates)) is not None:
            latitude, at_latitude = converged
            description = f"a latitude of {np.rad2deg(latitude.site.latitude):.3f} deg"
            alternatives.insert(0, (latitude, description, at_latitude))
        explained = [
            (other.fit.chi2 + 2.0 * len(problem.options.columns), description, other.fit)
            for problem, description, other in alternatives
            if other is not None and _explains(other.fit.chi2, estimates.fit)
        ]
        if explained:
            lowest, _, fit = min(explained, key=lambda each: each[0])
            chi2_text = f"chi2 falls from {estimates.fit.chi2:.3g} to {fit.chi2:.3g}"
            equal = [description for each, description, _ in explained if each < lowest + _MAX_CHI2_APART]
            description = capitalised(" or ".join(equal))
            if fit.p_value >= UNEXPLAINED_P_VALUE:
                return f"{description} would explain it: {chi2_text}"
            return (
                f"{description} would reduce it: {chi2_text}; noise alone gives {fit.dof}. Something else is "
                "wrong too"
            )
        hint = "; gyrobench calibrate has --lever-arms, --delay, --quadratic, --g-sensitivity, --asymmetry"
        if not all(section.epochs.has_vertical for section in self.sections):
            hint = ", and whether the INS aligned again or corrected its output in between"
        return (
            "Check latitude, gravity, signs and times, and whether the unit drifts, changes its temperature, "
            f"moves at rest or has biases that follow attitude{hint}"
        )

    def _at_converged_latitude(self, estimates: Estimates) -> tuple[CalibrationProblem, Estimates] | None:
        """Problem at the estimated latitude, iterated until it converges, and its solution.

        None if there is no such latitude, or no solution.
        """
        converged, next_problem = None, self.at_estimated_latitude(estimates)
        for _ in range(_MAX_ROUNDS):
            if next_problem is None:
                break
            if (other := _solution(next_problem)) is None:
                return None
            converged = next_problem, other
            if (
                other.fit.p_value >= UNEXPLAINED_P_VALUE
                or other.fit.chi2 > _CONVERGED_SHARE * estimates.fit.chi2
            ):
                break
            estimates, next_problem = other, next_problem.at_estimated_latitude(other)
        return converged

    def at_estimated_latitude(self, estimates: Estimates) -> CalibrationProblem | None:
        """Problem at the latitude estimated from the data; None if that can't explain a misfit."""
        correction, sigma = estimates.information.latitude_correction()
        latitude = self.site.latitude + correction
        lowest_chi2 = estimates.fit.chi2 - _MAX_CHI2_RATIO * (correction / sigma) ** 2
        is_linear = abs(correction) < _SMALL_ANGLE
        if abs(latitude) >= 0.5 * np.pi or (is_linear and not _explains(lowest_chi2, estimates.fit)):
            return None
        return replace(self, site=replace(self.site, latitude=latitude))

    def _check_alternatives(
        self, estimates: Estimates, retimed: Sequence[tuple[CalibrationProblem, Estimates | None]]
    ) -> None:
        """Raise MeasurementError if a mistake in the map explains what the noise does not.

        ``retimed``: problems at other sample intervals with their solutions.
        """
        # A mistake in the map may only be the cause of large residuals.
        if estimates.fit.chi2 < _MIN_CHI2_PER_DOF * estimates.fit.dof:
            return
        opposite = replace(self, site=replace(self.site, latitude=-self.site.latitude))
        alternatives = [
            (
                _solution(opposite),
                "at the opposite latitude. Correct either 'calibration.latitude_deg' or the signs of all "
                "accelerometers in the import map",
            )
        ]
        interval_s = self.sections[0].interval_s
        alternatives += [
            (
                other,
                f"if samples are {problem.sections[0].interval_s:.4g} s apart and not {interval_s:.4g} s. "
                "Correct 'time' in the import map; of a run, ins.signals.increments.period_s",
            )
            for problem, other in retimed
        ]
        for other, text in alternatives:
            if other is not None and other.fit.chi2 < _EXPLAINED_SHARE * estimates.fit.chi2:
                raise MeasurementError(f"chi2 is {estimates.fit.chi2:.3g}, and {other.fit.chi2:.3g} {text}")

    def _solutions_at_other_intervals(
        self, estimates: Estimates
    ) -> list[tuple[CalibrationProblem, Estimates | None]]:
        """Problems with sample intervals that would remove the mean scale factor error of a triad, solved.

        A wrong interval changes all scale factors equally: those of the accelerometers if the log has
        increments, those of the gyros if it has rates.
        """
        problems = []
        for sensor, are_rates in (("accelerometer", False), ("gyro", True)):
            is_scale = [each.name == f"{sensor}_scale_factor" for each in COEFFICIENTS]
            scale = 1.0 + float(estimates.values[:COUNT][is_scale].mean())
            factor = 1.0 / scale if are_rates else scale
            if abs(factor - 1.0) > _MIN_TIME_ERROR:
                sections = [each.with_interval(factor, are_rates) for each in self.sections]
                problems.append(replace(self, sections=sections))
        return [(each, _solution(each)) for each in problems]


def _solution(problem: CalibrationProblem) -> Estimates | None:
    """Solution of a problem; None if it does not converge."""
    try:
        return problem.solve()
    except MeasurementError:
        return None


def _explaining_solution(problem: CalibrationProblem, estimates: Estimates) -> Estimates | None:
    """Solution of another problem with the same data, if it explains the residuals; else None."""
    other = _solution(problem)
    return other if other is not None and _explains(other.fit.chi2, estimates.fit) else None


def _explains(chi2: float, fit: Chi2Test) -> bool:
    """Whether another problem with this chi2 explains the residuals of a fit."""
    return chi2_p_value(fit.dof, chi2) >= UNEXPLAINED_P_VALUE or chi2 < _EXPLAINED_SHARE * fit.chi2


def _test_fit(values: FloatArray, covariance: FloatArray, blocks: Sequence[FloatArray]) -> Chi2Test:
    """Test that the noise explains the residuals, summed over minutes."""
    sums = np.vstack([_minute_sums(each) for each in blocks])
    sums = sums[sums.any(axis=1)]  # without components that are not measured
    return chi2_test(sums[:, -1] - sums[:, :-2] @ values, sums[:, :-2], covariance)


def _minute_sums(rows: FloatArray) -> FloatArray:
    """White rows summed over blocks of a minute, which reveal a slow misfit."""
    size, columns = 3 * _FIT_EPOCHS, rows.shape[1]
    blocks = rows[: len(rows) // size * size].reshape(-1, _FIT_EPOCHS, 3, columns)
    return np.asarray(blocks.sum(axis=1).reshape(-1, columns) / np.sqrt(_FIT_EPOCHS))
