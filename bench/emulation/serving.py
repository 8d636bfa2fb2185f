"""Where the emulators of a station are to be, and what they are to speak."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import urlsplit

from gyrobench.bench.station.document import StationFile
from gyrobench.bench.station.station import Station
from gyrobench.drivers import ins

_LOOPBACK = ("127.0.0.1", "localhost")


@dataclass(frozen=True)
class Life:
    """How the emulated bench lives; what is None is left to the emulators.

    Attributes
    ----------
    world : str or None
        World file, or the name of a shipped one.
    seed : int or None
        Of everything random.
    speed : float or None
        How many times as fast as real time.
    faults : str or None
        Faults of the instruments: file, or the name of a shipped one.
    faults_log : Path or None
        File to which each injected fault is added.
    for_s : float or None
        Real time after which it ends, s.
    """

    world: str | None = None
    seed: int | None = None
    speed: float | None = None
    faults: str | None = None
    faults_log: Path | None = None
    for_s: float | None = None

    def options(self) -> list[str]:
        """Options of :mod:`gyrobench.drivers.emulators.serve` by the same names."""
        values = vars(self).items()
        return [f"--{name.replace('_', '-')}={value}" for name, value in values if value is not None]


def emulated_frames(station: Station) -> str | None:
    """Name of the frames of the emulated INS that fit the station's DBC file; None where none do."""
    wanted = station.dbc_path.read_bytes()
    shipped = Path(ins.__file__).parent.glob("*.dbc")
    return next((path.stem for path in shipped if path.read_bytes() == wanted), None)


def serve_options(
    station: Station, ports: Mapping[str, str], tcp: bool, can: str | None, life: Life | None = None
) -> list[str]:
    """Options of :mod:`gyrobench.drivers.emulators.serve` for a station.

    Parameters
    ----------
    ports : mapping of str to str
        TCP port or link by ``table``, ``chamber`` and ``ins``; where one is empty the station's own
        address counts, if it can be served: a port of the loopback, or a link outside ``/dev``.
    tcp : bool
        Whether TCP ports are to be served, where neither names a place.
    can : str or None
        ``slcan`` or ``socketcand``; None for what the station says.
    life : Life, optional
        World, speed and so on; the emulators' own without it.
    """
    file = station.file
    named = _addresses(file)
    if can not in (None, _can(file)):
        del named["ins"]
    own = {name: _port(address) for name, address in named.items()}
    if tcp:
        own = {name: port for name, port in own.items() if port.isdecimal()}
    wanted = {name: port or own.get(name, "") for name, port in ports.items()}
    options = [f"--{name}-port={port}" for name, port in wanted.items() if port]
    options += [f"--table-dialect={file.rate_table.dialect}", f"--chamber-dialect={file.chamber.dialect}"]
    options += [f"--frames={frames}"] if (frames := emulated_frames(station)) else []
    options += life.options() if life else []
    return [*options, f"--can={can or _can(file)}", *(["--tcp"] if tcp else [])]


def _can(file: StationFile) -> str:
    return "socketcand" if file.ins.interface == "socketcand" else "slcan"


def _addresses(file: StationFile) -> dict[str, str]:
    options = file.ins.options
    of_daemon = f"socket://{options.get('host', '')}:{options.get('port', '')}"
    ins = {"socketcand": of_daemon, "slcan": file.ins.channel}.get(file.ins.interface, "")
    return {"table": file.rate_table.port, "chamber": file.chamber.port, "ins": ins}


def _port(address: str) -> str:
    url = urlsplit(address)
    if url.scheme == "socket" and url.hostname in _LOOPBACK and url.port:
        return str(url.port)
    is_link = address.startswith("/") and not address.startswith("/dev/")
    return address if is_link else ""
