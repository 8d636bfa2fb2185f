"""The emulated bench as a program of its own, at pseudo-terminals or TCP ports of the loopback.

``gyrobench emulate`` starts it. Any client can talk to the instruments: this project's bench, pymodbus,
python-can, a terminal program. The first line that it prints says where they are, as JSON.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import signal
import sys
import tempfile
import threading
from collections.abc import Callable, Sequence
from pathlib import Path
from types import FrameType
from typing import NoReturn

from gyrobench.bench.foundations.clock import VirtualClock, WallClock
from gyrobench.bench.foundations.errors import DocumentError
from gyrobench.bench.foundations.shipped import find_document
from gyrobench.drivers.emulators.bench import EmulatedBench
from gyrobench.drivers.emulators.server import Server
from gyrobench.drivers.served_ports import Port, PseudoTerminal, TcpPort

_INSTRUMENTS = ("table", "chamber", "ins")
_MOST_SPEED = 100.0


def main(arguments: Sequence[str] | None = None) -> None:
    """Serve an emulated bench until it is told to end."""
    parser = _parser()
    options = parser.parse_args(arguments)
    if options.until_stdin_closes:
        threading.Thread(target=_end_with_stdin, daemon=True).start()
    with contextlib.ExitStack() as opened, contextlib.suppress(KeyboardInterrupt):
        try:
            world = find_document("worlds", options.world)
            faults = find_document("faults", options.faults) if options.faults else None
            _rehearse(world)
            clock = WallClock(speed=options.speed)
            bench = EmulatedBench(
                clock,
                world,
                options.seed,
                faults,
                options.faults_log,
                table=options.table_dialect,
                chamber=options.chamber_dialect,
            )
            bench.ins.speak(options.frames)
        except DocumentError as error:
            parser.exit(2, f"gyrobench emulate: {error}\n")
        signal.signal(signal.SIGTERM, _end)
        try:
            server = Server(bench, _port_maker(opened, options), options.can == "socketcand")
        except OSError as error:
            parser.exit(2, f"gyrobench emulate: can't serve there: {error}. Choose another port or path.\n")
        opened.callback(server.close)
        sys.stdout.write(json.dumps(server.urls) + "\n")
        sys.stdout.flush()
        server.serve(None if options.for_s is None else options.for_s * options.speed)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m gyrobench.drivers.emulators.serve", description=__doc__)
    parser.add_argument("--world", default="gyro_a", help="world file, or the name of a shipped one")
    parser.add_argument("--seed", type=int, default=0, help="seed of everything random")
    parser.add_argument("--faults", default="", help="list of faults, or the name of a shipped one")
    parser.add_argument("--faults-log", type=Path, help="file to which each injected fault is added as JSON")
    parser.add_argument("--tcp", action="store_true", help="TCP ports of the loopback, not pseudo-terminals")
    for name in _INSTRUMENTS:
        parser.add_argument(
            f"--{name}-port", default="", help=f"number of the {name}'s TCP port, or link to its terminal"
        )
    parser.add_argument("--table-dialect", default="acutrol3000", help="what the table speaks")
    parser.add_argument("--chamber-dialect", default="watlow_f4", help="what the chamber speaks")
    parser.add_argument("--frames", default="gyrobench_ins", help="which frames the INS sends")
    parser.add_argument(
        "--can", choices=("slcan", "socketcand"), default="slcan", help="what carries the INS's frames"
    )
    parser.add_argument("--speed", type=_speed, default=1.0, help="how many times as fast as real time")
    parser.add_argument("--for-s", type=float, default=None, help="end after so many seconds of real time")
    parser.add_argument("--until-stdin-closes", action="store_true", help="end with the program that reads")
    return parser


def _speed(text: str) -> float:
    speed = float(text)
    if not 1.0 <= speed <= _MOST_SPEED:
        raise argparse.ArgumentTypeError(f"1 to {_MOST_SPEED:g} is possible; found {text}")
    return speed


def _end(number: int, frame: FrameType | None) -> NoReturn:  # noqa: ARG001 - the handler of a signal
    raise KeyboardInterrupt


def _end_with_stdin() -> None:
    """End with the program that started this one, however that ends."""
    while os.read(sys.stdin.fileno(), 1):
        pass
    os.kill(os.getpid(), signal.SIGTERM)


def _port_maker(
    opened: contextlib.ExitStack, options: argparse.Namespace
) -> Callable[[str, Callable[[], bytes]], Port]:
    """Make ports; pseudo-terminals that can go away get links, so that they come back under their names."""
    folder: Path | None = None
    if options.faults:
        name = opened.enter_context(tempfile.TemporaryDirectory(prefix="gyrobench-emulators-"))
        folder = Path(name)

    def make_port(name: str, greet: Callable[[], bytes]) -> Port:
        where: str = getattr(options, f"{name}_port")
        if where.isdecimal():
            return TcpPort(int(where), greet)
        if (name == "ins" and options.can == "socketcand") or (options.tcp and not where):
            return TcpPort(0, greet)
        if where:
            return PseudoTerminal(Path(where))
        return PseudoTerminal(folder / name if folder else None)

    return make_port


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
