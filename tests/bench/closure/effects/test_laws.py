from dataclasses import replace

import numpy as np
import pytest

from gyrobench.bench.closure.campaign import campaign_of
from gyrobench.bench.closure.effects.effect import FittedForm
from gyrobench.bench.closure.effects.laws import (
    AGEING,
    BIAS_JUMP,
    G_SENSITIVITY,
    TEMPERATURE_RATE,
    THERMAL_GRADIENT,
    THERMAL_HYSTERESIS,
    THERMAL_LAG,
    TIME_DRIFT,
    WARM_UP,
)
from gyrobench.bench.closure.temperature_record import TemperatureRecord
from tests.bench.closure.thermal_bench import UP, measure

[DRIFT] = TIME_DRIFT.forms
AGEING_TAU_H = 20.0
[JUMP] = BIAS_JUMP.forms
[DECAY] = WARM_UP.forms
DECAY_TAU_S = 3600.0
[UP_COMPONENTS] = G_SENSITIVITY.forms
[RATE] = TEMPERATURE_RATE.forms
[GRADIENT] = THERMAL_GRADIENT.forms
SETTLED, UNDERWAY = THERMAL_LAG.forms
LAG_TAU_S = 1800.0
PLAY, MANY_WIDTHS = THERMAL_HYSTERESIS.forms
HALF_WIDTH_C = 4.0


def test_a_drift_grows_by_one_a_day_independently_of_events(clean):
    column = DRIFT.columns(clean, ())[:, :, 0]
    np.testing.assert_allclose(column[0], 0.0)
    np.testing.assert_allclose(np.diff(column, axis=0), 1800.0 / 86_400.0)


def test_the_logarithmic_form_is_the_mean_logarithm_over_each_dwell():
    rows = measure(cycles=3, power_on_each_cycle=True).rows
    [form] = [each for each in AGEING.forms if each.name == "logarithmic"]
    found = form.columns(campaign_of(rows), (3600.0 * AGEING_TAU_H,))
    for gyro in range(3):
        means = [
            np.log1p(
                (np.linspace(row.start_s, row.end_s, 1001) - rows[0].start_s) / 3600.0 / AGEING_TAU_H
            ).mean()
            for row in rows
        ]
        np.testing.assert_allclose(found[:, gyro, 0], means, rtol=1e-4, atol=1e-6)


def test_logarithmic_ageing_needs_two_power_cycles_as_the_exponential_one_does():
    campaign = campaign_of(measure(cycles=3).rows)
    assert {form.missing_input(campaign) for form in AGEING.forms} == {AGEING.missing_input(campaign)}
    assert "two power cycles" in AGEING.missing_input(campaign)


def test_the_bias_is_there_from_the_jump_on(clean):
    column = JUMP.columns(clean, (36_000.0,))[:, :, 0]
    np.testing.assert_array_equal(column, np.repeat((clean.start_s >= 36_000.0)[:, None], 3, axis=1))


def test_a_jump_within_a_dwell_counts_for_its_part(clean):
    column = JUMP.columns(clean, (36_000.0 + 600.0,))[:, 0, 0]
    [inside] = np.flatnonzero((clean.start_s < 36_600.0) & (clean.end_s > 36_600.0))
    assert column[inside] == 2.0 / 3.0
    assert set(np.delete(column, inside)) == {0.0, 1.0}


def test_every_begin_of_a_dwell_but_the_first_is_tried(clean):
    [jump] = JUMP.parameters
    np.testing.assert_array_equal(jump.starts(clean), clean.start_s[1:])


@pytest.mark.parametrize("each_cycle", [False, True], ids=["one power-on", "one in each cycle"])
def test_a_warm_up_is_the_mean_of_the_decay_over_the_dwell(each_cycle):
    measured = measure(power_on_each_cycle=each_cycle)
    decay = np.exp(-measured.course.since_power_on_h * 3600.0 / DECAY_TAU_S)
    expected = [decay[round(row.start_s / 60) : round(row.end_s / 60)].mean() for row in measured.rows]
    column = DECAY.columns(campaign_of(measured.rows), (DECAY_TAU_S,))[:, :, 0]
    np.testing.assert_allclose(column, np.repeat(np.array(expected)[:, None], 3, axis=1), atol=0.012)


def test_hours_after_power_on_a_warm_up_vanishes(clean):
    column = DECAY.columns(clean, (DECAY_TAU_S,))[:, 0, 0]
    assert 0.7 < column[0] < 0.9
    assert column[-1] < 1e-12


def test_a_dwell_of_no_length_is_no_division_by_zero(clean):
    still = replace(clean, end_s=clean.start_s)
    assert np.isfinite(DECAY.columns(still, (DECAY_TAU_S,))).all()


@pytest.mark.parametrize(("cycles", "size"), [(4, 2.0), pytest.param(3, 4.0, marks=pytest.mark.long)])
def test_a_decay_longer_than_twelve_hours_is_no_drift(closed, cycles, size):
    closure = closed({_slow_decay: size}, cycles=cycles, seed=3)
    [found] = closure.effects
    assert closure.probability > 0.95
    assert found.tied_with == ()
    assert found.effect.name == "warm_up"
    assert found.candidate.values[0] == pytest.approx(30.0 * 3600.0, rel=0.15)
    assert found.candidate.form.parameters[0].high == pytest.approx(
        np.ptp([closure.campaign.start_s[0], closure.campaign.end_s[closure.searched][-1]])
    )


def _slow_decay(course):
    return np.exp(-course.since_power_on_h / 30.0)[:, None]


def test_each_gyro_has_up_along_the_three_axes_at_every_temperature(clean):
    expected = np.array([UP[name] for name in clean.position], dtype=float)
    columns = UP_COMPONENTS.columns(clean, ())
    for gyro in range(3):
        np.testing.assert_allclose(columns[:, gyro], expected, atol=1e-15)


def test_the_temperature_rate_changes_sign_with_the_ramp_and_is_gone_after_a_soak(clean):
    column = RATE.columns(clean, ())[:, :, 0]
    # The first soak ends 4 h 40 min after the begin; the ramp upward follows.
    assert np.all(column[2] < -10.0)
    assert np.all(np.abs(column[8]) < 0.2 * np.abs(column[2]))
    assert np.all(column[11] > 5.0)


def test_the_gradient_is_the_electronics_above_the_optics_in_every_position(clean):
    np.testing.assert_allclose(GRADIENT.columns(clean, ())[:, :, 0], clean.board_c - clean.gyro_c)


def test_unknown_electronics_temperatures_are_a_missing_input():
    assert "temperature sensors" in GRADIENT.missing_input(campaign_of(measure(cycles=2, sensors=()).rows))


def test_on_a_ramp_the_sensor_is_ahead_by_the_rate_times_the_time_constant():
    rows = measure(profile=((60.0, 0.05, 0.0),), cycles=1).rows
    campaign = campaign_of(rows)
    ahead_c = SETTLED.columns(campaign, (LAG_TAU_S,))[:, :, 0]
    lag_s = 3600.0 * ahead_c / campaign.rate_c_per_h
    # A course is known from step to step of its record.
    np.testing.assert_allclose(lag_s[-6:], LAG_TAU_S, atol=0.6 * np.diff(campaign.record.time_s)[0])


@pytest.mark.parametrize("tau_s", [SETTLED.parameters[0].low, 60.0, 5000.0])
@pytest.mark.parametrize("step_s", [60.0, 3600.0])
def test_ahead_on_a_straight_line_the_lag_is_exact_however_coarse_the_steps(clean, tau_s, step_s):
    time_s = np.arange(clean.start_s[0], clean.end_s[-1] + step_s, step_s)
    rates_c_per_s = np.array([1.0, -2.0, 0.5]) / 3600.0
    record = TemperatureRecord(time_s, 20.0 + time_s[:, None] * rates_c_per_s)
    columns = SETTLED.columns(replace(clean, record=record), (tau_s,))[:, :, 0]
    settled = clean.start_s > 20.0 * max(tau_s, step_s)
    np.testing.assert_allclose(
        columns[settled], np.tile(rates_c_per_s * tau_s, (settled.sum(), 1)), rtol=1e-6
    )


def test_a_lag_dies_away_in_a_soak():
    rows = measure(profile=((60.0, 1.0, 16.0),), cycles=1).rows
    columns = SETTLED.columns(campaign_of(rows), (LAG_TAU_S,))
    assert np.abs(columns[-2:, :, 0]).max() < 0.02 * np.abs(columns[:, :, 0]).max()


def test_without_lag_there_is_nothing_left(clean):
    slow, quick = (np.abs(SETTLED.columns(clean, (tau_s,))).max() for tau_s in (3600.0, 60.0))
    assert quick < 0.05 * slow


def test_at_the_first_dwell_a_lag_is_settled_or_follows_a_temperature_that_changes(clean):
    """Begun on a ramp, a dwell's rate shows what a settled temperature can't lag by."""
    ramp = replace(clean, rate_c_per_h=clean.rate_c_per_h + 10.0)
    soak = replace(clean, rate_c_per_h=clean.rate_c_per_h - clean.rate_c_per_h[0])
    for campaign, form, other in ((ramp, UNDERWAY, SETTLED), (soak, SETTLED, UNDERWAY)):
        assert form.missing_input(campaign) is None
        assert other.missing_input(campaign)


def test_on_a_ramp_that_began_long_before_the_first_dwell_the_lag_is_the_same_throughout(clean):
    rate_c_per_s = 10.0 / 3600.0
    time_s = np.arange(clean.start_s[0], clean.end_s[-1] + 60.0, 60.0)
    ramp_c = np.repeat(20.0 + rate_c_per_s * time_s[:, None], 3, axis=1)
    rates_c_per_h = np.full_like(clean.rate_c_per_h, 10.0)
    ramp = replace(clean, record=TemperatureRecord(time_s, ramp_c), rate_c_per_h=rates_c_per_h)
    settled, long_before = (UNDERWAY.columns(ramp, (LAG_TAU_S, share)) for share in (0.0, 1.0))
    np.testing.assert_allclose(settled, SETTLED.columns(ramp, (LAG_TAU_S,)), rtol=1e-9)
    np.testing.assert_allclose(long_before, rate_c_per_s * LAG_TAU_S, rtol=1e-4)


def test_hysteresis_lies_behind_by_the_half_width_upward_and_downward(clean):
    behind_c = PLAY.columns(clean, (HALF_WIDTH_C,))[:, :, 0]
    assert np.abs(behind_c).max() <= HALF_WIDTH_C + 1e-9
    fast = np.abs(clean.rate_c_per_h) > 8.0
    swept = np.convolve(fast[:, 0], np.ones(3))[: len(fast)] >= 3
    np.testing.assert_allclose(behind_c[swept], -HALF_WIDTH_C * np.sign(clean.rate_c_per_h[swept]), atol=0.2)


def test_hysteresis_stays_in_a_soak_where_a_lag_dies_away():
    rows = measure(profile=((60.0, 1.0, 12.0),), cycles=1).rows
    behind_c = PLAY.columns(campaign_of(rows), (HALF_WIDTH_C,))[:, :, 0]
    np.testing.assert_allclose(behind_c[-4:], -HALF_WIDTH_C, atol=0.1)


def test_one_temperature_has_two_values_that_depend_on_the_way(clean):
    behind_c = PLAY.columns(clean, (HALF_WIDTH_C,))[:, 0, 0]
    near = np.abs(clean.gyro_c[:, 0] - 27.0) < 6.0
    assert np.ptp(behind_c[near]) > 1.9 * HALF_WIDTH_C


def test_swings_within_the_play_are_not_followed():
    rows = measure(profile=((22.0, 0.1, 3.0), (20.0, 0.1, 3.0)), cycles=2).rows
    campaign = campaign_of(rows)
    followed_c = PLAY.columns(campaign, (30.0,))[:, :, 0] + campaign.gyro_c
    assert np.ptp(followed_c, axis=0).max() < 0.2


def test_many_widths_begin_with_the_narrowest_and_end_as_one_width_does(clean):
    """Small swings are followed in part; far beyond all widths only their mean shows."""
    rows = measure(profile=((22.0, 0.1, 3.0), (20.0, 0.1, 3.0)), cycles=2).rows
    behind_c = MANY_WIDTHS.columns(campaign_of(rows), (4.0,))[:, :, 0]
    followed_c = behind_c + campaign_of(rows).gyro_c
    assert 0.05 < np.ptp(followed_c, axis=0).max() < np.ptp(campaign_of(rows).gyro_c, axis=0).max()
    one, many = (form.columns(clean, (HALF_WIDTH_C,))[:, :, 0] for form in THERMAL_HYSTERESIS.forms)
    swept = np.abs(many) > 0.99 * HALF_WIDTH_C
    assert swept.mean() > 0.1
    np.testing.assert_allclose(many[swept], one[swept], atol=0.05)


def test_an_ins_subtracts_many_widths_as_the_closest_single_one(clean):
    sizes_dph = np.array([[0.002], [-0.001], [0.0005]])
    searched = clean.all_dwells
    terms = THERMAL_HYSTERESIS.compensation(
        FittedForm(clean, searched, MANY_WIDTHS, (HALF_WIDTH_C,), sizes_dph)
    )
    true_dph = MANY_WIDTHS.columns(clean, (HALF_WIDTH_C,))[:, :, 0] * sizes_dph[:, 0]
    width_c = terms.coefficients["half_width_k"][0]
    of_ins_dph = PLAY.columns(clean, (width_c,))[:, :, 0] * terms.coefficients["hysteresis_dph_per_k"]
    off_dph = of_ins_dph - true_dph
    missed = np.sqrt(np.mean((off_dph - off_dph.mean(axis=0)) ** 2))
    assert missed < 0.25 * np.sqrt(np.mean((true_dph - true_dph.mean(axis=0)) ** 2))
    assert f"leaves {missed:.2g} deg/h rms" in terms.note
