"""Replaying a recording to the driver of its dialect."""

from __future__ import annotations

from pathlib import Path
from urllib.parse import quote

from pydantic import ValidationError

from gyrobench.bench.foundations.clock import VirtualClock
from gyrobench.bench.foundations.documents import Problem, problems_of
from gyrobench.bench.foundations.entry_points import CHAMBERS, RATE_TABLES, load
from gyrobench.bench.foundations.errors import DocumentError
from gyrobench.bench.recording.calls import USUAL_AXES, calls_of
from gyrobench.bench.recording.questions import answered
from gyrobench.drivers.chamber import Chamber
from gyrobench.drivers.chamber.dialect import ChamberDialect
from gyrobench.drivers.rate_table import RateTable
from gyrobench.drivers.rate_table.dialect import TableDialect
from gyrobench.drivers.recording.document import Call, Recording, RecordingHeader, read_recording
from gyrobench.drivers.recording.protocol_replay import SCHEME
from gyrobench.drivers.serial_line import SerialLine

_DEFAULT_BAUDRATE, _DEFAULT_PARITY = 9600, "N"


def replay(path: Path) -> tuple[Recording, list[Call]]:
    """Ask the driver again what it was asked while it was recorded, in virtual time.

    Returns
    -------
    Recording
        As read; its header has what the driver made of the replies then.
    list of Call
        The same calls, with what it makes of them now.

    Raises
    ------
    DocumentError
        The recording is wrong, or its dialect is not installed.
    ConnectionFailedError
        While it is opened, the driver asks something else than then.
    """
    recording = read_recording(path)
    header, calls = recording.header, calls_of(recording)
    clock = VirtualClock()
    name = "rate table" if header.instrument == "table" else header.instrument
    url = f"{SCHEME}{quote(str(path.absolute()))}"
    line = SerialLine(
        name, url, clock, header.baudrate or _DEFAULT_BAUDRATE, header.parity or _DEFAULT_PARITY
    )
    with line:
        driver = _driver(recording, header, line)
        return recording, list(answered(driver, calls))


def _driver(recording: Recording, header: RecordingHeader, line: SerialLine) -> RateTable | Chamber:
    try:
        if header.instrument == "table":
            table = load(RATE_TABLES, header.dialect, TableDialect)
            return table.open(line, header.axes or USUAL_AXES, table.options.model_validate(header.options))
        if header.instrument == "chamber":
            chamber = load(CHAMBERS, header.dialect, ChamberDialect)
            return chamber.open(line, chamber.options.model_validate(header.options))
    except ValidationError as error:
        problems: list[Problem] = problems_of(error, ("options",))
        raise DocumentError(
            "\n".join(f"{recording.path}: {'.'.join(map(str, p.location))}: {p.message}" for p in problems)
        ) from error
    raise DocumentError(f"{recording.path}: no driver speaks over a line of the {header.instrument}")
