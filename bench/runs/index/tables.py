"""Tables of the index: their rows for one run, read from the files of its folder, and the units."""

from __future__ import annotations

import hashlib
import io
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from datetime import UTC, datetime
from typing import Any, TypeVar

import pyarrow as pa
from pydantic import BaseModel, ValidationError

from gyrobench.bench.bias.bins import BIAS_BINS_TABLE, BiasBin
from gyrobench.bench.bias.dwell_table import SCALARS, DwellRow, columns_of, parse_dwells
from gyrobench.bench.foundations.csv_tables import CsvTable
from gyrobench.bench.foundations.errors import RunFolderError
from gyrobench.bench.foundations.files import with_nan_as_none
from gyrobench.bench.foundations.text import flag_text
from gyrobench.bench.runs.folder import (
    ACCEPTANCE,
    BIAS_BINS,
    COMPENSATION,
    DWELLS,
    JOURNAL,
    PROCEDURE,
    PROVENANCE,
)
from gyrobench.bench.runs.index.store import CLOSURE_FILE, CLOSURE_FINDINGS, RunFiles
from gyrobench.bench.runs.journal import facts_of, parse_journal


@dataclass(frozen=True)
class UnitRow:
    """A row of ``units.csv``."""

    unit: str  #: Serial number, as in the runs.
    batch: str  #: Batch of its gyros.
    #: hardware, note: Further information; may be empty.
    hardware: str
    note: str


def parse_units(text: str, name: str) -> list[UnitRow]:
    """Read CSV text with the columns unit and batch, optionally hardware and note.

    ``name``: of the file, for messages. Raises DocumentError, which lists all errors with their
    lines.
    """
    table = CsvTable(text, name, required=("unit", "batch"))
    first_indices: dict[str, int] = {}

    def read(index: int) -> UnitRow:
        unit = table.name(index, "unit")
        first = first_indices.setdefault(unit, index)
        if first != index:
            table.problem(index, "unit", f"unit {unit} is also in line {table.lines[first]}")
        batch = table.name(index, "batch")
        return UnitRow(unit, batch, table.text(index, "hardware"), table.text(index, "note"))

    return table.rows(read)


#: State of a run whose journal has no end: it was killed, or is still running.
NOT_ENDED = "not ended"
#: Verdict of a search whose dwells have been re-evaluated since.
STALE = "stale"

_ModelT = TypeVar("_ModelT", bound=BaseModel)


class _Provenance(BaseModel):
    """Part of provenance.json."""

    gyrobench: str = ""
    started_utc: datetime
    operator: str = ""
    instruments: dict[str, str] = {}
    options: dict[str, Any] = {}
    files_sha256: dict[str, str] = {}


class FoundEffectRecord(BaseModel):
    """One effect that a search found; see closure.json."""

    effect: str
    form: str = ""
    axes: list[str] = []
    rms_dph: float
    p_value: float
    tied_with: list[str] = []


class _Closure(BaseModel):
    """Part of closure.json."""

    verdict: str = ""
    effects: list[FoundEffectRecord] = []
    noise_dph: float | None = None
    error_before_dph: float | None = None
    error_after_dph: float | None = None
    dwells_searched: int | None = None


class _Findings(BaseModel):
    """Part of findings.json: hash of the dwells that were searched."""

    dwells_sha256: str = ""


class _Acceptance(BaseModel):
    """Part of acceptance.json."""

    verdict: str = ""


@dataclass(frozen=True)
class RunRow:
    """One row of the table of runs; empty text and None mean unknown."""

    path: str  #: Relative to the root of the runs.
    #: unit, station, procedure, procedure_sha256, gyrobench: Serial number, bench, procedure and its version,
    #: version of the program.
    unit: str
    station: str
    procedure: str
    procedure_sha256: str
    gyrobench: str
    operator: str  #: Who started it.
    ins_identity: str  #: Serial number, firmware and hardware, as the INS reported them.
    #: clock, world: Clock of the run, and world of emulated instruments.
    clock: str
    world: str
    started_utc: datetime  #: Start, UTC without time zone.
    duration_h: float  #: From its journal.
    #: ended, reason: From its journal; ``ended`` is :data:`NOT_ENDED` without an end.
    ended: str
    reason: str
    #: dwells, flagged: Numbers of measured and of flagged dwells.
    dwells: int
    flagged: int
    compensated: bool  #: Whether the INS compensated biases: the measured ones are residuals.
    verdict: str  #: Verdict of the search for effects.
    #: noise_dph, error_before_dph, error_after_dph, dwells_searched: Errors found by the search.
    noise_dph: float | None
    error_before_dph: float | None
    error_after_dph: float | None
    dwells_searched: int | None
    acceptance: str  #: Verdict on the acceptance limits.


@dataclass(frozen=True)
class RunRecord:
    """All rows of one run."""

    row: RunRow
    dwells: list[DwellRow]
    bins: list[BiasBin]
    effects: list[FoundEffectRecord]


def read_run_record(files: RunFiles, read: Callable[[str], bytes]) -> RunRecord:
    """Read a run.

    ``files``: files of its folder. ``read``: returns the content of a file, given its path from the root.
    Raises RunFolderError if a file can't be read, or is damaged; the message says which and why. Raises
    DocumentError if a table is wrong.
    """
    if PROVENANCE not in files.files:
        raise RunFolderError(f"{files.path}: has a journal but no {PROVENANCE}. Not a complete run folder")
    folder = _Folder(files, read)
    provenance = folder.document(PROVENANCE, _Provenance)
    closure = _current_closure(folder)
    dwells = parse_dwells(*folder.text(DWELLS)) if DWELLS in files.files else []
    bins = BIAS_BINS_TABLE.parse(*folder.text(BIAS_BINS)) if BIAS_BINS in files.files else []
    journal = folder.path(JOURNAL)
    facts = facts_of(parse_journal(io.BytesIO(read(journal)), journal))
    units = sorted({each.unit for each in dwells} - {""})
    row = RunRow(
        path=files.path,
        procedure_sha256=provenance.files_sha256.get(PROCEDURE, ""),
        gyrobench=provenance.gyrobench,
        operator=provenance.operator,
        ins_identity=provenance.instruments.get("INS", ""),
        clock=str(provenance.options.get("clock", "")),
        world=str(provenance.options.get("world", "")),
        started_utc=_naive_utc(provenance.started_utc),
        dwells=len(dwells),
        flagged=sum(bool(each.flags) for each in dwells),
        compensated=COMPENSATION in files.files,
        **closure.model_dump(exclude={"effects"}),
        acceptance=folder.document(ACCEPTANCE, _Acceptance).verdict,
        unit=", ".join(units) or facts.unit,
        station=facts.station,
        procedure=facts.procedure,
        duration_h=facts.last_s / 3600.0,
        ended=facts.ended or NOT_ENDED,
        reason=facts.reason,
    )
    return RunRecord(row, dwells, bins, closure.effects)


def _current_closure(folder: _Folder) -> _Closure:
    """Result of the search; only the verdict :data:`STALE` if the dwells have changed since."""
    closure = folder.document(CLOSURE_FILE, _Closure)
    searched_sha256 = folder.document(CLOSURE_FINDINGS, _Findings).dwells_sha256
    if not closure.verdict or not searched_sha256 or DWELLS not in folder.files.files:
        return closure
    is_current = hashlib.sha256(folder.read(folder.path(DWELLS))).hexdigest() == searched_sha256
    return closure if is_current else _Closure(verdict=STALE)


@dataclass(frozen=True)
class _Folder:
    """Files of a run, read by name."""

    files: RunFiles
    read: Callable[[str], bytes]

    def path(self, name: str) -> str:
        return name if self.files.path == "." else f"{self.files.path}/{name}"

    def text(self, name: str) -> tuple[str, str]:
        """Content of a table, and its name for messages."""
        path = self.path(name)
        try:
            return self.read(path).decode("utf-8-sig"), path
        except UnicodeDecodeError as error:
            raise RunFolderError(f"{path}: not UTF-8 text: {error.reason} at byte {error.start}") from error

    def document(self, name: str, model: type[_ModelT]) -> _ModelT:
        """Content of a JSON document; the model's defaults if it does not exist."""
        if name not in self.files.files:
            return model()
        path = self.path(name)
        try:
            return model.model_validate_json(self.read(path))
        except ValidationError as error:
            error_details = error.errors()[0]
            location = ".".join(map(str, error_details["loc"]))
            raise RunFolderError(
                f"{path}: damaged: {f'{location}: ' if location else ''}{error_details['msg']}"
            ) from error


def _naive_utc(time: datetime) -> datetime:
    """UTC without time zone; a time without zone is taken as UTC."""
    return time.astimezone(UTC).replace(tzinfo=None) if time.tzinfo else time


_TEXT, _NUMBER, _COUNT = pa.string(), pa.float64(), pa.int64()
_TYPES = {
    "str": _TEXT, "float": _NUMBER, "float | None": _NUMBER, "int": _COUNT, "int | None": _COUNT,
    "bool": pa.bool_(), "datetime": pa.timestamp("us"),
}  # fmt: skip
_DWELL_TRIPLES = ("gyro_c", "gyro_rate_c_per_h", "bias_dph", "sigma_dph")


def _schema_of(model: type, *first: tuple[str, pa.DataType], without: str = "") -> pa.Schema:
    columns = [(each.name, _TYPES[str(each.type)]) for each in fields(model) if each.name != without]
    return pa.schema([*first, *columns])


#: Columns of each table. Names and units are those of the files of a run; ``path`` is that of the run.
SCHEMAS: Mapping[str, pa.Schema] = {
    "runs": _schema_of(RunRow).append(pa.field("batch", _TEXT)).append(pa.field("hardware", _TEXT)),
    "bins": _schema_of(BiasBin, ("path", _TEXT), without="by_power_cycle"),
    "dwells": pa.schema(
        [
            *((name, _TEXT) for name in ("path", "run")),
            *((name, _COUNT) for name in ("dwell", "cycle")),
            ("position", _TEXT),
            *((name, _NUMBER) for name in columns_of((*SCALARS, *_DWELL_TRIPLES, "fit_p_value"))),
            ("flags", _TEXT),
        ]
    ),
    "effects": pa.schema(
        [
            *((name, _TEXT) for name in ("path", "effect", "form", "axes")),
            *((name, _NUMBER) for name in ("rms_dph", "p_value")),
            ("tied_with", _TEXT),
        ]
    ),
    "units": _schema_of(UnitRow),
    "files": pa.schema([(name, _TEXT) for name in ("path", "fingerprint", "problem")]),
}
#: Tables with rows that belong to a run.
RUN_TABLES = ("runs", "bins", "dwells", "effects")


def arrow_table(name: str, rows: Iterable[Mapping[str, Any]]) -> pa.Table:
    """Rows as an Arrow table; missing values and numbers that are not finite become null."""
    return pa.Table.from_pylist([with_nan_as_none(row) for row in rows], schema=SCHEMAS[name])


def rows_by_table(records: Sequence[RunRecord]) -> dict[str, list[dict[str, Any]]]:
    """Rows of some runs, by table."""
    return {
        "runs": [asdict(record.row) for record in records],
        "bins": [{"path": record.row.path, **asdict(each)} for record in records for each in record.bins],
        "dwells": [_dwell_values(record.row.path, row) for record in records for row in record.dwells],
        "effects": [
            {
                "path": record.row.path,
                **each.model_dump(),
                "axes": "".join(each.axes),
                "tied_with": ", ".join(each.tied_with),
            }
            for record in records
            for each in record.effects
        ],
    }


def _dwell_values(path: str, row: DwellRow) -> dict[str, Any]:
    """Row of the table of dwells."""
    triples = {
        column: value
        for name in _DWELL_TRIPLES
        for column, value in zip(columns_of((name,)), getattr(row, name), strict=True)
    }
    scalar_names = ("run", "dwell", "cycle", "position", *SCALARS, "fit_p_value")
    scalars = {name: getattr(row, name) for name in scalar_names}
    return {"path": path, **scalars, **triples, "flags": flag_text(row.flags)}
