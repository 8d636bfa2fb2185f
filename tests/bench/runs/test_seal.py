"""Seals of a run folder: what was changed, by whom it was sealed, and what may be added."""

import json
import sys

import numpy as np
import pytest

from gyrobench.bench.foundations.clock import VirtualClock
from gyrobench.bench.foundations.errors import DocumentError, MissingRunError, RunFolderError
from gyrobench.bench.foundations.operator_name import OPERATOR_VARIABLE
from gyrobench.bench.runs.can_log import CanLog
from gyrobench.bench.runs.folder import RunFolder
from gyrobench.bench.runs.journal import Journal
from gyrobench.bench.runs.seal import (
    edited_tables,
    require_sealed_inputs,
    seal_run,
    update_seal,
    verify_seals,
)
from gyrobench.bench.runs.seal_keys import KEY_VARIABLE, new_key
from gyrobench.drivers.frames import FrameBlock
from tests.bench.command_line import gyrobench


@pytest.fixture(autouse=True)
def environment(monkeypatch):
    monkeypatch.delenv(KEY_VARIABLE, raising=False)
    monkeypatch.setenv(OPERATOR_VARIABLE, "A. Smith")
    monkeypatch.setattr(sys, "argv", ["/usr/bin/gyrobench", "run", "x"])


@pytest.fixture
def folder(tmp_path):
    """A run that has ended, with two parts of its CAN log, a table and a journal."""
    run = RunFolder(tmp_path / "run")
    run.path.mkdir()
    with Journal(run.journal, VirtualClock()) as journal:
        journal.record("run_started", procedure="six_position_fig7", station="emulated")
        for number in range(40):
            journal.record("step_finished", step=number)
        journal.record("run_ended", ended="finished", reason="", safe_state=[])
    log = CanLog(run.can)
    for _ in range(2):
        numbers = np.arange(3000)
        data = np.random.default_rng(1).integers(256, size=(3000, 8), dtype=np.uint8)
        log.write(FrameBlock.from_columns(9e8 + 0.02 * numbers, numbers % 8, 8, data))
        log.cut()
    rows = [f"{dwell},{0.01 * dwell:.4f},{0.001:.4f}" for dwell in range(60)]
    run.dwells.write_text("\n".join(["dwell,bias_x_dph,sigma_x_dph", *rows]) + "\n")
    (run.path / ".lock").write_text("")
    return run


@pytest.fixture
def key(tmp_path):
    pytest.importorskip("cryptography")
    new_key(tmp_path / "seal.pem")
    return tmp_path / "seal.pem"


def change_byte(path, at):
    content = bytearray(path.read_bytes())
    content[at] ^= 0x01
    path.write_bytes(content)


def test_the_first_byte_that_changed_is_named_in_log_journal_and_table(folder, key):
    seal_run(folder, key)
    assert verify_seals(folder.path).is_intact
    part = folder.can / "part-00002.blf"
    journal, table = folder.journal.read_bytes(), folder.dwells.read_bytes()
    line_17 = sum(len(line) + 1 for line in journal.split(b"\n")[:16])
    cell = table.index(b"0.3700")
    for path, at, where in (
        (part, 1000, ""),
        (folder.journal, line_17 + 5, ", in line 17 (event step_finished)"),
        (folder.dwells, cell + 3, ", in line 39, column bias_x_dph"),
    ):
        change_byte(path, at)
        (finding,) = verify_seals(folder.path).findings
        assert finding.path == path.relative_to(folder.path).as_posix()
        assert (finding.start, finding.end) == (at, at + 1)
        assert finding.text.startswith(f"byte {at} is 0x")
        assert finding.text.endswith(where)
        change_byte(path, at)
    assert verify_seals(folder.path).is_intact


def test_a_file_that_is_missing_and_a_part_that_was_added_are_found(folder):
    seal_run(folder)
    (folder.can / "part-00001.blf").unlink()
    (folder.can / "part-00003.blf").write_bytes(b"LOGG")
    (folder.path / "notes.txt").write_text("remark")
    check = verify_seals(folder.path)
    assert {finding.path: finding.text for finding in check.findings} == {
        "can/part-00001.blf": "is missing",
        "can/part-00003.blf": "was added after the last seal",
    }
    assert check.not_sealed == ["notes.txt"]


@pytest.mark.parametrize("how", ["link", "seals"])
def test_an_added_part_of_the_log_is_found_though_it_is_a_link_or_beside_a_folder_named_seals(
    folder, tmp_path, how
):
    seal_run(folder)
    added = folder.can / "part-00003.blf"
    if how == "link":
        other = tmp_path / "other.blf"
        other.write_bytes(b"other")
        added.symlink_to(other)
    else:
        (folder.can / "seals").mkdir()
        added.write_bytes(b"other")
    found = verify_seals(folder.path)
    assert [each.path for each in found.findings] == ["can/part-00003.blf"]


def test_what_is_added_later_is_in_a_further_seal_with_who_and_by_which_command(folder, key, monkeypatch):
    seal_run(folder, key)
    monkeypatch.setenv(OPERATOR_VARIABLE, "B. Jones")
    monkeypatch.setattr(sys, "argv", ["gyrobench", "close", "run"])
    folder.report.write_text("report")
    folder.closure.mkdir()
    (folder.closure / "closure.json").write_text("{}")
    seal_run(folder, key)
    assert seal_run(folder, key) is None
    first, second = verify_seals(folder.path, key.with_name("seal.pem.pub")).seals
    assert (first.operator, first.command) == ("A. Smith", "gyrobench run x")
    assert (second.operator, second.command) == ("B. Jones", "gyrobench close run")
    assert second.changes.added == ["closure/closure.json", "report.html"]
    assert second.key == first.key != ""
    change_byte(folder.dwells, 5)  # found with the fingerprint in the first seal
    assert [finding.start for finding in verify_seals(folder.path).findings] == [5]


def test_changed_data_are_sealed_only_on_record(folder):
    seal_run(folder)
    change_byte(folder.journal, 100)
    with pytest.raises(RunFolderError, match=r"journal\.jsonl changed since seal 1"):
        seal_run(folder)
    folder.dwells.write_text("edited")
    seal = seal_run(folder, accept_changes=True)
    assert seal.changes.evidence == ["journal.jsonl"]
    assert "dwells.csv" in seal.changes.replaced
    assert seal.journal_broken_links == [2]


def test_a_resumed_run_extends_its_journal(folder):
    seal_run(folder)
    with Journal(folder.journal, VirtualClock(9.0)) as journal:
        journal.record("run_resumed")
    seal = seal_run(folder)
    assert seal.changes.extended == ["journal.jsonl"]
    assert not seal.changes.evidence


def test_a_log_of_the_guard_may_grow_after_the_seal_and_not_change(folder):
    log = folder.path / "guard.log"
    log.write_text("guard 1: watches\n")
    seal_run(folder)
    log.write_text("guard 1: watches\nguard 1: the bench is in its safe state\n")
    check = verify_seals(folder.path)
    assert (check.is_intact, check.not_sealed) == (True, ["guard.log"])
    log.write_text("guard 1: watched\nguard 1: the bench is in its safe state\n")
    check = verify_seals(folder.path)
    assert ([finding.path for finding in check.findings], check.not_sealed) == (["guard.log"], [])
    log.write_text("guard 1: watches\nguard 1: the bench is in its safe state\n")
    assert seal_run(folder).changes.extended == ["guard.log"]


@pytest.mark.parametrize("what", ["seal", "signature", "chain"])
def test_a_changed_seal_is_found(folder, key, what):
    seal_run(folder, key)
    folder.report.write_text("report")
    seal_run(folder, key)
    path = folder.path / "seals" / "001.jsonl"
    text, signature, _ = path.read_text().split("\n")
    if what == "seal":
        text = text.replace("A. Smith", "C. Brown")
    elif what == "signature":
        record = json.loads(signature)
        changed = "A" if record["signature"][0] != "A" else "B"
        signature = json.dumps(record | {"signature": changed + record["signature"][1:]})
    path.write_text(f"{text}\n{signature}\n\n" if what == "chain" else f"{text}\n{signature}\n")
    findings = verify_seals(folder.path).findings
    assert findings[0].path == f"seals/00{2 if what == 'chain' else 1}.jsonl"
    assert {"seal": "hash", "signature": "signature", "chain": "does not follow"}[what] in findings[0].text


def test_a_seal_of_another_key_is_not_the_trusted_one(folder, key, tmp_path):
    seal_run(folder, key)
    other = new_key(tmp_path / "other.pem")
    assert verify_seals(folder.path, key.with_name("seal.pem.pub")).is_intact
    (finding,) = verify_seals(folder.path, other).findings
    assert finding.text == "is not signed by the trusted key"
    found = gyrobench("seal", folder.path, "--verify", "--key", other, cwd=tmp_path)
    assert "Invalid: seals/001.jsonl: is not signed by the trusted key" in found.stdout


def test_a_key_that_others_can_read_is_named(folder, key, caplog):
    seal_run(folder, key)
    assert caplog.text == ""
    key.chmod(0o640)
    (folder.path / "notes.txt").write_text("remark")
    seal_run(folder, key)
    assert f"{key}: other users can read this private key" in caplog.text
    assert f"chmod 600 {key}" in caplog.text


def test_a_key_that_cant_be_used_leaves_the_seal_unsigned_or_is_an_error(folder, tmp_path, monkeypatch):
    wrong = tmp_path / "wrong.pem"
    wrong.write_text("no key")
    with pytest.raises(DocumentError, match="is not a private key"):
        seal_run(folder, wrong)
    monkeypatch.setenv(KEY_VARIABLE, str(wrong))
    assert "is not a private key" in seal_run(folder).unsigned


def test_a_run_is_kept_sealed_once_it_has_ended_and_old_runs_stay_as_they_are(folder):
    whole = folder.journal.read_bytes()
    folder.journal.write_bytes(b"".join(whole.splitlines(keepends=True)[:-1]))
    update_seal(folder)
    assert not (folder.path / "seals").exists()
    folder.journal.write_bytes(b'{"event": "run_ended", "ended": "finished"}\n')
    update_seal(folder)
    assert not (folder.path / "seals").exists()
    folder.journal.write_bytes(whole)
    update_seal(folder)
    assert verify_seals(folder.path).is_intact


@pytest.mark.parametrize("changed", ["journal", "can"])
def test_a_run_whose_measured_data_changed_is_not_sealed_again(folder, changed):
    update_seal(folder)
    path = folder.journal if changed == "journal" else next(folder.can.iterdir())
    change_byte(path, 40)
    with pytest.raises(RunFolderError, match=f"{path.name} changed since seal 1"):
        update_seal(folder)
    assert not verify_seals(folder.path).is_intact


def test_an_edited_table_is_named_and_sealed_only_where_it_was_computed_again(folder):
    update_seal(folder)
    assert edited_tables(folder) == []
    folder.dwells.write_text(folder.dwells.read_text().replace("0.0200", "0.0500"))
    assert edited_tables(folder) == ["dwells.csv"]
    update_seal(folder)
    assert [finding.path for finding in verify_seals(folder.path).findings] == ["dwells.csv"]
    with pytest.raises(
        RunFolderError, match=r"dwells\.csv changed since seal 1\. .*tables by `gyrobench bins`"
    ):
        seal_run(folder)
    update_seal(folder, are_tables_new=True)
    assert edited_tables(folder) == []
    assert not verify_seals(folder.path).findings


def test_what_is_no_table_may_change_and_is_sealed(folder):
    """As the name of who prepares the report."""
    folder.provenance.write_text("{}")
    update_seal(folder)
    folder.provenance.write_text('{"prepared_by": "A. Smith"}')
    assert edited_tables(folder) == []
    update_seal(folder)
    assert not verify_seals(folder.path).findings


def test_a_table_of_a_run_that_was_resumed_since_its_seal_is_not_edited(folder):
    update_seal(folder)
    with Journal(folder.journal, VirtualClock()) as journal:
        journal.record("run_resumed")
    folder.dwells.write_text("dwell\n")
    assert edited_tables(folder) == []


def test_a_resumed_run_is_sealed_again_with_what_was_added(folder):
    update_seal(folder)
    log = CanLog(folder.can)
    log.write(FrameBlock.from_columns(9e8 + np.zeros(1), np.ones(1), 8, np.zeros((1, 8), np.uint8)))
    log.cut()
    with folder.journal.open("ab") as journal:
        journal.write(folder.journal.read_bytes().splitlines(keepends=True)[-1])
    update_seal(folder)
    assert verify_seals(folder.path).is_intact


def test_the_command_seals_verifies_and_names_the_change(folder, tmp_path):
    made = gyrobench("seal", folder.path, "--operator", "D. White", "--json", cwd=tmp_path)
    assert made.returncode == 0, made.stderr
    assert "D. White" in made.stderr
    assert json.loads(made.stdout)["seal"]["operator"] == "D. White"
    unchanged = gyrobench("seal", folder.path, "--json", cwd=tmp_path)
    assert json.loads(unchanged.stdout) == {"folder": str(folder.path), "seal": None}
    same = gyrobench("seal", folder.path, "--verify", cwd=tmp_path)
    assert same.returncode == 0, same.stderr
    assert "Unchanged: 4 files" in same.stdout
    change_byte(folder.dwells, 40)
    found = gyrobench("seal", folder.path, "--verify", "--json", cwd=tmp_path)
    assert found.returncode == 1
    assert "Changed: dwells.csv: byte 40 is" in found.stderr
    record = json.loads(found.stdout)
    assert (record["intact"], record["changes"][0]["start"]) == (False, 40)


def test_the_command_names_both_files_of_a_new_key_as_json(tmp_path):
    made = gyrobench("seal", "--new-key", "mine.pem", "--json", cwd=tmp_path)
    assert json.loads(made.stdout) == {"secret_key": "mine.pem", "public_key": "mine.pem.pub"}


def test_a_folder_that_does_not_exist_is_refused(tmp_path):
    with pytest.raises(MissingRunError, match="second-001: no such folder"):
        verify_seals(tmp_path / "second-001")


def test_a_folder_without_a_seal_is_refused(folder):
    with pytest.raises(MissingRunError, match="has no seal"):
        verify_seals(folder.path)


def test_units_are_sealed_and_verified_with_their_run(folder, key):
    unit = RunFolder(folder.units / "1103")
    unit.path.mkdir(parents=True)
    for name in ("journal.jsonl", "dwells.csv"):
        (unit.path / name).write_bytes((folder.path / name).read_bytes())
    seal_run(folder, key)
    check = verify_seals(folder.path, key.with_name(key.name + ".pub"))
    assert check.is_intact
    assert {"journal.jsonl", "units/1103/dwells.csv", "units/1103/seals/001.jsonl"} <= set(check.files)
    (unit.path / "figure.svg").write_text("x")
    assert verify_seals(folder.path).not_sealed == ["units/1103/figure.svg"]
    update_seal(unit)
    assert verify_seals(folder.path).not_sealed == []
    change_byte(unit.dwells, 100)
    (finding,) = verify_seals(folder.path).findings
    assert (finding.path, finding.start) == ("units/1103/dwells.csv", 100)
    change_byte(unit.dwells, 100)
    (unit.path / "seals" / "001.jsonl").unlink()
    assert "units/1103/seals/001.jsonl" in [each.path for each in verify_seals(folder.path).findings]


def test_an_input_that_changed_since_the_seal_is_named_before_a_run_resumes(folder):
    require_sealed_inputs(folder)  # not sealed
    folder.station.write_text("station: a\n")
    seal_run(folder)
    require_sealed_inputs(folder)
    folder.station.write_text("station: b\n")
    with pytest.raises(RunFolderError, match=r"station.yaml changed since seal 1.*--accept-changes"):
        require_sealed_inputs(folder)
    seal_run(folder, accept_changes=True)
    require_sealed_inputs(folder)
