"""docs/tables.md names everything that a run folder holds, and nothing that no table has."""

import re
from dataclasses import fields, replace
from pathlib import Path

import pytest

from gyrobench.bench.bias import dwell_table
from gyrobench.bench.bias.allan import AllanVariance, RateNoise
from gyrobench.bench.bias.bins import BIAS_BINS_TABLE
from gyrobench.bench.bias.error_sources import SOURCES
from gyrobench.bench.bias.noise_estimate import ChannelNoise, NoiseEstimate
from gyrobench.bench.bias.vertical_pairs import Finding
from gyrobench.bench.closure.campaign import Table
from gyrobench.bench.closure.files import closure_document, model_document, prediction_columns
from gyrobench.bench.closure.loop import hold_out_each
from gyrobench.bench.closure.quantity import GYRO_BIAS
from gyrobench.bench.runs.folder import RunFolder
from gyrobench.bench.runs.tables import calibration_check_table
from gyrobench.bench.runs.tables.budget_table import ANY_POWER_CYCLE, COMBINED, BudgetRow
from gyrobench.bench.runs.tables.coefficient_table import PlateauCoefficientRow
from gyrobench.bench.runs.tables.joint_table import JOINT_BIASES_TABLE, JOINT_PLATEAUS_TABLE
from gyrobench.bench.verification.compensation_verification import COMPARISON_TABLE
from tests.bench.report.made_up_closure import explained

TEXT = (Path(__file__).parents[2] / "docs" / "tables.md").read_text(encoding="utf-8")


def names(kind):
    return {field.name for field in fields(kind)}


def section(title):
    [text] = re.findall(rf"^## {re.escape(title)}\n(.*?)(?=^## |\Z)", TEXT, re.MULTILINE | re.DOTALL)
    return text


def named_in_tables(text):
    """What stands in backticks in the first cell of a row."""
    cells = re.findall(r"^\|([^|]*)\|", text, re.MULTILINE)
    return {name for cell in cells for name in re.findall(r"`([^`]+)`", cell)}


def values_of_findings():
    return {finding.name.lower() for finding in Finding}


@pytest.mark.parametrize(
    ("title", "expected"),
    [
        ("dwells.csv", set(dwell_table.COLUMNS)),
        ("bias_bins.csv", set(BIAS_BINS_TABLE.columns)),
        ("budget.csv", names(BudgetRow) | set(SOURCES) | {COMBINED, ANY_POWER_CYCLE}),
        ("joint.csv", set(JOINT_PLATEAUS_TABLE.columns) | {"finding"} | values_of_findings()),
        ("joint_biases.csv", set(JOINT_BIASES_TABLE.columns)),
        ("verification.csv", set(calibration_check_table.CALIBRATION_CHECK_TABLE.columns)),
        ("coefficients.csv", names(PlateauCoefficientRow)),
        ("noise.json", names(NoiseEstimate) | names(ChannelNoise)),
        ("predictions.csv", set(prediction_columns(GYRO_BIAS))),
        ("comparison.csv", set(COMPARISON_TABLE.columns)),
    ],
)
def test_the_page_names_the_columns_that_a_table_has_and_no_others(title, expected):
    assert named_in_tables(section(title)) == expected


def test_the_page_names_the_keys_of_what_a_search_for_effects_leaves():
    document, model = closure_document(explained()), model_document(explained())
    effect, tried = document["effects"][0], document["tried"][0]
    assert named_in_tables(section("closure.json")) == {*document, *effect, *tried}
    campaign = replace(explained().campaign, tables=(Table("dwells.csv", (1, 2, 3)),))
    several = closure_document(hold_out_each(replace(explained(), campaign=campaign)))
    text = set(re.findall(r"`([a-z_]+)`", section("closure.json")))
    assert {*several["tables"][0], *several["rotation"][0]} <= text
    assert named_in_tables(section("model.yaml")) == set(model)
    named = set(re.findall(r"`([a-z_]+)`", section("model.yaml")))
    assert {*model["effects"][0], *model["declared_dph"]["x"]} <= named


def test_the_page_names_what_an_allan_variance_and_its_fit_hold():
    named = set(re.findall(r"`([a-z_]+)`", section("noise.json")))
    in_file = names(RateNoise) - {"excess"} | {"misfit"}
    assert names(AllanVariance) | in_file <= named


def test_the_page_names_every_file_of_a_run_folder():
    folder = RunFolder(Path("run"))
    paths = [value for name in dir(RunFolder) if isinstance(value := getattr(folder, name), Path)]
    files = {path.name for path in paths if path != folder.path}
    assert "dwells.csv" in files
    assert files <= {name.rstrip("/") for name in named_in_tables(section("Files"))}
