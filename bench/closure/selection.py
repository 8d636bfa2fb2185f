"""Which hypothesis stands: the most probable one in its own noise, and why others do not."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

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

#: Searches in a noise estimated beside what the one before found.
_MAX_SEARCHES = 4


@dataclass(frozen=True)
class NotAccepted:
    """A probable set of effects that is not found."""

    names: tuple[str, ...]  #: Effects.
    probability: float  #: Of the set, with or without a remainder.
    reason: str  #: The objection to it.


@dataclass(frozen=True)
class Selected:
    """The hypothesis that stands."""

    noise: CampaignNoise  #: Of the search.
    search: Search
    best: Hypothesis  #: The most probable one without an objection.
    posterior: Posterior  #: Probabilities of all sets of effects.

    @cached_property
    def found(self) -> Hypothesis:
        """The effects found: those of the best that are no lack of the others' laws; none, if it has none."""
        return self.search.without_lacks(self.best)

    @cached_property
    def with_effects(self) -> Problem:
        """The problem after a fit of the best effects."""
        return after_fit(self.search.problem, self.best.candidates)

    @cached_property
    def after(self) -> LackOfFit:
        """Test of the residual with the best effects."""
        return lack_of_fit(self.with_effects, sum(len(each.values) for each in self.best.candidates))

    @property
    def cost(self) -> float:
        """See :meth:`~.noise.CampaignNoise.cost`."""
        return self.noise.cost(self.best.bic, int(self.search.problem.searched.sum()))

    @property
    def not_accepted(self) -> NotAccepted | None:
        """The most probable set of effects, and why it is not found; None if effects are found."""
        names = next(filter(None, self.posterior.sets), None)
        if self.found.candidates or names is None:
            return None
        probability = sum(each.probability for each in self.posterior.hypotheses if each.names == names)
        reason = next(filter(None, self._objections(names).values()), "")
        reason = reason or "the declared model alone is simpler or more probable"
        return NotAccepted(tuple(sorted(names)), probability, reason)

    def rejection(self, effect: Effect) -> str:
        """Why an effect that is significant alone, or not improbable, is not found; empty for all others."""
        search, found = self.search, self.found
        alone = search.alone.get(effect.name)
        is_shown = alone is not None and search.p_value(alone, 0) < EFFECT_SIGNIFICANCE
        if effect.name in found.names or not (is_shown or effect.name in self.posterior.rivals(found.names)):
            return ""
        for names in itertools.takewhile(lambda each: each != found.names, self.posterior.sets):
            objections = self._objections(names)
            if objection := objections.get(effect.name):
                return objection
            if effect.name in objections and any(objections.values()):
                label, objection = next((label, text) for label, text in objections.items() if text)
                return f"{plain_name(label)} beside it is not accepted: {objection}"
        labels = listed([each.effect.display_name for each in found.candidates])
        with_it = search.add(found, effect)
        if with_it is None:
            return f"{NOT_SIGNIFICANT} beside {labels}"
        place = [each.effect.name for each in with_it.candidates].index(effect.name)
        beside = f"{labels} alone" if labels else "the declared model alone"
        reason = f"{beside} is about as probable and simpler"
        if self.posterior.not_on_list > 0.5:
            reason = "an unlisted effect is more probable"
        return search.objection(with_it, place) or search.lack(with_it, place) or reason

    def _objections(self, names: frozenset[str]) -> dict[str, str]:
        """The objection to each effect of a set of the posterior; empty if there is none."""
        fits = [each.candidates for each in self.posterior.hypotheses if each.names == names]
        fitted = fit_hypothesis(self.search.problem, fits[0])
        return {
            each.effect.name: self.search.objection(fitted, index) or self.search.lack(fitted, index)
            for index, each in enumerate(fitted.candidates)
        }


def select(campaign: Campaign, searched: BoolArray, effects: Sequence[Effect]) -> Selected:
    """Search the dwells ``searched`` (n,) of a campaign, which has the stated uncertainties.

    The noise is estimated beside the declared model and beside the effects found. A few disturbed dwells
    look like an effect, and an effect in a few dwells looks like outliers: if either noise is not as
    stated, both are searched, and the one stands that describes all dwells better.

    Beside a dwell that outweighs all others nearly every effect looks significant, and all sets of three
    would be fitted to it. An effect must not rest on one dwell: it is found without this one too, and then
    fitted to it, which shows whether the dwell is an outlier.
    """
    stated, alone = CampaignNoise.stated(campaign), estimate_campaign_noise(campaign, searched)
    first = outweighing_dwell(campaign, searched)
    settled = [_settled(campaign, searched, effects, first)]
    found = settled[0].best.candidates
    if first.outliers and found:
        fitted = refine(stated.problem(campaign, searched), found)
        beside = estimate_campaign_noise(campaign, searched, fitted)
        if not beside.is_like(settled[0].noise):
            settled.append(_settled(campaign, searched, effects, beside))
    if not (alone.is_like(stated) or alone.is_like(first)):
        settled.append(_settled(campaign, searched, effects, alone))
    if all(each.after.is_significant for each in settled):
        smooth = estimate_campaign_noise(campaign, searched, smooth=True)
        if smooth.outliers and not smooth.has_outliers_of(first):
            settled.append(_settled(campaign, searched, effects, smooth))
    return min(settled, key=lambda each: each.cost)


def _settled(
    campaign: Campaign, searched: BoolArray, effects: Sequence[Effect], noise: CampaignNoise
) -> Selected:
    """Search again as long as the noise beside what is found is another one than that of the search."""
    is_last = False
    for _ in range(_MAX_SEARCHES):
        search = Search(noise.problem(campaign, searched), effects)
        selected = Selected(noise, search, *search.most_probable())
        if noise.outliers and not selected.best.candidates:
            # No effect accounts for the outliers, but what is left may have been noise beside an effect.
            noise = noise.beside_none(campaign, searched)
            if is_last or noise.is_like(selected.noise):
                break
            is_last = True
            continue
        noise = estimate_campaign_noise(campaign, searched, selected.best.candidates)
        if is_last or noise.is_like(selected.noise):
            break
        # Scatter that has structure beside another set of effects is not noise.
        is_last = noise.scale == 1.0 < selected.noise.scale
    return selected
