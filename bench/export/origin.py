"""Where exported data came from."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any

import bench
from bench.errors import RunFolderError
from bench.reading import read_limited
from bench.run_store.folder import RunFolder
from bench.run_store.journal import read_journal
from bench.run_store.provenance import read_provenance

_MAX_BYTES = 500_000_000


def origin_of(folder: RunFolder) -> dict[str, Any]:
    """Plain data: run, unit, versions, hashes, and how the run ended.

    Raises
    ------
    RunFolderError
        Provenance or journal can't be read.
    """
    provenance = read_provenance(folder)
    known: dict[str, Any] = {"procedure": None, "station": None, "unit": None, "ended": None}
    for entry in read_journal(folder.journal):
        known |= {key: str(entry[key]) for key in known if key in entry}
        if entry.get("event") == "run_resumed":
            known["ended"] = None
    return {
        "run": folder.path.resolve().name,
        **known,
        "started_utc": provenance.get("started_utc"),
        "instruments": provenance.get("instruments", {}),
        "measured_by": f"gyrobench {provenance.get('gyrobench', '?')}",
        "exported_by": f"gyrobench {bench.__version__}",
        "sha256": {**provenance.get("files_sha256", {}), folder.journal.name: sha256_of(folder.journal)},
    }


def sha256_of(path: Path) -> str:
    """Hash of a file.

    Raises
    ------
    RunFolderError
        It can't be read.
    """
    return hashlib.sha256(read_limited(path, _MAX_BYTES, RunFolderError)).hexdigest()
