"""Uncertainty of a fitted model: draws of its coefficients, sizes and nonlinear parameters, given the data.

Given the nonlinear parameters the model is linear, and its coefficients have a normal distribution. The
nonlinear parameters are drawn by importance sampling within their bounds: where chi2 is not quadratic in
them, or the best value is at a bound, their distribution is neither normal nor symmetric.
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
from gyrobench.bench.closure.problem import DEGREE, MIN_SHARE, Problem, declared_columns, with_mean_constants
from gyrobench.bench.foundations.arrays import BoolArray, FloatArray, IntArray

#: Draws, places of the nonlinear parameters among them, and how many of those are sought within all bounds.
DRAWS, _NODES, _IN_BOX = 256, 128, 16
#: Prior standard deviation of the logarithm of the noise over the stated uncertainties.
_PRIOR_SCALE = 0.3
#: Degrees of freedom of the t distribution that proposes values.
_TAILS = 4.0
#: Rise of chi2 that measures the width of a parameter's distribution.
_RISE = 4.0
_MAX_HALVINGS, _ROUNDS = 40, 3
_PRIOR_STEPS = 6
#: An effect of more terms has those that the search kept.
_MAX_TERMS = 6
#: A parameter within this share of its range from a bound is at the bound.
_AT_BOUND = 1e-3


@dataclass(frozen=True)
class Draws:
    """N equally probable sets of the parameters of a model."""

    declared: FloatArray  #: Shape (N, 3, DEGREE + runs). As in :class:`~.problem.Solution`.
    run_names: tuple[str, ...]  #: Of these runs.
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

    def sigma(self, drawn: FloatArray, stated: FloatArray | float) -> FloatArray:
        """Standard uncertainty of a quantity as stated, from its value in each draw (N, ...)."""
        return np.asarray(np.sqrt(np.mean((drawn - stated) ** 2, axis=0)))

    def bias_dph(self, campaign: Campaign, effects: Collection[str] | None = None) -> FloatArray:
        """Bias by each draw in the dwells of a campaign (N, n, 3).

        ``effects``: names of the effects included, by default all. A power cycle that was not
        fitted gets the mean constant of the fitted ones, without its scatter.
        """
        base = np.stack([declared_columns(campaign, gyro) for gyro in range(3)], axis=1)
        unknown = np.full((*self.declared.shape[:2], 1), np.nan)
        known = np.concatenate([self.declared, unknown], axis=2)
        place = {name: DEGREE + index for index, name in enumerate(self.run_names)}
        wanted = [*range(DEGREE), *(place.get(name, -1) for name in campaign.run_names)]
        bias_dph = _sum(base, with_mean_constants(known)[..., wanted])
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
    problem = _with_noise_of_residuals(problem, candidates)
    at_best = _equations(problem, candidates)
    priors = _priors(at_best, candidates)
    nodes, node = _nodes(problem, candidates, priors)
    equations = [_equations(problem, each) for each in nodes] if len(nodes) > 1 else [at_best]
    random = np.random.default_rng(0)
    declared = np.full((DRAWS, 3, DEGREE + len(problem.campaign.run_names)), np.nan)
    sizes = {each.effect.name: np.zeros((DRAWS, *each.kept.shape)) for each in candidates}
    ends = np.cumsum([each.kept.shape[1] for each in candidates])
    for gyro in range(3):
        known = at_best[gyro].known
        used = _used_terms(at_best[gyro], candidates, gyro, priors, random)
        normal = _standard_normal(random, known.sum() + used.shape[1])
        drawn = np.array(
            [
                equations[index][gyro].drawn(mine, priors, each)
                for index, mine, each in zip(node, used, normal, strict=True)
            ]
        )
        declared[:, gyro, known], terms = np.split(drawn, [known.sum()], axis=1)
        for size, part in zip(sizes.values(), np.split(terms, ends[:-1], axis=1), strict=False):
            size[:, gyro] = part
    return Draws(declared, problem.campaign.run_names, sizes, nodes, node)


def _with_noise_of_residuals(problem: Problem, candidates: Sequence[Candidate]) -> Problem:
    """Same problem with the noise that its residuals show, as far as they know it better than is stated."""
    after = after_fit(problem, candidates)
    dof = max(after.dof - sum(len(each.values) for each in candidates), 1)
    ratio = max(after.chi2 / dof, 1e-12) ** (0.5 / (1.0 + 0.5 / dof / _PRIOR_SCALE**2))
    return replace(problem, noise_scale=problem.noise_scale * ratio, residuals=problem.residuals / ratio)


class _NormalEquations:
    """Of one gyro's coefficients, given the nonlinear parameters, for columns of length one."""

    def __init__(self, problem: Problem, candidates: Sequence[Candidate], gyro: int) -> None:
        campaign, searched = problem.campaign, problem.searched
        base = declared_columns(campaign, gyro)[searched]
        self.known: BoolArray = np.any(base != 0.0, axis=0)  #: Columns of the declared model in use.
        terms = [each.columns(campaign)[searched, gyro] for each in candidates]
        sigma_dph = problem.sigma_dph[:, gyro]
        columns = np.concatenate([base[:, self.known], *terms], axis=1) / sigma_dph[:, np.newaxis]
        lengths = np.linalg.norm(columns, axis=0)
        # What no measured value shows stays zero.
        self._lengths = np.where(lengths > 0.0, lengths, np.inf)
        columns /= self._lengths
        self._matrix = columns.T @ columns
        self._vector = columns.T @ (campaign.bias_dph[searched, gyro] / sigma_dph)
        self._roots: dict[bytes, tuple[FloatArray, float]] = {}

    def root(self, used: BoolArray, priors: FloatArray) -> tuple[FloatArray, float]:
        """Symmetric root of the covariance (q, q), zero for terms not used, and its log determinant."""
        key = used.tobytes() + priors.tobytes()
        if key not in self._roots:
            chosen = np.flatnonzero(np.concatenate([np.ones(self.known.sum(), dtype=bool), used]))
            diagonal = np.concatenate([np.zeros(self.known.sum()), priors**2])
            lengths, directions = np.linalg.eigh((self._matrix + np.diag(diagonal))[np.ix_(chosen, chosen)])
            good = lengths > MIN_SHARE**2
            root = np.zeros_like(self._matrix)
            root[np.ix_(chosen, chosen)] = (
                directions[:, good] / np.sqrt(lengths[good]) @ directions[:, good].T
            )
            self._roots[key] = root, -float(np.sum(np.log(lengths[good])))
        return self._roots[key]

    def drawn(self, used: BoolArray, priors: FloatArray, normal: FloatArray) -> FloatArray:
        """Coefficients from standard normal numbers (q,)."""
        root, _ = self.root(used, priors)
        return np.asarray(root @ (root @ self._vector + normal) / self._lengths)

    def squares(self, used: BoolArray, priors: FloatArray) -> FloatArray:
        """Expected squares of the terms' lengths, in standard deviations."""
        root, _ = self.root(used, priors)
        return np.asarray((root @ (root @ self._vector)) ** 2 + np.sum(root**2, axis=1))[self.known.sum() :]

    def log_evidence(self, used: BoolArray, priors: FloatArray) -> float:
        """Logarithm of the probability of the data with the terms used, but for a constant."""
        root, log_determinant = self.root(used, priors)
        return 0.5 * (float(np.sum((root @ self._vector) ** 2)) + log_determinant) + float(
            np.sum(np.log(priors[used]))
        )


def _equations(problem: Problem, candidates: Sequence[Candidate]) -> list[_NormalEquations]:
    return [_NormalEquations(problem, candidates, gyro) for gyro in range(3)]


def _priors(equations: Sequence[_NormalEquations], candidates: Sequence[Candidate]) -> FloatArray:
    """Inverse standard deviations of a normal prior of the terms' lengths, the same for those of an effect.

    The ones with which the data are most probable (empirical Bayes): the sizes of an effect that was selected
    as noise made it larger are drawn to zero, and those that the data do not determine stay finite.
    """
    kept = np.concatenate([np.zeros((3, 0), dtype=bool), *(each.kept for each in candidates)], axis=1)
    owner = owners(candidates)
    priors = np.zeros(kept.shape[1])
    for _ in range(_PRIOR_STEPS if candidates else 0):
        squares = np.stack([each.squares(kept[gyro], priors) for gyro, each in enumerate(equations)])
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
    """Terms of one gyro in each draw (DRAWS, k): by the probability that an effect has them.

    That a term was dropped by the search does not mean that it is zero.
    """
    kept = [each.kept[gyro] for each in candidates]
    drawn = []
    for place, mine in enumerate(kept):
        subsets = [mine]
        if 1 < len(mine) <= _MAX_TERMS:
            subsets = [
                np.array(each) for each in itertools.product([False, True], repeat=len(mine)) if any(each)
            ]
        log_evidence = np.array(
            [
                equations.log_evidence(np.concatenate([*kept[:place], each, *kept[place + 1 :]]), priors)
                for each in subsets
            ]
        )
        probability = np.exp(log_evidence - log_evidence.max())
        chosen = random.choice(len(subsets), DRAWS, p=probability / probability.sum())
        drawn.append(np.array(subsets)[chosen])
    return np.concatenate([np.zeros((DRAWS, 0), dtype=bool), *drawn], axis=1)


def _nodes(
    problem: Problem, candidates: Sequence[Candidate], priors: FloatArray
) -> tuple[tuple[tuple[Candidate, ...], ...], IntArray]:
    """Effects with their nonlinear parameters, and which of these each draw has."""
    place = _Place(problem, candidates, priors)
    if not len(place.best):
        return (tuple(candidates),), np.zeros(DRAWS, dtype=np.intp)
    centre, root = place.best, np.diag(place.widths())
    for _ in range(_ROUNDS):
        places, log_proposed = _proposed(centre, root, place.low, place.high)
        log_weights = np.array(list(map(place.log_density, places))) - log_proposed
        weights = np.exp(log_weights - log_weights.max())
        weights /= weights.sum()
        centre = weights @ places
        spread = (places - centre).T @ ((places - centre) * weights[:, np.newaxis])
        root = np.linalg.cholesky(spread + 1e-9 * np.diag(place.widths() ** 2))
    chosen = np.searchsorted(np.cumsum(weights), (np.arange(DRAWS) + 0.5) / DRAWS).clip(max=len(places) - 1)
    used, node = np.unique(chosen, return_inverse=True)
    return tuple(map(place.candidates_at, places[used])), node


class _Place:
    """The nonlinear parameters of some effects as a place in a box with a uniform prior."""

    def __init__(self, problem: Problem, candidates: Sequence[Candidate], priors: FloatArray) -> None:
        self._problem, self._candidates = problem, candidates
        self._priors = priors
        campaign = problem.campaign
        parameters = [parameter for each in candidates for parameter in each.form.parameters]
        self._is_log = np.array([each.is_scale for each in parameters], dtype=bool)
        span_s = float(campaign.start_s.min()), float(campaign.end_s.max())
        bounds = [(each.low, each.high) if np.isfinite(each.low) else span_s for each in parameters]
        self.low, self.high = _even(np.array(bounds, dtype=np.float64).reshape(-1, 2).T, self._is_log)
        self.best = _even(np.array([value for each in candidates for value in each.values]), self._is_log)

    def candidates_at(self, place: FloatArray) -> tuple[Candidate, ...]:
        """The effects with their parameters at a place."""
        values = iter(np.where(self._is_log, np.exp(np.where(self._is_log, place, 0.0)), place).tolist())
        return tuple(
            replace(each, values=tuple(itertools.islice(values, len(each.values))))
            for each in self._candidates
        )

    def log_density(self, place: FloatArray) -> float:
        """Logarithm of the probability density, with the coefficients of the terms integrated out."""
        if np.any(place < self.low) or np.any(place > self.high):
            return -np.inf
        columns, kept = stack(self.candidates_at(place), self._problem.campaign)
        terms = self._problem.independent_parts(columns, kept)
        used = kept & np.any(columns[self._problem.searched] != 0.0, axis=0)
        squares = np.where(used, self._priors**2, 1.0)  # a term that is not used adds nothing
        root = np.linalg.cholesky(terms.mT @ terms + squares[..., np.newaxis] * np.eye(len(self._priors)))
        parts = np.linalg.solve(root, terms.mT @ self._problem.residuals.T[..., np.newaxis])
        return float(0.5 * np.sum(parts**2) - np.sum(np.log(np.diagonal(root, axis1=1, axis2=2))))

    def widths(self) -> FloatArray:
        """Standard deviation of each parameter, the others at their best values."""
        return np.array(
            [max(self._width(index, side) for side in (-1.0, 1.0)) for index in range(len(self.best))]
        )

    def _width(self, index: int, side: float) -> float:
        """By the rise of chi2 on one side."""
        at_best, step = self.log_density(self.best), side * np.eye(len(self.best))[index]
        step *= (self.high - self.best if side > 0.0 else self.best - self.low)[index]
        for _ in range(_MAX_HALVINGS):
            rise = 2.0 * (at_best - self.log_density(self.best + step))
            if rise < _RISE:
                break
            step *= 0.5
        return float(np.abs(step[index]) / np.sqrt(max(rise, 0.5)))


def _proposed(
    centre: FloatArray, root: FloatArray, low: FloatArray, high: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Places that fill a t distribution evenly, and some that fill the box, with their log density."""
    count = len(centre)
    # Additive recurrence by the generalized golden ratio; the last coordinate is the scale of the t.
    golden = 2.0
    for _ in range(30):
        golden = (1.0 + golden) ** (1.0 / (count + 2.0))
    even = (0.5 + np.outer(np.arange(1, _NODES + 1), golden ** -np.arange(1.0, count + 2.0))) % 1.0
    scale = np.sqrt(_TAILS / np.maximum(_chi2_of_four(even[:, -1:]), 1e-12))
    normal = np.vectorize(NormalDist().inv_cdf)(even[:, :-1])
    places = centre + normal * scale @ root.T
    places[:: _NODES // _IN_BOX] = low + even[:_IN_BOX, :-1] * (high - low)
    squares = np.sum(np.linalg.solve(root, (places - centre).T) ** 2, axis=0)
    log_t = (
        math.lgamma(0.5 * (_TAILS + count))
        - math.lgamma(0.5 * _TAILS)
        - 0.5 * count * np.log(np.pi * _TAILS)
        - np.log(np.diag(root)).sum()
        - 0.5 * (_TAILS + count) * np.log1p(squares / _TAILS)
    )
    share = _IN_BOX / _NODES
    log_box = -np.log(high - low).sum()
    return places, np.logaddexp(np.log1p(-share) + log_t, np.log(share) + log_box)


def _chi2_of_four(probability: FloatArray) -> FloatArray:
    """Sum of four squares that is exceeded with this probability, ``exp(-h) (1 + h)`` of half the sum h."""
    wanted = -np.log(probability)
    half = wanted + np.sqrt(2.0 * wanted)  # never below the root, so that Newton's steps descend to it
    for _ in range(6):
        half = half - (half - np.log1p(half) - wanted) * (1.0 + half) / half
    return 2.0 * half


def _standard_normal(random: np.random.Generator, count: int) -> FloatArray:
    """Standard normal numbers (DRAWS, count), of mean 0 and covariance 1 where there are few."""
    normal = random.standard_normal((DRAWS, count))
    if 2 * count < DRAWS:
        normal -= normal.mean(axis=0)
        normal = np.linalg.solve(np.linalg.cholesky(normal.T @ normal / DRAWS), normal.T).T
    return normal


def interval(parameter: Parameter, value: float, drawn: FloatArray) -> tuple[float, float]:
    """Interval that holds a nonlinear parameter with 95 %, from its draws (N,).

    It ends at the bound if the value is there.
    """
    match bound_of(parameter, value):
        case "lower":
            return parameter.low, float(np.quantile(drawn, 0.95))
        case "upper":
            return float(np.quantile(drawn, 0.05)), parameter.high
    low, high = np.quantile(drawn, [0.025, 0.975]).tolist()
    return low, high


def bound_of(parameter: Parameter, value: float) -> str:
    """The bound of the fit at which a parameter is, "lower" or "upper"; empty within its range."""
    if not np.isfinite(parameter.low):
        return ""
    low, value, high = _even(np.array([parameter.low, value, parameter.high]), parameter.is_scale)
    step = _AT_BOUND * (high - low)
    return "lower" if value <= low + step else "upper" if value >= high - step else ""


def _even(values: FloatArray, is_log: BoolArray | bool) -> FloatArray:
    """Values on the scale on which they are equally probable: a positive scale by its logarithm."""
    return np.where(is_log, np.log(np.where(is_log, values, 1.0)), values)
