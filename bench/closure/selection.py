"""Which hypothesis stands: searched in its own noise, cross-validated by cycles, the others with reasons."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gyrobench.bench.closure.campaign import Campaign
from gyrobench.bench.closure.candidates import Candidate, Hypothesis, evaluate, hypothesis, stack
from gyrobench.bench.closure.effects.effect import Effect
from gyrobench.bench.closure.noise import Noise, estimate_noise
from gyrobench.bench.closure.problem import Problem, declared_problem
from gyrobench.bench.closure.search import MAX_EFFECTS, SIGNIFICANCE, Search
from gyrobench.bench.closure.validation import LackOfFit, LeftOut, lack_of_fit, leave_out_cycles, pooled_gain
from gyrobench.bench.foundations.arrays import BoolArray
from gyrobench.bench.foundations.text import listed

#: If a lack of fit remains, an effect is kept only if cross-validation confirms it: it explains this share of
#: the chi2 of all cycles left out, and lowers it in this share of the cycles.
CONFIRMED_SHARE, CONFIRMED_CYCLES = 0.5, 0.75
#: Hypotheses that explain at least this share are extended, at most so many in each step.
EXTENDED_SHARE, EXTENDED_HYPOTHESES = 0.3, 4
#: Gains that differ by less are equal: the simpler hypothesis is preferred.
_GAIN_STEP = 0.01
#: Searches in a noise estimated beside what the one before found.
_MAX_SEARCHES = 4


@dataclass(frozen=True)
class Selected:
    """The hypothesis that stands."""

    noise: Noise  #: Beside it.
    search: Search  #: With that noise.
    found: Hypothesis  #: The effects found; the declared model alone if there are none.
    after: LackOfFit  #: Test of its residual.

    def rejection(self, effect: Effect) -> str:
        """Why an effect that is significant alone is not found; empty for all others."""
        search, found = self.search, self.found
        alone = search.alone.get(effect.name)
        if alone is None or effect.name in found.names or search.p_value(alone, 0) >= SIGNIFICANCE:
            return ""
        with_it = search.add(found, effect)
        if with_it is None:
            return f"not significant beside {_labels(found)}"
        place = [each.effect.name for each in with_it.candidates].index(effect.name)
        objection = search.objection(with_it, place)
        cycles, must_confirm = (
            _left_out(search.problem, with_it, with_it.candidates[place]),
            self.after.is_significant,
        )
        if not objection and (cycles or must_confirm):
            objection = _contradiction(cycles, must_confirm=must_confirm)
        return objection or (f"{_labels(found)} alone fits as well" if found.names else "not confirmed")


def _labels(of: Hypothesis) -> str:
    return listed([each.effect.display_name for each in of.candidates])


def select(campaign: Campaign, searched: BoolArray, effects: Sequence[Effect]) -> Selected:
    """Search the dwells ``searched`` (n,) of a campaign, which has the stated uncertainties.

    The noise is estimated beside the declared model and beside the effects found. A few disturbed dwells
    look like an effect, and an effect in a few dwells looks like outliers: if either noise is not as
    stated, both are searched, and the one stands that describes all dwells better.
    """
    stated, alone = Noise.stated(campaign), estimate_noise(campaign, searched)
    settled = [_settled(campaign, searched, effects, stated)]
    if not alone.is_like(stated):
        settled.append(_settled(campaign, searched, effects, alone))
    if all(_test(each.problem, found).is_significant for _, each, found in settled):
        smooth = estimate_noise(campaign, searched, smooth=True)
        if smooth.outliers:
            settled.append(_settled(campaign, searched, effects, smooth))
    noise, search, found = min(settled, key=lambda each: each[0].cost(each[2].bic, int(searched.sum())))
    after = _test(search.problem, found)
    if after.is_significant:
        found = _confirmed(search, after.noise_ratio)
        after = _test(search.problem, found)
    return Selected(noise, search, found, after)


def _settled(
    campaign: Campaign, searched: BoolArray, effects: Sequence[Effect], noise: Noise
) -> tuple[Noise, Search, Hypothesis]:
    """Search again as long as the noise beside what is found is another one than that of the search."""
    is_last = False
    for _ in range(_MAX_SEARCHES):
        used, search = noise, Search(noise.problem(campaign, searched), effects)
        found = _without_contradicted(search)
        noise = estimate_noise(campaign, searched, found.candidates)
        if is_last or noise.is_like(used):
            break
        # Scatter that has structure beside another set of effects is not noise.
        is_last = noise.scale == 1.0 < used.scale
    return used, search, found


def _without_contradicted(search: Search) -> Hypothesis:
    """Best hypothesis without the effects that raise the chi2 of cycles to which they were not fitted."""
    problem, found = search.problem, search.best()
    for each in reversed(found.candidates):
        cycles = _left_out(problem, found, each)
        if cycles and _contradiction(cycles, must_confirm=False):
            found = evaluate(problem, found.without(each))
    return found


def _test(problem: Problem, found: Hypothesis) -> LackOfFit:
    if not found.candidates:
        return lack_of_fit(problem, 0)
    after = problem.with_columns(*stack(found.candidates, problem.campaign))
    return lack_of_fit(after, sum(len(each.values) for each in found.candidates))


def _confirmed(of: Search, noise_ratio: float) -> Hypothesis:
    """The hypothesis confirmed by cross-validation, where a lack of fit remains.

    The residual takes the place of the noise. Hypotheses grow by their gain in cycles left out; the one
    with the largest gain is chosen of those of which each effect is confirmed beside the others.
    """
    scale = of.problem.noise_scale * noise_ratio
    search = of.with_problem(declared_problem(of.problem.campaign, of.problem.searched, scale))
    best, best_gain, beam = search.declared, 0.0, [search.declared]
    for _ in range(MAX_EFFECTS):
        larger = [each for one in beam for effect in search.effects if (each := search.add(one, effect))]
        gains = np.array(
            [pooled_gain(leave_out_cycles(search.problem, (), each.candidates).values()) for each in larger]
        )
        parameters = [each.parameter_count for each in larger]
        order = np.lexsort((np.array(parameters), -np.round(gains, 2)))[:EXTENDED_HYPOTHESES]
        beam = [larger[index] for index in order if gains[index] > EXTENDED_SHARE]
        for each, gain in zip(beam, (gains[index] for index in order), strict=False):
            confirmed = all(_is_confirmed(search.problem, each, one) for one in each.candidates)
            if confirmed and gain > best_gain + _GAIN_STEP:
                best, best_gain = each, gain
    return hypothesis(of.problem, best.candidates)


def _is_confirmed(problem: Problem, of: Hypothesis, one: Candidate) -> bool:
    """Whether one effect explains most of the chi2 of cycles left out, and lowers it in most of them."""
    return not one.is_at_open_end and not _contradiction(_left_out(problem, of, one), must_confirm=True)


def _left_out(problem: Problem, of: Hypothesis, one: Candidate) -> list[LeftOut]:
    """Each cycle with and without one effect."""
    return list(leave_out_cycles(problem, of.without(one), of.candidates).values())


def _contradiction(cycles: Sequence[LeftOut], *, must_confirm: bool) -> str:
    """What cycles left out have against an effect; empty if nothing."""
    gain = pooled_gain(cycles)
    better = sum(each.gain > 0.0 for each in cycles)
    if must_confirm and not cycles:
        return "no cycle left out can confirm it, and a residual remains"
    if must_confirm and better < CONFIRMED_CYCLES * len(cycles):
        return f"it lowers chi2 in only {better} of {len(cycles)} cycles to which it was not fitted"
    if gain <= 0.0:
        return "it raises the chi2 of cycles to which it was not fitted"
    if must_confirm and gain <= CONFIRMED_SHARE:
        return (
            f"it explains {100.0 * gain:.0f} % of the chi2 of cycles to which it was not fitted; "
            f"required where a residual remains: {100.0 * CONFIRMED_SHARE:.0f} %"
        )
    return ""
