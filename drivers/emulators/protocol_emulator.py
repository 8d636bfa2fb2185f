"""pyserial handler of ``emulator://`` addresses: an emulated instrument as a serial port.

Read time-outs and latencies run on the bench's clock.
"""

from __future__ import annotations

from collections import deque

from serial.serialutil import PortNotOpenError, SerialException

from gyrobench.bench.foundations.errors import GyrobenchError
from gyrobench.drivers.clocked_port import ClockedPort
from gyrobench.drivers.emulators.bench import EmulatedBench, bench_at, parse_address
from gyrobench.drivers.emulators.dialect import Connection, SerialInstrument


class Serial(ClockedPort):  # the name that pyserial looks for
    """An emulated instrument as a serial port."""

    _bench: EmulatedBench
    _instrument: SerialInstrument
    _connection: Connection

    def open(self) -> None:
        """Connect to the instrument named in the address."""
        if self.is_open:
            raise SerialException("Port is already open.")
        try:
            name, address = parse_address(self.portstr or "")
            self._bench = bench_at(address)
            self._bench.advance()
        except GyrobenchError as error:
            raise SerialException(str(error)) from error
        if name not in self._bench.serial:
            names = ", ".join(sorted(self._bench.serial))
            raise SerialException(f"no emulated instrument {name!r}; available: {names}")
        self.clock = self._bench.clock
        self._instrument = self._bench.serial[name]
        self._connection = self._bench.connections[name]
        self._generation = self._connection.generation
        if self._connection.broken:
            raise SerialException(f"could not open port {self.portstr}: [Errno 2] No such file or directory")
        self._due: deque[tuple[float, bytes]] = deque()
        self._arrived = bytearray()
        self.is_open = True

    def write(self, data: bytes, /) -> int:  # type: ignore[override]
        """Send bytes to the instrument; its reply arrives after its latency."""
        if not self.is_open:
            raise PortNotOpenError
        self._bench.advance_instruments()
        self._check_connected()
        now_s = self.clock.now()
        reply = self._instrument.feed(bytes(data), now_s)
        if reply:
            self._due.append((now_s + self._instrument.latency_s, reply))
        return len(data)

    def next_due_s(self) -> float | None:
        """Time at which the next reply arrives; None if there is none."""
        return self._due[0][0] if self._due else None

    def collect(self) -> None:
        """Append the replies that have arrived."""
        if not self.is_open:
            raise PortNotOpenError
        self._check_connected()
        due = self._due
        while due and due[0][0] <= self.clock.now():
            self._arrived += due.popleft()[1]

    def _check_connected(self) -> None:
        if self._connection.generation != self._generation:
            raise SerialException("[Errno 5] Input/output error: the device is gone")
