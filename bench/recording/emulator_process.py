"""The emulators as a child process: where they serve what, from a station, and their life time.

A child process, because the emulators read no station files and the bench does not import the
emulators. The child receives options and prints the addresses as one line of JSON.
"""

from __future__ import annotations

import json
import signal
import subprocess
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import FrameType, TracebackType
from typing import NoReturn, Self
from urllib.parse import urlsplit

from gyrobench.bench.station.station import Station
from gyrobench.bench.station.station_file import StationFile
from gyrobench.drivers import ins

_PROGRAM = ("-P", "-m", "gyrobench.drivers.emulators.serve", "--until-stdin-closes")
_END_TIME_S = 10.0
_LOOPBACK = ("127.0.0.1", "localhost")


@dataclass(frozen=True)
class EmulationSettings:
    """Settings of the emulated bench; None leaves a setting to the emulators."""

    world: str | None = None  #: World file, or the name of a shipped one.
    seed: int | None = None  #: Seed of all random numbers.
    speed: float | None = None  #: Factor on real time.
    faults: str | None = None  #: Faults of the instruments: file, or the name of a shipped one.
    faults_log: Path | None = None  #: File to which each injected fault is appended.
    for_s: float | None = None  #: Real time after which the emulators end, s.

    def options(self) -> list[str]:
        """Options of :mod:`gyrobench.drivers.emulators.serve` by the same names."""
        values = vars(self).items()
        return [f"--{name.replace('_', '-')}={value}" for name, value in values if value is not None]


class EmulatorProcess:
    """The emulators of one bench, served as long as this context manager is open.

    Parameters
    ----------
    options : sequence of str
        Options of :mod:`gyrobench.drivers.emulators.serve`.

    Attributes
    ----------
    urls : dict of str to str
        Addresses of ``table``, ``chamber`` and ``ins``, and of further units: ``ins-2`` and so on; empty
        where the emulators did not start and printed the reason on stderr.
    """

    def __init__(self, options: Sequence[str]) -> None:
        self._process = subprocess.Popen(  # noqa: S603 - this project's own program
            [sys.executable, *_PROGRAM, *options], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        assert self._process.stdout is not None  # noqa: S101 - for the type checker
        line = self._process.stdout.readline()
        self.urls: dict[str, str] = json.loads(line) if line else {}

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._process.terminate()
        self.wait()
        for stream in (self._process.stdin, self._process.stdout):
            assert stream is not None  # noqa: S101 - for the type checker
            stream.close()

    def wait(self) -> int:
        """Wait for their end, or end them at Ctrl-C; returns their exit code."""
        try:
            return self._process.wait()
        except KeyboardInterrupt:
            self._process.terminate()
            return self._process.wait(_END_TIME_S)


def end_at_sigterm() -> None:
    """Make SIGTERM end this process as Ctrl-C does."""
    signal.signal(signal.SIGTERM, _interrupt)


def _interrupt(number: int, frame: FrameType | None) -> NoReturn:  # noqa: ARG001 - handles a signal
    raise KeyboardInterrupt


def emulated_dbc(station: Station) -> str | None:
    """Name of the shipped DBC file that equals the station's, or None."""
    content = station.dbc_path.read_bytes()
    shipped = Path(ins.__file__).parent.glob("*.dbc")
    return next((path.stem for path in shipped if path.read_bytes() == content), None)


def serve_options(
    station: Station,
    ports: Mapping[str, str],
    tcp: bool,
    can: str | None,
    settings: EmulationSettings | None = None,
) -> list[str]:
    """Options of :mod:`gyrobench.drivers.emulators.serve` for a station.

    Parameters
    ----------
    ports : mapping of str to str
        TCP port or link by ``table``, ``chamber`` and ``ins``. Empty takes the station's address if it
        can be served: a port of the loopback, or a link outside ``/dev``.
    tcp : bool
        Whether to serve TCP ports where neither ``ports`` nor the station gives a place.
    can : str or None
        ``slcan`` or ``socketcand``; None takes the station's.
    settings : EmulationSettings, optional
        World, speed and so on; the emulators' defaults without it.
    """
    file = station.file
    named = _addresses(file)
    if can not in (None, _can(file)):
        del named["ins"]
    own = {name: _port(address) for name, address in named.items()}
    if tcp:
        own = {name: port for name, port in own.items() if port.isdecimal()}
    chosen = {name: port or own.get(name, "") for name, port in ports.items()}
    options = [f"--{name}-port={port}" for name, port in chosen.items() if port]
    options += [f"--table-dialect={file.rate_table.dialect}", f"--chamber-dialect={file.chamber.dialect}"]
    options += [f"--frames={frames}"] if (frames := emulated_dbc(station)) else []
    if len(station.units) > 1:
        events = [f"--power-event={unit.file.unit.power_event}" for unit in station.units]
        options += [f"--units={len(events)}", *events]
    options += settings.options() if settings else []
    return [*options, f"--can={can or _can(file)}", *(["--tcp"] if tcp else [])]


def _can(file: StationFile) -> str:
    return "socketcand" if file.ins.interface == "socketcand" else "slcan"


def _addresses(file: StationFile) -> dict[str, str]:
    options = file.ins.options
    daemon = f"socket://{options.get('host', '')}:{options.get('port', '')}"
    ins = {"socketcand": daemon, "slcan": file.ins.channel}.get(file.ins.interface, "")
    return {"table": file.rate_table.port, "chamber": file.chamber.port, "ins": ins}


def _port(address: str) -> str:
    url = urlsplit(address)
    if url.scheme == "socket" and url.hostname in _LOOPBACK and url.port:
        return str(url.port)
    is_link = address.startswith("/") and not address.startswith("/dev/")
    return address if is_link else ""
