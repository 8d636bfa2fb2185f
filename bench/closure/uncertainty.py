"""Uncertainty of a fitted model: draws of its coefficients, sizes and nonlinear parameters, given the data.

Given the nonlinear parameters the model is linear, and its coefficients have a normal distribution. The
nonlinear parameters are drawn by importance sampling within their bounds: where chi2 is not quadratic in
them, or the best value is at a bound, their distribution is neither normal nor symmetric.
"""

from __future__ import annotations

import itertools
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.special import chdtri, ndtri

from gyrobench.bench.closure.campaign import Campaign
from gyrobench.bench.closure.candidates import Candidate
from gyrobench.bench.closure.effects.effect import Parameter
from gyrobench.bench.closure.problem import DEGREE, Problem, declared_columns, with_mean_constants
from gyrobench.bench.foundations.arrays import BoolArray, FloatArray, IntArray

#: Draws, and values of the nonlinear parameters among them: so many for each parameter, at most all.
DRAWS, _NODES = 256, 64
#: Prior standard deviation of the ratio of the noise to the stated uncertainties.
_PRIOR_SCALE = 0.1
#: Parameters whose bounds differ by this factor are drawn on a logarithmic scale.
_DECADE = 10.0
#: Degrees of freedom of the t distribution that proposes values.
_TAILS = 4.0
#: Rise of chi2 that measures the width of a parameter's distribution.
_RISE = 4.0
_MAX_HALVINGS, _ROUNDS = 14, 3
#: Directions that keep less than this share of a column's length are not determined.
_MIN_SHARE = 1e-5
#: A parameter within this share of its range from a bound is at the bound.
_AT_BOUND = 1e-3


@dataclass(frozen=True)
class Draws:
    """N draws of the parameters of a model, with weights."""

    weights: FloatArray  #: Shape (N,). Sum 1.
    declared: FloatArray  #: Shape (N, 3, DEGREE + runs). As in :class:`~.problem.Solution`.
    sizes_dph: dict[str, FloatArray]  #: By name of the effect, shape (N, 3, k) each.
    #: The effects with the parameters drawn, and which of them each draw has.
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

    def mean(self, drawn: FloatArray) -> FloatArray:
        """Mean of a quantity, from its value in each draw (N, ...)."""
        return np.asarray(np.tensordot(self.weights, drawn, axes=1))

    def sigma(self, drawn: FloatArray) -> FloatArray:
        """Standard uncertainty of a quantity, from its value in each draw (N, ...)."""
        variance = np.tensordot(self.weights, (drawn - self.mean(drawn)) ** 2, axes=1)
        return np.asarray(np.sqrt(variance))

    def quantile(self, drawn: FloatArray, probability: float) -> float:
        """Value (one number in each draw, shape (N,)) below which a quantity is with a probability."""
        order = np.argsort(drawn, kind="stable")
        below = np.cumsum(self.weights[order]) - 0.5 * self.weights[order]
        return float(np.interp(probability, below, drawn[order]))

    def interval(self, parameter: Parameter, value: float, drawn: FloatArray) -> tuple[float, float]:
        """Interval that holds a nonlinear parameter with 95 %; it ends at the bound if the value is there."""
        match bound_of(parameter, value):
            case "lower":
                return parameter.low, self.quantile(drawn, 0.95)
            case "upper":
                return self.quantile(drawn, 0.05), parameter.high
        return self.quantile(drawn, 0.025), self.quantile(drawn, 0.975)

    def bias_dph(self, campaign: Campaign, effects: Collection[str] | None = None) -> FloatArray:
        """Bias by each draw in the dwells of a campaign (N, n, 3).

        ``effects``: names of the effects included, by default all. A run that was not fitted gets the
        mean constant of the fitted ones, without its scatter.
        """
        base = np.stack([declared_columns(campaign, gyro) for gyro in range(3)], axis=1)
        bias_dph = _sum(base, with_mean_constants(self.declared))
        for name in self.sizes_dph.keys() if effects is None else effects:
            bias_dph += self.effect_dph(campaign, name)
        return bias_dph

    def effect_dph(self, campaign: Campaign, name: str) -> FloatArray:
        """Part of one effect in it (N, n, 3)."""
        part_dph = np.empty((len(self.node), len(campaign), 3))
        for number, candidates in enumerate(self.nodes):
            [one] = [each for each in candidates if each.effect.name == name]
            mine = self.node == number
            part_dph[mine] = _sum(one.columns(campaign), self.sizes_dph[name][mine])
        return part_dph


def _sum(columns: FloatArray, drawn: FloatArray) -> FloatArray:
    """Bias (N, n, 3) of columns (n, 3, k), each times what was drawn (N, 3, k)."""
    return np.asarray(np.matmul(drawn.swapaxes(0, 1), columns.transpose(1, 2, 0)).transpose(1, 2, 0))


def draw(problem: Problem, candidates: Sequence[Candidate]) -> Draws:
    """Draw the parameters of the declared model with effects, whose nonlinear parameters are fitted.

    ``problem`` has the declared model alone.
    """
    sampler = _Sampler(problem, candidates)
    nodes, weights = sampler.nodes()
    fits = [sampler.linear(each) for each in nodes]
    node = np.arange(DRAWS) % len(nodes)
    random = np.random.default_rng(0)
    declared = np.full((DRAWS, 3, DEGREE + len(problem.campaign.run_names)), np.nan)
    sizes = [np.zeros((DRAWS, *each.kept.shape)) for each in candidates]
    for gyro in range(3):
        mine = [each[gyro] for each in fits]
        normal = _standard_normal(random, max(each.root.shape[1] for each in mine))
        drawn = np.array([mine[index].drawn(each) for index, each in zip(node, normal, strict=True)])
        parts = np.split(
            drawn,
            np.cumsum([mine[0].known.sum(), *(each.kept[gyro].sum() for each in candidates)])[:-1],
            axis=1,
        )
        declared[:, gyro, mine[0].known] = parts[0]
        for size, part, each in zip(sizes, parts[1:], candidates, strict=True):
            size[:, gyro, each.kept[gyro]] = part
    named = {each.effect.name: size for each, size in zip(candidates, sizes, strict=True)}
    return Draws(weights[node] / weights[node].sum(), declared, named, nodes, node)


@dataclass(frozen=True)
class _LinearFit:
    """Normal distribution of one gyro's coefficients, given the nonlinear parameters."""

    known: BoolArray  #: Columns of the declared model that are not zero.
    mean: FloatArray  #: Shape (q,).
    root: FloatArray  #: Shape (q, r). Its product with its transpose is the covariance.
    chi2: float
    log_determinant: float  #: Of the covariance in units of the columns' lengths.

    def drawn(self, normal: FloatArray) -> FloatArray:
        return self.mean + self.root @ normal[: self.root.shape[1]]


class _Sampler:
    """Distribution of the nonlinear parameters of some effects, in coordinates without units."""

    def __init__(self, problem: Problem, candidates: Sequence[Candidate]) -> None:
        self.problem, self.candidates = problem, tuple(candidates)
        campaign = problem.campaign
        parameters = [parameter for each in candidates for parameter in each.form.parameters]
        self.is_log = np.array(
            [each.low > 0.0 and each.high > _DECADE * each.low for each in parameters], dtype=bool
        )
        span_s = float(campaign.start_s.min()), float(campaign.end_s.max())
        bounds = [(each.low, each.high) if np.isfinite(each.low) else span_s for each in parameters]
        self.low, self.high = self._coordinates(np.array(bounds, dtype=np.float64).reshape(-1, 2).T)
        self.best = self._coordinates(np.array([value for each in candidates for value in each.values]))
        self.scale = 1.0
        self.prior_size = np.full(len(candidates), np.inf)
        self._bases = [
            declared_columns(campaign, gyro)[problem.searched] / problem.sigma_dph[:, gyro, np.newaxis]
            for gyro in range(3)
        ]
        self._set_scale()

    def _coordinates(self, values: FloatArray) -> FloatArray:
        return np.where(self.is_log, np.log(np.maximum(values, 1e-300)), values)

    def at(self, place: FloatArray) -> tuple[Candidate, ...]:
        """The effects with their parameters at a place."""
        values = iter(np.where(self.is_log, np.exp(np.where(self.is_log, place, 0.0)), place).tolist())
        return tuple(
            replace(each, values=tuple(itertools.islice(values, len(each.values))))
            for each in self.candidates
        )

    def linear(self, candidates: Sequence[Candidate]) -> list[_LinearFit]:
        """Fit of each gyro."""
        return [self._fit(gyro, candidates) for gyro in range(3)]

    def _fit(self, gyro: int, candidates: Sequence[Candidate]) -> _LinearFit:
        problem, base = self.problem, self._bases[gyro]
        known = np.any(base != 0.0, axis=0)
        terms = [
            each.columns(problem.campaign)[problem.searched, gyro][:, each.kept[gyro]]
            / problem.sigma_dph[:, gyro, np.newaxis]
            for each in candidates
        ]
        columns = np.concatenate([base[:, known], *terms], axis=1)
        lengths = np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
        priors = np.repeat(
            [0.0, *self.scale / self.prior_size], [known.sum(), *(each.shape[1] for each in terms)]
        )
        priors = priors / np.sqrt(len(columns))
        left, shares, right = np.linalg.svd(
            np.concatenate([columns / lengths, np.diag(priors)[priors > 0.0]]), full_matrices=False
        )
        good = shares > _MIN_SHARE
        data = problem.campaign.bias_dph[problem.searched, gyro] / problem.sigma_dph[:, gyro]
        parts = left[: len(data), good].T @ data
        root = right[good].T / shares[good] / lengths[:, np.newaxis]
        return _LinearFit(
            known,
            root @ parts,
            self.scale * root,
            float(data @ data - parts @ parts),
            -float(np.sum(np.log(shares[good]))),
        )

    def _log_density(self, place: FloatArray) -> float:
        if np.any(place < self.low) or np.any(place > self.high):
            return -np.inf
        fits = self.linear(self.at(place))
        return float(sum(each.log_determinant - 0.5 * each.chi2 / self.scale**2 for each in fits))

    def _set_scale(self) -> None:
        """Set the noise: that of the residuals, and the stated one with what is known of it, combined."""
        fits = self.linear(self.candidates)
        dof = max(self.problem.residuals.size - sum(each.root.shape[1] for each in fits) - len(self.best), 1)
        found = 0.5 * np.log(max(sum(each.chi2 for each in fits) / dof, 1e-12))
        self.scale = float(np.exp(found / (1.0 + 0.5 / dof / _PRIOR_SCALE**2)))

    def nodes(self) -> tuple[tuple[tuple[Candidate, ...], ...], FloatArray]:
        """Values of the parameters and their weights."""
        if not len(self.best):
            return (self.candidates,), np.ones(1)
        count = len(self.best)
        centre, root = self.best, np.diag(self._widths())
        for _ in range(_ROUNDS):
            steps = _proposed(_NODES, count)
            places = centre + steps @ root.T
            log_weights = np.array([self._log_density(each) for each in places]) + 0.5 * (
                _TAILS + count
            ) * np.log1p(np.sum(steps**2, axis=1) / _TAILS)
            weights = np.exp(log_weights - log_weights.max())
            weights /= weights.sum()
            centre = weights @ places
            spread = (places - centre).T @ ((places - centre) * weights[:, np.newaxis])
            root = np.linalg.cholesky(spread + 1e-12 * np.eye(count) * np.trace(spread))
        return tuple(map(self.at, places)), weights

    def _widths(self) -> FloatArray:
        """Standard deviation of each parameter, the others at their best values."""
        return np.array(
            [max(self._width(index, side) for side in (-1.0, 1.0)) for index in range(len(self.best))]
        )

    def _width(self, index: int, side: float) -> float:
        """Where chi2 has risen on one side by more than noise makes it rise."""
        at_best = self._log_density(self.best)
        step = (self.high - self.best if side > 0.0 else self.best - self.low)[index]
        unit = side * np.eye(len(self.best))[index]
        for _ in range(_MAX_HALVINGS):
            rise = 2.0 * (at_best - self._log_density(self.best + step * unit))
            if rise < _RISE:
                break
            step *= 0.5 if rise > 4.0 * _RISE else max(np.sqrt(_RISE / rise) * 0.95, 0.5)
        return float(step / np.sqrt(max(rise, 0.5)))


def _proposed(number: int, count: int) -> FloatArray:
    """Points (number, count) that fill a t distribution evenly."""
    # Additive recurrence by the generalized golden ratio, the last coordinate for the scale.
    root = 2.0
    for _ in range(30):
        root = (1.0 + root) ** (1.0 / (count + 2.0))
    even = (0.5 + np.outer(np.arange(1, number + 1), root ** -np.arange(1.0, count + 2.0))) % 1.0
    scale = np.sqrt(_TAILS / np.maximum(chdtri(_TAILS, even[:, -1:]), 1e-12))
    return np.asarray(ndtri(even[:, :-1]) * scale)


def _standard_normal(random: np.random.Generator, count: int) -> FloatArray:
    """Standard normal numbers (DRAWS, count), of mean 0 and covariance 1 where there are few."""
    normal = random.standard_normal((DRAWS, count))
    if 2 * count < DRAWS:
        normal -= normal.mean(axis=0)
        normal = np.linalg.solve(np.linalg.cholesky(normal.T @ normal / DRAWS), normal.T).T
    return normal


def bound_of(parameter: Parameter, value: float) -> str:
    """The bound of the fit at which a parameter is, "lower" or "upper"; empty within its range."""
    step = _AT_BOUND * (parameter.high - parameter.low)
    if not np.isfinite(step):
        return ""
    return "lower" if value <= parameter.low + step else "upper" if value >= parameter.high - step else ""
