"""Hypotheses that a search leaves open, to be distinguished by blocks; whether one is settled."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from gyrobench.bench.closure.campaign import Campaign
from gyrobench.bench.closure.candidates import Candidate
from gyrobench.bench.closure.effects import all_effects
from gyrobench.bench.closure.effects.effect import Effect, searched_length_s
from gyrobench.bench.closure.loop import close_loop
from gyrobench.bench.closure.outcome import Closure
from gyrobench.bench.closure.posterior import RIVAL, HypothesisProbability
from gyrobench.bench.closure.search import MAY_CORRECT_LAWS, NOT_SIGNIFICANT, RESTS_ON_DWELL
from gyrobench.bench.investigation.choice import Rival
from gyrobench.bench.investigation.proposal import SETTLED

#: Smallest probability, and largest number, of the hypotheses that are predicted.
_MIN_PROBABILITY = 1e-3
_MAX_RIVALS = 6
#: Ageing is a hypothesis only if the dwells span more than this: its shortest time constant is a day.
_MIN_AGEING_S = 26.0 * 3600.0
#: A remainder below this share of each effect found counts as an error of its law.
_INEXACT_SHARE = 0.25
#: Insignificant effects leave a hypothesis open if their total probability is at least this.
_MAX_INSIGNIFICANT = 0.5
#: Both depend on time only. An exponential plus a line fits any slow relaxation, such as a logarithm, so they
#: are not stated as two effects.
SLOW = frozenset({"ageing", "time_drift"})


def search_campaign(campaign: Campaign, held_out: Sequence[int]) -> Closure:
    """Search a campaign, including ageing if the campaign is long enough.

    A search omits ageing in a single power cycle, which can't distinguish it from a warm-up. The next block
    may add a power cycle, so ageing must remain a hypothesis.
    """
    effects = all_effects(*campaign.sources)
    if searched_length_s(campaign.holding_out(held_out)) > _MIN_AGEING_S:
        effects = tuple(_in_one_power_cycle(each) if each.name == "ageing" else each for each in effects)
    return close_loop(campaign, held_out, effects)


def _in_one_power_cycle(effect: Effect) -> Effect:
    return replace(effect, forms=tuple(replace(form, missing_input=lambda _: None) for form in effect.forms))


def is_settled(closure: Closure) -> bool:
    """Whether a search states effects, or that there are none, with enough probability."""
    is_stated = closure.verdict in ("explained", "clean")
    return is_stated and closure.probability >= SETTLED and not closure.posterior.rivals(closure.names)


def only_unconfirmed(closure: Closure, *, with_weak: bool) -> bool:
    """Whether the effects found have enough probability and lack only a confirmation by new dwells.

    A confirmation is missing if the held-out dwells do not give it, or if an additional unlisted effect is
    improbable but not excluded, or so small that it may be an error of the laws found. ``with_weak``: whether
    weak rivals keep them open too. Weak are those that rest on one dwell; and those that are not
    significant, or may only correct the laws of the effects found, if they are together improbable.
    """
    others = closure.posterior.rivals(closure.names)
    weak, insignificant = (
        {each.effect.name for each in closure.evidence if each.rejected.startswith(prefix)} & others.keys()
        for prefix in (RESTS_ON_DWELL, (NOT_SIGNIFICANT, MAY_CORRECT_LAWS))
    )
    if sum(others[name] for name in insignificant) < _MAX_INSIGNIFICANT:
        weak |= insignificant
    is_probable = bool(closure.names) and probability_of_found(closure) >= SETTLED
    is_listed = closure.verdict == "ambiguous" and closure.posterior.unlisted_probability < RIVAL
    if not is_probable or not (is_listed or remainder_share(closure) < _INEXACT_SHARE):
        return False
    return not (others.keys() if with_weak else others.keys() - weak)


def remainder_share(closure: Closure) -> float:
    """Remainder of a search as a share of the rms of the smallest effect found."""
    return remainder_dph(closure) / min(each.rms_dph for each in closure.effects)


def probability_of_found(closure: Closure) -> float:
    """Probability that all effects found are present, with or without others; of none if none is found."""
    posterior, names = closure.posterior, closure.names
    return (
        posterior.joint_probability(names, has_remainder=None) if names else posterior.no_effect_probability
    )


def rivals_of(closure: Closure) -> tuple[Rival, ...]:
    """The most probable hypotheses of a search, with probabilities normalized to 1.

    Additional improbable effects do not leave it open: hypotheses that include all effects found and
    the same probable other effects are merged.
    """
    best = [each for each in _merged_by_found(closure) if each.probability > _MIN_PROBABILITY][:_MAX_RIVALS]
    total = sum(each.probability for each in best)
    effects = {each.effect.name: each.effect for each in closure.evidence}
    unlisted_dph = remainder_dph(closure)
    return tuple(
        Rival(
            tuple(sorted(each.names)),
            each.candidates,
            each.probability / total,
            unlisted_dph if each.has_remainder else 0.0,
            tuple(
                effects[name]
                for name in each.names - {candidate.effect.name for candidate in each.candidates}
            ),
        )
        for each in best
    )


def _merged_by_found(closure: Closure) -> list[HypothesisProbability]:
    posterior, names = closure.posterior, closure.names
    others = frozenset(posterior.rivals(names))
    merged: dict[object, HypothesisProbability] = {}
    for each in posterior.hypotheses:
        is_unlisted = each.has_remainder and posterior.unlisted_probability >= RIVAL
        has_found = bool(names) and posterior.contains(each, names)
        key = (None, each.names & others, is_unlisted) if has_found else (each.names, each.has_remainder)
        first = merged.setdefault(key, replace(each, probability=0.0))
        merged[key] = replace(first, probability=first.probability + each.probability)
    return sorted(merged.values(), key=lambda each: -each.probability)


def confirming_rivals(closure: Closure) -> tuple[Rival, ...]:
    """The effects that a search found, and these without each of them, for a confirming block."""
    found = tuple(each.candidate for each in closure.effects)
    sets = [found, *(tuple(each for each in found if each is not omitted) for omitted in found)]
    return tuple(Rival(_names(each), each, 1.0 / len(sets)) for each in sets)


def inexact_law_rivals(closure: Closure) -> tuple[Rival, ...]:
    """The most probable hypothesis, and the effects found with inexact laws.

    Empty unless they differ only in effects that may only correct the laws of those found, or if a law that
    contains one of these was not searched, such as ageing in a short campaign. A block distinguishes them if
    the laws at other scales behave differently in it, such as after a power cycle.
    """
    best, names = closure.posterior.hypotheses[0], set(closure.names)
    corrections = {
        each.effect.name for each in closure.evidence if each.rejected.startswith(MAY_CORRECT_LAWS)
    }
    for each in closure.evidence:
        corrections -= set(each.effect.contains) if each.missing_input else set()
    differs_in_corrections = names < best.names <= names | corrections and not best.names >= SLOW
    if (
        not differs_in_corrections
        or closure.posterior.joint_probability(best.names, has_remainder=None) < SETTLED
    ):
        return ()
    found = [each.candidate for each in closure.effects]
    inexact = (*found, *(scaled for each in found for scaled in each.at_other_scales))
    return Rival(tuple(sorted(best.names)), best.candidates, 0.5), Rival(_names(found), inexact, 0.5)


def _names(candidates: Sequence[Candidate]) -> tuple[str, ...]:
    return tuple(sorted(each.effect.name for each in candidates))


def remainder_dph(closure: Closure) -> float:
    """Rms of the residual beyond the noise; at least half of the noise."""
    residual_dph = (closure.campaign.bias_dph - closure.model.bias_dph)[closure.searched]
    variance = float(np.mean(residual_dph**2)) - closure.noise_dph**2
    return float(max(np.sqrt(max(variance, 0.0)), 0.5 * closure.noise_dph))
