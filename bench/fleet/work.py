"""Jobs of many runs, handed to workers; what one run does to a worker harms no other."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import count
from pathlib import Path

from distributed import Client, Future, KilledWorker, as_completed

from gyrobench.bench.fleet.jobs import JobKind, JobResult, JobState, do_job
from gyrobench.bench.fleet.record import FleetRecord
from gyrobench.bench.foundations.clock import Deadline, WallClock

#: What was done is on the disk at the latest after this.
_WRITE_EVERY_S = 5.0

_calls = count(1)


def work_through(client: Client, record: FleetRecord, paths: Sequence[Path]) -> Iterator[JobResult]:
    """Do the record's job with some runs; gives each result as soon as it is there and notes it.

    However this ends, the record tells of all that was done.

    Raises
    ------
    RunFolderError
        The record can't be written.
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
    if isinstance(error, KilledWorker):
        why = "its worker was killed, twice: perhaps it takes more memory than there is. Use fewer --workers"
    else:
        why = f"{type(error).__name__}: {error}"
    return JobResult(path, JobState.FAILED, why)
