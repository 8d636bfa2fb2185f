"""The verdict on the unit of a run, kept as ``acceptance.json``."""

from __future__ import annotations

from pathlib import Path

from gyrobench.bench.bias.verdicts import Acceptance
from gyrobench.bench.foundations.csv_tables import read_text, write_text
from gyrobench.bench.foundations.errors import DocumentError
from gyrobench.bench.foundations.files import parse_json


def write_acceptance(path: Path, acceptance: Acceptance) -> None:
    """Write a verdict and all that it stands on.

    Raises
    ------
    RunFolderError
        The file can't be written.
    """
    write_text(path, acceptance.model_dump_json(indent=2) + "\n")


def read_acceptance(path: Path) -> Acceptance:
    """Read a verdict.

    Raises
    ------
    DocumentError
        The file can't be read or holds something else.
    """
    text = read_text(path)
    try:
        return Acceptance.model_validate(parse_json(text))
    except ValueError as error:
        raise DocumentError(f"{path}: holds no verdict: {error}") from error
