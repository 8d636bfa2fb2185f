"""Holm's procedure, by hand."""

import numpy as np

from gyrobench.bench.bias.many_comparisons import holm


def test_the_smallest_p_value_counts_all_comparisons_the_next_one_less():
    assert np.allclose(holm([0.01, 0.04, 0.03]), [0.03, 0.06, 0.06])


def test_no_p_value_exceeds_one_and_none_falls_below_a_smaller_one():
    assert np.allclose(holm([0.5, 0.4, 0.01]), [0.8, 0.8, 0.03])


def test_what_was_not_compared_does_not_count():
    assert np.allclose(holm([np.nan, 0.01, np.nan]), [np.nan, 0.01, np.nan], equal_nan=True)
    assert len(holm([])) == 0
