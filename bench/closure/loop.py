"""Closes the loop on one campaign: residual, effects, verdict, error before and after."""

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
from gyrobench.bench.closure.held_out import HeldOutTest, are_effects_confirmed, held_out_test
from gyrobench.bench.closure.inputs import read_campaign
from gyrobench.bench.closure.outcome import CandidateResult, Closure, FoundEffect, HeldOutCycle, OtherForm
from gyrobench.bench.closure.posterior import CLEAN, EXPLAINED
from gyrobench.bench.closure.problem import DEGREE, Solution, declared_problem
from gyrobench.bench.closure.selection import Selected, select
from gyrobench.bench.closure.uncertainty import Draws, draw, interval
from gyrobench.bench.closure.validation import lack_of_fit, leave_out_cycles, measured_minus_model
from gyrobench.bench.foundations.arrays import BoolArray, FloatArray, nan_rms, rms
from gyrobench.bench.foundations.errors import MeasurementError, RunFolderError
from gyrobench.bench.foundations.text import counted, listed
from gyrobench.bench.runs.folder import RunFolder

#: Verdict without a search.
NOT_SEARCHED = "not searched"
#: Smallest number of degrees of freedom of the three gyros together with the declared model.
_MIN_DOF = 18


def close_loop(
    campaign: Campaign, hold_out_cycles: Sequence[int] = (), effects: Sequence[Effect] | None = None
) -> Closure:
    """Search a campaign for effects that the declared model lacks, and test them on held-out cycles.

    Raises MeasurementError if a cycle to hold out does not exist, or too few dwells remain without it. Raises
    DocumentError if an effect of another package or of a file can't be used.

    Parameters
    ----------
    campaign : Campaign
        The measured dwells.
    hold_out_cycles : sequence of int
        Cycles that the search does not use; by default :attr:`Campaign.last_cycle`, none if there is only
        one.
    effects : sequence of Effect, optional
        Candidate effects; by default all installed ones and those of the user's files.
    """
    sensor = campaign.quantity.sensor
    candidates = all_effects(*campaign.sources, sensor=sensor) if effects is None else tuple(effects)
    searched = _dwells_to_search(campaign, hold_out_cycles)
    campaign = campaign.holding_out(np.unique(campaign.cycle[~searched]).tolist())
    return _search_and_test(campaign, searched, candidates)


def without_search(campaign: Campaign) -> Closure:
    """Fit the declared model to all dwells, with the verdict "not searched".

    For a campaign of one cycle, which can't be held out. Raises MeasurementError if it has too few dwells.
    """
    return replace(_search_and_test(campaign, _dwells_to_search(campaign, ()), ()), verdict=NOT_SEARCHED)


def _search_and_test(campaign: Campaign, searched: BoolArray, candidates: Sequence[Effect]) -> Closure:
    """Search the dwells ``searched`` (n,) and test the others; errors are NaN if no dwells are held out."""
    selected = select(campaign, searched, candidates)
    problem, accepted = selected.search.problem, selected.accepted
    declared, model = (solve_with(problem, each) for each in ((), accepted.candidates))
    declared_draws, model_draws = (draw(problem, each) for each in ((), accepted.candidates))
    before_dph, after_dph = (measured_minus_model(campaign, searched, each) for each in (declared, model))
    drawn_dph = model_draws.bias_dph(campaign) - model.bias_dph
    held_out = held_out_test(after_fit(problem, accepted.candidates), after_dph, drawn_dph)
    held_out_part = campaign.part(~searched)
    circular = tuple(
        each.effect.name for each in accepted.candidates if _is_circular(each.effect, held_out_part)
    )
    can_confirm = bool(accepted.candidates) and not searched.all() and not circular
    is_confirmed = can_confirm and are_effects_confirmed(problem, before_dph, after_dph)
    noise_dph = campaign.noise_dph(problem.noise_scale)[~searched]
    return Closure(
        campaign=campaign,
        searched=searched,
        verdict=_verdict(selected, held_out, is_confirmed=is_confirmed),
        circular=circular,
        posterior=selected.posterior,
        not_accepted=selected.not_accepted,
        detectable_dph=detectable_dph(selected.problem_with_effects),
        effects=_describe_effects(selected, model, model_draws),
        evidence=_candidate_results(selected),
        before=lack_of_fit(problem, 0),
        after=selected.residual_test,
        held_out=held_out,
        declared=declared,
        model=model,
        noise_dph=nan_rms(campaign.noise_dph(selected.noise.scales)[searched]),
        confounding=confounding(campaign, searched),
        noise=selected.noise,
        error_before_dph=nan_rms(before_dph[~searched]),
        error_after_dph=nan_rms(after_dph[~searched]),
        error_before_sigma_dph=_rms_sigma(before_dph[~searched], noise_dph),
        error_after_sigma_dph=_rms_sigma(after_dph[~searched], noise_dph),
        declared_draws=declared_draws,
        model_draws=model_draws,
    )


def repeat_search(folder: Path) -> Closure:
    """Repeat the search whose files are in a folder, on the same tables.

    ``folder``: written by ``gyrobench close``, or the run folder that contains it. A table that is not at its
    path is looked for beside the folder. Raises RunFolderError if there is no search, it is damaged, or its
    tables are missing; DocumentError or MeasurementError if the tables can't be used.
    """
    folder = folder if holds_search(folder) else RunFolder(folder).closure
    run = RunFolder(folder.parent)
    run_table = run.path if run.journal.exists() else run.dwells
    table_names = read_tables(folder) or [str(run_table)]
    paths = []
    for path in map(Path, table_names):
        candidate_paths = [path, run.path / path.name, *([run_table] if len(table_names) == 1 else [])]
        if not any(candidate.exists() for candidate in candidate_paths):
            raise RunFolderError(
                f"{folder}: the table searched, {path}, is not there. Repeat gyrobench close"
            )
        paths.append(next(candidate for candidate in candidate_paths if candidate.exists()))
    return close_loop(read_campaign(*paths, quantity=read_quantity(folder)), read_held_out_cycles(folder))


def composed(closure: Closure) -> Closure:
    """The closure with laws composed from the grammar of effects, if the dwells searched are unexplained."""
    if closure.verdict != "unexplained" or closure.differs_held_out:
        return closure
    problem = closure.noise.problem(closure.campaign, closure.searched)
    return replace(closure, composed=compose(problem, [each.candidate for each in closure.effects]))


def hold_out_each(closure: Closure) -> Closure:
    """The closure with the outcome of one more search for each cycle, which holds out only that cycle."""
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
        nan_rms(closure.dwell_noise_dph[campaign.cycle == cycle]),
    )


def reason_too_few_dwells(campaign: Campaign, searched: BoolArray) -> str:
    """Reason why the dwells ``searched`` (n,) can't be searched, and what to measure; empty if they can."""
    dof, row = declared_problem(campaign, searched).dof, campaign.quantity.row
    if dof >= _MIN_DOF:
        return ""
    cycles = sorted(set(campaign.cycle[~searched].tolist()))
    omitted = f" without cycle {_cycle_list(cycles)}" if cycles else ""
    needed = _MIN_DOF // 3 + DEGREE + len(np.unique(campaign.run[searched]))
    return (
        f"a cubic in temperature leaves {dof} degrees of freedom in {counted(int(searched.sum()), row)}"
        f"{omitted}, required: {_MIN_DOF}. Measure the profile at least twice, each time with {needed} "
        f"{row}s or more, at temperatures reached from below and from above"
    )


def _dwells_to_search(campaign: Campaign, hold_out_cycles: Sequence[int]) -> BoolArray:
    cycles = campaign.cycles
    held_out = list(hold_out_cycles) or [campaign.last_cycle] * (len(cycles) > 1)
    unknown = sorted(set(held_out) - set(cycles))
    if unknown:
        raise MeasurementError(
            f"there is no cycle {_cycle_list(unknown)} to hold out; the table has {_cycle_list(cycles)}"
        )
    if len(cycles) == len(set(held_out)):
        raise MeasurementError(
            f"with cycle {_cycle_list(held_out)} held out nothing remains to search. Measure the profile at "
            "least twice, preferably three times"
        )
    searched: BoolArray = ~np.isin(campaign.cycle, held_out)
    if reason := reason_too_few_dwells(campaign, searched):
        raise MeasurementError(reason)
    return searched


def _verdict(selected: Selected, held_out: HeldOutTest, *, is_confirmed: bool) -> str:
    accepted, posterior = selected.accepted, selected.posterior
    if selected.residual_test.is_significant or posterior.unlisted_probability > 0.5:
        return "unexplained"
    if not accepted.candidates:
        if held_out.is_significant:
            return "unexplained"
        return "clean" if posterior.no_effect_probability >= CLEAN else "ambiguous"
    is_certain = posterior.joint_probability(accepted.names) >= EXPLAINED and not posterior.rivals(
        accepted.names
    )
    return "explained" if is_certain and is_confirmed and not held_out.is_significant else "ambiguous"


def _is_circular(effect: Effect, held_out: Campaign) -> bool:
    """Whether a law was composed from held-out dwells, or from their runs if its dwells are unknown."""
    if effect.composed_from_dwells:
        return not set(effect.composed_from_dwells).isdisjoint(held_out.fingerprints)
    return not {held_out.run_names[run] for run in held_out.run}.isdisjoint(effect.composed_from)


def _describe_effects(selected: Selected, model: Solution, draws: Draws) -> tuple[FoundEffect, ...]:
    search, accepted, posterior = selected.search, selected.accepted, selected.posterior
    problem, quantity = search.problem, search.problem.campaign.quantity
    result = []
    for index, each in enumerate(accepted.candidates):
        sizes = model.sizes[index]
        effect_dph = np.einsum("ngk,gk->ng", each.columns(problem.campaign), sizes)[problem.searched]
        effect_dph = effect_dph - effect_dph.mean(axis=0)
        values, sizes_drawn = (drawn[each.effect.name] for drawn in (draws.values, draws.sizes_dph))
        drawn_dph = draws.effect_dph(problem.campaign, each.effect.name)[:, problem.searched]
        drawn_dph -= drawn_dph.mean(axis=1, keepdims=True)
        weights = each.form.weights(problem.campaign, each.values)
        weights_drawn = np.array(
            [each.form.weights(problem.campaign, tuple(values_drawn)) for values_drawn in values]
        )
        is_significant = search.significant_gyros(accepted, index)
        result.append(
            FoundEffect(
                candidate=each,
                sizes_dph=sizes,
                axes=tuple(axis for axis, seen in zip(quantity.axes, is_significant, strict=True) if seen),
                p_value=search.p_value(accepted, index),
                candidate_fits=search.candidate_fits(each.effect),
                rms_dph=rms(effect_dph),
                gains=leave_out_cycles(problem, accepted.without(each), accepted.candidates),
                tied_with=posterior.tied_with(accepted.names, each.effect.name),
                probability=posterior.joint_probability([each.effect.name], has_remainder=None),
                sizes_sigma_dph=draws.sigma(sizes_drawn, sizes),
                values_sigma=draws.sigma(values, np.array(each.values)),
                rms_sigma_dph=float(
                    draws.sigma(np.sqrt(np.mean(drawn_dph**2, axis=(1, 2))), rms(effect_dph))
                ),
                values_range=tuple(map(interval, each.form.parameters, each.values, values.T)),
                weights=weights,
                weighted_sigma_dph=draws.sigma(sizes_drawn * weights_drawn[:, None, :], sizes * weights),
                quantity=quantity,
                other_forms=tuple(_describe_other_forms(selected, model, each)),
            )
        )
    return tuple(sorted(result, key=lambda each: -each.rms_dph))


def _describe_other_forms(selected: Selected, model: Solution, candidate: Candidate) -> Iterator[OtherForm]:
    problem, others = selected.search.problem, selected.accepted.without(candidate)
    bias_dph = measured_minus_model(problem.campaign, problem.searched, model)
    for probability, candidates in selected.posterior.other_forms(selected.accepted.names, candidate):
        [other] = [each for each in candidates if each.effect.name == candidate.effect.name]
        drawn = draw(problem, candidates)
        values = drawn.values[other.effect.name]
        ranges = tuple(map(interval, other.form.parameters, other.values, values.T))
        other_bias_dph = measured_minus_model(
            problem.campaign, problem.searched, solve_with(problem, [*others, other])
        )
        differences_dph = np.nan_to_num(np.abs(other_bias_dph - bias_dph)).max(axis=1)
        yield OtherForm(
            other,
            probability,
            drawn.sigma(values, np.array(other.values)),
            ranges,
            float(differences_dph.max()),
            int(problem.campaign.dwell[differences_dph.argmax()]),
        )


def _candidate_results(selected: Selected) -> tuple[CandidateResult, ...]:
    search, accepted = selected.search, selected.accepted
    problem = search.problem
    excess = problem.chi2 - problem.dof

    def odds(single_effect: Hypothesis) -> float:
        return search.evidences.log_odds(accepted, single_effect)

    result = []
    for effect in search.effects:
        single_effect = search.single_effects.get(effect.name)
        missing = effect.missing_input(problem.campaign)
        if missing:
            result.append(CandidateResult(effect, missing))
        elif single_effect is None:
            rejected = selected.rejection(effect)
            result.append(CandidateResult(effect, log_odds_against=odds(search.declared), rejected=rejected))
        else:
            share = (problem.chi2 - single_effect.chi2) / excess if excess > 0.0 else np.nan
            p_value, rejected = search.p_value(single_effect, 0), selected.rejection(effect)
            result.append(
                CandidateResult(
                    effect, None, single_effect.candidates[0], share, p_value, odds(single_effect), rejected
                )
            )
    return tuple(sorted(result, key=lambda each: (each.missing_input is not None, each.log_odds_against)))


def _cycle_list(cycles: Sequence[int]) -> str:
    return listed(list(map(str, cycles)))


def _rms_sigma(errors_dph: FloatArray, noise_dph: FloatArray) -> float:
    """Standard uncertainty of an rms error due to noise; NaN without measured errors.

    The square of an error with noise s and true part d has the variance ``2 s^4 + 4 s^2 d^2``.
    """
    is_measured = ~np.isnan(errors_dph)
    if not is_measured.any():
        return np.nan
    errors_dph, noise_dph = errors_dph[is_measured], noise_dph[is_measured]
    true_square = max(float(np.sum(errors_dph**2) - np.sum(noise_dph**2)), 0.0) / errors_dph.size
    variance = np.sum(2.0 * noise_dph**4 + 4.0 * noise_dph**2 * true_square)
    return float(np.sqrt(variance)) / (2.0 * errors_dph.size * max(rms(errors_dph), 1e-300))
