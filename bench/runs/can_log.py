"""The raw CAN log: every frame received, in BLF files that python-can reads.

A BLF file is complete once it is closed, so the log is cut into parts: a part ends where
:meth:`CanLog.cut` is called, and is on the disk from then on. A part that a kill or a power cut
left open can still be read up to its last full container. Later frames begin a new part, so that
frames before and after a gap are never taken for neighbours.
"""

from __future__ import annotations

import contextlib
import io
import os
import struct
import zlib
from collections.abc import Container, Iterable, Iterator
from pathlib import Path
from typing import BinaryIO

import can
from can.io.blf import (
    FILE_HEADER_SIZE,
    LOG_CONTAINER,
    LOG_CONTAINER_STRUCT,
    OBJ_HEADER_BASE_STRUCT,
    ZLIB_DEFLATE,
    BLFParseError,
)

from gyrobench.bench.foundations.errors import RunFolderError
from gyrobench.bench.foundations.files import cant_be_written, make_folder, read_limited, sync_folder
from gyrobench.bench.runs.folder import find_parts, part_path

_SUFFIX = ".blf"
#: A dwell of some hours on a bus that is never idle.
MAX_PART_BYTES = 1_000_000_000
#: zlib level: a tenth more bytes than the default in less time.
_FAST = 1
#: Bytes before compression, some 340 frames: the maximum loss after a kill.
_CONTAINER_BYTES = 16 * 1024
#: No program packs as much into one container; damaged bytes could request gigabytes.
_MAX_UNPACKED_BYTES = 16 * 1024 * 1024


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

    def write(self, messages: Iterable[can.Message]) -> None:
        """Add frames in the order received; full containers are readable at once."""
        path = part_path(self._folder, self._next, _SUFFIX)
        try:
            if self._part is None:
                self._part = _OpenPart(path)
                self._next += 1
            self._part.write(messages)
        except OSError as error:
            raise self._abandon(path, error) from error

    def cut(self) -> None:
        """End the present part; when this returns, all frames so far are on the disk."""
        if self._part is None:
            return
        try:
            self._part.end()
            sync_folder(self._folder)
        except OSError as error:
            raise self._abandon(self._part.path, error) from error
        self._part = None

    def _abandon(self, path: Path, error: OSError) -> RunFolderError:
        part, self._part = self._part, None
        if part is not None:
            part.abandon()
            path = part.path
        return cant_be_written(path, error)


class _OpenPart:
    """The part that is being written."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._stream: BinaryIO = path.open("xb")
        self._writer = can.BLFWriter(
            self._stream, compression_level=_FAST, max_container_size=_CONTAINER_BYTES
        )

    def write(self, messages: Iterable[can.Message]) -> None:
        for message in messages:
            self._writer.on_message_received(message)
        self._stream.flush()

    def end(self) -> None:
        descriptor = os.dup(self._stream.fileno())
        try:
            self._writer.stop()  # closes the stream
            os.fsync(descriptor)
        finally:
            os.close(descriptor)

    def abandon(self) -> None:
        with contextlib.suppress(OSError):
            self._stream.close()


def read_can_log(
    folder: Path, numbers: Container[int] | None = None
) -> Iterator[tuple[int, list[can.Message]]]:
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
        yield number, _frames(content[: _whole_bytes(content)])


def _whole_bytes(content: bytes) -> int:
    """Number of bytes up to the end of the last container before which all are whole."""
    end = FILE_HEADER_SIZE
    try:
        while content[end : end + 4] == b"LOBJ":
            _, _, _, size, kind = OBJ_HEADER_BASE_STRUCT.unpack_from(content, end)
            packed = content[end + OBJ_HEADER_BASE_STRUCT.size : end + size]
            method, unpacked_size = LOG_CONTAINER_STRUCT.unpack_from(packed)
            if kind != LOG_CONTAINER or method != ZLIB_DEFLATE or end + size > len(content):
                break
            if unpacked_size > _MAX_UNPACKED_BYTES:
                break
            unpacking = zlib.decompressobj()
            unpacked = unpacking.decompress(packed[LOG_CONTAINER_STRUCT.size :], unpacked_size + 1)
            if not unpacking.eof or len(unpacked) != unpacked_size:
                break
            end += size + size % 4  # as python-can pads
    except (struct.error, zlib.error):
        pass
    return end


def _frames(content: bytes) -> list[can.Message]:
    messages: list[can.Message] = []
    try:
        with can.BLFReader(io.BytesIO(content)) as reader:
            messages.extend(reader)
    except (ValueError, OverflowError, struct.error, can.CanError, BLFParseError):
        pass  # a file header that never reached the disk
    return messages
