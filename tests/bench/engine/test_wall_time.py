"""The same engine in real time, the emulators in a process of their own behind real ports."""

import pytest

from gyrobench.bench.bias.dwell_table import read_dwells
from gyrobench.bench.runs.journal import read_journal
from gyrobench.bench.runs.telemetry import read_telemetry
from tests.bench.engine.stations import served_station

PROCEDURE = """procedure: two_minutes
steps:
  - power_on
  - go_to: {position: z_up, rate_dps: 30, settle_s: 0}
  - align: {duration_s: 42}
  - navigate: {duration_s: 61}
  - turn: {angle_deg: 180, rate_dps: 30, settle_s: 1}
  - navigate: {duration_s: 61}
"""


@pytest.mark.long
@pytest.mark.wall_time
@pytest.mark.timeout(400)
def test_a_dwell_in_real_time_gives_the_bias_through_real_ports(run_procedure, tmp_path):
    procedure = tmp_path / "two_minutes.yaml"
    procedure.write_text(PROCEDURE)
    with served_station(tmp_path) as station:
        folder, outcome, _ = run_procedure(procedure, tmp_path / "run", station=station)
    assert outcome.ended == "finished", outcome.reason
    (row,) = read_dwells(folder.dwells)
    assert row.flags == ()
    assert row.unit == "1000"
    # One minute on each side: steps of 1e-4 m/s alone are worth some thousandths of a degree per hour.
    for measured, true in zip(row.bias_dph, (0.003, -0.002, 0.004), strict=True):
        assert measured == pytest.approx(true, abs=0.01)
    (finished,) = [entry for entry in read_journal(folder.journal) if entry["event"] == "dwell_finished"]
    assert finished["epochs"]["lost"] == 0
    assert len(read_telemetry(folder.telemetry)["time_s"]) > 60
