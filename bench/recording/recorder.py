"""Records the instruments of a station: by queries, through a proxy, or as a log of CAN frames."""

from __future__ import annotations

import contextlib
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Literal

import can
import serial

from gyrobench.bench.foundations.clock import Clock, Deadline, WallClock
from gyrobench.bench.foundations.documents import StrictModel
from gyrobench.bench.foundations.errors import ConnectionFailedError, DocumentError, NoReplyError
from gyrobench.bench.foundations.files import make_folder, write_error, write_whole
from gyrobench.bench.foundations.shipped import find_document
from gyrobench.bench.recording.replay import CHAMBER_QUERIES, TABLE_QUERIES, call_driver
from gyrobench.bench.station.bench_lock import BenchLock
from gyrobench.bench.station.instrument_sections import DialectSection
from gyrobench.bench.station.instruments import (
    CHAMBER,
    RATE_TABLE,
    Emulation,
    Outputs,
    open_chamber,
    open_ins,
    open_table,
)
from gyrobench.bench.station.station import Station
from gyrobench.drivers.chamber import Chamber
from gyrobench.drivers.frames import FrameBlock
from gyrobench.drivers.ins.can_bus import INSTRUMENT
from gyrobench.drivers.ins.can_ins import CanIns
from gyrobench.drivers.rate_table import RateTable
from gyrobench.drivers.recording.recording_file import (
    Call,
    RecordingFile,
    RecordingHeader,
    join_transfers,
    read_recording,
    recording_lines,
    recording_text,
)
from gyrobench.drivers.serial_line import open_port
from gyrobench.drivers.served_ports import Port, PseudoTerminal, TcpPort

Instrument = Literal["table", "chamber", "ins"]

#: Name in errors, function that opens it, and queries that neither move nor heat anything.
_QUERIED: Mapping[
    Instrument, tuple[str, Callable[[Station, Clock, Emulation], RateTable | Chamber], Sequence[Call]]
] = {"table": (RATE_TABLE, open_table, TABLE_QUERIES), "chamber": (CHAMBER, open_chamber, CHAMBER_QUERIES)}

#: CAN logs that stay readable after a kill.
_CAN_LOG_SUFFIXES = (".log", ".asc", ".blf")

_DEFAULT_CAN_LOG_S = 10.0
#: Time within which an INS that is on sends a frame, and one that was just switched on.
_FIRST_FRAME_S, _POWER_ON_TO_FIRST_FRAME_S = 3.0, 180.0
_CAN_POLL_S = 0.05
_SLCAN_BAUDRATE = 115200
_PROXY_PERIOD_S = 0.001
_MAX_PROXY_BYTES = 4096


class Recorder:
    """Records the instruments of a station, given by its file or the name of a shipped one.

    ``note`` goes into the header of each recording; ``report`` receives lines of progress. Raises
    DocumentError if the station file is wrong.
    """

    def __init__(
        self, station: str, emulation: Emulation, note: str, report: Callable[[str], object]
    ) -> None:
        self._station = Station(find_document("stations", station))
        self._emulation = emulation
        self._note = note
        self._report = report

    @contextlib.contextmanager
    def lines(self, folder: Path) -> Iterator[None]:
        """Record every serial line to table and chamber opened in this context, in a folder."""
        existing = set(folder.glob("*.rec"))
        headers = {name: _header(self._station, each, self._note) for each, (name, *_) in _QUERIED.items()}
        with recording_lines(folder, headers):
            try:
                yield
            finally:
                recorded = sorted(set(folder.glob("*.rec")) - existing)
                self._report(f"Recorded {', '.join(map(str, recorded)) or 'nothing: no line was opened'}")

    def record(self, instrument: Instrument, path: Path, duration_s: float | None) -> None:
        """Record the replies to queries that move nothing; of the INS, ``duration_s`` of CAN frames.

        Raises BenchInUseError if another process holds the bench. Raises DocumentError if the file exists, or
        a CAN log can't have its suffix. Raises InstrumentError if the instrument can't be reached, or its
        replies prevent the driver from continuing; the bytes until then are recorded. Raises RunFolderError
        if the file can't be written.
        """
        _check_absent(path)
        clock = self._station.new_clock()
        with BenchLock(self._station, path.parent, clock):
            if instrument == "ins":
                self._report(self._record_can(path, clock, duration_s or _DEFAULT_CAN_LOG_S))
            else:
                for call in self._record_queries(instrument, path, clock):
                    self._report(f"{call.ask}: {call.outcome()}")
        self._report(f"Recorded {path}")

    def proxy(self, instrument: Instrument, path: Path, where: str, duration_s: float | None) -> None:
        """Serve an instrument to other programs until Ctrl-C or for ``duration_s``, and record the bytes.

        ``path`` must not exist. ``where`` is the number of a TCP port of the loopback, the path of a link to
        a pseudo-terminal, or empty for a pseudo-terminal without a link. Raises DocumentError if the
        instrument is not on a serial line, or nothing can be served at ``where``. Raises
        ConnectionFailedError if the instrument's port can't be opened, or went away. Raises RunFolderError if
        the recording can't be written.
        """
        _check_absent(path)
        clock = WallClock()
        header, url = _serial_port(self._station, instrument, self._note)
        with BenchLock(self._station, path.parent, clock), contextlib.ExitStack() as resources:
            try:
                port = open_port(url, clock, header.baudrate or 0, header.parity or "N")
            except (OSError, ValueError) as error:
                raise ConnectionFailedError(
                    instrument, f"can't open {url}: {error}. Check the cable."
                ) from error
            resources.callback(port.close)
            served = _serve_port(where)
            resources.callback(served.unplug)
            make_folder(path.parent)
            file = RecordingFile(path, header, clock)
            resources.callback(file.close)
            self._report(f"The {instrument} is at {served.url}; Ctrl-C ends the recording.")
            try:
                Proxy(served, port, file, clock).run(duration_s)
            except KeyboardInterrupt:
                pass
            except OSError as error:
                raise ConnectionFailedError(instrument, f"its port went away: {error}") from error
        self._report(f"Recorded {path}")

    def _record_queries(self, instrument: Instrument, path: Path, clock: Clock) -> list[Call]:
        """Send the queries and write the recording, including replies that the driver can't parse."""
        name, open_driver, queries = _QUERIED[instrument]
        calls: list[Call] = []
        with tempfile.TemporaryDirectory() as temporary:
            folder = Path(temporary)
            try:
                with (
                    recording_lines(folder, {name: _header(self._station, instrument, self._note)}),
                    contextlib.closing(open_driver(self._station, clock, self._emulation)) as driver,
                ):
                    calls += list(call_driver(driver, queries))
            finally:
                for recording in sorted(folder.iterdir())[:1]:
                    _write_recording(path, recording, calls)
        return calls

    def _record_can(self, path: Path, clock: Clock, duration_s: float) -> str:
        """Log frames, switching on an INS that is off; returns a description of the recording."""
        if path.suffix not in _CAN_LOG_SUFFIXES:
            raise DocumentError(
                f"{path}: a CAN log is named {', '.join(f'*{suffix}' for suffix in _CAN_LOG_SUFFIXES)}"
            )
        make_folder(path.parent)
        with (
            contextlib.closing(open_ins(self._station, clock, self._emulation)) as ins,
            Outputs(self._station, clock, self._emulation) as outputs,
        ):
            is_switched_on = _switch_on(self._station, outputs, ins)
            try:
                return _log_frames(ins, path, clock, duration_s)
            finally:
                if is_switched_on:
                    outputs.power_unit(False)


class Proxy:
    """Passes all bytes between a served port and the open port of an instrument, and records them."""

    def __init__(self, served: Port, instrument: serial.Serial, file: RecordingFile, clock: Clock) -> None:
        self._served = served
        self._instrument = instrument
        self._file = file
        self._clock = clock
        self._unsent = b""

    def run(self, duration_s: float | None = None) -> None:
        """Pass bytes for ``duration_s``, or without end.

        Raises OSError if the instrument's port went away; pyserial's SerialException is an OSError.
        """
        self._instrument.timeout = 0
        end_s = None if duration_s is None else self._clock.now() + duration_s
        while end_s is None or self._clock.now() < end_s:
            if not self._exchange():
                self._clock.sleep(_PROXY_PERIOD_S)

    def _exchange(self) -> bool:
        """Pass the bytes that have arrived; returns whether there were any."""
        request = self._served.read()
        if request:
            self._file.add(True, request)
            self._instrument.write(request)
        reply = bytes(self._instrument.read(_MAX_PROXY_BYTES))
        if reply:
            self._file.add(False, reply)
        self._unsent = (self._unsent + reply)[-_MAX_PROXY_BYTES:]
        if self._unsent:
            self._unsent = self._unsent[self._served.write(self._unsent) :]
        return bool(request or reply)


def _section(station: Station, instrument: Instrument) -> DialectSection:
    return station.file.rate_table if instrument == "table" else station.file.chamber


def _header(station: Station, instrument: Instrument, note: str) -> RecordingHeader:
    """Header of a recording of table or chamber."""
    section = _section(station, instrument)
    return RecordingHeader(
        instrument=instrument,
        dialect=section.dialect,
        options=_options(section, section.installed_dialect.options),
        axes=list(station.file.rate_table.axis_numbers) if instrument == "table" else [],
        source="emulator" if section.is_emulated else "instrument",
        note=note,
    )


def _options(section: StrictModel, options: type[StrictModel]) -> dict[str, str | int | float | bool]:
    """Keys of the dialect that the station file sets."""
    return {
        key: value
        for key in options.model_fields
        if key in section.model_fields_set
        and isinstance(value := getattr(section, key), str | int | float | bool)
    }


def _serial_port(station: Station, instrument: Instrument, note: str) -> tuple[RecordingHeader, str]:
    """Header with baud rate and parity, and the port's address."""
    if instrument == "ins":
        ins = station.file.ins
        if ins.interface != "slcan":
            raise DocumentError(
                f"{station.path}: a proxy needs an INS on slcan, and this one is on {ins.interface}; "
                "record it without --proxy"
            )
        baudrate = int(ins.options.get("tty_baudrate", _SLCAN_BAUDRATE))
        header = RecordingHeader(instrument="ins", note=note, baudrate=baudrate, parity="N")
        return header, ins.channel
    section = _section(station, instrument)
    defaults = section.installed_dialect.line
    settings = {
        "baudrate": section.baudrate or defaults.baudrate,
        "parity": section.parity or defaults.parity,
    }
    return _header(station, instrument, note).model_copy(update=settings), section.port


def _serve_port(where: str) -> Port:
    try:
        return TcpPort(int(where)) if where.isdecimal() else PseudoTerminal(Path(where) if where else None)
    except OSError as error:
        raise DocumentError(f"{where}: can't serve the instrument there: {error}") from error


def _check_absent(path: Path) -> None:
    if path.exists():
        raise DocumentError(f"{path}: exists already; choose another name or remove it")


def _write_recording(path: Path, source: Path, calls: list[Call]) -> None:
    recorded = read_recording(source)
    identity = calls[0].gives or "" if calls else ""
    header = recorded.header.model_copy(update={"calls": calls, "identity": identity.strip("'")})
    make_folder(path.parent)
    write_whole(path, recording_text(header, join_transfers(recorded.transfers)).encode())


def _log_frames(ins: CanIns, path: Path, clock: Clock, duration_s: float) -> str:
    first_count = ins.frames
    try:
        with can.Logger(path) as log:

            def write(block: FrameBlock) -> None:
                for frame in block.messages():
                    log.on_message_received(frame)

            ins.on_frames = write
            deadline = Deadline(clock, duration_s)
            while not deadline.expired():
                clock.sleep(_CAN_POLL_S)
                ins.poll()
            identity = ins.identify()
            ins.on_frames = None
    except OSError as error:
        if isinstance(error, NoReplyError):
            raise
        raise write_error(path, error) from error
    return f"{ins.frames - first_count} frames in {duration_s:g} s; {identity}"


def _switch_on(station: Station, outputs: Outputs, ins: CanIns) -> bool:
    """Wait for the first frame, switching the INS on if necessary; returns whether it was switched on."""
    if ins.sends_frames(_FIRST_FRAME_S):
        return False
    if station.file.unit.power != "chamber_event":
        raise NoReplyError(INSTRUMENT, "sends no frames. Switch it on; check bus, bit rate and cable.")
    outputs.power_unit(True)
    if not ins.sends_frames(_POWER_ON_TO_FIRST_FRAME_S):
        outputs.power_unit(False)
        raise NoReplyError(
            INSTRUMENT, "sends no frames. Check its power, the bus, the bit rate and the cable."
        )
    return True
