"""Runs the fuzzer; see the package's docstring."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Sequence
from pathlib import Path

from tests.fuzz.fuzzing import HEADER, fuzz, table_of

_SHOWN_PROBLEMS = 20


def main(arguments: Sequence[str] | None = None) -> int:
    """Fuzz every kind of file and print what came of it; 1 if there was a problem."""
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz", description=__doc__)
    parser.add_argument("--count", type=int, default=10_000, help="how many inputs, of all kinds together")
    parser.add_argument("--seed", type=int, default=0, help="equal seeds give equal inputs")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1, help="how many processes")
    parser.add_argument("--only", action="append", default=[], help="kind of file; may be repeated")
    parser.add_argument("--input", type=int, default=None, help="only the input of this number, with --only")
    parser.add_argument("--keep", type=Path, default=None, help="folder for inputs that are a problem")
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
    for name, *counts in (HEADER, *table_of(tallies)):
        sys.stdout.write(f"{name:20}{''.join(f'{count:>10}' for count in counts)}\n")
    return int(bool(problems))


def _work(options: argparse.Namespace) -> None:
    from tests.fuzz.worker import Work, do

    work = Work(
        options.count, options.seed, options.only, options.input, options.first, options.jobs, options.keep
    )
    do(work, options.shared)


if __name__ == "__main__":
    sys.exit(main())
