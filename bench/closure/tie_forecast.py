"""Odds that a planned campaign is expected to give for the ties that a closure leaves open.

The unit of a closure has the noise, sensors and temperatures measured. For each tie, the dwells of the
plan are predicted by each of the two hypotheses as fitted; both are then fitted to the dwells measured
together with the predicted ones, as a search after the measurement would do.
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

_SMALLEST, _MAX_LOG_ODDS = 1e-150, 345.0
#: Draws of the noise of a plan.
_DRAWS = 5


def measured_properties(closure: Closure, estimate: ThermalEstimate) -> UnitProperties:
    """The unit of a closure: its noise, sensors, and temperatures fitted to the campaign.

    ``estimate`` is of a typical unit: it stands for what was not measured.
    """
    campaign = closure.campaign
    hours = (campaign.end_s - campaign.start_s)[:, np.newaxis] / S_PER_H
    variance = (closure.noise_scale * campaign.sigma_dph) ** 2 * hours
    return UnitProperties(
        np.sqrt(variance[closure.searched].mean(axis=0)),
        "as measured in the closure",
        has_boards=bool(np.isfinite(campaign.board_c).all()),
        has_case=bool(np.isfinite(campaign.case_c).all()),
        thermal=UnitThermal.typical(estimate).fitted_to(campaign)[0],
    )


@dataclass(frozen=True)
class TieForecast:
    """A tie of a closure, and the odds that a plan is expected to lead to."""

    found: str  #: Name of the effect found.
    other: str  #: Name of the effect tied with it.
    now: float  #: Odds by which the dwells searched prefer the effect found.
    #: Expected odds for the effect found if it is present, from the dwells of the plan that a search uses.
    alone: float = math.nan
    #: if_found, if_other: Expected odds for the one that is present, from the dwells searched and all of the
    #: plan. NaN, like ``alone``, where neither closure nor plan can fit the other; where only the plan can,
    #: ``if_found`` is of the plan alone.
    if_found: float = math.nan
    if_other: float = math.nan
    missing_input: str | None = None  #: Why the plan can't fit the other.

    @property
    def is_settled(self) -> bool:
        """Whether it is expected to be settled, whichever is present."""
        expected = [each for each in (self.if_found, self.if_other) if not math.isnan(each)]
        return bool(expected) and min(expected) >= TIE_ODDS


def tie_forecasts(closure: Closure, planned: Campaign) -> list[TieForecast]:
    """The ties of a closure after a planned campaign that begins at its end."""
    effects = {each.effect.name: each.effect for each in closure.evidence}
    problem = closure.noise.problem(closure.campaign, closure.searched)
    found = tuple(each.candidate for each in closure.effects)
    names = {each.effect.name for each in found}
    seen = replace(problem.campaign.part(closure.searched), tables=(), part_of=None)
    seen = replace(seen, sigma_dph=seen.sigma_dph * closure.noise_scale)
    planned = replace(planned, unit=seen.unit)
    together = join_tables([TableToJoin("measured", seen), TableToJoin("planned", planned, is_run=True)])
    whole, alone = (
        partial(
            _odds, problem=problem, is_predicted=is_predicted, campaign=campaign, effects=[*effects.values()]
        )
        for campaign, is_predicted in (
            (together, np.arange(len(together)) >= len(seen)),
            (searched_dwells(planned), np.ones(len(searched_dwells(planned)), dtype=bool)),
        )
    )
    forecasts = []
    for one in closure.effects:
        others = [each for each in found if each is not one.candidate]
        for name in dict.fromkeys(one.tied_with):
            chances = [closure.posterior.of_set(each) for each in (names, names - {one.effect.name} | {name})]
            tie = TieForecast(one.effect.name, name, _ratio(*chances))
            instead = _alternative(problem, others, effects[name])
            missing = effects[name].missing_input(planned)
            if instead is not None:
                both = found, instead.candidates
                tie = replace(tie, alone=alone(*both), if_found=whole(*both), if_other=whole(*both[::-1]))
            elif missing:
                tie = replace(tie, missing_input=missing)
            else:
                odds = alone(found, (*others, effects[name]))
                tie = replace(tie, alone=odds, if_found=odds)
            forecasts.append(tie)
    return forecasts


def _alternative(problem: Problem, others: Sequence[Candidate], effect: Effect) -> Hypothesis | None:
    """Hypothesis with an effect beside others; None if it can't be fitted."""
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
    """Expected odds of the effects that are present against others, both as fitted to a problem.

    ``other`` differs by one, an Effect if the problem can't fit it. ``is_predicted``: the dwells of the
    campaign of which the biases are predicted by the effects present, with noise; the expectation is that of
    the logarithm.
    """
    solution = solve_with(problem, present)
    runs = len(campaign.run_names) + DEGREE - solution.declared.shape[1]
    declared = np.pad(solution.declared, ((0, 0), (0, max(runs, 0))), constant_values=np.nan)
    declared = declared[:, : DEGREE + len(campaign.run_names)]
    columns = [each.columns(campaign) for each in present]
    predicted_dph = predict(campaign, declared, solution.sizes, columns)
    known = {each.effect.name for each in present}
    shared = [each for each in other if isinstance(each, Candidate) and each.effect.name in known]
    [new] = [each for each in other if each not in shared]
    draw, logarithms = np.random.default_rng(0), []
    for _ in range(_DRAWS):
        drawn_dph = predicted_dph + campaign.sigma_dph * draw.standard_normal(predicted_dph.shape)
        bias_dph = np.where(is_predicted[:, np.newaxis], drawn_dph, campaign.bias_dph)
        after = declared_problem(replace(campaign, bias_dph=bias_dph), np.ones(len(campaign), dtype=bool))
        own = fit_hypothesis(after, refine(after, present))
        rivals = [_alternative(after, shared, new if isinstance(new, Effect) else new.effect)]
        if isinstance(new, Candidate):
            rivals.append(fit_hypothesis(after, refine(after, [*shared, new])))
        evidences = Evidences(after, effects)
        # What is not significant is as probable as nothing.
        fitted = [each for each in rivals if each is not None] or [fit_hypothesis(after, shared)]
        logarithms.append(0.5 * min(evidences.log_odds(own, each) for each in fitted))
    return math.exp(float(np.clip(np.mean(logarithms), -_MAX_LOG_ODDS, _MAX_LOG_ODDS)))


def _ratio(one: float, other: float) -> float:
    return max(one, _SMALLEST) / max(other, _SMALLEST)
