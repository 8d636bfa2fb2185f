import numpy as np

from gyrobench.bench.closure.effects.laws import TIME_DRIFT as EFFECT

[FORM] = EFFECT.forms


def test_it_grows_by_one_a_day_independently_of_events(clean):
    column = FORM.columns(clean, ())[:, :, 0]
    np.testing.assert_allclose(column[0], 0.0)
    np.testing.assert_allclose(np.diff(column, axis=0), 1800.0 / 86_400.0)
