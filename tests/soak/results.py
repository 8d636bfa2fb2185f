"""Results of the parts, kept as JSON, and the table that is made from them."""

from __future__ import annotations

import json
import os
import platform
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path

_INTRODUCTION = """# Reliability: kills, faults, damaged files, long runs

Made by `make soak`, on the emulated bench; `python -m tests.soak PART` runs one part. *Wrong* is a result
without a flag that is off the world's truth by more than five of its stated sigma.
"""


@dataclass
class PartTable:
    """One table: its head, and rows of as many cells."""

    head: list[str]
    rows: list[list[str]]


@dataclass
class PartResult:
    """What came of a part.

    Attributes
    ----------
    part, title : str
        Name of the part, and its heading.
    figures : dict of str to str
        What the summary shows, with units.
    text : str
        How it was done.
    tables : list of PartTable
        Details.
    problems : list of str
        What was not as it must be; empty where all was well.
    """

    part: str
    title: str
    figures: dict[str, str]
    text: str
    tables: list[PartTable] = field(default_factory=list)
    problems: list[str] = field(default_factory=list)
    machine: str = ""


def machine() -> str:
    """What it ran on, and how busy that was."""
    model = next(
        (
            line.partition(":")[2].strip()
            for line in Path("/proc/cpuinfo").read_text().splitlines()
            if line.startswith("model name")
        ),
        platform.machine(),
    )
    load = ", ".join(f"{each:.1f}" for each in os.getloadavg())
    return f"{model}, {os.cpu_count()} cores, Python {platform.python_version()}, load {load}"


def keep(folder: Path, result: PartResult) -> None:
    """Write a part's result."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / f"{result.part}.json").write_text(json.dumps(asdict(result), indent=1))


def kept(folder: Path, parts: Sequence[str]) -> list[PartResult]:
    """Read the results that are there, in order."""
    found = []
    for part in parts:
        path = folder / f"{part}.json"
        if path.exists():
            values = json.loads(path.read_text())
            values["tables"] = [PartTable(**each) for each in values["tables"]]
            found.append(PartResult(**values))
    return found


def page(results: Sequence[PartResult]) -> str:
    """The whole table as Markdown."""
    summary = PartTable(
        ["part", "figure", "value"],
        [
            [result.title if not index else "", name, value]
            for result in results
            for index, (name, value) in enumerate(result.figures.items())
        ],
    )
    return "\n".join([_INTRODUCTION, markdown(summary), *(_section(result) for result in results)])


def _section(result: PartResult) -> str:
    parts = [f"\n## {result.title}\n", result.text, *(f"\n{markdown(table)}" for table in result.tables)]
    if result.problems:
        parts.append("\nNot as it must be:\n\n" + "\n".join(f"- {each}" for each in result.problems))
    return "\n".join([*parts, f"\nMachine: {result.machine}."])


def markdown(table: PartTable) -> str:
    """A table as Markdown."""
    lines = [table.head, ["---"] * len(table.head), *table.rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def terminal_text(result: PartResult) -> str:
    """A part's result for the terminal."""
    lines = [result.title, *(f"  {name:48}{value}" for name, value in result.figures.items())]
    for table in result.tables:
        widths = [max(len(row[i]) for row in (table.head, *table.rows)) for i in range(len(table.head))]
        lines.extend(
            "  " + "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True))
            for row in (table.head, *table.rows)
        )
    return "\n".join([*lines, *(f"  PROBLEM: {each}" for each in result.problems)])


def counts(title: str, values: Mapping[str, int]) -> PartTable:
    """A table of counts."""
    return PartTable([title, "count"], [[name, str(count)] for name, count in values.items()])
