"""The search: which effects, if any, explain the residuals of the declared model."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np

from gyrobench.bench.bias.statistics import chi2_p_value
from gyrobench.bench.closure.candidates import (
    Candidate,
    Hypothesis,
    after_fit,
    best_start,
    fit_hypothesis,
    hypothesis,
    ranked,
    refine,
    stack,
    start_count,
)
from gyrobench.bench.closure.effects.effect import Effect
from gyrobench.bench.closure.evidence import Evidences
from gyrobench.bench.closure.posterior import RIVAL, TIE_ODDS, Posterior
from gyrobench.bench.closure.problem import Problem, declared_problem
from gyrobench.bench.foundations.text import listed

#: An effect is found if its p-value, corrected for all candidate fits, is below this.
EFFECT_SIGNIFICANCE = 1e-3
MAX_EFFECTS = 3
#: Hypotheses that are extended in each step.
_BEAM_WIDTH = 3
#: An effect is a special case of another one that reproduces its terms to this share of their length.
SAME_SHARE = 0.05
#: An effect is tested again without the dwell that has more than this share of its reduction of chi2.
_MAX_SHARE_OF_ONE_DWELL = 0.5
#: Fitted parameters reduce chi2 by at most this factor more than the best starting values.
_MAX_REFINEMENT = 3.0
#: Sets are about equally probable below these odds.
_EVEN_ODDS = 3.0
#: Limit of exchanges of effects in the best hypothesis.
_MAX_EXCHANGES = 6


#: Begin of the objection to an effect that a single dwell shows.
RESTS_ON_DWELL = "it rests on dwell"
#: Begin of the objection to an effect that adds too little to others.
NOT_SIGNIFICANT = "not significant"
#: Begin of the objection to an effect that others explain whose laws are not exact.
MAY_BE_LACK = "it may be what the laws of the others lack"


class Search:
    """A search of one problem, which has the declared model alone.

    ``declared``: that model as a hypothesis. ``alone``: each effect alone, if it is significant, by name.
    """

    def __init__(self, problem: Problem, effects: Sequence[Effect]) -> None:
        self.problem = problem
        self.effects = tuple(each.bounded(problem.campaign) for each in effects)
        self.declared = fit_hypothesis(problem, ())
        self._known: dict[tuple[object, ...], Hypothesis | None] = {}
        self._insignificant: dict[frozenset[str], Hypothesis] = {}
        self._by_forms: dict[frozenset[tuple[str, str]], Hypothesis] = {}
        alone = {effect.name: self._added(self.declared, effect) for effect in self.effects}
        self.alone = {name: each for name, each in alone.items() if each is not None}

    def best(self) -> Hypothesis:
        """The hypothesis with the smallest BIC of which each effect is significant."""
        best = self.declared
        beam = [best]
        for _ in range(MAX_EFFECTS):
            grown: dict[frozenset[str], Hypothesis] = {}
            for smaller in beam:
                for effect in self.effects:
                    larger = self.add(smaller, effect)
                    if larger is None or self._objections(larger):
                        continue
                    if larger.names not in grown or larger.is_better_than(grown[larger.names]):
                        grown[larger.names] = larger
            beam = ranked(grown.values())[:_BEAM_WIDTH]
            if not beam or not beam[0].is_better_than(best):
                break
            best = beam[0]
        return self._exchanged(best)

    def add(self, to: Hypothesis, effect: Effect) -> Hypothesis | None:
        """Add one effect in its best form and fit all parameters; None if it is not significant."""
        if not to.candidates:
            return self.alone.get(effect.name)
        if effect.name in to.names:
            return None
        key = (*((each.effect.name, each.form.name, each.values) for each in to.candidates), effect.name)
        if key not in self._known:
            self._known[key] = self._added(to, effect)
        return self._known[key]

    def candidate_fits(self, effect: Effect) -> int:
        """Number of fits that the p-value of an effect is corrected for."""
        return start_count(effect, self.problem.campaign) * len(self.effects)

    def p_value(self, of: Hypothesis, index: int) -> float:
        """p-value of one effect of a hypothesis, corrected for all candidate fits."""
        return self._p_beside(self._beside_others(of, index), of.candidates[index])

    def objection(self, of: Hypothesis, index: int) -> str:
        """Why one effect of a hypothesis is not accepted; empty if it is."""
        one, p_value = of.candidates[index], self.p_value(of, index)
        if p_value >= EFFECT_SIGNIFICANCE:
            labels = [each.effect.display_name for each in of.without(one)]
            beside = f" beside {listed(labels)}" if labels else ""
            return f"{NOT_SIGNIFICANT}{beside} (p = {p_value:.2g}, required below {EFFECT_SIGNIFICANCE:g})"
        if not self._excludes_beyond(of, index):
            return "a parameter is at its upper bound, where the effect becomes another one"
        dwell, p_without = self._without_largest_dwell(of, index)
        if p_without >= EFFECT_SIGNIFICANCE:
            return f"{RESTS_ON_DWELL} {dwell} alone (p = {p_without:.2g} without it)"
        return ""

    def without_lacks(self, of: Hypothesis) -> Hypothesis:
        """A hypothesis without the effects that may be what the laws of the others lack."""
        p_values = [self._p_beside_inexact(of, index) for index in range(len(of.candidates))]
        if max(p_values, default=0.0) < EFFECT_SIGNIFICANCE:
            return of
        fewer = fit_hypothesis(self.problem, of.without(of.candidates[int(np.argmax(p_values))]))
        return self.without_lacks(self._fitted(fewer)[fewer.names])

    def lack(self, of: Hypothesis, index: int) -> str:
        """Why one effect of a hypothesis may be what the laws of the others lack; empty if it is not."""
        p_value = self._p_beside_inexact(of, index)
        if p_value < EFFECT_SIGNIFICANCE:
            return ""
        return f"{MAY_BE_LACK} (p = {p_value:.2g} beside them with other scales and a delay)"

    def shows(self, of: Hypothesis, index: int) -> list[bool]:
        """Which gyros by themselves show one effect of a hypothesis; at least the most significant."""
        one = of.candidates[index]
        beside, columns = self._beside_others(of, index), one.columns(self.problem.campaign)
        gyros = [
            beside.chi2_reduction(columns, one.kept & (np.arange(3) == gyro)[:, np.newaxis])
            for gyro in range(3)
        ]
        p_values = [chi2_p_value(max(rank, 1), reduction) for reduction, rank in gyros]
        return [p_value < EFFECT_SIGNIFICANCE or p_value == min(p_values) for p_value in p_values]

    @cached_property
    def evidences(self) -> Evidences:
        """Evidence of the hypotheses of this search."""
        return Evidences(self.problem, self.effects)

    def most_probable(self) -> tuple[Hypothesis, Posterior]:
        """The most probable set of effects to which there is no objection, and the probabilities of all sets.

        The sets are those of the search by BIC and all with one effect more than the most probable or with
        one exchanged, significant or not. The simpler of sets that are about equally probable is preferred.
        """
        best, evidences = self.best(), self.evidences
        for _ in range(_MAX_EXCHANGES):
            self._fit_similar(best)
            fitted = self._fitted(best)
            posterior = evidences.posterior([*fitted.values(), *self._other_forms(fitted)])
            sets = (fitted[names] for names in posterior.sets if names in fitted)
            found = next(each for each in sets if not self._objections(each))
            if found.names == best.names:
                break
            best = found
        similar = [fitted[names] for names in posterior.similar(found.names) if names in fitted]
        for each in similar:
            is_as_probable = posterior.odds(found.names, each.names) < _EVEN_ODDS
            is_simpler = each.parameter_count < found.parameter_count
            if is_simpler and is_as_probable and not self._objections(each):
                found = each
        return found, replace(posterior, more_general=self._more_general(found, fitted, posterior))

    def _more_general(
        self, found: Hypothesis, fitted: Mapping[frozenset[str], Hypothesis], posterior: Posterior
    ) -> dict[str, frozenset[str]]:
        """By effect found: those that contain it and are less probable, or fitted no different from it.

        What reproduces it in this campaign alone, as a step of the supply a jump, is another cause. A
        parameter that changes nothing below some value takes a part of the probability however many dwells
        there are: a lag of seconds is no different from a rate.
        """
        general: dict[str, frozenset[str]] = {}
        of_found = posterior.of_set(found.names)
        limit = max(RIVAL, of_found / _EVEN_ODDS)
        for each in (fitted[names] for names in posterior.similar(found.names) if names in fitted):
            of_each = posterior.of_set(each.names)
            [one], [other] = found.names - each.names, each.names - found.names
            law = next((one.effect for one in each.candidates if one.effect.name == other), None)
            if law is None or one not in law.contains:
                continue
            if self._is_special_case(found, each) and (
                of_each < limit or (of_each < of_found and self._is_contained(each, [found.candidates]))
            ):
                general[one] = general.get(one, frozenset()) | {other}
        return general

    def _fit_similar(self, to: Hypothesis) -> None:
        """Fit all sets with one effect more, and all with one exchanged."""
        fewer = [fit_hypothesis(self.problem, to.without(each)) for each in to.candidates]
        for each in [*fewer, to] if len(to.candidates) < MAX_EFFECTS else fewer:
            for effect in self.effects:
                self.add(each, effect)

    def _fitted(self, best: Hypothesis) -> dict[frozenset[str], Hypothesis]:
        """All sets of effects fitted so far, each as it fits best."""
        fitted = {self.declared.names: self.declared, best.names: best}
        for each in (*self.alone.values(), *self._known.values()):
            if each and (each.names not in fitted or each.is_better_than(fitted[each.names])):
                fitted[each.names] = each
        for each in self._insignificant.values():
            is_near = len(each.names - best.names) == 1 >= len(best.names - each.names)
            if is_near and each.names not in fitted:
                fitted[each.names] = each
        return fitted

    def _other_forms(self, fitted: Mapping[frozenset[str], Hypothesis]) -> list[Hypothesis]:
        """The same sets of effects in other forms."""
        return [
            each
            for forms, each in self._by_forms.items()
            if each.names in fitted and forms != fitted[each.names].forms
        ]

    def _added(self, to: Hypothesis, effect: Effect) -> Hypothesis | None:
        problem, campaign = self.problem, self.problem.campaign
        beside = after_fit(problem, to.candidates)
        found, failed = [], []
        for form in effect.forms:
            if form.missing_input(campaign):
                continue
            start = best_start(beside, effect, form)
            reduction, rank = beside.chi2_reduction(start.columns(campaign))
            if chi2_p_value(rank + len(start.values), _MAX_REFINEMENT * reduction) >= EFFECT_SIGNIFICANCE:
                failed.append(start)
                continue
            [candidate] = refine(beside, [start])
            reduction, rank = beside.chi2_reduction(candidate.columns(campaign))
            if chi2_p_value(rank + len(candidate.values), reduction) < EFFECT_SIGNIFICANCE:
                whole = [replace(each, kept=np.ones_like(each.kept)) for each in (*to.candidates, candidate)]
                found.append(fit_hypothesis(problem, refine(problem, whole) if to.candidates else whole))
            elif rank:
                failed.append(candidate)
        weak = [] if found else [fit_hypothesis(problem, [*to.candidates, each]) for each in failed]
        if weak:
            best = ranked(weak)[0]
            known = self._insignificant.get(best.names, best)
            self._insignificant[best.names] = ranked([best, known])[0]
        for each in (*found, *weak):
            self._by_forms[each.forms] = ranked([each, self._by_forms.get(each.forms, each)])[0]
        return ranked(found)[0] if found else None

    def _exchanged(self, best: Hypothesis) -> Hypothesis:
        """Exchange effects as long as that is better: an early one may stand in for several."""
        for _ in range(_MAX_EXCHANGES if len(best.candidates) > 1 else 0):
            fewer = [fit_hypothesis(self.problem, best.without(one)) for one in best.candidates]
            others = [effect for effect in self.effects if effect.name not in best.names]
            found = [self.add(each, effect) for each in fewer for effect in others]
            better = [
                each
                for each in found
                if each is not None and each.is_better_than(best) and not self._objections(each)
            ]
            if not better:
                break
            best = ranked(better)[0]
        return best

    def _objections(self, of: Hypothesis) -> bool:
        return any(self.objection(of, index) for index in range(len(of.candidates)))

    def _without_largest_dwell(self, of: Hypothesis, index: int) -> tuple[int, float]:
        """The dwell with most of an effect's reduction of chi2; the p-value without it, 0 if it has little.

        One dwell may be an outlier.
        """
        problem, one = self.problem, of.candidates[index]
        beside = self._beside_others(of, index)
        after = beside.with_columns(one.columns(problem.campaign))
        explained = np.sum((beside.residuals - after.residuals) ** 2, axis=1)
        place = np.flatnonzero(problem.searched)[int(np.argmax(explained))]
        dwell = int(problem.campaign.dwell[place])
        if explained.max() <= _MAX_SHARE_OF_ONE_DWELL * explained.sum():
            return dwell, 0.0
        rest = problem.searched & (np.arange(len(problem.searched)) != place)
        without = declared_problem(problem.campaign, rest, problem.noise_scale)
        return dwell, self._p_beside(self._beside_others(of, index, without), one)

    def _p_beside_inexact(self, of: Hypothesis, index: int) -> float:
        """p-value of one effect beside the others, none of whose laws is exact; 0 without others.

        A real cause has several widths or time constants where a law has one, and acts with a delay: the
        others may have any size at other scales, and any share of the change since the dwell before.
        """
        one, campaign = of.candidates[index], self.problem.campaign
        others = of.without(one)
        if not others:
            return 0.0
        terms, _ = stack(others, campaign)
        changes = np.diff(terms, axis=0, prepend=terms[:1])
        scales = [wider.columns(campaign) for each in others for wider in each.at_other_scales]
        return self._p_beside(
            self.problem.with_columns(np.concatenate([terms, changes, *scales], axis=2)), one
        )

    def _excludes_beyond(self, of: Hypothesis, index: int) -> bool:
        """Whether what an effect becomes beyond its open end is not tied with it, if it was fitted there."""
        one = of.candidates[index]
        beyond = one.beyond_open_end
        if beyond is None:
            return True
        other = hypothesis(self.problem, [*of.without(one), beyond])
        return other.bic > of.bic + 2.0 * math.log(TIE_ODDS)

    def _p_beside(self, beside: Problem, one: Candidate) -> float:
        """p-value of a candidate beside all terms of a problem, corrected for all candidate fits."""
        reduction, rank = beside.chi2_reduction(one.columns(self.problem.campaign))
        return min(1.0, chi2_p_value(rank + len(one.values), reduction) * self.candidate_fits(one.effect))

    def _beside_others(self, of: Hypothesis, index: int, problem: Problem | None = None) -> Problem:
        """Problem after a fit of all terms of the other effects."""
        problem, others = problem or self.problem, of.without(of.candidates[index])
        return problem.with_columns(stack(others, problem.campaign)[0]) if others else problem

    def _is_special_case(self, special: Hypothesis, general: Hypothesis) -> bool:
        """Whether a hypothesis is contained in another, as fitted or with a parameter at a bound."""
        if general.parameter_count <= special.parameter_count:
            return False
        return self._is_contained(special, [general.candidates, *_at_bounds(general.candidates)])

    def _is_contained(self, special: Hypothesis, laws: Iterable[Sequence[Candidate]]) -> bool:
        """Whether one of several sets of effects reproduces a hypothesis."""
        problem, target = self.problem, stack(special.candidates, self.problem.campaign)
        return any(after_fit(problem, each).independent_share(*target) < SAME_SHARE for each in laws)


def _at_bounds(candidates: Sequence[Candidate]) -> Iterator[list[Candidate]]:
    """Candidates with one parameter at its lower bound or open end, for each that has one."""
    for place, each in enumerate(candidates):
        for index, parameter in enumerate(each.form.parameters):
            bounds = (parameter.low, parameter.high if parameter.is_open_end else -np.inf)
            for bound in filter(np.isfinite, bounds):
                values = (*each.values[:index], bound, *each.values[index + 1 :])
                yield [*candidates[:place], replace(each, values=values), *candidates[place + 1 :]]
