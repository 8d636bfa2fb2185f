from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import minimize, rosen

from gyrobench.bench.closure.candidates import (
    Candidate,
    best_start,
    bic_penalty,
    fit_hypothesis,
    nelder_mead,
    refine,
    stack,
    starts,
)
from gyrobench.bench.closure.effects import attitude_thermal
from gyrobench.bench.closure.effects.effect import Effect, Form, Parameter, fixed
from gyrobench.bench.closure.effects.laws import (
    BIAS_JUMP,
    G_SENSITIVITY,
    THERMAL_HYSTERESIS,
    THERMAL_LAG,
    TIME_DRIFT,
    WARM_UP,
)
from tests.bench.closure.thermal_bench import HALF_WIDTH_C, LAG_H, WARM_UP_H


def fitted(problem, effect):
    return refine(problem, [best_start(problem, effect, effect.forms[0])])[0]


def whole(effect, *values):
    form = effect.forms[0]
    return Candidate(effect, form, values, np.ones((3, len(form.terms)), dtype=bool))


@pytest.mark.parametrize(
    ("effect", "true", "tolerance"),
    [
        (THERMAL_HYSTERESIS, HALF_WIDTH_C, 0.08),
        (THERMAL_LAG, LAG_H * 3600.0, 0.08),
        (WARM_UP, WARM_UP_H * 3600.0, 0.05),
        (BIAS_JUMP, 0.4 * 3 * 67_200.0, 0.01),
    ],
)
def test_the_parameter_of_an_effect_is_recovered(problem, effect, true, tolerance):
    one = problem({effect.name: 10.0})
    assert fitted(one, effect).values == (pytest.approx(true, rel=tolerance),)


def test_parameters_of_two_effects_are_improved_together(problem):
    one = problem({"warm_up": 8.0, "thermal_hysteresis": 8.0})
    begun = [whole(WARM_UP, 2700.0), whole(THERMAL_HYSTERESIS, 7.0)]
    better = refine(one, begun)
    assert (
        one.chi2_reduction(*stack(better, one.campaign))[0]
        > one.chi2_reduction(*stack(begun, one.campaign))[0]
    )
    (tau_s,), (half_width_c,) = (each.values for each in better)
    assert tau_s == pytest.approx(WARM_UP_H * 3600.0, rel=0.1)
    assert half_width_c == pytest.approx(HALF_WIDTH_C, rel=0.1)


def test_a_parameter_stays_between_its_bounds(problem):
    def columns(campaign, values):
        return np.repeat(np.exp(-campaign.middle_s / 3600.0 / values[0])[:, None, None], 3, axis=1)

    form = Form(("decay",), columns, (Parameter("tau_h", 0.2, 1.0, fixed(0.5)),))
    best = fitted(problem({"warm_up": 8.0}), Effect("short_warm_up", "", "", (form,)))
    assert best.values == (pytest.approx(1.0),)


def test_the_start_is_the_one_of_the_grid_that_explains_most(problem):
    one, form = problem({"thermal_hysteresis": 8.0}), THERMAL_HYSTERESIS.forms[0]
    start = best_start(one, THERMAL_HYSTERESIS, form)
    assert start.values in starts(form, one.campaign)
    gain = one.chi2_reduction(start.columns(one.campaign))[0]
    assert gain == max(
        one.chi2_reduction(form.columns(one.campaign, each))[0] for each in starts(form, one.campaign)
    )
    assert start.kept.all()


def test_a_form_without_parameters_has_nothing_to_improve(problem):
    drift = whole(TIME_DRIFT)
    assert refine(problem(), [drift]) == [drift]
    assert drift.parameter_count == 3


def test_all_combinations_of_starting_values_are_tried(clean):
    parameters = (Parameter("a", 0, 9, fixed(1.0, 2.0)), Parameter("b", 0, 9, fixed(3.0, 4.0, 5.0)))
    form = Form(("term",), lambda campaign, _: campaign.rate_c_per_h[:, :, None], parameters)
    assert starts(form, clean) == [(1, 3), (1, 4), (1, 5), (2, 3), (2, 4), (2, 5)]
    assert starts(TIME_DRIFT.forms[0], clean) == [()]


def test_the_parameters_of_a_candidate_are_those_of_its_form_and_the_terms_kept():
    attitude = attitude_thermal.EFFECT
    kept = np.array([[True, False, False, True], [True, True, False, False], [True, False, False, False]])
    assert Candidate(attitude, attitude.forms[0], (45.0, 3.0), kept).parameter_count == 7


@pytest.mark.parametrize("count", [1, 2, 4])
def test_the_simplex_takes_the_steps_of_scipys(count):
    def cost(point):
        return rosen(np.append(point, 0.5)) if count > 1 else np.cosh(point[0] - 0.7)

    simplex = np.vstack([np.zeros(count), np.eye(count)])
    options = {"initial_simplex": simplex, "xatol": 1e-3, "fatol": 1e-3, "maxfev": 4000}
    expected = minimize(cost, simplex[0], method="Nelder-Mead", options=options)
    assert expected.success
    np.testing.assert_allclose(nelder_mead(cost, simplex, 4000, 1e-3, 1e-3), expected.x, rtol=1e-12)


def test_without_effects_there_is_no_penalty(problem):
    one = problem()
    nothing = fit_hypothesis(one, [])
    assert nothing.candidates == ()
    assert nothing.chi2 == nothing.bic == one.chi2


def test_terms_that_the_data_have_are_kept_and_others_dropped(problem):
    def shape(course):
        return course.up[:, [0, 0, 0]] + course.up[:, [2, 2, 2]]

    [sensitivity] = fit_hypothesis(problem({shape: 6.0}), [whole(G_SENSITIVITY)]).candidates
    np.testing.assert_array_equal(sensitivity.kept, [[True, False, True]] * 3)


def test_each_gyro_keeps_one_term_of_an_effect_that_is_not_there(problem):
    [sensitivity] = fit_hypothesis(problem(), [whole(G_SENSITIVITY)]).candidates
    np.testing.assert_array_equal(sensitivity.kept.sum(axis=1), [1, 1, 1])


def test_terms_dropped_before_do_not_come_back(problem):
    kept = np.array([[False, True, False]] * 3)
    only_one = replace(whole(G_SENSITIVITY), kept=kept)
    [still] = fit_hypothesis(problem({"g_sensitivity": 4.0}), [only_one]).candidates
    np.testing.assert_array_equal(still.kept, kept)


def test_the_bic_is_chi2_and_the_penalty_of_each_parameter(problem):
    one = problem({"time_drift": 4.0})
    drift = fit_hypothesis(one, [whole(TIME_DRIFT)])
    left = one.chi2 - one.chi2_reduction(TIME_DRIFT.forms[0].columns(one.campaign, ()))[0]
    assert drift.chi2 == pytest.approx(left)
    assert drift.bic == pytest.approx(left + 3 * bic_penalty(one))
    assert bic_penalty(one) == pytest.approx(np.log(75))


def test_a_present_effect_lowers_the_bic_and_an_absent_one_raises_it(problem):
    there, not_there = problem({"time_drift": 4.0}), problem()
    assert fit_hypothesis(there, [whole(TIME_DRIFT)]).bic < fit_hypothesis(there, []).bic
    assert fit_hypothesis(not_there, [whole(TIME_DRIFT)]).bic > fit_hypothesis(not_there, []).bic


def test_a_set_has_the_names_of_its_effects(problem):
    both = fit_hypothesis(problem(), [whole(TIME_DRIFT), whole(G_SENSITIVITY)])
    assert both.names == {"time_drift", "g_sensitivity"}
