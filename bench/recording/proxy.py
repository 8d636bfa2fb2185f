"""A port at which other programs reach an instrument of a station, recorded meanwhile."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path

from gyrobench.bench.foundations.clock import Clock
from gyrobench.bench.foundations.errors import ConnectionFailedError, DocumentError
from gyrobench.bench.foundations.files import make_folder
from gyrobench.bench.recording.record import Instrument, headers
from gyrobench.bench.station.instruments import CHAMBER, RATE_TABLE
from gyrobench.bench.station.station import Station
from gyrobench.drivers.dialects import LineDefaults
from gyrobench.drivers.recording.document import RecordingHeader
from gyrobench.drivers.recording.proxy import Proxy
from gyrobench.drivers.recording.tap import RecordingFile
from gyrobench.drivers.serial_line import open_port
from gyrobench.drivers.served_ports import Port, PseudoTerminal, TcpPort

_SLCAN_BAUDRATE = 115200


@contextlib.contextmanager
def proxy(
    station: Station, instrument: Instrument, path: Path, clock: Clock, where: str, note: str = ""
) -> Iterator[tuple[Proxy, str]]:
    """Open the instrument, and serve it at another port.

    Parameters
    ----------
    path : Path
        Recording to write; must not exist.
    where : str
        Number of a TCP port of the loopback, path of a link to a pseudo-terminal, or empty for a
        pseudo-terminal without one.

    Yields
    ------
    Proxy
        Ready to pass on.
    str
        Where programs reach it.

    Raises
    ------
    DocumentError
        The instrument hangs on no line of bytes, or nothing can be served there.
    ConnectionFailedError
        Its port can't be opened.
    RunFolderError
        The recording can't be written.
    """
    header, url, baudrate, parity = _line(station, instrument, note)
    with contextlib.ExitStack() as opened:
        try:
            port = open_port(url, clock, baudrate, parity)
        except (OSError, ValueError) as error:
            raise ConnectionFailedError(instrument, f"can't open {url}: {error}. Check the cable.") from error
        opened.callback(port.close)
        try:
            served: Port = TcpPort(int(where)) if where.isdecimal() else _terminal(where)
        except OSError as error:
            raise DocumentError(f"{where}: nothing can be served there: {error}") from error
        opened.callback(served.unplug)
        make_folder(path.parent)
        header = header.model_copy(update={"baudrate": baudrate, "parity": parity})
        file = RecordingFile(path, header, clock)
        opened.callback(file.close)
        yield Proxy(served, port, file, clock), served.url


def _terminal(where: str) -> PseudoTerminal:
    return PseudoTerminal(Path(where) if where else None)


def _line(station: Station, instrument: Instrument, note: str) -> tuple[RecordingHeader, str, int, str]:
    """Header, address, baud rate and parity."""
    if instrument == "ins":
        section = station.file.ins
        if section.interface != "slcan":
            raise DocumentError(
                f"{station.path}: the INS is on {section.interface}, no line of bytes that a proxy could "
                "pass on; record it without --proxy"
            )
        baudrate = int(section.options.get("tty_baudrate", _SLCAN_BAUDRATE))
        return RecordingHeader(instrument="ins", note=note), section.channel, baudrate, "N"
    line = station.file.rate_table if instrument == "table" else station.file.chamber
    usual: LineDefaults = line.installed_dialect.line
    header = headers(station, note)[RATE_TABLE if instrument == "table" else CHAMBER]
    return header, line.port, line.baudrate or usual.baudrate, line.parity or usual.parity
