import math
from contextlib import suppress
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gyrobench.bench.foundations.errors import DocumentError
from gyrobench.bench.navigation.positions import AXES, POSITIONS
from gyrobench.bench.runs.tables.calibration_check_table import (
    CALIBRATION_CHECK_TABLE,
    METHODS,
    CalibrationCheckRow,
)

ROW = CalibrationCheckRow(
    unit="U7",
    run="R1-1",
    dwell=3,
    turned_dwell=4,
    cycle=1,
    position="y_up",
    azimuth_deg=90.0,
    gyro="z",
    method="alignment",
    temperature_c=-10.25,
    bias_dph=-0.0123456789,
    sigma_dph=0.0011,
    paper_bias_dph=-0.0135,
    paper_sigma_dph=0.0018,
    accelerometer_ug=31.5,
    accelerometer_sigma_ug=2.5,
    calibrated_dph=-0.0119,
    calibrated_sigma_dph=0.0007,
    difference_dph=-0.0004,
    difference_sigma_dph=0.0013,
    p_value=0.75,
    flags=(),
)
FLAGGED = CalibrationCheckRow("U7", "R1-1", 5, None, 1, "z_up", 0.0, "x", "velocity", flags=("gap, of 6 s",))

numbers = st.floats(-1e6, 1e6)
maybe = numbers | st.just(math.nan)
sigmas = st.floats(1e-9, 1.0)
maybe_sigmas = sigmas | st.just(math.nan)
texts = st.text(st.characters(exclude_categories=["Cc", "Cs", "Z"]), max_size=8)
rows = st.builds(
    CalibrationCheckRow,
    unit=texts,
    run=texts,
    dwell=st.integers(0, 10**9),
    turned_dwell=st.none() | st.integers(0, 10**9),
    cycle=st.integers(0, 1000),
    position=st.sampled_from(list(POSITIONS)),
    azimuth_deg=numbers,
    gyro=st.sampled_from(AXES),
    method=st.sampled_from(METHODS),
    temperature_c=st.floats(-273.15, 1000.0) | st.just(math.nan),
    bias_dph=numbers,
    sigma_dph=sigmas,
    paper_bias_dph=maybe,
    paper_sigma_dph=maybe_sigmas,
    accelerometer_ug=numbers,
    accelerometer_sigma_ug=sigmas,
    calibrated_dph=maybe,
    calibrated_sigma_dph=maybe_sigmas,
    difference_dph=maybe,
    difference_sigma_dph=maybe_sigmas,
    p_value=maybe,
    flags=st.lists(texts.filter(bool), max_size=2).map(tuple),
)


def text_of(path, table):
    CALIBRATION_CHECK_TABLE.write(path, table)
    return path.read_text(encoding="utf-8")


@given(st.lists(rows, max_size=4))
def test_reading_and_writing_again_gives_the_same_text(tmp_path, table):
    text = text_of(tmp_path / "verification.csv", table)
    assert (
        text_of(tmp_path / "again.csv", CALIBRATION_CHECK_TABLE.read(tmp_path / "verification.csv")) == text
    )


def test_rows_survive_the_file(tmp_path):
    path = tmp_path / "verification.csv"
    CALIBRATION_CHECK_TABLE.write(path, [ROW, FLAGGED])
    first, second = CALIBRATION_CHECK_TABLE.read(path)
    assert first == ROW
    assert (second.dwell, second.turned_dwell, second.flags) == (5, None, ("gap, of 6 s",))
    assert math.isnan(second.bias_dph)
    assert not second.is_compared


@given(st.sampled_from(CALIBRATION_CHECK_TABLE.columns), st.text(max_size=10))
def test_any_cell_is_read_or_refused(tmp_path, column, text):
    path = tmp_path / "verification.csv"
    cells = text_of(path, [ROW]).splitlines()[1].split(",")
    cells[CALIBRATION_CHECK_TABLE.columns.index(column)] = '"' + text.replace('"', '""') + '"'
    path.write_text(
        ",".join(CALIBRATION_CHECK_TABLE.columns) + "\n" + ",".join(cells) + "\n",
        encoding="utf-8",
        errors="replace",
    )
    with suppress(DocumentError):
        (row,) = CALIBRATION_CHECK_TABLE.read(path)
        assert row.gyro in AXES
        assert row.method in METHODS
        assert not row.sigma_dph <= 0.0


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"bias_dph": math.nan}, "x.csv:2: column bias_dph: expected a number; found ''"),
        ({"sigma_dph": 0.0}, "x.csv:2: column sigma_dph: an uncertainty must be above zero; found 0"),
        ({"difference_sigma_dph": -1.0}, "x.csv:2: column difference_sigma_dph: an uncertainty must"),
        ({"calibrated_sigma_dph": 1e-99}, "x.csv:2: column calibrated_sigma_dph: an uncertainty must"),
        ({"temperature_c": -300.0}, "x.csv:2: column temperature_c: -300 degC is not a gyro temperature"),
        ({"difference_dph": 1e99}, r"x.csv:2: column difference_dph: 1e\+99 is beyond"),
        ({"method": "guess"}, "x.csv:2: column method: expected one of alignment, velocity; found 'guess'"),
        ({"gyro": "w"}, "x.csv:2: column gyro: expected one of x, y, z"),
        ({"azimuth_deg": math.nan}, "x.csv:2: column azimuth_deg: expected a number"),
    ],
)
def test_says_which_cell_is_wrong(tmp_path, change, message):
    CALIBRATION_CHECK_TABLE.write(tmp_path / "x.csv", [replace(ROW, **change)])
    with pytest.raises(DocumentError, match=message):
        CALIBRATION_CHECK_TABLE.read(tmp_path / "x.csv")
