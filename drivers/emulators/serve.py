"""Serves an emulated bench as a separate program, at pseudo-terminals or TCP ports of the loopback.

``gyrobench emulate`` starts it. Any client can use the instruments: this project's bench, pymodbus,
python-can, a terminal program. The first line of output contains their addresses as JSON.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import math
import os
import selectors
import signal
import sys
import tempfile
import threading
from collections import deque
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

from gyrobench.bench.foundations.clock import WallClock
from gyrobench.bench.foundations.errors import DocumentError
from gyrobench.bench.foundations.shipped import find_document
from gyrobench.drivers.emulators.bench import EmulatedBench, channel_name, compile_world
from gyrobench.drivers.emulators.can_adapters import BUS_NAME, CanAdapter, SlcanAdapter, SocketcandDaemon
from gyrobench.drivers.emulators.dialect import Connection, SerialInstrument
from gyrobench.drivers.served_ports import Port, PseudoTerminal, TcpClient, TcpListener, TcpPort

_INSTRUMENTS = ("table", "chamber", "ins")
_MAX_SPEED = 100.0
#: Period at which the world advances, s of the bench's time: the maximum delay of its frames.
_PERIOD_S = 0.01
_MAX_BACKLOG = 65536


class _Server:
    """Serves the instruments of an emulated bench at ports: table, chamber and the INS of each unit.

    ``make_port`` makes a port for the instrument of a name. With ``socketcand``, a daemon for any number of
    clients serves each INS instead of an slcan adapter; the first daemon is on ``daemon_port``.
    """

    def __init__(
        self, bench: EmulatedBench, make_port: Callable[[str], Port], socketcand: bool, daemon_port: int
    ) -> None:
        self._bench = bench
        self._lines: list[_Line | _Daemon] = []
        #: Addresses of ``table``, ``chamber``, ``ins``, and ``ins-2`` and so on of further units.
        self.urls: dict[str, str] = {}
        for name, instrument in bench.serial.items():
            self._add(name, make_port(name), instrument, bench.connections[name])
        for number, unit in enumerate(bench.units, 1):
            name = channel_name(number)
            # Faults of the bus act on the adapter's channel; the adapter itself stays plugged in.
            if socketcand:
                make_adapter = partial(SocketcandDaemon, unit.bus, unit.connection)
                daemon = _Daemon(daemon_port if number == 1 else 0, make_adapter)
                self._lines.append(daemon)
                self.urls[name] = daemon.url
            else:
                self._add(name, make_port(name), SlcanAdapter(unit.bus, unit.connection), Connection())

    def _add(self, name: str, port: Port, instrument: SerialInstrument, connection: Connection) -> None:
        self._lines.append(_Line(port, instrument, connection))
        self.urls[name] = port.url

    def close(self) -> None:
        """Close all ports and remove their links."""
        for line in self._lines:
            line.close()

    def serve(self, duration_s: float | None = None) -> None:
        """Serve for ``duration_s`` on the bench's clock, or without end."""
        clock = self._bench.clock
        end_s = None if duration_s is None else clock.now() + duration_s
        while end_s is None or clock.now() < end_s:
            self._wait()
            self._bench.advance()
            for line in self._lines:
                line.exchange(clock.now())

    def _wait(self) -> None:
        with selectors.DefaultSelector() as selector:
            for line in self._lines:
                for port in line.ports():
                    selector.register(port, selectors.EVENT_READ)
            clock = self._bench.clock
            due_s = min(line.due_s for line in self._lines)
            selector.select(max(0.0, min(_PERIOD_S, due_s - clock.now()) / clock.speed))


class _Line:
    """An instrument on its port, with its pending replies and unsent bytes."""

    def __init__(self, port: Port | TcpClient, instrument: SerialInstrument, connection: Connection) -> None:
        self.port = port
        self.plugged_in = True
        self._instrument = instrument
        self._connection = connection
        self._generation = connection.generation
        self._replies: deque[tuple[float, bytes]] = deque()
        self._backlog = bytearray()

    def ports(self) -> list[Port | TcpClient]:
        """Ports to wait for."""
        return [self.port] if self.plugged_in else []

    @property
    def due_s(self) -> float:
        """Time of the next reply; infinite for none."""
        return self._replies[0][0] if self._replies else math.inf

    def exchange(self, now_s: float) -> None:
        """Pass received bytes to the instrument and send its reply after its latency."""
        self._update_plug()
        data = self.port.read() if self.plugged_in else b""
        reply = self._instrument.feed(data, now_s) if data else b""
        if reply:
            self._replies.append((now_s + self._instrument.latency_s, reply))
        while self.due_s <= now_s:
            self.send(self._replies.popleft()[1])
        self.send(self._instrument.from_bus() if isinstance(self._instrument, CanAdapter) else b"")

    def close(self) -> None:
        """Close the port."""
        if self.plugged_in:
            self.plugged_in = False
            self.port.unplug()

    def _update_plug(self) -> None:
        if self._connection.generation == self._generation or isinstance(self.port, TcpClient):
            return
        self._generation = self._connection.generation
        if self.plugged_in:
            self.port.unplug()
            self._replies.clear()
            self._backlog.clear()
        self.plugged_in = not self._connection.broken
        if self.plugged_in:
            self.port.plug_in()

    def send(self, data: bytes) -> None:
        """Send bytes; without a reader, the oldest bytes beyond the maximum backlog are lost."""
        self._backlog += data
        del self._backlog[:-_MAX_BACKLOG]
        if self._backlog and self.plugged_in:
            del self._backlog[: self.port.write(bytes(self._backlog))]


class _Daemon:
    """The socketcand daemon on its port, with an adapter for each client."""

    due_s = math.inf  # frames and answers go out at once

    def __init__(self, number: int, make_adapter: Callable[[], SocketcandDaemon]) -> None:
        self._listener = TcpListener(number)
        self._make_adapter = make_adapter
        self._clients: list[tuple[TcpClient, SocketcandDaemon, _Line]] = []
        self.url = f"{self._listener.url.replace('socket://', 'socketcand://')}/{BUS_NAME}"

    def ports(self) -> list[TcpListener | TcpClient]:
        """Ports to wait for."""
        return [self._listener, *(client for client, _, _ in self._clients)]

    def exchange(self, now_s: float) -> None:
        """Accept clients, receive their commands, and send them frames and answers."""
        while client := self._listener.accept(SocketcandDaemon.GREETING):
            adapter = self._make_adapter()
            self._clients.append((client, adapter, _Line(client, adapter, Connection())))
        for client, adapter, line in self._clients.copy():
            line.exchange(now_s)
            if not client.is_connected:
                adapter.leave_bus()
                self._clients.remove((client, adapter, line))

    def close(self) -> None:
        """Disconnect all clients and stop listening."""
        for client, _, _ in self._clients:
            client.unplug()
        self._listener.unplug()


def main(arguments: Sequence[str] | None = None) -> None:
    """Serve an emulated bench until a signal or the end of its time."""
    parser = _parser()
    options = parser.parse_args(arguments)
    if options.until_stdin_closes:
        threading.Thread(target=_end_with_stdin, daemon=True).start()
    with contextlib.ExitStack() as opened, contextlib.suppress(KeyboardInterrupt):
        try:
            world = find_document("worlds", options.world)
            faults = find_document("faults", options.faults) if options.faults else None
            compile_world()
            clock = WallClock(speed=options.speed)
            bench = EmulatedBench(
                clock,
                world,
                options.seed,
                faults,
                options.faults_log,
                table=options.table_dialect,
                chamber=options.chamber_dialect,
                chamber_options=dict(each.split("=", 1) for each in options.chamber_option),
                units=options.units,
            )
            for unit in bench.units:
                unit.ins.use_format(options.frames)
            for unit, event in zip(bench.units, options.power_event, strict=False):
                unit.power_event = event
        except DocumentError as error:
            parser.exit(2, f"gyrobench emulate: {error}\n")
        signal.signal(signal.SIGTERM, signal.default_int_handler)
        try:
            daemon_port = int(options.ins_port) if options.ins_port.isdecimal() else 0
            server = _Server(bench, _port_maker(opened, options), options.can == "socketcand", daemon_port)
        except (OSError, OverflowError) as error:
            parser.exit(2, f"gyrobench emulate: can't open a port: {error}. Choose another port or path.\n")
        opened.callback(server.close)
        sys.stdout.write(json.dumps(server.urls) + "\n")
        sys.stdout.flush()
        server.serve(None if options.for_s is None else options.for_s * options.speed)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m gyrobench.drivers.emulators.serve", description=__doc__)
    parser.add_argument("--world", default="gyro_a", help="world file, or the name of a shipped one")
    parser.add_argument("--units", type=int, default=1, help="minimum number of units on the table")
    parser.add_argument(
        "--power-event", type=int, action="append", default=[],
        help="event output of the chamber that powers a unit; repeat it for each, in order",
    )  # fmt: skip
    parser.add_argument("--seed", type=int, default=0, help="seed of everything random")
    parser.add_argument("--faults", default="", help="list of faults, or the name of a shipped one")
    parser.add_argument(
        "--faults-log", type=Path, help="log file; each injected fault appends a line of JSON"
    )
    parser.add_argument(
        "--tcp", action="store_true", help="use TCP ports of the loopback instead of pseudo-terminals"
    )
    for name in _INSTRUMENTS:
        parser.add_argument(
            f"--{name}-port", default="", help=f"number of the {name}'s TCP port, or link to its terminal"
        )
    parser.add_argument("--table-dialect", default="acutrol3000", help="dialect of the table")
    parser.add_argument("--chamber-dialect", default="watlow_f4", help="dialect of the chamber")
    parser.add_argument(
        "--chamber-option", type=_key_and_value, action="append", default=[], help="KEY=VALUE of its emulator"
    )
    parser.add_argument("--frames", default="gyrobench_ins", help="set of frames that the INS sends")
    parser.add_argument(
        "--can",
        choices=("slcan", "socketcand"),
        default="slcan",
        help="adapter that carries the INS's frames",
    )
    parser.add_argument("--speed", type=_speed, default=1.0, help="speed relative to real time")
    parser.add_argument("--for-s", type=float, default=None, help="end after this many seconds of real time")
    parser.add_argument(
        "--until-stdin-closes", action="store_true", help="end when the standard input closes"
    )
    return parser


def _key_and_value(text: str) -> str:
    if "=" not in text:
        raise argparse.ArgumentTypeError(f"expected KEY=VALUE; found {text}")
    return text


def _speed(text: str) -> float:
    speed = float(text)
    if not 1.0 <= speed <= _MAX_SPEED:
        raise argparse.ArgumentTypeError(f"the speed must be 1 to {_MAX_SPEED:g}; found {text}")
    return speed


def _end_with_stdin() -> None:
    """End this program when the program that started it ends, even if that is killed."""
    while os.read(sys.stdin.fileno(), 1):
        pass
    os.kill(os.getpid(), signal.SIGTERM)


def _port_maker(opened: contextlib.ExitStack, options: argparse.Namespace) -> Callable[[str], Port]:
    """Return a function that makes ports.

    With faults, pseudo-terminals get links, so that they keep their names when they are opened again.
    """
    folder: Path | None = None
    if options.faults:
        name = opened.enter_context(tempfile.TemporaryDirectory(prefix="gyrobench-emulators-"))
        folder = Path(name)

    def make_port(name: str) -> Port:
        requested: str = getattr(options, f"{name}_port", "")  # further units have none
        if requested.isdecimal():
            return TcpPort(int(requested))
        if options.tcp and not requested:
            return TcpPort()
        if requested:
            return PseudoTerminal(Path(requested))
        return PseudoTerminal(folder / name if folder else None)

    return make_port


if __name__ == "__main__":
    main()
