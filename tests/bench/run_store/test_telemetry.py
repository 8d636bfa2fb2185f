import pandas as pd

from bench.run_store.telemetry import COLUMNS, Telemetry, read_telemetry


def row(time_s):
    return (time_s, *range(1, len(COLUMNS)))


def test_pandas_opens_the_folder_as_one_table(tmp_path):
    telemetry = Telemetry(tmp_path)
    for second in range(2000):
        telemetry.add(row(float(second)))
    telemetry.flush()
    table = pd.read_parquet(tmp_path)
    assert len(table) == 2000
    assert list(table.columns) == list(COLUMNS)
    assert table.time_s.is_monotonic_increasing


def test_parts_are_written_while_the_run_lasts(tmp_path):
    telemetry = Telemetry(tmp_path)
    for second in range(1000):
        telemetry.add(row(float(second)))
    assert len(read_telemetry(tmp_path)["time_s"]) == 900


def test_an_empty_folder_gives_empty_columns(tmp_path):
    assert {name: len(values) for name, values in read_telemetry(tmp_path).items()} == dict.fromkeys(
        COLUMNS, 0
    )
