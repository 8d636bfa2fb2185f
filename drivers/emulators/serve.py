"""The emulated bench as a process of its own: pseudo-terminals or TCP ports of the loopback.

Table and chamber speak their protocols, the INS speaks slcan. Any client can talk to them: this
project's bench, pymodbus, a terminal program.
"""

from __future__ import annotations

import argparse
import json
import os
import selectors
import socket
import sys
import tty
from collections.abc import Sequence
from pathlib import Path
from typing import Protocol

from bench.clock import VirtualClock, WallClock
from bench.documents import find_document
from bench.errors import DocumentError
from drivers.emulators.bench import EmulatedBench
from drivers.emulators.serial_instrument import SerialInstrument
from drivers.emulators.slcan_adapter import SlcanAdapter

_PERIOD_S = 0.01
_MAX_BACKLOG = 65536
_CHUNK = 4096


class Port(Protocol):
    """A byte stream to whoever connects."""

    url: str

    def fileno(self) -> int:
        """Descriptor to wait on."""
        ...

    def read(self) -> bytes:
        """What has come; empty for nothing."""
        ...

    def write(self, data: bytes) -> int:
        """Send what fits now; returns how many bytes that was."""
        ...


class PseudoTerminal:
    """A pseudo-terminal; clients open ``url`` like a serial device."""

    def __init__(self) -> None:
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        self.url = os.ttyname(self._slave)

    def fileno(self) -> int:
        """Descriptor to wait on."""
        return self._master

    def read(self) -> bytes:
        """What has come."""
        try:
            return os.read(self._master, _CHUNK)
        except BlockingIOError:
            return b""

    def write(self, data: bytes) -> int:
        """Send what fits now."""
        try:
            return os.write(self._master, data)
        except BlockingIOError:
            return 0


class TcpPort:
    """A TCP port of the loopback with one client at a time; a new one replaces the old."""

    def __init__(self) -> None:
        self._listener = socket.create_server(("127.0.0.1", 0))
        self._listener.setblocking(False)
        self._client: socket.socket | None = None
        self.url = f"socket://127.0.0.1:{self._listener.getsockname()[1]}"

    def fileno(self) -> int:
        """Descriptor to wait on."""
        return (self._client or self._listener).fileno()

    def read(self) -> bytes:
        """What has come."""
        try:
            client, _ = self._listener.accept()
            client.setblocking(False)
            client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._hang_up()
            self._client = client
        except BlockingIOError:
            pass
        if self._client is None:
            return b""
        try:
            data = self._client.recv(_CHUNK)
        except BlockingIOError:
            return b""
        except OSError:
            data = b""
        if not data:
            self._hang_up()
        return data

    def write(self, data: bytes) -> int:
        """Send what fits now; without a client it is lost."""
        if self._client is None:
            return len(data)
        try:
            return self._client.send(data)
        except BlockingIOError:
            return 0
        except OSError:
            self._hang_up()
            return len(data)

    def _hang_up(self) -> None:
        if self._client is not None:
            self._client.close()
            self._client = None


class Server:
    """Serves the three instruments of an emulated bench.

    Parameters
    ----------
    bench : EmulatedBench
        On a wall clock.
    make_port : callable
        Makes a port for each instrument.

    Attributes
    ----------
    urls : dict of str to str
        Where ``table``, ``chamber`` and ``ins`` are.
    """

    def __init__(self, bench: EmulatedBench, make_port: type[PseudoTerminal] | type[TcpPort]) -> None:
        self._bench = bench
        self._adapter = SlcanAdapter(bench.ins)
        instruments: dict[str, SerialInstrument] = {**bench.serial, "ins": self._adapter}
        self._lines = {name: _Line(make_port(), instrument) for name, instrument in instruments.items()}
        self.urls = {name: line.port.url for name, line in self._lines.items()}

    def serve(self, duration_s: float | None = None) -> None:
        """Serve until ``duration_s`` is over, or for ever."""
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
                selector.register(line.port, selectors.EVENT_READ)
            selector.select(_PERIOD_S)


class _Line:
    """An instrument on its port, with what could not be sent yet."""

    def __init__(self, port: Port, instrument: SerialInstrument) -> None:
        self.port = port
        self._instrument = instrument
        self._backlog = bytearray()

    def exchange(self, now_s: float) -> None:
        """Hand what has come to the instrument and send its reply."""
        data = self.port.read()
        self.send(self._instrument.feed(data, now_s) if data else b"")

    def send(self, data: bytes) -> None:
        """Send; while nobody takes it, the oldest bytes beyond the backlog's size are lost."""
        self._backlog += data
        del self._backlog[:-_MAX_BACKLOG]
        if self._backlog:
            del self._backlog[: self.port.write(bytes(self._backlog))]


def main(arguments: Sequence[str] | None = None) -> None:
    """Serve an emulated bench; the first line printed says where, as JSON."""
    parser = argparse.ArgumentParser(prog="gyrobench-emulators", description=__doc__)
    parser.add_argument("--world", default="gyro_a", help="world file, or the name of a shipped one")
    parser.add_argument("--seed", type=int, default=0, help="seed of everything random")
    parser.add_argument("--tcp", action="store_true", help="TCP ports of the loopback, not pseudo-terminals")
    parser.add_argument("--for-s", type=float, default=None, help="end after so many seconds")
    options = parser.parse_args(arguments)
    try:
        world = find_document("worlds", options.world)
        _rehearse(world)
        bench = EmulatedBench(WallClock(), world, options.seed)
    except DocumentError as error:
        parser.exit(2, f"gyrobench-emulators: {error}\n")
    server = Server(bench, TcpPort if options.tcp else PseudoTerminal)
    try:
        sys.stdout.write(json.dumps(server.urls) + "\n")
        sys.stdout.flush()
        server.serve(options.for_s)
    except KeyboardInterrupt:
        return


def _rehearse(world: Path) -> None:
    """Let a throw-away bench align, navigate and turn: in real time nothing may wait for a compiler."""
    bench = EmulatedBench(VirtualClock(), world, 0)
    unit, axis = bench.world.unit, bench.world.axes[1]
    bench.world.power_unit(True)
    for duration_s, deed in ((60.0, unit.align), (120.0, unit.navigate), (5.0, lambda: None)):
        bench.clock.sleep(duration_s)
        bench.advance()
        deed()
    axis.move_to(10.0, bench.clock.now())
    bench.clock.sleep(10.0)
    bench.advance()


if __name__ == "__main__":
    main()
