import math
from dataclasses import replace

import pytest

from gyrobench.bench.bias.dwell_table import write_dwells
from gyrobench.bench.dwells.calibration import read_calibration
from gyrobench.bench.foundations.errors import DocumentError
from tests.bench.dwells.test_verification import calibrated

ROWS = [calibrated(dwell=1), calibrated("y_up", dwell=2, flags="door opened")]


@pytest.fixture
def table(tmp_path):
    write_dwells(tmp_path / "dwells.csv", ROWS)
    return tmp_path / "dwells.csv"


def test_a_run_folder_and_its_table_give_the_same_dwells(table):
    rows = read_calibration(table)
    assert [(row.dwell, row.position, row.flags) for row in rows] == [
        (1, "z_up", ""),
        (2, "y_up", "door opened"),
    ]
    assert rows[0].accelerometer_ug == (60.0, -40.0, 50.0)
    assert read_calibration(table.parent) == rows


def test_the_table_may_have_another_name(table):
    assert read_calibration(table.rename(table.parent / "unit 7.csv"))[0].unit == "U7"


def test_a_table_without_accelerometers_will_do(table):
    nothing = (math.nan,) * 3
    write_dwells(table, [replace(ROWS[0], accelerometer_ug=nothing, accelerometer_sigma_ug=nothing)])
    assert math.isnan(read_calibration(table)[0].accelerometer_ug[0])


def test_what_is_not_there_is_told(tmp_path):
    with pytest.raises(DocumentError, match=r"nowhere: does not exist\. Give a run folder"):
        read_calibration(tmp_path / "nowhere")
    with pytest.raises(DocumentError, match=r"holds no dwells\.csv, so it is no calibration"):
        read_calibration(tmp_path)


def test_a_table_without_a_good_dwell_is_no_calibration(table):
    for rows in ([], ROWS[1:]):
        write_dwells(table, rows)
        with pytest.raises(DocumentError, match=r"dwells\.csv: has no dwell that gave a bias"):
            read_calibration(table.parent)


def test_a_wrong_table_is_told_with_its_place(table):
    table.write_text(table.read_text().replace("z_up", "Z_UP"))
    with pytest.raises(DocumentError, match=r"dwells\.csv:2: column position"):
        read_calibration(table.parent)
