"""Independent looks at what was read."""

from __future__ import annotations

import csv
import io
import math
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from gyrobench.bench.foundations.documents import Document


class WrongResultError(Exception):
    """An input was accepted with a result that an independent reading contradicts."""


def written(folder: Path, name: str, data: bytes) -> Path:
    """Write an input."""
    path = folder / name
    path.write_bytes(data)
    return path


def check_finite(values: Any, what: str) -> None:
    """Refuse NaN and infinity."""
    if not np.isfinite(np.asarray(values, dtype=float)).all():
        raise WrongResultError(f"{what} is not finite: {values}")


def check_document(document: Document) -> None:
    """Compare what the bench read with the same file as PyYAML reads it when all scalars are text."""
    # Of libyaml where it is there, as the bench has it: it takes a tab between values for a space.
    loader = getattr(yaml, "CBaseLoader", yaml.BaseLoader)
    plain = yaml.load(document.path.read_bytes(), loader)  # noqa: S506 - it makes texts alone
    _same(document.data, plain, "document")


def _same(read: Any, plain: Any, place: str) -> None:
    if isinstance(read, dict):
        same = isinstance(plain, dict) and read.keys() == plain.keys()
        for key in read if same else ():
            _same(read[key], plain[key], f"{place}.{key}")
    elif isinstance(read, list):
        same = isinstance(plain, list) and len(read) == len(plain)
        for index, value in enumerate(read if same else ()):
            _same(value, plain[index], f"{place}[{index}]")
    elif isinstance(read, bool):
        same = plain.lower() == str(read).lower()
    elif isinstance(read, int):
        same = int(plain, {"0x": 16, "0o": 8}.get(plain[:2], 10)) == read
    elif isinstance(read, float):
        same = float(plain) == read
    elif read is None:
        same = plain.lower() in ("", "~", "null")
    else:
        same = read == plain
    if not same:
        raise WrongResultError(f"{place}: read as {read!r:.80}, is {plain!r:.80}")


def cells_of(data: bytes) -> list[dict[str, str]]:
    """Rows of a table as the csv module reads them."""
    return [
        {(key or "").strip(): (value or "").strip() for key, value in each.items()}
        for each in csv.DictReader(io.StringIO(data.decode("utf-8-sig"), newline=""))
    ]


def check_cell(value: str | float | tuple[str, ...] | None, cell: str) -> None:
    """Compare what the bench read with the text of its cell."""
    if isinstance(value, str):
        same = value == cell
    elif isinstance(value, tuple):
        same = "; ".join(value) == cell
    elif value is None or math.isnan(value):
        same = cell.lower() in ("", "nan")
    else:
        same = float(cell) == value
    if not same:
        raise WrongResultError(f"read as {value!r}, is {cell!r}")
