import pytest

from gyrobench.bench.engine.job import prepare_job
from gyrobench.bench.engine.observers import RunObserver
from gyrobench.bench.engine.operator import ConsentingOperator
from gyrobench.bench.engine.run import run_job
from gyrobench.bench.exchange.can_export import TimedLog
from gyrobench.bench.runs.folder import RunFolder
from gyrobench.bench.station.instruments import Emulation
from gyrobench.bench.station.station import Station
from tests.bench.exchange.sample_log import SampleLog


@pytest.fixture
def log(tmp_path):
    return SampleLog(tmp_path)


#: Two dwells, short, with a unit that has effects.
PROCEDURE = """
procedure: two_dwells
bin_width_c: 5
steps:
  - power_on: {settle_s: 20}
  - repeat:
      over: {position: [z_up, x_up]}
      steps:
        - go_to: {position: $position}
        - align: {duration_s: 60}
        - navigate: {duration_s: 60}
        - turn: {angle_deg: 180}
        - navigate: {duration_s: 60}
"""


@pytest.fixture(scope="session")
def two_dwells(tmp_path_factory):
    """A finished run of two dwells; not to be written to."""
    folder = tmp_path_factory.mktemp("two_dwells")
    (folder / "two_dwells.yaml").write_text(PROCEDURE)
    job = prepare_job(str(folder / "two_dwells.yaml"), "emulated", Emulation("gyro_a", 3))
    run, outcome = run_job(job, folder / "run", RunObserver(), ConsentingOperator())
    assert outcome.ended == "finished"
    return RunFolder(run.path)


@pytest.fixture(scope="session")
def messages(two_dwells):
    """Every frame of that run, with calendar time."""
    return [message for _, frames in TimedLog(two_dwells) for message in frames.messages()]


@pytest.fixture(scope="session")
def dbc(two_dwells):
    """Its DBC file."""
    return Station(two_dwells.station).dbc_path
