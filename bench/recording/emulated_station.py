"""Served emulators: their child process, their station file, and the printed guide to their ports.

The emulators run in a child process, because they read no station files and the bench does not import them.
The child receives options and prints the addresses as one line of JSON.
"""

from __future__ import annotations

import json
import shlex
import signal
import subprocess
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self
from urllib.parse import urlsplit

import yaml

from gyrobench.bench.foundations.documents import parse_document, validate
from gyrobench.bench.foundations.errors import DocumentError
from gyrobench.bench.foundations.files import write_whole
from gyrobench.bench.foundations.packages import CAN_FORMATS, installed
from gyrobench.bench.station.station import Station
from gyrobench.bench.station.station_file import StationFile
from gyrobench.drivers import ins

#: The emulated chamber controller's output that powers the INS.
_UNIT_POWER_EVENT = 2

#: Shortens python-can's wait for a restarting adapter: this one is running.
_SLCAN_OPTIONS = {"sleep_after_open": 0.05}
#: slcan stamps frames when they are read: poll at least once per epoch of the INS, s.
_MAX_POLL_PERIOD_S = 0.1
#: Readings take real time: with a longer period a single late reading would trip an interlock, s.
_MAX_INSTRUMENTS_PERIOD_S = 5.0
_WIDTH = 110


def write_station_file(path: Path, station: Station, urls: Mapping[str, str], speed: float) -> None:
    """Write a station file for the served emulators; replaces an existing file.

    All but the addresses comes from ``station``; gravity, if not declared, is the normal gravity at its
    location, as in the emulated bench. ``urls`` are the addresses of ``table``, ``chamber`` and ``ins``, and
    of further units: ``ins-2`` and so on; ``speed`` is the emulators' factor on real time. A DBC file that is
    not shipped is copied beside it. Raises DocumentError if no emulated INS sends the frames of the station's
    DBC file.
    """
    if emulated_frames(station) is None:
        raise DocumentError(
            f"{station.path}: no emulated INS sends the frames of {station.dbc_path.name}; serve a station "
            "with a shipped DBC file, such as `emulated`, or install a package with its frames"
        )
    if station.dbc_path.parent.resolve() not in (Path(ins.__file__).parent.resolve(), path.parent.resolve()):
        write_whole(path.with_name(station.dbc_path.name), station.dbc_path.read_bytes())
    text = _station_text(station, urls, speed)
    validate(parse_document(text, path), StationFile)
    write_whole(path, text.encode())


def _station_text(station: Station, urls: Mapping[str, str], speed: float) -> str:
    """YAML of the station with these addresses, on a wall clock."""
    data = yaml.safe_load(station.path.read_text(encoding="utf-8"))
    overrides = {
        "station": data.pop("station"),
        "description": f"Emulators of the station {station.file.station}, served by `gyrobench emulate`.",
        "clock": "wall",
        "speed": speed,
        "poll_period_s": min(station.file.poll_period_s, _MAX_POLL_PERIOD_S),
        "instruments_period_s": min(station.file.instruments_period_s, _MAX_INSTRUMENTS_PERIOD_S),
    }
    data = overrides | {key: value for key, value in data.items() if key not in overrides}
    data["location"] = {"gravity_mps2": round(station.site.gravity, 7)} | data["location"]
    data["rate_table"] |= {"port": urls["table"]}
    data["chamber"] |= {"port": urls["chamber"]}
    data["ins"] = _ins_section(data["ins"], urls["ins"])
    for entry, (_, url) in zip(data.get("units", []), _numbered_units(urls), strict=False):
        entry |= _ins_section(entry, url) | {"identifier_offset": 0}
    body = yaml.safe_dump(data, sort_keys=False, width=_WIDTH, allow_unicode=True, default_flow_style=None)
    return (
        "# Written by `gyrobench emulate`: the ports belong to the emulators that it started and\n"
        "# disappear with them. `speed` is the emulators' factor on real time; keep it equal.\n" + body
    )


def _numbered_units(urls: Mapping[str, str]) -> list[tuple[int, str]]:
    numbered = {int(name.partition("-")[2] or 1): url for name, url in urls.items() if name.startswith("ins")}
    return sorted(numbered.items())


def _ins_section(section: dict[str, Any], url: str) -> dict[str, Any]:
    rest = {key: value for key, value in section.items() if key not in ("interface", "channel", "options")}
    parts = urlsplit(url)
    if parts.scheme != "socketcand":
        return {"interface": "slcan", "channel": url, "options": _SLCAN_OPTIONS} | rest
    rest.pop("bitrate", None)  # the daemon sets it
    options = {"host": parts.hostname, "port": parts.port}
    return {"interface": "socketcand", "channel": parts.path.strip("/"), "options": options} | rest


def guide(urls: Mapping[str, str], station: Station, speed: float, station_path: Path | None) -> str:
    """Text with the address of each instrument and a command to reach it; ``urls`` as above.

    ``station`` gives the dialects and the DBC file; ``station_path`` is the file that was written for them.
    """
    pace = "in real time" if speed == 1.0 else f"{speed:g} times as fast as real time"
    file, table, chamber, units = station.file, urls["table"], urls["chamber"], _numbered_units(urls)
    frames = station.dbc_path.name if emulated_frames(station) else f"{_DEFAULT_FRAMES}.dbc"
    events = {number: unit.power_event or file.unit.power_event for number, unit in enumerate(file.units, 1)}
    lines = [
        f"The emulated bench runs {pace} until Ctrl-C.",
        *_guide_entry("Table", f"{table}  {file.rate_table.dialect}", _serial_terminal(table)),
        *_guide_entry("Chamber", f"{chamber}  {file.chamber.dialect}", *_chamber_clients(file, chamber)),
    ]
    for number, url in units:
        event = events.get(number, _UNIT_POWER_EVENT + number - 1)
        lines += [
            *_guide_entry(
                f"INS {number}" if len(units) > 1 else "INS", f"{url}  {frames}", *_can_clients(url)
            ),
            f"    It sends frames while event output {event} of the chamber is on.",
        ]
    if emulated_frames(station) is None:
        lines += ["", f"No emulated INS sends the frames of {station.dbc_path.name}: decode with {frames}."]
    if station_path:
        command = f"gyrobench run ten_minute_check --station {shlex.quote(str(station_path))}"
        lines += _guide_entry("Bench", f"{station_path}  station file", command)
    return "\n".join(lines)


def _guide_entry(title: str, address: str, *commands: str) -> list[str]:
    return ["", f"{title:<9}{address}", *(f"    {command}" for command in commands)]


def _chamber_clients(file: StationFile, url: str) -> list[str]:
    if file.chamber.dialect != "watlow_f4":
        return [_serial_terminal(url)]
    parts = urlsplit(url)
    if parts.scheme == "socket":
        client = f'ModbusTcpClient("{parts.hostname}", port={parts.port}, framer=FramerType.RTU)'
        return [f"{client} of pymodbus"]
    return [f"mbpoll -m rtu -a {getattr(file.chamber, 'address', 1)} -b 9600 -P none -0 -r 100 -c 2 {url}"]


def _serial_terminal(url: str) -> str:
    parts = urlsplit(url)
    if parts.scheme == "socket":
        return f"nc -C {parts.hostname} {parts.port}"
    return f"picocom --omap crcrlf {url}"


def _can_clients(url: str) -> list[str]:
    parts = urlsplit(url)
    if parts.scheme != "socketcand":
        return [f"python -m can.viewer -i slcan -c {url}"]
    return [
        f"python -m can.viewer -i socketcand -c {parts.path.strip('/')} \\",
        f"    --bus-kwargs host={parts.hostname} port={parts.port}",
    ]


#: Frames that the emulators send by default.
_DEFAULT_FRAMES = "gyrobench_ins"
_PROGRAM = ("-P", "-m", "gyrobench.drivers.emulators.serve", "--until-stdin-closes")
_END_TIME_S = 10.0
_LOOPBACK = ("127.0.0.1", "localhost")


@dataclass(frozen=True)
class EmulationSettings:
    """Settings of the emulated bench; None means the emulators' default."""

    world: str | None = None  #: World file, or the name of a shipped one.
    seed: int | None = None  #: Seed of all random numbers.
    speed: float | None = None  #: Factor on real time.
    faults: str | None = None  #: Faults of the instruments: file, or the name of a shipped one.
    faults_log: Path | None = None  #: File to which each injected fault is appended.
    for_s: float | None = None  #: Real time after which the emulators end, s.

    def options(self) -> list[str]:
        """Options of :mod:`gyrobench.drivers.emulators.serve` with the same names."""
        values = vars(self).items()
        return [f"--{name.replace('_', '-')}={value}" for name, value in values if value is not None]


class EmulatorProcess:
    """The emulators of one bench, served as long as this context manager is open.

    ``options`` are those of :mod:`gyrobench.drivers.emulators.serve`.
    """

    def __init__(self, options: Sequence[str]) -> None:
        self._process = subprocess.Popen(  # noqa: S603 - this project's own program
            [sys.executable, *_PROGRAM, *options], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        assert self._process.stdout is not None  # noqa: S101 - for the type checker
        line = self._process.stdout.readline()
        #: Addresses of ``table``, ``chamber``, ``ins``, and ``ins-2`` and so on of further units; empty if
        #: the emulators did not start and printed the reason on stderr.
        self.urls: dict[str, str] = json.loads(line) if line else {}

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._process.terminate()
        self.wait()
        for stream in (self._process.stdin, self._process.stdout):
            assert stream is not None  # noqa: S101 - for the type checker
            stream.close()

    def wait(self) -> int:
        """Wait until the emulators end, or end them at Ctrl-C; returns their exit code."""
        try:
            return self._process.wait()
        except KeyboardInterrupt:
            self._process.terminate()
            return self._process.wait(_END_TIME_S)


def end_at_sigterm() -> None:
    """Make SIGTERM end this process like Ctrl-C."""
    signal.signal(signal.SIGTERM, signal.default_int_handler)


def emulated_frames(station: Station) -> str | None:
    """Name of the emulated INS's frames that the station's DBC file describes; None if there are none.

    Those of the shipped DBC file with the same content; of a package those named in `ins.options.frames`, or
    as the DBC file.
    """
    content = station.dbc_path.read_bytes()
    shipped = Path(ins.__file__).parent.glob("*.dbc")
    name = next((path.stem for path in shipped if path.read_bytes() == content), None)
    own = str(station.file.ins.options.get("frames", station.dbc_path.stem))
    return name or (own if own in installed(CAN_FORMATS) else None)


def serve_options(
    station: Station,
    ports: Mapping[str, str],
    tcp: bool,
    can: str | None,
    settings: EmulationSettings | None = None,
) -> list[str]:
    """Options of :mod:`gyrobench.drivers.emulators.serve` for a station.

    ``ports`` has a TCP port or link for each of ``table``, ``chamber`` and ``ins``; an empty one takes the
    station's address if it can be served: a port of the loopback, or a link outside ``/dev``. ``tcp``:
    whether to serve TCP ports where neither ``ports`` nor the station gives a place. ``can`` is ``slcan`` or
    ``socketcand``; None takes the station's.
    """
    file = station.file
    addresses = _addresses(file)
    if can not in (None, _can_interface(file)):
        del addresses["ins"]
    own_ports = {name: _servable_port(address) for name, address in addresses.items()}
    if tcp:
        own_ports = {name: port for name, port in own_ports.items() if port.isdecimal()}
    selected = {name: port or own_ports.get(name, "") for name, port in ports.items()}
    options = [f"--{name}-port={port}" for name, port in selected.items() if port]
    options += [f"--table-dialect={file.rate_table.dialect}", f"--chamber-dialect={file.chamber.dialect}"]
    options += [f"--frames={frames}"] if (frames := emulated_frames(station)) else []
    if len(station.units) > 1:
        events = [f"--power-event={unit.file.unit.power_event}" for unit in station.units]
        options += [f"--units={len(events)}", *events]
    options += settings.options() if settings else []
    return [*options, f"--can={can or _can_interface(file)}", *(["--tcp"] if tcp else [])]


def _can_interface(file: StationFile) -> str:
    return "socketcand" if file.ins.interface == "socketcand" else "slcan"


def _addresses(file: StationFile) -> dict[str, str]:
    options = file.ins.options
    daemon = f"socket://{options.get('host', '')}:{options.get('port', '')}"
    ins = {"socketcand": daemon, "slcan": file.ins.channel}.get(file.ins.interface, "")
    return {"table": file.rate_table.port, "chamber": file.chamber.port, "ins": ins}


def _servable_port(address: str) -> str:
    url = urlsplit(address)
    if url.scheme == "socket" and url.hostname in _LOOPBACK and url.port:
        return str(url.port)
    is_link = address.startswith("/") and not address.startswith("/dev/")
    return address if is_link else ""
