"""Recordings of the instruments of a station."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Literal

from gyrobench.bench.foundations.clock import Clock
from gyrobench.bench.foundations.documents import StrictModel
from gyrobench.bench.foundations.files import make_folder, write_whole
from gyrobench.bench.recording.questions import CHAMBER_QUESTIONS, TABLE_QUESTIONS, answered
from gyrobench.bench.station.instruments import CHAMBER, RATE_TABLE, Emulation, open_chamber, open_table
from gyrobench.bench.station.station import Station
from gyrobench.drivers.recording.document import Call, RecordingHeader, joined, read_recording, recording_text
from gyrobench.drivers.recording.tap import recording_lines

Instrument = Literal["table", "chamber", "ins"]


def headers(station: Station, note: str = "") -> dict[str, RecordingHeader]:
    """What a station says of the lines of table and chamber, by the names that errors give them."""
    file = station.file
    table, chamber = file.rate_table, file.chamber
    return {
        RATE_TABLE: RecordingHeader(
            instrument="table",
            dialect=table.dialect,
            options=_options(table, table.installed_dialect.options),
            axes=list(table.axis_numbers),
            source=_source(table.port),
            note=note,
        ),
        CHAMBER: RecordingHeader(
            instrument="chamber",
            dialect=chamber.dialect,
            options=_options(chamber, chamber.installed_dialect.options),
            source=_source(chamber.port),
            note=note,
        ),
    }


def record_questions(
    station: Station, instrument: Instrument, path: Path, clock: Clock, emulation: Emulation, note: str = ""
) -> list[Call]:
    """Ask table or chamber what can be asked without moving anything, and keep the bytes.

    The recording is written whatever the instrument answers; one that can't be understood is the one
    to keep.

    Returns
    -------
    list of Call
        What was asked, with what the driver made of the replies.

    Raises
    ------
    ConnectionFailedError
        The port can't be opened, so that there is nothing to record.
    InstrumentError
        The driver got no reply by which to go on; the recording is there.
    """
    name = RATE_TABLE if instrument == "table" else CHAMBER
    calls: list[Call] = []
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        try:
            with recording_lines(folder, {name: headers(station, note)[name]}):
                calls += _asked(station, instrument, clock, emulation)
        finally:
            for part in sorted(folder.iterdir())[:1]:
                _write(path, part, calls)
    return calls


def _asked(station: Station, instrument: Instrument, clock: Clock, emulation: Emulation) -> list[Call]:
    if instrument == "table":
        table = open_table(station, clock, emulation)
        try:
            return list(answered(table, TABLE_QUESTIONS))
        finally:
            table.close()
    chamber = open_chamber(station, clock, emulation)
    try:
        return list(answered(chamber, CHAMBER_QUESTIONS))
    finally:
        chamber.close()


def _write(path: Path, part: Path, calls: list[Call]) -> None:
    recorded = read_recording(part)
    identity = calls[0].gives or "" if calls else ""
    header = recorded.header.model_copy(update={"calls": calls, "identity": identity.strip("'")})
    make_folder(path.parent)
    write_whole(path, recording_text(header, joined(recorded.transfers)).encode())


def _options(section: StrictModel, options: type[StrictModel]) -> dict[str, str | int | float | bool]:
    """Keys of the dialect that the station file gives."""
    return {
        key: value
        for key in options.model_fields
        if key in section.model_fields_set
        and isinstance(value := getattr(section, key), str | int | float | bool)
    }


def _source(port: str) -> Literal["instrument", "emulator"]:
    return "emulator" if port.startswith("emulator://") else "instrument"
