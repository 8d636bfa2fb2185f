"""The emulated bench at ports: table and chamber speak their protocols, the INS slcan or socketcand."""

from __future__ import annotations

import math
import selectors
from collections import deque
from collections.abc import Callable

from gyrobench.drivers.emulators.bench import EmulatedBench
from gyrobench.drivers.emulators.serial_instrument import Connection, SerialInstrument
from gyrobench.drivers.emulators.slcan_adapter import SlcanAdapter
from gyrobench.drivers.emulators.socketcand_daemon import BUS_NAME, SocketcandDaemon
from gyrobench.drivers.served_ports import Port

#: How often the world is looked at, s of the bench's time: its frames come no later than that.
_PERIOD_S = 0.01
_MAX_BACKLOG = 65536


class Server:
    """Serves the three instruments of an emulated bench.

    Parameters
    ----------
    bench : EmulatedBench
        On a wall clock, which may be a fast one.
    make_port : callable
        Makes a port for the instrument of that name; gets what gives the greeting of a new client, too.
    socketcand : bool
        Whether the INS speaks socketcand, which needs a TCP port, not slcan.

    Attributes
    ----------
    urls : dict of str to str
        Where ``table``, ``chamber`` and ``ins`` are.
    """

    def __init__(
        self,
        bench: EmulatedBench,
        make_port: Callable[[str, Callable[[], bytes]], Port],
        socketcand: bool = False,
    ) -> None:
        self._bench = bench
        self._lines: dict[str, _Line] = {}
        self.urls: dict[str, str] = {}
        for name, instrument in bench.serial.items():
            self._add(name, make_port(name, bytes), instrument, bench.connections[name])
        # What the bus suffers is the adapter's matter; the adapter itself stays plugged in.
        self._adapter: SlcanAdapter | SocketcandDaemon
        if socketcand:
            self._adapter = daemon = SocketcandDaemon(bench.bus, bench.connections["ins"])
            self._add("ins", make_port("ins", daemon.greet), daemon, Connection())
            self.urls["ins"] = f"{self.urls['ins'].replace('socket://', 'socketcand://')}/{BUS_NAME}"
        else:
            self._adapter = SlcanAdapter(bench.bus, bench.connections["ins"])
            self._add("ins", make_port("ins", bytes), self._adapter, Connection())

    def _add(self, name: str, port: Port, instrument: SerialInstrument, connection: Connection) -> None:
        self._lines[name] = _Line(port, instrument, connection)
        self.urls[name] = port.url

    def close(self) -> None:
        """Close all ports and remove their links."""
        for line in self._lines.values():
            line.close()

    def serve(self, duration_s: float | None = None) -> None:
        """Serve until ``duration_s`` of the bench's time is over, or for ever."""
        clock = self._bench.clock
        end_s = None if duration_s is None else clock.now() + duration_s
        while end_s is None or clock.now() < end_s:
            self._wait()
            self._bench.advance()
            for line in self._lines.values():
                line.exchange(clock.now())
            self._lines["ins"].send(self._adapter.from_bus())

    def _wait(self) -> None:
        with selectors.DefaultSelector() as selector:
            for line in self._lines.values():
                if line.plugged_in:
                    selector.register(line.port, selectors.EVENT_READ)
            clock = self._bench.clock
            due_s = min(line.due_s for line in self._lines.values())
            selector.select(max(0.0, min(_PERIOD_S, due_s - clock.now()) / clock.speed))


class _Line:
    """An instrument on its port, with its replies under way and what could not be sent yet."""

    def __init__(self, port: Port, instrument: SerialInstrument, connection: Connection) -> None:
        self.port = port
        self.plugged_in = True
        self._instrument = instrument
        self._connection = connection
        self._connection_number = connection.number
        self._replies: deque[tuple[float, bytes]] = deque()
        self._backlog = bytearray()

    @property
    def due_s(self) -> float:
        """When the next reply is to be sent; infinite for none."""
        return self._replies[0][0] if self._replies else math.inf

    def exchange(self, now_s: float) -> None:
        """Hand what has come to the instrument and send its reply after its latency."""
        self._follow_plug()
        data = self.port.read() if self.plugged_in else b""
        reply = self._instrument.feed(data, now_s) if data else b""
        if reply:
            self._replies.append((now_s + self._instrument.latency_s, reply))
        while self.due_s <= now_s:
            self.send(self._replies.popleft()[1])
        self.send(b"")

    def close(self) -> None:
        """Close the port."""
        if self.plugged_in:
            self.plugged_in = False
            self.port.unplug()

    def _follow_plug(self) -> None:
        if self._connection.number == self._connection_number:
            return
        self._connection_number = self._connection.number
        if self.plugged_in:
            self.port.unplug()
            self._replies.clear()
            self._backlog.clear()
        self.plugged_in = not self._connection.broken
        if self.plugged_in:
            self.port.plug_in()

    def send(self, data: bytes) -> None:
        """Send; while nobody takes it, the oldest bytes beyond the backlog's size are lost."""
        self._backlog += data
        del self._backlog[:-_MAX_BACKLOG]
        if self._backlog and self.plugged_in:
            del self._backlog[: self.port.write(bytes(self._backlog))]
