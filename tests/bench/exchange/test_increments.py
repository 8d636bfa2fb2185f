"""Increments from a log whose time stamps are coarse, or whose rows are lost or repeated."""

import numpy as np
import pytest

from gyrobench.bench.exchange.import_map import load_log_map
from gyrobench.bench.exchange.increments import read_increments
from gyrobench.bench.foundations.errors import MeasurementError

MAP = """
unit: "7"
text: {separator: comma, header: false}
time: {column: 1}
gyro: {unit: rad, x: 2, y: 3, z: 4}
calibration:
  accelerometers: {unit: m/s, x: 5, y: 6, z: 7}
  latitude_deg: 45
"""


def read(folder, time_s, rows):
    (folder / "map.yaml").write_text(MAP)
    np.savetxt(folder / "log.csv", np.column_stack([time_s, rows]), "%.6g", ",")
    return read_increments(folder / "log.csv", load_log_map(folder / "map.yaml", for_calibration=True))


def samples(rate_hz, duration_s=130.0):
    count = round(rate_hz * duration_s)
    return np.arange(1, count + 1) / rate_hz, np.random.default_rng(1).normal(size=(count, 6))


def test_jitter_and_coarse_time_stamps_are_no_gaps(tmp_path):
    time_s, rows = samples(50.0)
    jitter = 0.006 * np.random.default_rng(2).uniform(-1.0, 1.0, len(time_s))
    (recording,) = read(tmp_path, time_s + jitter, rows)
    assert len(recording.angle) == len(rows)
    time_s, rows = samples(700.0, 61.0)
    (recording,) = read(tmp_path, np.floor(1e3 * time_s) / 1e3, rows)
    assert len(recording.angle) >= len(rows) - 2
    assert recording.interval_s == pytest.approx(1.0 / 700.0, rel=1e-4)


def test_repeated_rows_are_left_out_and_a_lost_one_cuts(tmp_path):
    time_s, rows = samples(50.0)
    twice = np.sort(np.concatenate([np.arange(len(rows)), np.arange(500, 510)]))
    (recording,) = read(tmp_path, time_s[twice], rows[twice])
    assert len(recording.angle) == len(rows)
    kept = np.delete(np.arange(len(rows)), 3200)
    assert [len(each.angle) for each in read(tmp_path, time_s[kept], rows[kept])] == [3200, 3299]


def test_a_log_with_too_many_gaps_states_its_parts(tmp_path):
    time_s, rows = samples(50.0)
    kept = np.delete(np.arange(len(rows)), [2000, 4000])
    with pytest.raises(MeasurementError, match="into 3 parts"):
        read(tmp_path, time_s[kept], rows[kept])
