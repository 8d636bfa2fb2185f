"""The emulated bench as a process of its own: pseudo-terminals or TCP ports of the loopback.

Table and chamber speak their protocols, the INS slcan or socketcand. Any client can talk to them:
this project's bench, pymodbus, a terminal program.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import math
import os
import selectors
import socket
import sys
import tempfile
import tty
from collections import deque
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Protocol

from bench.clock import VirtualClock, WallClock
from bench.documents import find_document
from bench.errors import DocumentError
from drivers.emulators.bench import EmulatedBench
from drivers.emulators.serial_instrument import Connection, SerialInstrument
from drivers.emulators.slcan_adapter import SlcanAdapter
from drivers.emulators.socketcand_daemon import BUS_NAME, SocketcandDaemon

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

    def unplug(self) -> None:
        """Go away, as a device that is pulled out; whoever had it open loses it."""
        ...

    def plug_in(self) -> None:
        """Come back under the same ``url``."""
        ...


class PseudoTerminal:
    """A pseudo-terminal; clients open ``url`` like a serial device.

    Parameters
    ----------
    link : Path, optional
        A symbolic link for ``url``, which stays the same when the terminal itself comes back as another.
    """

    def __init__(self, link: Path | None = None) -> None:
        self._link = link
        self.plug_in()

    def plug_in(self) -> None:
        """Come back under the same ``url``, if there is a link."""
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        self.url = os.ttyname(self._slave)
        if self._link is not None:
            self._link.symlink_to(self.url)
            self.url = str(self._link)

    def unplug(self) -> None:
        """Go away: whoever had it open gets input/output errors."""
        if self._link is not None:
            self._link.unlink()
        os.close(self._master)
        os.close(self._slave)

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
    """A TCP port of the loopback with one client at a time; a new one replaces the old.

    Parameters
    ----------
    greet : callable, optional
        Gives what a new client is told at once.
    """

    def __init__(self, greet: Callable[[], bytes] = bytes) -> None:
        self._greet = greet
        self._client: socket.socket | None = None
        self.number = 0
        self.plug_in()
        self.url = f"socket://127.0.0.1:{self.number}"

    def plug_in(self) -> None:
        """Listen, at the same port as before."""
        self._listener = socket.create_server(("127.0.0.1", self.number))
        self._listener.setblocking(False)
        self.number = self._listener.getsockname()[1]

    def unplug(self) -> None:
        """Hang up, and let nobody connect."""
        self._hang_up()
        self._listener.close()

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
            client.sendall(self._greet())
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
        Makes a port for the instrument of that name.
    socketcand : bool
        Whether the INS speaks socketcand over TCP, not slcan.

    Attributes
    ----------
    urls : dict of str to str
        Where ``table``, ``chamber`` and ``ins`` are.
    """

    def __init__(
        self, bench: EmulatedBench, make_port: Callable[[str], Port], socketcand: bool = False
    ) -> None:
        self._bench = bench
        self._lines = {
            name: _Line(make_port(name), instrument, bench.connections[name])
            for name, instrument in bench.serial.items()
        }
        self.urls = {name: line.port.url for name, line in self._lines.items()}
        # What the bus suffers is the adapter's matter; the adapter itself stays plugged in.
        self._adapter: SlcanAdapter | SocketcandDaemon
        if socketcand:
            self._adapter = daemon = SocketcandDaemon(bench.bus, bench.connections["ins"])
            port = TcpPort(daemon.greet)
            self._lines["ins"] = _Line(port, daemon, Connection())
            self.urls["ins"] = f"socketcand://127.0.0.1:{port.number}/{BUS_NAME}"
        else:
            self._adapter = SlcanAdapter(bench.bus, bench.connections["ins"])
            self._lines["ins"] = _Line(make_port("ins"), self._adapter, Connection())
            self.urls["ins"] = self._lines["ins"].port.url

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
                if line.plugged_in:
                    selector.register(line.port, selectors.EVENT_READ)
            now_s = self._bench.clock.now()
            due_s = min(line.due_s for line in self._lines.values())
            selector.select(max(0.0, min(_PERIOD_S, due_s - now_s)))


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


def main(arguments: Sequence[str] | None = None) -> None:
    """Serve an emulated bench; the first line printed says where, as JSON."""
    parser = argparse.ArgumentParser(prog="gyrobench-emulators", description=__doc__)
    parser.add_argument("--world", default="gyro_a", help="world file, or the name of a shipped one")
    parser.add_argument("--seed", type=int, default=0, help="seed of everything random")
    parser.add_argument("--tcp", action="store_true", help="TCP ports of the loopback, not pseudo-terminals")
    parser.add_argument("--can", choices=("slcan", "socketcand"), default="slcan", help="what the INS speaks")
    parser.add_argument("--faults", default="", help="list of faults, or the name of a shipped one")
    parser.add_argument("--faults-log", type=Path, help="file to which each injected fault is added as JSON")
    parser.add_argument("--for-s", type=float, default=None, help="end after so many seconds")
    options = parser.parse_args(arguments)
    try:
        world = find_document("worlds", options.world)
        faults = find_document("faults", options.faults) if options.faults else None
        _rehearse(world)
        bench = EmulatedBench(WallClock(), world, options.seed, faults, options.faults_log)
    except DocumentError as error:
        parser.exit(2, f"gyrobench-emulators: {error}\n")
    with contextlib.ExitStack() as opened, contextlib.suppress(KeyboardInterrupt):
        make_port = _port_maker(opened, options.tcp, links=faults is not None)
        server = Server(bench, make_port, options.can == "socketcand")
        sys.stdout.write(json.dumps(server.urls) + "\n")
        sys.stdout.flush()
        server.serve(options.for_s)


def _port_maker(opened: contextlib.ExitStack, tcp: bool, links: bool) -> Callable[[str], Port]:
    """Make ports; pseudo-terminals that can go away get links, so that they come back under their names."""
    if tcp:
        return lambda _: TcpPort()
    if not links:
        return lambda _: PseudoTerminal()
    folder = Path(opened.enter_context(tempfile.TemporaryDirectory(prefix="gyrobench-emulators-")))
    return lambda name: PseudoTerminal(folder / name)


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
