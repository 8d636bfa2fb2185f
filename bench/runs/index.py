"""The index of the runs of a folder or object store: one DuckDB file, made from the run folders.

It holds nothing that the run folders do not, so it may be removed at any time. Only runs whose files
changed since are read again.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import duckdb

from gyrobench.bench.foundations.clock import Deadline, WallClock
from gyrobench.bench.foundations.errors import DocumentError, GyrobenchError, RunFolderError
from gyrobench.bench.foundations.files import make_folder
from gyrobench.bench.foundations.text import counted
from gyrobench.bench.runs.index_run_files import UNITS, RunFiles, RunStore
from gyrobench.bench.runs.index_run_record import RunRecord, read_run_record
from gyrobench.bench.runs.index_tables import OF_RUNS, SCHEMAS, VERSION, arrow_table, rows_of
from gyrobench.bench.runs.index_units import parse_units

INDEX = "index.duckdb"

#: So many runs are written at one stroke; what is written stays if the making is interrupted.
_AT_ONCE = 100
#: An object store takes some time for every answer, so several are asked for together.
_READERS = 16
#: Another process has the index open for about as long as it takes to read what changed.
_PATIENCE_S = 20.0
#: What DuckDB says of a file that another process has open, and of one that is not whole.
_LOCKED = "set lock on file"
_DAMAGED = ("Corrupt database", "not a valid DuckDB database", "Serialization Error")
_LOOK_S = 0.2
_MAGIC = slice(8, 12), b"DUCK"
_PROTECTED = {"enable_external_access": "false", "lock_configuration": "true"}

ReportProgress = Callable[[int, int], None]


@dataclass(frozen=True)
class Changes:
    """What an update of the index found: number of runs read, gone, and left as they were."""

    read: int
    gone: int
    unchanged: int

    @property
    def text(self) -> str:
        """For people: "12 of 300 runs read anew, 1 run gone"; empty where nothing changed."""
        told = [f"{self.read} of {counted(self.read + self.unchanged, 'run')} read anew"] if self.read else []
        return ", ".join([*told, *([f"{counted(self.gone, 'run')} gone"] if self.gone else [])])


@dataclass(frozen=True)
class QueryResult:
    """Result of a query: names of its columns, and its rows."""

    columns: list[str]
    rows: list[tuple[Any, ...]]

    def records(self) -> list[dict[str, Any]]:
        """Rows as values by column."""
        return [dict(zip(self.columns, row, strict=True)) for row in self.rows]


class RunIndex:
    """The index of one store.

    Parameters
    ----------
    store : RunStore
        Where the runs are.
    path : Path, optional
        The index; by default ``index.duckdb`` beside the runs, and for an object store a file of its
        own in the user's cache.
    """

    def __init__(self, store: RunStore, path: Path | None = None) -> None:
        self._store = store
        self.path = path or _default_path(store)

    def update(self, *, rebuild: bool = False, progress: ReportProgress | None = None) -> Changes:
        """Bring the index up to date.

        Parameters
        ----------
        rebuild : bool
            Whether to read all runs anew.
        progress : callable, optional
            Told how many of how many changed runs are read.

        Raises
        ------
        RunFolderError
            The runs can't be found or the index can't be written.
        DocumentError
            The table of units is wrong.
        """
        found = {run.path: run for run in self._store.runs()}
        units_tag = self._store.tag(UNITS)
        if rebuild or not self._is_usable():
            self._remove()
        known = self._fingerprints()
        changed = [run for path, run in found.items() if known.get(path) != run.fingerprint]
        gone = [path for path in known if path not in found and path != UNITS]
        if changed or gone or known.get(UNITS) != units_tag or not self.path.exists():
            make_folder(self.path.parent)
            with self._connect(read_only=False) as connection:
                _make_tables(connection)
                _remove_runs(connection, gone)
                self._read_changed(connection, changed, progress)
                self._read_units(connection, units_tag)
        return Changes(len(changed), len(gone), len(found) - len(changed))

    def query(self, sql: str, parameters: Sequence[Any] = ()) -> QueryResult:
        """Ask the index; the query can change nothing and sees no other file.

        Raises
        ------
        DocumentError
            The query is wrong.
        """
        with self._connect(read_only=True) as connection:
            try:
                queries = connection.extract_statements(sql)
                if len(queries) != 1:
                    raise DocumentError(f"one query is answered at a time; found {len(queries)}")
                cursor = connection.execute(sql, list(parameters))
                return QueryResult([column[0] for column in cursor.description or ()], cursor.fetchall())
            except duckdb.Error as error:
                raise DocumentError(f"the query can't be answered: {error}") from error

    def problems(self) -> dict[str, str]:
        """Run folders that can't be read, and why."""
        return dict(self.query("SELECT path, problem FROM files WHERE problem <> '' ORDER BY path").rows)

    def _read_changed(
        self,
        connection: duckdb.DuckDBPyConnection,
        changed: Sequence[RunFiles],
        progress: ReportProgress | None,
    ) -> None:
        with ThreadPoolExecutor(1 if self._store.is_local else _READERS) as readers:
            for first in range(0, len(changed), _AT_ONCE):
                runs = changed[first : first + _AT_ONCE]
                outcomes = list(readers.map(partial(_outcome, self._store), runs))
                connection.begin()
                _remove_runs(connection, [run.path for run in runs])
                _insert(connection, "files", [_file_row(*each) for each in zip(runs, outcomes, strict=True)])
                records = [each for each in outcomes if isinstance(each, RunRecord)]
                for table, rows in rows_of(records).items():
                    _insert(connection, table, rows)
                connection.commit()
                if progress:
                    progress(first + len(runs), len(changed))

    def _read_units(self, connection: duckdb.DuckDBPyConnection, tag: str) -> None:
        units = parse_units(self._store.read(UNITS).decode("utf-8-sig", "replace"), UNITS) if tag else []
        connection.begin()
        connection.execute("DELETE FROM units")
        connection.execute("DELETE FROM files WHERE path = ?", [UNITS])
        _insert(connection, "units", [asdict(unit) for unit in units])
        _insert(connection, "files", [{"path": UNITS, "fingerprint": tag, "problem": ""}])
        connection.execute("UPDATE runs SET batch = '', hardware = ''")
        connection.execute(
            "UPDATE runs SET batch = units.batch, hardware = units.hardware FROM units "
            "WHERE runs.unit = units.unit"
        )
        connection.commit()

    def _fingerprints(self) -> dict[str, str]:
        """Of the runs in the index; one with a problem has none, since what was wrong may be mended."""
        if not self.path.exists():
            return {}
        return dict(self.query("SELECT path, CASE problem WHEN '' THEN fingerprint END FROM files").rows)

    def _is_usable(self) -> bool:
        """Whether there is an index with the columns of this program."""
        if not self.path.exists():
            return False
        if not _is_duckdb(self.path):
            raise RunFolderError(
                f"{self.path}: is no index of runs. Name another file with --index, or remove this one"
            )
        try:
            return self.query("SELECT max(number) FROM version").rows == [(VERSION,)]
        except DocumentError:
            return False

    def _remove(self) -> None:
        if self.path.exists() and not _is_duckdb(self.path):
            raise RunFolderError(
                f"{self.path}: is no index of runs, so it is not replaced. Remove it yourself"
            )
        try:
            self.path.unlink(missing_ok=True)
        except OSError as error:
            raise RunFolderError(f"{self.path}: can't be removed: {error.strerror}") from error

    def _connect(self, *, read_only: bool) -> duckdb.DuckDBPyConnection:
        clock = WallClock()
        deadline = Deadline(clock, _PATIENCE_S)
        while True:
            try:
                return duckdb.connect(
                    str(self.path), read_only=read_only, config=dict(_PROTECTED) if read_only else {}
                )
            except duckdb.Error as error:
                is_held = _LOCKED in str(error)
                if not is_held or deadline.expired():
                    raise self._not_opened(error, is_held=is_held) from error
            clock.sleep(_LOOK_S)

    def _not_opened(self, error: duckdb.Error, *, is_held: bool) -> RunFolderError:
        if is_held:
            return RunFolderError(f"{self.path}: another process is at work on this index. Wait for its end")
        if any(mark in str(error) for mark in _DAMAGED):
            raise DocumentError(f"{self.path}: is damaged. Make it anew with --rebuild") from error
        text = str(error).splitlines()[0]
        return RunFolderError(
            f"{self.path}: can't be opened: {text}. Make it anew with --rebuild, or name another file with "
            "--index where this one can't be written"
        )


def _default_path(store: RunStore) -> Path:
    if store.is_local:
        return Path(store.root) / INDEX
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    name = hashlib.sha256(store.url.encode()).hexdigest()[:16]
    return cache / "gyrobench" / f"index-{name}.duckdb"


def _is_duckdb(path: Path) -> bool:
    place, mark = _MAGIC
    try:
        with path.open("rb") as stream:
            return stream.read(place.stop)[place] == mark
    except OSError as error:
        raise RunFolderError(f"{path}: can't be read: {error.strerror}") from error


def _make_tables(connection: duckdb.DuckDBPyConnection) -> None:
    for name in SCHEMAS:
        columns = arrow_table(name, [])
        connection.register("columns", columns)
        connection.execute(f"CREATE TABLE IF NOT EXISTS {name} AS SELECT * FROM columns")  # noqa: S608 - ours
        connection.unregister("columns")
    connection.execute(f"CREATE TABLE IF NOT EXISTS version AS SELECT {VERSION} AS number")


def _remove_runs(connection: duckdb.DuckDBPyConnection, paths: Sequence[str]) -> None:
    for table in (*OF_RUNS, "files"):
        if paths:
            connection.execute(f"DELETE FROM {table} WHERE path IN (SELECT unnest(?))", [list(paths)])  # noqa: S608 - ours


def _insert(connection: duckdb.DuckDBPyConnection, table: str, rows: Sequence[dict[str, Any]]) -> None:
    connection.register("added", arrow_table(table, rows))
    connection.execute(f"INSERT INTO {table} BY NAME SELECT * FROM added")  # noqa: S608 - ours
    connection.unregister("added")


def _outcome(store: RunStore, run: RunFiles) -> RunRecord | str:
    """Read a run, or say why it can't be read."""
    try:
        return read_run_record(run, store.read)
    except GyrobenchError as error:
        return str(error)


def _file_row(run: RunFiles, outcome: RunRecord | str) -> dict[str, Any]:
    problem = outcome if isinstance(outcome, str) else ""
    return {"path": run.path, "fingerprint": run.fingerprint, "problem": problem}
