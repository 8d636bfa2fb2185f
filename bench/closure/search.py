"""The search: which effects, if any, account for what the declared model leaves."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np
from scipy.stats import chi2 as chi2_distribution

from gyrobench.bench.closure.candidates import (
    Candidate,
    EffectSet,
    best_start,
    evaluate,
    refine,
    stack,
    tried,
)
from gyrobench.bench.closure.effects.effect import Effect
from gyrobench.bench.closure.problem import Problem

#: An effect is found if chance gives as much with a smaller probability, over all that was tried.
SIGNIFICANCE = 1e-3
#: Effects are tied if the data prefer one to the other by less than 100 to 1 (twice the logarithm).
TIE_MARGIN = 2.0 * np.log(100.0)
#: Most effects at a time.
MOST_EFFECTS = 3
#: Sets of effects that are carried on with at each step.
_BEAM = 3
#: An effect whose terms another one's can make up to this share of their length is a case of it.
SAME_SHARE = 0.05
#: One dwell may hold up to this share of what an effect explains.
MOST_OF_ONE_DWELL = 0.5
#: Better parameters than those it starts from let an effect explain this many times as much, at most.
_MOST_REFINED = 3.0
#: Times that effects of the best set are exchanged for better ones.
_MOST_EXCHANGES = 6


class Search:
    """A search of one problem.

    Parameters
    ----------
    problem : Problem
        With the declared model alone.
    effects : sequence of Effect
        All candidates.
    alone : mapping of str to EffectSet, optional
        Each effect alone, where that is known.

    Attributes
    ----------
    nothing : EffectSet
        The declared model alone.
    alone : dict of str to EffectSet
        Each effect alone; those that the data don't show at all are not in it.
    """

    def __init__(
        self, problem: Problem, effects: Sequence[Effect], alone: Mapping[str, EffectSet] | None = None
    ) -> None:
        self.problem = problem
        self.effects = tuple(effects)
        self.nothing = evaluate(problem, ())
        self._known: dict[tuple[object, ...], EffectSet | None] = {}
        if alone is None:
            each_alone = {effect.name: self._added(self.nothing, effect) for effect in effects}
            alone = {name: each for name, each in each_alone.items() if each is not None}
        self.alone = dict(alone)

    def paid_with(self, problem: Problem) -> Search:
        """Same search with noise of another size: parameters stay, terms are chosen anew."""
        alone = {name: evaluate(problem, each.candidates) for name, each in self.alone.items()}
        return Search(problem, self.effects, alone)

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
        return self._simplified(self._exchanged(best))

    def add(self, to: EffectSet, effect: Effect) -> EffectSet | None:
        """Add one effect in its best form, all parameters fitted anew; None if it adds nothing."""
        if not to.candidates:
            return self.alone.get(effect.name)
        if effect.name in to.names:
            return None
        key = (*((each.effect.name, each.form.name, each.values) for each in to.candidates), effect.name)
        if key not in self._known:
            self._known[key] = self._added(to, effect)
        return self._known[key]

    def p_value(self, of: EffectSet, index: int) -> float:
        """Probability that chance gives one effect of a set as much, over all effects and starts tried."""
        one = of.candidates[index]
        gain, rank = self._beside_others(of, index).gain(one.columns(self.problem.campaign))
        trials = tried(one.effect, self.problem.campaign) * len(self.effects)
        return min(1.0, _chance(gain, rank + len(one.values)) * trials)

    def shows(self, of: EffectSet, index: int) -> list[bool]:
        """Which gyros by themselves show one effect of a set; at least the one that shows it most."""
        one = of.candidates[index]
        beside, columns = self._beside_others(of, index), one.columns(self.problem.campaign)
        gyros = [beside.gain(columns, one.kept & (np.arange(3) == gyro)[:, np.newaxis]) for gyro in range(3)]
        chances = [_chance(gain, max(rank, 1)) for gain, rank in gyros]
        return [chance < SIGNIFICANCE or chance == min(chances) for chance in chances]

    def rivals(self, of: EffectSet, index: int) -> tuple[str, ...]:
        """Names of effects that do about as well in the place of one, best first.

        An effect that has the one as a special case is no rival: the simpler cause is preferred. One
        that is known to imitate it and can't be tried, for want of an input, may be in its place too.
        """
        others = evaluate(self.problem, of.without(of.candidates[index]))
        tied = []
        for effect in self.effects:
            instead = None if effect.name in of.names else self.add(others, effect)
            if (
                instead is not None
                and instead.score < of.score + TIE_MARGIN
                and not self._is_case_of(of, instead)
            ):
                tied.append((instead.score, effect.name))
        one = of.candidates[index].effect
        untried = [
            effect.name
            for effect in self.effects
            if effect.name in one.imitated_by
            and all(form.lacks(self.problem.campaign) for form in effect.forms)
        ]
        return (*(name for _, name in sorted(tied)), *untried)

    def _added(self, to: EffectSet, effect: Effect) -> EffectSet | None:
        problem, campaign = self.problem, self.problem.campaign
        beside = problem.with_columns(*stack(to.candidates, campaign)) if to.candidates else problem
        sets = []
        for form in effect.forms:
            if form.lacks(campaign):
                continue
            start = best_start(beside, effect, form)
            gain, rank = beside.gain(start.columns(campaign))
            if _chance(_MOST_REFINED * gain, rank + len(start.values)) >= SIGNIFICANCE:
                continue
            [candidate] = refine(beside, [start])
            gain, rank = beside.gain(candidate.columns(campaign))
            if _chance(gain, rank + len(candidate.values)) < SIGNIFICANCE:
                whole = [replace(each, kept=np.ones_like(each.kept)) for each in (*to.candidates, candidate)]
                sets.append(evaluate(problem, refine(problem, whole) if to.candidates else whole))
        return min(sets, key=lambda each: each.score, default=None)

    def _exchanged(self, best: EffectSet) -> EffectSet:
        """Set in which no effect has a better one in its place: early ones may be stand-ins for several."""
        for _ in range(_MOST_EXCHANGES if len(best.candidates) > 1 else 0):
            fewer = [evaluate(self.problem, best.without(one)) for one in best.candidates]
            others = [effect for effect in self.effects if effect.name not in best.names]
            found = [self.add(each, effect) for each in fewer for effect in others]
            better = [
                each
                for each in found
                if each is not None and each.score < best.score and self._all_significant(each)
            ]
            if not better:
                break
            best = min(better, key=lambda each: each.score)
        return best

    def _simplified(self, best: EffectSet) -> EffectSet:
        """Set in which no effect can be had by a special case of it that does about as well."""
        for one in best.candidates:
            others = evaluate(self.problem, best.without(one))
            for effect in self.effects:
                simpler = None if effect.name in best.names else self.add(others, effect)
                if (
                    simpler is not None
                    and simpler.score < best.score + TIE_MARGIN
                    and self._is_case_of(simpler, best)
                    and self._all_significant(simpler)
                ):
                    return self._simplified(simpler)
        return best

    def _all_significant(self, of: EffectSet) -> bool:
        return all(
            self.p_value(of, index) < SIGNIFICANCE
            and not each.is_at_open_end
            and not self._rests_on_one_dwell(of, index)
            for index, each in enumerate(of.candidates)
        )

    def _rests_on_one_dwell(self, of: EffectSet, index: int) -> bool:
        """Whether one dwell holds most of what an effect explains beside the others: an outlier may, too."""
        beside, one = self._beside_others(of, index), of.candidates[index]
        after = beside.with_columns(one.columns(self.problem.campaign))
        explained = np.sum((beside.residuals - after.residuals) ** 2, axis=1)
        return bool(explained.max() > MOST_OF_ONE_DWELL * explained.sum())

    def _beside_others(self, of: EffectSet, index: int) -> Problem:
        """Problem without what the other effects of a set, with all their terms, explain."""
        others = of.without(of.candidates[index])
        return self.problem.with_columns(stack(others, self.problem.campaign)[0]) if others else self.problem

    def _is_case_of(self, special: EffectSet, general: EffectSet) -> bool:
        """Whether one set makes up another with its terms as fitted, or at the lower bound of a parameter."""
        unknowns = [sum(each.unknowns for each in of.candidates) for of in (special, general)]
        if unknowns[1] <= unknowns[0]:
            return False
        wanted = stack(special.candidates, self.problem.campaign)
        return any(
            self.problem.with_columns(*stack(each, self.problem.campaign)).share_left(*wanted) < SAME_SHARE
            for each in (general.candidates, *_limits(general.candidates))
        )


def _limits(candidates: Sequence[Candidate]) -> Iterator[list[Candidate]]:
    """Candidates with one parameter at its lower bound, for each of them that has one."""
    for place, each in enumerate(candidates):
        for index, parameter in enumerate(each.form.parameters):
            if np.isfinite(parameter.low):
                values = (*each.values[:index], parameter.low, *each.values[index + 1 :])
                yield [*candidates[:place], replace(each, values=values), *candidates[place + 1 :]]


def _chance(gain: float, unknowns: int) -> float:
    return float(chi2_distribution.sf(gain, unknowns))
