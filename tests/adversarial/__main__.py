"""Prints the table of wrong set-ups; see the package's docstring."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence
from pathlib import Path

from tests.adversarial.harness import RowResult, measure_row
from tests.adversarial.rows import CLEAN, ROWS

HEADER = ("what was done", "dwells", "flagged", "silent", "cause named", "level", "vertical", "95 %")
_BEGIN, _END = "<!-- wrong set-ups: begin -->", "<!-- wrong set-ups: end -->"


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure rows, print or write the table; 1 if a dwell is silent or too many good ones are flagged."""
    parser = argparse.ArgumentParser(prog="python -m tests.adversarial", description=__doc__)
    parser.add_argument("row", nargs="*", help="part of the names of the rows; all without any")
    parser.add_argument("--runs", type=int, help="runs of six dwells for each row")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--flags", action="store_true", help="print the most frequent flag of each row")
    parser.add_argument("--table", type=Path, help="page into which the table is written")
    options = parser.parse_args(arguments)
    chosen = [
        row for row in (*ROWS, CLEAN) if not options.row or any(part in row.name for part in options.row)
    ]
    results, begin_s = [], time.process_time()
    for row in chosen:
        results.append(measure_row(row, options.seed, options.runs))
        sys.stdout.write(_line(results[-1]) + "\n")
        if options.flags and results[-1].usual_flag:
            sys.stdout.write(f"    {results[-1].usual_flag}\n")
        sys.stdout.flush()
    sys.stdout.write(f"{time.process_time() - begin_s:.0f} s of processor time\n")
    if options.table:
        page = options.table.read_text()
        before, _, rest = page.partition(_BEGIN)
        options.table.write_text(f"{before}{_BEGIN}\n{_table(results)}\n{_END}{rest.partition(_END)[2]}")
    return int(not all(map(is_well, results)))


def is_well(result: RowResult) -> bool:
    """Whether a row is as it must be."""
    return not result.silent and (result.row is not CLEAN or result.flagged <= 0.01 * result.dwells)


def _cells(result: RowResult) -> list[str]:
    sizes = [f"{result.rms(level):.2f}" for level in (True, False)]
    return [
        result.row.name,
        str(result.dwells),
        str(result.flagged),
        str(result.silent),
        str(result.named) if result.row.cause else "",
        *("" if size == "nan" else size for size in sizes),
        "" if result.flagged == result.dwells else f"{100.0 * result.coverage():.0f} %",
    ]


def _line(result: RowResult) -> str:
    name, *counts = _cells(result)
    return f"{name:<60}" + "".join(f"{count:>9}" for count in counts)


def _table(results: Sequence[RowResult]) -> str:
    lines = [HEADER, ["---"] * len(HEADER), *map(_cells, results)]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


if __name__ == "__main__":
    raise SystemExit(main())
