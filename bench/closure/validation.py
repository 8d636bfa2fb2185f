"""Lack-of-fit tests of a model's residuals, and cross-validation by cycles.

The sum of squares is tested against the stated uncertainties. F-tests for structure compare the variance
that a set of columns explains with the remaining variance (the repeat error). All tests are made within power
cycles: the model has a constant for each.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import NamedTuple

import numpy as np

from gyrobench.bench.bias.statistics import chi2_p_value, f_p_value
from gyrobench.bench.closure.campaign import Campaign
from gyrobench.bench.closure.candidates import Candidate, solve_with
from gyrobench.bench.closure.effects.effect import same_for_all_gyros
from gyrobench.bench.closure.problem import SCALE_C, Problem, Solution, declared_problem
from gyrobench.bench.foundations.arrays import BoolArray, FloatArray, b_splines

#: A lack of fit is significant below this p-value.
LACK_OF_FIT_P = 1e-3
_DWELLS_A_TIME_KNOT = 6
_MAX_TIME_KNOTS = 40
_TEMPERATURE_KNOT_C = 4.0
_MAX_TEMPERATURE_KNOTS = 24
_PREVIOUS_DWELL = "the previous dwell"
#: Fewest degrees of freedom of a correlation, and the largest one.
_MIN_CORRELATION_DOF, _MAX_CORRELATION = 6, 0.9999


@dataclass(frozen=True)
class LackOfFit:
    """Outcome of the tests."""

    p_noise: float  #: p-value of chi2, given the stated uncertainties.
    p_structure: dict[str, float]  #: p-value of each test for structure, by the quantity tested.
    noise_ratio: float  #: Square root of chi2 over the degrees of freedom; NaN without any.
    #: The two gyros whose residuals correlate most, and the correlation; None if not significant.
    correlated: tuple[int, int, float] | None = None

    @property
    def p_value(self) -> float:
        """Smallest p-value, corrected for the number of tests."""
        return min(1.0, min(self.p_noise, *self.p_structure.values()) * (1 + len(self.p_structure)))

    @property
    def is_significant(self) -> bool:
        """Whether the model lacks something."""
        return self.p_value < LACK_OF_FIT_P

    @property
    def p_any_structure(self) -> float:
        """Smallest p-value of the tests for structure, corrected for their number."""
        return min(1.0, min(self.p_structure.values()) * len(self.p_structure))

    @property
    def follows(self) -> str:
        """The quantity that the residuals follow most significantly."""
        return min(self.p_structure, key=lambda name: self.p_structure[name])


def lack_of_fit(problem: Problem, parameters: int) -> LackOfFit:
    """Test the residuals of a problem.

    ``problem`` has the declared model and the terms of all effects as columns; ``parameters`` is the
    number of nonlinear parameters of the effects. Without degrees of freedom all p-values are 1.
    """
    dof, factor = problem.dof - parameters, problem.correlation_factor
    if dof <= 0:
        return LackOfFit(1.0, {_PREVIOUS_DWELL: 1.0}, np.nan)
    # Knots and levels are chosen from the dwells searched.
    campaign = problem.campaign.part(problem.searched)
    structure = {}
    for name, columns in _STRUCTURES.items():
        reduction, rank = problem.chi2_reduction(_in_all_dwells(columns(campaign), problem))
        if rank and dof > rank:
            ratio = (reduction / rank) / max(
                (problem.chi2 - reduction) / (dof - rank), problem.min_residual_variance
            )
            structure[name] = f_p_value(rank / factor, (dof - rank) / factor, ratio)
    structure[_PREVIOUS_DWELL] = _serial_correlation(problem)
    return LackOfFit(
        p_noise=chi2_p_value(max(round(dof / factor), 1), problem.chi2 / factor),
        p_structure=structure,
        noise_ratio=float(np.sqrt(problem.chi2 / dof)),
        correlated=gyro_correlation(problem).strongest,
    )


class GyroCorrelation(NamedTuple):
    """Correlation of the residuals of the three gyros."""

    strongest: tuple[int, int, float] | None = None  #: See :attr:`LackOfFit.correlated`.
    #: Number of residuals that count as one in a sum of squares of all gyros, 1 if these do not correlate:
    #: with correlations ``R``, the sum has ``tr R R / 3`` times the variance (Satterthwaite).
    factor: float = 1.0


def gyro_correlation(problem: Problem) -> GyroCorrelation:
    """Correlation of the residuals of a problem, if it is significant by Fisher's transformation."""
    is_complete = problem.campaign.is_measured[problem.searched].all(axis=1)
    products = problem.residuals[is_complete].T @ problem.residuals[is_complete]
    lengths = np.sqrt(np.maximum(np.diag(products), problem.min_residual_variance))
    correlations = products / np.outer(lengths, lengths)
    dof = int(is_complete.sum()) - max(basis.shape[1] for basis in problem.bases)
    if dof < _MIN_CORRELATION_DOF:
        return GyroCorrelation()
    first, second = max(combinations(range(3), 2), key=lambda pair: abs(correlations[pair]))
    value = float(np.clip(correlations[first, second], -_MAX_CORRELATION, _MAX_CORRELATION))
    p_value = 3.0 * math.erfc(abs(math.atanh(value)) * math.sqrt((dof - 2) / 2.0))
    if p_value >= LACK_OF_FIT_P:
        return GyroCorrelation()
    factor = max(1.0, float(np.sum(correlations**2)) / 3.0 - 2.0 / dof)
    return GyroCorrelation((first, second, value), factor)


def _spline(values: FloatArray, knots: int) -> FloatArray:
    """Cubic B-splines (n, knots + 2) over the range of values."""
    low, high = float(values.min()), float(values.max())
    inner = np.linspace(low, high if high > low else low + 1.0, knots)
    all_knots = np.concatenate([[inner[0]] * 3, inner, [inner[-1]] * 3])
    return b_splines(values, all_knots, 3)


def _time(campaign: Campaign) -> FloatArray:
    knots = min(max(len(campaign) // _DWELLS_A_TIME_KNOT, 4), _MAX_TIME_KNOTS)
    return same_for_all_gyros(_spline(campaign.middle_s, knots))


def _temperature(campaign: Campaign) -> FloatArray:
    span_c = float(np.ptp(campaign.gyro_c))
    knots = min(max(round(span_c / _TEMPERATURE_KNOT_C), 4), _MAX_TEMPERATURE_KNOTS)
    return np.stack([_spline(each, knots) for each in campaign.gyro_c.T], axis=1)


def _positions(campaign: Campaign) -> FloatArray:
    names = sorted(set(campaign.position))
    flags = np.array([[name == each for name in names] for each in campaign.position], dtype=np.float64)
    scaled = campaign.gyro_c[:, :, None] / SCALE_C
    return np.concatenate([same_for_all_gyros(flags), flags[:, None, :] * scaled], axis=2)


def _rate(campaign: Campaign) -> FloatArray:
    rate = campaign.rate_c_per_h[:, :, None] / 10.0
    return np.concatenate([rate, np.abs(rate), rate * campaign.gyro_c[:, :, None] / SCALE_C], axis=2)


def _in_all_dwells(columns: FloatArray, problem: Problem) -> FloatArray:
    """Columns of the dwells searched (m, 3, k) as columns of all dwells (n, 3, k), zero in the others."""
    padded = np.zeros((len(problem.campaign), *columns.shape[1:]))
    padded[problem.searched] = columns
    return padded


def _serial_correlation(problem: Problem) -> float:
    """p-value of the correlation of consecutive residuals, two-sided.

    A fit makes neighbours slightly anticorrelated: residuals have the covariance ``1 - Q Q'``.
    """
    products = np.sum(problem.residuals[1:] * problem.residuals[:-1])
    expected = -sum(float(np.sum(basis[1:] * basis[:-1])) for basis in problem.bases)
    scale = max(problem.chi2 / problem.dof, problem.min_residual_variance)
    spread = scale * np.sqrt(
        problem.correlation_factor * problem.campaign.is_measured[problem.searched].sum()
    )
    return math.erfc(abs(products - scale * expected) / max(math.sqrt(2.0) * spread, 1e-300))


_STRUCTURES: dict[str, Callable[[Campaign], FloatArray]] = {
    "time": _time,
    "temperature": _temperature,
    "position": _positions,
    "temperature rate": _rate,
}


#: The other cycles determine a term's size if its length in them is at least this share of that in the cycle
#: left out.
_MIN_LENGTH = 0.1


def leave_out_cycles(
    problem: Problem, fewer: Sequence[Candidate], more: Sequence[Candidate]
) -> dict[int, float]:
    """Gain by cycle: share of its chi2 that more effects explain, with sizes fitted to the other cycles.

    1 is all; negative if chi2 is larger than with fewer effects. A cycle is omitted if the others do not
    determine the sizes, as of a warm-up without a power-on in them. ``problem`` has the declared model alone.
    """
    campaign = problem.campaign
    result = {}
    cycles, noise_dph = np.unique(campaign.cycle[problem.searched]), campaign.sigma_dph * problem.noise_scale
    for cycle in cycles if len(cycles) > 1 else ():
        left_out = problem.searched & (campaign.cycle == cycle)
        rest = declared_problem(campaign, problem.searched & ~left_out, problem.noise_scale)
        if all(_is_determined(rest, each, left_out) for each in more):
            errors = (
                measured_minus_model(campaign, rest.searched, solve_with(rest, each))
                for each in (fewer, more)
            )
            chi2_fewer, chi2_more = (
                float(np.nansum((each[left_out] / noise_dph[left_out]) ** 2)) for each in errors
            )
            result[int(cycle)] = 1.0 - chi2_more / chi2_fewer
    return result


def measured_minus_model(campaign: Campaign, searched: BoolArray, model: Solution) -> FloatArray:
    """Measured minus modelled bias in all dwells (n, 3), deg/h.

    NaN where nothing was measured. The mean of each power cycle that was not searched is removed.
    """
    errors_dph = np.where(campaign.is_measured, campaign.bias_dph - model.bias_dph, np.nan)
    for run in np.unique(campaign.run[~searched]):
        if not np.any(campaign.run[searched] == run):
            in_run = campaign.run == run
            is_measured = ~np.isnan(errors_dph[in_run])
            sums = np.where(is_measured, errors_dph[in_run], 0.0).sum(axis=0)
            errors_dph[in_run] -= sums / np.maximum(is_measured.sum(axis=0), 1)
    return errors_dph


def _is_determined(rest: Problem, candidate: Candidate, left_out: BoolArray) -> bool:
    """Whether the other cycles (``rest``) determine the sizes of the terms for the cycle left out."""
    campaign = rest.campaign
    columns = candidate.columns(campaign)
    varying = columns - _absorbed_by_constants(campaign, columns, rest.searched, left_out)
    weighted = (varying / (campaign.sigma_dph * rest.noise_scale)[:, :, np.newaxis])[left_out]
    lengths = [np.linalg.norm(weighted[:, gyro, candidate.kept[gyro]], axis=0) for gyro in range(3)]
    in_rest = rest.independent_lengths(columns, candidate.kept)
    return bool(np.all(in_rest >= _MIN_LENGTH * np.concatenate(lengths)))


def _absorbed_by_constants(
    campaign: Campaign, columns: FloatArray, rest: BoolArray, left_out: BoolArray
) -> FloatArray:
    """Part of the terms (n, 3, k) that the constant of each power cycle absorbs: their mean over its dwells.

    Over those in the rest, or in the cycle left out if the rest has none.
    """
    constants = np.zeros_like(columns)
    for run in np.unique(campaign.run):
        in_run = campaign.run == run
        fitted = in_run & rest if np.any(in_run & rest) else in_run & left_out
        if fitted.any():
            constants[in_run] = columns[fitted].mean(axis=0)
    return constants
