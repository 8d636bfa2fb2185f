"""The Python interface, as a person types it."""

import math
import subprocess
import sys
import tarfile
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

import gyrobench
from gyrobench.bench.bias.parameters import PriorKnowledge
from gyrobench.bench.foundations.errors import DocumentError, MeasurementError, RunFolderError
from gyrobench.bench.foundations.shipped import find_document


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    return gyrobench.run("ten_minute_check", world="ideal", out=tmp_path_factory.mktemp("api") / "run")


def test_importing_the_package_loads_nothing_heavy():
    code = "import sys, gyrobench; print([m for m in ('numpy', 'pydantic', 'can') if m in sys.modules])"
    answer = subprocess.run((sys.executable, "-c", code), capture_output=True, text=True, check=True)
    assert answer.stdout.strip() == "[]"


def test_tables_of_a_run_have_units_text_and_numbers(run):
    import pandas as pd

    assert isinstance(run.dwells, pd.DataFrame)
    assert run.dwells.attrs["units"]["bias_x_dph"] == "deg/h"
    assert run.dwells["position"].tolist() == ["z_up"]
    assert run.dwells["flags"].tolist() == [""]
    assert run.bias_bins["bias_dph"].notna().sum() == 3
    combined = run.budget[run.budget["contribution"] == "combined"]
    assert combined["sigma"].tolist()[:3] == pytest.approx(run.bias_bins["sigma_dph"].dropna().tolist())
    assert combined["expanded"].gt(combined["sigma"]).all()
    assert {"time_s", "chamber_c", "gyro_x_c"} <= set(run.telemetry)
    assert run.telemetry.attrs["units"]["chamber_c"] == "degC"


def test_a_bias_from_the_arrays_of_a_dwell_is_that_of_the_table(run):
    """The table takes the turn from the rate table, the arrays from the INS: 0.02 sigma apart at most."""
    navigation = run.navigation(1)
    readings = navigation.temperatures
    estimate = gyrobench.estimate_bias(
        navigation.ins_time_s,
        navigation.velocity_enu_mps,
        navigation.attitude,
        windows_s=run.windows_s(1),
        position="z_up",
        latitude_deg=36.4,
        height_m=60.0,
        arw_deg_per_sqrt_h=0.0006,
        vrw_ug_per_sqrt_hz=5.0,
        velocity_lsb_mps=1e-4,
        case_c=np.interp(navigation.ins_time_s, readings.ins_time_s, readings.case_c),
        prior=PriorKnowledge.from_datasheet(latitude_arcmin=0.02),
    )
    sigma = run.dwells.filter(regex="^sigma_._dph$").to_numpy()[0]
    bias = run.dwells.filter(regex="^bias_._dph$").to_numpy()[0]
    assert np.all(np.abs(estimate.bias_dph - bias) < 0.02 * sigma)
    assert np.allclose(estimate.sigma_dph, sigma, rtol=0.01)


def test_frames_of_a_dwell_are_bytes_as_they_came(run):
    frames = run.frames(1)
    assert len(frames) > 10_000
    assert frames["timestamp_s"].is_monotonic_increasing
    assert all(len(data) == length for data, length in zip(frames["data"], frames["length"], strict=True))


def test_figures_are_matplotlib_s(run):
    figures = run.figures()
    assert {"temperature", "bias_x", "bias_y", "bias_z"} <= set(figures)
    assert all(isinstance(figure, Figure) for figure in figures.values())


def test_a_search_takes_a_file_or_a_data_frame(tmp_path):
    with tarfile.open(Path(__file__).parents[1] / "data/run_folders/campaign.tar.xz") as archive:
        archive.extractall(tmp_path, filter="data")
    [folder] = [path.parent for path in tmp_path.rglob("journal.jsonl")]
    table = gyrobench.open_run(folder).dwells
    from_frame, from_folder = gyrobench.close_loop(table), gyrobench.close_loop(folder)
    assert from_frame.verdict == from_folder.verdict
    assert len(repr(from_frame)) < 200  # what a notebook shows
    assert from_frame.error_before_dph == pytest.approx(from_folder.error_before_dph)
    halves = [tmp_path / "one.csv", tmp_path / "two.csv"]
    for path, part in zip(halves, (table[table.cycle == 1], table[table.cycle > 1]), strict=True):
        part.to_csv(path, index=False)
    assert gyrobench.close_loop(halves).error_before_dph == pytest.approx(from_frame.error_before_dph)


def test_what_cannot_be_used_is_refused_with_its_reason(run, tmp_path):
    with pytest.raises(RunFolderError, match="is not a run folder"):
        gyrobench.open_run(tmp_path)
    with pytest.raises(RunFolderError, match="no finished dwell 7"):
        run.frames(7)
    with pytest.raises(MeasurementError, match="there is no position 'up'"):
        gyrobench.estimate_bias(
            np.arange(3.0),
            np.zeros((3, 3)),
            np.zeros((3, 3, 3)),
            windows_s=[(0.0, 2.0)],
            position="up",
            latitude_deg=36.4,
            arw_deg_per_sqrt_h=0.001,
        )
    with pytest.raises(DocumentError):
        gyrobench.run("no_such_procedure", out=tmp_path / "never")
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        gyrobench.nothing  # noqa: B018


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"times_s": [0.0, math.nan, 2.0]}, "times_s must be finite and increase"),
        ({"times_s": [2.0, 1.0, 0.0]}, "times_s must be finite and increase"),
        ({"times_s": ["a", "b", "c"]}, "times_s is not an array of numbers"),
        ({"times_s": np.zeros((3, 1))}, "do not fit together"),
        ({"velocity_enu_mps": np.zeros((2, 3))}, "do not fit together"),
        ({"attitude": None}, "do not fit together"),
        ({"attitude": np.tile(2.0 * np.eye(3), (3, 1, 1))}, "no rotation matrix in row 0"),
        (
            {"attitude": [np.eye(3), np.eye(3), np.diag([1, 1, -1])]},
            "attitude is no rotation matrix in row 2",
        ),
        ({"windows_s": []}, "windows_s must be pairs"),
        ({"windows_s": [0.0, 2.0]}, "windows_s must be pairs"),
        ({"windows_s": [(2.0, 0.0)]}, "windows_s must be pairs"),
        ({"windows_s": [(math.nan, 2.0)]}, "windows_s must be pairs"),
        ({"case_c": [20.0, 21.0]}, r"case temperatures \(2,\)"),
        ({"velocity_lsb_mps": -1.0}, "must not be negative"),
        ({"arw_deg_per_sqrt_h": None}, "arw_deg_per_sqrt_h must be a finite number; found None"),
        ({"latitude_deg": "36 N"}, "latitude_deg must be a finite number; found '36 N'"),
        ({"height_m": math.nan}, "height_m must be a finite number; found nan"),
        ({"azimuth_deg": [0.0, 180.0]}, "azimuth_deg must be a finite number"),
        ({"arw_deg_per_sqrt_h": -1.0}, "must not be negative"),
        ({"vrw_ug_per_sqrt_hz": math.inf}, "vrw_ug_per_sqrt_hz must be a finite number; found inf"),
        ({}, "the window from 0 to 2 s has 3 epochs, required: 30; times_s is from 0 to 2 s. Give both"),
        ({"times_s": [0.0, 1e3, 2e3]}, "has 1 epoch, required: 30; times_s is from 0 to 2000 s"),
    ],
)
def test_arrays_that_are_not_those_of_a_dwell_are_refused(change, message):
    arguments = {
        "times_s": np.arange(3.0),
        "velocity_enu_mps": np.zeros((3, 3)),
        "attitude": np.tile(np.eye(3), (3, 1, 1)),
        "windows_s": [(0.0, 2.0)],
        "position": "z_up",
        "latitude_deg": 36.4,
        "arw_deg_per_sqrt_h": 0.001,
    }
    with pytest.raises(MeasurementError, match=message):
        gyrobench.estimate_bias(**(arguments | change))


@pytest.mark.parametrize("table", [[], None, 3])
def test_a_search_without_a_table_is_refused(table):
    with pytest.raises(DocumentError, match="takes a dwell table, a run folder or a DataFrame"):
        gyrobench.close_loop(table)


@pytest.mark.parametrize("given", [{"world": "ideal"}, {"faults": "now_and_then"}])
def test_a_world_for_real_instruments_is_refused(tmp_path, given):
    with pytest.raises(DocumentError, match="no instrument of this station is emulated"):
        gyrobench.run("ten_minute_check", "example_bench", out=tmp_path, **given)


def test_a_negative_seed_is_refused(tmp_path):
    with pytest.raises(DocumentError, match="seed must not be negative; found -1"):
        gyrobench.run("ten_minute_check", seed=-1, out=tmp_path / "never")


def test_an_instrument_past_due_is_used_if_that_is_acknowledged(tmp_path):
    calibration = "{serial_number: A, certificate: B, calibrated: 2020-01-01, due: 2021-01-01"
    text = find_document("stations", "emulated").read_text()
    text += f"traceability:\n  chamber_sensors: {calibration}, uncertainty: {{value: 0.1, unit: K}}}}\n"
    station = tmp_path / "station.yaml"
    station.write_text(text)
    with pytest.raises(DocumentError, match="run with --acknowledge chamber_sensors"):
        gyrobench.run("ten_minute_check", str(station), out=tmp_path)
    with pytest.raises(RunFolderError, match="is not empty"):
        gyrobench.run("ten_minute_check", str(station), out=tmp_path, acknowledged=["chamber_sensors"])
