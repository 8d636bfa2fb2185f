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


def read_log(folder, time_s, rows, more=""):
    (folder / "map.yaml").write_text(MAP + more)
    np.savetxt(folder / "log.csv", np.column_stack([time_s, rows]), "%.9g", ",")
    return read_increments(folder / "log.csv", load_log_map(folder / "map.yaml", for_calibration=True))


def read(folder, time_s, rows):
    return read_log(folder, time_s, rows).recordings


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


def test_one_late_time_stamp_does_not_change_the_interval(tmp_path):
    time_s, rows = samples(50.0)
    late = time_s.copy()
    late[0] += 0.008
    log = read_log(tmp_path, late, rows)
    (recording,) = log.recordings
    assert recording.interval_s == pytest.approx(0.02, rel=1e-6)
    assert recording.start_s == pytest.approx(0.0, abs=1e-4)
    assert abs(recording.interval_s / 0.02 - 1.0) < 3.0 * log.interval_error < 1e-5


@pytest.mark.long
def test_the_interval_is_as_uncertain_as_the_scatter_of_the_time_stamps_makes_it(tmp_path):
    time_s, rows = samples(50.0)
    random = np.random.default_rng(5)
    deviations = []
    for number in range(40):
        (tmp_path / f"{number}").mkdir()
        log = read_log(tmp_path / f"{number}", time_s + 0.003 * random.standard_normal(len(time_s)), rows)
        deviations.append((log.recordings[0].interval_s / 0.02 - 1.0) / log.interval_error)
    assert np.sqrt(np.mean(np.square(deviations))) == pytest.approx(1.0, abs=0.35)


def test_samples_that_do_not_count_are_counted(tmp_path):
    time_s, rows = samples(50.0, 200.0)
    rows[4000:4100] = np.nan
    log = read_log(tmp_path, time_s, rows)
    assert (log.samples, log.left_out) == (10_000, 100)
    log = read_log(tmp_path, time_s, rows, "skip_s: 90\n")
    assert [each.start_s for each in log.recordings] == [pytest.approx(90.0, abs=0.03)]


def test_a_part_that_hardly_rests_is_left_out(tmp_path):
    time_s, rows = samples(50.0, 210.0)
    rows[6501] = np.nan
    rows[7000:8500] += 40.0 * np.sin(0.01 * np.arange(1500.0))[:, np.newaxis]
    log = read_log(tmp_path, time_s, rows)
    assert [len(each.angle) for each in log.recordings] == [6501]
    assert log.left_out == 10_500 - 6501


def test_time_stamps_coarser_than_samples_name_the_rate_as_the_way_out(tmp_path):
    time_s, rows = samples(50.0)
    with pytest.raises(MeasurementError, match=r"coarser than its samples.*sample_rate_hz"):
        read(tmp_path, np.floor(time_s), rows)
    with pytest.raises(MeasurementError, match=r"39\.98 s of samples; at least 60 s"):
        read(tmp_path, *(each[:2000] for each in samples(50.0)))


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("column", [2, 6])
def test_an_axis_that_stays_at_the_end_of_its_range_is_named(tmp_path, column, sign):
    time_s, rows = samples(50.0)
    rows[3000:3100, column - 2] += 9.0 * sign
    read(tmp_path, time_s, rows)
    clipped = np.clip(rows, -7.0, 7.0)
    with pytest.raises(MeasurementError, match=f"column {column} stays at the end of its range from 6[0-2]"):
        read(tmp_path, time_s, clipped)


def test_coarse_counts_of_a_steady_rotation_are_no_saturation(tmp_path):
    time_s, rows = samples(50.0)
    rows *= 0.1
    rows[3000:3500] += 40.0
    (recording,) = read(tmp_path, time_s, np.diff(np.round(np.cumsum(rows, axis=0)), axis=0, prepend=0.0))
    assert len(recording.angle) == len(rows)


def test_a_gyro_beyond_its_declared_range_is_named(tmp_path):
    time_s, rows = samples(50.0)
    rows[3000, 0] = 8.0
    (tmp_path / "map.yaml").write_text(MAP.replace("unit: rad,", "unit: rad, full_scale: 8,"))
    np.savetxt(tmp_path / "log.csv", np.column_stack([time_s, rows]), "%.9g", ",")
    log_map = load_log_map(tmp_path / "map.yaml", for_calibration=True)
    with pytest.raises(MeasurementError, match=r"column 2 stays at the end of its range from 60\.00 s"):
        read_increments(tmp_path / "log.csv", log_map)
