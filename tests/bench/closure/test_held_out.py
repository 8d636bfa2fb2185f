"""Held-out dwells that differ from the model or confirm it: no wrong verdict, and few false alarms."""

import json
from dataclasses import replace

import numpy as np
import pytest

from gyrobench.bench.closure.campaign import campaign_of
from gyrobench.bench.closure.effects.laws import BIAS_JUMP, G_SENSITIVITY, TEMPERATURE_RATE, TIME_DRIFT
from gyrobench.bench.closure.files import closure_document
from gyrobench.bench.closure.held_out import is_confirmed
from gyrobench.bench.closure.loop import close_loop, composed
from gyrobench.bench.report.closure_page import closure_sections
from gyrobench.bench.report.closure_text import (
    held_out_error_sentence,
    remaining_residual_sentence,
    verdict_sentence,
)
from tests.bench.closure.thermal_bench import SIGMA_DPH, measure
from tests.benchmarks.closure_units import make_unit


def held_out_rows(rows):
    return [row for row in rows if row.cycle == rows[-1].cycle]


def shifted(rows, dwells, sigmas, axes="x"):
    """The same rows with the biases of some dwells and gyros off."""
    off = np.array([axis in axes for axis in "xyz"]) * sigmas * SIGMA_DPH
    return [
        replace(row, bias_dph=tuple((np.array(row.bias_dph) + off).tolist())) if row.dwell in dwells else row
        for row in rows
    ]


def jumped(rows, share, sigmas, axes="x"):
    """The same rows with a jump after this share of the held-out cycle."""
    last = held_out_rows(rows)
    return shifted(rows, {row.dwell for row in last[round(share * len(last)) :]}, sigmas, axes)


def closed(rows, effects=()):
    return close_loop(campaign_of(rows), effects=effects)


@pytest.mark.parametrize(
    ("share", "sigmas", "each_cycle"),
    [(0.0, 1.5, False), (0.5, 3.0, False), (0.8, 25.0, False), (0.5, 5.0, True), (0.8, 25.0, True)],
)
def test_a_jump_in_the_held_out_cycle_is_unexplained_and_its_gyro_is_named(share, sigmas, each_cycle):
    rows = measure(cycles=2, power_on_each_cycle=each_cycle).rows
    assert closed(rows).verdict == "clean"
    closure = closed(jumped(rows, share, sigmas))
    assert (closure.verdict, closure.held_out_axes) == ("unexplained", ["x"])
    assert verdict_sentence(closure).startswith(
        "The residual in the dwells searched is noise, but the x gyro differs from the prediction in the "
        "held-out dwells, by "
    )
    assert "do not explain the errors of the x gyro (p " in held_out_error_sentence(closure)


@pytest.mark.parametrize("seed", [6, 7])
def test_a_step_of_three_sigma_in_the_last_tenth_of_the_held_out_cycle_is_unexplained(seed):
    closure = closed(jumped(measure(cycles=2, seed=seed).rows, 0.9, 3.0))
    assert (closure.verdict, closure.held_out_axes) == ("unexplained", ["x"])


def test_of_two_cycles_another_one_is_to_be_measured_and_of_three_another_one_held_out():
    of_two, of_three = (closed(jumped(measure(cycles=cycles).rows, 0.5, 9.0, "yz")) for cycles in (2, 3))
    assert "the y and z gyros differ from the prediction" in verdict_sentence(of_two)
    assert verdict_sentence(of_two).endswith(
        "Measure another cycle and hold that one out, so that these dwells are searched."
    )
    assert verdict_sentence(of_three).endswith("so that these dwells are searched: --hold-out-cycle 1.")


def test_with_another_cycle_held_out_as_advised_the_jump_is_found():
    campaign = campaign_of(jumped(measure(cycles=3).rows, 0.5, 9.0))
    candidates = [BIAS_JUMP, TIME_DRIFT, TEMPERATURE_RATE]
    assert close_loop(campaign, effects=candidates).held_out_axes == ["x"]
    closure = close_loop(campaign, [1], effects=candidates)
    assert closure.names == ("bias_jump",)
    assert closure.held_out_axes == []


def test_the_page_states_size_and_place_of_the_difference_and_that_the_rest_is_noise():
    closure = closed(jumped(measure(cycles=2).rows, 0.6, 9.0))
    assert closure.differs_held_out
    assert "The residual of the x gyro in the held-out dwells is 0.01" in closure.unexplained_part
    assert remaining_residual_sentence(closure).startswith("The remaining residual in the dwells searched is")
    [section] = [each for each in closure_sections(closure) if each.title == "Held-out error"]
    assert closure.unexplained_part in section.paragraphs
    document = json.loads(json.dumps(closure_document(closure)))
    assert document["held_out_p"]["x"] < 1e-9
    assert min(document["held_out_p"][axis] for axis in "yz") > 0.01
    assert document["left_over"] == closure.unexplained_part


def test_no_law_is_composed_for_a_difference_in_dwells_that_were_not_searched():
    closure = closed(jumped(measure(cycles=2).rows, 0.6, 9.0))
    assert composed(closure) is closure


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_a_bias_that_follows_the_attitude_in_the_held_out_cycle_alone_is_unexplained(seed):
    rows = measure(cycles=2, seed=seed).rows
    up, down = (
        {row.dwell for row in held_out_rows(rows) if row.position == f"y_{end}"} for end in ("up", "down")
    )
    closure = closed(shifted(shifted(rows, up, 2.0, "y"), down, -2.0, "y"))
    assert (closure.verdict, closure.held_out_axes) == ("unexplained", ["y"])


@pytest.mark.parametrize(("share", "sigmas"), [(0.5, 3.0), (0.8, 25.0)])
def test_an_effect_is_not_explained_where_the_held_out_cycle_jumps(share, sigmas):
    candidates = [TEMPERATURE_RATE, G_SENSITIVITY, TIME_DRIFT]
    rows = measure({"temperature_rate": 5.0}).rows
    assert closed(rows, candidates).verdict == "explained"
    closure = closed(jumped(rows, share, sigmas), candidates)
    assert (closure.verdict, closure.names) == ("ambiguous", ("temperature_rate",))
    assert "is not sufficient: the x gyro differs from the prediction" in verdict_sentence(closure)


def test_a_new_power_cycle_has_its_own_constant():
    rows = measure(cycles=2, power_on_each_cycle=True).rows
    assert closed(jumped(rows, 0.0, 1000.0)).verdict == "clean"


@pytest.mark.parametrize("each_cycle", [False, True])
def test_a_held_out_dwell_that_is_far_off_is_an_outlier_and_no_difference(each_cycle):
    rows = measure(cycles=2, power_on_each_cycle=each_cycle).rows
    dwell = held_out_rows(rows)[7].dwell
    closure = closed(shifted(rows, {dwell}, 40.0, "xz"))
    assert closure.verdict == "clean"
    assert [(each.dwell, each.gyro) for each in closure.held_out.outliers] == [(dwell, "x"), (dwell, "z")]
    assert "Noise and this uncertainty explain the others" in held_out_error_sentence(closure)


@pytest.mark.parametrize("places", [(7, 8, 9), (3, 7, 11, 15, 20, 26, 31)], ids=["in a row", "many"])
def test_held_out_dwells_that_are_off_in_a_row_or_in_large_number_are_no_outliers(places):
    rows = measure(cycles=2).rows
    last = held_out_rows(rows)
    closure = closed(shifted(rows, {last[place].dwell for place in places}, 15.0))
    assert closure.held_out.outliers == ()
    assert (closure.verdict, closure.held_out_axes) == ("unexplained", ["x"])


def test_without_held_out_dwells_nothing_is_tested():
    closure = closed(measure(cycles=1).rows)
    assert closure.searched.all()
    assert closure.held_out.p_values == (1.0, 1.0, 1.0)


def p_values(count, **options):
    return np.array([closed(measure(seed=seed, **options).rows).held_out.p_value for seed in range(count)])


CLEAN = (
    {"cycles": 2},
    {"cycles": 2, "power_on_each_cycle": True},
    {"cycles": 3, "power_on_each_cycle": True},
    {"cycles": 3, "noise": 1.4},
    {"cycles": 3, "noise": 0.6},
)


@pytest.mark.parametrize("count", [2, pytest.param(4, marks=pytest.mark.long)])
@pytest.mark.parametrize("options", CLEAN, ids=str)
def test_clean_tables_do_not_differ_from_the_prediction(options, count):
    assert p_values(count, **options).min() > 1e-3


@pytest.mark.long
@pytest.mark.parametrize("options", CLEAN, ids=str)
def test_p_values_of_clean_tables_are_at_most_as_often_small_as_they_state(options):
    found = p_values(100, **options)
    assert np.mean(found < 0.05) <= 0.1
    assert np.mean(found < 0.01) <= 0.04
    assert found.min() > 1e-4


@pytest.mark.long
def test_clean_units_with_outliers_and_understated_noise_do_not_differ_from_the_prediction():
    noises = ("stated", "understated", "outliers", "understated, outliers")
    found = [
        closed(make_unit(seed, noise=noises[seed % 4], cycles=2 + seed % 3)[0]).held_out.p_value
        for seed in range(120)
    ]
    assert np.sum(np.array(found) < 1e-3) <= 2


@pytest.mark.parametrize(
    ("held_out", "is_so"),
    [
        (lambda true, noise: true + noise, True),
        (lambda true, noise: true + noise + 30.0 * (np.arange(40) == 7)[:, None], True),
        (lambda true, noise: noise, False),
        (lambda true, noise: 40.0 * noise, False),
        (lambda true, noise: true + 5.0 * noise, False),
        (lambda true, noise: -true + noise, False),
        (lambda true, noise: true[::-1] + noise, False),
    ],
    ids=["as predicted", "an outlier", "absent", "garbage", "larger noise", "reversed", "in another order"],
)
def test_effects_are_confirmed_by_held_out_dwells_that_follow_them(held_out, is_so):
    random = np.random.default_rng(3)
    true = 2.0 * random.standard_normal((40, 3))
    measured = held_out(true, random.standard_normal((40, 3)))
    assert is_confirmed(measured, measured - true) == is_so


def test_an_effect_that_predicts_nothing_in_the_held_out_dwells_is_not_confirmed():
    measured = np.random.default_rng(3).standard_normal((40, 3))
    assert not is_confirmed(measured, measured)


def share_confirmed(predicted, size, *, outliers=0.0):
    """Share of 50 held-out cycles that confirm a prediction (n, 3) of this true size, or one per gyro."""
    random = np.random.default_rng(5)
    confirmed = 0
    for _ in range(50):
        noise = random.standard_normal(predicted.shape)
        noise += 30.0 * (random.random(predicted.shape) < outliers)
        measured = size * predicted + noise
        confirmed += is_confirmed(measured, measured - predicted)
    return confirmed / 50.0


def test_noise_that_gyros_share_confirms_no_effect_that_they_share():
    """With correlations of 0.8, a mean of three gyros has 1.6 times the standard deviation."""
    random, confirmed = np.random.default_rng(5), {1.0: 0, 2.28: 0}
    root = np.linalg.cholesky(np.full((3, 3), 0.8) + 0.2 * np.eye(3))
    for _ in range(400):
        shape = np.repeat(random.standard_normal((24, 1)), 3, axis=1)
        predicted = 4.0 * shape / np.linalg.norm(shape)
        noise = random.standard_normal((24, 3)) @ root.T
        for factor in confirmed:
            confirmed[factor] += is_confirmed(noise, noise - predicted, factor)
    assert confirmed[1.0] > 8
    assert confirmed[2.28] <= 2


@pytest.mark.parametrize(
    "sigmas",
    [2.0, 30.0, pytest.param(8.0, marks=pytest.mark.long), pytest.param(1000.0, marks=pytest.mark.long)],
)
@pytest.mark.parametrize("shown", ["by all gyros", "by one gyro", "in few dwells"])
def test_effects_of_any_size_are_refuted_if_absent_or_reversed_and_confirmed_beside_outliers(sigmas, shown):
    predicted = sigmas * np.random.default_rng(4).standard_normal((45, 3))
    if shown == "by one gyro":
        predicted[:, 1:] = 0.0
    elif shown == "in few dwells":
        predicted[12:] = 0.0
    assert share_confirmed(predicted, 0.0) < 0.01
    assert share_confirmed(predicted, -1.0) < 0.01
    assert share_confirmed(predicted, 3.0) < 0.01
    assert share_confirmed(predicted, 1.0) > 0.95
    assert share_confirmed(predicted, 1.0, outliers=0.02) > 0.95


def test_an_effect_that_one_of_three_gyros_refutes_is_not_confirmed():
    predicted = 4.0 * np.random.default_rng(4).standard_normal((45, 3))
    assert share_confirmed(predicted, np.array([1.0, 1.0, 0.0])) < 0.01
