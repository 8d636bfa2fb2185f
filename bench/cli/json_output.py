"""One JSON object on standard output, for programs that call a command."""

from __future__ import annotations

import dataclasses
import json
import math
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from bench.engine.session import Job

JSON_HELP = "Print one JSON object in place of text; everything else goes to standard error."
JsonOption = Annotated[bool, typer.Option("--json", help=JSON_HELP)]


def print_json(content: dict[str, Any]) -> None:
    """Print an object; numbers that are not finite become null, as JSON has none."""
    typer.echo(json.dumps(plain(content), indent=1, ensure_ascii=False, allow_nan=False))


def plain(value: Any) -> Any:
    """Turn records, arrays and paths into what JSON has."""
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
    return str(value) if isinstance(value, Path) else value


def plan_record(job: Job, figure: Path) -> dict[str, Any]:
    """What `gyrobench plan` tells of a plan."""
    plan = job.plan
    return {
        "procedure": plan.procedure.procedure,
        "station": job.station.file.station,
        "duration_s": plan.duration_s,
        "dwells": plan.dwell_count,
        "figure": figure,
        "steps": [
            {
                "number": planned.number,
                "step": planned.step.name,
                "what": planned.step.describe(),
                "start_s": planned.start_s,
                "duration_s": planned.duration_s,
                "dwell": planned.dwell or None,
                "cycle": planned.cycle,
            }
            for planned in plan.steps
        ],
    }
