"""Closing the loop on one campaign: residual, effects, verdict, error before and after."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from gyrobench.bench.closure.campaign import Campaign
from gyrobench.bench.closure.candidates import Candidate, Hypothesis, after_fit, solve_with
from gyrobench.bench.closure.compose import compose
from gyrobench.bench.closure.confounding import confounding
from gyrobench.bench.closure.effects import all_effects
from gyrobench.bench.closure.effects.effect import Effect
from gyrobench.bench.closure.evidence import detectable_dph
from gyrobench.bench.closure.files import holds_search, read_held_out_cycles, read_quantity, read_tables
from gyrobench.bench.closure.held_out import HeldOutTest, held_out_test, is_confirmed
from gyrobench.bench.closure.inputs import read_campaign
from gyrobench.bench.closure.outcome import CandidateResult, Closure, FoundEffect, HeldOutCycle, OtherForm
from gyrobench.bench.closure.posterior import CLEAN, EXPLAINED, Posterior
from gyrobench.bench.closure.problem import DEGREE, Problem, Solution, declared_problem
from gyrobench.bench.closure.search import Search
from gyrobench.bench.closure.selection import Selected, select
from gyrobench.bench.closure.uncertainty import Draws, draw, interval
from gyrobench.bench.closure.validation import LackOfFit, lack_of_fit, leave_out_cycles, measured_minus
from gyrobench.bench.foundations.arrays import BoolArray, FloatArray, nan_rms, rms
from gyrobench.bench.foundations.errors import MeasurementError, RunFolderError
from gyrobench.bench.foundations.text import counted, listed
from gyrobench.bench.runs.folder import RunFolder

#: Verdict without a search.
NOT_SEARCHED = "not searched"
#: Fewest degrees of freedom of the three gyros together beside the declared model.
_MIN_DOF = 18


def close_loop(
    campaign: Campaign, hold_out_cycles: Sequence[int] = (), effects: Sequence[Effect] | None = None
) -> Closure:
    """Search a campaign for effects that the declared model lacks.

    Raises MeasurementError if there is no such cycle, or too little is left without it. Raises DocumentError
    if an effect of another package or of a file can't be used.

    Parameters
    ----------
    campaign : Campaign
        The measured dwells.
    hold_out_cycles : sequence of int
        Cycles that the search does not use; by default :attr:`Campaign.last_cycle`, of one cycle none.
    effects : sequence of Effect, optional
        Candidates; by default all installed ones and those of the user's files.
    """
    sensor = campaign.quantity.sensor
    candidates = all_effects(*campaign.sources, sensor=sensor) if effects is None else tuple(effects)
    searched = _searched(campaign, hold_out_cycles)
    campaign = campaign.holding_out(np.unique(campaign.cycle[~searched]).tolist())
    return _closure(campaign, searched, candidates)


def without_search(campaign: Campaign) -> Closure:
    """The declared model fitted to all dwells, with the verdict "not searched".

    For a campaign of one cycle, where none can be held out. Raises MeasurementError if it has too few dwells.
    """
    return replace(_closure(campaign, _searched(campaign, ()), ()), verdict=NOT_SEARCHED)


def _closure(campaign: Campaign, searched: BoolArray, candidates: Sequence[Effect]) -> Closure:
    """Search the dwells ``searched`` (n,); the errors in the others are NaN where there are none."""
    selected = select(campaign, searched, candidates)
    search, found, posterior, after = selected.search, selected.found, selected.posterior, selected.after
    problem = search.problem
    declared, model = (solve_with(problem, each) for each in ((), found.candidates))
    declared_draws, model_draws = (draw(problem, each) for each in ((), found.candidates))
    errors_dph = [measured_minus(campaign, searched, each) for each in (declared, model)]
    before_dph, after_dph = (each[~searched] for each in errors_dph)
    held_out = held_out_test(
        after_fit(problem, found.candidates), errors_dph[1], model_draws.bias_dph(campaign) - model.bias_dph
    )
    noise_dph = campaign.sigma_dph[~searched] * problem.noise_scale
    others = campaign.part(~searched)
    circular = tuple(each.effect.name for each in found.candidates if _is_circular(each.effect, others))
    return Closure(
        campaign=campaign,
        searched=searched,
        verdict=_verdict(
            found,
            after,
            posterior,
            held_out,
            is_confirmed=bool(found.candidates)
            and not searched.all()
            and not circular
            and is_confirmed(before_dph, after_dph, noise_dph),
        ),
        circular=circular,
        posterior=posterior,
        not_accepted=selected.not_accepted,
        detectable_dph=detectable_dph(selected.with_effects),
        effects=_found_effects(search, found, model, model_draws, posterior),
        evidence=_evidence(selected),
        before=lack_of_fit(problem, 0),
        after=after,
        held_out=held_out,
        declared=declared,
        model=model,
        noise_dph=selected.noise.scale * nan_rms(campaign.known_sigma_dph[searched]),
        confounding=confounding(campaign, searched),
        noise=selected.noise,
        error_before_dph=nan_rms(before_dph),
        error_after_dph=nan_rms(after_dph),
        error_before_sigma_dph=_rms_sigma(before_dph, noise_dph),
        error_after_sigma_dph=_rms_sigma(after_dph, noise_dph),
        declared_draws=declared_draws,
        model_draws=model_draws,
    )


def repeat_search(folder: Path) -> Closure:
    """Repeat the search of which the files are in a folder, on its tables.

    ``folder``: as ``gyrobench close`` writes it, or the run folder that it is in. Tables that are not at
    their path are looked for beside the folder. Raises RunFolderError if there is no search, it is damaged,
    or its tables are missing; DocumentError or MeasurementError if the tables can't be used.
    """
    folder = folder if holds_search(folder) else RunFolder(folder).closure
    beside = RunFolder(folder.parent)
    own = beside.path if beside.journal.exists() else beside.dwells
    names = read_tables(folder) or [str(own)]
    paths = []
    for path in map(Path, names):
        places = [path, beside.path / path.name, *([own] if len(names) == 1 else [])]
        if not any(place.exists() for place in places):
            raise RunFolderError(
                f"{folder}: the table searched, {path}, is not there. Repeat gyrobench close"
            )
        paths.append(next(place for place in places if place.exists()))
    return close_loop(read_campaign(*paths, quantity=read_quantity(folder)), read_held_out_cycles(folder))


def composed(closure: Closure) -> Closure:
    """Same closure with laws composed from the grammar of effects, if the dwells searched are unexplained."""
    if closure.verdict != "unexplained" or closure.differs_held_out:
        return closure
    problem = closure.noise.problem(closure.campaign, closure.searched)
    return replace(closure, composed=compose(problem, [each.candidate for each in closure.effects]))


def hold_out_each(closure: Closure) -> Closure:
    """Same closure with the outcome of a search for each cycle, held out alone."""
    campaign, effects = closure.campaign, [each.effect for each in closure.evidence]
    return replace(
        closure,
        held_out_in_turn=tuple(_with_cycle_held_out(campaign, cycle, effects) for cycle in campaign.cycles),
    )


def _with_cycle_held_out(campaign: Campaign, cycle: int, effects: Sequence[Effect]) -> HeldOutCycle:
    try:
        closure = close_loop(campaign, [cycle], effects)
    except MeasurementError as error:
        return HeldOutCycle(cycle, reason=str(error))
    return HeldOutCycle(
        cycle,
        closure.verdict,
        closure.names,
        closure.error_before_dph,
        closure.error_after_dph,
        closure.noise_scale * nan_rms(campaign.known_sigma_dph[campaign.cycle == cycle]),
    )


def too_few_dwells(campaign: Campaign, searched: BoolArray) -> str:
    """Why the dwells ``searched`` (n,) can't be searched, and what to measure; empty if they can."""
    dof, row = declared_problem(campaign, searched).dof, campaign.quantity.row
    if dof >= _MIN_DOF:
        return ""
    cycles = sorted(set(campaign.cycle[~searched].tolist()))
    without = f" without cycle {_numbers(cycles)}" if cycles else ""
    needed = _MIN_DOF // 3 + DEGREE + len(np.unique(campaign.run[searched]))
    return (
        f"a cubic in temperature leaves {dof} degrees of freedom in {counted(int(searched.sum()), row)}"
        f"{without}, required: {_MIN_DOF}. Measure the profile at least twice, each time with {needed} "
        f"{row}s or more, at temperatures reached from below and from above"
    )


def _searched(campaign: Campaign, hold_out_cycles: Sequence[int]) -> BoolArray:
    cycles = campaign.cycles
    held_out = list(hold_out_cycles) or [campaign.last_cycle] * (len(cycles) > 1)
    unknown = sorted(set(held_out) - set(cycles))
    if unknown:
        raise MeasurementError(
            f"there is no cycle {_numbers(unknown)} to hold out; the table has {_numbers(cycles)}"
        )
    if len(cycles) == len(set(held_out)):
        raise MeasurementError(
            f"with cycle {_numbers(held_out)} held out nothing remains to search. Measure the profile at "
            "least twice, preferably three times"
        )
    searched: BoolArray = ~np.isin(campaign.cycle, held_out)
    if text := too_few_dwells(campaign, searched):
        raise MeasurementError(text)
    return searched


def _verdict(
    found: Hypothesis, after: LackOfFit, posterior: Posterior, held_out: HeldOutTest, *, is_confirmed: bool
) -> str:
    if after.is_significant or posterior.not_on_list > 0.5:
        return "unexplained"
    if not found.candidates:
        if held_out.is_significant:
            return "unexplained"
        return "clean" if posterior.nothing >= CLEAN else "ambiguous"
    is_settled = posterior.of_all(found.names) >= EXPLAINED and not posterior.rivals(found.names)
    return "explained" if is_settled and is_confirmed and not held_out.is_significant else "ambiguous"


def _is_circular(effect: Effect, held_out: Campaign) -> bool:
    """Whether a law was composed from held-out dwells, or from their runs if its dwells are not known."""
    if effect.composed_from_dwells:
        return not set(effect.composed_from_dwells).isdisjoint(held_out.fingerprints)
    return not {held_out.run_names[run] for run in held_out.run}.isdisjoint(effect.composed_from)


def _found_effects(
    search: Search, found: Hypothesis, model: Solution, draws: Draws, posterior: Posterior
) -> tuple[FoundEffect, ...]:
    problem, quantity = search.problem, search.problem.campaign.quantity
    result = []
    for index, each in enumerate(found.candidates):
        sizes = model.sizes[index]
        left_out_cycles = leave_out_cycles(problem, found.without(each), found.candidates)
        part = np.einsum("ngk,gk->ng", each.columns(problem.campaign), sizes)[problem.searched]
        part = part - part.mean(axis=0)
        values, sizes_drawn = (drawn[each.effect.name] for drawn in (draws.values, draws.sizes_dph))
        parts = draws.effect_dph(problem.campaign, each.effect.name)[:, problem.searched]
        parts -= parts.mean(axis=1, keepdims=True)
        weights = each.form.weights(problem.campaign, each.values)
        weights_drawn = np.array([each.form.weights(problem.campaign, tuple(one)) for one in values])
        shows = search.shows(found, index)
        result.append(
            FoundEffect(
                candidate=each,
                sizes_dph=sizes,
                axes=tuple(axis for axis, seen in zip(quantity.axes, shows, strict=True) if seen),
                p_value=search.p_value(found, index),
                candidate_fits=search.candidate_fits(each.effect),
                rms_dph=rms(part),
                gains={cycle: left_out.gain for cycle, left_out in left_out_cycles.items()},
                tied_with=posterior.tied_with(found.names, each.effect.name),
                probability=posterior.of_all([each.effect.name], has_remainder=None),
                sizes_sigma_dph=draws.sigma(sizes_drawn, sizes),
                values_sigma=draws.sigma(values, np.array(each.values)),
                rms_sigma_dph=float(draws.sigma(np.sqrt(np.mean(parts**2, axis=(1, 2))), rms(part))),
                values_range=tuple(map(interval, each.form.parameters, each.values, values.T)),
                weights=weights,
                weighted_sigma_dph=draws.sigma(sizes_drawn * weights_drawn[:, None, :], sizes * weights),
                quantity=quantity,
                other_forms=tuple(_other_forms(problem, found, each, posterior)),
            )
        )
    return tuple(sorted(result, key=lambda each: -each.rms_dph))


def _other_forms(
    problem: Problem, found: Hypothesis, one: Candidate, posterior: Posterior
) -> Iterator[OtherForm]:
    for probability, candidates in posterior.other_forms(found.names, one):
        [other] = [each for each in candidates if each.effect.name == one.effect.name]
        drawn = draw(problem, candidates)
        values = drawn.values[other.effect.name]
        ranges = tuple(map(interval, other.form.parameters, other.values, values.T))
        yield OtherForm(other, probability, drawn.sigma(values, np.array(other.values)), ranges)


def _evidence(selected: Selected) -> tuple[CandidateResult, ...]:
    search, found = selected.search, selected.found
    problem = search.problem
    excess = problem.chi2 - problem.dof

    def odds(alone: Hypothesis) -> float:
        return search.evidences.log_odds(found, alone)

    result = []
    for effect in search.effects:
        alone = search.alone.get(effect.name)
        missing = effect.missing_input(problem.campaign)
        if missing:
            result.append(CandidateResult(effect, missing))
        elif alone is None:
            rejected = selected.rejection(effect)
            result.append(CandidateResult(effect, log_odds_against=odds(search.declared), rejected=rejected))
        else:
            share = (problem.chi2 - alone.chi2) / excess if excess > 0.0 else np.nan
            p_value, rejected = search.p_value(alone, 0), selected.rejection(effect)
            result.append(
                CandidateResult(effect, None, alone.candidates[0], share, p_value, odds(alone), rejected)
            )
    return tuple(sorted(result, key=lambda each: (each.missing_input is not None, each.log_odds_against)))


def _numbers(cycles: Sequence[int]) -> str:
    return listed(list(map(str, cycles)))


def _rms_sigma(errors_dph: FloatArray, noise_dph: FloatArray) -> float:
    """Standard uncertainty of an rms error by the noise of what was measured; NaN of none.

    The square of an error with the noise s has the variance ``2 s^4 + 4 s^2 d^2`` with its true part d.
    """
    known = ~np.isnan(errors_dph)
    if not known.any():
        return np.nan
    errors_dph, noise_dph = errors_dph[known], noise_dph[known]
    true = max(float(np.sum(errors_dph**2) - np.sum(noise_dph**2)), 0.0) / errors_dph.size
    variance = np.sum(2.0 * noise_dph**4 + 4.0 * noise_dph**2 * true)
    return float(np.sqrt(variance)) / (2.0 * errors_dph.size * max(rms(errors_dph), 1e-300))
