"""The search: which effects, if any, account for what the declared model leaves."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.stats import chi2 as chi2_distribution

from bench.closure.candidate import fit_form, refine, stack, starts
from bench.closure.effect_set import EffectSet, evaluate
from bench.closure.effects.effect import Effect
from bench.closure.problem import Problem

#: An effect is found if chance gives as much with a smaller probability, over all that was tried.
SIGNIFICANCE = 1e-3
#: Effects are tied if the data prefer one to the other by less than 100 to 1 (twice the logarithm).
TIE_MARGIN = 2.0 * np.log(100.0)
#: Most effects at a time.
MOST_EFFECTS = 3
#: Sets of effects that are carried on with at each step.
_BEAM = 3
#: An effect whose terms another one's can make up to this share of their length is a case of it.
_SAME_SHARE = 0.02


class Search:
    """A search of one problem.

    Parameters
    ----------
    problem : Problem
        With the declared model alone.
    effects : sequence of Effect
        All candidates.

    Attributes
    ----------
    nothing : EffectSet
        The declared model alone.
    alone : dict of str to EffectSet
        Each effect alone; those that the data don't show at all are not in it.
    """

    def __init__(self, problem: Problem, effects: Sequence[Effect]) -> None:
        self.problem = problem
        self.effects = tuple(effects)
        self.nothing = evaluate(problem, ())
        alone = {effect.name: self._added(self.nothing, effect) for effect in effects}
        self.alone = {name: each for name, each in alone.items() if each is not None}

    def best(self) -> EffectSet:
        """Find the set that explains most for its number of unknowns, each effect of it significant."""
        best = self.nothing
        beam = [best]
        for _ in range(MOST_EFFECTS):
            grown: dict[frozenset[str], EffectSet] = {}
            for smaller in beam:
                for effect in self.effects:
                    larger = self.add(smaller, effect)
                    if larger is None or not self._all_significant(larger):
                        continue
                    if larger.names not in grown or larger.score < grown[larger.names].score:
                        grown[larger.names] = larger
            beam = sorted(grown.values(), key=lambda each: each.score)[:_BEAM]
            if not beam or beam[0].score >= best.score:
                break
            best = beam[0]
        return best

    def add(self, to: EffectSet, effect: Effect) -> EffectSet | None:
        """Add one effect in its best form, all parameters fitted anew; None if it adds nothing."""
        if not to.candidates:
            return self.alone.get(effect.name)
        return None if effect.name in to.names else self._added(to, effect)

    def p_value(self, of: EffectSet, index: int) -> float:
        """Probability that chance gives one effect of a set as much, over all effects and starts tried."""
        problem, one = self.problem, of.candidates[index]
        others = [each for number, each in enumerate(of.candidates) if number != index]
        beside = problem.with_columns(stack(others, problem.campaign)[0]) if others else problem
        gain, rank = beside.gain(one.columns(problem.campaign))
        tried = sum(len(starts(form, problem.campaign)) for form in one.effect.forms) * len(self.effects)
        return min(1.0, _chance(gain, rank + len(one.values)) * tried)

    def rivals(self, of: EffectSet, index: int) -> tuple[str, ...]:
        """Names of effects that do about as well in the place of one, best first.

        An effect that has the one as a special case is no rival: the simpler cause is preferred.
        """
        others = evaluate(
            self.problem, [each for number, each in enumerate(of.candidates) if number != index]
        )
        tied = []
        for effect in self.effects:
            instead = None if effect.name in of.names else self.add(others, effect)
            if (
                instead is not None
                and instead.score < of.score + TIE_MARGIN
                and not self._is_case_of(of, instead)
            ):
                tied.append((instead.score, effect.name))
        return tuple(name for _, name in sorted(tied))

    def _added(self, to: EffectSet, effect: Effect) -> EffectSet | None:
        problem, campaign = self.problem, self.problem.campaign
        beside = problem.with_columns(*stack(to.candidates, campaign)) if to.candidates else problem
        sets = []
        for form in effect.forms:
            candidate = None if form.lacks(campaign) else fit_form(beside, effect, form)
            if candidate is None:
                continue
            gain, rank = beside.gain(candidate.columns(campaign))
            if _chance(gain, rank + len(candidate.values)) < SIGNIFICANCE:
                whole = [replace(each, kept=np.ones_like(each.kept)) for each in (*to.candidates, candidate)]
                sets.append(evaluate(problem, refine(problem, whole) if to.candidates else whole))
        return min(sets, key=lambda each: each.score, default=None)

    def _all_significant(self, of: EffectSet) -> bool:
        return all(self.p_value(of, index) < SIGNIFICANCE for index in range(len(of.candidates)))

    def _is_case_of(self, special: EffectSet, general: EffectSet) -> bool:
        campaign = self.problem.campaign
        if sum(each.unknowns for each in general.candidates) <= sum(
            each.unknowns for each in special.candidates
        ):
            return False
        general_columns, special_columns = (stack(each.candidates, campaign) for each in (general, special))
        return self.problem.with_columns(*general_columns).share_left(*special_columns) < _SAME_SHARE


def _chance(gain: float, unknowns: int) -> float:
    return float(chi2_distribution.sf(gain, unknowns))
