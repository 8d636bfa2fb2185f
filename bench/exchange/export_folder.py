"""The folder of an export: typed columns with units, complete files, and a record of the data's origin."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet as pq

from gyrobench.bench import __version__
from gyrobench.bench.foundations.errors import RunFolderError, UnusablePathError
from gyrobench.bench.foundations.files import (
    file_sha256,
    make_folder,
    parse_json,
    read_limited,
    sync_folder,
    temporary_path,
    write_error,
    write_whole,
)
from gyrobench.bench.runs.folder import RunFolder
from gyrobench.bench.runs.journal import facts_of, read_journal
from gyrobench.bench.runs.provenance import read_provenance

_TEXT_COLUMNS = frozenset(
    {
        "unit", "run", "position", "gyro", "coefficient", "method", "finding", "flags", "effect",
        "compensation", "term", "result", "quantity", "axis", "contribution", "type", "distribution",
        "input_unit", "note",
    }
)  # fmt: skip
_INTEGER_COLUMNS = frozenset(
    {"dwell", "cycle", "stop", "plateau", "dwells", "turned_dwell", "count", "part", "step", "mode"}
)
#: Unit by the end of a column's name, longer ends first.
_UNIT_BY_SUFFIX = {
    "_dph_per_c_per_h": "deg/h per K/h",
    "_dph_per_k": "deg/h per K",
    "_dph_per_g": "deg/h per g",
    "_c_per_h": "K/h",
    "_arcmin": "arcmin",
    "_dph": "deg/h",
    "_dps": "deg/s",
    "_mps": "m/s",
    "_deg": "deg",
    "_ug": "ug",
    "_c": "degC",
    "_k": "K",
    "_s": "s",
    "_ratio": "1",
    "_value": "1",
    "chi2_reduced": "1",
}


def unit_of(column: str) -> str:
    """Unit of a column; empty if it has none."""
    return next((unit for end, unit in _UNIT_BY_SUFFIX.items() if column.endswith(end)), "")


def type_of(column: str) -> pa.DataType:
    """Arrow type of a column."""
    if column in _TEXT_COLUMNS:
        return pa.string()
    return pa.int64() if column in _INTEGER_COLUMNS else pa.float64()


def field_of(column: str) -> pa.Field:
    """Column of a schema, with its unit as metadata."""
    unit = unit_of(column)
    return pa.field(column, type_of(column), metadata={"unit": unit} if unit else None)


def data_origin(folder: RunFolder) -> dict[str, Any]:
    """Run, unit, versions, hashes and end of the run as plain data; None for unknown values.

    Raises RunFolderError if provenance or journal can't be read.
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
        "exported_by": f"gyrobench {__version__}",
        "sha256": {**provenance.get("files_sha256", {}), folder.journal.name: file_sha256(folder.journal)},
    }


#: Record in the folder of the exported files.
_RECORD_FILE = "export.json"
_MAX_RECORD_BYTES = 10_000_000


@dataclass
class ExportFolder:
    """The folder, which is made when the first file is written, and the record of its files.

    ``origin`` is the source of the data, ``force`` allows existing files to be replaced, ``written`` lists
    the files in order.
    """

    folder: Path
    origin: Mapping[str, Any]
    force: bool = False
    written: list[Path] = field(default_factory=list)
    _about: dict[str, Any] = field(default_factory=dict)

    def refuse_existing(self, names: list[str]) -> None:
        """Check for existing files before the first one is written.

        Raises UnusablePathError if a file exists and ``force`` is off.
        """
        existing = [name for name in names if (self.folder / name).exists()]
        if existing and not self.force:
            raise UnusablePathError(
                f"{self.folder}: already contains {', '.join(existing)}. Use --force or another --out"
            )

    @contextlib.contextmanager
    def file(self, name: str, **about: Any) -> Iterator[Path]:
        """Temporary path to write to; the complete file replaces the target. ``about`` goes into the record.

        Raises RunFolderError if it can't be written.
        """
        make_folder(self.folder)
        path = self.folder / name
        temporary = temporary_path(path)
        try:
            yield temporary
            temporary.replace(path)
            sync_folder(self.folder)
        except OSError as error:
            if isinstance(error, RunFolderError):
                raise
            raise write_error(path, error) from error
        finally:
            temporary.unlink(missing_ok=True)
        self.written.append(path)
        self._about[name] = about

    def table(self, name: str, schema: pa.Schema, batches: Iterator[pa.Table], **about: Any) -> None:
        """Write a table as Parquet or CSV, by the suffix of its name, batch by batch.

        Raises RunFolderError if it can't be written.
        """
        units = {column: unit for column in schema.names if (unit := unit_of(column))}
        with self.file(name, units=units, **about) as path:
            if name.endswith(".parquet"):
                origin = {"gyrobench": json.dumps({**self.origin, **about})}
                with pq.ParquetWriter(path, schema.with_metadata(origin), compression="zstd") as writer:
                    for batch in batches:
                        writer.write_table(batch.cast(schema))
            else:
                options = pa.csv.WriteOptions(include_header=False)
                with path.open("wb") as stream:
                    stream.write((",".join(schema.names) + "\n").encode())
                    with pa.csv.CSVWriter(stream, schema, write_options=options) as writer:
                        for batch in batches:
                            writer.write_table(batch.cast(schema))

    def finish(self) -> None:
        """Write the record of all files; entries of other files of the same run are kept.

        Raises RunFolderError if it can't be written.
        """
        if not self.written:
            return
        path = self.folder / _RECORD_FILE
        content = {"origin": self.origin, "files": self._earlier_entries(path) | self._about}
        write_whole(path, (json.dumps(content, indent=2, default=str) + "\n").encode())
        self.written.append(path)

    def _earlier_entries(self, path: Path) -> dict[str, Any]:
        """Entries of an existing record of the same run."""
        if not path.exists():
            return {}
        try:
            content = parse_json(read_limited(path, _MAX_RECORD_BYTES, RunFolderError))
            is_same_run = content["origin"]["run"] == self.origin["run"]
            return {name: about for name, about in content["files"].items() if is_same_run}
        except (ValueError, TypeError, LookupError, AttributeError):
            return {}  # another file of that name
