"""Tables of the index: their columns, and the rows that one run has in each."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, fields
from typing import Any

import pyarrow as pa

from gyrobench.bench.bias.bins import BiasBin
from gyrobench.bench.bias.dwell_table import DwellRow
from gyrobench.bench.navigation.positions import AXES
from gyrobench.bench.runs.index_run_record import RunRecord, RunRow
from gyrobench.bench.runs.index_units import Unit

#: Another number for every change of the columns: an index of another one is made anew.
VERSION = 1

_TEXT, _NUMBER, _COUNT = pa.string(), pa.float64(), pa.int64()
_TYPES = {"str": _TEXT, "float": _NUMBER, "float | None": _NUMBER, "int": _COUNT, "int | None": _COUNT}
_OTHER_TYPES = {"bool": pa.bool_(), "datetime": pa.timestamp("us")}
_DWELL_SCALARS = (
    "azimuth_deg",
    "start_s",
    "end_s",
    "since_power_on_s",
    "chamber_set_c",
    "chamber_c",
    "case_c",
)
_DWELL_TRIPLES = {
    "gyro_c": "gyro_{}_c",
    "gyro_rate_c_per_h": "gyro_{}_rate_c_per_h",
    "bias_dph": "bias_{}_dph",
    "sigma_dph": "sigma_{}_dph",
}


def _schema_of(model: type, *first: tuple[str, pa.DataType]) -> pa.Schema:
    types = _TYPES | _OTHER_TYPES
    return pa.schema([*first, *((each.name, types[str(each.type)]) for each in fields(model))])


#: Columns by table. Names and units are those of the files of a run; ``path`` is that of the run.
SCHEMAS: Mapping[str, pa.Schema] = {
    "runs": _schema_of(RunRow).append(pa.field("batch", _TEXT)).append(pa.field("hardware", _TEXT)),
    "bins": _schema_of(BiasBin, ("path", _TEXT)),
    "dwells": pa.schema(
        [
            *((name, _TEXT) for name in ("path", "run")),
            *((name, _COUNT) for name in ("dwell", "cycle")),
            ("position", _TEXT),
            *((name, _NUMBER) for name in _DWELL_SCALARS),
            *((name.format(axis), _NUMBER) for name in _DWELL_TRIPLES.values() for axis in AXES),
            ("fit_p_value", _NUMBER),
            ("flags", _TEXT),
        ]
    ),
    "effects": pa.schema(
        [
            *((name, _TEXT) for name in ("path", "effect", "form", "axes")),
            *((name, _NUMBER) for name in ("rms_dph", "p_value")),
            ("tied_with", _TEXT),
        ]
    ),
    "units": _schema_of(Unit),
    "files": pa.schema([(name, _TEXT) for name in ("path", "fingerprint", "problem")]),
}
#: Tables with rows of runs.
OF_RUNS = ("runs", "bins", "dwells", "effects")


def arrow_table(name: str, rows: Iterable[Mapping[str, Any]]) -> pa.Table:
    """Rows of a table in Arrow's form; numbers that are not finite become null, as do values not given."""
    return pa.Table.from_pylist([_without_nan(row) for row in rows], schema=SCHEMAS[name])


def rows_of(records: Sequence[RunRecord]) -> dict[str, list[dict[str, Any]]]:
    """Rows by table that some runs have."""
    return {
        "runs": [asdict(record.row) for record in records],
        "bins": [{"path": record.row.path, **asdict(each)} for record in records for each in record.bins],
        "dwells": [_dwell(record.row.path, row) for record in records for row in record.dwells],
        "effects": [
            {
                "path": record.row.path,
                **each.model_dump(),
                "axes": "".join(each.axes),
                "tied_with": ", ".join(each.tied_with),
            }
            for record in records
            for each in record.effects
        ],
    }


def _dwell(path: str, row: DwellRow) -> dict[str, Any]:
    triples = {
        column.format(axis): value
        for name, column in _DWELL_TRIPLES.items()
        for axis, value in zip(AXES, getattr(row, name), strict=True)
    }
    names = ("run", "dwell", "cycle", "position", *_DWELL_SCALARS, "fit_p_value", "flags")
    return {"path": path, **{name: getattr(row, name) for name in names}, **triples}


def _without_nan(row: Mapping[str, Any]) -> dict[str, Any]:
    return {
        name: None if isinstance(value, float) and not math.isfinite(value) else value
        for name, value in row.items()
    }
