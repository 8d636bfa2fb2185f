"""A serial line to an instrument, with deadlines on the run's clock.

The address is any pyserial URL: a device (``/dev/ttyUSB0``), ``socket://host:port``,
``rfc2217://host:port``, ``emulator://table?...`` or ``replay://FILE``, a recording. pyserial finds the
handlers of the last three in the packages listed below; this module does not import the emulators.
"""

from __future__ import annotations

import contextlib
import re
import threading
from dataclasses import dataclass
from urllib.parse import urlsplit

import serial

from gyrobench.bench.foundations.clock import Clock, Deadline
from gyrobench.bench.foundations.errors import ConnectionFailedError, DocumentError, NoReplyError, ReplyError
from gyrobench.drivers.recording.protocol_replay import ReplayError, with_clock
from gyrobench.drivers.recording.recording_file import RecordingFile, new_line_recording

_WRITE_TIMEOUT_S = 5.0
#: Default time limit to await silence, in multiples of the silence.
_MAX_SILENCES = 5
#: If a late reply has arrived, the reply to the present request begins within this time, s.
NEXT_REPLY_S = 0.5
_HOST_AND_PORT = re.compile(r"[\w.-]+:\d+")
#: Most bytes of discarded input that are recorded.
_MAX_DISCARDED_BYTES = 65536

serial.protocol_handler_packages[:0] = [
    handlers
    for handlers in ("gyrobench.drivers", "gyrobench.drivers.emulators", "gyrobench.drivers.recording")
    if handlers not in serial.protocol_handler_packages
]


@dataclass(frozen=True)
class LineDefaults:
    """Line settings of a controller, used unless the station file gives others."""

    baudrate: int = 9600
    parity: str = "N"  #: Parity: N, E or O. There are always eight data bits and one stop bit.
    #: TCP port used if the address has none; None if the controller has no default port.
    tcp_port: int | None = None

    def complete_url(self, url: str) -> str:
        """Add the default TCP port to ``socket://host``; returns other URLs unchanged."""
        parts = urlsplit(url)
        if parts.scheme != "socket" or self.tcp_port is None or parts.netloc.rpartition(":")[2].isdecimal():
            return url
        return parts._replace(netloc=f"{parts.netloc.rstrip(':')}:{self.tcp_port}").geturl()


_is_shared = threading.Event()


def share_ports() -> None:
    """Open later ports also while another process holds them: one that was killed and hangs in the kernel."""
    _is_shared.set()


def open_port(url: str, clock: Clock, baudrate: int, parity: str) -> serial.Serial:
    """Open a port, for exclusive use unless :func:`share_ports` was called; raises the errors of pyserial."""
    return serial.serial_for_url(
        with_clock(url, clock),
        baudrate=baudrate,
        parity=parity,
        timeout=0,
        write_timeout=_WRITE_TIMEOUT_S,
        exclusive=not _is_shared.is_set(),
    )


def _port_errors(*additional: type[Exception]) -> tuple[type[Exception], ...]:
    """Errors that pyserial raises if a port is gone, depending on call and platform; and ``additional``."""
    try:
        import termios
    except ImportError:  # not a POSIX system
        return (serial.SerialException, OSError, *additional)
    return (serial.SerialException, OSError, termios.error, *additional)


def system_reason(error: Exception) -> str:
    """Reason of the operating system why a port can't be opened, without the name of the port."""
    if "exclusively lock" in str(error):  # pyserial's words
        return "another program uses it"
    reasons = re.findall(r"\[Errno \d+\] ([^\[:']+)", str(error))
    return reasons[-1].strip() if reasons else str(error)


def port_advice(address: str, default_advice: str) -> str:
    """Advice for a port that can't be opened; a pseudo-terminal ends with the program that serves it."""
    if _HOST_AND_PORT.fullmatch(address):
        return f"Write a TCP port as socket://{address}."
    if not address.startswith("/dev/pts/"):
        return default_advice
    return (
        "Start the program that served it again, such as `gyrobench emulate`, and write its new port into "
        "the station file; `resume` reads station.yaml of the run folder."
    )


class SerialLine:
    """Transfers bytes to and from one instrument.

    ``instrument`` is its name in error messages, ``url`` a device name or pyserial URL. Baud rate and parity
    have no effect on TCP; there are always eight data bits and one stop bit. Raises ConnectionFailedError if
    the port can't be opened.
    """

    _open = False
    _recording: RecordingFile | None = None

    def __init__(
        self, instrument: str, url: str, clock: Clock, baudrate: int = 9600, parity: str = "N"
    ) -> None:
        self.instrument = instrument
        self.url = url
        #: The URL for messages, without its options, which mean nothing to an operator.
        self.address = url.partition("?")[0]
        self.clock = clock  #: The run's clock, for a driver's waits and deadlines.
        self._baudrate = baudrate
        self._parity = parity
        self.reopen()

    def __enter__(self) -> SerialLine:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def reopen(self) -> None:
        """Close the port and open it again with the same settings; unread input is lost.

        Raises ConnectionFailedError if the port can't be opened; it stays closed and can be reopened later.
        Raises DocumentError if the world behind an emulated port is wrong.
        """
        self.close()
        try:
            port = open_port(self.url, self.clock, self._baudrate, self._parity)
        except _port_errors(ValueError) as error:
            is_emulated = urlsplit(self.url).scheme == "emulator"
            if is_emulated and isinstance(error.__cause__, DocumentError):
                raise error.__cause__ from None
            raise ConnectionFailedError(
                self.instrument,
                f"can't open {self.address}: {system_reason(error)}. "
                + port_advice(self.address, "Check the station file's port and the cable."),
            ) from error
        self._port, self._open = port, True
        self._recording = new_line_recording(self.instrument, self.clock, self._baudrate, self._parity)

    def close(self) -> None:
        """Close the port; a second call does nothing."""
        if self._open:
            self._open = False
            with contextlib.suppress(*_port_errors()):  # the port is already gone
                self._port.close()
            if self._recording is not None:
                self._recording.close()

    def write(self, data: bytes) -> None:
        """Send bytes. Raises ConnectionFailedError if the port is gone."""
        try:
            if self._recording is not None:
                self._recording.add(True, data)
            self._port.write(data)
            self._port.flush()
        except _port_errors() as error:
            raise self._port_gone(error) from error

    def read(self, count: int, deadline: Deadline, settings: str = "this baud rate") -> bytes:
        """Read exactly ``count`` bytes.

        Raises NoReplyError if fewer bytes arrived before the deadline; the message contains them, and
        ``settings``: the instrument's settings that the operator should check. Raises ConnectionFailedError
        if the port is gone.
        """
        try:
            self._port.timeout = deadline.remaining_s() / self.clock.speed
            data: bytes = self._port.read(count)
            if self._recording is not None:
                self._recording.add(False, data)
        except _port_errors() as error:
            raise self._port_gone(error) from error
        if len(data) < count:
            raise NoReplyError(
                self.instrument,
                f"{len(data)} of {count} bytes within {deadline.duration_s:g} s on {self.address}"
                f"{': ' + data.hex(' ') if data else ''}. Is it switched on and set to {settings}?",
            )
        return data

    def discard_input(self) -> None:
        """Discard unread input, so that the next bytes read are those of the next reply."""
        try:
            if self._recording is not None:
                self._record_unread(self._recording)
            self._port.reset_input_buffer()
        except _port_errors() as error:
            raise self._port_gone(error) from error

    def await_silence(self, silence_s: float, max_s: float | None = None) -> None:
        """Discard input until nothing has arrived for ``silence_s``.

        Raises ReplyError if the line did not become silent within ``max_s``, by default five times
        ``silence_s``. Raises ConnectionFailedError if the port is gone.
        """
        deadline = Deadline(self.clock, _MAX_SILENCES * silence_s if max_s is None else max_s)
        while not deadline.expired():
            try:
                self.read(1, Deadline(self.clock, silence_s))
            except NoReplyError:
                return
            self.discard_input()
        raise ReplyError(
            self.instrument,
            f"bytes arrive on {self.address} all the time without a request. Check whether another program "
            "or master uses this line.",
        )

    def _record_unread(self, recording: RecordingFile) -> None:
        self._port.timeout = 0
        remaining = _MAX_DISCARDED_BYTES
        while remaining > 0 and (waiting := self._port.in_waiting):
            data = self._port.read(min(waiting, remaining))
            recording.add(False, data)
            remaining -= len(data)

    def _port_gone(self, error: Exception) -> ConnectionFailedError:
        if isinstance(error.__cause__, ReplayError):
            return ConnectionFailedError(self.instrument, f"the driver deviates from the recording: {error}")
        return ConnectionFailedError(
            self.instrument, f"{self.address} went away: {error}. Check cable and power."
        )
