from dataclasses import replace

import numpy as np
import pytest

from gyrobench.bench.closure.campaign import campaign_of
from gyrobench.bench.closure.effects import attitude_thermal
from gyrobench.bench.closure.effects.laws import G_SENSITIVITY, THERMAL_HYSTERESIS, WARM_UP
from gyrobench.bench.closure.loop import close_loop
from gyrobench.bench.closure.outcome import FoundEffect, OtherForm
from tests.bench.closure.test_candidates import whole
from tests.bench.closure.thermal_bench import SIGMA_DPH, measure

TRIANGLE = ((-20.0, 0.2, 0.0), (60.0, 0.2, 0.0), (20.0, 0.2, 0.0))


def found(effect, *values, axes=("x", "y", "z"), sigma=(), within=(), other_forms=()):
    candidate = whole(effect, *values)
    shape = candidate.kept.shape
    return FoundEffect(
        candidate,
        np.zeros(shape),
        axes,
        1e-9,
        41,
        0.01234,
        {},
        (),
        0.999,
        np.zeros(shape),
        np.array(sigma),
        0.0004,
        within,
        np.ones(1),
        np.zeros(shape),
        other_forms=other_forms,
    )


def test_a_statement_has_size_gyros_and_parameters_with_their_uncertainties():
    sentence = found(THERMAL_HYSTERESIS, 5.25, sigma=[0.12], within=[(5.02, 5.5)]).statement
    assert sentence.startswith("The bias depends on whether a temperature was reached from above or below")
    assert sentence.endswith(
        "0.0123 ± 0.0004 deg/h rms on the x, y and z gyros (half width 5.25 ± 0.12 degC)."
    )


def test_a_time_constant_of_an_hour_or_more_is_stated_in_hours():
    hours = found(WARM_UP, 5400.0, sigma=[720.0], within=[(3960.0, 6840.0)])
    assert hours.statement.endswith("(tau 1.50 ± 0.20 h).")
    seconds = found(WARM_UP, 900.0, sigma=[31.0], within=[(840.0, 960.0)])
    assert seconds.statement.endswith("(tau 900 ± 31 s).")


def test_an_interval_that_is_not_symmetric_is_stated_with_its_ends():
    sentence = found(WARM_UP, 5400.0, sigma=[1800.0], within=[(3600.0, 10_800.0)]).statement
    assert sentence.endswith("(tau 1.5 h, 1.0 to 3.0 h with 95 %).")


def test_a_parameter_at_its_bound_is_named_with_what_is_known_of_it():
    highest = found(THERMAL_HYSTERESIS, 40.0, sigma=[4.0], within=[(33.0, 40.0)])
    assert highest.at_bound == ("half_width_c",)
    assert highest.statement.endswith("(half width 40 degC, its upper bound, above 33 degC with 95 %).")
    lowest = found(THERMAL_HYSTERESIS, 0.3, sigma=[0.2], within=[(0.3, 0.9)])
    assert lowest.at_bound == ("half_width_c",)
    assert "0.30 degC, its lower bound, below 0.90 degC with 95 %" in lowest.statement
    assert found(WARM_UP, 7200.0, sigma=[60.0], within=[(7080.0, 7320.0)]).at_bound == ()


def test_another_form_that_is_not_improbable_is_stated_with_its_parameters():
    many_widths = replace(whole(THERMAL_HYSTERESIS, 4.5), form=THERMAL_HYSTERESIS.forms[1])
    other = OtherForm(many_widths, 0.34, np.array([0.25]), ((4.0, 5.0),), 0.0002, 43)
    sentence = found(
        THERMAL_HYSTERESIS, 5.25, sigma=[0.12], within=[(5.02, 5.5)], other_forms=(other,)
    ).statement
    assert sentence.endswith(
        "(one width with P = 0.66: half width 5.25 ± 0.12 degC; or, with P = 0.34, many widths: half width "
        "4.50 ± 0.25 degC)."
    )


def test_several_parameters_are_listed():
    sentence = found(
        attitude_thermal.EFFECT, 45.0, 3.25, sigma=[0.4, 0.6], within=[(44.2, 45.8), (2.1, 4.4)]
    ).statement
    assert sentence.endswith("(onset 45.0 ± 0.4 degC; onset width 3.2 ± 0.6 degC).")


def test_a_statement_about_one_gyro_and_no_parameter():
    sentence = found(G_SENSITIVITY, axes=("y",)).statement
    assert sentence.endswith("0.0123 ± 0.0004 deg/h rms on the y gyro.")


def test_a_statement_about_two_gyros():
    assert "on the x and z gyros" in found(G_SENSITIVITY, axes=("x", "z")).statement


def test_a_tie_asks_for_the_measurement_that_resolves_it(closed):
    closure = closed({"temperature_rate": 1.0}, profile=TRIANGLE, cycles=2)
    [tied] = closure.effects
    sentence = closure.separating_measurement
    names = [closure.label(name) for name in (tied.effect.name, tied.tied_with[0])]
    assert sentence.startswith(f"To distinguish {names[0]} from {names[1]}: ")
    assert tied.candidate.effect.experiment in sentence


def test_without_a_tie_no_further_measurement_is_needed(closed):
    assert closed({"g_sensitivity": 4.0}).separating_measurement is None
    assert closed().separating_measurement is None


def test_an_unexplained_residual_is_stated_with_size_and_place(closed):
    closure = closed({"sinusoid": 1.5}, seed=1)
    sentence = closure.unexplained_part
    rest = (closure.campaign.bias_dph - closure.model.bias_dph)[closure.searched]
    assert f"The residual is {np.sqrt(np.mean(rest**2)):.2g} deg/h rms" in sentence
    assert f"{closure.after.noise_ratio:.1f} times the noise" in sentence
    assert closure.after.follows in sentence


def test_a_residual_in_one_position_is_located_there(closed):
    def only_z_up(course):
        return (course.up[:, 2] > 0.5)[:, None] * np.sin(course.time_h * 7.0)[:, None]

    campaign = campaign_of(measure({only_z_up: 4.0}, cycles=2).rows)
    assert "position z up," in close_loop(campaign, effects=[]).unexplained_part


@pytest.mark.parametrize("effects", [None, {"g_sensitivity": 4.0}], ids=["clean", "explained"])
def test_without_a_lack_of_fit_no_part_is_unexplained(closed, effects):
    closure = closed(effects)
    assert closure.unexplained_part is None
    assert closure.noise_dph == pytest.approx(SIGMA_DPH)
