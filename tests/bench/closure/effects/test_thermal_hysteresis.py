import numpy as np

from gyrobench.bench.closure.campaign import campaign_of
from gyrobench.bench.closure.effects.laws import THERMAL_HYSTERESIS as EFFECT
from tests.bench.closure.thermal_bench import measure

[FORM] = EFFECT.forms
HALF_WIDTH_C = 4.0


def test_it_lies_behind_by_the_half_width_upward_and_downward(clean):
    behind_c = FORM.columns(clean, (HALF_WIDTH_C,))[:, :, 0]
    assert np.abs(behind_c).max() <= HALF_WIDTH_C + 1e-9
    fast = np.abs(clean.rate_c_per_h) > 8.0
    swept = np.convolve(fast[:, 0], np.ones(3))[: len(fast)] >= 3
    np.testing.assert_allclose(behind_c[swept], -HALF_WIDTH_C * np.sign(clean.rate_c_per_h[swept]), atol=0.2)


def test_it_stays_in_a_soak_where_a_lag_dies_away():
    rows = measure(profile=((60.0, 1.0, 12.0),), cycles=1).rows
    behind_c = FORM.columns(campaign_of(rows), (HALF_WIDTH_C,))[:, :, 0]
    np.testing.assert_allclose(behind_c[-4:], -HALF_WIDTH_C, atol=0.1)


def test_one_temperature_has_two_values_that_depend_on_the_way(clean):
    behind_c = FORM.columns(clean, (HALF_WIDTH_C,))[:, 0, 0]
    near = np.abs(clean.gyro_c[:, 0] - 27.0) < 6.0
    assert np.ptp(behind_c[near]) > 1.9 * HALF_WIDTH_C


def test_swings_within_the_play_are_not_followed():
    rows = measure(profile=((22.0, 0.1, 3.0), (20.0, 0.1, 3.0)), cycles=2).rows
    campaign = campaign_of(rows)
    followed_c = FORM.columns(campaign, (30.0,))[:, :, 0] + campaign.gyro_c
    assert np.ptp(followed_c, axis=0).max() < 0.2
