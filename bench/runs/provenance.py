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
#: tables, whose formats can't hold it.
SIMULATED = "SIMULATED"
_SIMULATED_TEXT = "The instruments of this run were emulated: nothing in this folder was measured.\n"

_MAX_BYTES = 10_000_000
_OBJECT_KEYS = ("instruments", "options", "files_sha256", "packages")


def write_provenance(
    folder: RunFolder, started: datetime, identities: Mapping[str, str], options: Mapping[str, Any]
) -> None:
    """Write provenance.json with the start of the run's clock, instruments' identities, and options."""
    inputs = [folder.procedure, folder.station, *sorted(folder.path.glob("*.dbc"))]
    content = {
        "gyrobench": __version__,
        "started_utc": started.isoformat(),
        # Local time on the bench minus UTC.
        "utc_offset_s": (started.astimezone().utcoffset() or timedelta()).total_seconds(),
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
    """Record the identity of an instrument that was switched on later or was replaced.

    Returns the previous identity; empty if there was none.
    """
    content = read_provenance(folder)
    previous = content["instruments"].get(instrument)
    if identity != previous:
        content["instruments"][instrument] = identity
        _write(folder, content)
    return str(previous or "")


def identities_in(folder: RunFolder) -> dict[str, str]:
    """Identity of each instrument of a run by its name; empty if provenance.json can't be read."""
    with contextlib.suppress(RunFolderError):
        return {name: str(text) for name, text in read_provenance(folder).get("instruments", {}).items()}
    return {}


def ins_identity(folder: RunFolder) -> str:
    """Identification of the INS of a run, with its firmware; empty if unknown."""
    return ", ".join(text for name, text in identities_in(folder).items() if name.startswith("INS"))


def update_input_hashes(folder: RunFolder) -> list[str]:
    """Update the recorded hashes of procedure, station and DBC file; returns the names of changed files."""
    content = read_provenance(folder)
    recorded = content.get("files_sha256", {})
    current = {name: file_sha256(folder.path / name) for name in recorded if (folder.path / name).is_file()}
    changed = [name for name, digest in current.items() if digest != recorded[name]]
    if changed:
        _write(folder, content | {"files_sha256": {**recorded, **current}})
    return changed


def record_preparer(folder: RunFolder, name: str) -> None:
    """Record who prepares the report, for all later times that it is written."""
    if content := read_provenance(folder):
        _write(folder, content | {"prepared_by": name})


def start_from_journal(
    folder: RunFolder, entries: Sequence[Mapping[str, Any]]
) -> tuple[datetime, dict[str, Any]]:
    """Start and options of a run from its journal, for a damaged provenance.json.

    Raises RunFolderError if the journal does not state them.
    """
    start = next((entry for entry in entries if entry.get("event") == "run_started"), {})
    try:
        started = datetime.fromisoformat(start["utc"]) - timedelta(seconds=start["time_s"])
        return started, dict(start["options"])
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise RunFolderError(
            f"{folder.provenance}: damaged, and {folder.journal.name} does not state how the run began. "
            "Restore the file from a copy"
        ) from error


def read_provenance(folder: RunFolder) -> dict[str, Any]:
    """Content of provenance.json; empty if it does not exist.

    Raises RunFolderError if it can't be read, or is damaged.
    """
    if not folder.provenance.exists():
        return {}
    try:
        content = parse_json(read_limited(folder.provenance, _MAX_BYTES, RunFolderError))
    except ValueError as error:
        raise RunFolderError(f"{folder.provenance}: damaged: {error}") from error
    parts = (
        [content, *(content.get(key, {}) for key in _OBJECT_KEYS)] if isinstance(content, dict) else [None]
    )
    if not all(isinstance(part, dict) for part in parts):
        raise RunFolderError(
            f"{folder.provenance}: damaged: it, and {', '.join(_OBJECT_KEYS)} in it, must be JSON objects"
        )
    return dict(content)


def run_options(folder: RunFolder) -> dict[str, Any]:
    """Options of a run; empty if provenance.json lacks them. Raises as :func:`read_provenance`."""
    return dict(read_provenance(folder).get("options", {}))


def is_emulated(provenance: Mapping[str, Any], options: Mapping[str, Any] | None = None) -> bool:
    """Whether instruments were emulated, by the run's options or an instrument's identification.

    ``options``: those in the journal, if known.
    """
    identities = provenance.get("instruments", {}).values()
    return "world" in {**provenance.get("options", {}), **(options or {})} or any(
        "emulator" in str(text) for text in identities
    )


def emulated_bench_text(folder: RunFolder) -> str:
    """Notice at the start of a run with emulated instruments; empty for real instruments.

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
    """Watermark of results of these runs, folders in them or their tables; empty if none is emulated."""
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


@cache
def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "not installed"


@dataclass(frozen=True)
class DataHash:
    """Hash of a file, or of all parts of a log."""

    name: str  #: Name of the file, or pattern of the parts: "can/*.blf".
    count: int  #: Number of files.
    #: Hash of a single file. For a log in parts, hash of its manifest, the lines that ``sha256sum`` prints
    #: for the parts: ``sha256sum can/*.blf | sha256sum`` in the run folder gives the same.
    sha256: str
    #: Hashes of a log's parts, by their paths in the run folder.
    parts: Mapping[str, str] = field(default_factory=dict)


def data_hashes(folder: RunFolder) -> list[DataHash]:
    """Hash the dwell table, the journal, and the raw logs; missing files are omitted.

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
            digests = {part.relative_to(folder.path).as_posix(): file_sha256(part) for part in parts}
            manifest = "".join(f"{digest}  {path}\n" for path, digest in digests.items())
            sha256 = hashlib.sha256(manifest.encode()).hexdigest()
            hashes.append(DataHash(f"{inner.name}/*{suffix}", len(parts), sha256, digests))
    return hashes
