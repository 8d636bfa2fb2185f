import numpy as np

from gyrobench.bench.closure.effects.laws import TEMPERATURE_RATE as EFFECT

[FORM] = EFFECT.forms


def test_it_changes_sign_with_the_ramp_and_is_gone_after_a_soak(clean):
    column = FORM.columns(clean, ())[:, :, 0]
    # The first soak ends 4 h 40 min after the begin; the ramp upward follows.
    assert np.all(column[2] < -10.0)
    assert np.all(np.abs(column[8]) < 0.2 * np.abs(column[2]))
    assert np.all(column[11] > 5.0)
