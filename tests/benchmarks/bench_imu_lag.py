"""How much a lagged temperature and a drift explain of a measured IMU's bias; time constants are fitted."""

from pathlib import Path

import numpy as np
import pytest

from gyrobench.bench.exchange.log_import import import_logs
from tests.benchmarks.stock_methods import lagged

IMU = Path(__file__).parents[3] / "shared" / "data" / "imu_thermal" / "imu_raw_data.csv"
LAGS_S = np.geomspace(20.0, 4000.0, 40)
MODELS = ("cubic", "time", "lag", "lag, time")


def design(temperature_c, since_s, lag_c, model):
    columns = [np.vander((temperature_c - 25.0) / 40.0, 4)]
    if "lag" in model:
        columns.append((lag_c - temperature_c)[:, None] / 40.0)
    if "time" in model:
        columns.append(since_s[:, None] / 4000.0)
    return np.hstack(columns)


def held_out_errors(designs, bias_dph, test):
    """Errors of the held-out rows by the lag that fits the other rows best, and which lag that is."""
    fits = [np.linalg.lstsq(each[~test], bias_dph[~test], rcond=None)[0] for each in designs]
    errors = [bias_dph - each @ fit for each, fit in zip(designs, fits, strict=True)]
    best = int(np.argmin([(each[~test] ** 2).sum() for each in errors]))
    return errors[best][test], best


@pytest.fixture(scope="module")
def rows():
    if not IMU.exists():
        pytest.skip("the measured log of an IMU is not beside the checkout")
    return import_logs([IMU], "tofupilot_imu").rows


def test_one_temperature_three_times(rows):
    """The log passes the same temperatures cooling, heating and cooling again."""
    temperature_c = np.array([row.gyro_c[0] for row in rows])
    coldest, hottest = int(temperature_c.argmin()), int(temperature_c.argmax())
    legs = {"cooling": slice(0, coldest), "heating": slice(coldest, hottest), "again": slice(hottest, None)}
    print("\nBias in deg/h where the temperature passes")
    for at_c in (0.0, 20.0, 40.0, 50.0):
        for leg, part in legs.items():
            near = min(rows[part], key=lambda row: abs(row.gyro_c[0] - at_c))
            if abs(near.gyro_c[0] - at_c) < 1.0:
                bias = " ".join(f"{value:7.0f}" for value in near.bias_dph)
                print(f"{at_c:3.0f} degC {leg:8s} {near.gyro_rate_c_per_h[0]:5.0f} K/h {bias}")
    assert 0 < coldest < hottest < len(rows)


def test_lag_and_drift(rows):
    since_s = np.array([row.start_s - rows[0].start_s for row in rows])
    temperatures = np.array([row.gyro_c for row in rows])
    temperature_c = temperatures[:, 0]
    bias = np.array([row.bias_dph for row in rows])
    runs = np.array([row.run for row in rows])
    lags = [lagged(temperatures, since_s, runs, lag_s)[:, 0] for lag_s in LAGS_S]
    cooling = np.arange(len(rows)) > temperature_c.argmax()
    tests = {
        "5-min blocks": [since_s // 300.0 % 2 == odd for odd in (0, 1)],
        "10-min blocks": [since_s // 600.0 % 2 == odd for odd in (0, 1)],
        "last cooling": [cooling],
    }
    print("\nHeld-out rms, deg/h, and the lag that fitted the other rows best, s")
    for axis, name in enumerate("xyz"):
        for model in MODELS:
            designs = [design(temperature_c, since_s, lag_c, model) for lag_c in lags]
            cells = []
            for label, parts in tests.items():
                results = [held_out_errors(designs, bias[:, axis], test) for test in parts]
                rms = np.sqrt((np.concatenate([errors for errors, _ in results]) ** 2).mean())
                used = "/".join(f"{LAGS_S[best]:.0f}" for _, best in results) if "lag" in model else ""
                cells.append(f"{label} {rms:5.0f} {used:10s}")
                assert np.isfinite(rms)
            print(f"{name} {model:10s} " + " ".join(cells))
