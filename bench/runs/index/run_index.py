"""The index of the runs of a folder or object store: one DuckDB file, made from the run folders.

All its content comes from the run folders, so it may be deleted at any time. An update reads only runs whose
files have changed.
"""

from __future__ import annotations

import hashlib
import os
import shlex
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from gyrobench.bench.foundations.clock import Deadline, WallClock
from gyrobench.bench.foundations.errors import DocumentError, GyrobenchError, RunFolderError
from gyrobench.bench.foundations.files import make_folder, require_utf8
from gyrobench.bench.foundations.packages import require
from gyrobench.bench.foundations.text import counted
from gyrobench.bench.runs.index.selection import Selection
from gyrobench.bench.runs.index.store import UNITS, RunFiles, RunStore, open_store
from gyrobench.bench.runs.index.tables import (
    RUN_TABLES,
    SCHEMAS,
    RunRecord,
    arrow_table,
    parse_units,
    read_run_record,
    rows_by_table,
)
from gyrobench.bench.runs.provenance import SIMULATED

if TYPE_CHECKING:
    import duckdb

_INDEX = "index.duckdb"

#: Runs per transaction; complete transactions survive an interruption.
_RUNS_PER_TRANSACTION = 100
#: Parallel requests to an object store, which answers slowly.
_MAX_READERS = 16
#: Longest wait for another process that updates the index.
_LOCK_TIMEOUT_S = 20.0
#: Texts of DuckDB's errors for a locked and for a damaged file.
_LOCKED = "set lock on file"
_DAMAGED = ("Corrupt database", "not a valid DuckDB database", "Serialization Error")
_LOCK_POLL_S = 0.2
_FILE_SIGNATURE = slice(8, 12), b"DUCK"
_READ_ONLY_CONFIG = {"enable_external_access": "false", "lock_configuration": "true"}

ReportProgress = Callable[[int, int], None]


@dataclass(frozen=True)
class IndexUpdate:
    """Result of an update: number of runs read, removed, and unchanged."""

    read: int
    removed: int
    unchanged: int

    @property
    def text(self) -> str:
        """Summary: "12 of 300 runs read, 1 run removed"; empty if nothing changed."""
        read = [f"{self.read} of {counted(self.read + self.unchanged, 'run')} read"] if self.read else []
        return ", ".join([*read, *([f"{counted(self.removed, 'run')} removed"] if self.removed else [])])


@dataclass(frozen=True)
class QueryResult:
    """Result of a query: names of its columns, and its rows."""

    columns: list[str]
    rows: list[tuple[Any, ...]]

    def records(self) -> list[dict[str, Any]]:
        """Rows as values by column."""
        return [dict(zip(self.columns, row, strict=True)) for row in self.rows]


class _IndexInUseError(RunFolderError):
    """Another process holds the lock of the index."""


class RunIndex:
    """The index of one store.

    Its file is by default ``index.duckdb`` beside the runs, and in the user's cache for an object store or a
    folder that the user can't write to.
    """

    def __init__(self, store: RunStore, path: Path | None = None) -> None:
        self._duckdb = require("duckdb")
        self._store = store
        self.path = path or _default_path(store)

    def update(self, *, rebuild: bool = False, progress: ReportProgress | None = None) -> IndexUpdate:
        """Bring the index up to date, or read all runs again.

        ``rebuild``: whether to read all runs again. ``progress``: called with the number of changed runs read
        so far and in total. Raises RunFolderError if the runs can't be found or the index can't be written,
        UnusablePathError if a name is not valid UTF-8.
        Raises DocumentError if the table of units is wrong.
        """
        runs = {run.path: run for run in self._store.runs()}
        for name in (os.path.relpath(self.path), *runs):
            require_utf8(name)
        units_tag = self._store.tag(UNITS)
        is_new = rebuild or not self._is_usable()
        indexed = {} if is_new else self._fingerprints()
        changed = [run for path, run in runs.items() if indexed.get(path) != run.fingerprint]
        removed = [path for path in indexed if path not in runs and path != UNITS]
        if changed or removed or indexed.get(UNITS) != units_tag or is_new:
            make_folder(self.path.parent)
            with self._connect_to_write(is_new=is_new) as connection:
                try:
                    if is_new:  # in the same file, since other processes wait for its lock
                        _make_tables(connection)
                    _remove_runs(connection, removed)
                    self._read_changed(connection, changed, progress)
                    self._read_units(connection, units_tag)
                except self._duckdb.Error as error:
                    text = str(error).splitlines()[0]
                    raise RunFolderError(
                        f"{self.path}: can't be written: {text}. Choose another file with --index"
                    ) from error
        return IndexUpdate(len(changed), len(removed), len(runs) - len(changed))

    def query(self, sql: str, parameters: Sequence[Any] = ()) -> QueryResult:
        """Query the index, read-only and without access to other files.

        Raises DocumentError if the query is invalid.
        """
        with self._connect(read_only=True) as connection:
            try:
                queries = connection.extract_statements(sql)
                if len(queries) != 1:
                    raise DocumentError(f"{len(queries)} queries given. Give one")
                cursor = connection.execute(sql, list(parameters))
                return QueryResult([column[0] for column in cursor.description or ()], cursor.fetchall())
            except self._duckdb.Error as error:
                raise DocumentError(f"invalid query: {error}") from error

    def problems(self) -> dict[str, str]:
        """Run folders that can't be read, with the reasons."""
        return dict(self.query("SELECT path, problem FROM files WHERE problem <> '' ORDER BY path").rows)

    def _read_changed(
        self,
        connection: duckdb.DuckDBPyConnection,
        changed: Sequence[RunFiles],
        progress: ReportProgress | None,
    ) -> None:
        """Replace the rows of changed runs, in transactions."""
        with ThreadPoolExecutor(1 if self._store.is_local else _MAX_READERS) as readers:
            for first in range(0, len(changed), _RUNS_PER_TRANSACTION):
                runs = changed[first : first + _RUNS_PER_TRANSACTION]
                outcomes = list(readers.map(partial(_read_or_problem, self._store), runs))
                connection.begin()
                _remove_runs(connection, [run.path for run in runs])
                _insert(connection, "files", [_file_row(*each) for each in zip(runs, outcomes, strict=True)])
                records = [each for each in outcomes if isinstance(each, RunRecord)]
                for table, rows in rows_by_table(records).items():
                    _insert(connection, table, rows)
                connection.commit()
                if progress:
                    progress(first + len(runs), len(changed))

    def _read_units(self, connection: duckdb.DuckDBPyConnection, tag: str) -> None:
        """Replace the table of units, and the columns of runs that depend on it."""
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
        """Fingerprints of the runs in the index; None for a run with a problem, so that it is read again."""
        if not self.path.exists():
            return {}
        return dict(self.query("SELECT path, CASE problem WHEN '' THEN fingerprint END FROM files").rows)

    def _is_usable(self) -> bool:
        """Whether an index exists whose columns have the names and types of :data:`SCHEMAS`."""
        if not self.path.exists():
            return False
        if not _is_duckdb(self.path):
            raise RunFolderError(
                f"{self.path}: not an index of runs. Choose another file with --index, or remove this one"
            )
        try:
            with self._connect(read_only=True) as connection:
                return all(
                    connection.table(name).limit(0).arrow().schema == SCHEMAS[name] for name in SCHEMAS
                )
        except (DocumentError, self._duckdb.Error):
            return False

    def _remove(self) -> None:
        if self.path.exists() and not _is_duckdb(self.path):
            raise RunFolderError(f"{self.path}: not an index of runs, so it is not replaced. Remove it")
        try:
            for path in (self.path, self.path.with_name(f"{self.path.name}.wal")):
                path.unlink(missing_ok=True)
        except OSError as error:
            raise RunFolderError(f"{self.path}: can't be removed: {error.strerror}") from error

    def _connect_to_write(self, *, is_new: bool) -> duckdb.DuckDBPyConnection:
        """Connect; a file that can't be opened is replaced if the index ``is_new``."""
        try:
            return self._connect(read_only=False)
        except _IndexInUseError:
            raise
        except (DocumentError, RunFolderError):
            if not is_new:
                raise
        self._remove()
        return self._connect(read_only=False)

    def _connect(self, *, read_only: bool) -> duckdb.DuckDBPyConnection:
        """Connect to the index, and wait for other processes up to a time limit."""
        clock = WallClock()
        deadline = Deadline(clock, _LOCK_TIMEOUT_S)
        while True:
            try:
                connection: duckdb.DuckDBPyConnection = self._duckdb.connect(
                    os.path.relpath(self.path),  # below a folder whose name may not be UTF-8
                    read_only=read_only,
                    config=dict(_READ_ONLY_CONFIG) if read_only else {},
                )
                return connection
            except self._duckdb.Error as error:
                is_held = _LOCKED in str(error)
                if not is_held or deadline.expired():
                    raise self._connection_error(error, is_held=is_held) from error
            clock.sleep(_LOCK_POLL_S)

    def _connection_error(self, error: duckdb.Error, *, is_held: bool) -> RunFolderError:
        """Error for an index that could not be opened."""
        if is_held:
            return _IndexInUseError(
                f"{self.path}: another process is using this index. Wait until it has finished"
            )
        if any(mark in str(error) for mark in _DAMAGED):
            raise DocumentError(f"{self.path}: damaged. Rebuild it with --rebuild") from error
        text = str(error).splitlines()[0]
        return RunFolderError(
            f"{self.path}: can't be opened: {text}. Rebuild it with --rebuild, or choose another file with "
            "--index"
        )


def _default_path(store: RunStore) -> Path:
    """Path of the index: beside the runs if that is possible, otherwise in the user's cache."""
    if store.is_local and os.access(store.root, os.W_OK):
        return Path(store.root) / _INDEX
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    location = store.root if store.is_local else store.url
    name = hashlib.sha256(location.encode()).hexdigest()[:16]
    return cache / "gyrobench" / f"index-{name}.duckdb"


def _is_duckdb(path: Path) -> bool:
    span, signature = _FILE_SIGNATURE
    try:
        with path.open("rb") as stream:
            return stream.read(span.stop)[span] == signature
    except OSError as error:
        raise RunFolderError(f"{path}: can't be read: {error.strerror}") from error


def _make_tables(connection: duckdb.DuckDBPyConnection) -> None:
    """Replace all tables by empty ones."""
    connection.begin()
    for (name,) in connection.execute("SELECT table_name FROM duckdb_tables()").fetchall():
        connection.execute(f'DROP TABLE "{name}"')
    for name in SCHEMAS:
        columns = arrow_table(name, [])
        connection.register("columns", columns)
        connection.execute(f"CREATE TABLE {name} AS SELECT * FROM columns")  # noqa: S608 - ours
        connection.unregister("columns")
    connection.commit()


def _remove_runs(connection: duckdb.DuckDBPyConnection, paths: Sequence[str]) -> None:
    for table in (*RUN_TABLES, "files"):
        if paths:
            connection.execute(f"DELETE FROM {table} WHERE path IN (SELECT unnest(?))", [list(paths)])  # noqa: S608 - ours


def _insert(connection: duckdb.DuckDBPyConnection, table: str, rows: Sequence[dict[str, Any]]) -> None:
    connection.register("added", arrow_table(table, rows))
    connection.execute(f"INSERT INTO {table} BY NAME SELECT * FROM added")  # noqa: S608 - ours
    connection.unregister("added")


def _read_or_problem(store: RunStore, run: RunFiles) -> RunRecord | str:
    """Read a run; returns the reason if it can't be read."""
    try:
        return read_run_record(run, store.read)
    except GyrobenchError as error:
        return str(error)


def _file_row(run: RunFiles, result: RunRecord | str) -> dict[str, Any]:
    problem = result if isinstance(result, str) else ""
    return {"path": run.path, "fingerprint": run.fingerprint, "problem": problem}


def find_runs(index: RunIndex, selection: Selection) -> list[dict[str, Any]]:
    """Selected rows of the table of runs, newest first."""
    condition, parameters = selection.condition()
    sql = f"SELECT * FROM runs WHERE {condition} ORDER BY started_utc DESC, path DESC"  # noqa: S608 - ours
    return index.query(sql, parameters).records()


def watermark(runs: Sequence[Mapping[str, Any]]) -> str:
    """Watermark of results of these rows of :func:`find_runs`; empty if no run was emulated."""
    return SIMULATED if any(run["world"] for run in runs) else ""


Grouping = Literal["unit", "batch", "bench", "procedure", "month"]

#: SQL expression of a group's name; versions of a procedure differ in the first digits of the SHA-256.
_GROUP_NAMES: dict[Grouping, str] = {
    "unit": "unit",
    "batch": "batch",
    "bench": "station",
    "procedure": "concat(procedure, ' ', left(procedure_sha256, 7))",
    "month": "strftime(started_utc, '%Y-%m')",
}

_GROUP_SQL = """
WITH chosen AS (SELECT *, {name} AS name FROM runs WHERE {condition}),
levels AS (
    SELECT path, gyro, sum(bias_dph / sigma_dph ** 2) / sum(1 / sigma_dph ** 2) AS bias_dph
    FROM bins WHERE count > 0 GROUP BY path, gyro
),
biases AS (
    SELECT name, {columns}
    FROM chosen JOIN levels USING (path) WHERE NOT compensated GROUP BY name
),
counts AS (
    SELECT name, count(*) AS runs, count(DISTINCT unit) AS units,
        count(*) FILTER (verdict = 'clean') AS clean,
        count(*) FILTER (verdict = 'explained') AS explained,
        count(*) FILTER (verdict IN ('ambiguous', 'unexplained')) AS other,
        count(*) FILTER (acceptance = 'accepted') AS accepted,
        count(*) FILTER (acceptance = 'marginal') AS marginal,
        count(*) FILTER (acceptance = 'rejected') AS rejected,
        median(error_before_dph) AS error_before_dph, median(error_after_dph) AS error_after_dph
    FROM chosen GROUP BY name
)
SELECT * FROM counts LEFT JOIN biases USING (name) ORDER BY name
"""


def group_runs(index: RunIndex, by: Grouping, selection: Selection) -> list[dict[str, Any]]:
    """Counts of verdicts and mean biases of the selected runs by group.

    A run's bias is the weighted mean over its bins and positions; the spread is the standard deviation
    over the runs. Both exclude runs in which the INS compensated biases.
    """
    condition, parameters = selection.condition()
    columns = ", ".join(
        f"{function}(bias_dph) FILTER (gyro = '{gyro}') AS {kind}_{gyro}_dph"
        for gyro in "xyz"
        for kind, function in (("bias", "avg"), ("spread", "stddev_samp"))
    )
    sql = _GROUP_SQL.format(name=_GROUP_NAMES[by], condition=condition, columns=columns)
    return index.query(sql, parameters).records()


def runs_in_index(root: str, index: RunIndex, selection: Selection) -> list[Path]:
    """Absolute paths of the selected runs of an index.

    Raises RunFolderError if no run is selected, or the store is an object store, which can't be written.
    """
    store = open_store(root)
    if not store.is_local:
        raise RunFolderError(f"{root}: runs in an object store can't be changed. Copy them to a folder first")
    paths = [Path(store.root) / run["path"] for run in find_runs(index, selection)]
    if not paths:
        raise RunFolderError(
            f"{root}: no run matches the selection. List them with: gyrobench runs {shlex.quote(root)}"
        )
    return paths
