"""Distributes the jobs of a fleet to workers: processes or threads of this machine, or a Dask cluster."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from gyrobench.bench.fleet.jobs import FleetRecord, JobKind, JobResult, JobState, do_job
from gyrobench.bench.foundations.clock import Deadline, WallClock
from gyrobench.bench.foundations.errors import GyrobenchError
from gyrobench.bench.foundations.files import sync_all
from gyrobench.bench.foundations.packages import require
from gyrobench.bench.foundations.text import counted

if TYPE_CHECKING:
    from distributed import Client

#: A run whose worker was killed is repeated once: another run may have been the cause.
_ALLOWED_DEATHS = 1
_SCHEDULER_TIMEOUT_S = 20.0

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
    are_threads: bool = False  #: Whether the workers are threads of this process instead of processes.
    #: Address of a Dask scheduler, such as ``tcp://host:8786``, whose workers see the run folders under the
    #: same paths; excludes ``count`` and ``are_threads``.
    scheduler: str | None = None

    def describe(self) -> str:
        """Text such as "4 processes"."""
        if self.scheduler:
            return f"the workers of {self.scheduler}"
        number = self.count or _cores()
        if self.are_threads:
            return counted(number, "thread")
        return "1 process" if number == 1 else f"{number} processes"


class Pool(Protocol):
    """Workers that take jobs."""

    def results(self, kind: JobKind, paths: Sequence[Path]) -> Iterator[JobResult]:
        """Process runs; yields each result as it arrives."""


@contextmanager
def connect_workers(workers: Workers) -> Iterator[Pool]:
    """Start local workers, which are stopped afterwards, or connect to a Dask cluster.

    Local workers open no port, and import nothing from the current folder. Raises GyrobenchError if the
    scheduler can't be reached or has no workers. Raises MissingPackageError if it is named and Dask is not
    installed.
    """
    if workers.scheduler:
        with require("dask").config.set(_CONFIG), _remote(workers.scheduler) as client:
            yield _Cluster(client)
        return
    os.environ["PYTHONSAFEPATH"] = "1"
    with ExitStack() as resources:
        threads = ThreadPoolExecutor(workers.count or _cores())
        try:
            yield _Local(threads, None if workers.are_threads else resources)
        finally:
            threads.shutdown(cancel_futures=True)


@dataclass(frozen=True)
class _Local:
    """Workers of this machine: each thread does its jobs itself, or in a separate process."""

    threads: ThreadPoolExecutor
    #: Closes the processes; None if the threads do the jobs.
    resources: ExitStack | None
    thread_data: threading.local = field(default_factory=threading.local)

    def results(self, kind: JobKind, paths: Sequence[Path]) -> Iterator[JobResult]:
        jobs = {self.threads.submit(self._do, kind, str(path)): str(path) for path in paths}
        for future in as_completed(jobs):
            yield _job_result(future.exception() or future.result(), jobs.pop(future))

    def _do(self, kind: JobKind, path: str) -> JobResult:
        if self.resources is None:
            return do_job(kind, path, is_synced=False)
        for remaining_deaths in range(_ALLOWED_DEATHS, -1, -1):
            process = getattr(self.thread_data, "process", None)
            if process is None:
                process = ProcessPoolExecutor(1, multiprocessing.get_context("spawn"), _ignore_interrupts)
                self.resources.callback(process.shutdown)
                self.thread_data.process = process
            try:
                return process.submit(do_job, kind, path, is_synced=False).result()
            except BrokenProcessPool:
                self.thread_data.process = None
                if not remaining_deaths:
                    raise
        raise AssertionError("the last try returns or raises")


def _ignore_interrupts() -> None:
    """Ignore Ctrl-C, which the starting process handles; a job in progress is completed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


@dataclass(frozen=True)
class _Cluster:
    """Workers of a Dask cluster."""

    client: Client

    def results(self, kind: JobKind, paths: Sequence[Path]) -> Iterator[JobResult]:
        call = next(_calls)
        jobs = {
            self.client.submit(do_job, kind, str(path), key=f"{kind} {path} {call}", pure=False): str(path)
            for path in paths
        }
        for future in require("distributed").as_completed(list(jobs)):
            yield _job_result(future.exception() or future.result(), jobs.pop(future))


def _job_result(outcome: JobResult | BaseException, path: str) -> JobResult:
    if isinstance(outcome, JobResult):
        return outcome
    if type(outcome).__name__ in ("BrokenProcessPool", "KilledWorker"):
        reason = "its worker was killed twice, probably out of memory. Use fewer --workers"
    else:
        reason = f"{type(outcome).__name__}: {outcome}"
    return JobResult(path, JobState.FAILED, reason)


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


#: Maximum time between writes of the record.
_WRITE_EVERY_S = 5.0

_calls = count(1)


def work_through(pool: Pool, record: FleetRecord, paths: Sequence[Path]) -> Iterator[JobResult]:
    """Process runs; yields each result as it arrives and adds it to the record.

    The record is complete at any end, and the results of a run are on the disk before the record lists it.
    Raises RunFolderError if the record can't be written.
    """
    clock = WallClock()
    deadline = Deadline(clock, _WRITE_EVERY_S)
    record.write()
    try:
        for result in pool.results(record.kind, paths):
            record.add(result)
            if deadline.expired():
                sync_all()
                record.write()
                deadline = Deadline(clock, _WRITE_EVERY_S)
            yield result
    finally:
        sync_all()
        record.write()


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
