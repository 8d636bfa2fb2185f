"""What ties a signed report to its data: hashes of the files that it was made from."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from gyrobench.bench.foundations.files import file_sha256
from gyrobench.bench.runs.folder import RunFolder


@dataclass(frozen=True)
class DataHash:
    """Hash of a file, or of all parts of a log.

    Attributes
    ----------
    name : str
        The file, or the parts: "can/*.blf".
    count : int
        Number of files.
    sha256 : str
        Of a single file. Of a log in parts that of its manifest, the lines that ``sha256sum`` prints for
        them: ``sha256sum can/*.blf | sha256sum`` in the run folder gives the same.
    """

    name: str
    count: int
    sha256: str


def data_hashes(folder: RunFolder) -> list[DataHash]:
    """Hash the dwell table, the journal, and the raw logs; what is missing is left out.

    Raises
    ------
    RunFolderError
        A file can't be read.
    """
    hashes = [
        DataHash(path.name, 1, file_sha256(path))
        for path in (folder.dwells, folder.journal)
        if path.is_file()
    ]
    for inner, suffix in ((folder.can, ".blf"), (folder.telemetry, ".parquet")):
        parts = sorted(inner.glob(f"*{suffix}"))
        if parts:
            hashes.append(
                DataHash(f"{inner.name}/*{suffix}", len(parts), _manifest_sha256(folder.path, parts))
            )
    return hashes


def _manifest_sha256(root: Path, parts: Sequence[Path]) -> str:
    lines = [f"{file_sha256(part)}  {part.relative_to(root).as_posix()}\n" for part in parts]
    return hashlib.sha256("".join(lines).encode()).hexdigest()
