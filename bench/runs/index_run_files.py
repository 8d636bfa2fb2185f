"""Run folders in a folder or an object store: where they are, and whether they changed."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import fsspec
from fsspec.spec import AbstractFileSystem

from gyrobench.bench.foundations.errors import RunFolderError
from gyrobench.bench.runs.folder import (
    ACCEPTANCE,
    BIAS_BINS,
    CLOSURE,
    COMPENSATION,
    DWELLS,
    JOURNAL,
    PROVENANCE,
)

#: What a search for effects tells programs.
CLOSURE_FILE = f"{CLOSURE}/closure.json"
#: Table of the units, in the root of the runs.
UNITS = "units.csv"

#: What the search found, for people, with the hash of the dwells that it saw.
CLOSURE_FINDINGS = f"{CLOSURE}/findings.json"

_OF_A_RUN = (JOURNAL, PROVENANCE, DWELLS, BIAS_BINS, ACCEPTANCE, COMPENSATION)
#: Runs lie no deeper than this; it also ends the walk through links that lead back.
_MOST_LEVELS = 8
_MOST_BYTES = 1_000_000_000
#: What tells a change: the store's own tag where it has one, else the time.
_TAGS = ("ETag", "etag", "mtime", "LastModified", "last_modified", "created")


@dataclass(frozen=True)
class RunFiles:
    """One run folder as it lies in the store.

    Attributes
    ----------
    path : str
        Relative to the root; "." where the root is the run.
    files : mapping of str to str
        Files that the index reads, by name; size and tag of each.
    """

    path: str
    files: Mapping[str, str]

    @property
    def fingerprint(self) -> str:
        """Text that is another after a file changed, came or went."""
        return json.dumps(dict(sorted(self.files.items())))


@dataclass(frozen=True)
class RunStore:
    """A folder, or a part of an object store, that holds run folders.

    Attributes
    ----------
    url : str
        As given: a path, or any URL that fsspec knows, as ``s3://bucket/runs`` or ``memory://runs``.
    file_system, root
        What reads it, and the path in it.
    """

    url: str
    file_system: AbstractFileSystem = field(repr=False)
    root: str

    @property
    def is_local(self) -> bool:
        """Whether it is a folder of this machine."""
        return "file" in _protocols(self.file_system)

    def runs(self) -> Iterator[RunFiles]:
        """Find run folders, in the order of their paths; a run inside a run is not looked for.

        Raises
        ------
        RunFolderError
            The root is not there, or can't be read.
        """
        for folder, inner, files in self._walk():
            if JOURNAL in files:
                found = {name: _tag(files[name]) for name in _OF_A_RUN if name in files}
                if CLOSURE in inner:
                    found |= self._closure(folder)
                inner.clear()
                yield RunFiles(folder.removeprefix(self.root).strip("/") or ".", found)
            else:
                # In place: this is the order in which the walk goes on.
                ordered = sorted(inner.items())
                inner.clear()
                inner.update(ordered)

    def read(self, path: str) -> bytes:
        """Content of a file.

        Raises
        ------
        RunFolderError
            It can't be read, or is too large.
        """
        whole = f"{self.root.rstrip('/')}/{path}"
        try:
            size = self.file_system.size(whole)
            if size is not None and size > _MOST_BYTES:
                raise RunFolderError(f"{path}: {size} bytes; at most {_MOST_BYTES} are allowed")
            return bytes(self.file_system.cat_file(whole))
        except RunFolderError:
            raise
        except OSError as error:
            raise RunFolderError(f"{path}: can't be read: {error.strerror or error}") from error

    def tag(self, path: str) -> str:
        """Size and tag of a file; empty where it is not there."""
        try:
            return _tag(self.file_system.info(f"{self.root.rstrip('/')}/{path}"))
        except OSError:
            return ""

    def _closure(self, folder: str) -> dict[str, str]:
        tags = {}
        for name in (CLOSURE_FILE, CLOSURE_FINDINGS):
            with contextlib.suppress(FileNotFoundError):
                tags[name] = _tag(self.file_system.info(f"{folder}/{name}"))
        return tags

    def _walk(self) -> Iterator[tuple[str, dict[str, Any], dict[str, Any]]]:
        try:
            if not self.file_system.isdir(self.root):
                raise RunFolderError(
                    f"{self.url}: there is no such folder of runs. Give the folder that holds the run folders"
                )
            yield from self.file_system.walk(self.root, maxdepth=_MOST_LEVELS, detail=True)
        except RunFolderError:
            raise
        except OSError as error:
            raise RunFolderError(f"{self.url}: can't be read: {error.strerror or error}") from error


def open_store(url: str) -> RunStore:
    """Find what a path or URL leads to.

    Raises
    ------
    RunFolderError
        Nothing here reads such a URL.
    """
    try:
        file_system, root = fsspec.core.url_to_fs(url)
    except (ImportError, ValueError) as error:
        raise RunFolderError(f"{url}: can't be opened: {error}") from error
    return RunStore(url, file_system, root)


def _protocols(file_system: AbstractFileSystem) -> tuple[str, ...]:
    protocol = file_system.protocol
    return (protocol,) if isinstance(protocol, str) else tuple(protocol)


def _tag(info: Mapping[str, Any]) -> str:
    return f"{info.get('size')} {next((info[name] for name in _TAGS if info.get(name)), '')}"
