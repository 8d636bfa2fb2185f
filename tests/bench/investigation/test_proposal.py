from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from gyrobench.bench.closure.campaign import campaign_of
from gyrobench.bench.closure.effects.laws import TIME_DRIFT, WARM_UP
from gyrobench.bench.closure.posterior import HypothesisProbability, Posterior
from gyrobench.bench.investigation.blocks import Block, catalogue
from gyrobench.bench.investigation.choice import ExpectedEntropy, Rival
from gyrobench.bench.investigation.forecast import Forecast
from gyrobench.bench.investigation.open_hypotheses import confirming_rivals, rivals_of, search_campaign
from gyrobench.bench.investigation.proposal import (
    Outcome,
    PossibleBlocks,
    Proposal,
    is_confirmed_by,
    outcome_of,
    propose,
    remaining_hours_of,
)
from tests.bench.investigation.simulated_bench import first_campaign, simulate

UNIT = {"unit": "S1", "seed": 4, "effects": {"g_sensitivity": 0.004}}
UNIT["steps"] = first_campaign([45.0, 10.0, -20.0])


@pytest.fixture(scope="module")
def rows():
    return simulate(UNIT)


@pytest.fixture(scope="module")
def closure(rows):
    return search_campaign(campaign_of(rows), [2])


@pytest.fixture(scope="module")
def rivals(closure):
    return rivals_of(closure)


@pytest.fixture(scope="module")
def proposed(rows, rivals):
    """Proposals by the names of their blocks."""
    return {each.block.name: each for each in propose(Forecast(rows), rivals)}


@pytest.fixture(scope="module")
def hot(rows):
    """Dwells of the block ``hot, six positions``, measured after the campaign."""
    steps = next(each.plan for each in catalogue(rows) if each.name == "hot, six positions").steps
    return simulate(UNIT | {"steps": UNIT["steps"] + [step.model_dump() for step in steps]})[len(rows) :]


def test_an_effect_whose_input_only_a_block_has_is_predicted_for_that_block(rows, closure, rivals):
    gravity, magnetic = (
        next(each for each in rivals if each.names == (name,))
        for name in ("g_sensitivity", "magnetic_sensitivity")
    )
    assert [each.name for each in magnetic.unfitted] == ["magnetic_sensitivity"]
    pair = [replace(gravity, probability=0.5), replace(magnetic, probability=0.5)]
    found = {each.block.name: each for each in propose(Forecast(rows, closure.noise_scale), pair)}
    headings, cycle = found["four headings"], found["power cycle"]
    assert cycle.entropy_decrease == pytest.approx(0.0, abs=1e-6)
    assert headings.entropy_decrease > 0.05
    assert np.allclose(cycle.predictions[0].mean_dph, cycle.predictions[1].mean_dph)


def test_what_is_improbable_beside_the_cause_counts_as_the_cause(closure):
    assert [each.effect.name for each in closure.effects] == ["g_sensitivity"]
    weights = (
        (["g_sensitivity"], False, 0.6),
        (["g_sensitivity", "time_drift"], False, 0.2),
        (["g_sensitivity", "warm_up"], False, 0.08),
        (["g_sensitivity"], True, 0.07),
        (["magnetic_sensitivity"], False, 0.05),
    )
    posterior = Posterior(
        tuple(HypothesisProbability(frozenset(names), *each, ()) for names, *each in weights), {}
    )
    found = {each.title: each.probability for each in rivals_of(replace(closure, posterior=posterior))}
    assert found == {
        "g_sensitivity": pytest.approx(0.75),
        "g_sensitivity + time_drift": pytest.approx(0.2),
        "magnetic_sensitivity": pytest.approx(0.05),
    }


def test_a_kind_that_was_measured_is_worth_half_of_what_is_expected(rows, rivals, proposed):
    measured = [("four headings",), ("power cycle", "four headings")]
    for each in propose(Forecast(rows), rivals, PossibleBlocks(measured=measured)):
        name = each.block.name
        if name in ("four headings", "power cycle", "slow ramp"):
            repeats = {"four headings": 2, "power cycle": 1}.get(name, 0)
            assert each.gain_per_h == pytest.approx(proposed[name].gain_per_h * 0.5**repeats)


def test_an_effect_whose_input_the_new_dwells_lack_is_predicted_with_its_size_as_scatter(rows):
    unit = UNIT | {"effects": {"thermal_gradient": 0.01}}
    warm = simulate(unit)
    closure = search_campaign(campaign_of(warm), [2])
    rival = next(each for each in rivals_of(closure) if "thermal_gradient" in each.names)
    bare = [replace(row, board_c=(np.nan,) * 3, case_c=np.nan) for row in warm]
    forecast = Forecast(bare, closure.noise_scale)
    proposal = next(
        each
        for each in propose(forecast, [replace(rival, probability=1.0)])
        if each.block.name == "four headings"
    )
    assert np.isfinite(proposal.predictions[0].covariance).all()


def test_new_dwells_without_electronics_are_compared_with_the_forecast(rows, closure, rivals, proposed, hot):
    bare = [replace(row, board_c=(np.nan,) * 3) for row in hot]
    forecast = Forecast(rows, closure.noise_scale)
    outcome = outcome_of(forecast, proposed["hot, six positions"], bare, rivals)
    assert np.isfinite(outcome.error_dph).all()
    assert sum(outcome.probabilities) == pytest.approx(1.0)


def test_correlated_noise_makes_new_dwells_worth_less(rows, closure, hot):
    effect = Rival(("g_sensitivity",), tuple(each.candidate for each in closure.effects), 0.5)
    rivals, odds, gains = (effect, Rival((), (), 0.5)), [], []
    for factor in (1.0, 2.0):
        forecast = Forecast(rows, closure.noise.scales, factor)
        found = next(each for each in propose(forecast, rivals) if each.block.name == "hot, six positions")
        probable, improbable = outcome_of(forecast, found, hot, rivals).probabilities
        odds.append(np.log(probable / improbable))
        gains.append(found.tested_per_h)
    assert odds[1] == pytest.approx(odds[0] / 2.0)
    assert gains[1] < gains[0]


def proposal(hours, fall, unsettled, missing_h=0.0, replaced_h=0.0):
    """A proposal with an entropy of 0.6 nats before it."""
    plan = SimpleNamespace(duration_h=hours)
    expected = ExpectedEntropy(0.6 - fall, unsettled, (0.6 - fall) * (unsettled > 0.0))
    block = Block(("some",), "measure", plan)
    return Proposal(block, (), (), 0.6, expected, missing_h=missing_h, replaced_h=replaced_h)


def test_a_block_that_settles_the_cause_is_chosen_before_one_that_needs_another():
    settling, faster = proposal(2.0, 0.5, 0.0), proposal(1.9, 0.5, 1.0)
    assert faster.gain_per_h > settling.gain_per_h
    hours = remaining_hours_of([settling, faster])
    assert hours(settling) == 2.0
    assert hours(faster) == pytest.approx(1.9 + 1.9)


@pytest.mark.parametrize(
    ("fall", "unsettled", "can_help"), [(0.03, 1.0, True), (0.01, 0.4, True), (0.01, 0.6, False)]
)
def test_a_block_helps_by_the_doubt_that_it_removes_or_by_settling_the_cause(fall, unsettled, can_help):
    assert proposal(2.0, fall, unsettled).can_help == can_help


def test_a_block_does_not_help_by_settling_what_is_settled():
    settled = replace(proposal(2.0, 0.01, 0.0), entropy=0.05, expected=ExpectedEntropy(0.04, 0.0, 0.0))
    assert not settled.can_help


def test_a_cause_of_two_effects_is_confirmed_against_each_of_them_alone(closure):
    effects = [
        replace(closure.effects[0], candidate=replace(closure.effects[0].candidate, effect=each))
        for each in (WARM_UP, TIME_DRIFT)
    ]
    both = replace(closure, effects=tuple(effects))
    assert [each.names for each in confirming_rivals(both)] == [
        ("time_drift", "warm_up"), ("time_drift",), ("warm_up",),
    ]  # fmt: skip


def test_hours_until_the_biases_are_certain_count_too():
    cause, both = (
        proposal(2.0, 0.5, 0.0, missing_h=10.0),
        proposal(3.0, 0.5, 0.0, missing_h=4.0, replaced_h=6.0),
    )
    hours = remaining_hours_of([cause, both])
    assert (hours(cause), hours(both)) == (2.0 + 10.0 / 2.0 + 2.0, 3.0 + 4.0 / 2.0 + 2.0)
    assert remaining_hours_of([cause, both], is_settled=True)(both) == 7.0


def test_a_block_that_makes_the_biases_certain_is_chosen_before_short_ones_that_hardly_help():
    enough, short = (
        proposal(5.0, 0.0, 0.0, missing_h=0.0, replaced_h=3.0),
        proposal(1.7, 0.0, 0.0, missing_h=2.9, replaced_h=0.1),
    )
    hours = remaining_hours_of([enough, short], is_settled=True)
    assert hours(enough) < hours(short)


def test_a_cause_is_confirmed_by_the_latest_block_that_says_something_about_it():
    agrees = Outcome((0.999, 0.001), (0.0, 0.0), 0.001, (0.5, 0.0), 0.0)
    contradicts = Outcome((0.001, 0.999), (0.0, 0.0), 0.001, (0.0, 0.5), 0.0)
    leaves_open = Outcome((0.6, 0.4), (0.0, 0.0), 0.001, (0.5, 0.5), 0.0)
    assert is_confirmed_by([agrees, leaves_open])
    assert is_confirmed_by([contradicts, agrees])
    assert not is_confirmed_by([agrees, contradicts])
    assert not is_confirmed_by([leaves_open])
    assert not is_confirmed_by([])
