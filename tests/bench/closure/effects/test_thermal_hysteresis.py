import numpy as np

from gyrobench.bench.closure.campaign import campaign_of
from gyrobench.bench.closure.effects.effect import FittedForm
from gyrobench.bench.closure.effects.laws import THERMAL_HYSTERESIS as EFFECT
from tests.bench.closure.thermal_bench import measure

FORM, MANY = EFFECT.forms
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


def test_many_widths_begin_with_the_narrowest_and_end_as_one_width_does(clean):
    """Small swings are followed in part; far beyond all widths only their mean shows."""
    rows = measure(profile=((22.0, 0.1, 3.0), (20.0, 0.1, 3.0)), cycles=2).rows
    behind_c = MANY.columns(campaign_of(rows), (4.0,))[:, :, 0]
    followed_c = behind_c + campaign_of(rows).gyro_c
    assert 0.05 < np.ptp(followed_c, axis=0).max() < np.ptp(campaign_of(rows).gyro_c, axis=0).max()
    one, many = (form.columns(clean, (HALF_WIDTH_C,))[:, :, 0] for form in EFFECT.forms)
    swept = np.abs(many) > 0.99 * HALF_WIDTH_C
    assert swept.mean() > 0.1
    np.testing.assert_allclose(many[swept], one[swept], atol=0.05)


def test_an_ins_subtracts_many_widths_as_the_closest_single_one(clean):
    sizes_dph = np.array([[0.002], [-0.001], [0.0005]])
    searched = np.ones(len(clean), dtype=bool)
    terms = EFFECT.compensation(FittedForm(clean, searched, MANY, (HALF_WIDTH_C,), sizes_dph))
    true_dph = MANY.columns(clean, (HALF_WIDTH_C,))[:, :, 0] * sizes_dph[:, 0]
    width_c = terms.coefficients["half_width_k"][0]
    of_ins_dph = FORM.columns(clean, (width_c,))[:, :, 0] * terms.coefficients["hysteresis_dph_per_k"]
    off_dph = of_ins_dph - true_dph
    missed = np.sqrt(np.mean((off_dph - off_dph.mean(axis=0)) ** 2))
    assert missed < 0.25 * np.sqrt(np.mean((true_dph - true_dph.mean(axis=0)) ** 2))
    assert f"leaves {missed:.2g} deg/h rms" in terms.note
