"""Workers: processes or threads of this machine, or those of a Dask cluster."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import dask
from distributed import Client, LocalCluster

from gyrobench.bench.foundations.errors import GyrobenchError

#: A worker that dies takes what it did along; that is tried once more, in case another run was to blame.
_ALLOWED_DEATHS = 1
_PATIENCE_S = 20.0
_ANY_PORT = "127.0.0.1:0"

_CONFIG = {
    "distributed.scheduler.allowed-failures": _ALLOWED_DEATHS,
    # A worker is given no run before it has done the last: it could only die with it.
    "distributed.scheduler.worker-saturation": 1.0,
    "distributed.worker.memory.spill": False,
    "distributed.worker.memory.target": False,
    "distributed.logging.distributed": "critical",
}


@dataclass(frozen=True)
class Workers:
    """Who does the work.

    Attributes
    ----------
    count : int or None
        Workers on this machine; None for one a core.
    are_threads : bool
        Whether they are threads of this process in place of processes.
    scheduler : str or None
        Address of a Dask scheduler, as ``tcp://host:8786``, whose workers see the run folders under the
        same paths; the two above have no meaning then.
    """

    count: int | None = None
    are_threads: bool = False
    scheduler: str | None = None

    def describe(self) -> str:
        """Say who they are."""
        if self.scheduler:
            return f"the workers of {self.scheduler}"
        number = self.count or _cores()
        return f"{number} {'thread' if self.are_threads else 'process'}{_plural(number, self.are_threads)}"


@contextmanager
def connected(workers: Workers) -> Iterator[Client]:
    """Start workers, or reach those of a cluster; local ones are gone afterwards.

    Raises
    ------
    GyrobenchError
        The scheduler can't be reached or has no workers.
    """
    with dask.config.set(_CONFIG):
        if workers.scheduler:
            with _remote(workers.scheduler) as client:
                yield client
            return
        number = workers.count or _cores()
        with (
            LocalCluster(
                n_workers=1 if workers.are_threads else number,
                threads_per_worker=number if workers.are_threads else 1,
                processes=not workers.are_threads,
                # Any free port: several fleets may be at work on one machine.
                dashboard_address=_ANY_PORT,
                silence_logs="CRITICAL",
            ) as cluster,
            Client(cluster) as client,
        ):
            yield client


def _remote(address: str) -> Client:
    try:
        client = Client(address, timeout=_PATIENCE_S)
    except (OSError, ValueError) as error:
        raise GyrobenchError(
            f"{address}: no Dask scheduler answers: {error}. Start one with `dask scheduler`, workers with "
            "`dask worker ADDRESS`, or leave --scheduler out"
        ) from error
    try:
        client.wait_for_workers(1, timeout=_PATIENCE_S)
    except TimeoutError as error:
        client.close()
        raise GyrobenchError(
            f"{address}: this Dask scheduler has no workers. Start some with `dask worker {address}`"
        ) from error
    return client


def _cores() -> int:
    return len(os.sched_getaffinity(0))


def _plural(number: int, are_threads: bool) -> str:
    if number == 1:
        return ""
    return "s" if are_threads else "es"
