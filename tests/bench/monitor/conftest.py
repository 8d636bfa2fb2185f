"""A short run with its pictures."""

import io
from dataclasses import dataclass

import pytest

from gyrobench.bench.engine.job import prepare_job
from gyrobench.bench.engine.observers import ObserverGroup, RunObserver
from gyrobench.bench.engine.operator import ConsentingOperator
from gyrobench.bench.engine.run import run_job
from gyrobench.bench.monitor.recorder import PictureRecorder
from gyrobench.bench.monitor.snapshot import Picture
from gyrobench.bench.monitor.terminal import PatientConsole
from gyrobench.bench.monitor.terminal_view import LinesView
from gyrobench.bench.runs.folder import RunFolder
from gyrobench.bench.station.instruments import Emulation


class Album(RunObserver):
    """Keeps a picture of every tenth tick, and the last one."""

    def __init__(self, recorder):
        self._recorder = recorder
        self._beats = 0
        self.pictures = []

    def beat(self, bench):
        self._beats += 1
        if self._beats % 10 == 0:
            self.pictures.append(self._recorder.picture())

    def ended(self, outcome):
        self.pictures.append(self._recorder.picture())


@dataclass(frozen=True)
class Recorded:
    folder: RunFolder
    pictures: list[Picture]


def recorded_run(out, procedure="ten_minute_check", operator=None, faults=""):
    """Run a procedure with a recorder."""
    job = prepare_job(str(procedure), "emulated", Emulation("ideal", 0, faults))
    recorder = PictureRecorder(job.plan)
    album = Album(recorder)
    with LinesView(PatientConsole(file=io.StringIO(), width=80), job.plan) as lines:
        folder, _ = run_job(job, out, ObserverGroup(recorder, lines, album), operator or ConsentingOperator())
    return Recorded(folder, album.pictures)


@pytest.fixture(scope="session")
def recorded(tmp_path_factory):
    return recorded_run(tmp_path_factory.mktemp("recorded") / "run")
