"""Fingerprint of a file: finds where a file was changed, without a copy of it.

A file is taken in blocks: lines of text, or 4 KiB. Of each block the fingerprint keeps its length, the start
of its SHA-256, the sum of its bytes and their first moment, both modulo a prime. If one byte of a block
changed, the differences of sum and moment give its place and its former value, as the two syndromes of a
Reed-Solomon code do; the hash of the restored block proves it. Of more changes only the block is known.
"""

from __future__ import annotations

import base64
import csv
import hashlib
import io
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
#: Short lines share a block; longer ones than a block are cut.
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
    # Pieces of whole words are encoded alike; all at once would take twenty times the memory of the text.
    pieces = (packed[start : start + _BLOCK_BYTES] for start in range(0, len(packed), _BLOCK_BYTES))
    return b"".join(map(base64.b85encode, pieces)).decode()


@dataclass(frozen=True)
class Change:
    """Where a file differs from its fingerprint first."""

    start: int  #: First byte, from 0, that may differ.
    end: int  #: Byte after the last one of the range; start + 1 where the byte is known.
    text: str  #: What was changed, and where: byte, line, cell.


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
                    return _change_in(path, start, block, record)
                start += len(block)
            if added := len(stream.read(_READ_BYTES)):
                return Change(start, start + added, f"bytes were added after byte {start}")
    except OSError as error:
        raise RunFolderError(f"{path}: can't be read: {error.strerror}") from error
    return None


def _change_in(path: Path, start: int, block: bytes, record: NDArray[np.void]) -> Change:
    if len(block) < record["length"]:
        end = start + len(block)
        return Change(start, end, f"cut off at byte {end}; it differs from byte {start} at the latest")
    at, former = _single_change(block, record)
    if at < 0:
        end = start + len(block)
        where = _place(path, start, end)
        return Change(
            start, end, f"several bytes were changed between byte {start} and byte {end - 1}{where}"
        )
    found = block[at]
    where = _place(path, start + at, start + at + 1)
    return Change(
        start + at, start + at + 1, f"byte {start + at} is 0x{found:02x} and was 0x{former:02x}{where}"
    )


def _single_change(block: bytes, record: NDArray[np.void]) -> tuple[int, int]:
    """Place and former value of the one byte that was changed; the place is -1 if several were."""
    now = _record(block)
    difference = (now[1] - int(record["sum"])) % _PRIME
    moment = (now[2] - int(record["moment"])) % _PRIME
    if difference:
        at = moment * pow(difference, -1, _PRIME) % _PRIME
        signed = difference if difference < _PRIME // 2 else difference - _PRIME
        if at < len(block) and 0 <= block[at] - signed <= 0xFF:
            former = block[at] - signed
            if _digest(block[:at] + bytes([former]) + block[at + 1 :]) == bytes(record["digest"]):
                return at, former
    return -1, 0


def _record(block: bytes) -> tuple[int, int, int, bytes]:
    # Adler-32 has one more than the sum, and the moment counted from behind, modulo the same prime.
    counted, before = divmod(zlib.adler32(block), 1 << 16)
    total = (before - 1) % _PRIME
    return len(block), total, (len(block) * before - counted) % _PRIME, _digest(block)


def _digest(block: bytes) -> bytes:
    return hashlib.sha256(block).digest()[:_DIGEST_BYTES]


def _blocks(stream: BinaryIO, is_text: bool) -> Iterator[bytes]:
    """Blocks of a file in order; of text, lines."""
    left = b""
    while data := stream.read(16 * _BLOCK_BYTES):
        left += data
        start = 0
        while len(left) - start >= _BLOCK_BYTES:
            end = start + _BLOCK_BYTES
            if is_text:
                newline = left.find(b"\n", start + _MIN_LINE_BYTES - 1, end)
                end = end if newline < 0 else newline + 1
            yield left[start:end]
            start = end
        left = left[start:]
    while left:
        newline = left.find(b"\n", _MIN_LINE_BYTES - 1) if is_text else -1
        end = len(left) if newline < 0 else newline + 1
        yield left[:end]
        left = left[end:]


def _place(path: Path, start: int, end: int) -> str:
    """Line of a range of bytes, with the cell of a table or the event of the journal; empty if not text."""
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
    found = _EVENT.search(line)
    return f" (event {found[1].decode()})" if found else ""


def _column(content: bytes, before: bytes) -> str:
    """Name of the column of a cell, from the head of the table and the part of the row before."""
    header = next(csv.reader(io.StringIO(content.partition(b"\n")[0].decode(errors="replace"))), [])
    cells = next(csv.reader(io.StringIO(before.decode(errors="replace") + "x")), [""])
    return header[len(cells) - 1] if len(cells) <= len(header) else str(len(cells))
