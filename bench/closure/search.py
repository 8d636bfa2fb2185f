"""Search for effects that explain the residuals of the declared model."""

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
    hypothesis_with,
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
#: Number of hypotheses that are extended in each step.
_BEAM_WIDTH = 3
#: An effect is a special case of another if that reproduces its terms within this share of their length.
SAME_SHARE = 0.05
#: If one dwell has more than this share of an effect's reduction of chi2, the effect is tested without it.
_MAX_SHARE_OF_ONE_DWELL = 0.5
#: Assumed upper limit of the factor by which fitting the parameters increases the reduction of chi2.
_MAX_REFINEMENT = 3.0
#: Sets are about equally probable below these odds.
_EVEN_ODDS = 3.0
#: Maximum number of exchanges of effects in the best hypothesis.
_MAX_EXCHANGES = 6


#: First words of the objection to an effect that rests on a single dwell.
RESTS_ON_DWELL = "it rests on dwell"
#: First words of the objection to an effect that adds too little to others.
NOT_SIGNIFICANT = "not significant"
#: First words of the objection to an effect that may only correct the inexact laws of the others.
MAY_CORRECT_LAWS = "it may only correct the inexact laws of the others"


class Search:
    """Search of one problem, which has the declared model alone.

    ``declared``: hypothesis without effects. ``single_effects``: hypotheses of one significant effect each,
    by name.
    """

    def __init__(self, problem: Problem, effects: Sequence[Effect]) -> None:
        self.problem = problem
        self.effects = tuple(each.bounded(problem.campaign) for each in effects)
        self.declared = fit_hypothesis(problem, ())
        self._fits: dict[tuple[object, ...], Hypothesis | None] = {}
        self._best_by_forms = {self.declared.forms: self.declared}
        single_fits = {effect.name: self._fit_with_effect(self.declared, effect) for effect in self.effects}
        self.single_effects = {name: each for name, each in single_fits.items() if each is not None}

    def best(self) -> Hypothesis:
        """The hypothesis with the smallest BIC to whose effects there is no objection."""
        best = self.declared
        beam = [best]
        for _ in range(MAX_EFFECTS):
            extended: dict[frozenset[str], Hypothesis] = {}
            for smaller in beam:
                for effect in self.effects:
                    larger = self.add(smaller, effect)
                    if larger is None or self._has_objection(larger):
                        continue
                    if larger.names not in extended or larger.is_better_than(extended[larger.names]):
                        extended[larger.names] = larger
            beam = ranked(extended.values())[:_BEAM_WIDTH]
            if not beam or not beam[0].is_better_than(best):
                break
            best = beam[0]
        return self._exchange_effects(best)

    def add(self, hypothesis: Hypothesis, effect: Effect) -> Hypothesis | None:
        """Hypothesis with one more effect in its best form, fitted together; None if not significant."""
        if not hypothesis.candidates:
            return self.single_effects.get(effect.name)
        if effect.name in hypothesis.names:
            return None
        key = (
            *((each.effect.name, each.form.name, each.values) for each in hypothesis.candidates),
            effect.name,
        )
        if key not in self._fits:
            self._fits[key] = self._fit_with_effect(hypothesis, effect)
        return self._fits[key]

    def candidate_fits(self, effect: Effect) -> int:
        """Number of fits for which the p-value of an effect is corrected."""
        return start_count(effect, self.problem.campaign) * len(self.effects)

    def p_value(self, hypothesis: Hypothesis, index: int) -> float:
        """p-value of one effect of a hypothesis, corrected for all candidate fits."""
        return self._p_value_in(self._with_others(hypothesis, index), hypothesis.candidates[index])

    def objection(self, hypothesis: Hypothesis, index: int) -> str:
        """Reason not to accept one effect of a hypothesis; empty if there is none."""
        candidate, p_value = hypothesis.candidates[index], self.p_value(hypothesis, index)
        if p_value >= EFFECT_SIGNIFICANCE:
            labels = [each.effect.display_name for each in hypothesis.without(candidate)]
            beside = f" beside {listed(labels)}" if labels else ""
            return f"{NOT_SIGNIFICANT}{beside} (p = {p_value:.2g}, required below {EFFECT_SIGNIFICANCE:g})"
        if not self._is_distinct_beyond_open_end(hypothesis, index):
            return "a parameter is at its upper bound, where the effect becomes another one"
        dwell, p_without_dwell = self._test_without_largest_dwell(hypothesis, index)
        if p_without_dwell >= EFFECT_SIGNIFICANCE:
            return f"{RESTS_ON_DWELL} {dwell} alone (p = {p_without_dwell:.2g} without it)"
        return ""

    def without_corrections(self, hypothesis: Hypothesis) -> Hypothesis:
        """The hypothesis without effects that may only correct the inexact laws of the others."""
        p_values = [
            self._p_value_with_inexact_laws(hypothesis, index) for index in range(len(hypothesis.candidates))
        ]
        if max(p_values, default=0.0) < EFFECT_SIGNIFICANCE:
            return hypothesis
        fewer = fit_hypothesis(
            self.problem, hypothesis.without(hypothesis.candidates[int(np.argmax(p_values))])
        )
        return self.without_corrections(ranked([fewer, *self._in_all_forms(fewer)])[0])

    def correction_objection(self, hypothesis: Hypothesis, index: int) -> str:
        """Objection that one effect may only correct the inexact laws of the others; empty if excluded."""
        p_value = self._p_value_with_inexact_laws(hypothesis, index)
        if p_value < EFFECT_SIGNIFICANCE:
            return ""
        return f"{MAY_CORRECT_LAWS} (p = {p_value:.2g} with their laws at other scales and delayed)"

    def significant_gyros(self, hypothesis: Hypothesis, index: int) -> list[bool]:
        """Whether each gyro shows one effect of a hypothesis by itself; the most significant one does."""
        candidate = hypothesis.candidates[index]
        others, columns = self._with_others(hypothesis, index), candidate.columns(self.problem.campaign)
        gyros = [
            others.chi2_reduction(columns, candidate.kept & (np.arange(3) == gyro)[:, np.newaxis])
            for gyro in range(3)
        ]
        p_values = [chi2_p_value(max(rank, 1), reduction) for reduction, rank in gyros]
        return [p_value < EFFECT_SIGNIFICANCE or p_value == min(p_values) for p_value in p_values]

    @cached_property
    def evidences(self) -> Evidences:
        """Evidence of the hypotheses of this search."""
        return Evidences(self.problem, self.effects)

    def most_probable(self) -> tuple[Hypothesis, Posterior]:
        """The most probable set of effects without objections, and the probabilities of all sets.

        Compared are the sets of the search by BIC, and all sets with one effect added to the most probable
        one or exchanged in it, significant or not. Of about equally probable sets the simplest is selected,
        and of its forms the one with the smallest BIC unless another one is clearly more probable.
        """
        best, evidences = self.best(), self.evidences
        for _ in range(_MAX_EXCHANGES):
            self._fit_similar(best)
            fits = self._fits_near(best)
            fitted = {each.names: each for each in reversed(fits)}
            posterior = evidences.posterior(fits)
            sets = (fitted[names] for names in posterior.sets if names in fitted)
            selected = next(each for each in sets if not self._has_objection(each))
            if selected.names == best.names:
                break
            best = selected
        similar = [fitted[names] for names in posterior.similar(selected.names) if names in fitted]
        for each in similar:
            is_as_probable = posterior.odds(selected.names, each.names) < _EVEN_ODDS
            is_simpler = each.parameter_count < selected.parameter_count
            if is_simpler and is_as_probable and not self._has_objection(each):
                selected = each
        selected = self._in_most_probable_form(selected)
        return selected, replace(posterior, more_general=self._find_more_general(selected, fitted, posterior))

    def _in_most_probable_form(self, hypothesis: Hypothesis) -> Hypothesis:
        """The same set of effects in the forms that are clearly more probable, if there is no objection."""
        allowed = [each for each in self._in_all_forms(hypothesis) if not self._has_objection(each)]
        best = max(allowed, key=lambda each: self.evidences.weights(each)[0], default=hypothesis)
        is_clear = self.evidences.log_odds(best, hypothesis) >= 2.0 * math.log(_EVEN_ODDS)
        return best if is_clear else hypothesis

    def _find_more_general(
        self, selected: Hypothesis, fitted: Mapping[frozenset[str], Hypothesis], posterior: Posterior
    ) -> dict[str, frozenset[str]]:
        """For each effect found: more general laws that are less probable, or equal to it as fitted.

        Only effects that declare to contain it count. One that reproduces it in this campaign alone, as a
        step of the supply reproduces a jump, is another effect. A more general law keeps some of the
        probability even with many dwells if its fit is equal: a lag of seconds equals a rate.
        """
        general: dict[str, frozenset[str]] = {}
        selected_probability = posterior.set_probability(selected.names)
        limit = max(RIVAL, selected_probability / _EVEN_ODDS)
        for each in (fitted[names] for names in posterior.similar(selected.names) if names in fitted):
            probability = posterior.set_probability(each.names)
            [name], [other_name] = selected.names - each.names, each.names - selected.names
            law = next((fit.effect for fit in each.candidates if fit.effect.name == other_name), None)
            if law is None or name not in law.contains:
                continue
            if self._is_special_case(selected, each) and (
                probability < limit
                or (
                    probability < selected_probability and self._is_reproduced_by(each, [selected.candidates])
                )
            ):
                general[name] = general.get(name, frozenset()) | {other_name}
        return general

    def _fit_similar(self, hypothesis: Hypothesis) -> None:
        """Fit all sets with one effect added, and all with one exchanged."""
        fewer = [fit_hypothesis(self.problem, hypothesis.without(each)) for each in hypothesis.candidates]
        for each in [*fewer, hypothesis] if len(hypothesis.candidates) < MAX_EFFECTS else fewer:
            for effect in self.effects:
                self.add(each, effect)

    def _fits_near(self, best: Hypothesis) -> list[Hypothesis]:
        """Best fit of each set of effects in each combination of forms so far, smallest BIC first.

        Of the insignificant sets, only those with one effect that ``best`` does not have.
        """
        significant = {each.names for each in (*self.single_effects.values(), *self._fits.values()) if each}
        significant |= {self.declared.names, best.names}
        return [
            each
            for each in ranked(self._best_by_forms.values())
            if each.names in significant or len(each.names - best.names) == 1 >= len(best.names - each.names)
        ]

    def _in_all_forms(self, hypothesis: Hypothesis) -> list[Hypothesis]:
        """Best fit of the same set of effects in each combination of forms so far."""
        return [each for each in self._best_by_forms.values() if each.names == hypothesis.names]

    def _fit_with_effect(self, hypothesis: Hypothesis, effect: Effect) -> Hypothesis | None:
        problem, campaign = self.problem, self.problem.campaign
        problem_so_far = after_fit(problem, hypothesis.candidates)
        significant, insignificant = [], []
        for form in effect.forms:
            if form.missing_input(campaign):
                continue
            start = best_start(problem_so_far, effect, form)
            reduction, rank = problem_so_far.chi2_reduction(start.columns(campaign))
            if self._single_p_value(start, _MAX_REFINEMENT * reduction, rank) >= EFFECT_SIGNIFICANCE:
                insignificant.append(start)
                continue
            [candidate] = refine(problem_so_far, [start])
            reduction, rank = problem_so_far.chi2_reduction(candidate.columns(campaign))
            if self._single_p_value(candidate, reduction, rank) < EFFECT_SIGNIFICANCE:
                all_terms = [
                    replace(each, kept=np.ones_like(each.kept))
                    for each in (*hypothesis.candidates, candidate)
                ]
                significant.append(
                    fit_hypothesis(
                        problem, refine(problem, all_terms) if hypothesis.candidates else all_terms
                    )
                )
            elif rank:
                insignificant.append(candidate)
        weak_fits = (
            []
            if significant
            else [fit_hypothesis(problem, [*hypothesis.candidates, each]) for each in insignificant]
        )
        for each in (*significant, *weak_fits):
            self._best_by_forms[each.forms] = ranked([each, self._best_by_forms.get(each.forms, each)])[0]
        return ranked(significant)[0] if significant else None

    def _exchange_effects(self, best: Hypothesis) -> Hypothesis:
        """Exchange effects while the BIC falls: an effect added early may substitute for several others."""
        for _ in range(_MAX_EXCHANGES if len(best.candidates) > 1 else 0):
            fewer = [fit_hypothesis(self.problem, best.without(candidate)) for candidate in best.candidates]
            others = [effect for effect in self.effects if effect.name not in best.names]
            exchanged = [self.add(each, effect) for each in fewer for effect in others]
            better = [
                each
                for each in exchanged
                if each is not None and each.is_better_than(best) and not self._has_objection(each)
            ]
            if not better:
                break
            best = ranked(better)[0]
        return best

    def _has_objection(self, hypothesis: Hypothesis) -> bool:
        return any(self.objection(hypothesis, index) for index in range(len(hypothesis.candidates)))

    def _test_without_largest_dwell(self, hypothesis: Hypothesis, index: int) -> tuple[int, float]:
        """The dwell with the largest share of an effect's reduction of chi2, and the p-value without it.

        The p-value is 0 if the share is small. One dwell may be an outlier.
        """
        problem, candidate = self.problem, hypothesis.candidates[index]
        with_others = self._with_others(hypothesis, index)
        after = with_others.with_columns(candidate.columns(problem.campaign))
        reductions = np.sum((with_others.residuals - after.residuals) ** 2, axis=1)
        largest = np.flatnonzero(problem.searched)[int(np.argmax(reductions))]
        dwell = int(problem.campaign.dwell[largest])
        if reductions.max() <= _MAX_SHARE_OF_ONE_DWELL * reductions.sum():
            return dwell, 0.0
        remaining = problem.searched & (np.arange(len(problem.searched)) != largest)
        without_dwell = declared_problem(problem.campaign, remaining, problem.noise_scale)
        return dwell, self._p_value_in(self._with_others(hypothesis, index, without_dwell), candidate)

    def _p_value_with_inexact_laws(self, hypothesis: Hypothesis, index: int) -> float:
        """p-value of one effect if the laws of the others are inexact; 0 without others.

        A real effect has several widths or time constants where its law has one, and acts with a delay. The
        others therefore get free terms at other scales, and free terms of their change since the previous
        dwell.
        """
        candidate, campaign = hypothesis.candidates[index], self.problem.campaign
        others = hypothesis.without(candidate)
        if not others:
            return 0.0
        terms, _ = stack(others, campaign)
        changes = np.diff(terms, axis=0, prepend=terms[:1])
        scales = [scaled.columns(campaign) for each in others for scaled in each.at_other_scales]
        return self._p_value_in(
            self.problem.with_columns(np.concatenate([terms, changes, *scales], axis=2)), candidate
        )

    def _is_distinct_beyond_open_end(self, fitted: Hypothesis, index: int) -> bool:
        """Whether an effect at its open end is distinct from what it becomes beyond; True elsewhere."""
        candidate = fitted.candidates[index]
        beyond = candidate.beyond_open_end
        if beyond is None:
            return True
        other = hypothesis_with(self.problem, [*fitted.without(candidate), beyond])
        return other.bic > fitted.bic + 2.0 * math.log(TIE_ODDS)

    def _p_value_in(self, problem: Problem, candidate: Candidate) -> float:
        """p-value of a candidate added to a problem, corrected for all candidate fits."""
        reduction, rank = problem.chi2_reduction(candidate.columns(self.problem.campaign))
        return min(
            1.0, self._single_p_value(candidate, reduction, rank) * self.candidate_fits(candidate.effect)
        )

    def _single_p_value(self, candidate: Candidate, reduction: float, rank: int) -> float:
        """p-value of a candidate's reduction of chi2 with ``rank`` terms, as if it were the only fit."""
        return chi2_p_value(rank + len(candidate.values), reduction / self.problem.correlation_factor)

    def _with_others(self, hypothesis: Hypothesis, index: int, problem: Problem | None = None) -> Problem:
        """Problem after a fit of all terms of the other effects."""
        problem, others = problem or self.problem, hypothesis.without(hypothesis.candidates[index])
        return problem.with_columns(stack(others, problem.campaign)[0]) if others else problem

    def _is_special_case(self, special: Hypothesis, general: Hypothesis) -> bool:
        """Whether another hypothesis reproduces this one, as fitted or with a parameter at a bound."""
        if general.parameter_count <= special.parameter_count:
            return False
        return self._is_reproduced_by(special, [general.candidates, *_at_bounds(general.candidates)])

    def _is_reproduced_by(self, special: Hypothesis, laws: Iterable[Sequence[Candidate]]) -> bool:
        """Whether any of several sets of effects reproduces a hypothesis."""
        problem, target = self.problem, stack(special.candidates, self.problem.campaign)
        return any(after_fit(problem, each).independent_share(*target) < SAME_SHARE for each in laws)


def _at_bounds(candidates: Sequence[Candidate]) -> Iterator[list[Candidate]]:
    """Candidates with one parameter set to its lower bound or open end, for each such parameter in turn."""
    for candidate_index, each in enumerate(candidates):
        for parameter_index, parameter in enumerate(each.form.parameters):
            bounds = (parameter.low, parameter.high if parameter.is_open_end else -np.inf)
            for bound in filter(np.isfinite, bounds):
                at_bound = each.with_value(parameter_index, bound)
                yield [*candidates[:candidate_index], at_bound, *candidates[candidate_index + 1 :]]
