"""A run folder after a power cut or a kill at any instant, and as another process sees it meanwhile."""

import os
import subprocess
import sys

import pytest

from gyrobench.bench.dwells.measurement_setup import measurement_setup
from gyrobench.bench.dwells.run_dwells import measure_recorded
from gyrobench.bench.dwells.run_results import recompute_run
from gyrobench.bench.foundations.errors import RunFolderError
from gyrobench.bench.runs.can_log import read_can_log
from gyrobench.bench.runs.folder import RunFolder, open_run_folder
from gyrobench.bench.runs.journal import Journal, read_journal
from gyrobench.bench.runs.provenance import read_provenance
from gyrobench.bench.runs.telemetry import read_telemetry
from gyrobench.bench.station.station import Station
from tests.bench.runs.disk import Disk, lay_out

pytestmark = pytest.mark.long

PROCEDURE = """procedure: two_dwells
steps:
  - power_on: {settle_s: 10}
  - go_to: {position: z_up}
  - align: {duration_s: 60}
  - navigate: {duration_s: 60}
  - turn: {angle_deg: 180}
  - navigate: {duration_s: 60}
  - go_to: {position: z_down}
  - align: {duration_s: 60}
  - navigate: {duration_s: 60}
  - turn: {angle_deg: 180}
  - navigate: {duration_s: 60}
"""
#: Reads a run folder over and over until its run has ended; prints how often.
READER = """
import sys
from pathlib import Path
from gyrobench.bench.foundations.errors import RunFolderError
from gyrobench.bench.runs.can_log import read_can_log
from gyrobench.bench.runs.folder import open_run_folder
from gyrobench.bench.runs.journal import read_journal
from gyrobench.bench.runs.provenance import read_provenance
from gyrobench.bench.runs.telemetry import read_telemetry

print("ready", flush=True)
rounds, ended = 0, False
while not ended:
    try:
        folder = open_run_folder(Path(sys.argv[1]))
    except RunFolderError:
        continue  # not begun yet
    ended = any(entry["event"] == "run_ended" for entry in read_journal(folder.journal))
    read_provenance(folder)
    read_telemetry(folder.telemetry)
    if any(folder.can.glob("*")):
        for _ in read_can_log(folder.can):
            pass
    rounds += 1
print(rounds)
"""


@pytest.fixture(scope="module")
def procedure(tmp_path_factory):
    path = tmp_path_factory.mktemp("procedure") / "two_dwells.yaml"
    path.write_text(PROCEDURE)
    return path


@pytest.fixture(scope="module")
def cut_run(procedure, run_procedure, tmp_path_factory):
    """A run with everything that a power cut or a kill could have left of it."""
    root = tmp_path_factory.mktemp("disk")
    disk = Disk(root)
    record = Journal.record
    missing = []

    def record_and_look(journal, event, **details):
        record(journal, event, **details)
        disk.fail_here()
        content = disk.synced().get("run/journal.jsonl", b"")
        if f'"event": "{event}"'.encode() not in content.splitlines()[-1]:
            missing.append(event)

    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(os, "fsync", disk.fsync)
        patched.setattr(Journal, "record", record_and_look)
        folder, outcome, _ = run_procedure(procedure, root / "run", "gyro_a")
    disk.close()
    assert outcome.ended == "finished", outcome.reason
    return folder, disk.states.values(), missing


def test_an_entry_of_the_journal_is_on_the_disk_when_it_has_been_recorded(cut_run):
    _, _, missing = cut_run
    assert missing == []


def finished(folder, what):
    entries = read_journal(folder.journal)
    return [entry["marks"][what] for entry in entries if entry["event"] == "dwell_finished"]


def measured(folder):
    dwells, _ = measure_recorded(folder, measurement_setup(Station(folder.station)))
    return {dwell.row.dwell: dwell.row for dwell in dwells}


def test_any_is_left_can_be_read_and_every_finished_dwell_is_measured_to_the_same_numbers(cut_run, tmp_path):
    whole, states, _ = cut_run
    expected = measured(whole)
    assert list(expected) == finished(whole, "dwell")
    assert len(expected) == 2
    seen, looked_at = set(), set()
    for number, state in enumerate(states):
        lay_out(state, tmp_path / str(number))
        path = tmp_path / str(number) / "run"
        try:
            folder = open_run_folder(path)
        except RunFolderError:
            assert "run/journal.jsonl" not in state
            continue
        dwells = finished(folder, "dwell")
        read_provenance(folder)
        read_telemetry(folder.telemetry)
        log = dict(read_can_log(folder.can)) if any(name.startswith("run/can/") for name in state) else {}
        key = tuple(len(log[part]) for part in finished(folder, "log_part"))
        if dwells and key not in looked_at:
            assert measured(folder) == {dwell: expected[dwell] for dwell in dwells}
        looked_at.add(key)
        seen.add(len(dwells))
    assert seen == {0, 1, 2}
    assert len(states) > 100


def test_a_run_can_be_read_by_another_process_at_any_instant(procedure, run_procedure, tmp_path):
    command = [sys.executable, "-c", READER, str(tmp_path / "run")]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as reader:
        assert reader.stdout.readline() == "ready\n"
        try:
            run_procedure(procedure, tmp_path / "run", "gyro_a")
            printed, problems = reader.communicate(timeout=60.0)
        finally:
            reader.kill()
    assert problems == ""
    assert int(printed) > 1


def test_a_run_that_was_killed_is_measured_again_as_far_as_it_is_finished(cut_run, tmp_path):
    _, states, _ = cut_run
    state = next(
        state for state in states if state.get("run/journal.jsonl", b"").count(b'"dwell_finished"') == 1
    )
    lay_out(state, tmp_path)
    folder = recompute_run(tmp_path / "run")
    assert folder == RunFolder(tmp_path / "run")
    assert folder.dwells.read_text().count("\n") == 2
