import numpy as np
import pytest
from scipy.stats import kstest

from gyrobench.bench.bias.uniformity import uniformity_band, uniformity_p_value


@pytest.mark.parametrize("count", [1, 2, 7, 60])
def test_p_value_is_the_exact_one_where_it_is_small(count):
    rng = np.random.default_rng(count)
    for power in (1.0, 3.0, 20.0):
        values = rng.uniform(size=count) ** power
        exact = kstest(values, "uniform", method="exact").pvalue
        found = uniformity_p_value(values)
        assert exact - 1e-12 <= found
        if exact < 0.1:
            assert found == pytest.approx(exact, rel=0.01)


def test_values_that_sit_too_well_in_the_middle_are_not_uniform():
    assert uniformity_p_value([0.5] * 20) < 1e-3


def test_band_is_left_by_one_uniform_sample_in_twenty():
    rng = np.random.default_rng(4)
    ordered = np.sort(rng.uniform(size=(4000, 30)), axis=1)
    above, below = np.arange(1, 31) / 30 - ordered, ordered - np.arange(30) / 30
    distances = np.maximum(above.max(axis=1), below.max(axis=1))
    assert 0.04 < np.mean(distances > uniformity_band(30)) < 0.06


def test_band_and_test_agree():
    values = np.maximum(np.arange(1, 11) / 10 - uniformity_band(10, 0.99), 0.0)
    assert uniformity_p_value(values) == pytest.approx(0.01)
