"""The search: which effects, if any, account for what the declared model leaves."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import chi2 as chi2_distribution

from bench.closure.candidate import Candidate, fit_form, refine, stack, starts
from bench.closure.effects.effect import Effect
from bench.closure.problem import Problem

#: An effect is found if chance gives as much with a smaller probability, over all that was tried.
SIGNIFICANCE = 1e-3
#: Most effects at a time.
MOST_EFFECTS = 3
#: Sets of effects that are carried on with at each step.
_BEAM = 3


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
        ``chi2`` plus what the unknowns cost (Schwarz); less is better.
    """

    candidates: tuple[Candidate, ...]
    chi2: float
    score: float

    @property
    def names(self) -> frozenset[str]:
        """Names of the effects."""
        return frozenset(each.effect.name for each in self.candidates)


def search(problem: Problem, effects: Sequence[Effect]) -> EffectSet:
    """Find the set of effects that explains most for its number of unknowns.

    Every effect of the set is significant beside the others.
    """
    best = evaluate(problem, ())
    beam = [best]
    for _ in range(MOST_EFFECTS):
        grown: dict[frozenset[str], EffectSet] = {}
        for each in beam:
            for effect in effects:
                if effect.name in each.names:
                    continue
                larger = add(problem, each, effect)
                if larger is None or not all_significant(problem, larger, effects):
                    continue
                if larger.names not in grown or larger.score < grown[larger.names].score:
                    grown[larger.names] = larger
        beam = sorted(grown.values(), key=lambda each: each.score)[:_BEAM]
        if not beam or beam[0].score >= best.score:
            break
        best = beam[0]
    return best


def evaluate(problem: Problem, candidates: Sequence[Candidate]) -> EffectSet:
    """Drop the terms that don't pay for themselves, and score what stays."""
    if not candidates:
        return EffectSet((), problem.chi2, problem.chi2)
    pruned = _prune(problem, list(candidates))
    gain, _ = problem.gain(*stack(pruned, problem.campaign))
    left = problem.chi2 - gain
    cost = price(problem) * sum(each.unknowns for each in pruned)
    return EffectSet(tuple(pruned), left, left + cost)


def price(problem: Problem) -> float:
    """What an unknown costs: the logarithm of the number of dwells searched."""
    return float(np.log(problem.searched.sum()))


def add(problem: Problem, to: EffectSet, effect: Effect) -> EffectSet | None:
    """Add one effect in its best form, all parameters fitted anew; None if it explains nothing."""
    campaign = problem.campaign
    beside = problem.with_columns(*stack(to.candidates, campaign)) if to.candidates else problem
    sets = []
    for form in effect.forms:
        if form.lacks(campaign) is not None:
            continue
        candidate = fit_form(beside, effect, form)
        if candidate is not None:
            whole = [replace(each, kept=np.ones_like(each.kept)) for each in (*to.candidates, candidate)]
            sets.append(evaluate(problem, refine(problem, whole) if to.candidates else whole))
    return min(sets, key=lambda each: each.score, default=None)


def p_value(problem: Problem, of: EffectSet, index: int, effects: Sequence[Effect]) -> float:
    """Probability that chance gives one effect of a set as much, over all effects and starts tried."""
    others = [each for number, each in enumerate(of.candidates) if number != index]
    one = of.candidates[index]
    campaign = problem.campaign
    beside = problem.with_columns(stack(others, campaign)[0]) if others else problem
    gain, rank = beside.gain(one.columns(campaign))
    tried = sum(len(starts(form, campaign)) for form in one.effect.forms) * len(effects)
    return min(1.0, float(chi2_distribution.sf(gain, rank + len(one.values))) * tried)


def all_significant(problem: Problem, of: EffectSet, effects: Sequence[Effect]) -> bool:
    """Whether each effect of a set is more than chance beside the others."""
    return all(
        each.kept.any() and p_value(problem, of, index, effects) < SIGNIFICANCE
        for index, each in enumerate(of.candidates)
    )


def _prune(problem: Problem, candidates: list[Candidate]) -> list[Candidate]:
    """Take away terms, gyro by gyro, as long as the score gets better."""
    columns, kept = stack(candidates, problem.campaign)
    kept = kept.copy()
    cost = price(problem)
    effect_of_term = np.repeat(np.arange(len(candidates)), [each.kept.shape[1] for each in candidates])
    for gyro in range(3):
        mine = np.zeros_like(kept)
        mine[gyro] = kept[gyro]
        gain, _ = problem.gain(columns, mine)
        while mine[gyro].any():
            trials = []
            for term in np.flatnonzero(mine[gyro]):
                if np.sum(mine[gyro] & (effect_of_term == effect_of_term[term])) == 1:
                    continue
                fewer = mine.copy()
                fewer[gyro, term] = False
                trials.append((problem.gain(columns, fewer)[0], int(term)))
            best, least = max(trials, default=(-np.inf, -1))
            if gain - best >= cost:
                break
            gain = best
            mine[gyro, least] = False
        kept[gyro] = mine[gyro]
    bounds = np.cumsum([0, *(each.kept.shape[1] for each in candidates)])
    parts = [kept[:, low:high] for low, high in itertools.pairwise(bounds)]
    return [replace(each, kept=part) for each, part in zip(candidates, parts, strict=True)]
