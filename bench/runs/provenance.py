"""Provenance of a run: versions, instruments, options, and hashes of its files."""

from __future__ import annotations

import contextlib
import hashlib
import json
import platform
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime, timedelta
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from gyrobench.bench import __version__
from gyrobench.bench.foundations.errors import RunFolderError
from gyrobench.bench.foundations.files import file_sha256, parse_json, read_limited, write_whole
from gyrobench.bench.foundations.operator_name import login_name, operator_name
from gyrobench.bench.runs.folder import RunFolder

_PACKAGES = ("numpy", "scipy", "pyserial", "python-can", "cantools", "pymodbus", "pydantic", "pyarrow")

#: Watermark of all pages and figures of a run with emulated instruments, and name of a file beside its
#: tables, whose formats have no place for it.
SIMULATED = "SIMULATED"
_SIMULATED_TEXT = "The instruments of this run were emulated: nothing in this folder was measured.\n"

_MAX_BYTES = 10_000_000
_OBJECTS = ("instruments", "options", "files_sha256", "packages")


def write_provenance(
    folder: RunFolder, started: datetime, identities: Mapping[str, str], options: Mapping[str, Any]
) -> None:
    """Write provenance.json with the start of the run's clock, instruments' identities, and options."""
    inputs = [folder.procedure, folder.station, *sorted(folder.path.glob("*.dbc"))]
    content = {
        "gyrobench": __version__,
        "started_utc": started.isoformat(),
        "utc_offset_s": _utc_offset_s(started),
        "operator": operator_name(),
        "login": login_name(),
        "host": platform.node(),
        "instruments": dict(identities),
        "options": dict(options),
        "files_sha256": {path.name: file_sha256(path) for path in inputs},
        "python": platform.python_version(),
        "platform": platform.platform(),
        "packages": {name: _version(name) for name in _PACKAGES},
    }
    content["simulated"] = is_emulated(content)
    if content["simulated"]:
        write_whole(folder.path / f"{SIMULATED}.txt", _SIMULATED_TEXT.encode())
    _write(folder, content)


def add_identity(folder: RunFolder, instrument: str, identity: str) -> str:
    """Add the identity of an instrument that was switched on later, or has another one than before.

    Returns the one before; empty if there was none.
    """
    content = read_provenance(folder)
    before = content["instruments"].get(instrument)
    if identity != before:
        content["instruments"][instrument] = identity
        _write(folder, content)
    return str(before or "")


def identities_in(folder: RunFolder) -> dict[str, str]:
    """Identity of each instrument of a run by its name; empty where provenance.json can't be read."""
    with contextlib.suppress(RunFolderError):
        return {name: str(text) for name, text in read_provenance(folder).get("instruments", {}).items()}
    return {}


def ins_identity(folder: RunFolder) -> str:
    """How the INS of a run identified, with its firmware; empty if unknown."""
    return ", ".join(text for name, text in identities_in(folder).items() if name.startswith("INS"))


def note_inputs(folder: RunFolder) -> list[str]:
    """Keep the hashes of procedure, station and DBC file as they are now; names of those that changed."""
    content = read_provenance(folder)
    known = content.get("files_sha256", {})
    now = {name: file_sha256(folder.path / name) for name in known if (folder.path / name).is_file()}
    changed = [name for name, digest in now.items() if digest != known[name]]
    if changed:
        _write(folder, content | {"files_sha256": {**known, **now}})
    return changed


def note_preparer(folder: RunFolder, name: str) -> None:
    """Keep the name of who prepares the report, for each time it is written."""
    if content := read_provenance(folder):
        _write(folder, content | {"prepared_by": name})


def start_of(folder: RunFolder, entries: Sequence[Mapping[str, Any]]) -> tuple[datetime, dict[str, Any]]:
    """Start and options of a run from its journal, where provenance.json is damaged.

    Raises RunFolderError if the journal does not state them.
    """
    begun = next((entry for entry in entries if entry.get("event") == "run_started"), {})
    try:
        started = datetime.fromisoformat(begun["utc"]) - timedelta(seconds=begun["time_s"])
        return started, dict(begun["options"])
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise RunFolderError(
            f"{folder.provenance}: damaged, and {folder.journal.name} does not state how the run began. "
            "Restore the file from a copy"
        ) from error


def read_provenance(folder: RunFolder) -> dict[str, Any]:
    """Content of provenance.json; empty where there is none.

    Raises RunFolderError if it can't be read, or is damaged.
    """
    if not folder.provenance.exists():
        return {}
    try:
        content = parse_json(read_limited(folder.provenance, _MAX_BYTES, RunFolderError))
    except ValueError as error:
        raise RunFolderError(f"{folder.provenance}: damaged: {error}") from error
    parts = [content, *(content.get(key, {}) for key in _OBJECTS)] if isinstance(content, dict) else [None]
    if not all(isinstance(part, dict) for part in parts):
        raise RunFolderError(
            f"{folder.provenance}: damaged: it, and {', '.join(_OBJECTS)} in it, must be JSON objects"
        )
    return dict(content)


def run_options(folder: RunFolder) -> dict[str, Any]:
    """Options of a run; empty where provenance.json lacks them. Raises as :func:`read_provenance`."""
    return dict(read_provenance(folder).get("options", {}))


def is_emulated(provenance: Mapping[str, Any], options: Mapping[str, Any] | None = None) -> bool:
    """Whether instruments were emulated: by the run's options, or an instrument's identification.

    ``options``: those that its journal states, where they are known.
    """
    identities = provenance.get("instruments", {}).values()
    return "world" in {**provenance.get("options", {}), **(options or {})} or any(
        "emulator" in str(text) for text in identities
    )


def emulated_bench_text(folder: RunFolder) -> str:
    """What a run with emulated instruments states at its start; empty for real ones.

    Raises RunFolderError if its provenance can't be read.
    """
    provenance = read_provenance(folder)
    if not is_emulated(provenance):
        return ""
    options = provenance.get("options", {})
    names = ("world", "seed", "faults")
    parts = [f"{name} {options[name]}" for name in names if name in options]
    parts += [f"{options['clock']} clock"] if "clock" in options else []
    return f"Emulated bench: {', '.join(parts)}. All data are simulated."


def watermark_of(*sources: Path) -> str:
    """Word across what was computed from runs, folders in them or their tables: empty if none is emulated."""
    folders = {RunFolder(folder) for path in sources for folder in (path, path.parent)}
    for folder in folders:
        try:
            if is_emulated(read_provenance(folder)):
                return SIMULATED
        except RunFolderError:
            continue  # damaged: its own report says so
    return ""


def started_utc(folder: RunFolder) -> datetime:
    """Calendar time at which a run began. Raises RunFolderError if it is not known."""
    try:
        return datetime.fromisoformat(read_provenance(folder)["started_utc"])
    except (KeyError, TypeError, ValueError) as error:
        raise RunFolderError(f"{folder.provenance}: does not state when the run began") from error


def _write(folder: RunFolder, content: Mapping[str, Any]) -> None:
    write_whole(folder.provenance, (json.dumps(content, indent=2) + "\n").encode())


def _utc_offset_s(moment: datetime) -> float:
    """How far local time on the bench is ahead of UTC."""
    offset = moment.astimezone().utcoffset()
    return 0.0 if offset is None else offset.total_seconds()


@cache
def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "not installed"


@dataclass(frozen=True)
class DataHash:
    """Hash of a file, or of all parts of a log."""

    name: str  #: The file, or the parts: "can/*.blf".
    count: int  #: Number of files.
    #: Of a single file. Of a log in parts that of its manifest, the lines that ``sha256sum`` prints for them:
    #: ``sha256sum can/*.blf | sha256sum`` in the run folder gives the same.
    sha256: str
    #: Hashes of a log's parts, by their paths in the run folder.
    parts: Mapping[str, str] = field(default_factory=dict)


def data_hashes(folder: RunFolder) -> list[DataHash]:
    """Hash the dwell table, the journal, and the raw logs; what is missing is left out.

    Raises RunFolderError if a file can't be read.
    """
    hashes = [
        DataHash(path.name, 1, file_sha256(path))
        for path in (folder.dwells, folder.journal)
        if path.is_file()
    ]
    for inner, suffix in ((folder.can, ".blf"), (folder.telemetry, ".parquet")):
        parts = sorted(inner.glob(f"*{suffix}"))
        if parts:
            each = {part.relative_to(folder.path).as_posix(): file_sha256(part) for part in parts}
            manifest = "".join(f"{digest}  {path}\n" for path, digest in each.items())
            whole = hashlib.sha256(manifest.encode()).hexdigest()
            hashes.append(DataHash(f"{inner.name}/*{suffix}", len(parts), whole, each))
    return hashes
