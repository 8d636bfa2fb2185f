"""How people and other programs reach a served bench."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from urllib.parse import urlsplit

from gyrobench.bench.station.document import StationFile

#: The emulated chamber controller's output that feeds the unit.
UNIT_POWER_EVENT = 2


def guide(urls: Mapping[str, str], file: StationFile, speed: float, station_path: Path | None) -> str:
    """Text that says where each instrument is, and what to type to talk to it.

    Parameters
    ----------
    urls : mapping of str to str
        Where ``table``, ``chamber`` and ``ins`` are.
    file : StationFile
        Says which dialects they speak.
    station_path : Path, optional
        The station file that was written for them.
    """
    pace = "in real time" if speed == 1.0 else f"{speed:g} times as fast as real time"
    lines = [f"The emulated bench lives {pace}, until Ctrl-C."]
    table, chamber, ins = urls["table"], urls["chamber"], urls["ins"]
    lines += _entry("Table", f"{table}  {file.rate_table.dialect}", _terminal(table))
    lines += _entry("Chamber", f"{chamber}  {file.chamber.dialect}", *_chamber_clients(file, chamber))
    lines += _entry("INS", f"{ins}  {file.ins.dbc}", *_can_clients(ins))
    lines += [f"    It is silent until event output {UNIT_POWER_EVENT} of the chamber is on."]
    if station_path:
        command = f"gyrobench run ten_minute_check --station {station_path}"
        lines += _entry("Bench", f"{station_path}  station file", command)
    return "\n".join(lines)


def _entry(title: str, where: str, *commands: str) -> list[str]:
    return ["", f"{title:<9}{where}", *(f"    {command}" for command in commands)]


def _chamber_clients(file: StationFile, url: str) -> list[str]:
    if file.chamber.dialect != "watlow_f4":
        return [_terminal(url)]
    where = urlsplit(url)
    if where.scheme == "socket":
        client = f'ModbusTcpClient("{where.hostname}", port={where.port}, framer=FramerType.RTU)'
        return [f"{client} of pymodbus"]
    return [f"mbpoll -a {getattr(file.chamber, 'address', 1)} -b 9600 -P none -0 -r 100 -c 2 {url}"]


def _terminal(url: str) -> str:
    where = urlsplit(url)
    if where.scheme == "socket":
        return f"nc -C {where.hostname} {where.port}"
    return f"picocom --omap crcrlf {url}"


def _can_clients(url: str) -> list[str]:
    where = urlsplit(url)
    if where.scheme != "socketcand":
        return [f"python -m can.viewer -i slcan -c {url}"]
    return [
        f"python -m can.viewer -i socketcand -c {where.path.strip('/')} \\",
        f"    --bus-kwargs host={where.hostname} port={where.port}",
    ]
