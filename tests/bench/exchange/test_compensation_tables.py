import json

import numpy as np
import pytest

from gyrobench.bench.closure.loadable_model import declared_model, model_with_effects
from gyrobench.bench.exchange.export_folder import ExportFolder
from gyrobench.bench.exchange.run_export import compensation_files, export_compensation
from gyrobench.bench.runs.compensation_file import read_compensation_file
from tests.bench.report import made_up_closure


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
    assert names == {*compensation_files([".csv", ".parquet"]), "export.json"}


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
