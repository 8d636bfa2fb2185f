from pathlib import Path

import numpy as np
import pytest

from gyrobench.bench.bias.raw_rate import RateRecording, estimate_rate, up_down_pair
from gyrobench.bench.foundations.arrays import DEG_PER_SQRT_H_TO_SI, DPH_TO_RADPS, RADPS_TO_DPH
from gyrobench.bench.foundations.errors import MeasurementError
from gyrobench.bench.navigation.attitude import rotation_matrix
from gyrobench.bench.navigation.positions import POSITIONS
from gyrobench.drivers.emulators.world.sensor_errors import ARCSEC, sense
from gyrobench.drivers.emulators.world.strapdown import true_increments

EAST, NORTH, UP = np.eye(3)
LATITUDE = np.radians(51.0784)
STEP_S = 1.0 / 64.0
BIAS_DPH = np.array([0.3, -0.2, 0.1])
LN100 = Path(__file__).parents[4] / "shared" / "data" / "ln100"


def recorded(
    random,
    C_nb,
    *,
    arw=0.002,
    white_arcsec=0.0,
    pulse_arcsec=0.0,
    line_arcsec=0.0,
    duration_s=300.0,
    bias_dph=BIAS_DPH,
):
    """Recording of a ring laser IMU at rest, and the rate that its gyros feel, bias included."""
    count = round(duration_s / STEP_S)
    still = np.zeros(count + 1)
    rotation, velocity = true_increments(EAST, UP, C_nb, still, still, LATITUDE, 0.0, STEP_S)
    angle = white_arcsec * ARCSEC * random.normal(size=(count + 1, 3))
    turns = 0.31 * STEP_S * np.arange(count + 1)[:, np.newaxis] + random.random(3)
    angle += line_arcsec * ARCSEC * np.sin(2.0 * np.pi * turns)
    noise = arw * DEG_PER_SQRT_H_TO_SI * np.sqrt(STEP_S) * random.normal(size=(count, 3))
    noise += np.diff(angle, axis=0)
    pulse = pulse_arcsec * ARCSEC
    remainder = pulse * random.uniform(-0.5, 0.5, 3)
    sensed = sense(rotation, np.zeros((3, 3)), bias_dph * DPH_TO_RADPS, noise, STEP_S, pulse, remainder)
    time = 1000.0 + STEP_S * np.arange(1, count + 1)
    force = velocity / STEP_S + 0.005 * random.normal(size=(count, 3))
    return RateRecording(time, sensed / STEP_S, force), rotation[0] / STEP_S + bias_dph * DPH_TO_RADPS


def without_force(recording):
    return RateRecording(recording.time_s, recording.rate_radps)


NOISES = {
    "random walk": {"arw": 0.003},
    "white angle": {"arw": 0.002, "white_arcsec": 1.5},
    "mostly white angle": {"arw": 0.0005, "white_arcsec": 1.5},
    "pulses": {"arw": 0.002, "pulse_arcsec": 1.1},
    "line of the dither": {"arw": 0.001, "white_arcsec": 1.0, "line_arcsec": 1.5},
}


@pytest.mark.long
@pytest.mark.parametrize("name", NOISES)
def test_rate_lies_within_its_uncertainty_as_often_as_it_should(name):
    random = np.random.default_rng(1)
    pulls = []
    for _ in range(15):
        recording, truth = recorded(random, POSITIONS["x_up"].C_nb(), **NOISES[name])
        estimate = estimate_rate(recording)
        pulls.append((estimate.rate_radps - truth) / estimate.sigma_radps)
    pulls = np.array(pulls)
    assert abs(pulls.mean()) < 4.0 * pulls.std() / np.sqrt(pulls.size)
    # 68 and 95 % of 45, less three standard deviations; more where the random walk is not observable.
    assert np.mean(np.abs(pulls) < 1.0) > 0.47
    assert np.mean(np.abs(pulls) < 2.0) > 0.85


def test_uncertainty_is_no_larger_than_need_be_where_the_noise_can_be_reported():
    random = np.random.default_rng(2)
    sigmas = [estimate_rate(recorded(random, np.eye(3), arw=0.003)[0]).sigma_radps for _ in range(5)]
    least = 0.003 * DEG_PER_SQRT_H_TO_SI / np.sqrt(300.0)
    np.testing.assert_allclose(np.array(sigmas) / least, 1.0, atol=0.2)


def test_slope_beats_the_mean_rate_where_the_angle_is_noisy():
    random = np.random.default_rng(3)
    errors, of_means = [], []
    for _ in range(10):
        recording, truth = recorded(random, np.eye(3), arw=0.0005, white_arcsec=1.5)
        errors.append(estimate_rate(recording).rate_radps - truth)
        of_means.append(recording.rate_radps.mean(axis=0) - truth)
    assert np.std(errors) < 0.5 * np.std(of_means)


def test_up_and_down_separate_bias_and_earth_rate():
    random = np.random.default_rng(4)
    up, _ = recorded(random, POSITIONS["y_up"].C_nb(), white_arcsec=1.0)
    down, _ = recorded(random, POSITIONS["y_down"].C_nb(), white_arcsec=1.0)
    pair = up_down_pair(up, down, "y")
    assert abs(pair.bias_radps * RADPS_TO_DPH + 0.2) < 3.0 * pair.bias_sigma_radps * RADPS_TO_DPH < 0.04
    assert abs(pair.sigmas_from(LATITUDE)) < 3.0
    assert pair.sigmas_from(LATITUDE + 0.1) < -20.0
    latitude, sigma = pair.latitude_rad()
    assert abs(latitude - LATITUDE) < 3.0 * sigma < 0.01


def test_specific_force_takes_a_tilt_of_the_axis_out():
    random = np.random.default_rng(5)
    tilt = rotation_matrix(EAST, np.radians(1.0))
    up, _ = recorded(random, tilt @ POSITIONS["x_up"].C_nb())
    down, _ = recorded(random, tilt @ POSITIONS["x_down"].C_nb(), bias_dph=BIAS_DPH)
    known = up_down_pair(up, down, "x")
    unknown = up_down_pair(without_force(up), without_force(down), "x")
    assert abs(known.sigmas_from(LATITUDE)) < 3.0
    assert abs(unknown.sigmas_from(LATITUDE)) > 10.0


def test_axis_that_is_not_where_it_should_be_is_refused():
    random = np.random.default_rng(6)
    up, _ = recorded(random, POSITIONS["x_up"].C_nb(), duration_s=60.0)
    down, _ = recorded(random, POSITIONS["x_down"].C_nb(), duration_s=60.0)
    with pytest.raises(MeasurementError, match=r"x axis should point up.*180\.0 deg away"):
        up_down_pair(down, up, "x")
    with pytest.raises(MeasurementError, match=r"y axis should point up.*90\.0 deg away"):
        up_down_pair(up, down, "y")
    with pytest.raises(MeasurementError, match="no body axis 'up'"):
        up_down_pair(up, down, "up")


def test_more_than_the_earth_turns_has_no_latitude():
    random = np.random.default_rng(7)
    up, _ = recorded(random, POSITIONS["x_up"].C_nb(), duration_s=60.0)
    down, _ = recorded(random, POSITIONS["x_down"].C_nb(), duration_s=60.0)
    twice = [RateRecording(each.time_s, 2.0 * each.rate_radps) for each in (up, down)]
    with pytest.raises(MeasurementError, match="more than the Earth turns"):
        up_down_pair(*twice, "x").latitude_rad()


@pytest.fixture(scope="module")
def good():
    return recorded(np.random.default_rng(12), np.eye(3), duration_s=60.0)[0]


def changed(recording, **fields):
    return {**{name: np.array(value) for name, value in vars(recording).items()}, **fields}


def test_samples_that_are_not_numbers_are_refused(good):
    for name in ("rate_radps", "specific_force_mps2"):
        values = np.array(getattr(good, name))
        values[7, 1] = np.nan
        with pytest.raises(MeasurementError, match=r"is not a number in 1 samples, first at 1000\.125 s"):
            RateRecording(**changed(good, **{name: values}))
    time = np.array(good.time_s)
    time[3] = np.inf
    with pytest.raises(MeasurementError, match="time of a sample is not a number"):
        RateRecording(**changed(good, time_s=time))


def test_gaps_and_times_that_go_back_are_refused(good):
    keep = np.arange(len(good.time_s)) != 640
    with pytest.raises(MeasurementError, match=r"no sample for 0\.0312 s after 1010\.000 s"):
        RateRecording(good.time_s[keep], good.rate_radps[keep])
    time = np.array(good.time_s)
    time[640] = time[639]
    with pytest.raises(MeasurementError, match=r"time does not increase after 1010\.000 s"):
        RateRecording(time, good.rate_radps)


def test_short_recordings_and_wrong_shapes_are_refused(good):
    with pytest.raises(MeasurementError, match=r"lasts 46\.9 s; it needs 55 s"):
        RateRecording(good.time_s[:3000], good.rate_radps[:3000])
    with pytest.raises(MeasurementError, match="only 60 samples"):
        RateRecording(np.arange(60.0), good.rate_radps[:60])
    with pytest.raises(MeasurementError, match="give three a time"):
        RateRecording(good.time_s, good.rate_radps[:, :2])


def test_a_gyro_that_never_changes_is_refused(good):
    rate = np.array(good.rate_radps)
    rate[:, 2] = 1e-5
    with pytest.raises(MeasurementError, match="rate of the z gyro never changes"):
        RateRecording(good.time_s, rate)


def test_motion_is_refused(good):
    nudge = np.array(good.rate_radps)
    nudge[1280:1312, 0] += 20.0 * ARCSEC / (32 * STEP_S)
    with pytest.raises(
        MeasurementError, match=r"angle jumps at about 10(19|20|21) s: the unit was not at rest"
    ):
        RateRecording(good.time_s, nudge)
    start = np.array(good.rate_radps)
    start[1280:, 2] += np.radians(0.1)
    with pytest.raises(MeasurementError, match="not at rest"):
        RateRecording(good.time_s, start)
    force = np.array(good.specific_force_mps2)
    force[2560:, 1] += 0.05
    with pytest.raises(MeasurementError, match=r"specific force jumps at about 10(39|40|41) s"):
        RateRecording(good.time_s, good.rate_radps, force)


@pytest.mark.skipif(not LN100.exists(), reason="the measured LN100 records are not beside the checkout")
def test_measured_ring_laser_gyros_give_bias_and_earth_rate():
    def read(name):
        columns = np.fromfile(LN100 / f"x_LN100_{name}.ins", "<f8").reshape(-1, 7)
        return RateRecording(columns[:, 0], np.radians(columns[:, 1:4]), columns[:, 4:])

    up, down = read("up"), read("down")
    level, bare = up_down_pair(up, down, "x"), up_down_pair(without_force(up), without_force(down), "x")
    for name, pair in (("on the vertical of the accelerometers", level), ("along the axis", bare)):
        bias, earth, sigma = RADPS_TO_DPH * np.array(
            [pair.bias_radps, pair.earth_radps, pair.earth_sigma_radps]
        )
        latitude = np.degrees(pair.latitude_rad())
        print(
            f"{name}: bias {bias:.4f}, Earth {earth:.4f}, both ± {sigma:.4f} deg/h, "
            f"{pair.sigmas_from(LATITUDE):.1f} sigma off; latitude {latitude[0]:.3f} ± {latitude[1]:.3f} deg"
        )
    sigma_dph = bare.bias_sigma_radps * RADPS_TO_DPH
    assert 0.002 < sigma_dph < 0.02
    # Means of the two records: half difference and half sum. They read the tilt, as the bare pair does.
    assert abs(bare.earth_radps * RADPS_TO_DPH - 11.732) < 2.0 * sigma_dph
    assert abs(bare.bias_radps * RADPS_TO_DPH + 0.254) < 2.0 * sigma_dph
    assert abs(bare.sigmas_from(LATITUDE)) < 3.0
    assert abs(level.sigmas_from(LATITUDE)) < 1.0
    assert abs(level.bias_radps * RADPS_TO_DPH + 0.254) < 2.0 * sigma_dph
