"""What resuming reports of a bench whose engine and guard are both gone."""

import re
from datetime import UTC, datetime

import pytest

from gyrobench.bench.engine.resume import prepare_resumption
from gyrobench.bench.foundations.clock import WallClock
from gyrobench.bench.runs.folder import RunFolder
from gyrobench.bench.runs.journal import Journal
from gyrobench.bench.runs.provenance import write_provenance
from gyrobench.bench.station.bench_lock import BenchLock
from gyrobench.bench.station.instruments import Outputs
from gyrobench.bench.station.safe_state import make_safe

pytestmark = pytest.mark.wall_time

OPTIONS = {"world": "quick", "seed": 0, "faults": ""}


@pytest.fixture
def begun(served, tmp_path):
    """Folder of a run that began on the served bench and has no end."""
    folder = RunFolder(tmp_path / "run")
    folder.path.mkdir()
    folder.procedure.write_text(
        "procedure: hot\nsteps:\n  - chamber: {temperature_c: 60, ramp_c_per_min: 2}\n"
    )
    folder.station.write_bytes(served.station.path.read_bytes())
    dbc = served.station.dbc_path
    (folder.path / dbc.name).write_bytes(dbc.read_bytes())
    write_provenance(folder, datetime.now(UTC), {}, OPTIONS)
    with Journal(folder.journal, WallClock()) as journal:
        journal.record("run_started", procedure="hot", options=OPTIONS)
    return folder


def test_a_bench_that_was_not_made_safe_is_reported_with_what_it_reads_now(served, begun):
    served.disturb()
    found = prepare_resumption(begun.path).describe_bench()
    assert found.startswith(
        "The bench was NOT made safe at the end (safe state: neither the run nor its guard"
    )
    assert "inner" in found
    assert "at 10.000 deg/s; servos on" in found
    assert "set point 60.0 degC" in found
    with BenchLock(served.station, begun.path, WallClock()):
        found = prepare_resumption(begun.path).describe_bench()
        # Pseudo-terminals have other numbers each time, and with them the order of their locks.
        assert re.search(r"\nNot read: the (rate table|chamber|INS)'s port .+ is in use by run ", found)


def test_what_the_guard_did_not_finish_is_named_until_it_has(served, begun):
    with Outputs(served.station, WallClock()) as outputs:
        done = make_safe(served.station, outputs)
    failed = [{"what": action.what, "problem": "no reply"} for action in done[:1]]
    with Journal(begun.journal, WallClock()) as journal:
        rest = [{"what": action.what, "problem": ""} for action in done[1:]]
        journal.record("guard_acted", reason="died", safe_state=[*failed, *rest])
        assert "(rate table stopped: no reply)" in prepare_resumption(begun.path).describe_bench()
        journal.record("guard_acted", reason="died", safe_state=[{"what": done[0].what, "problem": ""}])
    assert prepare_resumption(begun.path).describe_bench() == ""
    assert "The bench was brought to its safe state." in prepare_resumption(begun.path).describe()
