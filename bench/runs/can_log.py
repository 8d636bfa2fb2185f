"""The raw CAN log: every frame received, in BLF files that python-can reads.

A BLF file is complete once it is closed, so the log is cut into parts: a part ends where
:meth:`CanLog.cut` is called, and is on the disk from then on. A part that a kill or a power cut
left open can still be read up to its last full container. Later frames begin a new part, so that
frames before and after a gap are never taken for neighbours.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Container, Iterator
from pathlib import Path
from typing import BinaryIO

from gyrobench.bench.foundations.errors import RunFolderError
from gyrobench.bench.foundations.files import cant_be_written, make_folder, read_limited, sync_folder
from gyrobench.bench.runs.blf import BlfWriter, read_blf
from gyrobench.bench.runs.folder import find_parts, part_path
from gyrobench.drivers.frames import FrameBlock, concatenate

_SUFFIX = ".blf"
#: A dwell of some hours on a bus that is never idle.
MAX_PART_BYTES = 1_000_000_000
#: Frames that are written together, or what comes in so many seconds: the maximum loss after a kill.
_FRAMES_AT_ONCE, _SECONDS_AT_ONCE = 340, 10.0


class CanLog:
    """Writes the raw CAN log of a run.

    ``folder``: made if absent; existing parts are kept and numbering continues. Raises RunFolderError if a
    part can't be written. It ends there; the next frame begins a new one.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        make_folder(folder)
        self._next = 1 + max(find_parts(folder, _SUFFIX), default=0)
        self._part: _OpenPart | None = None

    @property
    def next_part(self) -> int:
        """Number of the part that the next frame begins, after :meth:`cut`."""
        return self._next

    def write(self, block: FrameBlock) -> None:
        """Add frames in the order received; readable after some hundred, or some seconds."""
        if self._part is None:
            path = part_path(self._folder, self._next, _SUFFIX)
            try:
                self._part = _OpenPart(path)
            except OSError as error:
                raise cant_be_written(path, error) from error
            self._next += 1
        try:
            self._part.write(block)
        except OSError as error:
            raise self._abandon(self._part, error) from error

    def write_waiting(self, now_s: float) -> None:
        """Write frames that no others have followed for some seconds by the clock of the run."""
        if self._part is not None:
            try:
                self._part.write_waiting(now_s)
            except OSError as error:
                raise self._abandon(self._part, error) from error

    def sync(self) -> None:
        """Bring all frames so far to the disk; the part continues."""
        if self._part is not None:
            try:
                self._part.sync()
                sync_folder(self._folder)
            except OSError as error:
                raise self._abandon(self._part, error) from error

    def cut(self) -> None:
        """End the present part; when this returns, all frames so far are on the disk."""
        self.sync()
        if self._part is not None:
            self._part.close()
            self._part = None

    def _abandon(self, part: _OpenPart, error: OSError) -> RunFolderError:
        self._part = None
        part.close()
        return cant_be_written(part.path, error)


class _OpenPart:
    """The part that is being written."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._stream: BinaryIO = path.open("xb")
        self._writer = BlfWriter(self._stream)
        self._pending: list[FrameBlock] = []
        self._count = 0
        self._since_s = 0.0
        self._noticed_s: float | None = None  # when the pending frames were first found, by the run's clock

    def write(self, block: FrameBlock) -> None:
        if not len(block):
            return
        last_s = block.timestamp_s.item(-1)
        if not self._pending:
            self._since_s = last_s
        self._pending.append(block)
        self._count += len(block)
        if self._count >= _FRAMES_AT_ONCE or abs(last_s - self._since_s) >= _SECONDS_AT_ONCE:
            self._flush()

    def _flush(self) -> None:
        self._writer.write(concatenate(self._pending))
        self._pending, self._count, self._noticed_s = [], 0, None

    def write_waiting(self, now_s: float) -> None:
        if self._noticed_s is None:
            self._noticed_s = now_s if self._pending else None
        elif now_s - self._noticed_s >= _SECONDS_AT_ONCE:
            self._flush()

    def sync(self) -> None:
        self._flush()
        self._writer.finish()
        os.fsync(self._stream.fileno())

    def close(self) -> None:
        with contextlib.suppress(OSError):
            self._stream.close()


def read_can_log(folder: Path, numbers: Container[int] | None = None) -> Iterator[tuple[int, FrameBlock]]:
    """Frames of a run's log in the order received, part by part: its number and its frames.

    A part that was never ended, or is damaged, gives the frames before its first container that is not whole;
    it may give none. ``numbers`` selects parts; by default all are read. Raises RunFolderError if there is no
    log, or a part can't be read from the disk.
    """
    parts = find_parts(folder, _SUFFIX)
    if not parts:
        raise RunFolderError(f"{folder}: contains no CAN log")
    for number, path in parts.items():
        if numbers is not None and number not in numbers:
            continue
        content = read_limited(path, MAX_PART_BYTES, RunFolderError)
        yield number, read_blf(content)[0]
