import numpy as np
import pytest

from gyrobench.bench.closure.campaign import campaign_of
from gyrobench.bench.closure.effects import attitude_thermal, g_sensitivity, thermal_hysteresis, warm_up
from gyrobench.bench.closure.loop import FoundEffect, close_loop
from tests.bench.closure.test_candidates import whole
from tests.bench.closure.thermal_bench import SIGMA_DPH, measure

TRIANGLE = ((-20.0, 0.2, 0.0), (60.0, 0.2, 0.0), (20.0, 0.2, 0.0))


def found(module, *values, axes=("x", "y", "z")):
    candidate = whole(module.EFFECT, *values)
    return FoundEffect(candidate, np.zeros(candidate.kept.shape), axes, 1e-9, 41, 0.01234, {}, (), 0.999)


def test_a_statement_has_size_gyros_and_parameters():
    sentence = found(thermal_hysteresis, 5.25).statement
    assert sentence.startswith("The bias depends on whether a temperature was reached from above or below")
    assert sentence.endswith("0.012 deg/h rms on the x, y and z gyros (half width 5.25 degC).")


def test_a_time_constant_of_an_hour_or_more_is_stated_in_hours():
    assert found(warm_up, 5400.0).statement.endswith("(tau 1.50 h).")
    assert found(warm_up, 900.0).statement.endswith("(tau 900 s).")


def test_several_parameters_are_listed():
    sentence = found(attitude_thermal, 45.0, 3.25).statement
    assert sentence.endswith("(onset 45 degC, onset width 3.25 degC).")


def test_a_statement_about_one_gyro_and_no_parameter():
    sentence = found(g_sensitivity, axes=("y",)).statement
    assert sentence.endswith("0.012 deg/h rms on the y gyro.")


def test_a_statement_about_two_gyros():
    assert "on the x and z gyros" in found(g_sensitivity, axes=("x", "z")).statement


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
