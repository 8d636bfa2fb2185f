"""Expected odds of the ties of a closure after a planned campaign.

Noise, sensors and temperatures of the unit are as measured in the closure. For each tie, the dwells of the
plan are predicted by each of the two fitted hypotheses; both are then fitted to the measured and predicted
dwells together, as a search after the measurement would do.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from gyrobench.bench.closure.campaign import Campaign
from gyrobench.bench.closure.candidates import Candidate, Hypothesis, fit_hypothesis, refine, solve_with
from gyrobench.bench.closure.effects.effect import Effect
from gyrobench.bench.closure.evidence import Evidences
from gyrobench.bench.closure.inputs import TableToJoin, join_tables
from gyrobench.bench.closure.outcome import Closure
from gyrobench.bench.closure.planned_campaign import UnitProperties
from gyrobench.bench.closure.posterior import TIE_ODDS
from gyrobench.bench.closure.problem import DEGREE, Problem, declared_problem, predict
from gyrobench.bench.closure.search import Search
from gyrobench.bench.closure.separability import searched_dwells
from gyrobench.bench.closure.unit_thermal import UnitThermal
from gyrobench.bench.foundations.arrays import S_PER_H, BoolArray
from gyrobench.bench.procedure.estimate import ThermalEstimate

_MIN_PROBABILITY, _MAX_LOG_ODDS = 1e-150, 345.0
#: Number of draws of the noise of a plan.
_DRAWS = 5


def measured_properties(closure: Closure, estimate: ThermalEstimate) -> UnitProperties:
    """Properties of the unit of a closure: noise, sensors, and thermal model fitted to the campaign.

    ``estimate``: of a typical unit; replaces what was not measured.
    """
    campaign = closure.campaign
    hours = (campaign.end_s - campaign.start_s)[:, np.newaxis] / S_PER_H
    variance = (closure.noise.scales * campaign.sigma_dph) ** 2 * hours
    return UnitProperties(
        np.sqrt(variance[closure.searched].mean(axis=0)),
        "as measured in the closure",
        has_boards=bool(np.isfinite(campaign.board_c).all()),
        has_case=bool(np.isfinite(campaign.case_c).all()),
        thermal=UnitThermal.typical(estimate).fitted_to(campaign)[0],
    )


@dataclass(frozen=True)
class TieForecast:
    """A tie of a closure, and the odds expected after a plan."""

    found: str  #: Name of the effect found.
    other: str  #: Name of the effect tied with it.
    now: float  #: Odds of the effect found, from the dwells searched.
    #: Expected odds of the effect found if it is present, from those dwells of the plan that a search uses.
    plan_only: float = math.nan
    #: if_found, if_other: Expected odds of the effect that is present, from the dwells searched and all of
    #: the plan. NaN, like ``plan_only``, if neither closure nor plan can fit the other effect; if only the
    #: plan can fit it, ``if_found`` is from the plan only.
    if_found: float = math.nan
    if_other: float = math.nan
    missing_input: str | None = (
        None  #: The missing input that prevents the plan from fitting the other effect.
    )

    @property
    def is_settled(self) -> bool:
        """Whether the tie is expected to be resolved, whichever effect is present."""
        expected = [each for each in (self.if_found, self.if_other) if not math.isnan(each)]
        return bool(expected) and min(expected) >= TIE_ODDS


def tie_forecasts(closure: Closure, planned: Campaign) -> list[TieForecast]:
    """Forecast the ties of a closure after a planned campaign that begins at its end."""
    effects = {each.effect.name: each.effect for each in closure.evidence}
    problem = closure.noise.problem(closure.campaign, closure.searched)
    found = tuple(each.candidate for each in closure.effects)
    names = {each.effect.name for each in found}
    measured = replace(problem.campaign.part(closure.searched), tables=(), part_of=None)
    measured = replace(measured, sigma_dph=measured.sigma_dph * closure.noise.scales)
    planned = replace(planned, unit=measured.unit)
    joined = join_tables([TableToJoin("measured", measured), TableToJoin("planned", planned, is_run=True)])
    odds_with_plan, odds_of_plan = (
        partial(
            _odds, problem=problem, is_predicted=is_predicted, campaign=campaign, effects=[*effects.values()]
        )
        for campaign, is_predicted in (
            (joined, np.arange(len(joined)) >= len(measured)),
            (searched_dwells(planned), np.ones(len(searched_dwells(planned)), dtype=bool)),
        )
    )
    forecasts = []
    for tied_effect in closure.effects:
        others = [each for each in found if each is not tied_effect.candidate]
        for name in dict.fromkeys(tied_effect.tied_with):
            present, other = (
                max(closure.posterior.set_probability(each), _MIN_PROBABILITY)
                for each in (names, names - {tied_effect.effect.name} | {name})
            )
            tie = TieForecast(tied_effect.effect.name, name, present / other)
            alternative = _alternative(problem, others, effects[name])
            missing_input = effects[name].missing_input(planned)
            if alternative is not None:
                sets = found, alternative.candidates
                tie = replace(
                    tie,
                    plan_only=odds_of_plan(*sets),
                    if_found=odds_with_plan(*sets),
                    if_other=odds_with_plan(*sets[::-1]),
                )
            elif missing_input:
                tie = replace(tie, missing_input=missing_input)
            else:
                odds = odds_of_plan(found, (*others, effects[name]))
                tie = replace(tie, plan_only=odds, if_found=odds)
            forecasts.append(tie)
    return forecasts


def _alternative(problem: Problem, others: Sequence[Candidate], effect: Effect) -> Hypothesis | None:
    """Hypothesis with an effect added to others; None if it can't be fitted."""
    if effect.missing_input(problem.campaign):
        return None
    search = Search(problem, (effect,))
    return search.add(fit_hypothesis(problem, others), search.effects[0])


def _odds(
    present: Sequence[Candidate],
    other: Sequence[Candidate | Effect],
    *,
    problem: Problem,
    campaign: Campaign,
    is_predicted: BoolArray,
    effects: Sequence[Effect],
) -> float:
    """Expected odds of the effects that are present to another set, both as fitted to a problem.

    ``other`` differs in one effect, which is an Effect if the problem can't fit it. ``is_predicted``: dwells
    of the campaign whose biases are predicted from the effects present, with noise. The expectation is that
    of the logarithm.
    """
    solution = solve_with(problem, present)
    runs = len(campaign.run_names) + DEGREE - solution.declared.shape[1]
    declared = np.pad(solution.declared, ((0, 0), (0, max(runs, 0))), constant_values=np.nan)
    declared = declared[:, : DEGREE + len(campaign.run_names)]
    columns = [each.columns(campaign) for each in present]
    predicted_dph = predict(campaign, declared, solution.sizes, columns)
    present_names = {each.effect.name for each in present}
    shared = [each for each in other if isinstance(each, Candidate) and each.effect.name in present_names]
    [new] = [each for each in other if each not in shared]
    random, logarithms = np.random.default_rng(0), []
    for _ in range(_DRAWS):
        noisy_dph = predicted_dph + campaign.sigma_dph * random.standard_normal(predicted_dph.shape)
        bias_dph = np.where(is_predicted[:, np.newaxis], noisy_dph, campaign.bias_dph)
        predicted_problem = declared_problem(
            replace(campaign, bias_dph=bias_dph),
            campaign.all_dwells,
            correlation_factor=problem.correlation_factor,
        )
        present_fit = fit_hypothesis(predicted_problem, refine(predicted_problem, present))
        rivals = [_alternative(predicted_problem, shared, new if isinstance(new, Effect) else new.effect)]
        if isinstance(new, Candidate):
            rivals.append(fit_hypothesis(predicted_problem, refine(predicted_problem, [*shared, new])))
        evidences = Evidences(predicted_problem, effects)
        # An effect that is not significant counts as absent.
        fitted = [each for each in rivals if each is not None] or [fit_hypothesis(predicted_problem, shared)]
        logarithms.append(0.5 * min(evidences.log_odds(present_fit, each) for each in fitted))
    return math.exp(float(np.clip(np.mean(logarithms), -_MAX_LOG_ODDS, _MAX_LOG_ODDS)))
