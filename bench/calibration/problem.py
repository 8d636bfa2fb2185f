"""Coefficients of a unit as one least-squares problem, and what else may explain its residuals.

Another latitude, a wrong time, terms beside the coefficients or whole turns that contradict the rotations:
each is the same problem with one assumption changed.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from gyrobench.bench.bias.statistics import Chi2Test, chi2_p_value, chi2_test
from gyrobench.bench.calibration.coefficients import BESIDE, COEFFICIENTS, COUNT, SensorErrors
from gyrobench.bench.calibration.increment_recording import SensorNoise
from gyrobench.bench.calibration.information import (
    BIAS_DRIFT,
    IS_GYRO_SCALE,
    MIN_SINGULAR_VALUE,
    CalibrationOptions,
    Information,
    integrated_sections,
)
from gyrobench.bench.calibration.section import IncrementSection, SpinError
from gyrobench.bench.calibration.strapdown import ASYMMETRIES, G_SENSITIVITIES, PARAMETER_COUNT, Trajectory
from gyrobench.bench.foundations.arrays import DPH_TO_RADPS, STANDARD_GRAVITY, BoolArray, FloatArray
from gyrobench.bench.foundations.errors import MeasurementError
from gyrobench.bench.foundations.text import capitalised
from gyrobench.bench.navigation.attitude import rotation_matrices
from gyrobench.bench.navigation.error_model import Site
from gyrobench.bench.navigation.positions import AXES

#: Rounds of linearisation; the last one changes the weighted sum of squares by less than this, and each
#: observed parameter by less than this part of its standard uncertainty.
_MAX_ROUNDS, _CONVERGED, _MAX_STEP = 15, 0.1, 0.05
#: After a step that multiplies the sum by more than this, steps are along fewer directions: those that the
#: data determine better by this factor.
_WORSE, _FEWER = 2.0, 10.0
#: Something else explains the residuals where it reduces chi2 to this part. A chi2 below this many times its
#: degrees of freedom can't fall that far unless the noise is less than half of the declared one.
_EXPLAINED, _MIN_EXPLICABLE = 0.1, 2.5
#: For an error of the latitude below this, rad, chi2 falls by the square of the error in units of its
#: uncertainty; chi2 of sums over minutes by at most this many times as much.
_SMALL_ANGLE, _MAX_CHI2_RATIO = 0.01, 2.0
#: A latitude is settled where the next step reduces chi2 no further than to this part.
_SETTLED = 0.5
#: Below this probability the noise alone does not explain the residuals.
UNEXPLAINED_P_VALUE = 1e-3
#: Smallest relative error of the time that is looked for.
_MIN_TIME_ERROR = 3e-4
#: Largest sensitivity of a ring laser gyro to the specific force, s/m: 0.5 deg/h/g. What needs more is a
#: mistake in the set-up, such as a latitude: its error along Up is one along the specific force.
_MAX_G_SENSITIVITY = 0.5 * DPH_TO_RADPS / STANDARD_GRAVITY
#: Standard uncertainties from which a sensitivity is named, and from which it may be a rate Up.
_NAMED_SIGMAS, _CLEAR_SIGMAS = 3.0, 4.0
_SENSITIVITIES = BESIDE[G_SENSITIVITIES.start - COUNT : G_SENSITIVITIES.stop - COUNT]
#: Least eigenvalue of a correlation matrix, above rounding.
_MIN_EIGENVALUE = 1e-9
#: Size of a parameter that is held, in its usual one.
_FIXED = 1e-6
#: Options that may explain a misfit, with the option of ``gyrobench calibrate``.
_BESIDE_COEFFICIENTS: tuple[tuple[dict[str, Any], str], ...] = (
    ({"quadratic": True}, "quadratic terms of the accelerometers (--quadratic)"),
    ({"lever_arms": True}, "places of the accelerometers (--lever-arms)"),
    ({"delay": True}, "a delay of the accelerometers (--delay)"),
    ({"g_sensitivity": True}, "gyro biases that follow the specific force (--g-sensitivity)"),
    ({"asymmetries": (0, 1, 2)}, "asymmetries of the gyros' scale factors (--asymmetry)"),
    ({"bias_drift": BIAS_DRIFT}, "a drift of the gyro biases (--drift)"),
)
#: Places of the scale factors of the gyros among the coefficients.
GYRO_SCALES = np.flatnonzero(IS_GYRO_SCALE)
#: Epochs at rest over which residuals are summed for the test of fit.
_FIT_EPOCHS = 60


@dataclass(frozen=True, eq=False)
class Estimates:
    """Estimates of all parameters of a problem, and how they fit.

    These are the coefficients, what is estimated beside them, attitudes at the starts, drifts of the biases.
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
class _TurnScatter:
    """Spins of one gyro, less its scale factor."""

    axis: int
    path: FloatArray  #: Shape (n,). Angles travelled, rad, with their signs.
    left: FloatArray  #: Shape (n,). Rad.
    variance: FloatArray  #: Shape (n,). Of each by noise and the table's return, rad^2.
    dof: int


@dataclass(frozen=True, eq=False)
class _Point:
    """Where a problem is linearised."""

    values: FloatArray  #: Of all parameters; attitudes are corrections to the ``starts``, and zero.
    starts: list[FloatArray]  #: Attitudes (3, 3) at the start of each section.
    origin: FloatArray  #: What the data leave open stays near it.

    def moved(self, step: FloatArray, first: int) -> _Point:
        """A step further; attitudes are from number ``first`` on."""
        turns = slice(first, first + 3 * len(self.starts))
        values, origin = self.values + step, self.origin.copy()
        values[turns] = 0.0
        origin[turns] -= step[turns]
        attitudes = rotation_matrices(step[turns].reshape(-1, 3))
        return _Point(values, [turn @ C for turn, C in zip(attitudes, self.starts, strict=True)], origin)


@dataclass(frozen=True, eq=False)
class CalibrationProblem:
    """What the coefficients are estimated from."""

    sections: Sequence[IncrementSection]
    bias: FloatArray  #: Shape (3,). Of the gyros, rad/s, where to begin.
    noise: SensorNoise
    site: Site
    options: CalibrationOptions

    def solve(self) -> Estimates:
        """Estimate all parameters. Raises MeasurementError if that does not converge."""
        used, first = self.options.columns, SensorErrors(gyro_bias=self.bias)
        common = np.zeros(PARAMETER_COUNT)
        common[:COUNT] = first.vector()
        beside = 6 if self.options.bias_drift else 3
        begin = np.concatenate([common[used], np.zeros(beside * len(self.sections))])
        point = trial = _Point(begin, [each.aligned(first) for each in self.sections], begin)
        lowest, left, least = np.inf, np.inf, MIN_SINGULAR_VALUE
        for _ in range(_MAX_ROUNDS):
            common[used] = trial.values[: len(used)]
            tried = integrated_sections(self.sections, trial.starts, common, self.site, self.options)
            linear = Information.of(self.sections, tried, common, self.noise, self.site, self.options)
            if (chi2 := linear.chi2(trial.values)) < _WORSE * lowest:
                point, found, trajectories, lowest = trial, linear, tried, chi2
                values, covariance, is_observed = found.solve(point.origin)
            elif np.isfinite(lowest):
                least *= _FEWER
            else:
                break
            step = found.shown(values - point.values, least)
            trial, before, left = point.moved(step, len(used)), left, found.chi2(point.values + step)
            # Sizes count in units of the residuals where these exceed the noise.
            excess = max(1.0, left / sum(map(len, found.blocks)))
            is_still = np.abs(step) < _MAX_STEP * np.sqrt(excess * np.diag(covariance))
            if abs(left - before) < _CONVERGED * excess and is_still[is_observed].all():
                common[used] = trial.values[: len(used)]
                fit = _test_fit(values, covariance, found.blocks)
                return Estimates(
                    values, covariance, is_observed, common, trial.starts, fit, found, trajectories
                )
        raise MeasurementError(
            "the estimate does not converge: the increments do not follow from rotations between rests at "
            "one place. Check signs, axes and units in the import map; of a run, those of ins.signals, and "
            "whether the table turns as its angles say"
        )

    def with_g_sensitivity(self, found: Estimates) -> tuple[CalibrationProblem, Estimates, str]:
        """The same problem, and its solution, with gyro biases that follow the specific force; these as text.

        Unchanged, without text, where these do not explain the residuals, noise or another latitude may, or
        they are larger than those of a ring laser gyro. Raises MeasurementError as
        :meth:`check_alternatives`.
        """
        wider = replace(self, options=replace(self.options, g_sensitivity=True))
        other = _explaining(wider, found)
        if other is None or other.fit.p_value < UNEXPLAINED_P_VALUE:
            return self, found, ""
        values, columns = other.common[G_SENSITIVITIES], wider.options.columns
        places = [columns.index(each) for each in range(G_SENSITIVITIES.start, G_SENSITIVITIES.stop)]
        covariance = other.covariance[np.ix_(places, places)]
        # As an F-test: larger noise makes nine more parameters gain as much more.
        gain = (found.fit.chi2 - other.fit.chi2) * other.fit.dof / other.fit.chi2
        is_doubtful = (
            chi2_p_value(len(places), gain) >= UNEXPLAINED_P_VALUE
            or np.abs(values).max() > _MAX_G_SENSITIVITY
            or self._is_rate_up(other, values, covariance)
        )
        if is_doubtful:
            return self, found, ""
        self.check_alternatives(found)
        latitude = self.at_another_latitude(found)
        if latitude is not None and _explaining(latitude, found) is not None:
            return self, found, ""
        sigmas = np.sqrt(np.diag(covariance))
        named = ", ".join(
            f"{each.axis[0]} gyro {value * each.per_si:+.2g} ± {sigma * each.per_si:.1g} along {each.axis[1]}"
            for each, value, sigma in zip(_SENSITIVITIES, values, sigmas, strict=True)
            if abs(value) > _NAMED_SIGMAS * sigma
        )
        text = (
            f"the gyro biases follow the specific force (p = {found.fit.p_value:.1g} without that), in deg/h "
            f"for each g: {named}. The coefficients allow for this; the gyro biases are those without "
            "specific force"
        )
        return wider, other, text

    def _is_rate_up(self, other: Estimates, values: FloatArray, covariance: FloatArray) -> bool:
        """Whether sensitivities (9,) may stand for an error of the latitude, or a bias that lags attitude.

        An equal sensitivity of all gyros along their own axes is a rate Up. It stands for such an error where
        it is clear and larger than the rest.
        """
        own, (correction, sigma) = np.eye(3).ravel() / 3.0, other.information.latitude_correction()
        up = abs(float(own @ values))
        rest = np.sqrt(np.sum((values - 3.0 * own * (own @ values)) ** 2) / (len(values) - 1))
        return bool(
            (up > _CLEAR_SIGMAS * np.sqrt(own @ covariance @ own) and up > rest)
            or abs(correction) > _CLEAR_SIGMAS * np.hypot(sigma, self.options.latitude_sigma)
        )

    def with_turns_checked(
        self, found: Estimates, spun: Sequence[int]
    ) -> tuple[CalibrationProblem, Estimates, FloatArray, str]:
        """The same problem, and its solution, with whole turns as uncertain as rotations and noise show.

        Also by how much the scale factors of whole turns contradict the others (3,), zero where they do not,
        and that as text. A scale factor that depends on the rate is no fault of the rests. It makes turns at
        several rates scatter, and those at one rate contradict the rotations, as a table does that returns
        elsewhere. ``spun``: the gyros that were spun.
        """
        offset, text = self._contradiction(found, spun)
        is_explained = found.fit.p_value >= UNEXPLAINED_P_VALUE
        if not text and is_explained and self._scatter_p_value(found) >= UNEXPLAINED_P_VALUE:
            return self, found, offset, ""
        alone = replace(self, options=replace(self.options, whole_turns=None)).solve()
        spins = self._spins(alone)
        if not spins or not (text or alone.fit.p_value >= UNEXPLAINED_P_VALUE):
            return self, found, offset, ""
        left = np.concatenate([each.left + each.path * offset[each.axis] for each in self._left(spins)])
        turns = float(np.hypot(self.options.whole_turns or 0.0, np.sqrt(np.mean(np.square(left)))))
        widened = replace(self, options=replace(self.options, whole_turns=turns))
        return widened, widened.solve(), offset, text

    def _spins(self, found: Estimates) -> list[SpinError]:
        """What each spin is wrong by with the values found."""
        pairs = zip(self.sections, found.starts, strict=True)
        return [spin for each, start in pairs for spin in each.spin_errors(start, found.common, self.site)]

    def _left(self, spins: Sequence[SpinError]) -> Iterator[_TurnScatter]:
        """What no scale factor and asymmetry explains of the spins of each gyro."""
        for axis in sorted({spin.axis for spin in spins}):
            error, path, duration_s = np.array(
                [(each.error, each.path, each.duration_s) for each in spins if each.axis == axis]
            ).T
            design = path[:, np.newaxis]
            if axis in (self.options.asymmetries or ()):
                design = np.column_stack([path, np.abs(path)])
            variance = (
                (self.options.whole_turns or 0.0) ** 2
                + 2.0 * self.noise.white_angle[axis] ** 2
                + self.noise.angle_random_walk[axis] ** 2 * duration_s
            )
            left = error - design @ np.linalg.lstsq(design, error)[0]
            yield _TurnScatter(axis, path, left, variance, max(0, len(path) - design.shape[1]))

    def _scatter_p_value(self, found: Estimates) -> float:
        """Probability of the scatter of whole turns by noise and the table's return."""
        scatters = list(self._left(self._spins(found)))
        chi2 = sum(float(np.sum(each.left**2 / each.variance)) for each in scatters)
        dof = sum(each.dof for each in scatters)
        return chi2_p_value(dof, chi2) if dof else 1.0

    def _contradiction(self, found: Estimates, spun: Sequence[int]) -> tuple[FloatArray, str]:
        """Scale factors (3,) of whole turns less the others, and that as text; zero where noise explains it.

        The covariance of the difference is that of a part of the data less that of all (Hausman 1978). The
        asymmetries are those of all data: left open without the turns, they would hide the difference.
        """
        offset, options = np.zeros(3), replace(self.options, whole_turns=None)
        known = self.sections, found.trajectories, found.common
        others = Information.of(*known, self.noise, self.site, options)
        sizes = others.sizes.copy()
        sizes[[place for place, each in enumerate(options.columns) if each >= ASYMMETRIES.start]] *= _FIXED
        origin = np.zeros(len(found.values))
        origin[: len(options.columns)] = found.common[options.columns]
        values, others_covariance, is_observed = replace(others, sizes=sizes).solve(origin)
        _, all_covariance, _ = replace(found.information, sizes=sizes).solve(origin)
        axes = [axis for axis in spun if is_observed[GYRO_SCALES[axis]]]
        places = [GYRO_SCALES[axis] for axis in axes]
        if not places:
            return offset, ""
        difference = found.values[places] - values[places]
        covariance = (others_covariance - all_covariance)[np.ix_(places, places)]
        scales = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
        squares, directions = np.linalg.eigh(covariance / np.outer(scales, scales))
        parts = (directions.T @ (difference / scales)) ** 2 / np.maximum(squares, _MIN_EIGENVALUE)
        p_value = chi2_p_value(len(places), float(parts.sum()))
        if p_value >= UNEXPLAINED_P_VALUE:
            return offset, ""
        # All data are a weighted mean of both.
        share = 1.0 - np.diag(all_covariance)[places] / np.diag(others_covariance)[places]
        offset[axes] = difference / np.maximum(share, _MIN_EIGENVALUE)
        apart = ", ".join(f"{AXES[axis]} {1e6 * offset[axis]:+.2g} ppm" for axis in axes)
        return offset, (
            f"whole turns contradict the rotations (p = {p_value:.1g}): scale factors of whole turns less "
            f"those of rotations are {apart}. Their uncertainties include it. Check that the table returns "
            "to where it was, and whether the scale factors depend on the rate"
        )

    def explanation(self, found: Estimates) -> str:
        """What would explain a misfit, or reduce it, as advice."""
        alternatives = [
            (problem, what, _solution(problem))
            for chosen, what in _BESIDE_COEFFICIENTS
            if self.options.are_explained and not all(getattr(self.options, name) for name in chosen)
            for problem in [replace(self, options=replace(self.options, **chosen))]
        ]
        if (settled := self._at_settled_latitude(found)) is not None:
            latitude, other = settled
            what = f"a latitude of {np.rad2deg(latitude.site.latitude):.3f} deg"
            alternatives.insert(0, (latitude, what, other))
        explained = [
            (other.fit.chi2 + 2.0 * len(problem.options.columns), what, other.fit)
            for problem, what, other in alternatives
            if other is not None and _is_explained(other.fit.chi2, found.fit)
        ]
        if explained:
            _, what, fit = min(explained, key=lambda each: each[0])
            falls = f"chi2 falls from {found.fit.chi2:.3g} to {fit.chi2:.3g}"
            what = capitalised(what)
            if fit.p_value >= UNEXPLAINED_P_VALUE:
                return f"{what} would explain it: {falls}"
            return (
                f"{what} would reduce it: {falls}; noise alone gives {fit.dof}. Something else is wrong too"
            )
        others = "; gyrobench calibrate has --lever-arms, --delay, --quadratic, --g-sensitivity, --asymmetry"
        return (
            "Check latitude, gravity, signs and times, and whether the unit drifts, changes its temperature, "
            f"moves at rest or has biases that follow attitude{others * self.options.are_explained}"
        )

    def _at_settled_latitude(self, found: Estimates) -> tuple[CalibrationProblem, Estimates] | None:
        """As :meth:`at_another_latitude`, again from there where it is too far, and its solution.

        None where there is no such latitude, or no solution.
        """
        settled, nearer = None, self.at_another_latitude(found)
        for _ in range(_MAX_ROUNDS):
            if nearer is None:
                break
            if (other := _solution(nearer)) is None:
                return None
            settled = nearer, other
            if other.fit.p_value >= UNEXPLAINED_P_VALUE or other.fit.chi2 > _SETTLED * found.fit.chi2:
                break
            found, nearer = other, nearer.at_another_latitude(other)
        return settled

    def at_another_latitude(self, found: Estimates) -> CalibrationProblem | None:
        """The same problem at the latitude that the data show, if there is one that may explain a misfit."""
        correction, sigma = found.information.latitude_correction()
        latitude = self.site.latitude + correction
        left = found.fit.chi2 - _MAX_CHI2_RATIO * (correction / sigma) ** 2
        is_linear = abs(correction) < _SMALL_ANGLE
        if abs(latitude) >= 0.5 * np.pi or (is_linear and not _is_explained(left, found.fit)):
            return None
        return replace(self, site=replace(self.site, latitude=latitude))

    def check_alternatives(self, found: Estimates) -> None:
        """Raise MeasurementError if a mistake in the map explains what the noise does not."""
        if found.fit.chi2 < _MIN_EXPLICABLE * found.fit.dof:
            return
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
            other = _solution(problem)
            if other is not None and other.fit.chi2 < _EXPLAINED * found.fit.chi2:
                raise MeasurementError(f"chi2 is {found.fit.chi2:.3g}, and {other.fit.chi2:.3g} {text}")


def _solution(problem: CalibrationProblem) -> Estimates | None:
    """The solution of a problem, if there is one."""
    try:
        return problem.solve()
    except MeasurementError:
        return None


def _explaining(problem: CalibrationProblem, found: Estimates) -> Estimates | None:
    """The solution of another problem with the same data, if it explains what ``found`` does not."""
    other = _solution(problem)
    return other if other is not None and _is_explained(other.fit.chi2, found.fit) else None


def _is_explained(chi2: float, fit: Chi2Test) -> bool:
    """Whether another problem whose residuals have this sum of squares explains those of a fit."""
    return chi2_p_value(fit.dof, chi2) >= UNEXPLAINED_P_VALUE or chi2 < _EXPLAINED * fit.chi2


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
