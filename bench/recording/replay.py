"""Calls of a recording: made to a driver, checked, and replayed."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, get_type_hints
from urllib.parse import quote

from pydantic import TypeAdapter, ValidationError

from gyrobench.bench.foundations.clock import VirtualClock
from gyrobench.bench.foundations.documents import DocumentProblem, problems_of
from gyrobench.bench.foundations.errors import DocumentError, InstrumentError
from gyrobench.bench.foundations.packages import CHAMBERS, RATE_TABLES, load
from gyrobench.bench.foundations.text import did_you_mean
from gyrobench.bench.station.instruments import RATE_TABLE
from gyrobench.drivers.chamber import Chamber, ChamberDialect
from gyrobench.drivers.rate_table import RateTable, TableDialect
from gyrobench.drivers.recording.protocol_replay import SCHEME
from gyrobench.drivers.recording.recording_file import Call, Recording, read_recording
from gyrobench.drivers.serial_line import SerialLine

#: Calls that neither move nor heat anything.
TABLE_QUERIES = tuple(Call(ask=name) for name in ("identify", "limits", "read", "identify"))
CHAMBER_QUERIES = tuple(Call(ask=name) for name in ("identify", "read", "limits_c", "set_point_c"))

_DEFAULT_AXES = (1, 2)
_DEFAULT_BAUDRATE, _DEFAULT_PARITY = 9600, "N"


def replay(path: Path) -> tuple[Recording, list[Call]]:
    """Make the recorded calls again to the driver of the dialect, on virtual time.

    Returns the recording, whose header has the recorded results, and the same calls with the results of the
    replay. Raises DocumentError if the recording is wrong, or its dialect is not installed. Raises
    ConnectionFailedError if the driver sends other bytes than recorded while it is opened.
    """
    recording = read_recording(path)
    header, calls = recording.header, checked_calls(recording)
    name = RATE_TABLE if header.instrument == "table" else header.instrument
    url = f"{SCHEME}{quote(str(path.absolute()))}"
    baudrate, parity = header.baudrate or _DEFAULT_BAUDRATE, header.parity or _DEFAULT_PARITY
    with SerialLine(name, url, VirtualClock(), baudrate, parity) as line:
        return recording, list(call_driver(_open_driver(recording, line), calls))


def call_driver(driver: RateTable | Chamber, calls: Iterable[Call]) -> Iterator[Call]:
    """Make calls to a driver; yields each call with its result or the type of its error."""
    for call in calls:
        outcome = call.model_copy(update={"gives": None, "fails": None})
        try:
            result = getattr(driver, call.ask)(**call.arguments)
        except InstrumentError as error:
            yield outcome.model_copy(update={"fails": type(error).__name__})
        else:
            yield outcome.model_copy(update={"gives": repr(result)})


def checked_calls(recording: Recording) -> list[Call]:
    """Calls of a recording, which may be hand-written, with arguments converted to the methods' types.

    Raises DocumentError with all calls that can't be made, and their places.
    """
    header = recording.header
    if header.instrument == "ins":
        return []  # its driver sends no queries
    protocol: type[RateTable | Chamber] = RateTable if header.instrument == "table" else Chamber
    calls, problems = [], []
    for index, call in enumerate(header.calls):
        arguments = _checked_arguments(protocol, call.ask, call.arguments, header.axes or _DEFAULT_AXES)
        if isinstance(arguments, DocumentProblem):
            message = f"call {index + 1} of {len(header.calls)}: {arguments.message}"
            problems.append(DocumentProblem(("calls", index, *arguments.location), message))
        else:
            calls.append(call.model_copy(update={"arguments": arguments}))
    if problems:
        raise recording.document.error(problems)
    return calls


def _checked_arguments(
    protocol: type[RateTable | Chamber], ask: str, arguments: Mapping[str, Any], axes: Sequence[int]
) -> dict[str, Any] | DocumentProblem:
    """Arguments of a call converted to their types, or a problem located within the call."""
    methods: dict[str, Callable[..., object]] = {
        name: method
        for name, method in vars(protocol).items()
        if inspect.isfunction(method) and not name.startswith("_") and name != "close"
    }
    if ask not in methods:
        return DocumentProblem(
            ("ask",), f"a {protocol.__name__} has no method '{ask}'{did_you_mean(ask, methods)}"
        )
    try:
        inspect.signature(methods[ask]).bind(None, **arguments)
    except TypeError as error:
        return DocumentProblem(("arguments",), f"{ask}: {error}")
    hints, typed = get_type_hints(methods[ask]), {}
    for name, value in arguments.items():
        try:
            typed[name] = TypeAdapter(hints[name]).validate_python(value)
        except ValidationError as error:
            return DocumentProblem(("arguments", name), f"{ask}: '{name}': {error.errors()[0]['msg']}")
    if typed.get("angles_deg") == {}:
        return DocumentProblem(("arguments", "angles_deg"), f"{ask}: names no axis")
    unknown = (set(typed.get("angles_deg", axes)) | {typed.get("axis", axes[0])}) - set(axes)
    if unknown:
        return DocumentProblem(("arguments",), f"{ask}: there is no axis {min(unknown)}, only {list(axes)}")
    return typed


def _open_driver(recording: Recording, line: SerialLine) -> RateTable | Chamber:
    header = recording.header
    try:
        if header.instrument == "table":
            table = load(RATE_TABLES, header.dialect, TableDialect)
            return table.open(
                line, header.axes or _DEFAULT_AXES, table.options.model_validate(header.options)
            )
        if header.instrument == "chamber":
            chamber = load(CHAMBERS, header.dialect, ChamberDialect)
            return chamber.open(line, chamber.options.model_validate(header.options))
    except ValidationError as error:
        problems: list[DocumentProblem] = problems_of(error, ("options",))
        raise DocumentError("\n".join(f"{recording.path}: {problem.text}" for problem in problems)) from error
    raise DocumentError(f"{recording.path}: no driver for an {header.instrument} on a serial line")
