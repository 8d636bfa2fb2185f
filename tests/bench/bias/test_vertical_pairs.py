import math

import numpy as np
import pytest
from scipy.stats import chi2, kstest

from gyrobench.bench.bias.statistics import weighted_mean
from gyrobench.bench.bias.vertical_pairs import Finding, VerticalPairs, up_rate
from gyrobench.bench.navigation.earth import earth_rate_enu

EARTH_RATE = earth_rate_enu(np.radians(36.4))
EQUATOR = earth_rate_enu(0.0)
DPH = np.pi / 180.0 / 3600.0
SIGMA = 0.0007 * DPH
NORTH_SIGMA = 0.0005 * DPH


def pairs(half_differences, north=0.0, sigma=SIGMA, gyros=(0, 1, 2), first=1, covariance=None):
    """Half-differences of one temperature; dwells are numbered up, down, gyro by gyro."""
    if covariance is None:
        covariance = np.diag(np.broadcast_to(sigma, len(gyros)) ** 2)
    numbers = [first + 2 * index for index in range(len(gyros))]
    return VerticalPairs(
        gyros,
        np.asarray(half_differences, dtype=float),
        covariance,
        tuple({number: 0.5, number + 1: -0.5} for number in numbers),
        north,
        NORTH_SIGMA**2,
        np.zeros(len(gyros)),
    )


def of_latitude(error, random):
    """What three gyros and the rate North show of a latitude error, with noise."""
    up = -EARTH_RATE[1] * error + SIGMA * random.standard_normal(3)
    return pairs(up, EARTH_RATE[2] * error + NORTH_SIGMA * random.standard_normal())


def test_rate_is_the_weighted_mean_of_independent_half_differences():
    values, sigmas = np.array([1.0, 2.5, 1.7]) * SIGMA, np.array([1.0, 2.0, 0.5]) * SIGMA
    rate, mean = up_rate([pairs(values, sigma=sigmas)], EARTH_RATE), weighted_mean(values, sigmas)
    assert rate.rate == pytest.approx(mean.value)
    assert rate.sigma == pytest.approx(mean.sigma)
    assert rate.p_value == pytest.approx(mean.p_value)


def test_correlated_half_differences_are_weighted_by_their_covariance():
    random = np.random.default_rng(3)
    root = SIGMA * (np.eye(3) + 0.4 * random.standard_normal((3, 3)))
    values = SIGMA * random.standard_normal(3)
    rate = up_rate([pairs(values, covariance=root @ root.T)], EARTH_RATE)
    whitened = np.linalg.solve(root, np.column_stack([np.ones(3), values]))
    (best,), (squares,), *_ = np.linalg.lstsq(whitened[:, :1], whitened[:, 1], rcond=None)
    assert rate.rate == pytest.approx(best)
    assert rate.sigma == pytest.approx(1.0 / np.linalg.norm(whitened[:, 0]))
    assert rate.p_value == pytest.approx(chi2.sf(squares, 2))


def test_rate_is_the_weighted_sum_of_the_vertical_biases_of_all_dwells():
    random = np.random.default_rng(4)
    biases = dict(enumerate(SIGMA * random.standard_normal(12), 1))
    groups = [
        pairs([0.5 * (biases[n] - biases[n + 1]) for n in range(first, first + 6, 2)], first=first)
        for first in (1, 7)
    ]
    rate = up_rate(groups, EARTH_RATE)
    assert sorted(rate.weights) == list(biases)
    assert rate.rate == pytest.approx(sum(weight * biases[n] for n, weight in rate.weights.items()))
    # A rate adds to what points up and takes from what points down.
    assert sum(abs(weight) for weight in rate.weights.values()) == pytest.approx(1.0)


def test_p_values_are_uniform_if_there_is_a_latitude_error():
    random = np.random.default_rng(5)
    rates = [up_rate([of_latitude(3e-4, random) for _ in range(3)], EARTH_RATE) for _ in range(400)]
    alone = [up_rate([of_latitude(3e-4, random)], EARTH_RATE) for _ in range(400)]
    assert kstest([rate.p_value for rate in alone], "uniform").pvalue > 1e-3
    assert sum(rate.finding is Finding.NOT_LATITUDE for rate in rates) < 0.03 * len(rates)
    assert sum(rate.p_value < 0.1 for rate in rates) < 0.15 * len(rates)
    misses = [(rate.latitude_error - 3e-4) / rate.latitude_sigma for rate in rates]
    assert chi2.cdf(np.square(misses).sum(), len(misses)) == pytest.approx(0.5, abs=0.499)


def test_more_temperatures_narrow_the_rate():
    random = np.random.default_rng(6)
    groups = [of_latitude(3e-4, random) for _ in range(9)]
    one, nine = up_rate(groups[:1], EARTH_RATE), up_rate(groups, EARTH_RATE)
    assert nine.sigma == pytest.approx(one.sigma / 3.0)
    assert nine.latitude_sigma == pytest.approx(one.latitude_sigma / 3.0)


def test_rates_north_and_up_of_a_latitude_error_bear_each_other_out():
    error = 1.0 / 60.0 * np.pi / 180.0
    rate = up_rate([pairs([-EARTH_RATE[1] * error] * 3, EARTH_RATE[2] * error)], EARTH_RATE)
    assert rate.finding is Finding.LATITUDE
    assert rate.applies
    assert rate.latitude_error == pytest.approx(error)


@pytest.mark.parametrize(("declared_arcmin", "finding"), [(0.33, "LATITUDE_OFF"), (0.6, "LATITUDE")])
def test_a_latitude_error_is_off_where_it_exceeds_twice_what_is_declared(declared_arcmin, finding):
    arcmin = np.pi / 180.0 / 60.0
    of_one = pairs([-EARTH_RATE[1] * arcmin] * 3, EARTH_RATE[2] * arcmin)
    rate = up_rate([of_one], EARTH_RATE, declared_arcmin * arcmin)
    assert rate.finding is Finding[finding]
    assert rate.applies


def test_rate_up_without_rate_north_is_no_latitude_error():
    rate = up_rate([pairs([8.0 * SIGMA] * 3)], EARTH_RATE)
    assert rate.finding is Finding.NOT_LATITUDE
    assert not rate.applies


def test_at_the_equator_the_rate_north_determines_nothing():
    rate = up_rate([pairs([8.0 * SIGMA] * 3)], EQUATOR)
    assert rate.finding is Finding.NOT_CONTRADICTED
    assert rate.applies


def test_small_rate_is_neither_contradicted_nor_borne_out():
    assert up_rate([pairs([0.3 * SIGMA] * 3)], EARTH_RATE).finding is Finding.NOT_CONTRADICTED


def test_half_differences_that_disagree_are_biases():
    rate = up_rate([pairs([4.0 * SIGMA, 0.0, -4.0 * SIGMA])], EARTH_RATE)
    assert rate.finding is Finding.DIFFERENT
    assert not rate.applies


def test_gyros_that_differ_too_little_at_one_temperature_show_over_many():
    one = pairs([1.5 * SIGMA, 0.0, -1.5 * SIGMA])
    alone, pooled = up_rate([one], EARTH_RATE), up_rate([one] * 8, EARTH_RATE)
    assert alone.finding is Finding.NOT_CONTRADICTED
    assert pooled.finding is Finding.DIFFERENT
    assert pooled.p_value < 1e-5


def test_rate_that_follows_the_temperature_is_bias():
    pooled = up_rate([pairs([n * 2.0 * SIGMA] * 3) for n in range(4)], EARTH_RATE)
    assert pooled.finding is Finding.DIFFERENT
    assert pooled.p_value < 1e-5


def test_single_gyro_is_not_enough_even_at_many_temperatures():
    rate = up_rate([pairs([8.0 * SIGMA], gyros=(1,))] * 5, EARTH_RATE)
    assert rate.finding is Finding.ONE_GYRO
    assert not rate.applies


def test_one_half_difference_can_not_be_tested():
    rate = up_rate([pairs([SIGMA], gyros=(2,))], EARTH_RATE)
    assert rate.sigma == pytest.approx(SIGMA)
    assert math.isnan(rate.p_value)


def test_temperature_without_a_pair_counts_for_nothing():
    full, empty = pairs([SIGMA, 0.0, -SIGMA]), pairs([], gyros=())
    assert up_rate([empty, full], EARTH_RATE).rate == up_rate([full], EARTH_RATE).rate


def test_nothing_is_reported_without_any_pair():
    rate = up_rate([], EARTH_RATE)
    assert rate.finding is Finding.NO_PAIR
    assert math.isnan(rate.rate)
    assert not rate.applies
