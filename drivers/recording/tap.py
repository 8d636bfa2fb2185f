"""Recording of lines: what passes through a line opened while a recording is on is written to a file."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from gyrobench.bench.foundations.clock import Clock
from gyrobench.bench.foundations.files import make_folder
from gyrobench.drivers.recording.recording_file import RecordingFile, RecordingHeader

#: Bytes recorded of the unread input that a driver discards.
_MAX_DISCARDED = 65536


class LinePort(Protocol):
    """The methods of a port that a line uses; pyserial's ports have them."""

    timeout: float | None

    @property
    def in_waiting(self) -> int:
        """Number of bytes that have arrived."""
        ...

    def read(self, size: int = 1, /) -> bytes:
        """Up to ``size`` bytes that arrive before the time-out."""
        ...

    def write(self, data: bytes, /) -> int | None:
        """Send."""
        ...

    def flush(self) -> None:
        """Wait until all is sent."""
        ...

    def reset_input_buffer(self) -> None:
        """Discard what has arrived."""
        ...

    def close(self) -> None:
        """Close."""
        ...


class RecordedPort:
    """A port that records what passes through it."""

    def __init__(self, port: LinePort, file: RecordingFile) -> None:
        self._port = port
        self._file = file

    @property
    def timeout(self) -> float | None:
        """Time-out of a read, s."""
        return self._port.timeout

    @timeout.setter
    def timeout(self, timeout_s: float | None) -> None:
        self._port.timeout = timeout_s

    @property
    def in_waiting(self) -> int:
        """Number of bytes that have arrived."""
        return self._port.in_waiting

    def read(self, size: int = 1, /) -> bytes:
        """Read and record."""
        data = bytes(self._port.read(size))
        self._file.add(False, data)
        return data

    def write(self, data: bytes, /) -> int | None:
        """Record and send."""
        self._file.add(True, data)
        return self._port.write(data)

    def flush(self) -> None:
        """Wait until all is sent."""
        self._port.flush()

    def reset_input_buffer(self) -> None:
        """Record and discard what has arrived."""
        self._port.timeout = 0
        left = _MAX_DISCARDED
        while left > 0 and (waiting := self._port.in_waiting):
            left -= len(self.read(min(waiting, left)))
        self._port.reset_input_buffer()

    def close(self) -> None:
        """Close port and recording."""
        self._port.close()
        self._file.close()


@dataclass(frozen=True)
class _Tap:
    folder: Path
    headers: Mapping[str, RecordingHeader]


#: The recordings that are on; lines are opened deep inside the bench, also in other threads.
_taps: list[_Tap] = []


@contextlib.contextmanager
def recording_lines(folder: Path, headers: Mapping[str, RecordingHeader]) -> Iterator[None]:
    """Record every line that is opened meanwhile, into a new file at each opening.

    Parameters
    ----------
    folder : Path
        Created if absent. Files are named after the instrument and numbered.
    headers : mapping of str to RecordingHeader
        By the instrument's name in errors: "rate table", "chamber". Lines of other instruments are
        not recorded.

    Raises
    ------
    RunFolderError
        The folder can't be created; opening a line raises it if its file can't be.
    """
    make_folder(folder)
    tap = _Tap(folder, headers)
    _taps.append(tap)
    try:
        yield
    finally:
        _taps.remove(tap)


def tapped(instrument: str, port: LinePort, clock: Clock, baudrate: int, parity: str) -> LinePort:
    """The port of an instrument, recorded if a recording is on."""
    for tap in _taps:
        if instrument in tap.headers:
            header = tap.headers[instrument].model_copy(update={"baudrate": baudrate, "parity": parity})
            return RecordedPort(port, RecordingFile(_next_path(tap.folder, header), header, clock))
    return port


def _next_path(folder: Path, header: RecordingHeader) -> Path:
    number = 1
    while (path := folder / f"{header.instrument}-{number:03d}.rec").exists():
        number += 1
    return path
