"""One JSON object on standard output, for programs that call a command."""

from __future__ import annotations

import dataclasses
import json
import math
from datetime import date
from decimal import Decimal
from enum import Enum
from typing import Annotated, Any

import typer

JSON_HELP = "Print one JSON object in place of text; everything else goes to standard error."
JsonOption = Annotated[bool, typer.Option("--json", help=JSON_HELP)]


def print_json(content: dict[str, Any]) -> None:
    """Print an object; numbers that are not finite become null, as JSON has none."""
    typer.echo(json.dumps(plain(content), indent=1, ensure_ascii=False, allow_nan=False))


def plain(value: Any) -> Any:
    """Turn records, arrays, times and paths into what JSON has; what else there is becomes its text."""
    if hasattr(value, "model_dump"):  # models of pydantic
        return value.model_dump(mode="json")
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {field.name: plain(getattr(value, field.name)) for field in dataclasses.fields(value)}
    if isinstance(value, dict):
        return {str(key): plain(each) for key, each in value.items()}
    if isinstance(value, list | tuple | set | frozenset):
        return [plain(each) for each in value]
    if hasattr(value, "tolist"):  # arrays and numbers of numpy
        return plain(value.tolist())
    if isinstance(value, Enum):
        return plain(value.value)
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, date):  # a datetime is one too
        return value.isoformat()
    if isinstance(value, Decimal):
        return plain(float(value))
    return value if isinstance(value, str | int | None) else str(value)
