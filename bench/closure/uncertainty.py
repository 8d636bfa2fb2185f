"""Uncertainty of a fitted model: posterior draws of its coefficients, sizes and nonlinear parameters.

Given the nonlinear parameters the model is linear, and its coefficients have a normal distribution. The
nonlinear parameters are drawn by importance sampling within their bounds, since their distribution is neither
normal nor symmetric if chi2 is not quadratic in them or the best value is at a bound.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from statistics import NormalDist

import numpy as np

from gyrobench.bench.closure.campaign import Campaign
from gyrobench.bench.closure.candidates import Candidate, after_fit, owners, stack
from gyrobench.bench.closure.effects.effect import Parameter
from gyrobench.bench.closure.problem import (
    DEGREE,
    MIN_SHARE,
    Problem,
    declared_columns,
    declared_problem,
    with_mean_constants,
)
from gyrobench.bench.foundations.arrays import BoolArray, FloatArray, IntArray

#: Number of draws, of proposed points of the nonlinear parameters, and of those spread over all bounds.
DRAWS, _NODES, _NODES_IN_BOX = 256, 128, 16
#: Prior standard deviation of the logarithm of the ratio of the noise to the stated uncertainties.
_PRIOR_SCALE = 0.3
#: Degrees of freedom of the t distribution that proposes values.
_T_DOF = 4.0
#: Rise of chi2 that measures the width of a parameter's distribution.
_CHI2_RISE = 4.0
_MAX_HALVINGS, _ROUNDS = 40, 3
_PRIOR_STEPS = 6
#: Subsets of terms are drawn for effects with at most this many terms; others have those that the search
#: kept.
_MAX_TERMS = 6
#: A parameter within this share of its range from a bound is at the bound.
_AT_BOUND = 1e-3


@dataclass(frozen=True)
class Draws:
    """N equally probable sets of the parameters of a model."""

    declared: FloatArray  #: Shape (N, 3, DEGREE + runs). As in :class:`~.problem.Solution`.
    run_names: tuple[str, ...]  #: Runs whose constants ``declared`` has.
    sizes_dph: dict[str, FloatArray]  #: By name of the effect, shape (N, 3, k) each.
    #: Distinct sets of the effects with drawn nonlinear parameters; index (N,) of the set of each draw.
    nodes: tuple[tuple[Candidate, ...], ...]
    node: IntArray

    @cached_property
    def values(self) -> dict[str, FloatArray]:
        """Nonlinear parameters by name of the effect, shape (N, p) each."""
        return {
            each[0].effect.name: np.array([each[index].values for index in self.node]).reshape(
                len(self.node), -1
            )
            for each in zip(*self.nodes, strict=True)
        }

    def sigma(self, drawn: FloatArray, stated: FloatArray | float) -> FloatArray:
        """Standard uncertainty of a stated value, from its value in each draw (N, ...)."""
        return np.asarray(np.sqrt(np.mean((drawn - stated) ** 2, axis=0)))

    def bias_dph(self, campaign: Campaign, effects: Collection[str] | None = None) -> FloatArray:
        """Bias of each draw in the dwells of a campaign (N, n, 3).

        ``effects``: names of the effects included, by default all. A power cycle that was not fitted gets the
        mean constant of those fitted, without its scatter.
        """
        declared_terms = np.stack([declared_columns(campaign, gyro) for gyro in range(3)], axis=1)
        unfitted = np.full((*self.declared.shape[:2], 1), np.nan)
        declared = np.concatenate([self.declared, unfitted], axis=2)
        column_of_run = {name: DEGREE + index for index, name in enumerate(self.run_names)}
        columns = [*range(DEGREE), *(column_of_run.get(name, -1) for name in campaign.run_names)]
        bias_dph = _apply_coefficients(declared_terms, with_mean_constants(declared)[..., columns])
        for name in self.sizes_dph.keys() if effects is None else effects:
            bias_dph += self.effect_dph(campaign, name)
        return bias_dph

    def effect_dph(self, campaign: Campaign, name: str) -> FloatArray:
        """Contribution of one effect to :meth:`bias_dph` (N, n, 3)."""
        contribution_dph = np.empty((len(self.node), len(campaign), 3))
        for index, candidates in enumerate(self.nodes):
            [candidate] = [each for each in candidates if each.effect.name == name]
            has_node = self.node == index
            contribution_dph[has_node] = _apply_coefficients(
                candidate.columns(campaign), self.sizes_dph[name][has_node]
            )
        return contribution_dph


def _apply_coefficients(columns: FloatArray, drawn: FloatArray) -> FloatArray:
    """Bias (N, n, 3) of columns (n, 3, k) with the coefficients drawn (N, 3, k)."""
    return np.asarray(np.matmul(drawn.swapaxes(0, 1), columns.transpose(1, 2, 0)).transpose(1, 2, 0))


def draw(problem: Problem, candidates: Sequence[Candidate]) -> Draws:
    """Draw the parameters of the declared model with effects.

    ``problem`` has the declared model alone; the nonlinear parameters of the candidates are fitted.
    """
    problem = _with_noise_of_residuals(problem, candidates)
    at_best = _normal_equations(problem, candidates)
    priors = _estimate_priors(at_best, candidates)
    nodes, node = _nodes(problem, candidates, priors)
    equations = [_normal_equations(problem, each) for each in nodes] if len(nodes) > 1 else [at_best]
    random = np.random.default_rng(0)
    declared = np.full((DRAWS, 3, DEGREE + len(problem.campaign.run_names)), np.nan)
    sizes = {each.effect.name: np.zeros((DRAWS, *each.kept.shape)) for each in candidates}
    ends = np.cumsum([each.kept.shape[1] for each in candidates])
    for gyro in range(3):
        is_used = at_best[gyro].is_used
        used_terms = _used_terms(at_best[gyro], candidates, gyro, priors, random)
        normal = _standard_normal(random, is_used.sum() + used_terms.shape[1])
        coefficients = np.array(
            [
                equations[index][gyro].draw_coefficients(terms_of_draw, priors, each)
                for index, terms_of_draw, each in zip(node, used_terms, normal, strict=True)
            ]
        )
        declared[:, gyro, is_used], terms = np.split(coefficients, [is_used.sum()], axis=1)
        for size, gyro_sizes in zip(sizes.values(), np.split(terms, ends[:-1], axis=1), strict=False):
            size[:, gyro] = gyro_sizes
    return Draws(declared, problem.campaign.run_names, sizes, nodes, node)


def _with_noise_of_residuals(problem: Problem, candidates: Sequence[Candidate]) -> Problem:
    """Problem with the noise of its residuals, combined with the prior of the stated uncertainties."""
    after = after_fit(problem, candidates)
    dof = max(after.dof - sum(len(each.values) for each in candidates), 1)
    ratio = max(after.chi2 / dof, 1e-12) ** (0.5 / (1.0 + 0.5 / dof / _PRIOR_SCALE**2))
    noise_scale = problem.noise_scale * ratio
    return declared_problem(problem.campaign, problem.searched, noise_scale, problem.correlation_factor)


class _NormalEquations:
    """Normal equations of one gyro's coefficients, given the nonlinear parameters, with unit columns."""

    def __init__(self, problem: Problem, candidates: Sequence[Candidate], gyro: int) -> None:
        campaign, searched = problem.campaign, problem.searched
        base = declared_columns(campaign, gyro)[searched]
        self.is_used: BoolArray = np.any(base != 0.0, axis=0)  #: Columns of the declared model in use.
        terms = [each.columns(campaign)[searched, gyro] for each in candidates]
        columns = problem.whitened_of(gyro, np.concatenate([base[:, self.is_used], *terms], axis=1))
        lengths = np.linalg.norm(columns, axis=0)
        # Coefficients that no measured value depends on stay zero.
        self._lengths = np.where(lengths > 0.0, lengths, np.inf)
        columns /= self._lengths
        self._matrix = columns.T @ columns
        data = problem.whitened_of(gyro, campaign.bias_dph[searched, gyro, np.newaxis])[:, 0]
        self._vector = columns.T @ data
        self._roots: dict[bytes, tuple[FloatArray, float]] = {}

    def root(self, used: BoolArray, priors: FloatArray) -> tuple[FloatArray, float]:
        """Symmetric square root of the covariance (q, q), zero for terms not used; its log determinant."""
        key = used.tobytes() + priors.tobytes()
        if key not in self._roots:
            chosen = np.flatnonzero(np.concatenate([np.ones(self.is_used.sum(), dtype=bool), used]))
            diagonal = np.concatenate([np.zeros(self.is_used.sum()), priors**2])
            lengths, directions = np.linalg.eigh((self._matrix + np.diag(diagonal))[np.ix_(chosen, chosen)])
            is_determined = lengths > MIN_SHARE**2
            root = np.zeros_like(self._matrix)
            root[np.ix_(chosen, chosen)] = (
                directions[:, is_determined]
                / np.sqrt(lengths[is_determined])
                @ directions[:, is_determined].T
            )
            self._roots[key] = root, -float(np.sum(np.log(lengths[is_determined])))
        return self._roots[key]

    def draw_coefficients(self, used: BoolArray, priors: FloatArray, normal: FloatArray) -> FloatArray:
        """Draw of the coefficients from standard normal numbers (q,)."""
        root, _ = self.root(used, priors)
        return np.asarray(root @ (root @ self._vector + normal) / self._lengths)

    def expected_squares(self, used: BoolArray, priors: FloatArray) -> FloatArray:
        """Expected squared lengths of the terms, in standard deviations."""
        root, _ = self.root(used, priors)
        return np.asarray((root @ (root @ self._vector)) ** 2 + np.sum(root**2, axis=1))[self.is_used.sum() :]

    def log_evidence(self, used: BoolArray, priors: FloatArray) -> float:
        """Logarithm of the probability of the data with the terms used, up to a constant."""
        root, log_determinant = self.root(used, priors)
        return 0.5 * (float(np.sum((root @ self._vector) ** 2)) + log_determinant) + float(
            np.sum(np.log(priors[used]))
        )


def _normal_equations(problem: Problem, candidates: Sequence[Candidate]) -> list[_NormalEquations]:
    return [_NormalEquations(problem, candidates, gyro) for gyro in range(3)]


def _estimate_priors(equations: Sequence[_NormalEquations], candidates: Sequence[Candidate]) -> FloatArray:
    """Inverse standard deviations (k,) of a normal prior of the terms' lengths, equal for one effect's terms.

    They maximize the probability of the data (empirical Bayes): the prior shrinks the sizes of an effect that
    was selected because noise made it larger, and keeps sizes finite that the data do not determine.
    """
    kept = np.concatenate([np.zeros((3, 0), dtype=bool), *(each.kept for each in candidates)], axis=1)
    owner = owners(candidates)
    priors = np.zeros(kept.shape[1])
    for _ in range(_PRIOR_STEPS if candidates else 0):
        squares = np.stack([each.expected_squares(kept[gyro], priors) for gyro, each in enumerate(equations)])
        means = [squares[:, owner == index][each.kept].mean() for index, each in enumerate(candidates)]
        priors = np.array(means)[owner] ** -0.5
    return priors


def _used_terms(
    equations: _NormalEquations,
    candidates: Sequence[Candidate],
    gyro: int,
    priors: FloatArray,
    random: np.random.Generator,
) -> BoolArray:
    """Terms of one gyro in each draw (DRAWS, k), with the probability that the effect has them.

    A term that the search dropped need not be zero.
    """
    kept = [each.kept[gyro] for each in candidates]
    used = []
    for index, own_kept in enumerate(kept):
        subsets = [own_kept]
        if 1 < len(own_kept) <= _MAX_TERMS:
            subsets = [
                np.array(each) for each in itertools.product([False, True], repeat=len(own_kept)) if any(each)
            ]
        log_evidence = np.array(
            [
                equations.log_evidence(np.concatenate([*kept[:index], each, *kept[index + 1 :]]), priors)
                for each in subsets
            ]
        )
        probability = np.exp(log_evidence - log_evidence.max())
        chosen = random.choice(len(subsets), DRAWS, p=probability / probability.sum())
        used.append(np.array(subsets)[chosen])
    return np.concatenate([np.zeros((DRAWS, 0), dtype=bool), *used], axis=1)


def _nodes(
    problem: Problem, candidates: Sequence[Candidate], priors: FloatArray
) -> tuple[tuple[tuple[Candidate, ...], ...], IntArray]:
    """Distinct effects with drawn nonlinear parameters, and the index of each draw among them (DRAWS,)."""
    density = _ParameterDensity(problem, candidates, priors)
    if not len(density.best):
        return (tuple(candidates),), np.zeros(DRAWS, dtype=np.intp)
    centre, root = density.best, np.diag(density.widths())
    for _ in range(_ROUNDS):
        points, log_proposal = _propose_points(centre, root, density.low, density.high)
        log_weights = np.array(list(map(density.log_density, points))) - log_proposal
        weights = np.exp(log_weights - log_weights.max())
        weights /= weights.sum()
        centre = weights @ points
        covariance = (points - centre).T @ ((points - centre) * weights[:, np.newaxis])
        root = np.linalg.cholesky(covariance + 1e-9 * np.diag(density.widths() ** 2))
    chosen = np.searchsorted(np.cumsum(weights), (np.arange(DRAWS) + 0.5) / DRAWS).clip(max=len(points) - 1)
    used_points, node = np.unique(chosen, return_inverse=True)
    return tuple(map(density.candidates_at, points[used_points])), node


class _ParameterDensity:
    """Posterior density of the nonlinear parameters of some effects, with a uniform prior in a box."""

    def __init__(self, problem: Problem, candidates: Sequence[Candidate], priors: FloatArray) -> None:
        self._problem, self._candidates = problem, candidates
        self._priors = priors
        campaign = problem.campaign
        parameters = [parameter for each in candidates for parameter in each.form.parameters]
        self._is_log = np.array([each.is_scale for each in parameters], dtype=bool)
        span_s = float(campaign.start_s.min()), float(campaign.end_s.max())
        bounds = [(each.low, each.high) if np.isfinite(each.low) else span_s for each in parameters]
        self.low, self.high = _to_uniform_scale(
            np.array(bounds, dtype=np.float64).reshape(-1, 2).T, self._is_log
        )
        self.best = _to_uniform_scale(
            np.array([value for each in candidates for value in each.values]), self._is_log
        )

    def candidates_at(self, point: FloatArray) -> tuple[Candidate, ...]:
        """The effects with their parameters at a point."""
        values = iter(np.where(self._is_log, np.exp(np.where(self._is_log, point, 0.0)), point).tolist())
        return tuple(
            replace(each, values=tuple(itertools.islice(values, len(each.values))))
            for each in self._candidates
        )

    def log_density(self, point: FloatArray) -> float:
        """Logarithm of the probability density, with the coefficients of the terms integrated out."""
        if np.any(point < self.low) or np.any(point > self.high):
            return -np.inf
        columns, kept = stack(self.candidates_at(point), self._problem.campaign)
        terms = self._problem.independent_parts(columns, kept)
        used = kept & np.any(columns[self._problem.searched] != 0.0, axis=0)
        squares = np.where(used, self._priors**2, 1.0)  # no contribution of unused terms
        root = np.linalg.cholesky(terms.mT @ terms + squares[..., np.newaxis] * np.eye(len(self._priors)))
        projections = np.linalg.solve(root, terms.mT @ self._problem.residuals.T[..., np.newaxis])
        log_evidence = 0.5 * np.sum(projections**2) - np.sum(np.log(np.diagonal(root, axis1=1, axis2=2)))
        return float(log_evidence) / self._problem.correlation_factor

    def widths(self) -> FloatArray:
        """Standard deviation of each parameter, with the others at their best values."""
        return np.array(
            [max(self._width(index, side) for side in (-1.0, 1.0)) for index in range(len(self.best))]
        )

    def _width(self, index: int, side: float) -> float:
        """Standard deviation of one parameter, from the rise of chi2 on one side."""
        at_best, step = self.log_density(self.best), side * np.eye(len(self.best))[index]
        step *= (self.high - self.best if side > 0.0 else self.best - self.low)[index]
        for _ in range(_MAX_HALVINGS):
            rise = 2.0 * (at_best - self.log_density(self.best + step))
            if rise < _CHI2_RISE:
                break
            step *= 0.5
        return float(np.abs(step[index]) / np.sqrt(max(rise, 0.5)))


def _propose_points(
    centre: FloatArray, root: FloatArray, low: FloatArray, high: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Points that sample a t distribution evenly, some of them the box instead, and their log density."""
    count = len(centre)
    # Additive recurrence by the generalized golden ratio; the last coordinate is the scale of the t.
    golden = 2.0
    for _ in range(30):
        golden = (1.0 + golden) ** (1.0 / (count + 2.0))
    uniform = (0.5 + np.outer(np.arange(1, _NODES + 1), golden ** -np.arange(1.0, count + 2.0))) % 1.0
    scale = np.sqrt(_T_DOF / np.maximum(_chi2_quantile_4_dof(uniform[:, -1:]), 1e-12))
    normal = np.vectorize(NormalDist().inv_cdf)(uniform[:, :-1])
    points = centre + normal * scale @ root.T
    points[:: _NODES // _NODES_IN_BOX] = low + uniform[:_NODES_IN_BOX, :-1] * (high - low)
    squares = np.sum(np.linalg.solve(root, (points - centre).T) ** 2, axis=0)
    log_t = (
        math.lgamma(0.5 * (_T_DOF + count))
        - math.lgamma(0.5 * _T_DOF)
        - 0.5 * count * np.log(np.pi * _T_DOF)
        - np.log(np.diag(root)).sum()
        - 0.5 * (_T_DOF + count) * np.log1p(squares / _T_DOF)
    )
    share = _NODES_IN_BOX / _NODES
    log_box = -np.log(high - low).sum()
    return points, np.logaddexp(np.log1p(-share) + log_t, np.log(share) + log_box)


def _chi2_quantile_4_dof(probability: FloatArray) -> FloatArray:
    """Inverse survival function of chi2 with 4 degrees of freedom: p = ``exp(-h) (1 + h)``, h = chi2 / 2."""
    target = -np.log(probability)
    half = target + np.sqrt(2.0 * target)  # at least the root, so that Newton's method descends
    for _ in range(6):
        half = half - (half - np.log1p(half) - target) * (1.0 + half) / half
    return 2.0 * half


def _standard_normal(random: np.random.Generator, count: int) -> FloatArray:
    """Standard normal numbers (DRAWS, count); if count is small, with sample mean 0 and covariance 1."""
    normal = random.standard_normal((DRAWS, count))
    if 2 * count < DRAWS:
        normal -= normal.mean(axis=0)
        normal = np.linalg.solve(np.linalg.cholesky(normal.T @ normal / DRAWS), normal.T).T
    return normal


def interval(parameter: Parameter, value: float, drawn: FloatArray) -> tuple[float, float]:
    """95 % interval of a nonlinear parameter from its draws (N,).

    One-sided if the value is at a bound.
    """
    match bound_of(parameter, value):
        case "lower":
            return parameter.low, float(np.quantile(drawn, 0.95))
        case "upper":
            return float(np.quantile(drawn, 0.05)), parameter.high
    low, high = np.quantile(drawn, [0.025, 0.975]).tolist()
    return low, high


def bound_of(parameter: Parameter, value: float) -> str:
    """Name of the bound at which a parameter is, "lower" or "upper"; empty within the range."""
    if not np.isfinite(parameter.low):
        return ""
    low, value, high = _to_uniform_scale(np.array([parameter.low, value, parameter.high]), parameter.is_scale)
    step = _AT_BOUND * (high - low)
    return "lower" if value <= low + step else "upper" if value >= high - step else ""


def _to_uniform_scale(values: FloatArray, is_log: BoolArray | bool) -> FloatArray:
    """Values in the variable with a uniform prior: the logarithm if ``is_log``."""
    return np.where(is_log, np.log(np.where(is_log, values, 1.0)), values)
