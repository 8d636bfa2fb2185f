from dataclasses import replace

import numpy as np
import pytest

from gyrobench.bench.closure.campaign import campaign_of
from gyrobench.bench.closure.problem import DEGREE, declared_columns, declared_problem, solve_terms
from tests.bench.closure.thermal_bench import CUBIC_DPH, SIGMA_DPH, measure

ALL = np.ones((3, 2), dtype=bool)


@pytest.fixture(scope="module")
def one(problem):
    return problem({"temperature_rate": 4.0}, power_on_each_cycle=True, dwell_s=1680.0)


@pytest.fixture(scope="module")
def terms(one):
    """Two terms in all dwells: one that is in the data, one that isn't."""
    noise = np.random.default_rng(1).standard_normal(one.campaign.rate_c_per_h.shape)
    return np.stack([one.campaign.rate_c_per_h, noise], axis=2)


def left_by_least_squares(problem, terms=None, kept=ALL):
    """Weighted sum of squares that a direct fit leaves, over the gyros."""
    campaign, searched, total = problem.campaign, problem.searched, 0.0
    for gyro in range(3):
        columns = declared_columns(campaign, gyro)
        if terms is not None:
            columns = np.concatenate([columns, terms[:, gyro, kept[gyro]]], axis=1)
        weighted = columns[searched] / campaign.sigma_dph[searched, gyro, None]
        data = campaign.bias_dph[searched, gyro] / campaign.sigma_dph[searched, gyro]
        rest = data - weighted @ np.linalg.lstsq(weighted, data, rcond=None)[0]
        total += rest @ rest
    return total


def test_the_residual_of_the_declared_model_is_that_of_a_direct_fit(one):
    assert one.chi2 == pytest.approx(left_by_least_squares(one))
    assert one.dof == 3 * (one.searched.sum() - DEGREE - 2)


def test_the_gain_of_terms_is_the_fall_of_the_sum_of_squares(one, terms):
    gain, rank = one.chi2_reduction(terms)
    assert gain == pytest.approx(one.chi2 - left_by_least_squares(one, terms))
    assert rank == 6


def test_each_gyro_gains_from_the_terms_that_it_keeps(one, terms):
    kept = np.array([[True, False], [False, True], [False, False]])
    gain, rank = one.chi2_reduction(terms, kept)
    assert gain == pytest.approx(one.chi2 - left_by_least_squares(one, terms, kept))
    assert rank == 2


def test_columns_reduce_chi2_as_predicted(one, terms):
    after = one.with_columns(terms)
    assert after.chi2 == pytest.approx(one.chi2 - one.chi2_reduction(terms)[0])
    assert after.dof == one.dof - 6


def test_terms_gain_nothing_twice(one, terms):
    after = one.with_columns(terms)
    gain, rank = after.chi2_reduction(terms)
    assert gain == pytest.approx(0.0, abs=1e-6)
    assert rank == 0
    assert after.with_columns(terms).dof == after.dof


def test_gains_of_one_term_after_the_other_add_up(one, terms):
    after = one.with_columns(terms[:, :, :1])
    assert one.chi2_reduction(terms[:, :, :1])[0] + after.chi2_reduction(terms[:, :, 1:])[0] == pytest.approx(
        one.chi2_reduction(terms)[0]
    )


@pytest.mark.parametrize(
    "columns",
    [
        lambda campaign: np.zeros((len(campaign), 3, 2)),
        lambda campaign: np.ones((len(campaign), 3, 1)),
        lambda campaign: (campaign.gyro_c**3)[:, :, None],
        lambda campaign: (campaign.cycle == 3)[:, None, None] * np.ones((1, 3, 1)),
    ],
    ids=["zeros", "a constant", "a power of the temperature", "only held out"],
)
def test_terms_of_the_declared_model_or_outside_the_search_determine_nothing(one, columns):
    assert one.chi2_reduction(columns(one.campaign)) == (pytest.approx(0.0, abs=1e-6), 0)
    assert one.with_columns(columns(one.campaign)).chi2 == pytest.approx(one.chi2)


def test_a_duplicate_adds_no_gain_and_no_rank(one, terms):
    twice = np.concatenate([terms, 3.0 * terms], axis=2)
    gain, rank = one.chi2_reduction(twice)
    assert (gain, rank) == (pytest.approx(one.chi2_reduction(terms)[0]), 6)
    assert one.with_columns(twice).dof == one.dof - 6


def test_units_of_a_term_do_not_matter(one, terms):
    assert one.chi2_reduction(terms * np.array([1e6, 1e-6]))[0] == pytest.approx(one.chi2_reduction(terms)[0])


def test_twice_the_noise_leaves_a_quarter(one):
    louder = declared_problem(one.campaign, one.searched, 2.0)
    assert louder.chi2 == pytest.approx(one.chi2 / 4.0)
    np.testing.assert_allclose(louder.sigma_dph, 2.0 * SIGMA_DPH)


def test_held_out_dwells_have_no_part_in_it(one, terms):
    campaign = one.campaign
    garbage = campaign.bias_dph.copy()
    garbage[~one.searched] = 1e6
    changed = declared_problem(replace(campaign, bias_dph=garbage), one.searched)
    assert changed.chi2 == one.chi2
    assert changed.chi2_reduction(terms) == one.chi2_reduction(terms)


def test_share_left_is_nothing_of_a_case_and_all_of_something_else(one, terms):
    after = one.with_columns(terms)
    assert after.independent_share(terms @ np.array([[1.0], [2.0]])) < 1e-6
    other = np.random.default_rng(2).standard_normal(terms.shape)
    assert after.independent_share(other) > 0.8


def test_the_declared_model_is_recovered_without_noise():
    campaign = campaign_of(measure(noise=0.0).rows)
    fitted = solve_terms(declared_problem(campaign, campaign.cycle < 3), [])
    np.testing.assert_allclose(fitted.declared[:, :DEGREE], CUBIC_DPH, atol=5e-4)
    np.testing.assert_allclose(fitted.bias_dph, campaign.bias_dph, atol=1e-4)


def test_the_solution_leaves_the_sum_of_squares_of_its_problem(one, terms):
    kept = np.array([[True, False], [True, True], [False, True]])
    fitted = solve_terms(one, [(terms, kept)])
    rest = (one.campaign.bias_dph - fitted.bias_dph)[one.searched] / one.sigma_dph
    assert np.sum(rest**2) == pytest.approx(left_by_least_squares(one, terms, kept))
    np.testing.assert_array_equal(fitted.sizes[0] != 0.0, kept)


def test_a_run_that_was_not_searched_has_the_mean_constant_of_the_others(one):
    fitted = solve_terms(one, [])
    assert np.isnan(fitted.declared[:, DEGREE + 2]).all()
    held_out = ~one.searched
    for gyro in range(3):
        powers = declared_columns(one.campaign, gyro)[:, :DEGREE] @ fitted.declared[gyro, :DEGREE]
        constant = fitted.declared[gyro, DEGREE : DEGREE + 2].mean()
        np.testing.assert_allclose(fitted.bias_dph[held_out, gyro], (powers + constant)[held_out], rtol=1e-9)
