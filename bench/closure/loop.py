"""Closing the loop on one campaign: residual, effects, verdict, error before and after."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gyrobench.bench.closure.campaign import Campaign
from gyrobench.bench.closure.candidates import Candidate, EffectSet, evaluate, scored, solve_with, stack
from gyrobench.bench.closure.effects import all_effects
from gyrobench.bench.closure.effects.effect import Effect
from gyrobench.bench.closure.problem import Problem, Solution, declared_problem
from gyrobench.bench.closure.search import MOST_EFFECTS, Search
from gyrobench.bench.closure.validation import (
    LackOfFit,
    lack_of_fit,
    leave_out_cycles,
    measured_minus,
    pooled_gain,
)
from gyrobench.bench.foundations.arrays import BoolArray, FloatArray
from gyrobench.bench.foundations.errors import MeasurementError
from gyrobench.bench.foundations.text import listed, plain_name
from gyrobench.bench.navigation.positions import AXES

#: Below this probability of chance something is left.
LEFT_OVER_P = 1e-3
#: Stated uncertainties are believed to this factor; scatter beyond them that follows nothing is noise.
NOISE_TOLERANCE = 1.25
#: Beside something unexplained an effect stays only if it takes away this share of the squares of all
#: cycles left out, and makes this share of them better.
PROVEN_SHARE, PROVEN_CYCLES = 0.5, 0.75
#: Sets that take away this share at least are carried on with, so many at each step.
PROMISING_SHARE, PROVEN_BEAM = 0.3, 4
#: Gains this near to each other count as one: the simpler cause is preferred.
_GAIN_STEP = 0.01
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
        Share of the squares of each cycle that it takes away, its size taken from the other cycles; see
        :func:`gyrobench.bench.closure.validation.leave_out_cycles`.
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
        Share of the sum of squares beyond the noise that it takes away; 1 is all. NaN where nothing is
        beyond the noise.
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
    campaign: Campaign, hold_out_cycles: Sequence[int] = (), effects: Sequence[Effect] | None = None
) -> Closure:
    """Search a campaign for what the declared model does not explain.

    Parameters
    ----------
    campaign : Campaign
        What was measured.
    hold_out_cycles : sequence of int
        Cycles that nothing of the search sees; the last one if none is given.
    effects : sequence of Effect, optional
        Candidates; all that the package knows if not given.

    Raises
    ------
    MeasurementError
        There is no such cycle, or too little is left without it.
    """
    candidates = all_effects() if effects is None else tuple(effects)
    searched = _searched(campaign, hold_out_cycles)
    campaign = campaign.holding_out(np.unique(campaign.cycle[~searched]).tolist())
    problem = declared_problem(campaign, searched)
    search = Search(problem, candidates)
    found, after = _confirmed(search)
    if _is_noise(after):
        problem = declared_problem(campaign, searched, after.noise_ratio)
        search = Search(problem, candidates)
        found, after = _confirmed(search)
    if _is_left(after):
        found = _proven(search, after.noise_ratio)
        after = _test(problem, found)
    ties = [search.rivals(found, index) for index in range(len(found.candidates))]
    before = lack_of_fit(problem, 0)
    declared, model = (solve_with(problem, each) for each in ((), found.candidates))
    error_before, error_after = (
        _rms(measured_minus(campaign, searched, each)[~searched]) for each in (declared, model)
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


def _searched(campaign: Campaign, hold_out_cycles: Sequence[int]) -> BoolArray:
    cycles = np.unique(campaign.cycle)
    held_out = list(hold_out_cycles) or [int(cycles[-1])]
    unknown = sorted(set(held_out) - set(cycles.tolist()))
    if unknown:
        raise MeasurementError(
            f"there is no cycle {_numbers(unknown)} to hold out; the table has {_numbers(cycles.tolist())}"
        )
    if len(cycles) == len(set(held_out)):
        raise MeasurementError(
            f"with cycle {_numbers(held_out)} held out nothing is left to search; measure the profile at "
            "least twice, better three times"
        )
    searched: BoolArray = ~np.isin(campaign.cycle, held_out)
    freedom = declared_problem(campaign, searched).freedom
    if freedom < 3 * 6:
        raise MeasurementError(
            f"{searched.sum()} dwells without cycle {_numbers(held_out)} leave {freedom} values beside the "
            "declared model; measure more dwells a cycle or more cycles"
        )
    return searched


def _confirmed(search: Search) -> tuple[EffectSet, LackOfFit]:
    """Best set without the effects that make cycles worse which they were not fitted to."""
    problem, found = search.problem, search.best()
    for each in reversed(found.candidates):
        others = found.without(each)
        cycles = leave_out_cycles(problem, others, found.candidates).values()
        if cycles and pooled_gain(cycles) <= 0.0:
            found = evaluate(problem, others)
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


def _proven(of: Search, noise_ratio: float) -> EffectSet:
    """Effects that stay although something is left, because they show in cycles left out.

    What is left, not the noise, is what unknowns are paid with: its size takes the place of the
    noise. Sets grow by what they take away in cycles left out, and the one counts that takes away
    most and of which each effect is proven beside the others.
    """
    scale = of.problem.noise_scale * noise_ratio
    search = of.paid_with(declared_problem(of.problem.campaign, of.problem.searched, scale))
    best, best_gain, beam = search.nothing, 0.0, [search.nothing]
    for _ in range(MOST_EFFECTS):
        larger = [each for one in beam for effect in search.effects if (each := search.add(one, effect))]
        gains = np.array(
            [pooled_gain(leave_out_cycles(search.problem, (), each.candidates).values()) for each in larger]
        )
        unknowns = [sum(one.unknowns for one in each.candidates) for each in larger]
        order = np.lexsort((np.array(unknowns), -np.round(gains, 2)))[:PROVEN_BEAM]
        beam = [larger[index] for index in order if gains[index] > PROMISING_SHARE]
        for each, gain in zip(beam, (gains[index] for index in order), strict=False):
            proven = all(_is_proven(search.problem, each, one) for one in each.candidates)
            if proven and gain > best_gain + _GAIN_STEP:
                best, best_gain = each, gain
    return scored(of.problem, best.candidates)


def _is_proven(problem: Problem, of: EffectSet, one: Candidate) -> bool:
    """Whether one effect takes away most of the squares of cycles left out, and of most of them."""
    cycles = leave_out_cycles(problem, of.without(one), of.candidates).values()
    better = sum(each.gain > 0.0 for each in cycles)
    share = 0.0 if one.is_at_open_end else pooled_gain(cycles)
    return share > PROVEN_SHARE and better >= PROVEN_CYCLES * len(cycles)


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
        left_out_cycles = leave_out_cycles(problem, found.without(each), found.candidates)
        part = np.einsum("ngk,gk->ng", each.columns(problem.campaign), sizes)[problem.searched]
        part = part - part.mean(axis=0)
        shows = search.shows(found, index)
        result.append(
            FoundEffect(
                candidate=each,
                sizes_dph=sizes,
                axes=tuple(axis for axis, seen in zip(AXES, shows, strict=True) if seen),
                p_value=search.p_value(found, index),
                rms_dph=_rms(part),
                gains={cycle: left_out.gain for cycle, left_out in left_out_cycles.items()},
                tied_with=ties[index],
            )
        )
    return tuple(sorted(result, key=lambda each: -each.rms_dph))


def _evidence(search: Search, found: EffectSet) -> tuple[Evidence, ...]:
    problem = search.problem
    beyond = problem.chi2 - problem.freedom
    result = []
    for effect in search.effects:
        lacks = [form.lacks(problem.campaign) for form in effect.forms]
        alone = search.alone.get(effect.name)
        if all(lacks):
            result.append(Evidence(effect, lacks=lacks[0]))
        elif alone is None:
            result.append(Evidence(effect, score_behind=search.nothing.score - found.score))
        else:
            share = (problem.chi2 - alone.chi2) / beyond if beyond > 0.0 else np.nan
            p_value, behind = search.p_value(alone, 0), alone.score - found.score
            result.append(Evidence(effect, None, alone.candidates[0], share, p_value, behind))
    return tuple(sorted(result, key=lambda each: (each.lacks is not None, each.score_behind)))


def _numbers(cycles: Sequence[int]) -> str:
    return listed(list(map(str, cycles)))


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2)))


_S_PER_H = 3600.0
_UNITS = {"c": "degC"}


def statement(found: FoundEffect) -> str:
    """One sentence: what the bias does, on which gyros, how much, with which parameters."""
    parameters = ", ".join(
        _parameter(each.name, value)
        for each, value in zip(found.candidate.form.parameters, found.candidate.values, strict=True)
    )
    gyros = f"{listed(found.axes)} gyro{'s' if len(found.axes) > 1 else ''}"
    size = f"{found.rms_dph:.2g} deg/h rms on the {gyros}"
    sentence = found.candidate.effect.statement
    return f"{sentence[0].upper()}{sentence[1:]}: {size}{f' ({parameters})' if parameters else ''}."


def _parameter(name: str, value: float) -> str:
    """Name and value of a parameter with its unit: "tau 1.5 h", "onset width 4.2 degC"."""
    words, _, unit = name.replace("_", " ").rpartition(" ")
    if unit == "s" and abs(value) >= _S_PER_H:
        return f"{words} {value / _S_PER_H:.2f} h"
    return f"{words} {value:.3g} {_UNITS.get(unit, unit)}"


def separating_measurement(closure: Closure) -> str | None:
    """What to measure next to split the first tie; None without ties."""
    experiments = {each.effect.name: each.effect.experiment for each in closure.evidence}
    for found in closure.effects:
        if found.tied_with:
            other = found.tied_with[0]
            one = found.candidate.effect
            return (
                f"To tell {plain_name(one.name)} from {plain_name(other)}: {one.experiment}; "
                f"for {plain_name(other)}: {experiments[other]}."
            )
    return None


def whereabouts(closure: Closure) -> str | None:
    """Where the model leaves most, if anything is left: size, position, temperatures, times."""
    if closure.verdict != "unexplained":
        return None
    campaign, searched = closure.campaign, closure.searched
    rest = (campaign.bias_dph - closure.model.bias_dph)[searched]
    size = np.sqrt(np.mean(rest**2))
    squares = np.sum(rest**2, axis=1)
    names = np.array(campaign.position)[searched]
    position = max(sorted(set(names)), key=lambda name: float(squares[names == name].mean()))
    low_c, high_c = _worst_span(campaign.gyro_c[searched].mean(axis=1), squares)
    low_h, high_h = _worst_span(campaign.middle_s[searched] / 3600.0, squares)
    return (
        f"{size:.2g} deg/h rms is left, {closure.after.noise_ratio:.1f} times the noise; it follows "
        f"{closure.after.follows} most clearly, and is largest in position {plain_name(position)}, "
        f"at {low_c:.0f} to {high_c:.0f} degC, and at {low_h:.0f} to {high_h:.0f} h."
    )


def _worst_span(
    values: np.ndarray[tuple[int], np.dtype[np.float64]],
    squares: np.ndarray[tuple[int], np.dtype[np.float64]],
) -> tuple[float, float]:
    """Eighth of the range of values with the largest mean square."""
    edges = np.linspace(values.min(), values.max(), 9)
    place = np.clip(np.digitize(values, edges) - 1, 0, 7)
    means = [float(squares[place == each].mean()) if np.any(place == each) else -1.0 for each in range(8)]
    worst = int(np.argmax(means))
    return float(edges[worst]), float(edges[worst + 1])
