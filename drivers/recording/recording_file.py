"""Reads and writes the file of a recording: its header and transfers."""

from __future__ import annotations

import contextlib
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import yaml
from pydantic import Field

from gyrobench.bench.foundations.clock import Clock
from gyrobench.bench.foundations.documents import Document, StrictModel, parse_document, validate
from gyrobench.bench.foundations.errors import DocumentError
from gyrobench.bench.foundations.files import decode_text, make_folder, read_limited, write_error

_MAX_RECORDING_BYTES = 200_000_000
_END_OF_HEADER = "---\n"
_TRANSFER = re.compile(r"\s*(\d+(?:\.\d+)?)\s*([<>])((?:\s+[0-9A-Fa-f]{2})+)\s*(?:\|.*)?")
_COLUMN_HEADS = "#   time s    bytes and text\n"
#: Longest pause between the bytes of one reply, s.
_MAX_PAUSE_S = 0.005
_TEXT_COLUMN = 3 * 16


class Call(StrictModel):
    """A call of the driver during the recording, and its result."""

    ask: str = Field(pattern="^[a-z][a-z_]*$", description="method of the driver")
    arguments: dict[str, Any] = Field({}, description="arguments by name")
    gives: str | None = Field(None, description="returned value, as Python's repr")
    fails: str | None = Field(None, description="kind of the error that it raised instead")

    def outcome(self) -> str:
        """Result or error, in words."""
        return f"fails with {self.fails}" if self.fails else str(self.gives)


class RecordingHeader(StrictModel):
    """Description of a recording: instrument, line settings, source, and calls of the driver."""

    recording: Literal[1] = Field(1, description="version of the format")
    instrument: Literal["table", "chamber", "ins"] = Field(description="kind of instrument")
    dialect: str = Field("", max_length=80, description="dialect, as in a station file")
    options: dict[str, str | int | float | bool] = Field(
        {}, description="additional keys of the dialect in the station file"
    )
    axes: list[int] = Field([], max_length=9, description="numbers of the table's axes in use")
    baudrate: int | None = Field(None, gt=0, description="bit/s of a serial device")
    parity: Literal["N", "E", "O"] | None = Field(None, description="of a serial device")
    source: Literal["instrument", "emulator", "manual"] = Field(
        "instrument", description="source of the replies; manual: written from published bytes"
    )
    identity: str = Field("", max_length=1000, description="identification by the instrument")
    recorded_utc: str = Field("", max_length=40, description="begin, ISO 8601")
    note: str = Field("", max_length=2000, description="a remark, for instance on a peculiarity")
    calls: list[Call] = Field([], description="calls of the driver, in order")


@dataclass(frozen=True)
class Transfer:
    """Bytes in one direction."""

    time_s: float  #: Time since the line was opened, on the clock of the recording.
    is_sent: bool  #: Whether the bytes were sent to the instrument.
    data: bytes
    line: int = 0  #: Line of the file, from 1; 0 if it does not come from a file.

    def text(self) -> str:
        """The transfer as a line of the file."""
        direction = ">" if self.is_sent else "<"
        characters = "".join(chr(byte) if 32 <= byte < 127 else "." for byte in self.data)
        return f"{self.time_s:10.6f} {direction}  {self.data.hex(' '):<{_TEXT_COLUMN}}|{characters}|\n"


@dataclass(frozen=True)
class Recording:
    """A recording that was read; ``document`` gives the places of the header's keys in the file."""

    path: Path
    document: Document
    header: RecordingHeader
    transfers: tuple[Transfer, ...]


def join_transfers(transfers: Iterable[Transfer]) -> list[Transfer]:
    """Join transfers that belong together, such as a reply whose length is read before its text."""
    joined: list[Transfer] = []
    for transfer in transfers:
        last = joined[-1] if joined else None
        if last and last.is_sent == transfer.is_sent and transfer.time_s - last.time_s < _MAX_PAUSE_S:
            joined[-1] = Transfer(last.time_s, last.is_sent, last.data + transfer.data, last.line)
        else:
            joined.append(transfer)
    return joined


def _header_text(header: RecordingHeader) -> str:
    """Text of the file up to the first transfer."""
    data = header.model_dump(exclude_defaults=True)
    data = {"recording": header.recording, "instrument": header.instrument} | data
    keys = yaml.safe_dump(data, sort_keys=False, allow_unicode=True, width=100)
    return keys + _END_OF_HEADER + _COLUMN_HEADS


def recording_text(header: RecordingHeader, transfers: Iterable[Transfer]) -> str:
    """Text of the whole file."""
    return _header_text(header) + "".join(transfer.text() for transfer in transfers)


def read_recording(path: Path) -> Recording:
    """Read a recording.

    Raises DocumentError if the file can't be read or a line of it is wrong; the message has the place.
    """
    if path.is_dir():
        raise DocumentError(
            f"{path}: is a folder. Give a recording, a file that `gyrobench record` wrote (*.rec)"
        )
    text = decode_text(path, read_limited(path, _MAX_RECORDING_BYTES, DocumentError))
    head, end, body = text.partition(f"\n{_END_OF_HEADER}")
    if not end:
        raise DocumentError(
            f"{path}:1:1: not a recording: the line '---' after its header is missing. A CAN log is replayed "
            "by a station file with `interface: replay`"
        )
    document = parse_document(head + "\n", path)
    header = validate(document, RecordingHeader)
    first_line = head.count("\n") + 3
    return Recording(path, document, header, tuple(_transfers(path, body.splitlines(), first_line)))


def _transfers(path: Path, lines: list[str], first_line: int) -> Iterable[Transfer]:
    last_s = 0.0
    for number, line in enumerate(lines, first_line):
        if not line.strip() or line.startswith("#"):
            continue
        match = _TRANSFER.fullmatch(line)
        if match is None:
            raise DocumentError(
                f"{path}:{number}:1: not a transfer; write TIME > BYTES or TIME < BYTES, each byte as two "
                "hexadecimal digits"
            )
        time_s = float(match[1])
        if time_s < last_s:
            raise DocumentError(f"{path}:{number}:1: its time is before that of the line above")
        last_s = time_s
        yield Transfer(time_s, match[2] == ">", bytes.fromhex(match[3]), number)


class RecordingFile:
    """A recording in progress; each transfer is written to the file at once.

    ``path`` must not exist. The times of transfers begin now, on ``clock``. Raises RunFolderError if the file
    can't be created.
    """

    def __init__(self, path: Path, header: RecordingHeader, clock: Clock) -> None:
        self._clock = clock
        self._start_s = clock.now()
        recorded_utc = clock.utc().isoformat(timespec="seconds")
        try:
            self._file = path.open("x", encoding="utf-8", buffering=1)
            self._file.write(_header_text(header.model_copy(update={"recorded_utc": recorded_utc})))
        except OSError as error:
            raise write_error(path, error) from error

    def add(self, is_sent: bool, data: bytes) -> None:
        """Write a transfer with the present time; a write error ends the recording only."""
        if data and not self._file.closed:
            try:
                self._file.write(Transfer(self._clock.now() - self._start_s, is_sent, data).text())
            except OSError:
                self.close()

    def close(self) -> None:
        """End the recording; a second call does nothing."""
        with contextlib.suppress(OSError):
            self._file.close()


#: Folders and headers of the recordings in progress; any thread may open a line, deep inside the bench.
_recordings: list[tuple[Path, Mapping[str, RecordingHeader]]] = []


@contextlib.contextmanager
def recording_lines(folder: Path, headers: Mapping[str, RecordingHeader]) -> Iterator[None]:
    """Record every line that is opened within the context; each opening begins a new file.

    ``folder`` is created if absent; files are named after the instrument and numbered. The keys of
    ``headers`` are the names of instruments in errors ("rate table", "chamber"); lines of other instruments
    are not recorded. Raises RunFolderError if the folder can't be created; opening a line raises it if its
    file can't be created.
    """
    make_folder(folder)
    recording = (folder, headers)
    _recordings.append(recording)
    try:
        yield
    finally:
        _recordings.remove(recording)


def new_line_recording(instrument: str, clock: Clock, baudrate: int, parity: str) -> RecordingFile | None:
    """Begin the recording of a line that is opened; None if its instrument is not being recorded."""
    for folder, headers in _recordings:
        if instrument in headers:
            header = headers[instrument].model_copy(update={"baudrate": baudrate, "parity": parity})
            number = 1
            while (path := folder / f"{header.instrument}-{number:03d}.rec").exists():
                number += 1
            return RecordingFile(path, header, clock)
    return None
