"""`gyrobench investigate` on the emulated bench: from a tie to a verified compensation."""

import json
import os
import random
import signal
import subprocess
import time

import pytest

from gyrobench.bench.foundations.shipped import find_document
from gyrobench.bench.runs.journal import read_journal
from tests.bench.command_line import PROCESS, output_of, refusal_of

COMMAND = (
    "investigate", "quick_campaign", "--station", "quick", "--world", "quick_warm_up", "--approve", "auto",
    "--verification", "quick_verification", "--out", "found", "--view", "lines", "--json",
)  # fmt: skip


TWO_CYCLES = """
procedure: two_cycles
bin_width_c: 5
steps:
  - power_on: {settle_s: 60}
  - repeat:
      over: {cycle: [1, 2], temperature_c: [60, 25, -20, 10]}
      steps:
        - chamber: {temperature_c: $temperature_c, ramp_c_per_min: 5.0, within_c: 50}
        - soak: {for_s: 480}
        - repeat:
            over: {position: [z_up, y_down, x_down, z_down]}
            steps:
              - go_to: {position: $position, rate_dps: 30}
              - align: {duration_s: 16}
              - navigate: {duration_s: 60}
              - turn: {angle_deg: 180, rate_dps: 30, settle_s: 1}
              - navigate: {duration_s: 60}
  - power_off
  - chamber_off
"""


@pytest.mark.long
def test_several_runs_of_one_unit_are_investigated_together(tmp_path):
    (tmp_path / "two_cycles.yaml").write_text(TWO_CYCLES)
    runs = ("first", "second")
    for seed, name in enumerate(runs, start=10):
        output_of(
            *("run", "two_cycles.yaml", "--station", "quick", "--world", "quick_warm_up"),
            *("--seed", str(seed), "--out", name, "--view", "lines"),
            cwd=tmp_path,
        )
    printed = output_of(
        *("investigate", *runs, "--approve", "auto", "--verification", "none", "--budget-h", "12"),
        *("--out", "found", "--view", "lines", "--json"),
        cwd=tmp_path,
    )
    found = json.loads(printed)
    assert found["ended"] == "settled"
    assert found["effects"]["warm_up"] >= 0.99
    assert len((tmp_path / "found" / "start.csv").read_text().splitlines()) == 1 + 2 * 32


def test_blocks_without_approval_need_a_station_that_allows_them(tmp_path):
    station = find_document("stations", "quick").read_text()
    (tmp_path / "careful.yaml").write_text(station.replace("block_approval: auto\n", ""))
    problem = refusal_of(
        "investigate", "ten_minute_check", "--station", "careful.yaml", "--approve", "auto", cwd=tmp_path
    )
    assert "block_approval: auto" in problem
    assert not (tmp_path / "runs").exists()


def test_a_table_needs_a_bench(tmp_path):
    (tmp_path / "dwells.csv").write_text("unit\n")
    assert "--bench" in refusal_of("investigate", "dwells.csv", cwd=tmp_path)


def decisions(folder):
    """Blocks with their predictions, as they were measured; of each number the last."""
    entries = list(read_journal(folder / "journal.jsonl"))
    found = {
        entry["number"]: (entry["block"], entry["predictions"])
        for entry in entries
        if entry["event"] == "proposed"
    }
    approved = [entry["number"] for entry in entries if entry["event"] == "approved"]
    assert len(approved) == len(set(approved))  # an approved block is never proposed again
    return found


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """Folder of an investigation in one go, and what it printed."""
    folder = tmp_path_factory.mktemp("whole")
    return folder / "found", json.loads(output_of(*COMMAND, cwd=folder))


@pytest.mark.long
def test_a_hidden_warm_up_is_found_confirmed_compensated_and_verified(whole):
    folder, found = whole
    entries = list(read_journal(folder / "journal.jsonl"))
    first = next(entry for entry in entries if entry["event"] == "searched")
    assert max(first["effects"].values()) < 0.99
    assert found["ended"] == "settled"
    assert found["effects"]["warm_up"] >= 0.99
    before, after = (
        row["varying_rms_dph"]
        for row in found["verification"]
        if row["stop"] == 0  # all plateaus
    )
    assert after < 0.9 * before
    page = (folder / "investigation.html").read_text()
    assert "Compensation, before and after" in page
    assert "agrees with the effect found" in page


def entries_in(folder):
    """Number of entries in the journals of an investigation and its runs."""
    return sum(path.read_bytes().count(b"\n") for path in folder.rglob("journal.jsonl"))


@pytest.mark.long
def test_killed_at_random_instants_it_ends_with_the_same_cause_and_repeats_no_decision(whole, tmp_path):
    draw, folder, last = random.Random(7), tmp_path / "found", entries_in(whole[0])  # noqa: S311
    for target in sorted(draw.sample(range(last // 10, last), 3)):
        process = subprocess.Popen(
            [*PROCESS, *COMMAND], cwd=tmp_path, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )
        while process.poll() is None and entries_in(folder) < target:
            time.sleep(0.05)
        os.kill(process.pid, signal.SIGKILL)
        assert process.wait() == -signal.SIGKILL
    before = decisions(folder)
    measured = {number for number in before if (folder / f"block-{number}" / "plan.json").exists()}
    found = json.loads(output_of(*COMMAND, cwd=tmp_path))
    after = decisions(folder)
    assert {number: after[number] for number in measured} == {number: before[number] for number in measured}
    assert found["ended"] == "settled"
    assert found["effects"]["warm_up"] >= 0.99
    assert found["verification"]
