"""The raw CAN log: every frame received, in BLF files, written and read in bulk.

A BLF file is complete once it is closed, so the log is divided into parts: :meth:`CanLog.cut` ends a part,
which is then on the disk. A part that a kill or a power cut left open can still be read up to its last full
container. Later frames begin a new part, so that frames before and after a gap are never treated as
consecutive.

The format is Vector's, in the form that python-can writes and reads: a header, then containers of deflated
objects, one for each frame. Containers written here never divide an object.
"""

from __future__ import annotations

import contextlib
import io
import math
import os
import struct
from collections.abc import Container, Iterator
from pathlib import Path
from typing import BinaryIO

import can
import numpy as np
from can.io.blf import (
    CAN_ERROR_EXT,
    CAN_MESSAGE,
    FILE_HEADER_SIZE,
    FILE_HEADER_STRUCT,
    LOG_CONTAINER,
    LOG_CONTAINER_STRUCT,
    NO_COMPRESSION,
    OBJ_HEADER_BASE_STRUCT,
    REMOTE_FLAG,
    TIME_ONE_NANS,
    ZLIB_DEFLATE,
    BLFParseError,
    systemtime_to_timestamp,
    timestamp_to_systemtime,
)
from isal import isal_zlib
from numpy.typing import NDArray

from gyrobench.bench.foundations.errors import RunFolderError
from gyrobench.bench.foundations.files import make_folder, read_limited, sync_folder, write_error
from gyrobench.bench.runs.folder import find_parts, part_path
from gyrobench.drivers.frames import ERROR_FRAME, FRAME_DTYPE, REMOTE_FRAME, FrameBlock, concatenate

#: Compresses frames of an INS as well as zlib's fastest level, in a third of its time.
_COMPRESSION_LEVEL = 1
#: Size of a container before compression; Vector's tools write 128 kB.
_MAX_UNPACKED = 128 * 1024
#: No program writes larger containers; damaged bytes could request gigabytes.
_MAX_UNPACKED_READ = 256 * 1024 * 1024
_NS = 1e9
_FILE_HEADER_START = (b"LOGG", FILE_HEADER_SIZE, 5, 0, 0, 0, 2, 6, 8, 1)

_OBJECT_HEADER = [
    ("signature", "S4"), ("header_size", "<u2"), ("version", "<u2"), ("size", "<u4"), ("kind", "<u4"),
    ("time_unit", "<u4"), ("client", "<u2"), ("object_version", "<u2"), ("time", "<u8"),
]  # fmt: skip
#: Object of a data or remote frame.
_FRAME = np.dtype(
    [*_OBJECT_HEADER, ("channel", "<u2"), ("flags", "u1"), ("dlc", "u1"), ("id", "<u4"), ("data", "u1", (8,))]
)
#: Object of an error frame.
_ERROR = np.dtype(
    [*_OBJECT_HEADER, ("channel", "<u2"), ("unused", "V8"), ("dlc", "u1"), ("unused_2", "V5"), ("id", "<u4"),
     ("unused_3", "V4"), ("data", "u1", (8,))]
)  # fmt: skip


def _template(dtype: np.dtype[np.void], kind: int) -> NDArray[np.void]:
    """Object of one frame with all fields that are the same for every frame."""
    template = np.zeros(1, dtype)
    template["signature"], template["header_size"], template["version"] = b"LOBJ", 32, 1
    template["size"], template["kind"], template["time_unit"] = dtype.itemsize, kind, TIME_ONE_NANS
    template["channel"] = 1
    return template


_FRAME_TEMPLATE, _ERROR_TEMPLATE = _template(_FRAME, CAN_MESSAGE), _template(_ERROR, CAN_ERROR_EXT)


class BlfWriter:
    """Writes blocks of frames to a BLF file; the stream stays open.

    The header is complete after :meth:`finish`. Raises OSError if the stream can't be written.
    """

    def __init__(self, stream: BinaryIO) -> None:
        self._stream = stream
        self.count = 0  #: Frames written so far.
        self._unpacked = FILE_HEADER_SIZE
        self._start_s: float | None = None
        self._stop_s = 0.0

    def write(self, block: FrameBlock) -> None:
        """Write frames, and pass their containers to the operating system."""
        if not len(block):
            return
        if self._start_s is None:
            # The header holds whole milliseconds, and only calendar times.
            first_s = float(block.timestamp_s[0])
            self._start_s = int(first_s * 1000) / 1000 if timestamp_to_systemtime(first_s)[0] else 0.0
            self._write_header()
        self._stop_s = float(block.timestamp_s[-1])
        self.count += len(block)
        for first in range(0, len(block), _CONTAINER_FRAMES):
            frames = block.take(slice(first, first + _CONTAINER_FRAMES))
            self._write_container(_pack_objects(frames, self._start_s))
        self._stream.flush()

    def finish(self) -> None:
        """Complete the header; if more frames follow, it must be completed again."""
        self._write_header()
        self._stream.seek(0, io.SEEK_END)
        self._stream.flush()

    def _write_container(self, objects: bytes) -> None:
        packed = isal_zlib.compress(objects, _COMPRESSION_LEVEL)
        size = OBJ_HEADER_BASE_STRUCT.size + LOG_CONTAINER_STRUCT.size + len(packed)
        header = OBJ_HEADER_BASE_STRUCT.pack(b"LOBJ", OBJ_HEADER_BASE_STRUCT.size, 1, size, LOG_CONTAINER)
        container = LOG_CONTAINER_STRUCT.pack(ZLIB_DEFLATE, len(objects))
        self._stream.write(b"".join((header, container, packed, bytes(size % 4))))  # padded as by python-can
        self._unpacked += len(header) + len(container) + len(objects)

    def _write_header(self) -> None:
        size = max(self._stream.seek(0, io.SEEK_END), FILE_HEADER_SIZE)
        self._stream.seek(0)
        times = (*timestamp_to_systemtime(self._start_s), *timestamp_to_systemtime(self._stop_s))
        header = FILE_HEADER_STRUCT.pack(*_FILE_HEADER_START, size, self._unpacked, self.count, 0, *times)
        self._stream.write(header.ljust(FILE_HEADER_SIZE, b"\0"))


def _pack_objects(block: FrameBlock, start_s: float) -> bytes:
    """Frames as a sequence of BLF objects; times are relative to ``start_s``."""
    rows = block.rows
    objects = _fill_template(_FRAME_TEMPLATE, rows, start_s)
    if block.data_frames() is block:
        return objects.tobytes()
    flags = rows["flags"]
    objects["flags"] = np.where(flags & REMOTE_FRAME, REMOTE_FLAG, 0)
    is_error = (flags & ERROR_FRAME) != 0
    buffer = np.zeros((len(rows), _ERROR.itemsize), np.uint8)
    buffer[:, : _FRAME.itemsize] = objects.view(np.uint8).reshape(len(rows), -1)
    errors = _fill_template(_ERROR_TEMPLATE, rows[is_error], start_s)
    buffer[is_error] = errors.view(np.uint8).reshape(-1, _ERROR.itemsize)
    lengths = np.where(is_error, _ERROR.itemsize, _FRAME.itemsize)
    return buffer[np.arange(_ERROR.itemsize) < lengths[:, np.newaxis]].tobytes()


def _fill_template(template: NDArray[np.void], rows: NDArray[np.void], start_s: float) -> NDArray[np.void]:
    """Objects (n,) of frames, with times relative to ``start_s``."""
    objects = np.frombuffer(bytearray(template.tobytes() * len(rows)), template.dtype)
    objects["time"] = np.maximum((rows["time_s"] - start_s) * _NS, 0.0)
    objects["dlc"], objects["id"], objects["data"] = rows["length"], rows["id"], rows["data"]
    return objects


def read_blf(content: bytes) -> tuple[FrameBlock, bool]:
    """Frames of a BLF file, without CAN FD frames, and whether the whole file was read.

    The file is read up to the first container that is cut off, damaged or of an unknown form. Files with
    other objects than those of :class:`BlfWriter` are read by python-can, frame by frame.
    """
    try:
        header = FILE_HEADER_STRUCT.unpack_from(content)
        if header[0] != b"LOGG":
            return FrameBlock.from_messages([]), False
        objects, end = _unpack_containers(content, max(header[1], FILE_HEADER_STRUCT.size))
        block, is_whole = _decode_objects(objects, systemtime_to_timestamp(header[14:22])), True
    except struct.error:
        return FrameBlock.from_messages([]), False
    if block is None:
        block, is_whole = _read_with_python_can(content[:end])
    return block, is_whole and not content[end:].strip(b"\0")


def _unpack_containers(content: bytes, end: int) -> tuple[bytes, int]:
    """Objects of the containers from offset ``end`` on, and the offset of the first unreadable one."""
    unpacked: list[bytes] = []
    try:
        while content[end : end + 4] == b"LOBJ":
            _, _, _, size, kind = OBJ_HEADER_BASE_STRUCT.unpack_from(content, end)
            packed = content[end + OBJ_HEADER_BASE_STRUCT.size : end + size]
            method, unpacked_size = LOG_CONTAINER_STRUCT.unpack_from(packed)
            objects = packed[LOG_CONTAINER_STRUCT.size :]
            if kind != LOG_CONTAINER or end + size > len(content) or unpacked_size > _MAX_UNPACKED_READ:
                break
            if method == ZLIB_DEFLATE:
                decompressor = isal_zlib.decompressobj()
                objects = decompressor.decompress(objects, unpacked_size + 1)
                if not decompressor.eof:
                    break
            elif method != NO_COMPRESSION:
                break
            if len(objects) != unpacked_size:
                break
            unpacked.append(objects)
            end += size + size % 4
    except (struct.error, isal_zlib.error):  # type: ignore[misc] # its stub has an instance
        pass
    return b"".join(unpacked), end


def _decode_objects(objects: bytes, start_s: float) -> FrameBlock | None:
    """Frames of the objects that :class:`BlfWriter` writes; None if there are other objects."""
    content = np.frombuffer(objects, np.uint8)
    if len(content) % _FRAME.itemsize == 0:
        frames = content.view(_FRAME)
        if _match_template(_FRAME_TEMPLATE, frames):
            return _decode_uniform(frames, start_s)
    starts, offset = [], 0
    while offset + 12 <= len(objects):  # objects of error frames are longer
        starts.append(offset)
        offset += max(int.from_bytes(objects[offset + 8 : offset + 12], "little"), 12)
    offsets = np.array(starts)
    size = np.diff(np.append(offsets, offset))
    is_error = size == _ERROR.itemsize
    if offset != len(objects) or not np.all(is_error | (size == _FRAME.itemsize)):
        return None
    rows = np.empty(len(offsets), FRAME_DTYPE)
    for template, is_selected in ((_FRAME_TEMPLATE, ~is_error), (_ERROR_TEMPLATE, is_error)):
        indices = offsets[is_selected, np.newaxis] + np.arange(template.itemsize)
        frames = content[indices].view(template.dtype)[:, 0]
        if not _match_template(template, frames):
            return None
        rows[is_selected] = _decode_uniform(frames, start_s).rows
    return FrameBlock(rows)


def _match_template(template: NDArray[np.void], objects: NDArray[np.void]) -> bool:
    """Whether the headers of all objects are those of the template."""
    # Compares the header up to the unit of time, as 4-byte numbers, which is faster than by field.
    words, fixed = (
        each.view("<u4").reshape(-1, template.itemsize // 4)[:, :5] for each in (objects, template)
    )
    return bool((words == fixed).all() and (objects["dlc"] <= 8).all())


def _decode_uniform(objects: NDArray[np.void], start_s: float) -> FrameBlock:
    """Frames of objects of one kind, data frames or error frames."""
    is_error = objects.dtype == _ERROR
    flags = ERROR_FRAME if is_error else np.where(objects["flags"] & REMOTE_FLAG, REMOTE_FRAME, 0)
    time_s = objects["time"] / _NS + start_s
    return FrameBlock.from_columns(time_s, objects["id"], objects["dlc"], objects["data"], flags)


def _read_with_python_can(content: bytes) -> tuple[FrameBlock, bool]:
    """Frames as read by python-can, and whether the whole file was read."""
    messages: list[can.Message] = []
    is_whole = False
    try:
        with can.BLFReader(io.BytesIO(content)) as reader:
            messages.extend(reader)
        is_whole = True
    except (ValueError, OverflowError, struct.error, can.CanError, BLFParseError):
        pass  # damaged inside a container that was read
    return FrameBlock.from_messages(messages), is_whole


_SUFFIX = ".blf"
#: Size of a dwell of several hours on a fully loaded bus.
_MAX_PART_BYTES = 1_000_000_000
#: Pending frames, and their time span, s, from which they are written: the maximum loss after a kill.
_MAX_PENDING_FRAMES, _MAX_PENDING_S = 340, 10.0
#: On virtual time a whole container is less than a second of real time, and costs half as much in all.
_CONTAINER_FRAMES = _MAX_UNPACKED // _FRAME.itemsize


class CanLog:
    """Writes the raw CAN log of a run.

    ``folder``: created if missing; existing parts are kept and numbering continues. ``is_virtual``: whether
    the run's clock is. Raises RunFolderError if a part can't be written; that part then ends, and the next
    frame begins a new one.
    """

    def __init__(self, folder: Path, is_virtual: bool = False) -> None:
        self._folder = folder
        self._max_frames = _CONTAINER_FRAMES if is_virtual else _MAX_PENDING_FRAMES
        self._max_pending_s = math.inf if is_virtual else _MAX_PENDING_S
        make_folder(folder)
        #: Number of the part that the next frame begins after :meth:`cut`.
        self.next_part = 1 + max(find_parts(folder, _SUFFIX), default=0)
        self._path: Path  # of the part that is being written
        self._stream: BinaryIO | None = None  # of that part; None between two parts
        self._writer: BlfWriter
        self._pending: list[FrameBlock] = []
        self._pending_count = 0
        self._pending_since_s = 0.0
        self._idle_since_s: float | None = None  # run's clock at the first check of the pending frames

    def write(self, block: FrameBlock) -> None:
        """Add frames in the order received; in real time they are written after a few seconds at most."""
        if self._stream is None:
            self._begin_part()
        if not len(block):
            return
        if self._pending_count + len(block) > _CONTAINER_FRAMES:
            self._flush()
        last_s = block.timestamp_s.item(-1)
        if not self._pending:
            self._pending_since_s = last_s
        self._pending.append(block)
        self._pending_count += len(block)
        if (
            self._pending_count >= self._max_frames
            or abs(last_s - self._pending_since_s) >= self._max_pending_s
        ):
            self._flush()

    def write_waiting(self, now_s: float) -> None:
        """Write pending frames if none has followed for some seconds; ``now_s``: time on the run's clock."""
        if self._idle_since_s is None:
            self._idle_since_s = now_s if self._pending else None
        elif now_s - self._idle_since_s >= self._max_pending_s:
            self._flush()

    def sync(self) -> None:
        """Sync all frames so far to the disk; the part continues."""
        if self._stream is not None:
            self._flush()
            with self._part_ended_by_error():
                self._writer.finish()
                os.fsync(self._stream.fileno())
                sync_folder(self._folder)

    def cut(self) -> None:
        """End the current part; all frames so far are on the disk when this returns."""
        self.sync()
        self._end_part()

    def _begin_part(self) -> None:
        self._path = log_path(self._folder, self.next_part)
        with self._part_ended_by_error():
            self._stream = self._path.open("xb")
            self._writer = BlfWriter(self._stream)
        self.next_part += 1

    def _flush(self) -> None:
        pending = concatenate(self._pending)
        self._pending, self._pending_count, self._idle_since_s = [], 0, None
        with self._part_ended_by_error():
            self._writer.write(pending)

    def _end_part(self) -> None:
        if self._stream is not None:
            with contextlib.suppress(OSError):
                self._stream.close()
            self._stream = None

    @contextlib.contextmanager
    def _part_ended_by_error(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            self._end_part()
            raise write_error(self._path, error) from error


def log_path(folder: Path, number: int) -> Path:
    """Path of a part of the log; parts are numbered from 1."""
    return part_path(folder, number, _SUFFIX)


def read_can_log(folder: Path, numbers: Container[int] | None = None) -> Iterator[tuple[int, FrameBlock]]:
    """Frames of a run's log in the order received: number and frames of each part.

    A part that was never ended, or is damaged, yields the frames before its first incomplete container; there
    may be none. ``numbers`` selects parts; by default all are read. Raises RunFolderError if there is no
    log, or a part can't be read from the disk.
    """
    parts = find_parts(folder, _SUFFIX)
    if not parts:
        raise RunFolderError(f"{folder}: contains no CAN log")
    for number, path in parts.items():
        if numbers is not None and number not in numbers:
            continue
        content = read_limited(path, _MAX_PART_BYTES, RunFolderError)
        yield number, read_blf(content)[0]
