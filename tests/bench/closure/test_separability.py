"""Sizes found and distinguished in a campaign, compared with searches of simulated biases."""

from dataclasses import replace

import numpy as np
import pytest

from gyrobench.bench.cli.plan import declared_properties
from gyrobench.bench.closure.effects import all_effects
from gyrobench.bench.closure.effects.effect import Effect, Form, Parameter, fixed
from gyrobench.bench.closure.planned_campaign import planned_campaign
from gyrobench.bench.closure.problem import declared_problem
from gyrobench.bench.closure.search import EFFECT_SIGNIFICANCE, Search
from gyrobench.bench.closure.separability import searched_dwells, separability, unit_components
from tests.bench.closure.plans import dwell, planned, shipped, station

EFFECTS = {effect.name: effect for effect in all_effects()}


@pytest.fixture(scope="module")
def campaign():
    """The dwells of the procedure of the paper's Fig. 7 that a search sees."""
    _, plan = shipped("six_position_fig7")
    return searched_dwells(planned_campaign(plan, declared_properties(station())))


@pytest.fixture(scope="module")
def result(campaign):
    return separability(campaign, all_effects())


def detection(result, name):
    [found] = [each for each in result.detections if each.effect.name == name]
    return found


def following(name, *values):
    """An effect with terms that follow given numbers, the same for all gyros."""

    def columns(_, __):
        return np.repeat(np.stack(values, axis=1)[:, np.newaxis, :], 3, axis=1)

    return Effect(name, "", "", (Form(tuple(map(str, range(len(values)))), columns),))


def searched(campaign, name, size_dph, seed, beside=()):
    """Search of made-up biases: one effect without parameters at some size, and noise."""
    rng = np.random.default_rng(seed)
    parts = unit_components(EFFECTS[name].forms[0].columns(campaign, ()))
    signs = rng.choice([-1.0, 1.0], (3, parts.shape[2]))
    bias_dph = size_dph * np.einsum("ngk,gk->ng", parts, signs)
    bias_dph += rng.normal(size=bias_dph.shape) * campaign.sigma_dph
    problem = declared_problem(replace(campaign, bias_dph=bias_dph), campaign.all_dwells)
    return Search(problem, [EFFECTS[each] for each in (name, *beside)])


def share_found(campaign, name, size_dph, repeats=60):
    """How often the search finds an effect, were it to try all effects."""
    found = 0
    for seed in range(repeats):
        search = searched(campaign, name, size_dph, seed)
        alone = search.single_effects.get(name)
        found += alone is not None and search.p_value(alone, 0) * len(EFFECTS) < EFFECT_SIGNIFICANCE
    return found / repeats


@pytest.mark.long
@pytest.mark.parametrize("name", ["temperature_rate", "g_sensitivity", "time_drift"])
def test_the_search_finds_nine_of_ten_effects_of_the_stated_size(campaign, result, name):
    size_dph = detection(result, name).typical_dph
    # Three standard deviations of 60 trials.
    assert share_found(campaign, name, size_dph) == pytest.approx(0.9, abs=0.12)
    assert share_found(campaign, name, 0.5 * size_dph) < 0.3


@pytest.mark.parametrize(("factor", "is_distinguished"), [(0.5, False), (2.0, True)])
def test_the_search_ties_effects_below_the_stated_size_and_not_above(
    campaign, result, factor, is_distinguished
):
    true, alternative = "time_drift", "bias_jump"
    size_dph = factor * result.distinguished_dph[true, alternative]
    distinguished = []
    for seed in range(8):
        search = searched(campaign, true, size_dph, seed, beside=(alternative,))
        posterior = search.evidences.posterior([search.declared, *search.single_effects.values()])
        distinguished.append(alternative not in posterior.tied_with(frozenset({true}), true))
    assert np.mean(distinguished) == pytest.approx(float(is_distinguished), abs=0.3)


def test_a_special_case_of_another_effect_is_distinguished_as_soon_as_it_is_found(result):
    size_dph = result.distinguished_dph["thermal_gradient", "attitude_thermal"]
    assert size_dph == detection(result, "thermal_gradient").typical_dph
    assert result.correlation["thermal_gradient", "attitude_thermal"] == pytest.approx(1.0, abs=1e-3)


def test_sizes_go_with_the_noise(campaign, result):
    noisier = separability(replace(campaign, sigma_dph=2.0 * campaign.sigma_dph), all_effects())
    for one, other in zip(result.detections, noisier.detections, strict=True):
        assert other.typical_dph == pytest.approx(2.0 * one.typical_dph)
        assert other.inflation == pytest.approx(one.inflation, rel=1e-3)


def test_independent_effects_inflate_nothing_and_equal_ones_without_bounds(campaign):
    order = np.arange(len(campaign))
    one, two = np.cos(2.0 * np.pi * order / 5.0), np.sin(2.0 * np.pi * order / 3.0)
    apart = separability(campaign, [following("one", one), following("two", two)])
    assert max(each.inflation for each in apart.detections) < 1.3
    assert apart.nearest_alternative("one") == ("two", detection(apart, "one").typical_dph)
    same = separability(campaign, [following("one", one), following("same", -3.0 * one)])
    assert [each.inflation for each in same.detections] == [np.inf, np.inf]
    assert same.correlation["one", "same"] == pytest.approx(1.0)
    assert same.distinguished_dph["one", "same"] == np.inf
    assert same.not_distinguished(1.0) == [("one", "same")]
    assert not same.is_settled("one", 1.0)


def test_an_effect_within_the_declared_model_is_not_observable(campaign):
    result = separability(campaign, [following("cubic", (campaign.gyro_c[:, 0] / 50.0) ** 3)])
    assert result.detections[0].typical_dph == np.inf
    assert result.detections[0].missing_input is not None
    assert result.nearest_alternative("cubic") is None
    assert result.not_found(1.0) == ["cubic"]


def test_an_effect_with_a_missing_input_names_it(campaign):
    result = separability(replace(campaign, set_c=np.full(len(campaign), np.nan)), all_effects())
    assert detection(result, "chamber_state").missing_input == "the chamber's set point"
    assert not any("chamber_state" in pair for pair in result.distinguished_dph)


def test_an_input_that_only_one_form_of_an_effect_lacks_is_not_missing():
    _, plan = planned(f"  - power_on\n{dwell('z_up')}{dwell('y_up')}")
    few = searched_dwells(planned_campaign(plan, declared_properties(station())))
    missing = detection(separability(few, all_effects()), "attitude_thermal").missing_input
    assert missing == "dwells with a larger variation of what the effect follows"


def test_the_worst_value_of_a_parameter_counts(campaign):
    def late(_, values):
        return np.repeat((np.arange(30) >= values[0]).astype(float)[:, None, None], 3, axis=1)

    jump = Effect("jump", "", "", (Form(("after",), late, (Parameter("at", 0, 30, fixed(6, 14, 27)),)),))
    found = detection(separability(campaign, [jump]), "jump")
    assert found.largest_dph > 2.0 * found.typical_dph


def test_the_last_cycle_is_held_out_unless_it_is_the_only_one():
    _, plan = shipped("six_position_fig7")
    whole = planned_campaign(plan, declared_properties(station()))
    assert set(searched_dwells(whole).cycle.tolist()) == {1}
    assert len(searched_dwells(searched_dwells(whole))) == 30
