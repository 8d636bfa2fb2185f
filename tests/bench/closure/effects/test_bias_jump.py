import numpy as np

from gyrobench.bench.closure.effects.laws import BIAS_JUMP

[FORM] = BIAS_JUMP.forms


def test_the_bias_is_there_from_the_jump_on(clean):
    column = FORM.columns(clean, (36_000.0,))[:, :, 0]
    np.testing.assert_array_equal(column, np.repeat((clean.start_s >= 36_000.0)[:, None], 3, axis=1))


def test_a_jump_within_a_dwell_counts_for_its_part(clean):
    column = FORM.columns(clean, (36_000.0 + 600.0,))[:, 0, 0]
    [inside] = np.flatnonzero((clean.start_s < 36_600.0) & (clean.end_s > 36_600.0))
    assert column[inside] == 2.0 / 3.0
    assert set(np.delete(column, inside)) == {0.0, 1.0}


def test_every_begin_of_a_dwell_but_the_first_is_tried(clean):
    [jump] = FORM.parameters
    np.testing.assert_array_equal(jump.starts(clean), clean.start_s[1:])
