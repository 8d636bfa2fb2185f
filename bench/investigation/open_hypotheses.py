"""What a search leaves open: whether its cause is settled, and the hypotheses that blocks distinguish."""

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
from gyrobench.bench.closure.search import MAY_BE_LACK, NOT_SIGNIFICANT, RESTS_ON_DWELL
from gyrobench.bench.investigation.choice import Rival
from gyrobench.bench.investigation.proposal import SETTLED

#: Hypotheses less probable than this are not predicted, and at most this number is.
_MIN_PROBABILITY = 1e-3
_MAX_RIVALS = 6
#: Ageing is a hypothesis of dwells over more than this: its shortest time constant is a day.
_MIN_AGEING_S = 26.0 * 3600.0
#: A remainder below this share of each effect found is what its law lacks.
_INEXACT_SHARE = 0.25
#: Effects beside a cause that are not significant leave it open from this probability of all of them on.
_MAX_UNSHOWN = 0.5
#: Both follow the time alone: an exponential and a line together fit any law that settles slowly, as a
#: logarithm, so that they are not stated as two causes.
SLOW = frozenset({"ageing", "time_drift"})


def searched(campaign: Campaign, held_out: Sequence[int]) -> Closure:
    """Search with the effects that only the first dwells do not show, as far as they are long enough.

    A single power cycle does not exclude ageing, so that a search leaves it out; the next block may have
    another one.
    """
    effects = all_effects(*campaign.sources)
    if searched_length_s(campaign.holding_out(held_out)) > _MIN_AGEING_S:
        effects = tuple(_in_one_power_cycle(each) if each.name == "ageing" else each for each in effects)
    return close_loop(campaign, held_out, effects)


def _in_one_power_cycle(effect: Effect) -> Effect:
    return replace(effect, forms=tuple(replace(form, missing_input=lambda _: None) for form in effect.forms))


def is_settled(closure: Closure) -> bool:
    """Whether a search states its cause, or that there is nothing, with enough probability."""
    is_stated = closure.verdict in ("explained", "clean")
    return is_stated and closure.probability >= SETTLED and not closure.posterior.rivals(closure.names)


def only_unconfirmed(closure: Closure, *, with_weak: bool) -> bool:
    """Whether a cause has enough probability, and is open only since new dwells have to confirm it.

    They do where held-out dwells do not, and where something beside it that is not on the list is improbable
    but not excluded, or so small that the laws of the effects found are not exact: a block that was predicted
    can. ``with_weak``: whether others leave it open as well that a single dwell shows, or that are together
    less probable than not and not significant or no more than what the laws of the effects found may lack.
    """
    others = closure.posterior.rivals(closure.names)
    weak, unshown = (
        {each.effect.name for each in closure.evidence if each.rejected.startswith(why)} & others.keys()
        for why in (RESTS_ON_DWELL, (NOT_SIGNIFICANT, MAY_BE_LACK))
    )
    if sum(others[name] for name in unshown) < _MAX_UNSHOWN:
        weak |= unshown
    is_probable = bool(closure.names) and cause_probability(closure) >= SETTLED
    is_listed = closure.verdict == "ambiguous" and closure.posterior.not_on_list < RIVAL
    if not is_probable or not (is_listed or remainder_share(closure) < _INEXACT_SHARE):
        return False
    return not (others.keys() if with_weak else others.keys() - weak)


def remainder_share(closure: Closure) -> float:
    """Largest remainder of a search with effects, as a share of the rms of the smallest one found."""
    return remainder_dph(closure) / min(each.rms_dph for each in closure.effects)


def cause_probability(closure: Closure) -> float:
    """Probability that all effects found are there, with or without others; of nothing if there are none."""
    posterior, names = closure.posterior, closure.names
    return posterior.of_all(names, has_remainder=None) if names else posterior.nothing


def rivals_of(closure: Closure) -> tuple[Rival, ...]:
    """The most probable hypotheses of a search; together they have probability 1.

    What is improbable beside the effects found does not leave the cause open: hypotheses with all of them
    count as the first one that has the same probable others.
    """
    best = [each for each in _by_cause(closure) if each.probability > _MIN_PROBABILITY][:_MAX_RIVALS]
    total = sum(each.probability for each in best)
    effects = {each.effect.name: each.effect for each in closure.evidence}
    beyond_dph = remainder_dph(closure)
    return tuple(
        Rival(
            tuple(sorted(each.names)),
            each.candidates,
            each.probability / total,
            beyond_dph if each.has_remainder else 0.0,
            tuple(effects[name] for name in each.names - {one.effect.name for one in each.candidates}),
        )
        for each in best
    )


def _by_cause(closure: Closure) -> list[HypothesisProbability]:
    posterior, names = closure.posterior, closure.names
    others = frozenset(posterior.rivals(names))
    merged: dict[object, HypothesisProbability] = {}
    for each in posterior.hypotheses:
        is_beyond = each.has_remainder and posterior.not_on_list >= RIVAL
        is_same = bool(names) and posterior.contains(each, names)
        key = (None, each.names & others, is_beyond) if is_same else (each.names, each.has_remainder)
        first = merged.setdefault(key, replace(each, probability=0.0))
        merged[key] = replace(first, probability=first.probability + each.probability)
    return sorted(merged.values(), key=lambda each: -each.probability)


def confirming_rivals(closure: Closure) -> tuple[Rival, ...]:
    """The cause that a search found, and it without each of its effects: what a block confirms."""
    found = tuple(each.candidate for each in closure.effects)
    sets = [found, *(tuple(each for each in found if each is not one) for one in found)]
    return tuple(Rival(_names(one), one, 1.0 / len(sets)) for one in sets)


def lacking_rivals(closure: Closure) -> tuple[Rival, ...]:
    """The most probable cause, and what was found of it with laws that are not exact.

    None if they differ by more than effects that may be what the laws of those found lack, or if a law that
    contains one of these was not searched, as an ageing in a short campaign. A block shows which it is where
    the laws at other scales do something else, as after a power cycle.
    """
    best, names = closure.posterior.hypotheses[0], set(closure.names)
    lacks = {each.effect.name for each in closure.evidence if each.rejected.startswith(MAY_BE_LACK)}
    for each in closure.evidence:
        lacks -= set(each.effect.contains) if each.missing_input else set()
    is_lack = names < best.names <= names | lacks and not best.names >= SLOW
    if not is_lack or closure.posterior.of_all(best.names, has_remainder=None) < SETTLED:
        return ()
    found = [each.candidate for each in closure.effects]
    inexact = (*found, *(wider for each in found for wider in each.at_other_scales))
    return Rival(tuple(sorted(best.names)), best.candidates, 0.5), Rival(_names(found), inexact, 0.5)


def _names(candidates: Sequence[Candidate]) -> tuple[str, ...]:
    return tuple(sorted(each.effect.name for each in candidates))


def remainder_dph(closure: Closure) -> float:
    """Rms of what the model leaves beyond the noise; at least half of the noise."""
    residual_dph = (closure.campaign.bias_dph - closure.model.bias_dph)[closure.searched]
    variance = float(np.mean(residual_dph**2)) - closure.noise_dph**2
    return float(max(np.sqrt(max(variance, 0.0)), 0.5 * closure.noise_dph))
