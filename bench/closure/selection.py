"""Selects the most probable hypothesis, with the noise estimated for it; gives the reasons against others."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from gyrobench.bench.closure.campaign import Campaign
from gyrobench.bench.closure.candidates import Hypothesis, after_fit, fit_hypothesis, refine
from gyrobench.bench.closure.effects.effect import Effect
from gyrobench.bench.closure.noise import CampaignNoise, estimate_campaign_noise, outweighing_dwell
from gyrobench.bench.closure.posterior import Posterior
from gyrobench.bench.closure.problem import Problem
from gyrobench.bench.closure.search import EFFECT_SIGNIFICANCE, NOT_SIGNIFICANT, Search
from gyrobench.bench.closure.validation import LackOfFit, lack_of_fit
from gyrobench.bench.foundations.arrays import BoolArray
from gyrobench.bench.foundations.text import listed, plain_name

#: Maximum number of searches, each with the noise estimated with the effects of the previous one.
_MAX_SEARCHES = 4


@dataclass(frozen=True)
class NotAccepted:
    """A probable set of effects that was not accepted."""

    names: tuple[str, ...]  #: Names of the effects.
    probability: float  #: Of the set, with or without a remainder.
    reason: str  #: The objection to the set.


@dataclass(frozen=True)
class Selected:
    """Outcome of the searches: the selected hypothesis, its noise and the search that gave it."""

    noise: CampaignNoise  #: Noise with which the search was made.
    search: Search
    best: Hypothesis  #: The most probable hypothesis without objections.
    posterior: Posterior  #: Probabilities of all sets of effects.

    @cached_property
    def accepted(self) -> Hypothesis:
        """Effects of the best hypothesis, without those that only correct the law of another."""
        return self.search.without_corrections(self.best)

    @cached_property
    def problem_with_effects(self) -> Problem:
        """The problem after a fit of the effects of the best hypothesis."""
        return after_fit(self.search.problem, self.best.candidates)

    @cached_property
    def residual_test(self) -> LackOfFit:
        """Lack-of-fit test of the residual with the effects of the best hypothesis."""
        return lack_of_fit(self.problem_with_effects, sum(len(each.values) for each in self.best.candidates))

    @property
    def cost(self) -> float:
        """Cost of the best hypothesis; see :meth:`~.noise.CampaignNoise.cost`."""
        return self.noise.cost(self.best.bic, int(self.search.problem.searched.sum()))

    @property
    def not_accepted(self) -> NotAccepted | None:
        """The most probable set of effects and the reason against it; None if effects are accepted."""
        names = next(filter(None, self.posterior.sets), None)
        if self.accepted.candidates or names is None:
            return None
        probability = sum(each.probability for each in self.posterior.hypotheses if each.names == names)
        reason = next(filter(None, self._objections(names).values()), "")
        reason = reason or "the declared model alone is simpler or more probable"
        return NotAccepted(tuple(sorted(names)), probability, reason)

    def rejection(self, effect: Effect) -> str:
        """Reason against an effect that is significant alone or a rival; otherwise empty."""
        search, accepted = self.search, self.accepted
        single_effect = search.single_effects.get(effect.name)
        is_significant = single_effect is not None and search.p_value(single_effect, 0) < EFFECT_SIGNIFICANCE
        is_rival = effect.name in self.posterior.rivals(accepted.names)
        if effect.name in accepted.names or not (is_significant or is_rival):
            return ""
        for names in itertools.takewhile(lambda each: each != accepted.names, self.posterior.sets):
            objections = self._objections(names)
            if objection := objections.get(effect.name):
                return objection
            if effect.name in objections and any(objections.values()):
                label, objection = next((label, text) for label, text in objections.items() if text)
                return f"combined with {plain_name(label)}, which is not accepted: {objection}"
        labels = listed([each.effect.display_name for each in accepted.candidates])
        with_effect = search.add(accepted, effect)
        if with_effect is None:
            return f"{NOT_SIGNIFICANT} beside {labels}"
        index = [each.effect.name for each in with_effect.candidates].index(effect.name)
        beside = f"{labels} alone" if labels else "the declared model alone"
        reason = f"{beside} is about as probable and simpler"
        if self.posterior.unlisted_probability > 0.5:
            reason = "an unlisted effect is more probable"
        return (
            search.objection(with_effect, index) or search.correction_objection(with_effect, index) or reason
        )

    def _objections(self, names: frozenset[str]) -> dict[str, str]:
        """Objection to each effect of a set of the posterior, by name; empty text without one."""
        candidates = next(each.candidates for each in self.posterior.hypotheses if each.names == names)
        fitted = fit_hypothesis(self.search.problem, candidates)
        return {
            each.effect.name: self.search.objection(fitted, index)
            or self.search.correction_objection(fitted, index)
            for index, each in enumerate(fitted.candidates)
        }


def select(campaign: Campaign, searched: BoolArray, effects: Sequence[Effect]) -> Selected:
    """Search the dwells ``searched`` (n,) of a campaign, which has the stated uncertainties.

    The noise is estimated with the declared model alone and with the effects found. A few disturbed dwells
    look like an effect, and an effect in a few dwells looks like outliers. If one of these noises is not as
    stated, a search is made with each, and the one that describes all dwells best is selected.

    If one dwell outweighs all others, nearly every effect looks significant, and all sets of three would be
    fitted to that dwell. An effect must not rest on one dwell: the first search down-weights it as an
    outlier. The effects found are then fitted with it, which shows whether it is one.
    """
    stated, declared_noise = CampaignNoise.stated(campaign), estimate_campaign_noise(campaign, searched)
    first_noise = outweighing_dwell(campaign, searched)
    selections = [_search_until_consistent(campaign, searched, effects, first_noise)]
    candidates = selections[0].best.candidates
    if first_noise.outliers and candidates:
        fitted = refine(stated.problem(campaign, searched), candidates)
        effects_noise = estimate_campaign_noise(campaign, searched, fitted)
        if not effects_noise.is_close_to(selections[0].noise):
            selections.append(_search_until_consistent(campaign, searched, effects, effects_noise))
    if not (declared_noise.is_close_to(stated) or declared_noise.is_close_to(first_noise)):
        selections.append(_search_until_consistent(campaign, searched, effects, declared_noise))
    if all(each.residual_test.is_significant for each in selections):
        smooth_noise = estimate_campaign_noise(campaign, searched, smooth=True)
        if smooth_noise.outliers and not smooth_noise.has_same_outliers(first_noise):
            selections.append(_search_until_consistent(campaign, searched, effects, smooth_noise))
    return min(selections, key=lambda each: each.cost)


def _search_until_consistent(
    campaign: Campaign, searched: BoolArray, effects: Sequence[Effect], noise: CampaignNoise
) -> Selected:
    """Repeat the search until the noise estimated with its effects is the noise that it was made with."""
    is_last = False
    for _ in range(_MAX_SEARCHES):
        search = Search(noise.problem(campaign, searched), effects)
        selected = Selected(noise, search, *search.most_probable())
        if noise.outliers and not selected.best.candidates:
            # No effect explains the outliers, but the scale may have been estimated with an effect.
            noise = noise.without_effects(campaign, searched)
            if is_last or noise.is_close_to(selected.noise):
                break
            is_last = True
            continue
        noise = estimate_campaign_noise(campaign, searched, selected.best.candidates)
        if is_last or noise.is_close_to(selected.noise):
            break
        # Scatter that has structure with another set of effects is not noise.
        is_last = bool(np.all(noise.scales == 1.0) and np.any(selected.noise.scales != 1.0))
    return selected
