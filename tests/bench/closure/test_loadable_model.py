"""What a search found, as numbers that an INS subtracts."""

import re
from dataclasses import replace

import numpy as np
import pytest

from gyrobench.bench.closure.campaign import campaign_of
from gyrobench.bench.closure.effects import all_effects, attitude_thermal
from gyrobench.bench.closure.effects.effect import FittedForm
from gyrobench.bench.closure.effects.laws import WARM_UP
from gyrobench.bench.closure.loadable_model import declared_model, model_with_effects
from gyrobench.bench.closure.loop import close_loop
from gyrobench.bench.closure.outcome import CandidateResult, OtherForm
from gyrobench.bench.closure.posterior import HypothesisProbability
from gyrobench.bench.closure.problem import SCALE_C
from tests.bench.closure.thermal_bench import STEP_S, measure
from tests.drivers.ins.compensation_reference import Conditions, compensated_dph

POWER_STEPS = {"power_steps_h": 7.0}
#: What each effect is best shown by.
LOADED = {
    "temperature_rate": {},
    "thermal_gradient": POWER_STEPS,
    "attitude_thermal": POWER_STEPS,
    "g_sensitivity": {},
    "warm_up": {},
    "thermal_hysteresis": {},
}
NOT_LOADED = ["chamber_state"]


def search(effect, **options):
    """A campaign with one effect, and a search that knows that one alone."""
    measured = measure({effect: 6.0}, **options)
    known = [each for each in all_effects() if each.name == effect]
    return measured, close_loop(campaign_of(measured.rows), effects=known)


def subtracted_dph(compensation, course, rows):
    """Mean over each dwell of what an INS subtracts that goes through a course, (n, 3)."""
    conditions = Conditions(
        optics_c=course.optics_c,
        board_c=course.board_c,
        rate_c_per_h=np.gradient(course.optics_c, axis=0) * 3600.0 / STEP_S,
        up_body=course.up,
        since_power_on_s=course.since_power_on_h * 3600.0,
    )
    bias_dph = compensated_dph(compensation, conditions)
    spans = [(round(row.start_s / STEP_S), round(row.end_s / STEP_S)) for row in rows]
    return np.array([bias_dph[first:end].mean(axis=0) for first, end in spans])


def rms(values):
    return np.sqrt(np.mean(values**2))


@pytest.mark.parametrize("effect", LOADED)
def test_an_ins_subtracts_the_bias_of_the_model(effect):
    measured, closure = search(effect, **LOADED[effect])
    assert [each.candidate.effect.name for each in closure.effects] == [effect]
    loadable = model_with_effects(closure)
    assert loadable.effects == (effect,)
    of_ins = subtracted_dph(loadable.compensation, measured.course, measured.rows)
    off = (of_ins - closure.model.bias_dph)[closure.searched]
    # The model takes means over half an hour where the INS follows each moment.
    assert rms(off) < 0.1 * closure.effects[0].rms_dph


def test_the_declared_model_is_a_polynomial_within_the_fitted_temperatures():
    _, closure = search("g_sensitivity")
    loadable = declared_model(closure)
    assert loadable.effects == ()
    assert loadable.compensation.terms() == ()
    campaign, compensation = closure.campaign, loadable.compensation
    zeros = np.zeros((len(campaign), 3))
    conditions = Conditions(campaign.gyro_c, zeros, zeros, campaign.up_body, campaign.start_s)
    off = (compensated_dph(compensation, conditions) - closure.declared.bias_dph)[closure.searched]
    np.testing.assert_allclose(off, 0.0, atol=1e-9)
    fitted_c = campaign.gyro_c[closure.searched]
    np.testing.assert_array_equal(compensation.low_c, fitted_c.min(axis=0))
    np.testing.assert_array_equal(compensation.high_c, fitted_c.max(axis=0))


def test_numbers_have_the_uncertainties_of_the_fit():
    _, closure = search("warm_up")
    compensation = model_with_effects(closure).compensation
    sigma, [found] = compensation.sigma, closure.effects
    assert sigma.keys() == {"polynomial_dph", "warm_up_dph", "warm_up_s"}
    np.testing.assert_allclose(sigma["warm_up_dph"], found.sizes_sigma_dph[:, 0])
    np.testing.assert_allclose(sigma["warm_up_s"], found.values_sigma[0])
    draws = closure.model_draws
    cubic = draws.declared[:, :, 2] / SCALE_C**3
    stated = compensation.polynomial_dph[:, 3]
    np.testing.assert_allclose(sigma["polynomial_dph"][:, 3], draws.sigma(cubic, stated))


@pytest.mark.long
def test_true_numbers_are_within_their_uncertainties():
    def loaded(**options):
        return model_with_effects(search("g_sensitivity", **options)[1]).compensation

    true, off = loaded(noise=1e-3).gravity_dph_per_g, []
    for seed in range(10):
        compensation = loaded(seed=seed)
        off.append((compensation.gravity_dph_per_g - true) / compensation.sigma["gravity_dph_per_g"])
    assert 0.8 < np.sqrt(np.mean(np.square(off))) < 1.25


def test_rates_and_differences_are_limited_to_the_fitted_range():
    _, closure = search("temperature_rate")
    rate_c_per_h = closure.campaign.rate_c_per_h[closure.searched]
    compensation = model_with_effects(closure).compensation
    np.testing.assert_array_equal(compensation.rate_limit_c_per_h, np.abs(rate_c_per_h).max(axis=0))
    _, closure = search("thermal_gradient", **POWER_STEPS)
    above_k = (closure.campaign.board_c - closure.campaign.gyro_c)[closure.searched]
    compensation = model_with_effects(closure).compensation
    np.testing.assert_array_equal(compensation.difference_low_k, above_k.min(axis=0))
    np.testing.assert_array_equal(compensation.difference_high_k, above_k.max(axis=0))


@pytest.mark.parametrize("effect", NOT_LOADED)
def test_an_effect_without_a_term_of_the_ins_is_left_out_with_a_note(effect):
    _, closure = search(effect)
    loadable = model_with_effects(closure)
    assert loadable.effects == ()
    assert loadable.compensation.terms() == ()
    assert any(note.startswith(f"{closure.label(effect)} is left out") for note in loadable.notes)


def search_two(effects, **options):
    """A campaign with two effects, and a search that knows these alone and finds them."""
    measured = measure(effects, **options)
    known = [each for each in all_effects() if each.name in effects]
    closure = close_loop(campaign_of(measured.rows), effects=known)
    assert set(closure.names) == set(effects)
    return measured, closure


def test_an_effect_that_is_left_out_beside_another_one_leaves_its_mean_in_the_constant():
    sensors = ("set", "air", "board", "room")
    measured, closure = search_two({"g_sensitivity": 6.0, "daily_course": 6.0}, sensors=sensors)
    [left_out] = [each for each in closure.effects if each.effect.name == "daily_course"]
    loadable, declared = model_with_effects(closure).compensation, declared_model(closure).compensation
    assert loadable.terms() == ("g_sensitivity",)
    of_ins = subtracted_dph(loadable, measured.course, measured.rows)
    left_dph = (closure.model.bias_dph - of_ins)[closure.searched]
    assert np.abs(left_dph.mean(axis=0)).max() < 0.05 * left_out.rms_dph
    assert rms(left_dph) == pytest.approx(left_out.rms_dph, rel=0.05)
    # The mean of the course is known to the noise, though that of the room is far from zero.
    assert np.all(loadable.sigma["polynomial_dph"][:, 0] < 2.0 * declared.sigma["polynomial_dph"][:, 0])


@pytest.mark.parametrize(
    "effects",
    [
        # They nearly cancel while the temperature falls.
        {"temperature_rate": 6.0, "chamber_state": 6.0},
        # The declared model follows part of a drift within each cycle, the value at its end none.
        {"time_drift": 6.0, "thermal_g_sensitivity": 3.0},
    ],
)
def test_the_declared_model_is_loaded_if_the_other_effects_alone_leave_more(effects):
    measured, closure = search_two(effects)
    loadable, declared = model_with_effects(closure), declared_model(closure)
    assert loadable.effects == loadable.compensation.terms() == ()
    np.testing.assert_array_equal(loadable.compensation.polynomial_dph, declared.compensation.polynomial_dph)
    [with_terms, stated] = re.findall(
        r"no effect is loaded: the terms of the INS would leave (\S+) deg/h rms of the fitted model, "
        r"the declared model leaves (\S+) deg/h",
        loadable.notes[-1],
    )[0]
    assert float(with_terms) > float(stated)
    of_ins = subtracted_dph(loadable.compensation, measured.course, measured.rows)
    left_dph = (closure.model.bias_dph - of_ins)[closure.searched]
    assert rms(left_dph - left_dph.mean(axis=0)) == pytest.approx(float(stated), rel=0.1)


def test_a_lag_is_compensated_as_the_temperature_rate_that_is_nearest_to_it():
    measured, closure = search("thermal_lag")
    [found], loadable = closure.effects, model_with_effects(closure)
    assert loadable.effects == ("thermal_lag",)
    of_ins = subtracted_dph(loadable.compensation, measured.course, measured.rows)
    left_dph = (closure.model.bias_dph - of_ins)[closure.searched]
    left_dph -= left_dph.mean(axis=0)
    assert rms(left_dph) < 0.6 * found.rms_dph
    [stated] = re.findall(
        r"thermal lag is compensated as the temperature rate, which leaves (\S+) deg/h rms of it",
        "; ".join(loadable.notes),
    )
    assert rms(left_dph) == pytest.approx(float(stated), rel=0.1)


@pytest.mark.parametrize("effect", ["thermal_lag", "time_drift"])
def test_terms_that_subtract_an_effect_in_part_state_what_they_leave_in_each_dwell(effect):
    measured, closure = search(effect)
    [found] = closure.effects
    form, values = found.candidate.form, found.candidate.values
    fitted = FittedForm(closure.campaign, closure.searched, form, values, found.sizes_dph)
    of_ins = subtracted_dph(model_with_effects(closure).compensation, measured.course, measured.rows)
    off_dph = closure.model.bias_dph - of_ins - found.effect.compensation(fitted).residual_dph
    assert rms(off_dph - off_dph.mean(axis=0)) < 0.1 * found.rms_dph


def test_a_temperature_rate_and_a_lag_add_up():
    measured = measure({"temperature_rate": 6.0, "thermal_lag": 6.0})
    known = [each for each in all_effects() if each.name in ("temperature_rate", "thermal_lag")]
    closure = close_loop(campaign_of(measured.rows), effects=known)
    assert set(closure.names) == {"temperature_rate", "thermal_lag"}
    both, *alone = (
        model_with_effects(replace(closure, effects=effects)).compensation.rate_dph_per_c_per_h
        for effects in (closure.effects, closure.effects[:1], closure.effects[1:])
    )
    np.testing.assert_allclose(both, sum(alone))


def test_a_drift_is_taken_as_it_was_at_the_end():
    _, closure = search("time_drift")
    loadable = model_with_effects(closure)
    days = (closure.campaign.middle_s[-1] - closure.campaign.middle_s[0]) / 86_400.0
    drifted_dph = days * closure.effects[0].sizes_dph[:, 0]
    constant_dph = closure.model.declared[:, 3]
    np.testing.assert_allclose(loadable.compensation.polynomial_dph[:, 0], constant_dph + drifted_dph)
    assert any("by its value at the end of the campaign" in note for note in loadable.notes)


def test_the_constant_is_the_mean_of_the_power_cycles_searched_with_their_scatter():
    _, closure = search("g_sensitivity", power_on_each_cycle=True)
    constants = closure.model.declared[:, 3 + np.unique(closure.campaign.run[closure.searched])]
    loadable = model_with_effects(closure)
    np.testing.assert_allclose(loadable.compensation.polynomial_dph[:, 0], constants.mean(axis=1))
    assert "the mean of 2 power cycles, which scatter by" in loadable.notes[0]


def test_without_sensors_at_the_electronics_a_gradient_is_left_out():
    _, closure = search("thermal_gradient", **POWER_STEPS)
    blind = replace(closure.campaign, board_c=np.full_like(closure.campaign.board_c, np.nan))
    loadable = model_with_effects(replace(closure, campaign=blind))
    assert loadable.effects == ()
    assert "the INS has no sensors there" in loadable.notes[1]


def test_a_tied_effect_is_loaded_with_a_note():
    _, closure = search("g_sensitivity")
    tied = replace(closure.effects[0], tied_with=("warm_up", "time_drift"))
    loadable = model_with_effects(replace(closure, effects=(tied,)))
    assert loadable.effects == ("g_sensitivity",)
    assert (
        "g-sensitivity is loaded, but warm up or time drift fits the data equally well" in loadable.notes[1]
    )


def test_a_form_that_is_less_probable_than_another_is_loaded_with_a_note():
    _, closure = search("thermal_hysteresis")
    [found] = closure.effects
    many_widths = replace(found.candidate, form=found.effect.forms[1])

    def note(probability):
        other = OtherForm(many_widths, probability, found.values_sigma, found.values_range, 0.0002, 43)
        closed = replace(closure, effects=(replace(found, other_forms=(other,)),))
        return "; ".join(model_with_effects(closed).notes[1:])

    assert note(0.4) == ""
    assert note(0.6) == (
        "thermal hysteresis is loaded with the form one width, which has the smallest BIC (P = 0.40), though "
        "many widths is more probable (P = 0.60); that changes the bias by at most 0.0002 deg/h, in dwell "
        "43: repeat that dwell with those before it to decide"
    )


def test_effects_that_are_more_probable_with_another_one_are_loaded_with_a_note():
    _, closure = search("g_sensitivity")
    found = frozenset({"g_sensitivity"})
    warm_up = CandidateResult(WARM_UP, rejected="it may only correct the inexact laws of the others")

    def note(p_both, p_alone, reason=warm_up.rejected, effects=closure.effects):
        hypotheses = [
            HypothesisProbability(names, False, probability, ())
            for names, probability in ((found | {"warm_up"}, p_both), (found, p_alone))
        ]
        ranked = tuple(sorted(hypotheses, key=lambda each: -each.probability))
        posterior = replace(closure.posterior, hypotheses=ranked)
        closed = replace(closure, posterior=posterior, evidence=(replace(warm_up, rejected=reason),))
        closed = replace(closed, effects=effects)
        return "; ".join(model_with_effects(closed).notes[1:])

    assert note(0.4, 0.6) == ""
    assert note(0.9, 0.1) == (
        "warm-up is not loaded, though the effects found are more probable with it (P = 0.9) than alone "
        f"(P = 0.1): {warm_up.rejected}; to decide, {WARM_UP.experiment}"
    )
    assert note(0.9, 0.1, reason="").endswith(f"(P = 0.1): to decide, {WARM_UP.experiment}")
    assert note(0.9, 0.1, effects=()) == ""


def test_a_heat_flow_unknown_in_flagged_dwells_is_left_out():
    rows = [
        replace(row, flags=("vibration",), board_c=(np.nan,) * 3) if row.dwell % 7 == 0 else row
        for row in measure({"attitude_thermal": 5.0}).rows
    ]
    closure = close_loop(campaign_of(rows), effects=[attitude_thermal.EFFECT])
    assert [each.candidate.form.name for each in closure.effects] == ["saturating, flow unknown"]
    assert model_with_effects(closure).effects == ()
