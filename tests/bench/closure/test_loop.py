from dataclasses import replace

import numpy as np
import pytest

from gyrobench.bench.closure.campaign import campaign_of
from gyrobench.bench.closure.candidates import solve_with
from gyrobench.bench.closure.effects import all_effects, attitude_thermal
from gyrobench.bench.closure.effects.laws import (
    BIAS_JUMP,
    G_SENSITIVITY,
    TEMPERATURE_RATE,
    THERMAL_G_SENSITIVITY,
    THERMAL_GRADIENT,
    THERMAL_HYSTERESIS,
    THERMAL_LAG,
    TIME_DRIFT,
    WARM_UP,
)
from gyrobench.bench.closure.effects.surroundings import CHAMBER_STATE
from gyrobench.bench.closure.loop import close_loop
from gyrobench.bench.closure.problem import declared_columns, declared_problem
from gyrobench.bench.closure.search import Search
from gyrobench.bench.closure.validation import LACK_OF_FIT_P
from gyrobench.bench.foundations.errors import MeasurementError
from tests.bench.closure.conftest import among
from tests.bench.closure.thermal_bench import SHARES, SIGMA_DPH, UP, measure

LONG = pytest.mark.long
TRIANGLE = ((-20.0, 0.2, 0.0), (60.0, 0.2, 0.0), (20.0, 0.2, 0.0))


def residual_of_direct_fit(campaign, searched, terms=None):
    """Measured bias minus a least-squares fit to the dwells searched; all runs are in them."""
    rest = np.empty_like(campaign.bias_dph)
    for gyro in range(3):
        columns = declared_columns(campaign, gyro)
        if terms is not None:
            columns = np.concatenate([columns, terms[:, gyro]], axis=1)
        fit = np.linalg.lstsq(columns[searched], campaign.bias_dph[searched, gyro], rcond=None)[0]
        rest[:, gyro] = campaign.bias_dph[:, gyro] - columns @ fit
    return rest


def rms(values):
    return np.sqrt(np.mean(values**2))


def with_common_errors(rows, sizes, *, is_stated=True):
    """Rows with errors that the dwells of an attitude share, in sigmas, and their standard uncertainties.

    Each gyro gets one in each attitude where it is level, and one along Up where it is vertical.
    """
    random = np.random.default_rng(4)
    level = {name: sizes * SIGMA_DPH * random.standard_normal(3) for name in sorted(UP)}
    vertical_dph, common = sizes * SIGMA_DPH * random.standard_normal(3), (sizes * SIGMA_DPH,) * 3
    return [
        replace(
            row,
            bias_dph=tuple(row.bias_dph + np.where(up == 0.0, level[row.position], vertical_dph * up)),
            sigma_dph=(np.hypot(1.0, sizes) * SIGMA_DPH,) * 3,
            **({"common_sigma_dph": common} if is_stated else {}),
        )
        for row in rows
        for up in [np.rint(UP[row.position])]
    ]


@pytest.mark.parametrize("sizes", [0.7, 4.0])
def test_errors_that_the_dwells_of_an_attitude_share_are_no_effect_and_no_noise(sizes):
    rows = measure().rows
    assert (
        close_loop(
            campaign_of(with_common_errors(rows, sizes, is_stated=False)), effects=[G_SENSITIVITY]
        ).verdict
        != "clean"
    )
    closure = close_loop(campaign_of(with_common_errors(rows, sizes)), effects=[G_SENSITIVITY])
    assert (closure.verdict, closure.noise_scale) == ("clean", 1.0)
    assert closure.noise_dph == pytest.approx(np.hypot(1.0, sizes) * SIGMA_DPH)


def test_effects_are_as_visible_beside_common_errors_as_without():
    rows = measure({"temperature_rate": 1.0}).rows
    alone, beside = (
        close_loop(campaign_of(each), effects=[TEMPERATURE_RATE, G_SENSITIVITY])
        for each in (rows, with_common_errors(rows, 4.0))
    )
    assert (alone.names, alone.verdict) == (("temperature_rate",), "explained")
    assert (beside.names, beside.verdict) == (alone.names, alone.verdict)
    sigmas = [each.effects[0].sizes_sigma_dph for each in (alone, beside)]
    np.testing.assert_allclose(sigmas[1], sigmas[0], rtol=0.2)


def test_clean_data_are_called_clean(closed):
    closure = closed()
    assert closure.verdict == "clean"
    assert closure.effects == ()
    assert closure.noise_scale == 1.0
    assert closure.noise_dph == pytest.approx(SIGMA_DPH)
    assert closure.error_after_dph == closure.error_before_dph == pytest.approx(SIGMA_DPH, rel=0.15)


def test_an_effect_is_explained_with_its_size(closed):
    closure = closed({"g_sensitivity": 4.0})
    [found] = closure.effects
    assert closure.verdict == "explained"
    assert found.candidate.effect.name == "g_sensitivity"
    assert found.axes == ("x", "y", "z")
    assert found.p_value < 1e-12
    assert found.tied_with == ()
    assert closure.before.p_value < LACK_OF_FIT_P < closure.after.p_value


@among(TEMPERATURE_RATE, THERMAL_HYSTERESIS, TIME_DRIFT)
def test_a_form_that_the_data_do_not_exclude_is_stated_with_its_probability(candidates):
    weak, strong = (
        close_loop(
            campaign_of(measure({"thermal_hysteresis": size}, headings_deg=(0.0, 90.0)).rows),
            effects=candidates,
        )
        for size in (2.0, 8.0)
    )
    [found] = weak.effects
    [other] = found.other_forms
    assert {found.candidate.form, other.candidate.form} == set(THERMAL_HYSTERESIS.forms)
    [of] = [
        each
        for each in weak.posterior.hypotheses
        if each.names == {"thermal_hysteresis"} and not each.has_remainder
    ]
    assert sum(share for share, _ in of.forms) == pytest.approx(1.0)
    shares = {candidates[0].form: share for share, candidates in of.forms}
    assert other.probability == pytest.approx(shares[other.candidate.form])
    assert 0.05 < other.probability < 0.5
    [(low_c, high_c)], [width_c] = other.values_range, other.candidate.values
    assert low_c < width_c < high_c
    fitted = solve_with(weak.noise.problem(weak.campaign, weak.searched), [other.candidate])
    differences_dph = np.abs(weak.residuals_dph(fitted) - weak.residuals_dph(weak.model))
    assert other.difference_dph == pytest.approx(np.max(differences_dph))
    assert other.difference_dph == pytest.approx(np.max(differences_dph[weak.campaign.dwell == other.dwell]))
    assert strong.effects[0].other_forms == ()


def test_the_stated_size_is_that_in_the_dwells_searched(closed):
    measured = measure({"time_drift": 4.0}, cycles=2)
    [found] = closed({"time_drift": 4.0}).effects
    searched = np.array([row.cycle == 1 for row in measured.rows])
    part = measured.undeclared_dph[searched]
    assert found.rms_dph == pytest.approx(rms(part - part.mean(axis=0)), rel=0.15)


@pytest.mark.parametrize("seeds", [4, pytest.param(10, marks=LONG)])
def test_gyros_that_show_an_effect_are_named_and_others_seldom(seeds):
    named = []
    for seed in range(seeds):
        rows, clean = (measure(each, cycles=2, seed=seed).rows for each in ({"time_drift": 5.0}, None))
        mixed = [
            replace(row, bias_dph=(none.bias_dph[0], row.bias_dph[1], none.bias_dph[2]))
            for row, none in zip(rows, clean, strict=True)
        ]
        [found] = close_loop(campaign_of(mixed), effects=[TIME_DRIFT]).effects
        named += found.axes
    assert named.count("y") == seeds
    assert len(named) <= 1.5 * seeds


def test_two_effects_that_fit_equally_well_are_ambiguous(closed):
    closure = closed({"temperature_rate": 1.0}, profile=TRIANGLE, cycles=2)
    [found] = closure.effects
    assert closure.verdict == "ambiguous"
    assert "temperature_rate" in {found.candidate.effect.name, *found.tied_with}


@pytest.mark.parametrize("outside", ["sinusoid", "square_wave"])
def test_an_effect_that_no_candidate_has_is_unexplained(closed, outside):
    closure = closed({outside: 1.5}, seed=1)
    assert closure.verdict == "unexplained"
    assert closure.after.p_value < LACK_OF_FIT_P


def test_an_effect_without_its_candidate_is_unexplained():
    others = [each for each in all_effects() if each.name not in {"g_sensitivity", "attitude_thermal"}]
    closure = close_loop(campaign_of(measure({"g_sensitivity": 2.0}, cycles=2).rows), effects=others)
    assert closure.verdict == "unexplained"


@among(BIAS_JUMP, G_SENSITIVITY, TEMPERATURE_RATE, TIME_DRIFT)
def test_with_an_unexplained_residual_a_cross_validated_effect_is_kept_with_its_probability(candidates):
    rows = measure({"g_sensitivity": 4.0, "sinusoid": 1.5}, headings_deg=(0.0, 90.0), seed=1).rows
    closure = close_loop(campaign_of(rows), effects=candidates)
    [found] = closure.effects
    assert closure.verdict == "unexplained"
    assert found.candidate.effect.name == "g_sensitivity"
    assert min(found.gains.values()) > 0.5
    assert closure.error_after_dph < 0.5 * closure.error_before_dph
    assert closure.posterior.unlisted_probability > 0.95
    assert found.probability > 0.95


def test_a_stand_in_for_an_unexplained_residual_is_replaced_by_the_confirmed_effect():
    """The best hypothesis is without the drift; alone, the drift is best."""
    candidates = [BIAS_JUMP, CHAMBER_STATE, THERMAL_LAG, TIME_DRIFT]
    rows = measure({"time_drift": 8.0, "square_wave": 2.0}, seed=1).rows
    closure = close_loop(campaign_of(rows), effects=candidates)
    best = Search(declared_problem(closure.campaign, closure.searched), candidates).best()
    assert "time_drift" not in best.names
    assert [each.candidate.effect.name for each in closure.effects] == ["time_drift"]
    assert closure.verdict == "unexplained"


def test_with_an_unexplained_residual_an_unconfirmed_effect_is_dropped():
    candidates = [BIAS_JUMP, CHAMBER_STATE, WARM_UP]
    closure = close_loop(campaign_of(measure({"sinusoid": 3.0}, seed=1).rows), effects=candidates)
    best = Search(declared_problem(closure.campaign, closure.searched), candidates).best()
    assert best.candidates
    assert closure.effects == ()
    assert closure.verdict == "unexplained"


def test_where_nothing_is_beyond_the_noise_there_is_no_share_of_it():
    quiet = close_loop(campaign_of(measure({"time_drift": 1.2}, noise=0.5).rows), effects=[TIME_DRIFT])
    [evidence] = quiet.evidence
    assert quiet.before.noise_ratio < 1.0
    assert np.isnan(evidence.share)
    assert evidence.p_value < 1e-3


def test_an_effect_that_all_gyros_show_together_has_the_one_that_shows_it_most():
    rows = measure({"temperature_rate": 0.3}, seed=2).rows
    [found] = close_loop(campaign_of(rows), effects=[TEMPERATURE_RATE]).effects
    assert found.axes


def test_the_error_falls_to_the_noise_where_an_effect_is_explained(closed):
    closure = closed({"g_sensitivity": 4.0})
    assert closure.error_before_dph > 3.0 * SIGMA_DPH
    assert closure.error_after_dph == pytest.approx(SIGMA_DPH, rel=0.25)


def test_errors_are_those_of_a_direct_fit(closed):
    closure = closed({"g_sensitivity": 4.0})
    campaign, searched = closure.campaign, closure.searched
    [found] = closure.effects
    before = residual_of_direct_fit(campaign, searched)
    assert closure.error_before_dph == pytest.approx(rms(before[~searched]), rel=1e-6)
    if found.candidate.kept.all():
        after = residual_of_direct_fit(campaign, searched, found.candidate.columns(campaign))
        assert closure.error_after_dph == pytest.approx(rms(after[~searched]), rel=1e-6)


def test_errors_of_a_run_that_was_not_searched_are_without_its_mean():
    rows = measure(power_on_each_cycle=True, dwell_s=1680.0).rows
    lifted = [
        replace(row, bias_dph=tuple(np.add(row.bias_dph, 1.0).tolist())) if row.cycle == 3 else row
        for row in rows
    ]
    one, other = (close_loop(campaign_of(each), effects=[]) for each in (rows, lifted))
    assert other.error_before_dph == pytest.approx(one.error_before_dph, rel=1e-9)
    assert one.error_before_dph == pytest.approx(SIGMA_DPH, rel=0.15)


@pytest.mark.parametrize("each_cycle", [False, True], ids=["one run", "a run a cycle"])
def test_held_out_biases_change_nothing_but_the_errors(each_cycle):
    effects = (TEMPERATURE_RATE, G_SENSITIVITY)
    rows = measure({"temperature_rate": 4.0}, power_on_each_cycle=each_cycle).rows
    draw = np.random.default_rng(9)
    garbage = [
        replace(row, bias_dph=tuple(draw.uniform(-5.0, 5.0, 3).tolist())) if row.cycle == 3 else row
        for row in rows
    ]
    one, other = (close_loop(campaign_of(each), effects=effects) for each in (rows, garbage))
    assert (one.verdict, other.verdict) == ("explained", "ambiguous")
    assert [each.p_value for each in other.effects] == [each.p_value for each in one.effects]
    assert [each.gains for each in other.effects] == [each.gains for each in one.effects]
    for mine, its in zip(one.model.sizes, other.model.sizes, strict=True):
        np.testing.assert_array_equal(mine, its)
    np.testing.assert_array_equal(one.model.bias_dph, other.model.bias_dph)
    assert (other.before, other.after) == (one.before, one.after)
    assert other.error_after_dph > 100.0 * one.error_after_dph


def test_held_out_uncertainties_do_not_change_the_outcome():
    rows = measure({"g_sensitivity": 4.0}, cycles=2).rows
    changed = [replace(row, sigma_dph=(1.0,) * 3) if row.cycle == 2 else row for row in rows]
    one, other = (close_loop(campaign_of(each), effects=[G_SENSITIVITY]) for each in (rows, changed))
    np.testing.assert_array_equal(one.model.bias_dph, other.model.bias_dph)
    assert other.noise_dph == one.noise_dph


def test_another_cycle_is_held_out():
    closure = close_loop(campaign_of(measure().rows), [1], effects=[])
    assert set(closure.campaign.cycle[~closure.searched]) == {1}
    assert closure.error_before_dph == pytest.approx(SIGMA_DPH, rel=0.2)


def test_an_unknown_cycle_is_refused():
    with pytest.raises(MeasurementError, match="no cycle 7 to hold out"):
        close_loop(campaign_of(measure().rows), [7])


def test_one_cycle_alone_can_not_be_held_out():
    campaign = campaign_of(measure(cycles=1).rows)
    with pytest.raises(MeasurementError, match=r"remains to search\. Measure the profile at least twice"):
        close_loop(campaign, [1], effects=[])


def test_one_cycle_is_searched_whole_and_confirms_nothing():
    campaign = campaign_of(measure({"g_sensitivity": 8.0}, cycles=1).rows)
    closure = close_loop(campaign, effects=[G_SENSITIVITY])
    assert closure.searched.all()
    assert [each.effect.name for each in closure.effects] == ["g_sensitivity"]
    assert closure.verdict == "ambiguous"
    assert np.isnan([closure.error_before_dph, closure.error_after_dph]).all()


def test_too_few_dwells_are_refused():
    rows = measure(profile=((10.0, 1.0, 3.0),), cycles=2).rows
    with pytest.raises(MeasurementError, match="at least twice, each time with 10 dwells or more"):
        close_loop(campaign_of(rows))


def test_a_little_more_noise_than_stated_is_noise(closed):
    closure = closed(noise=1.18, cycles=3, headings_deg=(0.0,))
    assert closure.verdict == "clean"
    assert closure.noise_scale == pytest.approx(1.18, rel=0.06)
    assert closure.noise_dph == pytest.approx(SIGMA_DPH * closure.noise_scale)


def test_noise_understated_by_up_to_1_6_is_recognized(closed):
    closure = closed(noise=1.55, cycles=3, headings_deg=(0.0,))
    assert closure.verdict == "clean"
    assert closure.effects == ()
    assert closure.noise_scale == pytest.approx(1.55, rel=0.08)


@among(attitude_thermal.EFFECT, BIAS_JUMP, TEMPERATURE_RATE, TIME_DRIFT, WARM_UP)
def test_much_more_noise_than_stated_is_unexplained_without_any_effect(candidates):
    closure = close_loop(campaign_of(measure(cycles=2, noise=2.2).rows), effects=candidates)
    assert closure.verdict == "unexplained"
    assert closure.noise_scale == 1.0
    assert closure.effects == ()
    assert closure.after.p_any_structure > 1e-3


def test_an_effect_is_found_in_a_little_more_noise_than_stated():
    closure = close_loop(
        campaign_of(measure({"g_sensitivity": 4.0}, noise=1.18, seed=4).rows),
        effects=[G_SENSITIVITY, TEMPERATURE_RATE, TIME_DRIFT],
    )
    [found] = closure.effects
    assert closure.verdict == "explained"
    assert found.candidate.effect.name == "g_sensitivity"
    assert min(found.gains.values()) > 0.8
    assert closure.noise_scale == pytest.approx(1.18, rel=0.1)


def test_evidence_has_the_share_of_each_effect_alone(closed):
    closure = closed({"g_sensitivity": 4.0})
    evidence = {each.effect.name: each for each in closure.evidence}
    assert set(evidence) == {each.name for each in all_effects()}
    assert evidence["g_sensitivity"].share == pytest.approx(1.0, abs=0.1)
    assert evidence["g_sensitivity"].log_odds_against == pytest.approx(0.0, abs=1e-6)
    assert evidence["time_drift"].share < 0.1
    assert evidence["time_drift"].log_odds_against > 100.0


def test_evidence_names_missing_inputs():
    closure = close_loop(campaign_of(measure(sensors=(), cycles=2).rows))
    lacks = {each.effect.name: each.missing_input for each in closure.evidence}
    assert lacks["chamber_state"] == "the chamber's set point"
    assert "temperature sensors" in lacks["thermal_gradient"]
    assert lacks["time_drift"] is None


@among(attitude_thermal.EFFECT, G_SENSITIVITY, TEMPERATURE_RATE, TIME_DRIFT)
def test_positions_in_blocks_give_the_same_answer(candidates):
    blocks = [each for each in UP for _ in range(6)]
    rows = measure({"attitude_thermal": 4.0}, positions=blocks, cycles=2).rows
    closure = close_loop(campaign_of(rows), effects=candidates)
    assert closure.verdict == "explained"
    assert [each.candidate.effect.name for each in closure.effects] == ["attitude_thermal"]


def test_one_position_alone_shows_no_gravity():
    closure = close_loop(campaign_of(measure(positions=["z_up"], cycles=2).rows))
    assert closure.verdict == "clean"
    assert {each.effect.name: each.candidate for each in closure.evidence}["g_sensitivity"] is None


@among(attitude_thermal.EFFECT, BIAS_JUMP, G_SENSITIVITY, THERMAL_G_SENSITIVITY)
def test_an_effect_of_thirty_times_the_noise_is_explained_by_itself_alone(candidates):
    campaign = campaign_of(measure({"attitude_thermal": 30.0}, cycles=2).rows)
    closure = close_loop(campaign, effects=candidates)
    assert closure.verdict == "explained"
    assert [each.candidate.effect.name for each in closure.effects] == ["attitude_thermal"]


def test_sizes_follow_the_gyros(closed):
    [found] = closed({"time_drift": 4.0}).effects
    np.testing.assert_allclose(found.sizes_dph[:, 0] / found.sizes_dph[0, 0], SHARES, atol=0.2)


def test_one_dwell_far_off_is_no_effect_but_an_outlier():
    rows = measure(cycles=2).rows
    rows[0] = replace(rows[0], bias_dph=tuple(np.add(rows[0].bias_dph, 10.0 * SIGMA_DPH).tolist()))
    closure = close_loop(campaign_of(rows))
    assert closure.effects == ()
    assert closure.verdict == "clean"
    assert {(each.dwell, each.gyro) for each in closure.noise.outliers} == {(1, "x"), (1, "y"), (1, "z")}
    for each in closure.noise.outliers:
        assert each.residual_sigma == pytest.approx(10.0, abs=3.5)


def test_outliers_do_not_influence_the_fit_and_hide_no_effect():
    candidates = [BIAS_JUMP, G_SENSITIVITY, TEMPERATURE_RATE, TIME_DRIFT]
    rows = measure({"g_sensitivity": 4.0}).rows
    disturbed = (11, 50)
    bad = [
        replace(row, bias_dph=tuple(np.add(row.bias_dph, 15.0 * SIGMA_DPH).tolist()))
        if row.dwell in disturbed
        else row
        for row in rows
    ]
    closure, undisturbed = (close_loop(campaign_of(each), effects=candidates) for each in (bad, rows))
    assert {each.dwell for each in closure.noise.outliers} == set(disturbed)
    assert [each.effect.name for each in closure.effects] == ["g_sensitivity"]
    assert closure.verdict == undisturbed.verdict
    np.testing.assert_allclose(
        closure.effects[0].sizes_dph, undisturbed.effects[0].sizes_dph, atol=1.0 * SIGMA_DPH
    )


def test_a_rejected_candidate_has_its_reason(closed):
    closure = closed({"g_sensitivity": 4.0})
    settled = {each.effect.name for each in closure.effects}
    rejected = {each.effect.name: each.rejected for each in closure.evidence if each.rejected}
    significant = {each.effect.name for each in closure.evidence if each.p_value < 1e-3}
    assert rejected.keys() == significant - settled
    assert rejected["attitude_thermal"].startswith("not significant beside g-sensitivity")


def test_a_cause_more_probable_than_the_one_found_has_the_objection_to_itself(closed):
    """A decay longer than the campaign: what is said against it is not that it adds nothing to a drift."""

    def decay(course):
        return np.exp(-course.time_h / (4.0 * course.time_h[-1]))[:, None]

    options = {"cycles": 4, "headings_deg": (0.0,), "power_on_each_cycle": True, "sensors": ()}
    closure = closed({decay: 6.0}, **options)
    assert [each.effect.name for each in closure.effects] == ["time_drift"]
    assert closure.posterior.sets[0] == {"ageing"}
    [rejected] = [each.rejected for each in closure.evidence if each.effect.name == "ageing"]
    assert rejected.startswith("a parameter is at its upper bound")


@LONG
def test_not_even_the_length_of_the_held_out_cycle_changes_the_outcome():
    rows = measure({"thermal_hysteresis": 5.0}, cycles=3).rows
    few = [row for row in rows if row.cycle < 3] + [row for row in rows if row.cycle == 3][:4]
    candidates = [TEMPERATURE_RATE, THERMAL_HYSTERESIS, THERMAL_LAG]
    one, other = (close_loop(campaign_of(each), effects=candidates) for each in (rows, few))
    assert one.effects
    assert [each.candidate.values for each in one.effects] == [
        each.candidate.values for each in other.effects
    ]
    assert [each.p_value for each in one.effects] == [each.p_value for each in other.effects]
    assert one.after == other.after


@among(TEMPERATURE_RATE, THERMAL_GRADIENT, THERMAL_LAG, TIME_DRIFT)
def test_an_effect_that_an_untried_one_imitates_is_ambiguous(candidates):
    rows = measure({"temperature_rate": 5.0}, cycles=3, sensors=("air", "set")).rows
    closure = close_loop(campaign_of(rows), effects=candidates)
    assert closure.verdict == "ambiguous"
    [found] = closure.effects
    assert found.candidate.effect.name == "temperature_rate"
    assert "thermal_gradient" in found.tied_with


@among(TEMPERATURE_RATE, THERMAL_HYSTERESIS, THERMAL_LAG, TIME_DRIFT, WARM_UP)
def test_a_constant_gyro_temperature_without_other_temperatures_is_searched(candidates):
    rows = [
        replace(row, gyro_c=(25.0, 25.0, 25.0), gyro_rate_c_per_h=(0.0, 0.0, 0.0))
        for row in measure({"warm_up": 8.0}, cycles=2, power_on_each_cycle=True, sensors=()).rows
    ]
    closure = close_loop(campaign_of(rows), effects=candidates)
    assert closure.verdict in {"explained", "ambiguous", "unexplained"}
    assert np.isfinite(
        [closure.posterior.unlisted_probability, closure.posterior.no_effect_probability]
    ).all()
