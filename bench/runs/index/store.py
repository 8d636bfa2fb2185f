"""Run folders in a folder or an object store: their paths, and tags that change with their files."""

from __future__ import annotations

import contextlib
import glob
import json
import os
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gyrobench.bench.foundations.errors import MissingRunError, RunFolderError
from gyrobench.bench.foundations.packages import require
from gyrobench.bench.runs.folder import (
    ACCEPTANCE,
    BIAS_BINS,
    CLOSURE,
    COMPENSATION,
    DWELLS,
    JOURNAL,
    PROVENANCE,
    UNITS_FOLDER,
)

if TYPE_CHECKING:
    from fsspec.spec import AbstractFileSystem

#: Result of a search for effects.
CLOSURE_FILE = f"{CLOSURE}/closure.json"
#: Table of the units, in the root of the runs.
UNITS = "units.csv"

#: Findings of a search as data, with the hash of the dwells that were searched.
CLOSURE_FINDINGS = f"{CLOSURE}/findings.json"

_RUN_FILES = (JOURNAL, PROVENANCE, DWELLS, BIAS_BINS, ACCEPTANCE, COMPENSATION)
_INVESTIGATION_FILE = "start.csv"
#: Maximum depth of run folders; it also ends a walk through cyclic links.
_MAX_DEPTH = 8
_MAX_BYTES = 1_000_000_000
#: Keys of values that change with a file: the tag of the store if it has one, else the time.
_TAGS = ("ETag", "etag", "mtime", "LastModified", "last_modified", "created")


@dataclass(frozen=True)
class RunFiles:
    """One run folder of a store."""

    path: str  #: Relative to the root; "." if the root is the run.
    files: Mapping[str, str]  #: Size and tag of each file that the index reads, by name.

    @property
    def fingerprint(self) -> str:
        """Text that changes with any file."""
        return json.dumps(dict(sorted(self.files.items())))


@dataclass(frozen=True)
class RunStore:
    """A folder, or a part of an object store, that holds run folders."""

    url: str  #: As given: a path, or any URL that fsspec knows, as ``s3://bucket/runs`` or ``memory://runs``.
    #: file_system, root: Its fsspec file system, and the path in it.
    file_system: AbstractFileSystem = field(repr=False)
    root: str

    @property
    def is_local(self) -> bool:
        """Whether it is a folder of this machine."""
        protocol = self.file_system.protocol
        return "file" in ((protocol,) if isinstance(protocol, str) else protocol)

    def runs(self) -> Iterator[RunFiles]:
        """Find run folders in order of their paths; folders inside a run are not searched.

        For a run with several units, finds the folders of the units instead of that of the run; for an
        investigation, its runs.

        Raises RunFolderError if the root does not exist or can't be read.
        """
        for folder, inner, files in self._walk():
            to_search = _folders_to_search(inner, files)
            if to_search is None:
                tags = {name: _tag(files[name]) for name in _RUN_FILES if name in files}
                if CLOSURE in inner:
                    tags |= self._closure(folder)
                inner.clear()
                yield RunFiles(folder.removeprefix(self.root).strip("/") or ".", tags)
            else:
                # In place, which sets the order of the walk.
                ordered = {name: inner[name] for name in to_search}
                inner.clear()
                inner.update(ordered)

    def read(self, path: str) -> bytes:
        """Content of a file. Raises RunFolderError if it can't be read, or is too large."""
        full_path = f"{self.root.rstrip('/')}/{path}"
        try:
            size = self.file_system.size(full_path)
            if size is not None and size > _MAX_BYTES:
                raise RunFolderError(f"{path}: {size} bytes exceed the limit of {_MAX_BYTES}")
            return bytes(self.file_system.cat_file(full_path))
        except RunFolderError:
            raise
        except OSError as error:
            raise RunFolderError(f"{path}: can't be read: {error.strerror or error}") from error

    def tag(self, path: str) -> str:
        """Size and tag of a file; empty if it does not exist."""
        try:
            return _tag(self.file_system.info(f"{self.root.rstrip('/')}/{path}"))
        except OSError:
            return ""

    def _closure(self, folder: str) -> dict[str, str]:
        """Tags of the files of a search in a run folder."""
        tags = {}
        for name in (CLOSURE_FILE, CLOSURE_FINDINGS):
            with contextlib.suppress(FileNotFoundError):
                tags[name] = _tag(self.file_system.info(f"{folder}/{name}"))
        return tags

    def _walk(self) -> Iterator[tuple[str, dict[str, Any], dict[str, Any]]]:
        try:
            if not self.file_system.isdir(self.root):
                raise MissingRunError(
                    f"{self.url}: no such folder. Give the folder that contains the run folders"
                )
            yield from self.file_system.walk(self.root, maxdepth=_MAX_DEPTH, detail=True)
        except RunFolderError:
            raise
        except OSError as error:
            raise RunFolderError(f"{self.url}: can't be read: {error.strerror or error}") from error


def open_store(url: str) -> RunStore:
    """Open a folder or an object store by path or URL. Raises RunFolderError if the URL is not supported."""
    url_to_fs = require("fsspec.core").url_to_fs
    try:
        file_system, root = url_to_fs(url)
    except (ImportError, ValueError) as error:
        raise RunFolderError(f"{url}: can't be opened: {error}") from error
    return RunStore(url, file_system, root)


def _tag(info: Mapping[str, Any]) -> str:
    """Size of a file, and a value that changes with its content."""
    return f"{info.get('size')} {next((info[name] for name in _TAGS if info.get(name)), '')}"


def find_run_folders(names: Sequence[str]) -> list[Path]:
    """Absolute paths of run folders, each once.

    ``names``: run folders, folders that hold them at any depth, and patterns with ``*``, ``?`` or ``[]``.
    Raises RunFolderError if a name matches no run folder.
    """
    found: dict[Path, None] = {}
    for name in names:
        roots = [name] if Path(name).exists() else sorted(glob.glob(name))  # noqa: PTH207 - may be absolute
        paths = [path for root in roots for path in _run_folders_below(Path(root).absolute())]
        if not paths:
            problem = "no run folder found. Give run folders, or folders that contain some"
            raise MissingRunError(f"{name}: {problem}")
        found |= dict.fromkeys(paths)
    return list(found)


def _run_folders_below(root: Path) -> Iterator[Path]:
    """Run folders of this machine, as :meth:`RunStore.runs`, but without fsspec."""
    for folder, inner, files in os.walk(root, followlinks=True):
        path = Path(folder)
        to_search = _folders_to_search(inner, files)
        if to_search is None:
            yield path
        is_deepest = len(path.relative_to(root).parts) + 1 >= _MAX_DEPTH
        inner[:] = [] if is_deepest else to_search or []


def _folders_to_search(inner: Collection[str], files: Collection[str]) -> list[str] | None:
    """Inner folders to search for runs, in order; None if the folder is a run without units."""
    if JOURNAL not in files or _INVESTIGATION_FILE in files:
        return sorted(inner)
    return [UNITS_FOLDER] if UNITS_FOLDER in inner else None
