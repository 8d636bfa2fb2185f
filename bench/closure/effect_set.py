"""Effects fitted together, and the terms that each gyro needs of them."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from gyrobench.bench.closure.candidate import Candidate, stack
from gyrobench.bench.closure.problem import Problem


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
