"""The raw CAN log with calendar times: as one BLF file, and decoded to navigation data.

Attitude is given as a quaternion, since Euler angles are undefined if an axis is vertical, and as roll, pitch
and yaw of the sequence ``C_nb = Rz(yaw) Rx(pitch) Ry(roll)``; body axes and East-North-Up, yaw positive about
Up.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pyarrow as pa
from scipy.spatial.transform import Rotation

from gyrobench.bench.dwells.measurement_setup import MeasurementSetup
from gyrobench.bench.dwells.run_dwells import finished_marks
from gyrobench.bench.exchange.export_folder import ExportFolder, field_of
from gyrobench.bench.foundations.arrays import FloatArray
from gyrobench.bench.foundations.errors import RunFolderError
from gyrobench.bench.navigation.attitude import euler_rpy321
from gyrobench.bench.navigation.positions import AXES
from gyrobench.bench.runs.can_log import BlfWriter, read_can_log
from gyrobench.bench.runs.folder import RunFolder
from gyrobench.bench.runs.marks import DwellMarks
from gyrobench.bench.runs.provenance import started_utc
from gyrobench.drivers.frames import FrameBlock
from gyrobench.drivers.ins.navigation_data import NavigationData

#: Column of calendar times.
UTC_FIELD = pa.field("utc", pa.timestamp("us", tz="UTC"))
_MICROSECONDS = 1e6


def calendar_times(start: datetime, time_s: FloatArray) -> pa.Array:
    """Calendar times of times (n,) in seconds after ``start``."""
    begin_us = round(start.timestamp() * _MICROSECONDS)
    times_us = begin_us + np.rint(time_s * _MICROSECONDS).astype(np.int64)
    return pa.array(times_us, pa.int64()).cast(UTC_FIELD.type)


#: 1990-01-01 UTC: earlier time stamps are not calendar times.
_FIRST_CALENDAR_S = 631_152_000.0


#: Number of a part of the log, and its frames with time stamps in seconds since 1970 UTC.
TimedPart = tuple[int, FrameBlock]


class TimedLog:
    """The parts of a run's log that hold frames, with calendar times; only one part is in memory at a time.

    A part that was never closed, or was stamped by the CAN adapter's own clock, has times relative to its
    first frame. Its times follow from the finished dwell in it, whose marks are in ``finished`` by part;
    without one, the part is placed at the end of the previous part, and ``estimated`` lists it.

    Raises RunFolderError if log, journal or provenance can't be read.
    """

    def __init__(self, folder: RunFolder) -> None:
        self.finished = {marks.log_part: marks for marks in finished_marks(folder)}
        self.estimated: list[int] = []
        self.start_s = started_utc(folder).timestamp()
        self._folder = folder.can

    def __iter__(self) -> Iterator[TimedPart]:
        end_s = self.start_s
        for number, frames in read_can_log(self._folder):
            if not len(frames):
                continue
            if frames.timestamp_s[0] < _FIRST_CALENDAR_S:
                shift_s = self._shift_s(number, frames, end_s)
                frames = frames.with_fields(time_s=frames.timestamp_s + shift_s)
            end_s = float(frames.timestamp_s[-1])
            yield number, frames

    def _shift_s(self, number: int, frames: FrameBlock, end_s: float) -> float:
        """Offset, s, from the time stamps of a part to calendar times."""
        marks = self.finished.get(number)
        if marks is not None and marks.windows[0].first_frame < len(frames):
            window_start_s = self.start_s + marks.start_s
            return float(window_start_s - frames.timestamp_s[marks.windows[0].first_frame])
        self.estimated.append(number)
        return float(end_s - frames.timestamp_s[0])


def write_blf(path: Path, parts: Iterable[TimedPart]) -> None:
    """Write all frames, with calendar times."""
    with path.open("wb") as stream:
        writer = BlfWriter(stream)
        for _, frames in parts:
            writer.write(frames)
        writer.finish()


_ATTITUDE = "C_nb, body to East-North-Up; C_nb = Rz(yaw) Rx(pitch) Ry(roll), yaw positive about Up"
_EPOCH = datetime.fromtimestamp(0.0, UTC)
_FLOAT_COLUMNS = (
    "time_s",
    "ins_time_s",
    *(f"velocity_{axis}_mps" for axis in ("east", "north", "up")),
    *(f"quaternion_{part}" for part in "wxyz"),
    *(f"{angle}_deg" for angle in ("roll", "pitch", "yaw")),
    *(f"gyro_{axis}_c" for axis in AXES),
    *(f"board_{axis}_c" for axis in AXES),
    "case_c",
)
_INTEGER_COLUMNS = ("part", "dwell", "segment", "mode")
_SCHEMA = pa.schema(
    [
        UTC_FIELD,
        *(field_of(name) for name in _FLOAT_COLUMNS),
        *(pa.field(name, pa.int64()) for name in _INTEGER_COLUMNS),
    ]
)


def export_navigation(
    folder: RunFolder, setup: MeasurementSetup, name: str, destination: ExportFolder, dwell: int | None
) -> None:
    """Write decoded navigation of a run, or of one finished dwell; one part of the log is read at a time.

    Raises RunFolderError if the log can't be read, there is no such dwell, or the file can't be written.
    """
    log = TimedLog(folder)
    selected = {number for number, marks in log.finished.items() if marks.dwell == dwell}
    if dwell is not None and not selected:
        numbers = sorted(marks.dwell for marks in log.finished.values())
        available = f"finished are {numbers[0]} to {numbers[-1]}" if numbers else "none is finished"
        raise RunFolderError(f"{folder.path}: has no finished dwell {dwell}; {available}")
    batches = (
        _table(number, setup.decode(frames.data_frames()), log.finished.get(number), log.start_s)
        for number, frames in log
        if dwell is None or number in selected
    )
    destination.table(name, _SCHEMA, batches, source=folder.can.name, attitude=_ATTITUDE)


def _table(part: int, data: NavigationData, marks: DwellMarks | None, start_s: float) -> pa.Table:
    """Table of one part; frames after its dwell belong to no dwell."""
    values = dict(zip(_FLOAT_COLUMNS, _float_values(data, start_s), strict=True))
    columns = {name: pa.array(column, pa.float64(), from_pandas=True) for name, column in values.items()}
    is_in_dwell = data.row < (marks.frame_count if marks else 0)
    integers = {
        "part": np.full(len(data.row), part),
        "dwell": np.where(is_in_dwell, marks.dwell if marks else 0, 0),
        "segment": data.segment,
        "mode": data.mode.astype(np.int64),
    }
    utc = calendar_times(_EPOCH, data.timestamp_s)
    return pa.table({UTC_FIELD.name: utc, **columns, **integers}).select(_SCHEMA.names)


def _float_values(data: NavigationData, start_s: float) -> list[FloatArray]:
    """Values of the float columns, in their order."""
    quaternion = np.full((len(data.row), 4), np.nan)
    is_known = np.isfinite(data.attitude).all(axis=(1, 2))
    if is_known.any():
        quaternion[is_known] = Rotation.from_matrix(data.attitude[is_known]).as_quat(canonical=True)[
            :, [3, 0, 1, 2]
        ]
    temperatures = data.temperatures
    temperatures_c = np.column_stack([temperatures.optics_c, temperatures.electronics_c, temperatures.case_c])
    return [
        data.timestamp_s - start_s,
        data.ins_time_s,
        *data.velocity_enu_mps.T,
        *quaternion.T,
        *np.rad2deg(euler_rpy321(data.attitude)).T,
        *_last_values(temperatures_c, temperatures.ins_time_s, data).T,
    ]


def _last_values(values: FloatArray, time_s: FloatArray, data: NavigationData) -> FloatArray:
    """Latest of the values (m, k), sent at times (m,), at each epoch (n,); NaN before the first."""
    latest = np.full((len(data.row), values.shape[1]), np.nan)
    restarts = np.concatenate([[0], np.cumsum(np.diff(time_s) < 0.0)])[: len(time_s)]
    for segment in np.unique(data.segment):
        is_epoch, is_sent = data.segment == segment, restarts == segment
        last = np.searchsorted(time_s[is_sent], data.ins_time_s[is_epoch], side="right") - 1
        rows = np.flatnonzero(is_epoch)[last >= 0]
        latest[rows] = values[is_sent][last[last >= 0]]
    return latest
