"""Runs that several tests look at."""

import io
from pathlib import Path

import pytest
from rich.console import Console

from bench.engine.operator import ConsentingOperator
from bench.engine.session import prepare_job, run_job
from bench.progress_view import ProgressView
from bench.station.instruments import Emulation


def run(procedure, out, world="ideal", seed=0, station="emulated"):
    """Run a procedure as the command line does; returns run folder, outcome and what was printed."""
    job = prepare_job(str(procedure), str(station), Emulation(str(world), seed))
    printed = io.StringIO()
    with ProgressView(Console(file=printed, width=80), job.plan) as progress:
        folder, outcome = run_job(job, Path(out), progress, ConsentingOperator())
    return folder, outcome, printed.getvalue()


@pytest.fixture(scope="session")
def run_procedure():
    return run


@pytest.fixture(scope="session")
def shift_runs(tmp_path_factory):
    """The shipped eight-hour procedure, run whole on each shipped world."""
    runs = {}
    for world in ("ideal", "gyro_a", "gyro_b"):
        folder, outcome, _ = run("three_temperature_shift", tmp_path_factory.mktemp(world), world)
        runs[world] = (folder, outcome)
    return runs


@pytest.fixture(scope="session")
def short_run(tmp_path_factory):
    """The shipped ten-minute check in the world gyro_a."""
    return run("ten_minute_check", tmp_path_factory.mktemp("short"), "gyro_a")
