import math

import numpy as np
import pytest

from gyrobench.bench.bias.weighted_mean import weighted_mean


def test_two_values_by_hand():
    mean = weighted_mean([10.0, 20.0], [1.0, 2.0])
    assert (mean.value, mean.sigma) == pytest.approx((12.0, 1 / math.sqrt(1.25)))
    assert (mean.chi2, mean.freedom) == (pytest.approx(2.0**2 + 4.0**2), 1)
    assert mean.chi2_reduced == mean.chi2
    assert mean.p_value == pytest.approx(math.erfc(math.sqrt(20.0 / 2.0)))


def test_single_value_is_its_own_mean_without_scatter():
    mean = weighted_mean([3.0], [0.5])
    assert (mean.value, mean.sigma, mean.chi2) == (3.0, 0.5, 0.0)
    assert math.isnan(mean.chi2_reduced)
    assert math.isnan(mean.p_value)


def test_mean_scatters_as_much_as_it_says():
    rng = np.random.default_rng(8)
    sigmas = np.array([1.0, 2.0, 0.5])
    means = [weighted_mean(rng.normal(0.0, sigmas), sigmas) for _ in range(2000)]
    assert np.std([mean.value for mean in means]) == pytest.approx(means[0].sigma, rel=0.06)
    assert 0.035 < np.mean([mean.p_value < 0.05 for mean in means]) < 0.065
