"""Public logs of real sensors: what is known of them comes out of the imported tables."""

from pathlib import Path

import numpy as np
import pytest

from gyrobench.bench.exchange.log_import import import_logs
from gyrobench.bench.foundations.arrays import RADPS_TO_DPH
from gyrobench.bench.navigation.earth import EARTH_RATE

DATA = Path(__file__).parents[4] / "shared" / "data"
IMU = DATA / "imu_thermal" / "imu_raw_data.csv"
LN100 = DATA / "ln100"


@pytest.fixture(scope="module")
def imu():
    """Times, temperatures and biases (n, 3) in windows of 10 s."""
    if not IMU.exists():
        pytest.skip("the measured log of an IMU in a climate chamber is not beside the checkout")
    rows = import_logs([IMU], "tofupilot_imu").rows
    return (
        np.array([row.start_s - rows[0].start_s for row in rows]),
        np.array([row.gyro_c[0] for row in rows]),
        np.array([row.bias_dph for row in rows]),
        rows,
    )


def test_every_window_of_the_imu_log_is_valid(imu):
    _, temperature_c, _, rows = imu
    assert len(rows) == 423
    assert temperature_c.min() == pytest.approx(-17.6, abs=0.1)
    assert temperature_c.max() == pytest.approx(73.9, abs=0.1)
    assert {row.position for row in rows} == {"z_down"}
    assert all(8.0 < sigma < 20.0 for sigma in rows[0].sigma_dph)


def held_out_rms(columns, bias_dph, test):
    coefficients = np.linalg.lstsq(columns[~test], bias_dph[~test], rcond=None)[0]
    return bias_dph[test] - columns[test] @ coefficients


@pytest.mark.parametrize(("block_s", "expected"), [(300.0, (904, 186, 369)), (600.0, (1137, 247, 288))])
def test_a_cubic_in_temperature_leaves_the_known_error_in_blocks_held_out_in_turn(imu, block_s, expected):
    since_s, temperature_c, bias_dph, rows = imu
    cubic = np.vander((temperature_c - 25.0) / 40.0, 4)
    odd = since_s // block_s % 2 == 1
    if block_s == 300.0:
        assert [row.cycle % 2 == 0 for row in rows] == list(odd)
    errors = np.concatenate([held_out_rms(cubic, bias_dph, test) for test in (odd, ~odd)])
    np.testing.assert_allclose(np.sqrt((errors**2).mean(axis=0)), expected, rtol=0.06)


def test_a_lagged_temperature_takes_error_from_the_last_cooling(imu):
    since_s, temperature_c, bias_dph, _ = imu
    lagged = np.empty_like(temperature_c)
    lagged[0] = temperature_c[0]
    for index, step_s in enumerate(np.diff(since_s), 1):
        share = 1.0 - np.exp(-step_s / 300.0)
        lagged[index] = lagged[index - 1] + share * (temperature_c[index] - lagged[index - 1])
    cubic = np.vander((temperature_c - 25.0) / 40.0, 4)
    cooling = np.arange(len(since_s)) > temperature_c.argmax()
    with_lag = np.column_stack([cubic, (lagged - temperature_c) / 40.0])
    rms = [np.sqrt((held_out_rms(each, bias_dph[:, 0], cooling) ** 2).mean()) for each in (cubic, with_lag)]
    np.testing.assert_allclose(rms, [1955.0, 1172.0], rtol=0.02)


def test_a_ring_laser_turned_upside_down_shows_its_bias_and_the_latitude():
    if not LN100.exists():
        pytest.skip("the measured records of a ring laser INS are not beside the checkout")
    logs = [LN100 / f"x_LN100_{name}.ins" for name in ("down", "up")]
    rows = import_logs(logs, "ln100").rows
    assert [row.position for row in rows] == ["x_down"] * 10 + ["x_up"] * 10
    assert rows[10].start_s == pytest.approx(335.0, abs=0.1)
    means = np.array([row.bias_dph[0] for row in rows]).reshape(2, 10).mean(axis=1)
    down, up = means
    assert 0.5 * (up + down) == pytest.approx(-0.254, abs=0.002)
    vertical_dph = EARTH_RATE * RADPS_TO_DPH * np.sin(np.deg2rad(51.0784))
    assert 0.5 * (up - down) + vertical_dph == pytest.approx(11.732, abs=0.002)
    spread = np.array([row.bias_dph for row in rows]).reshape(2, 10, 3).std(axis=1, ddof=1)
    assert (spread < 2.0 * np.array(rows[0].sigma_dph)).all()
    assert (spread > 0.5 * np.array(rows[0].sigma_dph)).all()
