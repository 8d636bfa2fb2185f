"""The same engine in real time, the emulators in a process of their own behind real ports."""

import json
import subprocess
import sys

import pytest

from gyrobench.bench.bias.dwell_table import read_dwells
from gyrobench.bench.foundations.shipped import find_document
from gyrobench.bench.runs.journal import read_journal
from gyrobench.bench.runs.telemetry import read_telemetry

SERVE = "gyrobench.drivers.emulators.serve"


PROCEDURE = """procedure: two_minutes
steps:
  - power_on
  - go_to: {position: z_up, rate_dps: 30, settle_s: 0}
  - align: {duration_s: 42}
  - navigate: {duration_s: 61}
  - turn: {angle_deg: 180, rate_dps: 30, settle_s: 1}
  - navigate: {duration_s: 61}
"""


def station_of(urls):
    """The shipped station with the ports of a served bench."""
    text = find_document("stations", "emulated").read_text()
    for old, new in {
        "clock: virtual": "clock: wall",
        "poll_period_s: 1.0": "poll_period_s: 0.1",
        "instruments_period_s: 10.0": "instruments_period_s: 2.0",
        "emulator://table": urls["table"],
        "emulator://chamber": urls["chamber"],
        "interface: emulator": "interface: slcan",
        "channel: ins": f"channel: {urls['ins']}",
        "bitrate: 500000": "bitrate: 500000\n  options: {sleep_after_open: 0.1}",
    }.items():
        assert old in text
        text = text.replace(old, new)
    return text


@pytest.fixture
def served_station(tmp_path):
    command = [
        sys.executable,
        "-m",
        "gyrobench.drivers.emulators.serve",
        "--world",
        "ideal",
        "--for-s",
        "1000",
    ]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as server:
        path = tmp_path / "station.yaml"
        path.write_text(station_of(json.loads(server.stdout.readline())))
        yield path
        server.terminate()


@pytest.mark.long
@pytest.mark.wall_time
@pytest.mark.timeout(400)
def test_a_dwell_in_real_time_gives_the_bias_through_real_ports(run_procedure, served_station, tmp_path):
    procedure = tmp_path / "two_minutes.yaml"
    procedure.write_text(PROCEDURE)
    folder, outcome, _ = run_procedure(procedure, tmp_path / "run", station=served_station)
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
