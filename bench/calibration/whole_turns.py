"""Tests whether whole turns against the table contradict the rotations, or one another."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from gyrobench.bench.bias.statistics import chi2_p_value
from gyrobench.bench.calibration.information import IS_GYRO_SCALE
from gyrobench.bench.calibration.problem import UNEXPLAINED_P_VALUE, CalibrationProblem, Estimates
from gyrobench.bench.calibration.strapdown import ASYMMETRIES
from gyrobench.bench.foundations.arrays import FloatArray
from gyrobench.bench.navigation.positions import AXES

#: Indices of the gyro scale factors among the coefficients.
GYRO_SCALES = np.flatnonzero(IS_GYRO_SCALE)
#: Smallest eigenvalue of a correlation matrix, above rounding.
_MIN_EIGENVALUE = 1e-9
#: Prior of a parameter that is held fixed, relative to its usual size.
_FIXED_SIZE = 1e-6


def check_turns(
    problem: CalibrationProblem, estimates: Estimates, spun_axes: Sequence[int]
) -> tuple[CalibrationProblem, Estimates, FloatArray, str]:
    """Problem and solution with the uncertainty of whole turns as estimated from their residuals.

    Also returns standard uncertainties (3,) of the scale factors by contradictions, zero without any, and a
    finding about them. The residuals at rest do not reveal a scale factor that depends on the rate. But it
    makes turns at several rates scatter, and turns at one rate contradict the rotations, as does a table that
    does not return to its start. ``spun_axes``: axes of the gyros that were spun.
    """
    offset, text = _contradiction(problem, estimates, spun_axes)
    is_explained = estimates.fit.p_value >= UNEXPLAINED_P_VALUE
    scatter_p_value = _scatter_p_value(list(_turn_scatters(problem, estimates)))
    if not text and is_explained and scatter_p_value >= UNEXPLAINED_P_VALUE:
        return problem, estimates, offset, ""
    without_turns = problem.with_options(whole_turns=None).solve()
    scatters = list(_turn_scatters(problem, without_turns))
    if not scatters or not (text or without_turns.fit.p_value >= UNEXPLAINED_P_VALUE):
        return problem, estimates, offset, ""
    residuals = np.concatenate([each.residuals_rad + each.path * offset[each.axis] for each in scatters])
    turns = float(np.hypot(problem.options.whole_turns or 0.0, np.sqrt(np.mean(np.square(residuals)))))
    widened = problem.with_options(whole_turns=turns)
    if not text and scatter_p_value < UNEXPLAINED_P_VALUE:
        for each in scatters:
            offset[each.axis] = np.sqrt(np.mean((each.residuals_rad / each.path) ** 2))
        text = _scatter_finding(scatters, scatter_p_value)
    return widened, widened.solve(), offset, text


@dataclass(frozen=True, eq=False)
class _TurnScatter:
    """Residuals of the spins of one gyro about its scale factor."""

    axis: int
    path: FloatArray  #: Shape (n,). Angles travelled, rad, with their signs.
    rate: FloatArray  #: Shape (n,). Magnitudes, rad/s.
    residuals_rad: FloatArray  #: Shape (n,).
    variance: FloatArray  #: Shape (n,). Of each residual, due to noise and the table's return, rad^2.
    dof: int

    @property
    def chi2(self) -> float:
        """Sum of squared residuals in units of their variances."""
        return float(np.sum(self.residuals_rad**2 / self.variance))


def _turn_scatters(problem: CalibrationProblem, estimates: Estimates) -> Iterator[_TurnScatter]:
    """Residuals of the spins of each gyro about a scale factor and an asymmetry."""
    pairs = zip(problem.sections, estimates.starts, strict=True)
    spins = [
        spin for each, start in pairs for spin in each.spin_errors(start, estimates.common, problem.site)
    ]
    for axis in sorted({spin.axis for spin in spins}):
        error, path, rate, duration_s = np.array(
            [(each.error, each.path, abs(each.rate), each.duration_s) for each in spins if each.axis == axis]
        ).T
        design = path[:, np.newaxis]
        if axis in (problem.options.asymmetries or ()):
            design = np.column_stack([path, np.abs(path)])
        variance = (
            (problem.options.whole_turns or 0.0) ** 2
            + 2.0 * problem.noise.white_angle[axis] ** 2
            + problem.noise.angle_random_walk[axis] ** 2 * duration_s
        )
        residuals = error - design @ np.linalg.lstsq(design, error)[0]
        yield _TurnScatter(axis, path, rate, residuals, variance, max(0, len(path) - design.shape[1]))


def _scatter_p_value(scatters: Sequence[_TurnScatter]) -> float:
    """P-value of the scatter of whole turns, given noise and the table's return."""
    dof = sum(each.dof for each in scatters)
    return chi2_p_value(dof, sum(each.chi2 for each in scatters)) if dof else 1.0


def _scatter_finding(scatters: Sequence[_TurnScatter], p_value: float) -> str:
    """Finding that whole turns contradict one another, with the gyro whose turns scatter most."""
    largest = max(scatters, key=lambda each: each.chi2)
    rates = np.round(np.rad2deg(largest.rate), 1)
    deviations_ppm = 1e6 * largest.residuals_rad / largest.path
    deviation_texts = [
        f"{deviations_ppm[rates == rate].mean():+.2g} ppm at {rate:.3g} deg/s" for rate in np.unique(rates)
    ]
    return (
        f"whole turns contradict one another (p = {p_value:.1g}): the scale factor of the "
        f"{AXES[largest.axis]} gyro deviates from its mean by {', '.join(deviation_texts)}. The "
        "uncertainties include it. Check whether the scale factors depend on the rate, and that the table "
        "returns to where it was"
    )


def _contradiction(
    problem: CalibrationProblem, estimates: Estimates, spun_axes: Sequence[int]
) -> tuple[FloatArray, str]:
    """Scale factors (3,) of whole turns minus the others, zero if noise explains it; and a finding.

    The covariance of the difference is that of a part of the data minus that of all (Hausman 1978). The
    asymmetries are fixed at their estimates from all data: if they were free without the turns, they
    would hide the difference.
    """
    offset, options = np.zeros(3), problem.options
    without_turns = problem.with_options(whole_turns=None)
    others_information = without_turns.information(estimates.trajectories, estimates.common)
    sizes = others_information.sizes.copy()
    sizes[[index for index, each in enumerate(options.columns) if each >= ASYMMETRIES.start]] *= _FIXED_SIZE
    origin = np.zeros(len(estimates.values))
    origin[: len(options.columns)] = estimates.common[options.columns]
    values, others_covariance, is_observed = replace(others_information, sizes=sizes).solve(origin)
    _, all_covariance, _ = replace(estimates.information, sizes=sizes).solve(origin)
    axes = [axis for axis in spun_axes if is_observed[GYRO_SCALES[axis]]]
    indices = [GYRO_SCALES[axis] for axis in axes]
    if not indices:
        return offset, ""
    difference = estimates.values[indices] - values[indices]
    covariance = (others_covariance - all_covariance)[np.ix_(indices, indices)]
    scales = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    squares, directions = np.linalg.eigh(covariance / np.outer(scales, scales))
    terms = (directions.T @ (difference / scales)) ** 2 / np.maximum(squares, _MIN_EIGENVALUE)
    p_value = chi2_p_value(len(indices), float(terms.sum()))
    if p_value >= UNEXPLAINED_P_VALUE:
        return offset, ""
    # The estimate from all data is a weighted mean of both.
    share = 1.0 - np.diag(all_covariance)[indices] / np.diag(others_covariance)[indices]
    offset[axes] = difference / np.maximum(share, _MIN_EIGENVALUE)
    differences_text = ", ".join(f"{AXES[axis]} {1e6 * offset[axis]:+.2g} ppm" for axis in axes)
    return offset, (
        f"whole turns contradict the rotations (p = {p_value:.1g}): scale factors of whole turns less "
        f"those of rotations are {differences_text}. Their uncertainties include it. Check that the "
        "table returns to where it was, and whether the scale factors depend on the rate"
    )
