"""A process that holds a bench and a run folder."""

import os
import time
from contextlib import contextmanager
from pathlib import Path

from gyrobench.bench.foundations.clock import WallClock
from gyrobench.bench.runs.locks import LOCK_DIR_VARIABLE, RunLock
from gyrobench.bench.station.bench_lock import BenchLock
from gyrobench.bench.station.station import Station
from tests.drivers.emulators.forked import CONTEXT, start


def hold(station_path, run, lock_folder, pipe):
    """Hold both until a message arrives."""
    os.environ[LOCK_DIR_VARIABLE] = lock_folder
    run = Path(run)
    with (
        BenchLock(Station(Path(station_path)), run, WallClock(), "gyrobench run x"),
        RunLock(run, WallClock()),
    ):
        pipe.send("held")
        pipe.recv()
        time.sleep(0.5)


@contextmanager
def held_elsewhere(station, run):
    """Have another process hold the bench and its run folder; gives the process and a pipe to it."""
    run.mkdir(exist_ok=True)
    ours, theirs = CONTEXT.Pipe()
    process = start(hold, str(station.path), str(run), os.environ[LOCK_DIR_VARIABLE], theirs)
    theirs.close()
    assert ours.recv() == "held"
    try:
        yield process, ours
    finally:
        process.kill()
        process.join()
        process.close()
        ours.close()
