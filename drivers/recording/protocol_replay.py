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
from gyrobench.drivers.recording.recording_file import Recording, Transfer, read_recording

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


#: A driver is never asked to keep time to better than this: what should have come by then has come.
_TOLERANCE_S = 0.05


class ReplayError(Exception):
    """The driver asks something else than it did when it was recorded, or earlier."""


class ReplayScript:
    """What is left of a recording.

    A reply comes as long after the question before it as it did then.

    Parameters
    ----------
    now_s : float
        Time at which the line is opened, on the clock that the other calls are told.
    """

    def __init__(self, recording: Recording, now_s: float) -> None:
        self._path = recording.path
        self._left = list(reversed(recording.transfers))
        self._zero_s = now_s
        self._asked = b""

    @property
    def next_due_s(self) -> float | None:
        """When the next bytes arrive; None while the instrument waits to be asked."""
        if not self._left or self._left[-1].is_sent:
            return None
        return self._zero_s + self._left[-1].time_s

    def arrived(self, now_s: float) -> bytes:
        """Bytes that have come by now, since the last call."""
        data = b""
        while (due_s := self.next_due_s) is not None and due_s <= now_s:
            data += self._left.pop().data
        return data

    def ask(self, data: bytes, now_s: float) -> None:
        """Take what the driver sends.

        Raises
        ------
        ReplayError
            It is not what was sent then; the message has the place in the recording, and both.
        """
        self._let_pass(now_s)
        asked = self._asked + data
        while asked:
            if not self._left:
                raise ReplayError(f"{self._path}: the recording is at its end, and got {_shown(asked)}")
            expected = self._left[-1]
            if not expected.is_sent:
                raise self._too_early(expected, asked)
            if not (expected.data.startswith(asked) or asked.startswith(expected.data)):
                raise ReplayError(
                    f"{self._path}:{expected.line}: expected {_shown(expected.data)}; got {_shown(asked)}"
                )
            if len(asked) < len(expected.data):
                break
            asked = asked[len(expected.data) :]
            self._left.pop()
            self._zero_s = now_s - expected.time_s
        self._asked = asked

    def _let_pass(self, now_s: float) -> None:
        """Skip what the driver did not wait for by no more than a recording's times are good for."""
        while (due_s := self.next_due_s) is not None and due_s <= now_s + _TOLERANCE_S:
            self._left.pop()

    def _too_early(self, expected: Transfer, asked: bytes) -> ReplayError:
        return ReplayError(
            f"{self._path}:{expected.line}: asks {_shown(asked)} before the reply "
            f"{_shown(expected.data)} has come"
        )


def _shown(data: bytes) -> str:
    return f"{data.hex(' ')} ({data.decode('ascii', 'backslashreplace')!r})"
