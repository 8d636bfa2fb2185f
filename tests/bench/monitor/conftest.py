"""A short run with its snapshots."""

import io
from dataclasses import dataclass

import pytest

from gyrobench.bench.engine.job import prepare_job
from gyrobench.bench.engine.observers import ObserverGroup, RunObserver
from gyrobench.bench.engine.operator import ConsentingOperator
from gyrobench.bench.engine.run import run_job
from gyrobench.bench.monitor.snapshot import RunSnapshot
from gyrobench.bench.monitor.snapshot_recorder import SnapshotRecorder
from gyrobench.bench.monitor.terminal import RunConsole
from gyrobench.bench.monitor.terminal_view import LinesView
from gyrobench.bench.runs.folder import RunFolder
from gyrobench.bench.station.instruments import Emulation


class Album(RunObserver):
    """Keeps a snapshot of every tenth tick, and the last one."""

    def __init__(self, recorder):
        self._recorder = recorder
        self._beats = 0
        self.snapshots = []

    def beat(self, bench):
        self._beats += 1
        if self._beats % 10 == 0:
            self.snapshots.append(self._recorder.snapshot())

    def ended(self, outcome):
        self.snapshots.append(self._recorder.snapshot())


@dataclass(frozen=True)
class Recorded:
    folder: RunFolder
    snapshots: list[RunSnapshot]


def recorded_run(out, procedure="ten_minute_check", operator=None, faults=""):
    """Run a procedure with a recorder."""
    job = prepare_job(str(procedure), "emulated", Emulation("ideal", 0, faults))
    recorder = SnapshotRecorder(job.plan)
    album = Album(recorder)
    with LinesView(RunConsole(file=io.StringIO(), width=80), job.plan) as lines:
        folder, _ = run_job(job, out, ObserverGroup(recorder, lines, album), operator or ConsentingOperator())
    return Recorded(folder, album.snapshots)


@pytest.fixture(scope="session")
def recorded(tmp_path_factory):
    return recorded_run(tmp_path_factory.mktemp("recorded") / "run")
