from dataclasses import replace

import numpy as np
import pytest

from gyrobench.bench.closure.candidates import bic_penalty, fit_hypothesis
from gyrobench.bench.closure.effects.laws import G_SENSITIVITY, TIME_DRIFT
from tests.bench.closure.test_candidates import whole


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
