import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

from gyrobench.bench.dwells.marks import DwellMarks
from gyrobench.bench.dwells.setup import measurement_setup
from gyrobench.bench.export.run_export import export_run
from gyrobench.bench.export.wanted import Format, Wanted, What
from gyrobench.bench.foundations.errors import RunFolderError
from gyrobench.bench.runs.can_log import read_can_log
from gyrobench.bench.runs.journal import read_journal
from gyrobench.bench.station.station import Station
from gyrobench.drivers.ins.can_bus import FrameBlock


@pytest.fixture(scope="module")
def of_run(two_dwells, tmp_path_factory):
    out = tmp_path_factory.mktemp("navigation")
    export_run(two_dwells, Wanted([What.NAVIGATION]), out)
    return pd.read_parquet(out / "navigation.parquet")


@pytest.fixture(scope="module")
def decoded(two_dwells):
    """What the bench itself decodes, part by part."""
    setup = measurement_setup(Station(two_dwells.station))
    return {
        number: setup.decode(FrameBlock.from_messages(messages))
        for number, messages in read_can_log(two_dwells.can)
    }


def test_navigation_is_what_the_bench_measures_from(of_run, decoded):
    for number, data in decoded.items():
        part = of_run[of_run["part"] == number]
        np.testing.assert_array_equal(part["ins_time_s"], data.ins_time_s)
        np.testing.assert_array_equal(
            part[[f"velocity_{axis}_mps" for axis in ("east", "north", "up")]], data.velocity_enu_mps
        )
        known = part["quaternion_w"].notna().to_numpy()
        quaternion = part.loc[known, [f"quaternion_{each}" for each in "xyzw"]].to_numpy(copy=True)
        np.testing.assert_allclose(
            Rotation.from_quat(quaternion).as_matrix(), data.attitude[known], atol=1e-12
        )
        np.testing.assert_array_equal(known, np.isfinite(data.attitude).all(axis=(1, 2)))


def test_temperatures_are_the_last_ones_sent(of_run, decoded):
    for number, data in decoded.items():
        part = of_run[of_run["part"] == number].reset_index(drop=True)
        sent = data.temperatures
        if len(sent.ins_time_s) < 2:
            continue
        row = part["ins_time_s"].searchsorted(sent.ins_time_s[1])
        assert part["gyro_y_c"][row] == sent.optics_c[1, 1]
        assert part["gyro_y_c"][row - 1] == sent.optics_c[0, 1]
        assert part["board_z_c"][row] == sent.electronics_c[1, 2]


def test_rows_of_a_dwell_can_be_told_from_those_between(of_run, two_dwells):
    finished = [entry for entry in read_journal(two_dwells.journal) if entry["event"] == "dwell_finished"]
    for entry in finished:
        marks = DwellMarks.from_json(entry["marks"])
        rows = of_run[of_run["dwell"] == marks.dwell]
        assert set(rows["part"]) == {marks.log_part}
        assert rows["time_s"].max() == pytest.approx(marks.end_s, abs=1.1)
    assert (of_run["dwell"] == 0).any()


def test_one_dwell_alone_can_be_had_as_csv(of_run, two_dwells, tmp_path):
    export_run(two_dwells, Wanted([What.NAVIGATION], [Format.CSV], dwell=2), tmp_path)
    table = pd.read_csv(tmp_path / "navigation_dwell_2.csv")
    (part,) = set(of_run.loc[of_run["dwell"] == 2, "part"])
    whole = of_run[of_run["part"] == part]
    assert len(table) == len(whole)
    np.testing.assert_allclose(table["yaw_deg"], whole["yaw_deg"])


def test_a_dwell_that_was_not_finished_is_told(two_dwells, tmp_path):
    with pytest.raises(RunFolderError, match="no finished dwell 7; finished are 1 to 2"):
        export_run(two_dwells, Wanted([What.NAVIGATION], dwell=7), tmp_path)
    assert not (tmp_path / "navigation_dwell_7.parquet").exists()
