from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import kstest

from gyrobench.bench.closure.candidates import solve_with
from gyrobench.bench.closure.effects.effect import Effect, Form
from gyrobench.bench.closure.effects.laws import (
    BIAS_JUMP,
    G_SENSITIVITY,
    TEMPERATURE_RATE,
    TIME_DRIFT,
    WARM_UP,
)
from gyrobench.bench.closure.problem import declared_problem
from gyrobench.bench.closure.validation import (
    LACK_OF_FIT_P,
    gyro_correlation,
    lack_of_fit,
    leave_out_cycles,
    measured_minus_model,
)
from tests.bench.closure.test_candidates import whole
from tests.bench.closure.thermal_bench import SIGMA_DPH, WARM_UP_H, jump


@pytest.fixture(scope="module")
def of_clean_data(problem):
    return [lack_of_fit(problem(seed=seed), 0) for seed in range(60)]


@pytest.mark.long
@pytest.mark.parametrize("name", ["time", "temperature", "position", "temperature rate"])
def test_without_anything_left_p_values_are_uniform(of_clean_data, name):
    assert kstest([each.p_structure[name] for each in of_clean_data], "uniform").pvalue > 0.01


@pytest.mark.long
def test_without_anything_left_the_sum_of_squares_is_uniform(of_clean_data):
    assert kstest([each.p_noise for each in of_clean_data], "uniform").pvalue > 0.01


@pytest.mark.long
def test_serial_correlation_of_noise_is_rarely_significant(of_clean_data):
    # A fitted model makes neighbours a little unlike: large values are frequent, small ones are not.
    p_values = [each.p_structure["the previous dwell"] for each in of_clean_data]
    assert kstest(p_values, "uniform", alternative="greater").pvalue > 0.01


@pytest.mark.long
def test_without_anything_left_few_tests_say_that_there_is(of_clean_data):
    # As many tests as there are would give 3 below 0.05 if they had nothing in common.
    assert sum(each.p_value < 0.05 for each in of_clean_data) <= 6
    assert sum(each.p_value < LACK_OF_FIT_P for each in of_clean_data) <= 1


@pytest.mark.long
def test_the_noise_ratio_is_that_of_the_noise(of_clean_data):
    assert np.mean([each.noise_ratio for each in of_clean_data]) == pytest.approx(1.0, abs=0.02)


@pytest.mark.parametrize(
    ("effect", "followed"),
    [("time_drift", "time"), ("square_wave", "temperature"), ("g_sensitivity", "position")],
)
def test_residuals_that_follow_something_are_seen_to(problem, effect, followed):
    left = lack_of_fit(problem({effect: 2.0}, seed=3), 0)
    assert left.p_value < 1e-6
    assert left.follows == followed
    assert left.p_any_structure < 1e-6


def test_residuals_that_follow_the_temperature_rate_are_significant(problem):
    assert lack_of_fit(problem({"temperature_rate": 2.0}, seed=3), 0).p_structure["temperature rate"] < 1e-6


def test_residuals_that_follow_the_previous_dwell_are_significant(problem):
    left = lack_of_fit(problem({"sinusoid": 2.0}, seed=3), 0)
    assert left.p_structure["the previous dwell"] < 1e-6


@pytest.mark.parametrize("noise", [0.5, 2.0])
def test_another_noise_than_stated_is_no_structure(problem, noise):
    left = lack_of_fit(problem(noise=noise), 0)
    assert left.noise_ratio == pytest.approx(noise, rel=0.1)
    assert left.p_any_structure > 0.05
    assert (left.p_noise < 1e-6) == (noise > 1.0)


def test_the_same_residuals_against_their_true_noise_are_clean(problem):
    assert lack_of_fit(problem(sigma_dph=0.001), 0).p_value > 0.05


def test_structure_is_seen_where_the_noise_is_smaller_than_stated(problem):
    left = lack_of_fit(problem({"time_drift": 0.5}, noise=0.3), 0)
    assert left.p_noise > 0.5
    assert left.p_value < 1e-6


def test_p_values_count_how_many_tests_were_made(problem):
    left = lack_of_fit(problem(), 0)
    smallest = min(left.p_noise, *left.p_structure.values())
    assert left.p_value == min(1.0, smallest * (1 + len(left.p_structure)))


def test_parameters_fitted_beside_reduce_the_degrees_of_freedom(problem):
    one = problem()
    assert lack_of_fit(one, 6).noise_ratio == pytest.approx(np.sqrt(one.chi2 / (one.dof - 6)))
    assert lack_of_fit(one, 6).p_noise < lack_of_fit(one, 0).p_noise


def test_without_degrees_of_freedom_nothing_is_significant(problem):
    one = problem()
    left = lack_of_fit(one, one.dof)
    assert (left.p_value, left.p_any_structure) == (1.0, 1.0)
    assert np.isnan(left.noise_ratio)


def test_noise_that_gyros_share_is_named_with_them(problem):
    alone = problem(seed=0)
    assert lack_of_fit(alone, 0).correlated is None
    noise = alone.residuals.copy()
    noise[:, 2] = 0.8 * noise[:, 0] + 0.6 * noise[:, 2]
    first, second, value = lack_of_fit(replace(alone, residuals=noise), 0).correlated
    assert (first, second) == (0, 2)
    assert 0.6 < value < 0.95


def test_noise_that_gyros_share_counts_as_fewer_values(problem):
    """With correlations R, a sum of squares has tr(R R) / 3 times the variance of independent ones."""
    alone = problem(seed=0)
    assert gyro_correlation(alone).factor == 1.0
    noise = 0.8 * alone.residuals[:, [0]] + 0.6 * alone.residuals
    shared = replace(alone, residuals=noise)
    assert gyro_correlation(shared).factor == pytest.approx(1.0 + 2.0 * 0.64**2, rel=0.3)
    once = replace(shared, correlation_factor=gyro_correlation(shared).factor)
    assert lack_of_fit(once, 0).p_structure["time"] > lack_of_fit(shared, 0).p_structure["time"]


@pytest.mark.long
def test_independent_noise_is_rarely_called_shared(of_clean_data):
    assert sum(each.correlated is not None for each in of_clean_data) <= 1


def gains_by_cycle(problem, candidates, index):
    fewer = [each for number, each in enumerate(candidates) if number != index]
    return leave_out_cycles(problem, fewer, candidates)


def test_an_effect_that_is_there_takes_most_away_in_cycles_left_out(problem):
    gains = gains_by_cycle(problem({"temperature_rate": 5.0}), [whole(TEMPERATURE_RATE)], 0)
    assert gains.keys() == {1, 2}
    assert min(gains.values()) > 0.9


def test_an_effect_that_is_not_there_takes_nothing_away(problem):
    gains = [
        gain
        for seed in range(10)
        for gain in gains_by_cycle(problem(seed=seed), [whole(G_SENSITIVITY)], 0).values()
    ]
    assert np.mean(gains) < 0.0
    assert max(gains) < 0.2


def test_each_effect_of_two_has_its_own_share(problem):
    one = problem({"temperature_rate": 5.0, "g_sensitivity": 2.0})
    both = [whole(TEMPERATURE_RATE), whole(G_SENSITIVITY)]
    assert min(gains_by_cycle(one, both, 0).values()) > min(gains_by_cycle(one, both, 1).values()) > 0.4


def test_the_only_cycle_that_shows_an_effect_is_not_asked(problem):
    one = problem({"warm_up": 5.0})
    assert 1 not in gains_by_cycle(one, [whole(WARM_UP, WARM_UP_H * 3600.0)], 0)


def test_a_warm_up_in_each_cycle_is_confirmed_by_the_others(problem):
    one = problem({"warm_up": 5.0}, power_on_each_cycle=True, dwell_s=1680.0)
    gains = gains_by_cycle(one, [whole(WARM_UP, WARM_UP_H * 3600.0)], 0)
    assert gains.keys() == {1, 2}
    assert min(gains.values()) > 0.8


def test_one_cycle_alone_has_none_to_be_left_out(problem):
    assert gains_by_cycle(problem({"temperature_rate": 5.0}, cycles=2), [whole(TEMPERATURE_RATE)], 0) == {}


def test_a_jump_between_two_cycles_is_determined_by_neither_alone(problem):
    jump_s = 68_343.0  # 57 s before the end of the first cycle's last dwell
    one = problem({jump(jump_s / (3 * 67_200.0)): 5.0})
    assert gains_by_cycle(one, [whole(BIAS_JUMP, jump_s)], 0) == {}


def test_a_term_that_the_declared_model_makes_up_in_the_others_is_not_asked(problem):
    one = problem(power_on_each_cycle=True, dwell_s=1680.0)

    def columns(campaign, _):
        grown = np.where(campaign.cycle == 1, campaign.gyro_c[:, 0], campaign.rate_c_per_h[:, 0])
        return np.repeat(grown[:, None, None], 3, axis=1)

    effect = Effect("like the temperature in one cycle", "", "", (Form(("term",), columns),))
    assert leave_out_cycles(one, [], [whole(effect)]).keys() == {1}


def errors_of_constant_model(problem):
    """Measured minus modelled bias before and after the removal of means; the model is -1 deg/h."""
    model = replace(solve_with(problem, []), bias_dph=np.full_like(problem.campaign.bias_dph, -1.0))
    return problem.campaign.bias_dph + 1.0, measured_minus_model(problem.campaign, problem.searched, model)


def test_a_run_that_was_not_searched_has_no_mean_error(problem):
    one = problem(power_on_each_cycle=True, dwell_s=1680.0)
    errors, centred = errors_of_constant_model(one)
    np.testing.assert_allclose(centred[~one.searched].mean(axis=0), 0.0, atol=1e-12)
    np.testing.assert_array_equal(centred[one.searched], errors[one.searched])
    np.testing.assert_allclose(np.std(centred[~one.searched], axis=0), np.std(errors[~one.searched], axis=0))


def test_a_run_that_was_searched_keeps_its_mean_error(problem):
    errors, centred = errors_of_constant_model(problem())
    np.testing.assert_array_equal(centred, errors)


@pytest.mark.parametrize("effect", [TIME_DRIFT, G_SENSITIVITY])
def test_the_gain_is_the_share_of_chi2_that_a_fit_to_the_other_cycles_explains(problem, effect):
    one = problem({"time_drift": 20.0})
    first = declared_problem(one.campaign, one.campaign.cycle == 1)
    second = one.campaign.cycle == 2
    chi2 = []
    for candidates in ([], [whole(effect)]):
        errors = measured_minus_model(one.campaign, first.searched, solve_with(first, candidates))
        chi2.append(np.sum((errors[second] / one.campaign.sigma_dph[second]) ** 2))
    gain = leave_out_cycles(one, [], [whole(effect)])[2]
    assert gain == pytest.approx(1.0 - chi2[1] / chi2[0])


def test_the_true_effect_leaves_the_noise(problem):
    one = problem({"time_drift": 20.0})
    rest = measured_minus_model(one.campaign, one.searched, solve_with(one, [whole(TIME_DRIFT)]))
    assert np.sqrt(np.mean(rest**2)) == pytest.approx(SIGMA_DPH, rel=0.15)
