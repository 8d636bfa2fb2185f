"""Runs the soak; see the package's docstring."""

from __future__ import annotations

import argparse
import shutil
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from tests.fuzz.fuzzing import HEADER, fuzz, table_of
from tests.soak.faults import inject_faults
from tests.soak.kills import kill_runs
from tests.soak.long_run import long_run
from tests.soak.real_time import real_time
from tests.soak.results import PartResult, PartTable, keep, kept, machine, page, terminal_text

#: The order in which the table shows them.
PARTS = ("kills", "faults", "fuzz", "long", "real_time")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run parts, write the table; 1 if something was not as it must be."""
    parser = argparse.ArgumentParser(prog="python -m tests.soak", description=__doc__)
    parser.add_argument("part", nargs="+", choices=(*PARTS, "all", "table"), help="table: only write it")
    parser.add_argument(
        "--table", type=Path, help="Markdown file to write, from all parts that were ever run"
    )
    parser.add_argument("--results", type=Path, default=Path("build/soak"), help="folder of results and runs")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--kills", type=int, default=200, help="how many at least")
    parser.add_argument("--faults", type=int, default=620, help="how many to aim at, over all kinds")
    parser.add_argument("--kind", action="append", default=[], help="kind of fault, may be repeated")
    parser.add_argument("--inputs", type=int, default=10_000, help="of the fuzzer")
    parser.add_argument("--hours", type=float, default=1010.0, help="of bench time, of the long run")
    parser.add_argument("--minutes", type=float, default=15.5, help="of real time")
    options = parser.parse_args(arguments)
    runs: Mapping[str, Callable[[Path], PartResult]] = {
        "kills": lambda folder: kill_runs(folder, options.kills, options.seed),
        "faults": lambda folder: inject_faults(folder, options.faults, options.seed, options.kind),
        "fuzz": lambda folder: _fuzz(options.inputs, options.seed),
        "long": lambda folder: long_run(folder, options.hours, options.seed),
        "real_time": lambda folder: real_time(folder, options.minutes, options.seed),
    }
    is_well = True
    for part in PARTS if "all" in options.part else [each for each in options.part if each != "table"]:
        work = (options.results / "runs" / part).absolute()
        shutil.rmtree(work, ignore_errors=True)
        result = runs[part](work)
        keep(options.results, result)
        sys.stdout.write(terminal_text(result) + "\n")
        is_well &= not result.problems
    if options.table:
        before = options.table.read_text() if options.table.exists() else ""
        _, heading, wrong = before.partition("\n## Wrong set-ups")  # tests.adversarial writes it
        options.table.write_text(page(kept(options.results, PARTS)) + "\n" + heading + wrong)
    return int(not is_well)


def _fuzz(count: int, seed: int) -> PartResult:
    """Let the fuzzer run."""
    begin_s = time.monotonic()
    tallies = fuzz(count, seed)
    rows = table_of(tallies)
    _, *counts = rows[-1]
    inputs, refused, accepted, problems = map(str, counts)
    return PartResult(
        "fuzz",
        "Fuzz",
        {"inputs": inputs, "refused with a clear error": refused, "accepted with a right result": accepted,
         "problems": problems},
        "Mutated files of every kind that the bench reads. "
        f"Took {(time.monotonic() - begin_s) / 60.0:.0f} min.",
        [PartTable(list(HEADER), [list(map(str, row)) for row in rows])],
        [problem for tally in tallies.values() for problem in tally.problems],
        machine(),
    )  # fmt: skip


if __name__ == "__main__":
    sys.exit(main())
