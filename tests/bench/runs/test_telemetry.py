import numpy as np
import pytest

from gyrobench.bench.foundations.errors import RunFolderError
from gyrobench.bench.runs.telemetry import TELEMETRY_COLUMNS, Telemetry, last_reading_s, read_telemetry


def row(time_s):
    return {name: float(index) for index, name in enumerate(TELEMETRY_COLUMNS)} | {"time_s": time_s}


def add(telemetry, times_s):
    for time_s in times_s:
        telemetry.add(row(float(time_s)))


def times_s(folder):
    return read_telemetry(folder)["time_s"].tolist()


def test_pandas_opens_the_folder_as_one_table(tmp_path):
    import pandas as pd

    telemetry = Telemetry(tmp_path)
    for second in range(2000):
        telemetry.add(row(float(second)))
    telemetry.flush()
    table = pd.read_parquet(tmp_path)
    assert len(table) == 2000
    assert list(table.columns) == list(TELEMETRY_COLUMNS)
    assert table.time_s.is_monotonic_increasing


@pytest.mark.parametrize(("is_virtual", "most_s"), [(False, 60), (True, 600)])
def test_a_kill_loses_the_readings_of_a_minute_at_most_and_on_virtual_time_of_ten(
    tmp_path, is_virtual, most_s
):
    telemetry = Telemetry(tmp_path, is_virtual)
    for second in range(0, 20 * most_s, 10):
        add(telemetry, [second])
        if second % (most_s - 10) == 0:
            read = times_s(tmp_path)
            assert read == list(range(0, 10 * len(read), 10))
            assert second - (read[-1] if read else 0) <= most_s


def test_a_day_has_few_parts(tmp_path):
    telemetry = Telemetry(tmp_path, is_virtual=True)
    add(telemetry, range(0, 86_400, 10))
    telemetry.flush()
    assert len(list(tmp_path.iterdir())) == 10
    assert times_s(tmp_path) == list(range(0, 86_400, 10))


def test_flushing_often_makes_no_more_parts(tmp_path):
    telemetry = Telemetry(tmp_path)
    for second in range(100):
        add(telemetry, [second])
        telemetry.flush()
        telemetry.flush()
    assert [path.name for path in tmp_path.iterdir()] == ["part-00001.parquet"]
    assert times_s(tmp_path) == list(range(100))


def test_a_resumed_run_continues_in_a_new_part_after_a_row_that_says_nothing(tmp_path):
    for begin in (0, 500):
        telemetry = Telemetry(tmp_path)
        add(telemetry, range(begin, begin + 3))
        telemetry.flush()
    readings = read_telemetry(tmp_path)
    assert readings["time_s"].tolist() == [0, 1, 2, 500, 500, 501, 502]
    for name in TELEMETRY_COLUMNS[1:]:
        assert np.flatnonzero(np.isnan(readings[name])).tolist() == [3]


def test_the_last_reading_reports_how_far_a_run_came(tmp_path):
    assert last_reading_s(tmp_path) == 0.0
    telemetry = Telemetry(tmp_path)
    add(telemetry, range(1000))
    telemetry.flush()
    assert last_reading_s(tmp_path) == 999.0


def test_what_was_written_stays_where_a_part_cant_be_written_again(tmp_path, small_files):
    telemetry = Telemetry(tmp_path)
    add(telemetry, [0, 1])
    telemetry.flush()
    add(telemetry, [2])
    with small_files(1000), pytest.raises(RunFolderError, match="can't be written"):
        telemetry.flush()
    assert times_s(tmp_path) == [0, 1]
    assert len(list(tmp_path.iterdir())) == 1
    telemetry.flush()
    assert times_s(tmp_path) == [0, 1, 2]


@pytest.mark.parametrize("content", [b"", b"PAR1", b"not a Parquet file"])
def test_a_damaged_part_is_an_error_with_its_name(tmp_path, content):
    (tmp_path / "part-00001.parquet").write_bytes(content)
    with pytest.raises(RunFolderError, match="part-00001"):
        read_telemetry(tmp_path)


def test_values_that_a_row_or_an_older_run_lacks_are_unknown(tmp_path, monkeypatch):
    monkeypatch.setattr("gyrobench.bench.runs.telemetry.TELEMETRY_COLUMNS", ("time_s", "step", "dwell"))
    telemetry = Telemetry(tmp_path)
    telemetry.add({"time_s": 1.0, "dwell": 2.0})
    with pytest.raises(KeyError, match="humidity"):
        telemetry.add({"time_s": 2.0, "humidity": 0.4})
    telemetry.flush()
    readings = read_telemetry(tmp_path, ("time_s", "dwell", "step", "humidity"))
    assert [values.tolist() for values in readings.values()][:2] == [[1.0], [2.0]]
    assert np.isnan([readings["step"], readings["humidity"]]).all()


def test_an_empty_folder_gives_empty_columns(tmp_path):
    assert {name: len(values) for name, values in read_telemetry(tmp_path).items()} == dict.fromkeys(
        TELEMETRY_COLUMNS, 0
    )


def test_a_part_that_asks_for_far_more_rows_than_a_run_writes_is_refused(tmp_path):
    import pyarrow as pa
    import pyarrow.parquet as pq

    table = pa.table({name: np.zeros(200_000) for name in TELEMETRY_COLUMNS})
    pq.write_table(table, tmp_path / "part-00001.parquet")
    with pytest.raises(RunFolderError, match=r"part-00001\.parquet: 200000 rows"):
        read_telemetry(tmp_path)


def test_a_part_with_text_in_the_place_of_numbers_is_refused(tmp_path):
    import pyarrow as pa
    import pyarrow.parquet as pq

    pq.write_table(pa.table({name: ["x"] for name in TELEMETRY_COLUMNS}), tmp_path / "part-00001.parquet")
    with pytest.raises(RunFolderError, match=r"part-00001\.parquet: can't be read"):
        read_telemetry(tmp_path)
