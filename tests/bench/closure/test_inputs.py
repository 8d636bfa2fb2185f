"""Campaigns from dwell tables and run folders."""

import numpy as np
import pytest

from gyrobench.bench.bias.dwell_table import write_dwells
from gyrobench.bench.closure.inputs import read_campaign, temperature_record
from gyrobench.bench.foundations.errors import DocumentError, MeasurementError, RunFolderError
from gyrobench.bench.runs.telemetry import TELEMETRY_COLUMNS, Telemetry
from tests.bench.report.made_up_closure import made_up_rows


def readings(count=200, step_s=10.0):
    values = {name: np.zeros(count) for name in TELEMETRY_COLUMNS}
    values["time_s"] = step_s * np.arange(count)
    for axis, name in enumerate(("gyro_x_c", "gyro_y_c", "gyro_z_c")):
        values[name] = 20.0 + axis + 0.01 * values["time_s"]
    return values


def write_run(folder, values):
    (folder / "journal.jsonl").write_text("")
    write_dwells(folder / "dwells.csv", made_up_rows())
    telemetry = Telemetry(folder / "telemetry")
    for row in zip(*(values[name] for name in TELEMETRY_COLUMNS), strict=True):
        telemetry.add(row)
    telemetry.flush()


def test_a_table_gives_its_dwells(tmp_path):
    write_dwells(tmp_path / "dwells.csv", made_up_rows())
    assert len(read_campaign(tmp_path / "dwells.csv")) == len(made_up_rows())


def test_a_run_gives_its_temperatures_between_the_dwells_too(tmp_path):
    write_run(tmp_path, readings())
    record = read_campaign(tmp_path).record
    assert record.time_s[[0, -1]] == pytest.approx([0.0, 1990.0])
    assert record.gyro_c == pytest.approx(20.0 + np.arange(3) + 0.01 * record.time_s[:, np.newaxis])
    assert np.ptp(np.diff(record.time_s)) < 1e-6


def test_a_run_without_readings_falls_back_on_its_dwells(tmp_path):
    write_run(tmp_path, {name: np.empty(0) for name in TELEMETRY_COLUMNS})
    record = read_campaign(tmp_path).record
    assert record.time_s[-1] == pytest.approx(made_up_rows()[-1].end_s)


def test_readings_without_a_number_are_bridged():
    values = readings()
    values["gyro_y_c"][50:120] = np.nan
    record = temperature_record(values)
    assert record.gyro_c[:, 1] == pytest.approx(21.0 + 0.01 * record.time_s)


def test_a_gyro_that_was_never_read_gives_no_record():
    values = readings()
    values["gyro_z_c"][:] = np.nan
    assert temperature_record(values) is None


def test_a_long_run_has_a_record_of_bounded_size():
    record = temperature_record(readings(count=2000, step_s=3600.0))
    assert len(record.time_s) <= 20_001


def test_a_folder_that_is_no_run_is_reported(tmp_path):
    with pytest.raises(RunFolderError, match="is not a run folder"):
        read_campaign(tmp_path)


def test_a_table_that_is_not_there_is_reported(tmp_path):
    with pytest.raises(DocumentError, match=r"nothing\.csv"):
        read_campaign(tmp_path / "nothing.csv")


def test_a_table_without_dwells_is_refused(tmp_path):
    write_dwells(tmp_path / "dwells.csv", [])
    with pytest.raises(MeasurementError, match=r"dwells\.csv: has no dwells"):
        read_campaign(tmp_path / "dwells.csv")
