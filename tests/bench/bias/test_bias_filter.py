from dataclasses import replace
from functools import cache
from itertools import pairwise

import numpy as np
import pytest

from gyrobench.bench.bias.bias_filter import BiasFilter, estimate_state_space
from gyrobench.bench.bias.dwell import RestOutput
from gyrobench.bench.bias.noise_model import NoiseModel
from gyrobench.bench.bias.parameters import ErrorModel, PriorKnowledge
from gyrobench.bench.foundations.errors import MeasurementError
from gyrobench.bench.navigation.attitude import UP, angle_between, rotation_matrix
from gyrobench.bench.navigation.positions import POSITIONS
from tests.bench.bias import disturbances
from tests.bench.bias.emulated_dwells import CLEAN, LATITUDE_DEG, UG, emulate, noise_model, sensors, site

NOISE = noise_model(0.0006)
#: With a surveyed latitude.
DEFAULT = PriorKnowledge.from_datasheet(latitude_arcmin=0.02)
FOLLOWING = replace(DEFAULT, accelerometer_slope=2.0 * UG)
BIAS_DPH, ACCELEROMETER_UG = np.array([0.05, -0.05, 0.05]), np.array([100.0, -100.0, -100.0])
#: A fifth of what a rotational INS of 1 nmi in 24 h bears.
EXACT_DPH = 2e-4


def estimate(dwell, prior=DEFAULT, noise=NOISE, latitude_deg=LATITUDE_DEG):
    return estimate_state_space(dwell, ErrorModel(site(latitude_deg), noise, prior))


@cache
def quiet():
    """A dwell without noise."""
    return emulate(ins=sensors(BIAS_DPH, ACCELEROMETER_UG))


def error_dph(dwell, bias_dph=BIAS_DPH, **known):
    return estimate(dwell, **known).bias_dph - bias_dph


@pytest.mark.parametrize(
    ("position", "latitude_deg"),
    [*((position, -60.0) for position in POSITIONS), ("z_down", -0.5), ("x_up", 60.0), ("y_down", 60.0)],
)
def test_without_noise_the_bias_is_exact(position, latitude_deg):
    ins = sensors(BIAS_DPH, ACCELEROMETER_UG)
    dwell = emulate(position, ins, latitude_deg=latitude_deg, outer_level=True)
    assert np.abs(error_dph(dwell, latitude_deg=latitude_deg)).max() < EXACT_DPH


@pytest.mark.parametrize("window_s", [60.0, 300.0, 1200.0])
def test_the_bias_is_exact_in_short_and_long_windows(window_s):
    for signs in ([1, 1, 1], [1, -1, 1]):
        bias_dph, accelerometer_ug = 0.05 * np.array(signs), -100.0 * np.array(signs)
        dwell = emulate("x_down", sensors(bias_dph, accelerometer_ug), window_s=window_s)
        assert np.abs(error_dph(dwell, bias_dph)).max() < EXACT_DPH


@pytest.mark.parametrize("position", ["z_up", "y_down"])
def test_the_bias_is_exact_after_a_slow_turn(position):
    """Even though the table's word is of the way alone, and not of when it was where."""
    for bias_dph in (BIAS_DPH, -BIAS_DPH):
        dwell = emulate(position, sensors(bias_dph, ACCELEROMETER_UG), turn_s=300.0, outer_level=True)
        assert np.abs(error_dph(dwell, bias_dph)).max() < EXACT_DPH


@pytest.mark.parametrize("position", ["z_up", "y_down", "x_up"])
def test_the_bias_is_exact_with_another_mechanisation(dwell_of, position):
    dwell = dwell_of(
        position=position, gyro_bias_dph=tuple(BIAS_DPH), accelerometer_bias_mps2=tuple(ACCELEROMETER_UG * UG)
    )
    assert np.abs(error_dph(dwell)).max() < EXACT_DPH


def test_finds_the_level_accelerometers_and_leaves_the_vertical_one_to_the_prior():
    found = estimate(emulate("y_up", sensors(BIAS_DPH, ACCELEROMETER_UG)))
    level = [0, 2]
    np.testing.assert_allclose(found.accelerometer_bias[level] / UG, ACCELEROMETER_UG[level], atol=1.0)
    assert found.accelerometer_sigma[level].max() < 20.0 * UG
    assert found.accelerometer_sigma[1] == pytest.approx(DEFAULT.accelerometer_bias, rel=1e-4)


def test_the_accelerometer_error_of_a_misaligned_gyro_is_common_to_the_dwells_of_an_attitude():
    arcsec = np.pi / 180.0 / 3600.0
    x_to_z = 2.0 * arcsec * np.outer([1.0, 0.0, 0.0], [0.0, 0.0, 1.0])
    errors_ug = [
        estimate(emulate(position, sensors(gyro_matrix=x_to_z))).accelerometer_bias[0] / UG
        for position in ("z_up", "z_down")
    ]
    found = estimate(emulate("z_up", sensors()))
    assert errors_ug == pytest.approx([-9.7, 9.7], abs=0.1)
    assert found.accelerometer_common_sigma[:2] / UG == pytest.approx([9.7, 9.7], rel=0.02)
    assert (found.accelerometer_common_sigma < found.accelerometer_sigma).all()


@pytest.mark.parametrize("position", ["z_down", "y_up", "x_down"])
def test_a_bias_that_turns_the_heading_by_degrees_leaves_the_others_alone(position):
    """0.5 deg/h East turns a gyrocompass by 2 deg, and takes 0.01 deg/h from the Earth's rate in its axes."""
    bias_dph = np.array([0.5, -0.5, 0.5])
    found = estimate(emulate(position, sensors(bias_dph, ACCELEROMETER_UG), noise=NOISE, outer_level=True))
    assert np.abs((found.bias_dph - bias_dph) / found.sigma_dph).max() < 0.9
    assert found.fit.ratio < 0.25


@pytest.mark.parametrize("heading_deg", [0.05, 0.5, -1.0])
def test_an_ins_that_started_with_a_wrong_heading_does_not_matter(heading_deg):
    change = disturbances.heading_error("z_up", heading_deg)
    dwell, usual = (
        emulate(ins=sensors(BIAS_DPH, ACCELEROMETER_UG, gyro_bias_change=each)) for each in (change, None)
    )
    started = angle_between(dwell.windows[0].C_nb[0], usual.windows[0].C_nb[0])
    assert started == pytest.approx(np.radians(abs(heading_deg)), rel=0.02)
    assert np.abs(error_dph(dwell)).max() < EXACT_DPH


@pytest.mark.parametrize(
    "stops_deg", [(30.0, 210.0), (0.0, -180.0), (0.0, 120.0), (0.0, 180.0, 0.0), (0.0, 90.0, 180.0, 270.0)]
)
def test_the_bias_is_exact_with_any_azimuths_and_turns(stops_deg):
    dwell = emulate("z_down", sensors(BIAS_DPH, ACCELEROMETER_UG), stops_deg=stops_deg)
    assert np.abs(error_dph(dwell)).max() < EXACT_DPH


def epochs(rest, part):
    """Some epochs of an output at rest."""
    temperatures = (None if each is None else each[part] for each in (rest.gyro_c, rest.accelerometer_c))
    return RestOutput(rest.time_s[part], rest.velocity_enu_mps[part], rest.C_nb[part], *temperatures)


def feed(dwell, sizes, noise=NOISE):
    """A filter that got the epochs of a dwell in chunks of these sizes, again and again."""
    bias_filter = BiasFilter(ErrorModel(site(), noise, DEFAULT))
    for number, window in enumerate(dwell.windows):
        bias_filter.begin_window(
            window.time_s[0], window.C_nb[0], dwell.turns[number - 1] if number else None
        )
        edges = [0, *np.cumsum(sizes * len(window.time_s))]
        for a, b in pairwise(edge for edge in edges if edge < len(window.time_s) + max(sizes)):
            bias_filter.add(epochs(window, slice(a, b)))
    return bias_filter


@pytest.mark.parametrize(("epoch_s", "sizes"), [(1.0, [1]), (1.0, [7, 100]), (0.1, [10]), (0.1, [7, 1, 33])])
def test_epochs_in_any_chunks_give_the_same_estimate(epoch_s, sizes):
    dwell = emulate(
        "y_up", sensors(BIAS_DPH, ACCELEROMETER_UG, NOISE), noise=NOISE, random=np.random.default_rng(23),
        epoch_s=epoch_s, window_s=120.0, gyro_c=lambda time_s: np.multiply.outer(0.01 * time_s, np.ones(3)),
    )  # fmt: skip
    whole, chunks = estimate(dwell), feed(dwell, sizes).estimate()
    np.testing.assert_allclose(chunks.bias_dph, whole.bias_dph, rtol=0, atol=1e-8)
    np.testing.assert_allclose(chunks.sigma_dph, whole.sigma_dph, rtol=1e-9)
    assert chunks.fit.chi2 == pytest.approx(whole.fit.chi2, rel=1e-6)


def test_uncertainty_falls_while_the_dwell_goes_on():
    dwell = emulate(ins=sensors(BIAS_DPH), noise=NOISE)
    bias_filter = feed(
        replace(dwell, windows=dwell.windows[:1], C_nb_table=dwell.C_nb_table[:1], turns=()), [601]
    )
    after = dwell.windows[1]
    bias_filter.begin_window(after.time_s[0], after.C_nb[0], dwell.turns[0])
    sigmas = []
    for part in np.split(np.arange(len(after.time_s)), [2, 60, 180, 300, 450]):
        bias_filter.add(epochs(after, part))
        sigmas.append(bias_filter.estimate().sigma_dph)
    assert np.all(np.diff(sigmas, axis=0) < 0.0)
    np.testing.assert_allclose(sigmas[-1], estimate(dwell).sigma_dph, rtol=1e-9)


def test_the_clock_of_the_ins_may_start_anywhere():
    dwell = quiet()
    later = replace(
        dwell,
        windows=tuple(replace(w, time_s=w.time_s + 1e9) for w in dwell.windows),
        turns=tuple(replace(turn, time_s=turn.time_s + 1e9) for turn in dwell.turns),
    )
    np.testing.assert_allclose(estimate(later).bias_dph, estimate(dwell).bias_dph, rtol=0, atol=1e-7)


def test_times_that_are_a_little_uneven_leave_no_epoch_out():
    dwell, random = emulate(ins=sensors(BIAS_DPH)), np.random.default_rng(25)
    jittered = replace(
        dwell,
        windows=tuple(replace(w, time_s=w.time_s + random.uniform(0.0, 5e-4, 601)) for w in dwell.windows),
    )
    np.testing.assert_allclose(estimate(jittered).sigma_dph, estimate(dwell).sigma_dph, rtol=1e-6)


def test_missing_and_uneven_epochs_cost_little_and_bias_nothing():
    dwell, random = emulate(ins=sensors(BIAS_DPH, ACCELEROMETER_UG), epoch_s=0.1), np.random.default_rng(24)
    windows = []
    for w in dwell.windows:
        # One epoch somewhere in each second, or none.
        kept = np.append(0, 10 * np.arange(600) + random.integers(1, 10, 600))
        kept = kept[random.random(601) < 0.9]
        windows.append(
            replace(w, time_s=w.time_s[kept], velocity_enu_mps=w.velocity_enu_mps[kept], C_nb=w.C_nb[kept])
        )
    uneven = replace(dwell, windows=tuple(windows))
    assert np.abs(error_dph(uneven)).max() < EXACT_DPH
    np.testing.assert_allclose(estimate(uneven).sigma_dph, estimate(dwell).sigma_dph, rtol=0.02)


@pytest.mark.parametrize("arw", [1e-5, 1e-3, 1e-1])
@pytest.mark.parametrize("white", [(0.0, 0.0), (1e-9, 1e-12), (0.01, 1e-4)])
def test_any_noise_can_be_declared(arw, white):
    noise = replace(NoiseModel.from_datasheet(arw, 5.0), velocity_white=white[0], heading_white=white[1])
    found = estimate(quiet(), noise=noise)
    assert np.abs(found.bias_dph - BIAS_DPH).max() < EXACT_DPH + 0.01 * found.sigma_dph.max()
    assert found.sigma_dph.min() > 0.99 * np.sqrt(3.0) * arw
    assert found.fit.p_value > 0.9


def test_refuses_a_dwell_without_a_turn():
    dwell = emulate(window_s=60.0)
    one = replace(dwell, windows=dwell.windows[:1], C_nb_table=dwell.C_nb_table[:1], turns=())
    with pytest.raises(MeasurementError, match="no navigation after a turn: the biases are not observable"):
        estimate(one)


def test_refuses_an_estimate_before_there_is_navigation_after_the_turn():
    dwell = emulate(window_s=60.0)
    bias_filter = BiasFilter(ErrorModel(site(), NOISE, DEFAULT))
    with pytest.raises(MeasurementError, match="no navigation after a turn"):
        bias_filter.estimate()
    before, after = dwell.windows
    bias_filter.begin_window(before.time_s[0], before.C_nb[0])
    bias_filter.add(before)
    with pytest.raises(MeasurementError, match="a window after the first one needs the turn"):
        bias_filter.begin_window(after.time_s[0], after.C_nb[0])
    bias_filter.begin_window(after.time_s[0], after.C_nb[0], dwell.turns[0])
    with pytest.raises(MeasurementError, match="no navigation after a turn"):
        bias_filter.estimate()


def test_a_turn_that_determines_nothing_leaves_the_level_gyros_unknown():
    """Back to where it started: only the prior parts biases from initial errors, and it says so."""
    table = [rotation_matrix(UP, 0.0)] * 2
    dwell = replace(emulate(ins=sensors(BIAS_DPH), stops_deg=(0.0, 0.0)), C_nb_table=tuple(table))
    found = estimate(dwell)
    assert found.sigma_dph[0] > 0.5
    assert np.all(np.abs(found.bias_dph - BIAS_DPH) < 3.0 * found.sigma_dph)


@pytest.mark.parametrize("settle_s", [60.0, 600.0])
def test_a_long_rest_after_the_turn_changes_nothing(settle_s):
    truth = sensors(bias_dph=(0.05, 0.05, 0.05))
    dwell = emulate("z_up", truth, settle_s=settle_s)
    estimate = estimate_state_space(dwell, ErrorModel(site(), NOISE, CLEAN))
    assert np.abs(estimate.bias_dph - 0.05).max() < 2e-4
    level = np.abs(estimate.accelerometer_bias[:2])
    assert np.all(level < 0.5 * estimate.accelerometer_sigma[:2])


def course_k(time_s):
    """A ramp that the unit follows with a lag."""
    return 60.0 * (time_s / 3600.0 - (1.0 - np.exp(-time_s / 500.0)) / 7.2)


def on_a_ramp(position, slopes, **scenario):
    """Without noise; the case changes as :func:`course_k`, and the gyros differently."""
    ins = sensors(BIAS_DPH, accelerometer_bias_change=lambda time_s: np.outer(course_k(time_s), slopes))
    dwell = emulate(position, ins, outer_level=True, **scenario)
    windows = [
        replace(
            each,
            accelerometer_c=20.0 + course_k(each.time_s),
            gyro_c=25.0 + np.outer(each.time_s, [1, 2, 3]) / 900.0,
        )
        for each in dwell.windows
    ]
    return replace(dwell, windows=tuple(windows))


@pytest.mark.parametrize("position", ["z_up", "y_down", "x_up"])
def test_accelerometers_that_follow_the_temperature_act_as_their_part_of_the_uncertainty_does(position):
    for slopes_ug_per_k in np.diag([2.0, 1.0, -2.0]):
        dwell = on_a_ramp(position, slopes_ug_per_k * UG)
        found = estimate(dwell, FOLLOWING)
        part = found.parts["accelerometer_slope"]
        expected_radps = -part.columns @ (slopes_ug_per_k * UG / part.sigma)
        off_dph = found.bias_dph - BIAS_DPH
        assert off_dph == pytest.approx(np.degrees(expected_radps) * 3600.0, abs=EXACT_DPH)
        assert found.fit.p_value > 0.1
        size_ug_per_k = np.abs(np.delete(slopes_ug_per_k, POSITIONS[position].up_axis)).max()
        ignored_dph = error_dph(dwell)
        assert np.abs(ignored_dph).max() == pytest.approx(0.00217 * size_ug_per_k, abs=EXACT_DPH)
        # The accelerations before and after the turn show part of the slope.
        assert np.abs(off_dph).max() < 0.7 * np.abs(ignored_dph).max() + EXACT_DPH


def test_the_accelerometer_biases_are_those_at_the_mean_temperature():
    dwell = on_a_ramp("z_up", np.array([2.0, -2.0, 0.0]) * UG)
    mean_k = course_k(np.concatenate([each.time_s for each in dwell.windows])).mean()
    found = estimate(dwell, FOLLOWING).accelerometer_bias / UG
    assert found[:2] == pytest.approx(np.array([2.0, -2.0]) * mean_k, abs=1.0)


def test_at_constant_temperature_their_slope_changes_nothing():
    dwell = emulate(ins=sensors(BIAS_DPH), gyro_c=lambda time_s: np.full((len(time_s), 3), 30.0))
    found = [estimate(dwell, replace(DEFAULT, accelerometer_slope=slope)) for slope in (0.0, 1e-4)]
    assert found[0].bias_radps.tolist() == found[1].bias_radps.tolist()
    assert found[0].covariance.tolist() == found[1].covariance.tolist()
