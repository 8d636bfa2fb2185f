"""pyserial handler of ``replay://FILE`` addresses: a recording as a serial port.

The port replies as recorded, and only to the recorded requests. It runs on the clock named in
``?clock=NAME``, which :class:`SerialLine` adds to the address; without it, on wall time. pyserial prescribes
the names of this module and of ``Serial``.
"""

from __future__ import annotations

from pathlib import Path
from urllib.parse import parse_qs, unquote, urlsplit

from serial.serialutil import PortNotOpenError, SerialException

from gyrobench.bench.foundations.clock import Clock, WallClock, find_clock
from gyrobench.bench.foundations.errors import DocumentError
from gyrobench.drivers.clocked_port import ClockedPort
from gyrobench.drivers.recording.recording_file import read_recording

SCHEME = "replay://"

#: Accuracy of a driver's times, s: a reply that is due within this time counts as arrived.
_TOLERANCE_S = 0.05


class ReplayError(Exception):
    """The driver sent other bytes than recorded, or sent them earlier."""


def with_clock(url: str, clock: Clock) -> str:
    """Add a clock to a ``replay://`` address; other addresses stay unchanged."""
    return f"{url}?clock={clock.name}" if url.startswith(SCHEME) and "?" not in url else url


class Serial(ClockedPort):
    """A recording as a serial port; a reply arrives after the same delay from its request as recorded."""

    def open(self) -> None:
        """Open the recording at its beginning."""
        if self.is_open:
            raise SerialException("Port is already open.")
        url = urlsplit(self.portstr or "")
        names = parse_qs(url.query).get("clock", [])
        try:
            self.clock = find_clock(names[0]) if names else WallClock()
            recording = read_recording(Path(unquote(f"{url.netloc}{url.path}")))
        except KeyError:
            raise SerialException(f"no clock is named {names[0]!r}") from None
        except DocumentError as error:
            raise SerialException(str(error)) from error
        self._path = recording.path
        self._remaining = list(reversed(recording.transfers))
        self._zero_s = self.clock.now()  # time of the transfer at zero
        self._sent = b""  # first bytes of the request that is being sent
        self._arrived = bytearray()
        self.is_open = True

    def write(self, data: bytes, /) -> int:  # type: ignore[override]
        """Compare bytes with the recording.

        Raises SerialException if they differ; the message has the place in the recording and both byte
        strings.
        """
        self.collect()
        try:
            self._compare(self._sent + bytes(data))
        except ReplayError as error:
            raise SerialException(str(error)) from error
        return len(data)

    def _compare(self, sent: bytes) -> None:
        now_s = self.clock.now()
        # Drop a reply that the driver did not wait for, within the accuracy of recorded times.
        while (due_s := self.next_due_s()) is not None and due_s <= now_s + _TOLERANCE_S:
            self._remaining.pop()
        while sent:
            if not self._remaining:
                raise ReplayError(f"{self._path}: the recording ends before {_quoted(sent)}")
            expected = self._remaining[-1]
            place = f"{self._path}:{expected.line}"
            if not expected.is_sent:
                raise ReplayError(
                    f"{place}: {_quoted(sent)} is sent before the reply {_quoted(expected.data)}"
                )
            if not (expected.data.startswith(sent) or sent.startswith(expected.data)):
                raise ReplayError(f"{place}: expected {_quoted(expected.data)}; got {_quoted(sent)}")
            if len(sent) < len(expected.data):
                break
            sent = sent[len(expected.data) :]
            self._remaining.pop()
            self._zero_s = now_s - expected.time_s
        self._sent = sent

    def next_due_s(self) -> float | None:
        """Time at which the next recorded bytes arrive; None while the instrument waits for a request."""
        if not self._remaining or self._remaining[-1].is_sent:
            return None
        return self._zero_s + self._remaining[-1].time_s

    def collect(self) -> None:
        """Add recorded bytes that are due."""
        if not self.is_open:
            raise PortNotOpenError
        while (due_s := self.next_due_s()) is not None and due_s <= self.clock.now():
            self._arrived += self._remaining.pop().data


def _quoted(data: bytes) -> str:
    return f"{data.hex(' ')} ({data.decode('ascii', 'backslashreplace')!r})"
