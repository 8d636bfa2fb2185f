"""The runs that are meant: named one by one, by folders that hold them, by patterns, or by an index."""

from __future__ import annotations

import glob
from collections.abc import Iterator, Sequence
from pathlib import Path

from gyrobench.bench.foundations.errors import RunFolderError
from gyrobench.bench.runs.folder import JOURNAL
from gyrobench.bench.runs.index import RunIndex
from gyrobench.bench.runs.index_run_files import open_store
from gyrobench.bench.runs.index_selection import Selection, find_runs


def runs_named(names: Sequence[str]) -> list[Path]:
    """Absolute paths of run folders, each once.

    Parameters
    ----------
    names : sequence of str
        Run folders, folders that hold them at any depth, and patterns with ``*``, ``?`` or ``[]``.

    Raises
    ------
    RunFolderError
        A name leads to no run.
    """
    paths = [path for name in names for path in _named(name)]
    return list(dict.fromkeys(paths))


def runs_in_index(root: str, index: RunIndex, selection: Selection) -> list[Path]:
    """Absolute paths of the runs of an index that are meant.

    Raises
    ------
    RunFolderError
        No run is meant, or they are in an object store, where nothing can be written.
    """
    store = open_store(root)
    if not store.is_local:
        raise RunFolderError(f"{root}: runs in an object store can't be written. Copy them to a folder first")
    paths = [Path(store.root) / run["path"] for run in find_runs(index, selection)]
    if not paths:
        raise RunFolderError(f"{root}: no run is as asked for. See them with: gyrobench runs {root}")
    return paths


def _named(name: str) -> Iterator[Path]:
    matches = [name] if Path(name).exists() else sorted(glob.glob(name))  # noqa: PTH207 - may be absolute
    places = [Path(match) for match in matches]
    found = False
    for place in places:
        for path in _below(place.absolute()):
            found = True
            yield path
    if not found:
        raise RunFolderError(f"{name}: there is no run folder. Give run folders, or folders that hold some")


def _below(place: Path) -> Iterator[Path]:
    if (place / JOURNAL).is_file():
        yield place
    elif place.is_dir():
        yield from (place / run.path for run in open_store(str(place)).runs())
