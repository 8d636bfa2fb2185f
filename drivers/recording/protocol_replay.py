"""pyserial handler of ``replay://FILE`` addresses: a recording as a serial port.

The port lives on the clock that ``?clock=NAME`` names, which a line adds to the address; without one
it lives on wall time.
"""

from __future__ import annotations

from pathlib import Path
from urllib.parse import parse_qs, unquote, urlsplit

from serial.serialutil import SerialException

from gyrobench.bench.foundations.clock import Clock, WallClock, clock_named
from gyrobench.bench.foundations.errors import DocumentError
from gyrobench.drivers.clocked_port import ClockedPort
from gyrobench.drivers.recording.document import read_recording
from gyrobench.drivers.recording.script import ReplayError, ReplayScript

SCHEME = "replay://"


def with_clock(url: str, clock: Clock) -> str:
    """Add the clock of a line to a ``replay://`` address; any other stays as it is."""
    return f"{url}?clock={clock.name}" if url.startswith(SCHEME) and "?" not in url else url


class Serial(ClockedPort):  # the name that pyserial looks for
    """Port of a recording."""

    def open(self) -> None:
        """Begin the recording."""
        if self.is_open:
            raise SerialException("Port is already open.")
        url = urlsplit(self.portstr or "")
        names = parse_qs(url.query).get("clock", [])
        try:
            self.clock = clock_named(names[0]) if names else WallClock()
            recording = read_recording(Path(unquote(f"{url.netloc}{url.path}")))
        except KeyError:
            raise SerialException(f"no clock is named {names[0]!r}") from None
        except DocumentError as error:
            raise SerialException(str(error)) from error
        self._script = ReplayScript(recording, self.clock.now())
        self._arrived = bytearray()
        self.is_open = True

    def write(self, data: bytes, /) -> int:  # type: ignore[override]
        """Ask; what was not asked then is an error, with the place in the recording."""
        self._collect()
        try:
            self._script.ask(bytes(data), self.clock.now())
        except ReplayError as error:
            raise SerialException(str(error)) from error
        return len(data)

    def next_due_s(self) -> float | None:
        """When the next recorded bytes arrive."""
        return self._script.next_due_s

    def take(self) -> bytes:
        """Recorded bytes that are due."""
        return self._script.arrived(self.clock.now())
