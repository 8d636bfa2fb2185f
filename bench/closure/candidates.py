"""Candidate effects fitted to a problem, and hypotheses: sets of effects compared by their BIC."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from operator import itemgetter

import numpy as np

from gyrobench.bench.closure.campaign import Campaign
from gyrobench.bench.closure.effects.effect import Effect, Form
from gyrobench.bench.closure.problem import Problem, Solution, explained_by, solve_terms
from gyrobench.bench.foundations.arrays import BoolArray, FloatArray, IntArray

_MAX_EVALUATIONS = 60
#: Convergence limits: of a parameter in units of its first step, and of chi2.
_PARAMETER_PRECISION = 1e-2
_CHI2_PRECISION = 0.05
#: At this factor above its upper bound, a parameter gives another effect's terms within a few percent.
_BEYOND = 10.0
_OTHER_SCALES = (0.5, 2.0)


@dataclass(frozen=True)
class Candidate:
    """An effect as fitted."""

    #: effect, form: The effect and its form.
    effect: Effect
    form: Form
    values: tuple[float, ...]  #: Parameters of the form.
    kept: BoolArray  #: Shape (3, k). Terms used for each gyro.

    def columns(self, campaign: Campaign) -> FloatArray:
        """Terms (n, 3, k) in all dwells."""
        return _terms(self.form, campaign, self.values)

    def with_value(self, index: int, value: float) -> Candidate:
        """The effect with one parameter changed."""
        return replace(self, values=(*self.values[:index], value, *self.values[index + 1 :]))

    @property
    def beyond_open_end(self) -> Candidate | None:
        """The effect with parameters that are at an open end moved far beyond; None if there are none.

        Beyond an open end the effect becomes another one.
        """
        pairs = zip(self.form.parameters, self.values, strict=True)
        factors = [
            _BEYOND if each.is_open_end and value >= 0.999 * each.high else 1.0 for each, value in pairs
        ]
        values = tuple(value * factor for value, factor in zip(self.values, factors, strict=True))
        return replace(self, values=values) if values != self.values else None

    @property
    def at_other_scales(self) -> list[Candidate]:
        """The effect with each width or time constant halved and doubled in turn, within the bounds."""
        scaled = []
        for index, each in enumerate(self.form.parameters):
            for factor in _OTHER_SCALES if each.is_scale else ():
                value = min(max(self.values[index] * factor, each.low), each.high)
                scaled.append(self.with_value(index, value))
        return scaled

    @property
    def parameter_count(self) -> int:
        """Number of fitted sizes and parameters."""
        return int(self.kept.sum()) + len(self.values)


@dataclass(frozen=True)
class Hypothesis:
    """The declared model with a set of effects fitted together."""

    candidates: tuple[Candidate, ...]  #: The effects; empty for the declared model alone.
    chi2: float  #: Sum of squared residuals in units of sigma.
    #: ``chi2`` plus :func:`bic_penalty` for each parameter (Schwarz); smaller is better. The difference of
    #: two is twice the logarithm of the odds.
    bic: float

    @property
    def names(self) -> frozenset[str]:
        """Names of the effects."""
        return frozenset(each.effect.name for each in self.candidates)

    @property
    def forms(self) -> frozenset[tuple[str, str]]:
        """Names of the effects and of their forms."""
        return frozenset((each.effect.name, each.form.name) for each in self.candidates)

    @property
    def parameter_count(self) -> int:
        """Number of fitted sizes and parameters of all effects."""
        return sum(each.parameter_count for each in self.candidates)

    def without(self, candidate: Candidate) -> list[Candidate]:
        """The effects except one."""
        return [each for each in self.candidates if each is not candidate]

    def is_better_than(self, other: Hypothesis) -> bool:
        """Whether the data prefer this hypothesis."""
        return self.bic < other.bic


def ranked(hypotheses: Iterable[Hypothesis]) -> list[Hypothesis]:
    """Hypotheses, best first."""
    return sorted(hypotheses, key=lambda each: each.bic)


def bic_penalty(problem: Problem) -> float:
    """Penalty of one parameter: the logarithm of the number of dwells searched."""
    return float(np.log(problem.searched.sum()))


def fit_hypothesis(problem: Problem, candidates: Sequence[Candidate]) -> Hypothesis:
    """Hypothesis of candidates whose parameters are fitted, without terms that do not lower the BIC.

    ``problem`` has the declared model alone.
    """
    return hypothesis_with(problem, _prune(problem, candidates) if candidates else ())


def hypothesis_with(problem: Problem, candidates: Sequence[Candidate]) -> Hypothesis:
    """Hypothesis of candidates with exactly the terms that they keep."""
    chi2 = problem.chi2
    if candidates:
        chi2 -= problem.chi2_reduction(*stack(candidates, problem.campaign))[0]
    penalty = bic_penalty(problem) * sum(each.parameter_count for each in candidates)
    return Hypothesis(tuple(candidates), chi2, chi2 + penalty)


def starts(form: Form, campaign: Campaign) -> list[tuple[float, ...]]:
    """All combinations of the starting values of a form's parameters."""
    return list(itertools.product(*(parameter.starts(campaign).tolist() for parameter in form.parameters)))


def start_count(effect: Effect, campaign: Campaign) -> int:
    """Number of combinations of starting values of an effect, over all its forms."""
    return sum(len(starts(form, campaign)) for form in effect.forms)


def best_start(problem: Problem, effect: Effect, form: Form) -> Candidate:
    """The form with the starting values that reduce chi2 most."""
    all_terms = np.ones((3, len(form.terms)), dtype=bool)
    candidates = [Candidate(effect, form, values, all_terms) for values in starts(form, problem.campaign)]
    reductions = [problem.chi2_reduction(each.columns(problem.campaign))[0] for each in candidates]
    return candidates[int(np.argmax(reductions))]


def refine(problem: Problem, candidates: Sequence[Candidate]) -> list[Candidate]:
    """Fit the nonlinear parameters of several candidates together, with the terms that they keep.

    ``problem`` has the declared model alone.
    """
    parameters = [parameter for each in candidates for parameter in each.form.parameters]
    start = np.array([value for each in candidates for value in each.values])
    if not parameters:
        return list(candidates)
    widths = np.array(
        [_width(value, each.low, each.high, problem) for value, each in zip(start, parameters, strict=True)]
    )

    kept = np.concatenate([each.kept for each in candidates], axis=1)
    cached: dict[tuple[tuple[float, ...], ...], float] = {}  # by values within the bounds

    def values_at(offsets: FloatArray) -> tuple[tuple[float, ...], ...]:
        parameter_values = (start + widths * offsets).tolist()
        values = iter(
            [
                min(max(value, each.low), each.high)
                for value, each in zip(parameter_values, parameters, strict=True)
            ]
        )
        return tuple([tuple(itertools.islice(values, len(each.values))) for each in candidates])

    def negative_reduction(offsets: FloatArray) -> float:
        values = values_at(offsets)
        if values not in cached:
            columns = [
                _terms(each.form, problem.campaign, own_values)
                for each, own_values in zip(candidates, values, strict=True)
            ]
            terms = columns[0] if len(columns) == 1 else np.concatenate(columns, axis=2)
            cached[values] = -problem.chi2_reduction(terms, kept)[0]
        return cached[values]

    simplex = np.vstack([np.zeros(len(start)), np.eye(len(start))])
    max_evaluations = _MAX_EVALUATIONS * len(start)
    best = values_at(
        nelder_mead(negative_reduction, simplex, max_evaluations, _PARAMETER_PRECISION, _CHI2_PRECISION)
    )
    return [replace(each, values=values) for each, values in zip(candidates, best, strict=True)]


def nelder_mead(
    cost: Callable[[FloatArray], float],
    simplex: FloatArray,
    max_evaluations: int,
    point_precision: float,
    cost_precision: float,
) -> FloatArray:
    """Minimize a cost by the method of Nelder and Mead (1965), from a simplex (n + 1, n); returns (n,).

    The steps are those of scipy.optimize, whose import takes longer than all searches of a campaign. Ends
    with the first step after ``max_evaluations``, or as soon as both precisions are reached.
    """
    costs = np.array([cost(corner) for corner in simplex])
    evaluations = len(costs)

    def evaluate(factor: float) -> tuple[float, FloatArray]:
        nonlocal evaluations
        evaluations += 1
        point = (1.0 + factor) * centre - factor * simplex[-1]
        return cost(point), point

    while True:
        order = costs.argsort()
        simplex, costs = simplex[order], costs[order]
        if evaluations >= max_evaluations or (
            costs[-1] - costs[0] <= cost_precision
            and np.abs(simplex[1:] - simplex[0]).max() <= point_precision
        ):
            return np.asarray(simplex[0])
        centre = np.add.reduce(simplex[:-1]) / len(simplex[0])
        trial, point = evaluate(1.0)
        if trial < costs[0]:
            trial, point = min((trial, point), evaluate(2.0), key=itemgetter(0))
        elif trial >= costs[-2]:
            outside = trial < costs[-1]
            limit = trial if outside else costs[-1]
            trial, point = evaluate(0.5 if outside else -0.5)
            if trial > limit or (trial == limit and not outside):
                simplex[1:] = simplex[0] + 0.5 * (simplex[1:] - simplex[0])
                costs[1:] = [cost(corner) for corner in simplex[1:]]
                evaluations += len(costs) - 1
                continue
        simplex[-1], costs[-1] = point, trial


def stack(candidates: Sequence[Candidate], campaign: Campaign) -> tuple[FloatArray, BoolArray]:
    """Terms (n, 3, k) of several candidates, concatenated, and which of them each gyro keeps (3, k)."""
    columns = np.concatenate([each.columns(campaign) for each in candidates], axis=2)
    return columns, np.concatenate([each.kept for each in candidates], axis=1)


def owners(candidates: Sequence[Candidate]) -> IntArray:
    """Which candidate each term of all together is of, shape (k,)."""
    return np.repeat(np.arange(len(candidates)), [each.kept.shape[1] for each in candidates])


def after_fit(problem: Problem, candidates: Sequence[Candidate]) -> Problem:
    """Problem after a fit of the terms that candidates keep; the same without any."""
    return problem.with_columns(*stack(candidates, problem.campaign)) if candidates else problem


def solve_with(problem: Problem, candidates: Sequence[Candidate]) -> Solution:
    """Fit the declared model with the terms that candidates keep."""
    return solve_terms(problem, [(each.columns(problem.campaign), each.kept) for each in candidates])


def _terms(form: Form, campaign: Campaign, values: tuple[float, ...]) -> FloatArray:
    """Terms (n, 3, k) of a form, cached by its parameter values."""
    return campaign.computed_once((form, values), lambda: form.columns(campaign, values))


def _width(value: float, low: float, high: float, problem: Problem) -> float:
    """First step of a parameter: a quarter of its value; for a time without bounds, a dwell's length."""
    if np.isinf(low):
        campaign = problem.campaign
        return float(np.median(campaign.end_s - campaign.start_s))
    step = 0.25 * max(abs(value), 0.05 * (high - low))
    return -step if value + step > high else step


def _prune(problem: Problem, candidates: Sequence[Candidate]) -> list[Candidate]:
    """Drop terms, gyro by gyro, as long as the BIC falls.

    Each effect keeps at least one term per gyro: an effect present in one gyro is present in all of them.
    """
    columns, kept = stack(candidates, problem.campaign)
    products, residual_products = problem.inner_products(columns, kept)
    owner = owners(candidates)

    def reduction(gyro: int, terms: IntArray) -> float:
        return explained_by(products[gyro][np.ix_(terms, terms)], residual_products[gyro, terms])[0]

    pruned = np.zeros_like(kept)
    for gyro in range(3):
        terms = np.flatnonzero(kept[gyro])
        current = reduction(gyro, terms)
        while True:
            trials = [
                (reduction(gyro, terms[terms != each]), int(each))
                for each in terms
                if np.count_nonzero(owner[terms] == owner[each]) > 1
            ]
            best, dropped = max(trials, default=(-np.inf, -1))
            if current - best >= bic_penalty(problem):
                break
            current, terms = best, terms[terms != dropped]
        pruned[gyro, terms] = True
    bounds = np.cumsum([0, *(each.kept.shape[1] for each in candidates)])
    pruned_by_candidate = [pruned[:, low:high] for low, high in itertools.pairwise(bounds)]
    return [
        replace(each, kept=own_kept) for each, own_kept in zip(candidates, pruned_by_candidate, strict=True)
    ]
