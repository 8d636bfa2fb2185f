"""A serial line to an instrument, with deadlines on the run's clock.

Any pyserial URL will do: a device (``/dev/ttyUSB0``), ``socket://host:port``,
``rfc2217://host:port``, ``emulator://table?...`` or ``replay://FILE``, a recording. pyserial finds the
handlers of the last two in the packages named below; nothing of the emulators is imported here.
"""

from __future__ import annotations

import contextlib
from dataclasses import dataclass
from types import TracebackType

import serial

from gyrobench.bench.foundations.clock import Clock, Deadline
from gyrobench.bench.foundations.errors import ConnectionFailedError, NoReplyError, ReplyError
from gyrobench.drivers.recording.protocol_replay import ReplayError, with_clock
from gyrobench.drivers.recording.tap import tapped


def _port_errors() -> tuple[type[Exception], ...]:
    """Errors that pyserial raises when a port disappears; on POSIX systems also those of the terminal."""
    errors: tuple[type[Exception], ...] = (serial.SerialException, OSError)
    try:
        import termios
    except ImportError:
        return errors
    return (*errors, termios.error)


_PORT_ERRORS = _port_errors()
_OPEN_ERRORS: tuple[type[Exception], ...] = (*_PORT_ERRORS, ValueError)

_WRITE_TIMEOUT_S = 5.0

for _handlers in ("gyrobench.drivers.emulators", "gyrobench.drivers.recording"):
    if _handlers not in serial.protocol_handler_packages:
        serial.protocol_handler_packages.append(_handlers)


@dataclass(frozen=True)
class LineDefaults:
    """How a controller is reached unless the station file says otherwise.

    Attributes
    ----------
    baudrate : int
        Bits per second.
    parity : {"N", "E", "O"}
        Parity bit; eight data bits and one stop bit always.
    tcp_port : int or None
        Its TCP port, for an address that names none; None where it has no usual one.
    """

    baudrate: int = 9600
    parity: str = "N"
    tcp_port: int | None = None


def open_port(url: str, clock: Clock, baudrate: int, parity: str) -> serial.Serial:
    """Open a port for this program alone; raises what pyserial raises."""
    return serial.serial_for_url(
        with_clock(url, clock),
        baudrate=baudrate,
        parity=parity,
        timeout=0,
        write_timeout=_WRITE_TIMEOUT_S,
        exclusive=True,
    )


class SerialLine:
    """Bytes to and from one instrument.

    Parameters
    ----------
    instrument : str
        Name used in error messages, for instance "rate table".
    url : str
        A device name or pyserial URL.
    clock : Clock
        The run's clock.
    baudrate : int
        Bits per second; ignored where the URL is not a serial port.
    parity : {"N", "E", "O"}
        Parity bit; eight data bits and one stop bit always.

    Raises
    ------
    ConnectionFailedError
        The port can't be opened.
    """

    _open = False

    def __init__(
        self, instrument: str, url: str, clock: Clock, baudrate: int = 9600, parity: str = "N"
    ) -> None:
        self.instrument = instrument
        self.url = url
        self.clock = clock
        self._baudrate = baudrate
        self._parity = parity
        self.reopen()

    def __enter__(self) -> SerialLine:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def reopen(self) -> None:
        """Open the port anew as it was opened first, after whatever failed; what had arrived is lost.

        Raises
        ------
        ConnectionFailedError
            The port can't be opened; it stays closed, and may be opened later.
        """
        self.close()
        try:
            port = open_port(self.url, self.clock, self._baudrate, self._parity)
        except _OPEN_ERRORS as error:
            raise ConnectionFailedError(
                self.instrument,
                f"can't open {self.url}: {error}. Check the station file's port and the cable.",
            ) from error
        self._port = tapped(self.instrument, port, self.clock, self._baudrate, self._parity)
        self._open = True

    def close(self) -> None:
        """Close the port; a second call does nothing."""
        if self._open:
            self._open = False
            with contextlib.suppress(*_PORT_ERRORS):  # gone already
                self._port.close()

    def write(self, data: bytes) -> None:
        """Send bytes.

        Raises
        ------
        ConnectionFailedError
            The port went away.
        """
        try:
            self._port.write(data)
            self._port.flush()
        except _PORT_ERRORS as error:
            raise self._gone(error) from error

    def read(self, count: int, deadline: Deadline) -> bytes:
        """Read exactly ``count`` bytes.

        Raises
        ------
        NoReplyError
            Fewer bytes came before the deadline; the message holds those that did.
        ConnectionFailedError
            The port went away.
        """
        try:
            self._port.timeout = deadline.remaining_s() / self.clock.speed
            data = bytes(self._port.read(count))
        except _PORT_ERRORS as error:
            raise self._gone(error) from error
        if len(data) < count:
            raise NoReplyError(
                self.instrument,
                f"{len(data)} of {count} bytes within {deadline.duration_s:g} s on {self.url}"
                f"{': ' + data.hex(' ') if data else ''}. Is it switched on and set to this baud rate?",
            )
        return data

    def discard_input(self) -> None:
        """Throw away what arrived and nobody read, so that the next reply is the next one read."""
        try:
            self._port.reset_input_buffer()
        except _PORT_ERRORS as error:
            raise self._gone(error) from error

    def await_silence(self, silence_s: float, longest_s: float) -> None:
        """Throw away what arrives until nothing has come for ``silence_s``.

        Raises
        ------
        ReplyError
            The line was not silent for so long within ``longest_s``.
        ConnectionFailedError
            The port went away.
        """
        deadline = Deadline(self.clock, longest_s)
        while not deadline.expired():
            try:
                self.read(1, Deadline(self.clock, silence_s))
            except NoReplyError:
                return
            self.discard_input()
        raise ReplyError(
            self.instrument,
            f"something arrives on {self.url} all the time without being asked for. Is another program or "
            "master on this line?",
        )

    def _gone(self, error: Exception) -> ConnectionFailedError:
        if isinstance(error.__cause__, ReplayError):
            return ConnectionFailedError(self.instrument, f"is not asked as it was recorded: {error}")
        return ConnectionFailedError(
            self.instrument, f"{self.url} went away: {error}. Check cable and power."
        )
