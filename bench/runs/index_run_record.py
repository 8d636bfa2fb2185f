"""One run as the index keeps it, read from the files of its folder."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from gyrobench.bench.bias.bins import BiasBin, parse_bins
from gyrobench.bench.bias.dwell_table import DwellRow, parse_dwells
from gyrobench.bench.foundations.errors import RunFolderError
from gyrobench.bench.runs.folder import (
    ACCEPTANCE,
    BIAS_BINS,
    COMPENSATION,
    DWELLS,
    JOURNAL,
    PROCEDURE,
    PROVENANCE,
)
from gyrobench.bench.runs.index_run_files import CLOSURE_FILE, CLOSURE_FINDINGS, RunFiles
from gyrobench.bench.runs.journal import facts_of, parse_journal

#: How a run ended that does not say so: it was killed, or is under way.
NOT_ENDED = "not ended"
#: Verdict of a search whose dwells were measured anew since.
STALE = "stale"

ModelT = TypeVar("ModelT", bound=BaseModel)


class _Provenance(BaseModel):
    """What the index takes from provenance.json."""

    gyrobench: str = ""
    started_utc: datetime
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
    """What the index takes from closure.json."""

    verdict: str = ""
    effects: list[FoundEffectRecord] = []
    noise_dph: float | None = None
    error_before_dph: float | None = None
    error_after_dph: float | None = None
    dwells_searched: int | None = None


class _Findings(BaseModel):
    """What the index takes from findings.json: the dwells that the search saw."""

    dwells_sha256: str = ""


class _Acceptance(BaseModel):
    """What the index takes from acceptance.json."""

    verdict: str = ""


@dataclass(frozen=True)
class RunRow:
    """One row of the table of runs; empty text and None are what the folder does not tell.

    Attributes
    ----------
    path : str
        Relative to the root of the runs.
    unit, station, procedure, procedure_sha256, gyrobench : str
        Serial number, bench, procedure and its version, version of the program.
    clock, world : str
        Whether time was virtual, and what stood behind emulated instruments.
    started_utc : datetime
        Calendar time of its start, without time zone.
    duration_h : float
        By its journal.
    ended, reason : str
        As its journal says; :data:`NOT_ENDED`.
    dwells, flagged : int
        Number of dwells measured, and of those with flags.
    compensated : bool
        Whether the INS subtracted biases: those measured are what that left.
    verdict : str
        Of the search for effects.
    noise_dph, error_before_dph, error_after_dph, dwells_searched
        What the search says of its errors.
    acceptance : str
        Verdict on the acceptance limits.
    """

    path: str
    unit: str
    station: str
    procedure: str
    procedure_sha256: str
    gyrobench: str
    clock: str
    world: str
    started_utc: datetime
    duration_h: float
    ended: str
    reason: str
    dwells: int
    flagged: int
    compensated: bool
    verdict: str
    noise_dph: float | None
    error_before_dph: float | None
    error_after_dph: float | None
    dwells_searched: int | None
    acceptance: str


@dataclass(frozen=True)
class RunRecord:
    """Everything that the index keeps of one run."""

    row: RunRow
    dwells: list[DwellRow]
    bins: list[BiasBin]
    effects: list[FoundEffectRecord]


def read_run_record(files: RunFiles, read: Callable[[str], bytes]) -> RunRecord:
    """Read a run.

    Parameters
    ----------
    files : RunFiles
        What is in its folder.
    read : callable
        Gives the content of a file by its path from the root.

    Raises
    ------
    RunFolderError
        A file can't be read, or is damaged; the message says which and why.
    DocumentError
        A table is wrong.
    """
    if PROVENANCE not in files.files:
        raise RunFolderError(
            f"{files.path}: has a journal and no {PROVENANCE}, so it is no run folder or has lost a part"
        )
    folder = _Folder(files, read)
    provenance = folder.document(PROVENANCE, _Provenance)
    closure = _search_of(folder)
    dwells = parse_dwells(*folder.text(DWELLS)) if DWELLS in files.files else []
    bins = parse_bins(*folder.text(BIAS_BINS)) if BIAS_BINS in files.files else []
    journal = folder.path(JOURNAL)
    told = facts_of(parse_journal(read(journal), journal))
    units = sorted({each.unit for each in dwells} - {""})
    row = RunRow(
        path=files.path,
        procedure_sha256=provenance.files_sha256.get(PROCEDURE, ""),
        gyrobench=provenance.gyrobench,
        clock=str(provenance.options.get("clock", "")),
        world=str(provenance.options.get("world", "")),
        started_utc=_plain_utc(provenance.started_utc),
        dwells=len(dwells),
        flagged=sum(bool(each.flags) for each in dwells),
        compensated=COMPENSATION in files.files,
        verdict=closure.verdict,
        noise_dph=closure.noise_dph,
        error_before_dph=closure.error_before_dph,
        error_after_dph=closure.error_after_dph,
        dwells_searched=closure.dwells_searched,
        acceptance=folder.document(ACCEPTANCE, _Acceptance).verdict,
        unit=", ".join(units) or told.unit,
        station=told.station,
        procedure=told.procedure,
        duration_h=told.last_s / 3600.0,
        ended=told.ended or NOT_ENDED,
        reason=told.reason,
    )
    return RunRecord(row, dwells, bins, closure.effects)


def _search_of(folder: _Folder) -> _Closure:
    """What the search found, if it saw the dwells as they are."""
    closure = folder.document(CLOSURE_FILE, _Closure)
    seen = folder.document(CLOSURE_FINDINGS, _Findings).dwells_sha256
    if not closure.verdict or not seen or DWELLS not in folder.files.files:
        return closure
    is_same = hashlib.sha256(folder.read(folder.path(DWELLS))).hexdigest() == seen
    return closure if is_same else _Closure(verdict=STALE)


@dataclass(frozen=True)
class _Folder:
    """Files of a run, read by name."""

    files: RunFiles
    read: Callable[[str], bytes]

    def path(self, name: str) -> str:
        return name if self.files.path == "." else f"{self.files.path}/{name}"

    def text(self, name: str) -> tuple[str, str]:
        """Content of a table, and what to call it."""
        path = self.path(name)
        try:
            return self.read(path).decode("utf-8-sig"), path
        except UnicodeDecodeError as error:
            raise RunFolderError(
                f"{path}: is not UTF-8 text: {error.reason} at byte {error.start}"
            ) from error

    def document(self, name: str, model: type[ModelT]) -> ModelT:
        """Content of a JSON document; the model's defaults where it is not there."""
        if name not in self.files.files:
            return model()
        path = self.path(name)
        try:
            return model.model_validate_json(self.read(path))
        except ValidationError as error:
            first = error.errors()[0]
            place = ".".join(map(str, first["loc"]))
            raise RunFolderError(f"{path}: damaged: {f'{place}: ' if place else ''}{first['msg']}") from error


def _plain_utc(time: datetime) -> datetime:
    """Without its zone, as a column of UTC times holds it; a time without zone is taken as UTC."""
    return time.astimezone(UTC).replace(tzinfo=None) if time.tzinfo else time
