"""Runs that several tests look at."""

import io
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from gyrobench.bench.engine.job import prepare_job
from gyrobench.bench.engine.operator import ConsentingOperator
from gyrobench.bench.engine.run import run_job
from gyrobench.bench.foundations.arrays import RADPS_TO_DPH
from gyrobench.bench.foundations.shipped import find_document
from gyrobench.bench.monitor.terminal_view import LinesView
from gyrobench.bench.runs.folder import RunFolder
from gyrobench.bench.station.instruments import Emulation
from gyrobench.drivers.emulators.bench import BenchAddress, bench_at
from tests.bench.runs.index.sample_runs import emulated_run


class Watcher(LinesView):
    """Prints as the command line does, and keeps what is reported and what is true in the emulated world.

    Attributes
    ----------
    estimates : list of lists of StateSpaceEstimate
        The live ones, dwell by dwell.
    true_bias_dph : list of ndarray, shape (3,)
        Mean of the world's biases while the INS navigated in each dwell.
    """

    def __init__(self, console, job):
        super().__init__(console, job.plan)
        self.estimates, self.true_bias_dph = [], []
        self._emulation = job.emulation if job.is_virtual else None
        self._bench = None
        self._navigates = False
        self._estimated, self._true = [], []

    def step_started(self, planned, bench):
        super().step_started(planned, bench)
        self._navigates = planned.step.name == "navigate"

    def ticked(self, bench, left_s):
        super().ticked(bench, left_s)
        if self._navigates and self._emulation:
            if self._bench is None:
                world = str(find_document("worlds", self._emulation.world))
                self._bench = bench_at(BenchAddress(bench.clock.name, world, self._emulation.seed))
            self._true.append(self._bench.world.true_gyro_bias() * RADPS_TO_DPH)

    def estimable(self, estimate):
        super().estimable(estimate)
        if estimate() is not None:
            self._estimated.append(estimate())

    def dwell_measured(self, row):
        super().dwell_measured(row)
        self.estimates.append(self._estimated)
        self.true_bias_dph.append(np.mean(self._true, axis=0) if self._true else None)
        self._estimated, self._true = [], []


def run_with_view(view_of, procedure, out, world="ideal", seed=0, station="emulated"):
    """Run a procedure as the command line does; returns run folder, outcome, the view and what it printed."""
    job = prepare_job(str(procedure), str(station), Emulation(str(world), seed))
    printed = io.StringIO()
    with view_of(Console(file=printed, width=80), job) as view:
        folder, outcome = run_job(job, Path(out), view, ConsentingOperator())
    return folder, outcome, view, printed.getvalue()


def watched_run(*arguments, **options):
    """Run a procedure; returns run folder, outcome, watcher and what was printed."""
    return run_with_view(Watcher, *arguments, **options)


def run(*arguments, **options):
    """Run a procedure; returns run folder, outcome and what was printed."""
    folder, outcome, _, printed = run_with_view(
        lambda console, job: LinesView(console, job.plan), *arguments, **options
    )
    return folder, outcome, printed


@pytest.fixture(scope="session")
def run_procedure():
    return run


@pytest.fixture(scope="session")
def run_watched():
    return watched_run


class Runs:
    """Runs of one procedure by world, each done when it is asked for first; ``runs[world]``."""

    def __init__(self, run_in):
        self._run_in = run_in
        self._done = {}

    def __getitem__(self, world):
        if world not in self._done:
            self._done[world] = self._run_in(world)
        return self._done[world]


@pytest.fixture(scope="session")
def watched_shift_runs(tmp_path_factory):
    """The shipped eight-hour procedure, run whole on a shipped world: run folder, outcome, watcher."""

    def run_in(world):
        folder, outcome, watcher, _ = watched_run(
            "three_temperature_shift", tmp_path_factory.mktemp(world), world
        )
        return folder, outcome, watcher

    return Runs(run_in)


@pytest.fixture(scope="session")
def shift_runs(watched_shift_runs):
    """The same without the watcher."""
    return Runs(lambda world: watched_shift_runs[world][:2])


@pytest.fixture(scope="session")
def short_run(made_once):
    """The shipped ten-minute check in the world gyro_a: run folder and what was printed."""

    def make(folder):
        _, _, printed = run("ten_minute_check", folder / "run", "gyro_a")
        (folder / "printed").write_text(printed)

    folder = made_once("short-run", make)
    return RunFolder(folder / "run"), (folder / "printed").read_text()


@pytest.fixture(scope="session")
def sample(made_once):
    """Path of a small run for index and fleet, whose tests copy it."""
    return made_once("sample-run", emulated_run) / "run-00000"
