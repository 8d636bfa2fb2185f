from dataclasses import replace

import numpy as np
import pytest

from gyrobench.bench.closure.campaign import campaign_of
from gyrobench.bench.closure.effects.laws import THERMAL_LAG as EFFECT
from gyrobench.bench.closure.temperature_record import TemperatureRecord
from tests.bench.closure.thermal_bench import measure

FORM, UNDERWAY = EFFECT.forms
TAU_S = 1800.0


def test_on_a_ramp_the_sensor_is_ahead_by_the_rate_times_the_time_constant():
    rows = measure(profile=((60.0, 0.05, 0.0),), cycles=1).rows
    campaign = campaign_of(rows)
    ahead_c = FORM.columns(campaign, (TAU_S,))[:, :, 0]
    lag_s = 3600.0 * ahead_c / campaign.rate_c_per_h
    # A course is known from step to step of its record.
    np.testing.assert_allclose(lag_s[-6:], TAU_S, atol=0.6 * np.diff(campaign.record.time_s)[0])


@pytest.mark.parametrize("tau_s", [FORM.parameters[0].low, 60.0, 5000.0])
@pytest.mark.parametrize("step_s", [60.0, 3600.0])
def test_ahead_on_a_straight_line_it_is_exact_however_coarse_the_steps(clean, tau_s, step_s):
    time_s = np.arange(clean.start_s[0], clean.end_s[-1] + step_s, step_s)
    rates_c_per_s = np.array([1.0, -2.0, 0.5]) / 3600.0
    record = TemperatureRecord(time_s, 20.0 + time_s[:, None] * rates_c_per_s)
    columns = FORM.columns(replace(clean, record=record), (tau_s,))[:, :, 0]
    settled = clean.start_s > 20.0 * max(tau_s, step_s)
    np.testing.assert_allclose(
        columns[settled], np.tile(rates_c_per_s * tau_s, (settled.sum(), 1)), rtol=1e-6
    )


def test_it_dies_away_in_a_soak():
    rows = measure(profile=((60.0, 1.0, 16.0),), cycles=1).rows
    columns = FORM.columns(campaign_of(rows), (TAU_S,))
    assert np.abs(columns[-2:, :, 0]).max() < 0.02 * np.abs(columns[:, :, 0]).max()


def test_without_lag_there_is_nothing_left(clean):
    slow, quick = (np.abs(FORM.columns(clean, (tau_s,))).max() for tau_s in (3600.0, 60.0))
    assert quick < 0.05 * slow


def test_at_the_first_dwell_it_is_settled_or_follows_a_temperature_that_changes(clean):
    """Begun on a ramp, a dwell's rate shows what a settled temperature can't lag by."""
    ramp = replace(clean, rate_c_per_h=clean.rate_c_per_h + 10.0)
    soak = replace(clean, rate_c_per_h=clean.rate_c_per_h - clean.rate_c_per_h[0])
    for campaign, form, other in ((ramp, UNDERWAY, FORM), (soak, FORM, UNDERWAY)):
        assert form.missing_input(campaign) is None
        assert other.missing_input(campaign)


def test_on_a_ramp_that_began_long_before_the_first_dwell_the_lag_is_the_same_throughout(clean):
    rate_c_per_s = 10.0 / 3600.0
    time_s = np.arange(clean.start_s[0], clean.end_s[-1] + 60.0, 60.0)
    ramp_c = np.repeat(20.0 + rate_c_per_s * time_s[:, None], 3, axis=1)
    rates_c_per_h = np.full_like(clean.rate_c_per_h, 10.0)
    ramp = replace(clean, record=TemperatureRecord(time_s, ramp_c), rate_c_per_h=rates_c_per_h)
    settled, long_before = (UNDERWAY.columns(ramp, (TAU_S, share)) for share in (0.0, 1.0))
    np.testing.assert_allclose(settled, FORM.columns(ramp, (TAU_S,)), rtol=1e-9)
    np.testing.assert_allclose(long_before, rate_c_per_s * TAU_S, rtol=1e-4)
