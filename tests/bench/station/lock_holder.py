"""A process that holds a bench and a run folder."""

import os
import time
from contextlib import contextmanager
from multiprocessing import get_context
from pathlib import Path

from gyrobench.bench.foundations.clock import WallClock
from gyrobench.bench.station.locks import LOCK_DIR_VARIABLE, BenchLock, RunLock
from gyrobench.bench.station.station import Station

_CONTEXT = get_context("forkserver")
_CONTEXT.set_forkserver_preload([__name__])


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
    ours, theirs = _CONTEXT.Pipe()
    given = (str(station.path), str(run), os.environ[LOCK_DIR_VARIABLE], theirs)
    process = _CONTEXT.Process(target=hold, args=given, daemon=True)
    process.start()
    theirs.close()
    assert ours.recv() == "held"
    try:
        yield process, ours
    finally:
        process.kill()
        process.join()
        process.close()
        ours.close()
