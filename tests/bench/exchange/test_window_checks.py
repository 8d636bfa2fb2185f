import numpy as np
import pytest

from gyrobench.bench.exchange.import_map import EarthRate
from gyrobench.bench.exchange.log_windows import cut_windows
from gyrobench.bench.exchange.window_checks import earth_rate_dph, nearest_position, noise_of_means
from gyrobench.bench.foundations.errors import MeasurementError
from gyrobench.bench.navigation.positions import POSITIONS


@pytest.mark.parametrize("name", POSITIONS)
def test_the_force_at_rest_reports_the_position_and_the_tilt(name):
    up = POSITIONS[name].C_nb()[2]
    beside = np.roll(up, 1)
    tilt = np.deg2rad(5.0)
    found, tilt_deg = nearest_position(9.8 * (np.cos(tilt) * up + np.sin(tilt) * beside))
    assert found == name
    assert tilt_deg == pytest.approx(5.0)


def test_no_force_is_near_no_position():
    assert np.isnan(nearest_position(np.zeros(3))[1])
    assert np.isnan(nearest_position(np.full(3, np.nan))[1])


@pytest.mark.parametrize("name", POSITIONS)
def test_the_earth_rate_in_the_body_turns_with_the_azimuth_about_the_vertical(name):
    axis, sign = POSITIONS[name].up_axis, POSITIONS[name].up_sign
    at_zero, turned, unknown = (
        earth_rate_dph(name, EarthRate(latitude_deg=45.0, azimuth_deg=azimuth))
        for azimuth in (0.0, 180.0, None)
    )
    vertical = sign * 15.041067 * np.sqrt(0.5) * np.eye(3)[axis]
    np.testing.assert_allclose(0.5 * (at_zero + turned), vertical, atol=1e-5)
    np.testing.assert_allclose(unknown, vertical, atol=1e-5)
    assert np.linalg.norm(at_zero) == pytest.approx(15.041067, abs=1e-5)


RATE_HZ, WINDOW_S, COUNT = 5.0, 60.0, 30_000
SAMPLES = RATE_HZ * WINDOW_S


def windows(rates, window_s=WINDOW_S):
    time_s = np.arange(len(rates)) / RATE_HZ
    samples = {f"rate_{axis}": rates[:, index] for index, axis in enumerate("xyz")}
    return list(cut_windows([{"time_s": time_s, **samples}], window_s, 0.0))


def white(seed=0, count=COUNT):
    return np.random.default_rng(seed).standard_normal((count, 3))


def test_rates_with_white_noise_are_known_as_their_number_shows():
    np.testing.assert_allclose(noise_of_means([windows(white())]), 1.0 / np.sqrt(SAMPLES), rtol=0.25)


def test_angles_with_white_noise_are_known_as_their_ends_show():
    rates = np.diff(white(count=COUNT + 1), axis=0)
    np.testing.assert_allclose(noise_of_means([windows(rates)]), np.sqrt(2.0) / SAMPLES, rtol=0.8)


def test_noise_that_does_not_average_out_stays():
    rates = white() + np.repeat(0.5 * white(1, COUNT // 10), 10, axis=0) + 0.5 * np.cumsum(
        np.repeat(white(2, COUNT // 150) / 10.0, 150, axis=0) / 150.0, axis=0)  # fmt: skip
    spread = np.std(np.diff([each.rate_dph for each in windows(rates)], axis=0), axis=0) / np.sqrt(2.0)
    np.testing.assert_allclose(noise_of_means([windows(rates)]), spread, rtol=0.35)


def test_drift_hardly_counts():
    drift = 100.0 * np.sin(np.arange(COUNT) / 5000.0)[:, None]
    clean, drifting = windows(white()), windows(white() + drift)
    from_one_to_the_next = np.abs(np.diff([each.rate_dph for each in drifting], axis=0)).mean()
    assert from_one_to_the_next > 50.0 * noise_of_means([clean]).max()
    np.testing.assert_allclose(noise_of_means([drifting]), noise_of_means([clean]), rtol=0.7)


def test_a_knock_does_not_count():
    knocked = white()
    knocked[1000:1100] += 1000.0
    np.testing.assert_allclose(
        noise_of_means([windows(knocked)]), noise_of_means([windows(white())]), rtol=0.1
    )


def test_windows_of_several_logs_are_not_taken_for_neighbours():
    logs = [windows(white(seed, 2500) + 1000.0 * seed, 10.0) for seed in range(4)]
    np.testing.assert_allclose(noise_of_means(logs), 1.0 / np.sqrt(50.0), rtol=0.3)


def test_steps_of_a_rate_without_noise_limit_what_is_known():
    rates = np.zeros((COUNT, 3))
    rates[7] = 2.0
    np.testing.assert_allclose(noise_of_means([windows(rates)]), 2.0 / np.sqrt(12.0))


def test_a_rate_that_never_changes_is_an_error():
    rates = white()
    rates[:, 1] = 3.0
    with pytest.raises(MeasurementError, match="a gyro's rate never changes"):
        noise_of_means([windows(rates)])


def test_too_few_windows_are_an_error():
    with pytest.raises(MeasurementError, match="1 valid windows of 10 samples are too few"):
        noise_of_means([windows(white(count=10))])
