"""Closing the loop on one campaign: residual, effects, verdict, error before and after."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bench.closure.campaign import Campaign
from bench.closure.candidate import Candidate, stack
from bench.closure.confirmation import gains_by_cycle, without_unseen_constants
from bench.closure.effect_set import EffectSet, evaluate, price
from bench.closure.effects import all_effects
from bench.closure.effects.effect import Effect
from bench.closure.lack_of_fit import LackOfFit, lack_of_fit
from bench.closure.problem import Problem, Solution, declared_problem, solve
from bench.closure.search import Search
from bench.errors import MeasurementError
from bench.navigation.positions import AXES

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

#: Below this probability of chance something is left.
LEFT_OVER_P = 1e-3
#: Stated uncertainties are believed to this factor; scatter beyond them that follows nothing is noise.
NOISE_TOLERANCE = 1.25
#: Beside something unexplained an effect stays only if it takes away this share in every other cycle.
PROVEN_SHARE = 0.5
_NO_STRUCTURE_P = 0.05


@dataclass(frozen=True)
class FoundEffect:
    """An effect that the data show.

    Attributes
    ----------
    candidate : Candidate
        The effect, its form and parameters.
    sizes_dph : ndarray, shape (3, k)
        Size of each term for each gyro; zero where the gyro does without.
    axes : tuple of str
        Gyros that show it.
    p_value : float
        Probability that chance gives as much, over all that was tried.
    rms_dph : float
        Its size in the dwells searched, without its mean.
    gains : dict of int to float
        See :func:`bench.closure.confirmation.gains_by_cycle`.
    tied_with : tuple of str
        Effects that the data can't tell from it.
    """

    candidate: Candidate
    sizes_dph: FloatArray
    axes: tuple[str, ...]
    p_value: float
    rms_dph: float
    gains: dict[int, float]
    tied_with: tuple[str, ...]


@dataclass(frozen=True)
class Evidence:
    """What one effect, alone, makes of what the declared model leaves.

    Attributes
    ----------
    lacks : str or None
        The input that is missing; then nothing else is known.
    candidate : Candidate or None
        As fitted alone; None where the data don't show it at all.
    share : float
        Share of the sum of squares beyond the noise that it takes away; 1 is all.
    p_value : float
        Probability that chance gives as much, over all that was tried.
    score_behind : float
        Twice the logarithm of how much more the data prefer what was found to this effect alone.
    """

    effect: Effect
    lacks: str | None = None
    candidate: Candidate | None = None
    share: float = 0.0
    p_value: float = 1.0
    score_behind: float = np.nan


@dataclass(frozen=True)
class Closure:
    """Outcome of a search.

    Attributes
    ----------
    campaign : Campaign
        All dwells.
    searched : ndarray of bool, shape (n,)
        Dwells that the search saw; the others are held out.
    verdict : str
        "clean", "explained", "ambiguous" or "unexplained".
    effects : tuple of FoundEffect
        Strongest first.
    evidence : tuple of Evidence
        Of each effect alone.
    before, after : LackOfFit
        Tests of the declared model, and with the effects.
    declared, model : Solution
        The declared model, and with the effects.
    noise_dph : float
        Noise of a measured bias, rms.
    noise_scale : float
        By how much that is above the stated uncertainties.
    error_before_dph, error_after_dph : float
        Rms of measured minus predicted bias in the dwells held out.
    """

    campaign: Campaign
    searched: BoolArray
    verdict: str
    effects: tuple[FoundEffect, ...]
    evidence: tuple[Evidence, ...]
    before: LackOfFit
    after: LackOfFit
    declared: Solution
    model: Solution
    noise_dph: float
    noise_scale: float
    error_before_dph: float
    error_after_dph: float


def close_loop(
    campaign: Campaign, hold_out_cycle: int | None = None, effects: Sequence[Effect] | None = None
) -> Closure:
    """Search a campaign for what the declared model does not explain.

    Parameters
    ----------
    campaign : Campaign
        What was measured.
    hold_out_cycle : int, optional
        The cycle that nothing of the search sees; the last one if not given.
    effects : sequence of Effect, optional
        Candidates; all that the package knows if not given.

    Raises
    ------
    MeasurementError
        There is no such cycle, or too little is left without it.
    """
    candidates = all_effects() if effects is None else tuple(effects)
    searched = _searched(campaign, hold_out_cycle)
    problem = declared_problem(campaign, searched)
    search = Search(problem, candidates)
    found, after = _confirmed(search)
    if _is_noise(after):
        problem = declared_problem(campaign, searched, after.noise_ratio)
        search = Search(problem, candidates)
        found, after = _confirmed(search)
    if _is_left(after):
        found = _proven(problem, found)
        after = _test(problem, found)
    ties = [search.rivals(found, index) for index in range(len(found.candidates))]
    before = lack_of_fit(problem, 0)
    declared, model = (_solve(problem, each) for each in ((), found.candidates))
    held_out = ~searched
    error_before, error_after = (
        _rms(without_unseen_constants(campaign, searched, campaign.bias_dph - each.bias_dph)[held_out])
        for each in (declared, model)
    )
    return Closure(
        campaign=campaign,
        searched=searched,
        verdict=_verdict(found, after, ties),
        effects=_found_effects(search, found, model, ties),
        evidence=_evidence(search, found),
        before=before,
        after=after,
        declared=declared,
        model=model,
        noise_dph=_rms(problem.sigma_dph),
        noise_scale=problem.noise_scale,
        error_before_dph=error_before,
        error_after_dph=error_after,
    )


def _searched(campaign: Campaign, hold_out_cycle: int | None) -> BoolArray:
    cycles = np.unique(campaign.cycle)
    held_out = int(cycles[-1]) if hold_out_cycle is None else hold_out_cycle
    if held_out not in cycles:
        raise MeasurementError(
            f"there is no cycle {held_out} to hold out; the table has {', '.join(map(str, cycles))}"
        )
    if len(cycles) < 2:
        raise MeasurementError(
            f"the table has only cycle {cycles[0]}: with it held out nothing is left to search; "
            "measure the profile at least twice, better three times"
        )
    searched: BoolArray = np.asarray(campaign.cycle != held_out)
    freedom = declared_problem(campaign, searched).freedom
    if freedom < 3 * 6:
        raise MeasurementError(
            f"{searched.sum()} dwells without cycle {held_out} leave {freedom} values beside the declared "
            "model; measure more dwells a cycle or more cycles"
        )
    return searched


def _confirmed(search: Search) -> tuple[EffectSet, LackOfFit]:
    """Best set without the effects that make cycles worse which they were not fitted to."""
    problem, found = search.problem, search.best()
    for index, each in reversed(list(enumerate(found.candidates))):
        gains = gains_by_cycle(problem, found.candidates, index)
        if gains and np.mean(list(gains.values())) <= 0.0:
            found = evaluate(problem, [other for other in found.candidates if other is not each])
    return found, _test(problem, found)


def _test(problem: Problem, found: EffectSet) -> LackOfFit:
    if not found.candidates:
        return lack_of_fit(problem, 0)
    after = problem.with_columns(*stack(found.candidates, problem.campaign))
    return lack_of_fit(after, sum(len(each.values) for each in found.candidates))


def _is_left(after: LackOfFit) -> bool:
    return after.p_value < LEFT_OVER_P


def _is_noise(after: LackOfFit) -> bool:
    """Whether what is left follows nothing and is little enough for the uncertainties being too small."""
    return (
        _is_left(after)
        and after.p_any_structure > _NO_STRUCTURE_P
        and 1.0 < after.noise_ratio < NOISE_TOLERANCE
    )


def _proven(problem: Problem, found: EffectSet) -> EffectSet:
    """Effects that stay although something is left: each cycle, left out, has to show them."""
    kept: list[Candidate] = []
    for each in found.candidates:
        gains = gains_by_cycle(problem, [*kept, each], len(kept))
        if gains and min(gains.values()) > PROVEN_SHARE:
            kept.append(each)
    return evaluate(problem, kept)


def _verdict(found: EffectSet, after: LackOfFit, ties: list[tuple[str, ...]]) -> str:
    if _is_left(after):
        return "unexplained"
    if not found.candidates:
        return "clean"
    return "ambiguous" if any(ties) else "explained"


def _found_effects(
    search: Search, found: EffectSet, model: Solution, ties: list[tuple[str, ...]]
) -> tuple[FoundEffect, ...]:
    problem = search.problem
    result = []
    for index, each in enumerate(found.candidates):
        sizes = model.sizes[index]
        part = np.einsum("ngk,gk->ng", each.columns(problem.campaign), sizes)[problem.searched]
        part = part - part.mean(axis=0)
        shows = np.sum((part / problem.sigma_dph) ** 2, axis=0) > price(problem)
        result.append(
            FoundEffect(
                candidate=each,
                sizes_dph=sizes,
                axes=tuple(axis for axis, seen in zip(AXES, shows, strict=True) if seen),
                p_value=search.p_value(found, index),
                rms_dph=_rms(part),
                gains=gains_by_cycle(problem, found.candidates, index),
                tied_with=ties[index],
            )
        )
    return tuple(sorted(result, key=lambda each: -each.rms_dph))


def _evidence(search: Search, found: EffectSet) -> tuple[Evidence, ...]:
    problem = search.problem
    beyond = max(problem.chi2 - problem.freedom, 1e-9)
    result = []
    for effect in search.effects:
        lacks = [form.lacks(problem.campaign) for form in effect.forms]
        alone = search.alone.get(effect.name)
        if all(lacks):
            result.append(Evidence(effect, lacks=lacks[0]))
        elif alone is None:
            result.append(Evidence(effect, score_behind=search.nothing.score - found.score))
        else:
            share = (problem.chi2 - alone.chi2) / beyond
            p_value, behind = search.p_value(alone, 0), alone.score - found.score
            result.append(Evidence(effect, None, alone.candidates[0], share, p_value, behind))
    return tuple(sorted(result, key=lambda each: (each.lacks is not None, each.score_behind)))


def _solve(problem: Problem, candidates: Sequence[Candidate]) -> Solution:
    return solve(problem, [(each.columns(problem.campaign), each.kept) for each in candidates])


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2)))
