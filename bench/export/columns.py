"""What the columns of tables are: text, whole number or measured value, and in which unit.

Names of columns end in their unit.
"""

from __future__ import annotations

from types import MappingProxyType

import pyarrow as pa

_TEXT = frozenset(
    {"unit", "run", "position", "gyro", "method", "finding", "flags", "effect", "compensation", "term"}
)
_WHOLE = frozenset({"dwell", "cycle", "stop", "dwells", "turned_dwell", "count", "part", "step", "mode"})
#: By the end of the name, longer ends first.
_UNITS = MappingProxyType(
    {
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
)


def unit_of(column: str) -> str:
    """Unit of a column; empty where it has none."""
    return next((unit for end, unit in _UNITS.items() if column.endswith(end)), "")


def type_of(column: str) -> pa.DataType:
    """Type of a column in a file that has types."""
    if column in _TEXT:
        return pa.string()
    return pa.int64() if column in _WHOLE else pa.float64()


def field_of(column: str, kind: pa.DataType | None = None) -> pa.Field:
    """Column of a schema, with its unit as metadata."""
    unit = unit_of(column)
    return pa.field(column, kind or type_of(column), metadata={"unit": unit} if unit else None)
