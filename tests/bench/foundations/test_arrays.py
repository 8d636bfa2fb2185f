import numpy as np
import pytest
from scipy.interpolate import BSpline

from gyrobench.bench.foundations.arrays import b_splines, true_spans


@pytest.mark.parametrize("degree", [1, 2, 3, 5])
def test_b_splines_are_those_of_scipy_up_to_both_ends(degree):
    random = np.random.default_rng(degree)
    inner = np.sort(random.uniform(-40.0, 75.0, 9))
    knots = np.concatenate([np.full(degree, inner[0]), inner, np.full(degree, inner[-1])])
    values = np.concatenate([inner, random.uniform(inner[0], inner[-1], 50)])
    expected = BSpline.design_matrix(values, knots, degree).toarray()
    np.testing.assert_allclose(b_splines(values, knots, degree), expected, atol=1e-13)


@pytest.mark.parametrize(
    ("flags", "spans"), [("", []), ("..", []), ("##.#", [[0, 2], [3, 4]]), (".##..#.", [[1, 3], [5, 6]])]
)
def test_each_unbroken_series_of_true_values_has_a_begin_and_an_end(flags, spans):
    found = true_spans(np.array([each == "#" for each in flags], dtype=bool))
    assert found.shape == (len(spans), 2)
    assert found.tolist() == spans
