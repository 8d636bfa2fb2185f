"""Reading whole and partial run folders."""

import shutil
from dataclasses import replace

import pytest

from gyrobench.bench.bias.bins import BIAS_BINS_TABLE, bin_biases, compare_positions
from gyrobench.bench.bias.dwell_table import write_dwells
from gyrobench.bench.foundations.clock import VirtualClock
from gyrobench.bench.report.run_content import read_run
from gyrobench.bench.runs.folder import RunFolder
from gyrobench.bench.runs.journal import Journal


def test_whole_folder_is_read_without_complaint(run_folder, bins):
    content = read_run(run_folder)
    assert content.problems == ["station.yaml is missing."]
    assert content.name == content.run_name == "six_position_fig7-001"
    assert content.ending == "The run finished."
    assert len(content.dwells) == 72
    assert len(content.bins) == len(bins)
    assert content.procedure["assumptions"] == ["ramp rates are <chosen> here"]
    assert len(content.telemetry["time_s"]) > 2000
    assert content.last("run_ended")["ended"] == "finished"
    assert [each.count for each in content.step_durations] == [1] * 5
    assert (content.last_step["event"], content.last_step["step"]) == ("step_started", 6)
    assert content.last("no such event") == {}


def test_empty_folder_gives_empty_content(empty_folder):
    content = read_run(empty_folder)
    assert not content.journal
    assert not content.dwells
    assert not content.bins
    assert not content.has_readings
    assert len(content.problems) == 7


def test_a_folder_without_parts_has_no_readings(empty_folder):
    empty_folder.telemetry.mkdir()
    assert not read_run(empty_folder).has_readings


def test_bins_are_worked_out_where_their_file_is_missing(empty_folder, dwells):
    write_dwells(empty_folder.dwells, dwells)
    empty_folder.procedure.write_text("procedure: p\nbin_width_c: 10\n", encoding="utf-8")
    bins = read_run(empty_folder).bins
    assert {each.bin_high_c - each.bin_low_c for each in bins} == {10.0}
    assert sum(each.count for each in bins if each.gyro == "x") == 71


def test_bins_of_the_file_are_compared_with_a_constant_for_each_power_cycle(empty_folder, dwells):
    rows = [replace(row, run=row.position[:1]) for row in dwells if not row.flags]
    write_dwells(empty_folder.dwells, rows)
    BIAS_BINS_TABLE.write(empty_folder.bias_bins, bin_biases(rows))
    found = compare_positions(read_run(empty_folder).bins)
    expected = compare_positions(bin_biases(rows))
    assert [each.p_value for each in found] == pytest.approx([each.p_value for each in expected], rel=1e-3)
    assert all(high[0] == low[0] for each in found for high, low in [each.largest_pair])


def test_damaged_files_are_named_and_the_rest_is_read(empty_folder, journal_writer):
    journal_writer(empty_folder)
    lines = empty_folder.journal.read_text(encoding="utf-8").splitlines()
    empty_folder.journal.write_text("\n".join([*lines[:3], "{damaged", *lines[3:]]), encoding="utf-8")
    empty_folder.dwells.write_text("unit,run\n", encoding="utf-8")
    empty_folder.provenance.write_text("{", encoding="utf-8")
    empty_folder.procedure.write_text("bin_width_c: wide\n", encoding="utf-8")
    empty_folder.telemetry.mkdir()
    (empty_folder.telemetry / "part-00001.parquet").write_bytes(b"PAR1")
    content = read_run(empty_folder)
    assert [entry["event"] for entry in content.journal] == ["run_started", "ins_identified", "resolution"]
    said = "\n".join(content.problems)
    for name in (
        "journal.jsonl can't be used",
        "dwells.csv can't",
        "provenance.json can't",
        "telemetry can't",
    ):
        assert name in said
    assert "can't be binned by temperature" in said


def test_reading_a_run_does_not_read_its_raw_log(run_folder, tmp_path):
    folder = RunFolder(tmp_path / "run")
    shutil.copytree(run_folder.path, folder.path)
    (folder.can / "part-00001.blf").mkdir(parents=True)  # what can't be read
    assert read_run(folder).problems == read_run(run_folder).problems


def test_approvals_of_an_investigation_are_read_from_its_folder(empty_folder):
    assert read_run(empty_folder).approvals == []
    (empty_folder.path / "investigation").mkdir()
    with Journal(empty_folder.path / "investigation" / "journal.jsonl", VirtualClock()) as journal:
        journal.record("proposed", number=1)
        journal.record("approved", number=1, operator="A. Smith")
        journal.record("declined", number=2, operator="B. Jones")
    first, second = read_run(empty_folder).approvals
    assert first.startswith("Block 1 approved by A. Smith, 20")
    assert second.startswith("Block 2 declined by B. Jones, ")


def test_dwells_without_biases_need_no_table_of_dwells(empty_folder):
    with Journal(empty_folder.journal, VirtualClock()) as journal:
        journal.record("dwell_finished", marks={"dwell": 1, "is_rotated": True}, flags="")
        journal.record("dwell_finished", marks={"dwell": 1, "is_rotated": True}, flags="")
        journal.record("dwell_finished", marks={"dwell": 2, "is_noise_record": True}, flags="")
    content = read_run(empty_folder)
    assert content.dwell_purposes == {"rotations": 1, "noise": 1}
    assert "dwells.csv is missing." not in content.problems


def test_a_dwell_for_biases_needs_a_table_of_dwells(empty_folder):
    with Journal(empty_folder.journal, VirtualClock()) as journal:
        journal.record("dwell_finished", marks={"dwell": 1}, flags="")
        journal.record("dwell_finished", marks={"dwell": 2, "is_rotated": True}, flags="")
    content = read_run(empty_folder)
    assert content.dwell_purposes == {"calibration": 1, "rotations": 1}
    assert "dwells.csv is missing." in content.problems
