"""Shares the inputs among processes, and counts what came of them."""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path

#: Columns of :func:`table_of`.
HEADER = ("kind", "inputs", "refused", "accepted", "problems")


@dataclass
class Tally:
    """What became of the inputs of one kind."""

    refused: int = 0
    accepted: int = 0
    problems: list[str] = field(default_factory=list)

    @property
    def inputs(self) -> int:
        """How many there were."""
        return self.refused + self.accepted + len(self.problems)


def fuzz(
    count: int,
    seed: int,
    kinds: Sequence[str] = (),
    only_input: int | None = None,
    jobs: int = 1,
    keep: Path | None = None,
) -> dict[str, Tally]:
    """Fuzz.

    Parameters
    ----------
    count : int
        How many inputs, of all kinds together.
    seed : int
        Equal seeds give equal inputs.
    kinds : sequence of str
        Kinds of file; all where empty. Each has as many inputs as it has among all.
    only_input : int, optional
        Only the input of this number.
    jobs : int
        How many processes.
    keep : Path, optional
        Folder for inputs that are a problem.

    Returns
    -------
    dict of str to Tally
        By kind.
    """
    command = [sys.executable, "-m", "tests.fuzz", "--count", str(count), "--seed", str(seed)]
    command += [word for kind in kinds for word in ("--only", kind)]
    if only_input is not None:
        command += ["--input", str(only_input)]
    if keep is not None:
        keep.mkdir(parents=True, exist_ok=True)
        command += ["--keep", str(keep.resolve())]
    with tempfile.TemporaryDirectory(prefix="fuzz-") as folder, ThreadPoolExecutor(jobs) as pool:
        shared = [Path(folder) / str(job) for job in range(jobs)]
        parts = list(
            pool.map(lambda job: _part([*command, "--jobs", str(jobs)], job, jobs, shared[job]), range(jobs))
        )
    tallies: dict[str, Tally] = {}
    for part in parts:
        for kind, tally in part.items():
            whole = tallies.setdefault(kind, Tally())
            whole.refused += tally.refused
            whole.accepted += tally.accepted
            whole.problems += tally.problems
    return tallies


def table_of(tallies: Mapping[str, Tally]) -> list[tuple[str, int, int, int, int]]:
    """One row a kind, and one for all."""
    rows = [
        (kind, tally.inputs, tally.refused, tally.accepted, len(tally.problems))
        for kind, tally in tallies.items()
    ]
    inputs, refused, accepted, problems = (sum(row[column] for row in rows) for column in range(1, 5))
    return [*rows, ("all", inputs, refused, accepted, problems)]


def _part(command: list[str], first: int, step: int, shared: Path) -> dict[str, Tally]:
    """Have every ``step``-th input read; a process that dies is followed by another."""
    tallies: dict[str, Tally] = {}
    while True:
        place, kind, number = -1, "", 0
        worker_command = [*command, "--first", str(first), "--shared", str(shared)]
        with subprocess.Popen(worker_command, stdout=subprocess.PIPE, text=True) as worker:
            for line in worker.stdout or ():
                report = json.loads(line)
                if "place" in report:
                    place, kind, number = report["place"], report["kind"], report["number"]
                else:
                    _count(tallies.setdefault(kind, Tally()), report, f"{kind} {number}")
                    first = place + step
        if not worker.returncode:
            return tallies
        if place < first:
            raise RuntimeError("even the files without damage can't be used; see above")
        tallies.setdefault(kind, Tally()).problems.append(
            f"{kind} {number}: the process died, code {worker.returncode}"
        )
        first = place + step


def _count(tally: Tally, report: dict[str, str], name: str) -> None:
    match report["outcome"]:
        case "refused":
            tally.refused += 1
        case "accepted":
            tally.accepted += 1
        case _:
            tally.problems.append(f"{name}: {report['why']}")
