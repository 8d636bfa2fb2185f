"""Fingerprint of a file, which locates a change of the file without a copy of it.

A file is divided into blocks: lines of text, or 4 KiB. The fingerprint keeps the length of each block, the
start of its SHA-256, the sum of its bytes and their first moment, both modulo a prime. If one byte of a block
changed, the differences of sum and moment give its index and its former value, as the two syndromes of a
Reed-Solomon code do; the hash of the restored block proves it. If more bytes changed, only the block is
known.
"""

from __future__ import annotations

import base64
import csv
import hashlib
import re
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from gyrobench.bench.foundations.errors import RunFolderError

_PRIME = 65521
_BLOCK_BYTES = 4096
#: Shorter lines share a block; lines longer than a block are divided.
_MIN_LINE_BYTES = 64
_DIGEST_BYTES = 8
_READ_BYTES = 1 << 20
_RECORD = np.dtype([("length", "<u2"), ("sum", "<u2"), ("moment", "<u2"), ("digest", f"V{_DIGEST_BYTES}")])
_FIELDS = struct.Struct(f"<HHH{_DIGEST_BYTES}s")
_TEXT_SUFFIXES = (".csv", ".json", ".jsonl", ".yaml", ".html", ".svg", ".txt", ".dbc", ".xml")
_EVENT = re.compile(rb'"event": "(\w{1,60})"')


def fingerprint_of(path: Path) -> str:
    """Fingerprint of a file as text. Raises RunFolderError if it can't be read."""
    try:
        with path.open("rb") as stream:
            blocks = _blocks(stream, path.suffix in _TEXT_SUFFIXES)
            packer, packed = zlib.compressobj(), bytearray()
            for block in blocks:
                packed += packer.compress(_FIELDS.pack(*_record(block)))
            packed += packer.flush()
    except OSError as error:
        raise RunFolderError(f"{path}: can't be read: {error.strerror}") from error
    # Encoding in pieces of whole words gives the same text; all at once takes 20 times the memory of the
    # text.
    pieces = (packed[start : start + _BLOCK_BYTES] for start in range(0, len(packed), _BLOCK_BYTES))
    return b"".join(map(base64.b85encode, pieces)).decode()


@dataclass(frozen=True)
class Change:
    """First difference of a file from its fingerprint."""

    start: int  #: First byte, from 0, that may differ.
    end: int  #: Byte after the last one that may differ; start + 1 if the changed byte is known.
    text: str  #: Description of the change with its location: byte, line, cell.


def find_change(path: Path, fingerprint: str) -> Change | None:
    """The first difference of a file from its fingerprint; None without one.

    Raises RunFolderError if the file can't be read or the fingerprint is damaged.
    """
    try:
        records = np.frombuffer(zlib.decompress(base64.b85decode(fingerprint)), _RECORD)
    except (ValueError, zlib.error) as error:
        raise RunFolderError(f"{path}: its fingerprint is damaged") from error
    try:
        with path.open("rb") as stream:
            start = 0
            for record in records:
                block = stream.read(int(record["length"]))
                if _digest(block) != bytes(record["digest"]):
                    return _locate_change(path, start, block, record)
                start += len(block)
            if added := len(stream.read(_READ_BYTES)):
                return Change(start, start + added, f"bytes were added after byte {start}")
    except OSError as error:
        raise RunFolderError(f"{path}: can't be read: {error.strerror}") from error
    return None


def _locate_change(path: Path, start: int, block: bytes, record: NDArray[np.void]) -> Change:
    """Change of a block that begins at byte ``start`` and differs from its record."""
    if len(block) < record["length"]:
        end = start + len(block)
        return Change(start, end, f"cut off at byte {end}; it differs from byte {start} at the latest")
    index, former = _single_change(block, record)
    if index < 0:
        end = start + len(block)
        location = _location(path, start, end)
        return Change(
            start, end, f"several bytes were changed between byte {start} and byte {end - 1}{location}"
        )
    value = block[index]
    location = _location(path, start + index, start + index + 1)
    return Change(
        start + index,
        start + index + 1,
        f"byte {start + index} is 0x{value:02x} and was 0x{former:02x}{location}",
    )


def _single_change(block: bytes, record: NDArray[np.void]) -> tuple[int, int]:
    """Index and former value of the one byte that was changed; the index is -1 if several were."""
    current = _record(block)
    difference = (current[1] - int(record["sum"])) % _PRIME
    moment = (current[2] - int(record["moment"])) % _PRIME
    if difference:
        index = moment * pow(difference, -1, _PRIME) % _PRIME
        signed = difference if difference < _PRIME // 2 else difference - _PRIME
        if index < len(block) and 0 <= block[index] - signed <= 0xFF:
            former = block[index] - signed
            if _digest(block[:index] + bytes([former]) + block[index + 1 :]) == bytes(record["digest"]):
                return index, former
    return -1, 0


def _record(block: bytes) -> tuple[int, int, int, bytes]:
    """Length, sum, first moment and digest of a block."""
    # Adler-32 holds the sum plus one, and the moment counted from the end, modulo the same prime.
    moment_from_end, sum_plus_one = divmod(zlib.adler32(block), 1 << 16)
    total = (sum_plus_one - 1) % _PRIME
    return len(block), total, (len(block) * sum_plus_one - moment_from_end) % _PRIME, _digest(block)


def _digest(block: bytes) -> bytes:
    return hashlib.sha256(block).digest()[:_DIGEST_BYTES]


def _blocks(stream: BinaryIO, is_text: bool) -> Iterator[bytes]:
    """Blocks of a file in order; for text, lines."""
    unread = b""
    while data := stream.read(16 * _BLOCK_BYTES):
        unread += data
        start = 0
        while len(unread) - start >= _BLOCK_BYTES:
            end = start + _BLOCK_BYTES
            if is_text:
                newline = unread.find(b"\n", start + _MIN_LINE_BYTES - 1, end)
                end = end if newline < 0 else newline + 1
            yield unread[start:end]
            start = end
        unread = unread[start:]
    while unread:
        newline = unread.find(b"\n", _MIN_LINE_BYTES - 1) if is_text else -1
        end = len(unread) if newline < 0 else newline + 1
        yield unread[:end]
        unread = unread[end:]


def _location(path: Path, start: int, end: int) -> str:
    """Line of a range of bytes, with the column of a table or the event of a journal; empty if not text."""
    if path.suffix not in _TEXT_SUFFIXES:
        return ""
    content = path.read_bytes()
    first = content.count(b"\n", 0, start) + 1
    last = first + content[start : end - 1].count(b"\n")
    if last > first:
        return f", in lines {first} to {last}"
    line_start = content.rfind(b"\n", 0, start) + 1
    line_end = content.find(b"\n", start)
    line = content[line_start : line_end if line_end >= 0 else len(content)]
    if path.suffix == ".jsonl":
        return f", in line {first}{_event(line)}"
    if path.suffix == ".csv" and first > 1 and end == start + 1:
        return f", in line {first}, column {_column(content, line[: start - line_start])}"
    return f", in line {first}"


def _event(line: bytes) -> str:
    match = _EVENT.search(line)
    return f" (event {match[1].decode()})" if match else ""


def _column(content: bytes, before: bytes) -> str:
    """Name of the column of a cell; ``before``: the part of its row up to the changed byte."""
    header, cells = _cells(content.partition(b"\n")[0]), _cells(before + b"x")
    return header[len(cells) - 1] if len(cells) <= len(header) else str(len(cells))


def _cells(line: bytes) -> list[str]:
    """Cells of a line of CSV, which may be damaged: csv refuses a carriage return inside."""
    text = line.decode(errors="replace").rstrip("\r").replace("\r", " ")
    return next(csv.reader([text]), [])
