from dataclasses import replace

import numpy as np
import pytest

from gyrobench.bench.closure.candidates import evaluate, price
from gyrobench.bench.closure.effects import g_sensitivity, time_drift
from tests.bench.closure.test_candidate import whole


def test_without_effects_nothing_is_paid(problem):
    one = problem()
    nothing = evaluate(one, [])
    assert nothing.candidates == ()
    assert nothing.chi2 == nothing.score == one.chi2


def test_terms_that_the_data_have_are_kept_and_others_dropped(problem):
    def shape(course):
        return course.up[:, [0, 0, 0]] + course.up[:, [2, 2, 2]]

    [sensitivity] = evaluate(problem({shape: 6.0}), [whole(g_sensitivity.EFFECT)]).candidates
    np.testing.assert_array_equal(sensitivity.kept, [[True, False, True]] * 3)


def test_each_gyro_keeps_one_term_of_an_effect_that_is_not_there(problem):
    [sensitivity] = evaluate(problem(), [whole(g_sensitivity.EFFECT)]).candidates
    np.testing.assert_array_equal(sensitivity.kept.sum(axis=1), [1, 1, 1])


def test_terms_dropped_before_do_not_come_back(problem):
    kept = np.array([[False, True, False]] * 3)
    only_one = replace(whole(g_sensitivity.EFFECT), kept=kept)
    [still] = evaluate(problem({"g_sensitivity": 4.0}), [only_one]).candidates
    np.testing.assert_array_equal(still.kept, kept)


def test_the_score_is_what_is_left_and_what_the_unknowns_cost(problem):
    one = problem({"time_drift": 4.0})
    drift = evaluate(one, [whole(time_drift.EFFECT)])
    left = one.chi2 - one.gain(time_drift.EFFECT.forms[0].columns(one.campaign, ()))[0]
    assert drift.chi2 == pytest.approx(left)
    assert drift.score == pytest.approx(left + 3 * price(one))
    assert price(one) == pytest.approx(np.log(75))


def test_what_is_there_scores_better_than_nothing_and_what_is_not_scores_worse(problem):
    there, not_there = problem({"time_drift": 4.0}), problem()
    assert evaluate(there, [whole(time_drift.EFFECT)]).score < evaluate(there, []).score
    assert evaluate(not_there, [whole(time_drift.EFFECT)]).score > evaluate(not_there, []).score


def test_a_set_has_the_names_of_its_effects(problem):
    both = evaluate(problem(), [whole(time_drift.EFFECT), whole(g_sensitivity.EFFECT)])
    assert both.names == {"time_drift", "g_sensitivity"}
