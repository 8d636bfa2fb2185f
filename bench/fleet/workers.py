"""Jobs of many runs, handed to workers: processes or threads of this machine, or a Dask cluster."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from gyrobench.bench.fleet.jobs import FleetRecord, JobKind, JobResult, JobState, do_job
from gyrobench.bench.foundations.clock import Deadline, WallClock
from gyrobench.bench.foundations.errors import GyrobenchError
from gyrobench.bench.foundations.packages import require
from gyrobench.bench.foundations.text import counted

if TYPE_CHECKING:
    from distributed import Client, Future

#: A run whose worker was killed is tried once more: another run may have caused it.
_ALLOWED_DEATHS = 1
_SCHEDULER_TIMEOUT_S = 20.0
_ANY_PORT = "127.0.0.1:0"

_CONFIG = {
    "distributed.scheduler.allowed-failures": _ALLOWED_DEATHS,
    # One run at a time for each worker: a queued run would be lost with it.
    "distributed.scheduler.worker-saturation": 1.0,
    "distributed.worker.memory.spill": False,
    "distributed.worker.memory.target": False,
    "distributed.logging.distributed": "critical",
}


@dataclass(frozen=True)
class Workers:
    """Workers that process the runs."""

    count: int | None = None  #: Workers on this machine; None for one per core.
    are_threads: bool = False  #: Whether they are threads of this process instead of processes.
    #: Address of a Dask scheduler, as ``tcp://host:8786``, whose workers see the run folders under the same
    #: paths; it excludes the two above.
    scheduler: str | None = None

    def describe(self) -> str:
        """Text for people: "4 processes"."""
        if self.scheduler:
            return f"the workers of {self.scheduler}"
        number = self.count or _cores()
        if self.are_threads:
            return counted(number, "thread")
        return "1 process" if number == 1 else f"{number} processes"


@contextmanager
def connected(workers: Workers) -> Iterator[Client]:
    """Start local workers, stopped afterwards, or connect to those of a cluster.

    Raises GyrobenchError if the scheduler can't be reached or has no workers. Raises MissingPackageError if
    Dask is not installed.
    """
    dask, distributed = require("dask"), require("distributed")
    with dask.config.set(_CONFIG):
        if workers.scheduler:
            with _remote(workers.scheduler) as client:
                yield client
            return
        number = workers.count or _cores()
        with (
            distributed.LocalCluster(
                n_workers=1 if workers.are_threads else number,
                threads_per_worker=number if workers.are_threads else 1,
                processes=not workers.are_threads,
                # Any free port: several fleets may run on one machine.
                dashboard_address=_ANY_PORT,
                silence_logs="CRITICAL",
            ) as cluster,
            distributed.Client(cluster) as client,
        ):
            yield client


def _remote(address: str) -> Client:
    try:
        client: Client = require("distributed").Client(address, timeout=_SCHEDULER_TIMEOUT_S)
    except (OSError, ValueError) as error:
        raise GyrobenchError(
            f"{address}: no Dask scheduler answers: {error}. Start one with `dask scheduler`, workers with "
            "`dask worker ADDRESS`, or leave --scheduler out"
        ) from error
    try:
        client.wait_for_workers(1, timeout=_SCHEDULER_TIMEOUT_S)
    except TimeoutError as error:
        client.close()
        raise GyrobenchError(
            f"{address}: this Dask scheduler has no workers. Start some with `dask worker {address}`"
        ) from error
    return client


def _cores() -> int:
    return len(os.sched_getaffinity(0))


#: Longest time between writing the record to disk.
_WRITE_EVERY_S = 5.0

_calls = count(1)


def work_through(client: Client, record: FleetRecord, paths: Sequence[Path]) -> Iterator[JobResult]:
    """Process runs; yields each result as it arrives and adds it to the record.

    The record on disk is complete however this ends. Raises RunFolderError if the record can't be written.
    """
    clock = WallClock()
    deadline = Deadline(clock, _WRITE_EVERY_S)
    record.write()
    try:
        for result in _results(client, record.kind, paths):
            record.add(result)
            if deadline.expired():
                record.write()
                deadline = Deadline(clock, _WRITE_EVERY_S)
            yield result
    finally:
        record.write()


def _results(client: Client, kind: JobKind, paths: Sequence[Path]) -> Iterator[JobResult]:
    as_completed = require("distributed").as_completed
    call = next(_calls)
    jobs = {
        client.submit(do_job, kind, str(path), key=f"{kind} {path} {call}", pure=False): str(path)
        for path in paths
    }
    for future in as_completed(list(jobs)):
        yield _result(future, jobs.pop(future))


def _result(future: Future[JobResult], path: str) -> JobResult:
    error = future.exception()
    if error is None:
        return future.result()
    if isinstance(error, require("distributed").KilledWorker):
        why = "its worker was killed twice, probably out of memory. Use fewer --workers"
    else:
        why = f"{type(error).__name__}: {error}"
    return JobResult(path, JobState.FAILED, why)


class FleetProgress:
    """Shows results as they arrive: a bar on a terminal, lines elsewhere; a context manager."""

    def __init__(self, console: Console, total: int) -> None:
        self._console = console
        self._total = total
        self._done = self._failed = 0
        self._bar = Progress(
            BarColumn(bar_width=24),
            MofNCompleteColumn(),
            TextColumn("{task.description}"),
            TimeRemainingColumn(compact=True),
            TextColumn("left"),
            console=console,
            transient=True,
        )
        self._task = self._bar.add_task("starting workers", total=total)

    def __enter__(self) -> FleetProgress:
        if self._console.is_terminal:
            self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._bar.stop()

    def advance(self, result: JobResult) -> None:
        """Show one more result."""
        self._done += 1
        self._failed += result.state != JobState.DONE
        if self._console.is_terminal:
            text = f"{self._failed} not done" if self._failed else "runs"
            self._bar.update(self._task, advance=1, description=text)
            return
        number = f"{self._done:>{len(str(self._total))}}/{self._total}"
        text = result.text if result.state == JobState.DONE else result.state.value
        self._console.print(
            f"{number} {Path(result.path).name}: {text}, {result.took_s:.1f} s", soft_wrap=True
        )
