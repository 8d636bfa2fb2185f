"""Where exported data came from."""

from __future__ import annotations

from typing import Any

import gyrobench
from gyrobench.bench.foundations.files import file_sha256
from gyrobench.bench.runs.folder import RunFolder
from gyrobench.bench.runs.journal import read_journal
from gyrobench.bench.runs.provenance import read_provenance
from gyrobench.bench.runs.run_facts import facts_of


def origin_of(folder: RunFolder) -> dict[str, Any]:
    """Plain data: run, unit, versions, hashes, and how the run ended; None for what is not known.

    Raises
    ------
    RunFolderError
        Provenance or journal can't be read.
    """
    provenance = read_provenance(folder)
    facts = facts_of(read_journal(folder.journal))
    return {
        "run": folder.path.resolve().name,
        "procedure": facts.procedure or None,
        "station": facts.station or None,
        "unit": facts.unit or None,
        "ended": facts.ended or None,
        "started_utc": provenance.get("started_utc"),
        "instruments": provenance.get("instruments", {}),
        "measured_by": f"gyrobench {provenance.get('gyrobench', '?')}",
        "exported_by": f"gyrobench {gyrobench.__version__}",
        "sha256": {**provenance.get("files_sha256", {}), folder.journal.name: file_sha256(folder.journal)},
    }
