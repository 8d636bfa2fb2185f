from dataclasses import replace

import numpy as np
import pytest

from gyrobench.bench.closure.campaign import campaign_of
from gyrobench.bench.closure.candidates import fit_hypothesis
from gyrobench.bench.closure.effects import all_effects
from gyrobench.bench.closure.effects.effect import Effect, Form
from gyrobench.bench.closure.effects.laws import (
    BIAS_JUMP,
    TEMPERATURE_RATE,
    THERMAL_HYSTERESIS,
    THERMAL_LAG,
    TIME_DRIFT,
)
from gyrobench.bench.closure.posterior import TIE_ODDS
from gyrobench.bench.closure.problem import declared_problem
from gyrobench.bench.closure.search import EFFECT_SIGNIFICANCE, MAY_CORRECT_LAWS, Search
from tests.bench.closure.conftest import EQUIPPED, among
from tests.bench.closure.thermal_bench import SIGMA_DPH, measure

CLEAN_SEEDS = range(8)
TRIANGLE = ((-20.0, 0.2, 0.0), (60.0, 0.2, 0.0), (20.0, 0.2, 0.0))


@pytest.fixture(scope="module")
def search(problem):
    """``search(effects, among, **options of measure)``: the search and the best set that it finds.

    ``among``: names of the candidates, by default all.
    """
    done = {}

    def of(effects=None, among=None, **options):
        key = (*(effects or {}).items(), among, *sorted(options.items()))
        if key not in done:
            candidates = [each for each in all_effects() if among is None or each.name in among]
            one = Search(problem(effects, **options), candidates)
            done[key] = one, one.best()
        return done[key]

    return of


def following_dwell(*numbers):
    """An effect that is there in a few dwells only."""

    def columns(campaign, _):
        return np.isin(np.arange(len(campaign)), numbers)[:, None, None] * np.ones((1, 3, 1))

    return Effect("dwells", "", "", (Form(("in the dwell",), columns),))


@pytest.mark.parametrize(
    ("effect", "size"),
    [
        ("attitude_thermal", 3.0),
        ("thermal_lag", 4.0),
        ("warm_up", 3.0),
        ("bias_jump", 3.0),
        pytest.param("temperature_rate", 4.0, marks=pytest.mark.long),
        pytest.param("thermal_hysteresis", 3.0, marks=pytest.mark.long),
        pytest.param("time_drift", 3.0, marks=pytest.mark.long),
        pytest.param("g_sensitivity", 3.0, marks=pytest.mark.long),
        pytest.param("chamber_state", 3.0, marks=pytest.mark.long),
    ],
)
def test_an_effect_is_found_alone(search, effect, size):
    one, best = search({effect: size}, cycles=2, seed=1)
    assert best.names == {effect}
    assert one.p_value(best, 0) < 1e-9


def ties(one, best):
    """Effects tied with those of the best hypothesis."""
    _, posterior = one.most_probable()
    return tuple(other for name in best.names for other in posterior.tied_with(best.names, name))


def test_the_gradient_is_found_where_the_electronics_power_changes(search):
    one, best = search({"thermal_gradient": 4.0}, power_steps_h=5.3)
    assert best.names == {"thermal_gradient"}
    assert ties(one, best) == ()


@pytest.mark.parametrize("seeds", [CLEAN_SEEDS[:3], pytest.param(CLEAN_SEEDS, marks=pytest.mark.long)])
def test_in_clean_data_nothing_is_found(problem, seeds):
    found = [Search(problem(seed=seed, cycles=2), all_effects()).best().names for seed in seeds]
    assert found == [frozenset()] * len(seeds)


@pytest.mark.parametrize("outside", ["sinusoid", "square_wave"])
def test_an_effect_that_no_candidate_has_is_not_made_up_from_them(search, outside):
    _, best = search({outside: 1.5}, cycles=2, seed=1)
    assert len(best.candidates) <= 1


OF_TWO = among("g_sensitivity", "bias_jump", "thermal_lag", "time_drift", name="among")


@OF_TWO
def test_two_effects_are_found_together(search, among):
    one, best = search({"g_sensitivity": 4.0, "bias_jump": 4.0}, among, cycles=2, seed=7)
    assert best.names == {"g_sensitivity", "bias_jump"}
    assert max(one.p_value(best, 0), one.p_value(best, 1)) < 1e-9


OVER_TIME = among("warm_up", "time_drift", "ageing", "thermal_lag", name="among")


@OVER_TIME
def test_warm_up_and_drift_are_distinguished_over_several_cycles(search, among):
    _, best = search({"warm_up": 4.0, "time_drift": 6.0}, among, seed=7, sensors=())
    assert best.names == {"warm_up", "time_drift"}


THREE = {"g_sensitivity": 4.0, "bias_jump": 4.0, "thermal_hysteresis": 4.0}
AMONG = among(*THREE, "attitude_thermal", name="among")


@AMONG
def test_three_effects_are_found_together(search, among):
    _, best = search(THREE, among, cycles=2, seed=7)
    assert best.names == THREE.keys()


@pytest.mark.long
def test_no_effect_of_the_best_set_has_a_better_one_in_its_place(search):
    one, best = search(THREE, cycles=2, seed=7)
    for left_out in best.candidates:
        others = fit_hypothesis(one.problem, [each for each in best.candidates if each is not left_out])
        for effect in one.effects:
            instead = None if effect.name in best.names else one.add(others, effect)
            assert instead is None or instead.bic > best.bic


@AMONG
def test_the_first_of_several_effects_may_be_one_that_is_none_of_them(search, among):
    """Of one effect at a time a stand-in for several does best; it is exchanged for them later."""
    one, best = search(THREE, among, cycles=2, seed=7)
    first = min(one.single_effects.values(), key=lambda each: each.bic)
    assert first.names.isdisjoint(best.names)


@pytest.mark.parametrize(("effect", "drift"), [(THERMAL_LAG, 0.0), (TIME_DRIFT, 8.0)])
def test_what_one_width_lacks_of_a_hysteresis_of_many_is_no_second_effect(problem, effect, drift):
    """A lag takes it up, and is significant. A drift that is there is accepted."""
    one, [width, many] = problem(), THERMAL_HYSTERESIS.forms
    bias_dph = one.campaign.bias_dph.copy()
    for form, values, size in ((many, (8.0,), 40.0), (TIME_DRIFT.forms[0], (), drift)):
        course = form.columns(one.campaign, values)[:, :, 0]
        bias_dph += size * SIGMA_DPH * course / course.std()
    searched = declared_problem(replace(one.campaign, bias_dph=bias_dph), one.searched)
    searching = Search(searched, [replace(THERMAL_HYSTERESIS, forms=(width,)), effect])
    both = searching.add(searching.single_effects["thermal_hysteresis"], effect)
    place = [each.effect.name for each in both.candidates].index(effect.name)
    assert searching.p_value(both, place) < EFFECT_SIGNIFICANCE
    assert searching.correction_objection(both, place).startswith(MAY_CORRECT_LAWS) == (drift == 0.0)


def test_an_effect_in_one_dwell_is_not_found(problem):
    one = problem()
    bias_dph = one.campaign.bias_dph.copy()
    bias_dph[20] += 10.0 * SIGMA_DPH
    searched = declared_problem(replace(one.campaign, bias_dph=bias_dph), one.searched)
    searching = Search(searched, [BIAS_JUMP, following_dwell(20)])
    assert searching.p_value(searching.single_effects["dwells"], 0) < EFFECT_SIGNIFICANCE
    assert "dwells" not in searching.best().names


def test_an_effect_with_most_of_its_gain_in_one_dwell_is_found_if_the_others_show_it_too(problem):
    """One dwell has 51 % of the gain or more; without it the effect is still significant."""
    one = problem()
    shape = np.zeros((len(one.campaign), 1, 1))
    shape[[20, *range(25, 61, 3)], 0, 0] = [1.0] + [0.25] * 12
    loads = Effect("loads", "", "", (Form(("load",), lambda campaign, _: shape * np.ones((1, 3, 1))),))
    bias_dph = one.campaign.bias_dph + 12.0 * SIGMA_DPH * shape[:, :, 0]
    searching = Search(declared_problem(replace(one.campaign, bias_dph=bias_dph), one.searched), [loads])
    assert searching.best().names == {"loads"}


def test_an_effect_that_is_not_accepted_has_an_objection(problem):
    one = problem()
    bias_dph = one.campaign.bias_dph.copy()
    bias_dph[20] += 10.0 * SIGMA_DPH
    searched = declared_problem(replace(one.campaign, bias_dph=bias_dph), one.searched)
    searching = Search(searched, [following_dwell(20)])
    assert searching.objection(searching.single_effects["dwells"], 0) == (
        "it rests on dwell 21 alone (p = 1 without it)"
    )


def test_an_effect_in_several_dwells_is_found(problem):
    one = problem()
    bias_dph = one.campaign.bias_dph.copy()
    bias_dph[[20, 31, 45]] += 10.0 * SIGMA_DPH
    searched = declared_problem(replace(one.campaign, bias_dph=bias_dph), one.searched)
    assert Search(searched, [following_dwell(20, 31, 45)]).best().names == {"dwells"}


def test_each_gyro_says_by_itself_whether_it_shows_an_effect(problem):
    one = problem({"time_drift": 5.0})
    bias_dph = one.campaign.bias_dph.copy()
    bias_dph[:, [0, 2]] = problem(seed=3).campaign.bias_dph[:, [0, 2]]
    mixed = Search(declared_problem(replace(one.campaign, bias_dph=bias_dph), one.searched), [TIME_DRIFT])
    best = mixed.best()
    assert best.names == {"time_drift"}
    assert mixed.significant_gyros(best, 0) == [False, True, False]


def test_a_special_case_at_the_lower_bound_of_a_parameter_is_no_tie(search):
    """A lag of a second follows the rate as well as the rate itself."""
    one, best = search({"temperature_rate": 4.0}, cycles=2, seed=1)
    assert one.single_effects["thermal_lag"].bic < best.bic + 2.0 * np.log(TIE_ODDS)
    assert ties(one, best) == ()


def test_what_reproduces_an_effect_in_one_campaign_alone_is_a_tie(problem):
    """As a step of the supply a jump: only what contains the effect in any campaign is no other cause."""
    one = problem({"temperature_rate": 4.0}, seed=1)
    for contains, tied in (THERMAL_LAG.contains, ()), ((), ("thermal_lag",)):
        searching = Search(one, [TEMPERATURE_RATE, replace(THERMAL_LAG, contains=contains)])
        best, _ = searching.most_probable()
        assert best.names == {"temperature_rate"}
        assert ties(searching, best) == tied


@OF_TWO
def test_the_probability_of_an_effect_does_not_go_by_its_place_in_the_set(search, among):
    one, best = search({"g_sensitivity": 4.0, "bias_jump": 4.0}, among, cycles=2, seed=7)
    backward = replace(best, candidates=best.candidates[::-1])
    assert one.p_value(best, 0) == pytest.approx(one.p_value(backward, 1))


def test_terms_that_explain_nothing_are_not_added(problem):
    nothing = Effect(
        "nothing", "", "", (Form(("zero",), lambda campaign, _: np.zeros((len(campaign), 3, 1))),)
    )
    assert Search(problem({"time_drift": 4.0}), [nothing]).single_effects == {}


def test_a_weak_effect_of_one_ramp_rate_is_not_distinguished_from_similar_ones(search):
    one, best = search({"temperature_rate": 1.0}, profile=TRIANGLE, cycles=2)
    [found] = best.names
    assert {"temperature_rate", "thermal_gradient"} <= {found, *ties(one, best)}


def test_a_slow_warm_up_in_few_hours_looks_like_a_drift(search):
    """Six hours at one temperature: what decays with many hours and what drifts are the same."""

    def slow_decay(course):
        return 2.0 ** (-course.time_h / 20.0)[:, None]

    one, best = search({slow_decay: 4.0}, profile=((20.0, 1.0, 6.0),), cycles=3)
    assert best.names | {*ties(one, best)} >= {"warm_up", "time_drift"}


def after_start(law):
    """An effect that follows the share of the campaign since its start."""

    def over_campaign(course):
        return law(course.time_h / course.time_h[-1])[:, None]

    return over_campaign


@pytest.mark.parametrize(
    ("law", "size", "found"),
    [
        (lambda share: np.exp(-share / 4.0), 20.0, {"ageing"}),
        (lambda share: np.exp(-share / 20.0), 10.0, {"time_drift"}),
    ],
)
def test_a_time_constant_at_its_upper_bound_counts_where_a_line_is_excluded(problem, law, size, found):
    """Both time constants are above three lengths of the campaign; the longer one looks like a line."""
    one = problem({after_start(law): size}, cycles=4, power_on_each_cycle=True, sensors=())
    searching = Search(one, all_effects())
    [alone] = searching.single_effects["ageing"].candidates
    assert alone.values[0] >= 0.999 * alone.form.parameters[0].high
    assert bool(searching.objection(searching.single_effects["ageing"], 0)) == ("ageing" not in found)
    best, posterior = searching.most_probable()
    assert best.names == found
    assert posterior.sets[0] == found


def test_an_effect_that_contains_the_one_found_is_no_alternative(search):
    one, best = search({"g_sensitivity": 3.0}, cycles=2, seed=1, headings_deg=EQUIPPED["headings_deg"])
    assert ties(one, best) == ()
    # Alone, heat flow that depends on attitude at all temperatures says nearly the same.
    assert one.single_effects["attitude_thermal"].chi2 < 0.5 * one.declared.chi2


@OF_TWO
def test_alternatives_are_not_in_the_hypothesis(search, among):
    one, best = search({"g_sensitivity": 4.0, "bias_jump": 4.0}, among, cycles=2, seed=7)
    assert best.names.isdisjoint(ties(one, best))


def test_an_effect_in_the_set_is_not_added_twice(search):
    one, best = search({"warm_up": 3.0}, cycles=2, seed=1)
    [effect] = [each for each in one.effects if each.name == "warm_up"]
    assert one.add(best, effect) is None


@OVER_TIME
def test_each_effect_of_the_best_set_is_significant(search, among):
    one, best = search({"warm_up": 4.0, "time_drift": 6.0}, among, seed=7, sensors=())
    assert all(one.p_value(best, index) < EFFECT_SIGNIFICANCE for index in range(len(best.candidates)))


def test_effects_with_missing_inputs_are_not_fitted(search):
    one, _ = search({"bias_jump": 3.0}, sensors=())
    assert one.single_effects.keys().isdisjoint({"chamber_state", "thermal_gradient"})


@pytest.mark.parametrize(("seed", "is_clear"), [(20, True), (2, False)])
def test_the_form_with_the_smallest_bic_is_selected_unless_another_one_is_clearly_more_probable(
    seed, is_clear
):
    """In both campaigns the other form is more probable: by odds of 3.6, and of 1.7."""
    measured = measure({"attitude_thermal": 1.2}, seed=seed, cycles=1, headings_deg=(0.0, 90.0))
    data = declared_problem(campaign_of(measured.rows), np.ones(len(measured.rows), bool))
    laws = [each for each in all_effects() if each.name in ("attitude_thermal", "g_sensitivity")]
    selected, posterior = Search(data, laws).most_probable()
    [found] = selected.candidates
    [(probability, _)] = posterior.other_forms(selected.names, found)
    assert (probability < 0.5) == is_clear
