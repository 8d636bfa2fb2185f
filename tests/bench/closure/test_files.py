import csv
import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

from gyrobench.bench.closure.campaign import campaign_of
from gyrobench.bench.closure.effects import all_effects
from gyrobench.bench.closure.effects.laws import BIAS_JUMP, G_SENSITIVITY, TIME_DRIFT
from gyrobench.bench.closure.files import (
    closure_document,
    format_predictions,
    is_written,
    model_document,
    read_held_out_cycles,
    write_closure,
)
from gyrobench.bench.closure.loop import close_loop, hold_out_each
from gyrobench.bench.foundations.errors import RunFolderError
from tests.bench.closure.thermal_bench import SIGMA_DPH, measure

FORMATS = Path(__file__).parents[4] / "shared" / "formats.md"


@pytest.fixture(scope="module")
def explained(closed):
    return closed({"g_sensitivity": 4.0})


def predictions(closure):
    return list(csv.DictReader(format_predictions(closure).splitlines()))


def test_a_closure_is_written_with_its_predictions_and_its_model(explained, tmp_path):
    write_closure(tmp_path / "new" / "folder", explained)
    written = {path.name: path.read_text() for path in (tmp_path / "new" / "folder").iterdir()}
    assert set(written) == {"closure.json", "predictions.csv", "model.yaml"}
    assert json.loads(written["closure.json"])["verdict"] == "explained"
    assert yaml.safe_load(written["model.yaml"]) == model_document(explained)


@pytest.mark.skipif(not FORMATS.exists(), reason="the description of the formats is not beside the checkout")
def test_the_document_has_every_key_that_the_formats_name(explained):
    table = FORMATS.read_text().split("`closure.json`")[1].split("`predictions.csv`")[0]
    keys = {name.strip() for row in re.findall(r"^\| ([a-z_, ]+) \|", table, re.M) for name in row.split(",")}
    document = closure_document(explained)
    assert keys - {"key"} <= set(document)
    of_an_effect = set(re.findall(r"`([a-z_]+)`", table.split("strongest first:")[1].split("\n")[0]))
    assert of_an_effect <= set(document["effects"][0])


def test_the_document_lists_the_effects_found(explained):
    document = closure_document(explained)
    [effect] = document["effects"]
    assert effect["effect"] == "g_sensitivity"
    assert effect["axes"] == ["x", "y", "z"]
    assert effect["tied_with"] == []
    assert document["separating_measurement"] is None
    assert document["lack_of_fit_p_before"] < 1e-3 < document["lack_of_fit_p_after"]
    assert document["error_after_dph"] < 0.5 * document["error_before_dph"]
    assert {each["effect"] for each in document["tried"]} == {each.name for each in all_effects()}


@pytest.mark.parametrize("effects", [None, {"g_sensitivity": 4.0}, {"sinusoid": 1.5}])
def test_the_document_is_json_without_nan(closed, effects):
    text = json.dumps(closure_document(closed(effects)), allow_nan=False)
    assert json.loads(text)["verdict"] in {"clean", "explained", "unexplained"}


def test_shares_are_null_where_nothing_is_beyond_the_noise():
    quiet = campaign_of(measure({"time_drift": 1.2}, noise=0.5).rows)
    closure = close_loop(quiet, effects=[TIME_DRIFT])
    [tried] = closure_document(closure)["tried"]
    assert closure.effects
    assert tried["share_explained_alone"] is None
    assert tried["p_value_alone"] < 1e-3
    json.dumps(closure_document(closure), allow_nan=False)


def test_effects_are_listed_strongest_first():
    rows = measure({"g_sensitivity": 3.0, "bias_jump": 8.0}, cycles=2).rows
    closure = close_loop(campaign_of(rows), effects=[BIAS_JUMP, G_SENSITIVITY])
    document = closure_document(closure)
    assert [each["effect"] for each in document["effects"]] == ["bias_jump", "g_sensitivity"]
    assert document["effects"][0]["rms_dph"] > document["effects"][1]["rms_dph"]


def test_every_dwell_has_its_predictions_held_out_ones_too(explained):
    rows = predictions(explained)
    assert [int(row["dwell"]) for row in rows] == explained.campaign.dwell.tolist()
    assert {int(row["dwell"]) for row in rows} > set(explained.campaign.dwell[~explained.searched])
    assert all(np.isfinite(float(value)) for row in rows for value in row.values())


def test_dwells_without_a_result_are_predicted_too_and_those_without_temperatures_have_empty_cells():
    rows = measure({"g_sensitivity": 4.0}, cycles=2).rows
    rows[4] = replace(rows[4], flags=("vibration",), bias_dph=(np.nan,) * 3)
    rows[8] = replace(rows[8], gyro_c=(np.nan,) * 3)
    closure = close_loop(campaign_of(rows), effects=[G_SENSITIVITY])
    predicted = {int(row.pop("dwell")): [*row.values()] for row in predictions(closure)}
    assert [*predicted] == [row.dwell for row in rows]
    assert predicted[9] == [""] * 12
    after_dph = np.array([float(value) for value in predicted[5][3:6]])
    undisturbed = measure({"g_sensitivity": 4.0}, cycles=2)
    np.testing.assert_allclose(after_dph, undisturbed.bias_dph[4], atol=4.0 * SIGMA_DPH)
    before_dph = np.array([float(value) for value in predicted[5][:3]])
    assert (
        np.abs(before_dph - undisturbed.bias_dph[4]).max()
        > 2.0 * np.abs(after_dph - undisturbed.bias_dph[4]).max()
    )


def test_predictions_give_the_stated_errors(explained):
    held_out = ~explained.searched
    for kind, predicted in (("before", explained.error_before_dph), ("after", explained.error_after_dph)):
        values = [[float(row[f"bias_{axis}_{kind}_dph"]) for axis in "xyz"] for row in predictions(explained)]
        errors = (explained.campaign.bias_dph - values)[held_out]
        assert np.sqrt(np.mean(errors**2)) == pytest.approx(predicted, rel=1e-5)


def test_predictions_have_the_stated_uncertainties(explained):
    sigma_dph = [[float(row[f"sigma_{axis}_after_dph"]) for axis in "xyz"] for row in predictions(explained)]
    np.testing.assert_allclose(sigma_dph, explained.prediction_sigma_dph, rtol=1e-5)


def test_in_clean_data_nothing_is_predicted_otherwise_after(closed):
    for row in predictions(closed()):
        for axis in "xyz":
            assert row[f"bias_{axis}_after_dph"] == row[f"bias_{axis}_before_dph"]
            assert row[f"sigma_{axis}_after_dph"] == row[f"sigma_{axis}_before_dph"]


def test_the_model_gives_the_predictions(explained):
    document, campaign = model_document(explained), explained.campaign
    [effect] = document["effects"]
    [form] = G_SENSITIVITY.forms
    columns = form.columns(campaign, tuple(effect["parameters"].values()))
    for gyro, axis in enumerate("xyz"):
        declared = document["declared_dph"][axis]
        scaled = campaign.gyro_c[:, gyro] / document["scale_c"]
        bias_dph = sum(size * scaled**power for power, size in enumerate(declared["powers"], 1))
        bias_dph += declared["constant_of_run"]["R1"]
        bias_dph += columns[:, gyro] @ [effect["terms_dph"][axis][term] for term in form.terms]
        np.testing.assert_allclose(bias_dph, explained.model.bias_dph[:, gyro], rtol=1e-9)
        low_c, high_c = document["fitted_c"][axis]
        assert low_c == campaign.gyro_c[explained.searched, gyro].min() < high_c


def test_dwells_may_be_numbered_from_any_number():
    rows = [replace(row, dwell=row.dwell + 500) for row in measure(cycles=2).rows]
    closure = close_loop(campaign_of(rows), effects=[])
    assert predictions(closure)[0]["dwell"] == "501"


def test_a_search_that_is_written_is_known_again_with_its_cycles_held_out(closed, explained, tmp_path):
    assert read_held_out_cycles(tmp_path) == []
    assert not is_written(tmp_path, explained)
    write_closure(tmp_path, explained)
    assert read_held_out_cycles(tmp_path) == closure_document(explained)["held_out_cycles"]
    assert is_written(tmp_path, explained)
    assert not is_written(tmp_path, closed({"sinusoid": 1.5}))
    write_closure(tmp_path, hold_out_each(explained))
    assert is_written(tmp_path, explained)
    (tmp_path / "closure.json").write_text("{")
    assert not is_written(tmp_path, explained)


@pytest.mark.parametrize("text", ["", "{}", '{"held_out_cycles": ["last"]}'])
def test_a_damaged_closure_file_is_refused(text, tmp_path):
    (tmp_path / "closure.json").write_text(text)
    with pytest.raises(RunFolderError, match="run gyrobench close again"):
        read_held_out_cycles(tmp_path)
