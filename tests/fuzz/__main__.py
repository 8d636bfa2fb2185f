"""Runs the fuzzer; see the package's docstring."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

from tests.fuzz.fuzzing import Tally, fuzz

_SHOWN_PROBLEMS = 20
_HEAD = ("kind", "inputs", "refused", "accepted", "problems")


def main(arguments: Sequence[str] | None = None) -> int:
    """Fuzz every kind of file and print what came of it; 1 if there was a problem."""
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz", description=__doc__)
    parser.add_argument("--count", type=int, default=10_000, help="how many inputs, of all kinds together")
    parser.add_argument("--seed", type=int, default=0, help="equal seeds give equal inputs")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1, help="how many processes")
    parser.add_argument("--only", action="append", default=[], help="kind of file; may be repeated")
    parser.add_argument("--input", type=int, default=None, help="only the input of this number, with --only")
    parser.add_argument("--keep", type=Path, default=None, help="folder for inputs that are a problem")
    parser.add_argument("--table", type=Path, default=None, help="file for the table, as Markdown")
    parser.add_argument("--first", type=int, help=argparse.SUPPRESS)
    parser.add_argument("--shared", type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args(arguments)
    if options.shared is not None:
        _work(options)
        return 0
    tallies = fuzz(options.count, options.seed, options.only, options.input, options.jobs, options.keep)
    problems = [problem for tally in tallies.values() for problem in tally.problems]
    sys.stdout.write("".join(f"{problem}\n" for problem in problems[:_SHOWN_PROBLEMS]))
    if len(problems) > _SHOWN_PROBLEMS:
        sys.stdout.write(f"... and {len(problems) - _SHOWN_PROBLEMS} more\n")
    rows = _rows(tallies)
    for name, *counts in (_HEAD, *rows):
        sys.stdout.write(f"{name:20}{''.join(f'{count:>10}' for count in counts)}\n")
    if options.table is not None:
        lines = [_HEAD, ["---", *["---:"] * 4], *rows]
        options.table.write_text("".join(f"| {' | '.join(map(str, line))} |\n" for line in lines))
    return int(bool(problems))


def _rows(tallies: Mapping[str, Tally]) -> list[tuple[str, int, int, int, int]]:
    rows = [
        (kind, tally.inputs, tally.refused, tally.accepted, len(tally.problems))
        for kind, tally in tallies.items()
    ]
    inputs, refused, accepted, problems = (sum(row[column] for row in rows) for column in range(1, 5))
    return [*rows, ("all", inputs, refused, accepted, problems)]


def _work(options: argparse.Namespace) -> None:
    from tests.fuzz.worker import Work, do

    work = Work(
        options.count, options.seed, options.only, options.input, options.first, options.jobs, options.keep
    )
    do(work, options.shared)


if __name__ == "__main__":
    sys.exit(main())
