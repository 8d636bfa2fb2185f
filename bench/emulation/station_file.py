"""The station file of a served bench: a station with the addresses of its emulators filled in."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import yaml

from gyrobench.bench.emulation.serving import emulated_frames
from gyrobench.bench.foundations.documents import parse_document, validate
from gyrobench.bench.foundations.errors import DocumentError
from gyrobench.bench.foundations.files import write_whole
from gyrobench.bench.station.document import StationFile
from gyrobench.bench.station.station import Station

#: python-can waits so long for an adapter that starts anew when it is opened; this one is up.
_SLCAN_OPTIONS = {"sleep_after_open": 0.05}
#: slcan stamps frames as they are taken from the bus: no later than an epoch of the INS, s.
_POLL_S = 0.1
#: Real readings take their time; what is read rarely would be old by one that comes late, s.
_READINGS_S = 5.0
_WIDTH = 110


def write_station_file(path: Path, station: Station, urls: Mapping[str, str], speed: float) -> None:
    """Write a station file with which the served bench can be used at once.

    Parameters
    ----------
    path : Path
        Is replaced if it exists.
    station : Station
        All that is no address comes from here.
    urls : mapping of str to str
        Where ``table``, ``chamber`` and ``ins`` are.
    speed : float
        How many times as fast as real time the emulators live.

    Raises
    ------
    DocumentError
        No emulated INS sends what the station's DBC file describes.
    """
    if emulated_frames(station) is None:
        raise DocumentError(
            f"{station.path}: no emulated INS sends the frames of {station.dbc_path.name}; serve a station "
            "with a shipped DBC file, such as `emulated`"
        )
    text = station_text(station, urls, speed)
    validate(parse_document(text, path), StationFile)
    write_whole(path, text.encode())


def station_text(station: Station, urls: Mapping[str, str], speed: float) -> str:
    """YAML of the station with these addresses, on a wall clock."""
    data = yaml.safe_load(station.path.read_text(encoding="utf-8"))
    first = {
        "station": data.pop("station"),
        "description": f"Emulators of the station {station.file.station} as `gyrobench emulate` serves them.",
        "clock": "wall",
        "speed": speed,
        "poll_period_s": min(station.poll_period_s, _POLL_S),
        "instruments_period_s": min(station.instruments_period_s, _READINGS_S),
    }
    data = first | {key: value for key, value in data.items() if key not in first}
    data["rate_table"] |= {"port": urls["table"]}
    data["chamber"] |= {"port": urls["chamber"]}
    data["ins"] = _ins_section(data["ins"], urls["ins"]) | {"dbc": f"{emulated_frames(station)}.dbc"}
    body = yaml.safe_dump(data, sort_keys=False, width=_WIDTH, allow_unicode=True, default_flow_style=None)
    return (
        "# Written by `gyrobench emulate`: the ports are those of the emulators that it started, and are\n"
        "# gone when they end. `speed` is theirs; the clocks of both have to run alike.\n" + body
    )


def _ins_section(section: dict[str, Any], url: str) -> dict[str, Any]:
    rest = {key: value for key, value in section.items() if key not in ("interface", "channel", "options")}
    where = urlsplit(url)
    if where.scheme != "socketcand":
        return {"interface": "slcan", "channel": url, "options": _SLCAN_OPTIONS} | rest
    rest.pop("bitrate", None)  # the daemon's own
    options = {"host": where.hostname, "port": where.port}
    return {"interface": "socketcand", "channel": where.path.strip("/"), "options": options} | rest
