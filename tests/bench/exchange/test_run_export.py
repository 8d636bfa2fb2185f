"""What is exported, read back by the tools that it is for."""

import json
import shutil
import sys

import duckdb
import numpy as np
import pytest

from gyrobench.bench.bias.dwell_table import read_dwells
from gyrobench.bench.closure.loadable_model import declared_model, model_with_effects
from gyrobench.bench.exchange.export_folder import ExportFolder
from gyrobench.bench.exchange.run_export import (
    DataKind,
    ExportSelection,
    Format,
    export_compensation,
    export_run,
)
from gyrobench.bench.foundations.errors import DocumentError, MissingPackageError, RunFolderError
from gyrobench.bench.foundations.text import flag_text
from gyrobench.bench.runs.compensation_file import read_compensation_file
from gyrobench.bench.runs.folder import RunFolder
from gyrobench.bench.runs.telemetry import read_telemetry
from tests.bench.report import made_up_closure


@pytest.fixture(scope="module")
def usual(two_dwells, tmp_path_factory):
    """Everything usual in the usual formats."""
    out = tmp_path_factory.mktemp("usual")
    return out, export_run(two_dwells, ExportSelection(), out)


def test_without_wishes_all_but_navigation_is_written_as_far_as_it_is_there(usual):
    out, exported = usual
    names = {path.name for path in out.iterdir()}
    assert names == {path.name for path in exported.files}
    assert names == {
        *("dwells.parquet", "bias_bins.parquet", "joint.parquet", "joint_biases.parquet"),
        *("telemetry.parquet", "can.blf", "export.json"),
    }
    assert set(exported.missing) == {DataKind.VERIFICATION, DataKind.COMPENSATION}
    assert "gyrobench close" in exported.missing[DataKind.COMPENSATION]


def test_dwells_are_read_back_by_pandas_with_types(usual, two_dwells):
    import pandas as pd

    table, rows = pd.read_parquet(usual[0] / "dwells.parquet"), read_dwells(two_dwells.dwells)
    assert table["dwell"].tolist() == [1, 2]
    assert table["unit"].tolist() == [row.unit for row in rows]
    assert table["position"].tolist() == ["z_up", "x_up"]
    assert table["bias_x_dph"].tolist() == [row.bias_dph[0] for row in rows]
    assert table["flags"].tolist() == [flag_text(row.flags) for row in rows]


def test_columns_say_their_units_and_files_where_they_came_from(usual, two_dwells):
    import pyarrow.parquet as pq

    schema = pq.read_schema(usual[0] / "dwells.parquet")
    units = {field.name: (field.metadata or {}).get(b"unit", b"").decode() for field in schema}
    assert units["bias_x_dph"] == "deg/h"
    assert units["gyro_x_rate_c_per_h"] == "K/h"
    assert units["accelerometer_sigma_z_ug"] == "ug"
    assert units["unit"] == ""
    origin = json.loads(schema.metadata[b"gyrobench"])
    assert origin["run"] == two_dwells.path.name
    assert origin["unit"] == "1001"
    assert origin["measured_by"].startswith("gyrobench ")
    assert len(origin["sha256"]["station.yaml"]) == 64
    about = json.loads((usual[0] / "export.json").read_text())
    assert about["origin"]["procedure"] == "two_dwells"
    assert about["files"]["dwells.parquet"]["units"]["bias_x_dph"] == "deg/h"


def test_duckdb_queries_several_files_at_once(usual):
    with duckdb.connect() as database:
        for name in ("dwells", "telemetry"):
            database.read_parquet(str(usual[0] / f"{name}.parquet")).create_view(name)
        ((count, hottest),) = database.execute(
            "select count(*), max(telemetry.gyro_x_c) from dwells "
            "join telemetry on telemetry.time_s between dwells.start_s and dwells.end_s"
        ).fetchall()
    assert count > 10
    assert 20.0 < hottest < 60.0


@pytest.mark.parametrize("form", [Format.CSV, Format.PARQUET])
def test_telemetry_holds_every_reading_with_its_calendar_time(two_dwells, form, tmp_path):
    import pandas as pd

    export_run(two_dwells, ExportSelection([DataKind.TELEMETRY], [form]), tmp_path)
    path, readings = tmp_path / f"telemetry.{form}", read_telemetry(two_dwells.telemetry)
    table = pd.read_csv(path) if form is Format.CSV else pd.read_parquet(path)
    for name, values in readings.items():
        np.testing.assert_allclose(table[name].astype(float), values)
    utc = pd.to_datetime(table["utc"], format="ISO8601", utc=True)
    since_s = (utc - pd.Timestamp("2000-01-01", tz="UTC")).dt.total_seconds()
    np.testing.assert_allclose(since_s, readings["time_s"], atol=1e-6)


def test_tables_as_csv_are_those_of_the_run(two_dwells, tmp_path):
    export_run(two_dwells, ExportSelection([DataKind.DWELLS, DataKind.BINS], [Format.CSV]), tmp_path)
    assert (tmp_path / "dwells.csv").read_bytes() == two_dwells.dwells.read_bytes()
    assert (tmp_path / "bias_bins.csv").read_bytes() == two_dwells.bias_bins.read_bytes()


def test_a_run_that_was_cut_off_gives_what_it_holds(two_dwells, tmp_path):
    shutil.copytree(two_dwells.path, tmp_path / "a run")
    folder = RunFolder(tmp_path / "a run")
    for path in (folder.bias_bins, folder.joint, folder.joint_biases):
        path.unlink()
    lines = folder.journal.read_text().splitlines(keepends=True)
    folder.journal.write_text("".join(lines[:-1]) + lines[-1][:40])
    last = max(folder.can.iterdir())
    last.write_bytes(last.read_bytes()[:-1000])
    exported = export_run(folder, ExportSelection(), tmp_path / "out")
    assert {path.name for path in exported.files} == {
        *("dwells.parquet", "telemetry.parquet", "can.blf", "export.json")
    }
    assert f"gyrobench bins '{folder.path}'" in exported.missing[DataKind.BINS]
    assert json.loads((tmp_path / "out" / "export.json").read_text())["origin"]["ended"] is None


def test_what_is_not_there_is_reported_where_nothing_else_was_wanted(two_dwells, tmp_path):
    with pytest.raises(RunFolderError, match="verification: the run made no calibration check"):
        export_run(two_dwells, ExportSelection([DataKind.VERIFICATION]), tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_the_model_of_a_unit_that_compensated_itself_is_no_compensation(two_dwells, tmp_path):
    run = RunFolder(tmp_path / "run")
    shutil.copytree(two_dwells.path, run.path)
    entry = {"event": "compensation", "in_use": {"active": True, "checksum": "0badcafe"}, "terms": None}
    run.journal.write_text(json.dumps(entry) + "\n")
    with pytest.raises(RunFolderError, match=r"the INS applied a compensation already \(0badcafe\)"):
        export_run(run, ExportSelection([DataKind.COMPENSATION]), tmp_path / "out")


def test_files_that_are_there_stay_unless_they_are_to_be_replaced(two_dwells, tmp_path):
    wanted = ExportSelection([DataKind.DWELLS, DataKind.BINS], [Format.CSV])
    (tmp_path / "bias_bins.csv").write_text("mine")
    with pytest.raises(RunFolderError, match=r"already contains bias_bins.csv. Use --force"):
        export_run(two_dwells, wanted, tmp_path)
    assert not (tmp_path / "dwells.csv").exists()
    assert (tmp_path / "bias_bins.csv").read_text() == "mine"
    export_run(two_dwells, wanted, tmp_path, force=True)
    assert (tmp_path / "bias_bins.csv").read_bytes() == two_dwells.bias_bins.read_bytes()


def test_what_is_said_of_files_written_earlier_stays(two_dwells, tmp_path):
    export_run(two_dwells, ExportSelection([DataKind.DWELLS]), tmp_path)
    export_run(two_dwells, ExportSelection([DataKind.BINS]), tmp_path)
    about = json.loads((tmp_path / "export.json").read_text())
    assert set(about["files"]) == {"dwells.parquet", "bias_bins.parquet"}


def test_a_format_whose_package_is_missing_is_refused_before_a_file_is_written(
    two_dwells, tmp_path, monkeypatch
):
    monkeypatch.setitem(sys.modules, "asammdf", None)
    with pytest.raises(MissingPackageError, match="asammdf"):
        export_run(two_dwells, ExportSelection([], [Format.CSV, Format.MF4]), tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_a_format_that_does_not_fit_is_refused():
    with pytest.raises(DocumentError, match=r"--format mf4 does not fit dwells"):
        ExportSelection([DataKind.DWELLS, DataKind.CAN], [Format.MF4])
    assert ExportSelection([], [Format.MF4]).kinds() == [DataKind.CAN]
    with pytest.raises(DocumentError, match="--what navigation"):
        ExportSelection([DataKind.DWELLS], dwell=2)


@pytest.fixture(scope="module", params=["explained", "clean"])
def exported(request, tmp_path_factory):
    """A closed campaign, with an effect and without, and the folder that it was written to."""
    closure = getattr(made_up_closure, request.param)()
    out = tmp_path_factory.mktemp(request.param)
    destination = ExportFolder(out, {"run": "made_up"})
    export_compensation(closure, [".csv", ".parquet"], destination)
    destination.finish()
    return closure, out


def test_files_are_those_that_were_announced(exported):
    _, out = exported
    names = {path.name for path in out.iterdir()}
    tables = {
        f"compensation_{name}{suffix}" for name in ("table", "terms") for suffix in (".csv", ".parquet")
    }
    assert names == {*tables, "compensation.yaml", "export.json"}


def test_the_table_is_the_model_over_the_temperatures_that_were_fitted(exported):
    import pandas as pd

    closure, out = exported
    table, model = pd.read_csv(out / "compensation_table.csv"), model_with_effects(closure).compensation
    temperature_c = table["temperature_c"].to_numpy()
    np.testing.assert_allclose(np.diff(temperature_c), 1.0)
    for index, axis in enumerate("xyz"):
        inside = (temperature_c >= model.low_c[index]) & (temperature_c <= model.high_c[index])
        expected = np.polynomial.polynomial.polyval(temperature_c, model.polynomial_dph[index])
        np.testing.assert_allclose(table[f"bias_{axis}_dph"], np.where(inside, expected, np.nan), atol=1e-8)
    declared = declared_model(closure).compensation.polynomial_dph
    middle = table.iloc[len(table) // 2]
    expected = np.polynomial.polynomial.polyval(middle["temperature_c"], declared[1])
    assert middle["declared_bias_y_dph"] == pytest.approx(expected, abs=1e-8)


def test_the_terms_give_back_every_number_of_the_compensation(exported):
    import pandas as pd

    closure, out = exported
    terms, model = pd.read_csv(out / "compensation_terms.csv"), model_with_effects(closure).compensation
    for number, rows in terms.groupby("number"):
        np.testing.assert_allclose(rows["value"], getattr(model, number).ravel(), rtol=1e-8)
    cubic = terms[(terms["number"] == "polynomial_dph") & (terms["index"] == "degree 3")]
    assert set(cubic["unit"]) == {"deg/h per degC^3"}
    effects = {term for term in terms["term"].dropna() if term != "declared"}
    assert effects == set(model.terms())


def test_the_file_is_one_that_a_run_takes(exported):
    closure, out = exported
    read = read_compensation_file(out / "compensation.yaml")
    loaded, model = read.compensation(), model_with_effects(closure).compensation
    np.testing.assert_array_equal(loaded.polynomial_dph, model.polynomial_dph)
    assert loaded.terms() == model.terms()
    assert read.serial_number == closure.campaign.unit


def test_verdict_and_what_is_left_out_are_reported(exported):
    closure, out = exported
    about = json.loads((out / "export.json").read_text())["files"]["compensation_table.csv"]
    assert about["verdict"] == closure.verdict
    assert about["notes"] == list(model_with_effects(closure).notes)
    assert about["units"]["temperature_c"] == "degC"
