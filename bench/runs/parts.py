"""Numbered parts: how a log that grows for days lies in its folder."""

from __future__ import annotations

import re
from pathlib import Path

from gyrobench.bench.foundations.errors import RunFolderError


def part_path(folder: Path, number: int, suffix: str) -> Path:
    """Path of a part, numbered from 1."""
    return folder / f"part-{number:05d}{suffix}"


def find_parts(folder: Path, suffix: str) -> dict[int, Path]:
    """Find the parts in a folder, number to path, in the order of their numbers.

    Raises
    ------
    RunFolderError
        The folder can't be read.
    """
    name = re.compile(rf"part-(\d{{5,9}}){re.escape(suffix)}")
    try:
        matches = [(name.fullmatch(path.name), path) for path in folder.iterdir()]
    except FileNotFoundError:
        return {}
    except OSError as error:
        raise RunFolderError(f"{folder}: can't be read: {error.strerror}") from error
    return dict(sorted((int(match[1]), path) for match, path in matches if match))
