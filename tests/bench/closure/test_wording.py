import numpy as np
import pytest

from gyrobench.bench.closure.campaign import campaign_of
from gyrobench.bench.closure.effects import attitude_thermal, g_sensitivity, thermal_hysteresis, warm_up
from gyrobench.bench.closure.loop import (
    FoundEffect,
    close_loop,
    separating_measurement,
    statement,
    whereabouts,
)
from tests.bench.closure.test_candidate import whole
from tests.bench.closure.thermal_bench import SIGMA_DPH, measure

TRIANGLE = ((-20.0, 0.2, 0.0), (60.0, 0.2, 0.0), (20.0, 0.2, 0.0))


def found(module, *values, axes=("x", "y", "z")):
    candidate = whole(module.EFFECT, *values)
    return FoundEffect(candidate, np.zeros(candidate.kept.shape), axes, 1e-9, 0.01234, {}, ())


def test_a_statement_says_what_how_much_on_which_gyros_and_with_which_parameters():
    sentence = statement(found(thermal_hysteresis, 5.25))
    assert sentence.startswith("The bias depends on the way that the temperature came")
    assert sentence.endswith("0.012 deg/h rms on the x, y and z gyros (half width 5.25 degC).")


def test_a_time_constant_of_an_hour_or_more_is_told_in_hours():
    assert statement(found(warm_up, 5400.0)).endswith("(tau 1.50 h).")
    assert statement(found(warm_up, 900.0)).endswith("(tau 900 s).")


def test_several_parameters_are_told_one_after_the_other():
    sentence = statement(found(attitude_thermal, 45.0, 3.25))
    assert sentence.endswith("(onset 45 degC, onset width 3.25 degC).")


def test_a_statement_about_one_gyro_and_no_parameter():
    sentence = statement(found(g_sensitivity, axes=("y",)))
    assert sentence.endswith("0.012 deg/h rms on the y gyro.")


def test_a_statement_about_two_gyros():
    assert "on the x and z gyros" in statement(found(g_sensitivity, axes=("x", "z")))


def test_a_tie_asks_for_the_measurement_that_splits_it(closed):
    closure = closed({"temperature_rate": 1.0}, profile=TRIANGLE, cycles=2)
    [tied] = closure.effects
    sentence = separating_measurement(closure)
    names = [name.replace("_", " ") for name in (tied.candidate.effect.name, tied.tied_with[0])]
    assert sentence.startswith(f"To tell {names[0]} from {names[1]}: ")
    assert tied.candidate.effect.experiment in sentence


def test_without_a_tie_nothing_more_is_to_be_measured(closed):
    assert separating_measurement(closed({"g_sensitivity": 4.0})) is None
    assert separating_measurement(closed()) is None


def test_what_is_left_is_told_with_its_size_and_place(closed):
    closure = closed({"sinusoid": 1.5}, seed=1)
    sentence = whereabouts(closure)
    rest = (closure.campaign.bias_dph - closure.model.bias_dph)[closure.searched]
    assert f"{np.sqrt(np.mean(rest**2)):.2g} deg/h rms is left" in sentence
    assert f"{closure.after.noise_ratio:.1f} times the noise" in sentence
    assert closure.after.follows in sentence


def test_what_is_left_in_one_position_is_found_there(closed):
    def only_z_up(course):
        return (course.up[:, 2] > 0.5)[:, None] * np.sin(course.time_h * 7.0)[:, None]

    campaign = campaign_of(measure({only_z_up: 4.0}, cycles=2).rows)
    assert "position z up," in whereabouts(close_loop(campaign, effects=[]))


@pytest.mark.parametrize("effects", [None, {"g_sensitivity": 4.0}], ids=["clean", "explained"])
def test_nothing_is_left_to_tell_of(closed, effects):
    closure = closed(effects)
    assert whereabouts(closure) is None
    assert closure.noise_dph == pytest.approx(SIGMA_DPH)
