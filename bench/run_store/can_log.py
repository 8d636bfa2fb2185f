"""The raw CAN log: every frame received, in BLF files that python-can reads.

A BLF file is complete once it is closed, so the log is cut into parts: a part ends where
:meth:`CanLog.cut` is called, and is on the disk from then on. A part that a kill left open can
still be read up to its last full container.
"""

from __future__ import annotations

import os
import struct
import zlib
from collections.abc import Iterable, Iterator
from pathlib import Path

import can
from can.io.blf import BLFParseError

from bench.errors import RunFolderError

_PART = "part-{:05d}.blf"
#: zlib level: a tenth more bytes than the default in less time.
_FAST = 1


class CanLog:
    """Writes the raw CAN log of a run.

    Parameters
    ----------
    folder : Path
        Made if absent; parts that are there are kept and numbering goes on.

    Raises
    ------
    RunFolderError
        A part can't be written.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        folder.mkdir(parents=True, exist_ok=True)
        self._next = 1 + max((int(path.stem[5:]) for path in folder.glob("part-*.blf")), default=0)
        self._writer: can.BLFWriter | None = None

    @property
    def next_part(self) -> int:
        """Number of the part that the next frame begins, after :meth:`cut`."""
        return self._next

    def write(self, messages: Iterable[can.Message]) -> None:
        """Add frames, in the order received."""
        try:
            if self._writer is None:
                self._path = self._folder / _PART.format(self._next)
                self._next += 1
                self._writer = can.BLFWriter(self._path, compression_level=_FAST)
            write = self._writer.on_message_received
            for message in messages:
                write(message)
        except OSError as error:
            raise self._failed(error) from error

    def cut(self) -> None:
        """End the present part; when this returns, all frames so far are on the disk."""
        if self._writer is None:
            return
        writer, self._writer = self._writer, None
        try:
            writer.stop()
            descriptor = os.open(self._path, os.O_RDONLY)
            try:
                os.fsync(descriptor)
            finally:
                os.close(descriptor)
        except OSError as error:
            raise self._failed(error) from error

    def _failed(self, error: OSError) -> RunFolderError:
        return RunFolderError(f"{self._path}: can't be written: {error.strerror}. Is the disk full?")


def read_can_log(folder: Path) -> Iterator[tuple[int, list[can.Message]]]:
    """Frames of a run's log in the order received, part by part: its number and its frames.

    Raises
    ------
    RunFolderError
        There is no log, or a part before the last one is damaged.
    """
    parts = sorted(folder.glob("part-*.blf"))
    if not parts:
        raise RunFolderError(f"{folder}: holds no CAN log")
    for path in parts:
        yield int(path.stem[5:]), _read_part(path, is_last=path is parts[-1])


def _read_part(path: Path, *, is_last: bool) -> list[can.Message]:
    messages: list[can.Message] = []
    try:
        with path.open("rb") as stream, can.BLFReader(stream) as reader:
            messages.extend(reader)
    except (OSError, ValueError, struct.error, zlib.error, can.CanError, BLFParseError) as error:
        if not is_last:
            raise RunFolderError(f"{path}: damaged: {error}") from error
    return messages
