"""pyserial handler of ``emulator://`` addresses: an emulated instrument as a serial port.

The port lives on the bench's clock: a read with a time-out waits there, so on a virtual clock it
returns at once with what would have come in that time.
"""

from __future__ import annotations

from collections import deque

from serial.serialutil import PortNotOpenError, SerialBase, SerialException

from bench.errors import GyrobenchError
from drivers.emulators.bench import EmulatedBench, emulated_bench, parse_address
from drivers.emulators.serial_instrument import Connection, SerialInstrument


class Serial(SerialBase):  # the name that pyserial looks for
    """Port of one emulated instrument."""

    _bench: EmulatedBench
    _instrument: SerialInstrument
    _connection: Connection

    def open(self) -> None:
        """Connect to the instrument that the address names."""
        if self.is_open:
            raise SerialException("Port is already open.")
        try:
            name, address = parse_address(self.portstr or "")
            self._bench = emulated_bench(address)
            self._bench.advance()
        except GyrobenchError as error:
            raise SerialException(str(error)) from error
        if name not in self._bench.serial:
            names = ", ".join(sorted(self._bench.serial))
            raise SerialException(f"no emulated instrument {name!r}; there are: {names}")
        self._instrument = self._bench.serial[name]
        self._connection = self._bench.connections[name]
        self._opened_number = self._connection.number
        if self._connection.broken:
            raise SerialException(f"could not open port {self.portstr}: [Errno 2] No such file or directory")
        self._due: deque[tuple[float, bytes]] = deque()
        self._arrived = bytearray()
        self.is_open = True

    def close(self) -> None:
        """Disconnect; the instrument goes on as it is."""
        self.is_open = False

    def _reconfigure_port(self) -> None:
        """Baud rate and parity have no effect."""

    def _update_rts_state(self) -> None:
        """Control lines have no effect."""

    def _update_dtr_state(self) -> None:
        """Control lines have no effect."""

    @property
    def in_waiting(self) -> int:
        """Number of bytes that have arrived."""
        self._collect()
        return len(self._arrived)

    def read(self, size: int = 1, /) -> bytes:
        """Read up to ``size`` bytes, waiting for them on the bench's clock until the time-out."""
        self._collect()
        clock = self._bench.clock
        end_s = None if self.timeout is None else clock.now() + self.timeout
        while len(self._arrived) < size:
            if not self._due or (end_s is not None and self._due[0][0] > end_s):
                if end_s is not None:
                    clock.sleep_until(end_s)
                break
            clock.sleep_until(self._due[0][0])
            self._collect()
        data = bytes(self._arrived[:size])
        del self._arrived[:size]
        return data

    def write(self, data: bytes, /) -> int:  # type: ignore[override]
        """Send bytes to the instrument; its reply arrives after its latency."""
        if self.is_open:
            self._bench.advance()
        self._check_open()
        now_s = self._bench.clock.now()
        reply = self._instrument.feed(bytes(data), now_s)
        if reply:
            self._due.append((now_s + self._instrument.latency_s, reply))
        return len(data)

    def flush(self) -> None:
        """Everything has been sent already."""

    def reset_input_buffer(self) -> None:
        """Throw away what has arrived."""
        self._collect()
        self._arrived.clear()

    def reset_output_buffer(self) -> None:
        """Nothing waits to be sent."""

    def _collect(self) -> None:
        self._check_open()
        now_s = self._bench.clock.now()
        while self._due and self._due[0][0] <= now_s:
            self._arrived += self._due.popleft()[1]

    def _check_open(self) -> None:
        if not self.is_open:
            raise PortNotOpenError
        if self._connection.number != self._opened_number:
            raise SerialException("[Errno 5] Input/output error: the device is gone")
