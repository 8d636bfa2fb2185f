import shutil

import can
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gyrobench.bench.dwells.measurement_setup import measurement_setup
from gyrobench.bench.exchange.can_export import TimedLog, write_blf
from gyrobench.bench.exchange.run_export import DataKind, ExportSelection, Format, export_run
from gyrobench.bench.foundations.errors import RunFolderError
from gyrobench.bench.runs.can_log import BlfWriter, read_can_log
from gyrobench.bench.runs.folder import RunFolder
from gyrobench.bench.runs.journal import read_journal
from gyrobench.bench.runs.marks import DwellMarks
from gyrobench.bench.runs.provenance import started_utc
from gyrobench.bench.station.station import Station
from tests.bench.exchange.frames import assert_same, frames_of, strange_parts


def test_a_blf_file_holds_every_frame_with_its_calendar_time(two_dwells, messages, tmp_path):
    path = tmp_path / "can.blf"
    write_blf(path, TimedLog(two_dwells))
    with can.BLFReader(path) as reader:
        assert_same(list(reader), messages)


def test_frames_of_all_kinds_survive(tmp_path):
    path, parts = tmp_path / "can.blf", strange_parts()
    write_blf(path, parts)
    assert_same(frames_of(path), [message for _, frames in parts for message in frames.messages()])


@pytest.fixture
def copied(two_dwells, tmp_path):
    shutil.copytree(two_dwells.path, tmp_path / "run")
    return RunFolder(tmp_path / "run")


def rewrite(folder, change):
    """Write the parts of a log again with other times."""
    parts = list(read_can_log(folder.can))
    for number, frames in parts:
        with (folder.can / f"part-{number:05d}.blf").open("wb") as stream:
            writer = BlfWriter(stream)
            writer.write(frames.with_fields(time_s=change(number, frames.timestamp_s)))
            writer.finish()


def test_parts_with_calendar_times_stay_as_they_are(two_dwells):
    log = TimedLog(two_dwells)
    placed = {number: frames.timestamp_s.tolist() for number, frames in log}
    logged = {number: frames.timestamp_s.tolist() for number, frames in read_can_log(two_dwells.can)}
    assert placed == {number: times for number, times in logged.items() if times}
    assert log.estimated == []


def test_a_dwell_reports_the_time_where_the_adapter_has_a_clock_of_its_own(two_dwells, copied):
    began_s = started_utc(two_dwells).timestamp()
    rewrite(copied, lambda number, time_s: time_s - began_s + 100.0 * number)
    log, good = TimedLog(copied), list(TimedLog(two_dwells))
    placed = list(log)
    assert sum(len(frames) for _, frames in placed) == sum(len(frames) for _, frames in good)
    for (number, frames), (_, right) in zip(placed, good, strict=True):
        exact = number in log.finished
        assert exact != (number in log.estimated)
        off_s = frames.timestamp_s[0] - right.timestamp_s[0]
        assert abs(off_s) < (1.1 if exact else 30.0)  # a tick; the way from dwell to dwell
        assert np.ptp(frames.timestamp_s) == pytest.approx(np.ptp(right.timestamp_s), abs=1e-5)


def test_a_part_that_was_never_closed_follows_the_one_before(two_dwells, copied):
    lines = copied.journal.read_text().splitlines(keepends=True)
    copied.journal.write_text("".join(line for line in lines if "dwell_finished" not in line))
    last = max(copied.can.glob("*.blf"))
    content = bytearray(last.read_bytes())
    content[40:72] = bytes(32)  # begin and end, which are written when a part is closed
    last.write_bytes(content)
    log = TimedLog(copied)
    *_, (_, before), (number, frames) = log
    assert log.estimated == [number]
    assert frames.timestamp_s[0] == before.timestamp_s[-1]
    *_, (_, right) = TimedLog(two_dwells)
    assert abs(frames.timestamp_s[0] - right.timestamp_s[0]) < 30.0


@pytest.fixture(scope="module")
def of_run(two_dwells, tmp_path_factory):
    import pandas as pd

    out = tmp_path_factory.mktemp("navigation")
    export_run(two_dwells, ExportSelection([DataKind.NAVIGATION]), out)
    return pd.read_parquet(out / "navigation.parquet")


@pytest.fixture(scope="module")
def decoded(two_dwells):
    """What the bench itself decodes, part by part."""
    setup = measurement_setup(Station(two_dwells.station))
    return {number: setup.decode(frames.data_frames()) for number, frames in read_can_log(two_dwells.can)}


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


def test_rows_of_a_dwell_can_be_distinguished_from_those_between(of_run, two_dwells):
    finished = [entry for entry in read_journal(two_dwells.journal) if entry["event"] == "dwell_finished"]
    for entry in finished:
        marks = DwellMarks.from_json(entry["marks"])
        rows = of_run[of_run["dwell"] == marks.dwell]
        assert set(rows["part"]) == {marks.log_part}
        assert rows["time_s"].max() == pytest.approx(marks.end_s, abs=1.1)
    assert (of_run["dwell"] == 0).any()


def test_one_dwell_alone_can_be_had_as_csv(of_run, two_dwells, tmp_path):
    import pandas as pd

    export_run(two_dwells, ExportSelection([DataKind.NAVIGATION], [Format.CSV], dwell=2), tmp_path)
    table = pd.read_csv(tmp_path / "navigation_dwell_2.csv")
    (part,) = set(of_run.loc[of_run["dwell"] == 2, "part"])
    whole = of_run[of_run["part"] == part]
    assert len(table) == len(whole)
    np.testing.assert_allclose(table["yaw_deg"], whole["yaw_deg"])


def test_a_dwell_that_was_not_finished_is_reported(two_dwells, tmp_path):
    with pytest.raises(RunFolderError, match="no finished dwell 7; finished are 1 to 2"):
        export_run(two_dwells, ExportSelection([DataKind.NAVIGATION], dwell=7), tmp_path)
    assert not (tmp_path / "navigation_dwell_7.parquet").exists()
