import numpy as np

from bench.closure.campaign import campaign_of
from bench.closure.effects.thermal_lag import EFFECT
from tests.bench.closure.thermal_bench import measure

[FORM] = EFFECT.forms
TAU_S = 1800.0


def test_on_a_ramp_it_is_behind_by_the_rate_times_the_time_constant():
    rows = measure(profile=((60.0, 0.05, 0.0),), cycles=1).rows
    campaign = campaign_of(rows)
    behind_c = FORM.columns(campaign, (TAU_S,))[:, :, 0]
    lag_s = -3600.0 * behind_c / campaign.rate_c_per_h
    # A course is known from step to step of its record.
    np.testing.assert_allclose(lag_s[-6:], TAU_S, atol=0.6 * campaign.record.step_s)


def test_it_dies_away_in_a_soak():
    rows = measure(profile=((60.0, 1.0, 16.0),), cycles=1).rows
    columns = FORM.columns(campaign_of(rows), (TAU_S,))
    assert np.abs(columns[-2:, :, 0]).max() < 0.02 * np.abs(columns[:, :, 0]).max()


def test_without_lag_there_is_nothing_left(clean):
    slow, quick = (np.abs(FORM.columns(clean, (tau_s,))).max() for tau_s in (3600.0, 60.0))
    assert quick < 0.05 * slow
