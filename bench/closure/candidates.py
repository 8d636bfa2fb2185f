"""Candidate effects fitted to a problem, alone or together, and the criterion that compares them (BIC)."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import minimize

from gyrobench.bench.closure.campaign import Campaign
from gyrobench.bench.closure.effects.effect import Effect, Form
from gyrobench.bench.closure.problem import Problem, Solution, solve
from gyrobench.bench.foundations.arrays import BoolArray, FloatArray

_MOST_EVALUATIONS = 60
#: Of a parameter in first steps, and of the sum of squares.
_PARAMETER_PRECISION = 1e-2
_CHI2_PRECISION = 0.05


@dataclass(frozen=True)
class Candidate:
    """An effect as fitted.

    Attributes
    ----------
    effect, form : Effect, Form
        What and in which form.
    values : tuple of float
        Of the form's parameters.
    kept : ndarray of bool, shape (3, k)
        Terms that each gyro has.
    """

    effect: Effect
    form: Form
    values: tuple[float, ...]
    kept: BoolArray

    def columns(self, campaign: Campaign) -> FloatArray:
        """Terms (n, 3, k) in all dwells."""
        return self.form.columns(campaign, self.values)

    @property
    def is_at_open_end(self) -> bool:
        """Whether a parameter ended at an upper bound beyond which the effect becomes another one."""
        return any(
            each.is_open_end and value >= 0.999 * each.high
            for each, value in zip(self.form.parameters, self.values, strict=True)
        )

    @property
    def unknowns(self) -> int:
        """Sizes and parameters fitted."""
        return int(self.kept.sum()) + len(self.values)


def starts(form: Form, campaign: Campaign) -> list[tuple[float, ...]]:
    """All combinations of the values that a form's parameters start from."""
    grids = [parameter.starts(campaign).tolist() for parameter in form.parameters]
    return list(itertools.product(*grids))


def tried(effect: Effect, campaign: Campaign) -> int:
    """How many starts a search makes of an effect, over all its forms."""
    return sum(len(starts(form, campaign)) for form in effect.forms)


def best_start(problem: Problem, effect: Effect, form: Form) -> Candidate:
    """Form with the parameters, of those that it starts from, that explain most of what is left."""
    begun = starts(form, problem.campaign)
    gains = [problem.gain(form.columns(problem.campaign, values))[0] for values in begun]
    return Candidate(effect, form, begun[int(np.argmax(gains))], np.ones((3, len(form.terms)), dtype=bool))


def refine(problem: Problem, candidates: Sequence[Candidate]) -> list[Candidate]:
    """Improve the parameters of several candidates together.

    Parameters
    ----------
    problem : Problem
        With the declared model alone.
    candidates : sequence of Candidate
        To fit at the same time; the terms that they keep stay the same.
    """
    parameters = [parameter for each in candidates for parameter in each.form.parameters]
    start = np.array([value for each in candidates for value in each.values])
    if not parameters:
        return list(candidates)
    widths = np.array(
        [_width(value, each.low, each.high, problem) for value, each in zip(start, parameters, strict=True)]
    )

    def split(offsets: FloatArray) -> list[Candidate]:
        values = iter(
            float(np.clip(value, each.low, each.high))
            for value, each in zip(start + widths * offsets, parameters, strict=True)
        )
        return [
            replace(each, values=tuple(itertools.islice(values, len(each.values)))) for each in candidates
        ]

    def left(offsets: FloatArray) -> float:
        return -problem.gain(*stack(split(offsets), problem.campaign))[0]

    zero = np.zeros(len(start))
    simplex = np.vstack([zero, np.eye(len(start))])
    found = minimize(
        left,
        zero,
        method="Nelder-Mead",
        options={
            "initial_simplex": simplex,
            "maxfev": _MOST_EVALUATIONS * len(start),
            "xatol": _PARAMETER_PRECISION,
            "fatol": _CHI2_PRECISION,
        },
    )
    return split(found.x)


def stack(candidates: Sequence[Candidate], campaign: Campaign) -> tuple[FloatArray, BoolArray]:
    """Terms of several candidates side by side, and which of them each gyro keeps."""
    columns = np.concatenate([each.columns(campaign) for each in candidates], axis=2)
    return columns, np.concatenate([each.kept for each in candidates], axis=1)


def solve_with(problem: Problem, candidates: Sequence[Candidate]) -> Solution:
    """Fit the declared model with the terms that candidates keep."""
    return solve(problem, [(each.columns(problem.campaign), each.kept) for each in candidates])


def _width(value: float, low: float, high: float, problem: Problem) -> float:
    """First step of a parameter: a good part of it, or of a dwell where it is a time without bounds."""
    if np.isinf(low):
        campaign = problem.campaign
        return float(np.median(campaign.end_s - campaign.start_s))
    step = 0.25 * max(abs(value), 0.05 * (high - low))
    return -step if value + step > high else step


@dataclass(frozen=True)
class EffectSet:
    """Effects fitted together.

    Attributes
    ----------
    candidates : tuple of Candidate
        The effects; empty for the declared model alone.
    chi2 : float
        Sum of squares that they leave.
    score : float
        ``chi2`` plus what the unknowns cost (Schwarz); less is better. The difference of two is
        twice the logarithm of how much more the data prefer one.
    """

    candidates: tuple[Candidate, ...]
    chi2: float
    score: float

    @property
    def names(self) -> frozenset[str]:
        """Names of the effects."""
        return frozenset(each.effect.name for each in self.candidates)

    def without(self, one: Candidate) -> list[Candidate]:
        """All effects but one."""
        return [each for each in self.candidates if each is not one]


def evaluate(problem: Problem, candidates: Sequence[Candidate]) -> EffectSet:
    """Drop the terms that don't pay for themselves, and score what stays.

    Parameters
    ----------
    problem : Problem
        With the declared model alone.
    candidates : sequence of Candidate
        With good values of their parameters.
    """
    return scored(problem, _prune(problem, candidates) if candidates else ())


def scored(problem: Problem, candidates: Sequence[Candidate]) -> EffectSet:
    """Score candidates with the terms that they keep."""
    left = problem.chi2
    if candidates:
        left -= problem.gain(*stack(candidates, problem.campaign))[0]
    cost = price(problem) * sum(each.unknowns for each in candidates)
    return EffectSet(tuple(candidates), left, left + cost)


def price(problem: Problem) -> float:
    """What an unknown costs: the logarithm of the number of dwells searched."""
    return float(np.log(problem.searched.sum()))


def _prune(problem: Problem, candidates: Sequence[Candidate]) -> list[Candidate]:
    """Take away terms, gyro by gyro, as long as the score gets better.

    Each effect keeps one term for each gyro: a cause that one gyro has, all of them have.
    """
    columns, kept = stack(candidates, problem.campaign)
    kept = kept.copy()
    owner = np.repeat(np.arange(len(candidates)), [each.kept.shape[1] for each in candidates])
    for gyro in range(3):
        mine = np.zeros_like(kept)
        mine[gyro] = kept[gyro]
        gain, _ = problem.gain(columns, mine)
        while True:
            trials = []
            for term in np.flatnonzero(mine[gyro]):
                if np.sum(mine[gyro] & (owner == owner[term])) > 1:
                    fewer = mine.copy()
                    fewer[gyro, term] = False
                    trials.append((problem.gain(columns, fewer)[0], int(term)))
            best, least = max(trials, default=(-np.inf, -1))
            if gain - best >= price(problem):
                break
            gain = best
            mine[gyro, least] = False
        kept[gyro] = mine[gyro]
    bounds = np.cumsum([0, *(each.kept.shape[1] for each in candidates)])
    parts = [kept[:, low:high] for low, high in itertools.pairwise(bounds)]
    return [replace(each, kept=part) for each, part in zip(candidates, parts, strict=True)]
