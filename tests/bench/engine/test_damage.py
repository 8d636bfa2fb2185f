"""Damaged files of an interrupted run: named before it resumes, and given up only on command."""

import shutil

import pytest

from gyrobench.bench.bias.dwell_table import read_dwells
from gyrobench.bench.dwells.run_dwells import finished_marks
from gyrobench.bench.engine.damage import find_damage
from gyrobench.bench.foundations.clock import VirtualClock
from gyrobench.bench.foundations.errors import RunFolderError
from gyrobench.bench.runs.folder import RunFolder
from gyrobench.bench.runs.journal import broken_links, read_journal
from gyrobench.bench.runs.telemetry import read_telemetry
from tests.bench.command_line import gyrobench
from tests.bench.engine.intervention import TWO_TEMPERATURES
from tests.bench.engine.test_resumption import broken_off, resumed

BOTH = ("resume", "run")


@pytest.fixture(scope="module")
def interrupted(tmp_path_factory):
    """A run of four dwells, killed in the third."""
    folder = tmp_path_factory.mktemp("damage")
    path = folder / "two_temperatures.yaml"
    path.write_text(TWO_TEMPERATURES)
    broken_off(path, folder / "run", "turn", 3)
    return folder / "run"


@pytest.fixture
def run(interrupted, tmp_path):
    shutil.copytree(interrupted, tmp_path / "run")
    return tmp_path / "run"


def log_part(run, dwell):
    (marks,) = [marks for marks in finished_marks(RunFolder(run)) if marks.dwell == dwell]
    return run / "can" / f"part-{marks.log_part:05d}.blf"


def damage_blf(run):
    path = log_part(run, 1)
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    return path.name


def damage_telemetry(run):
    path = sorted((run / "telemetry").iterdir())[0]
    path.write_bytes(path.read_bytes()[:-20])
    return path.name


def damage_provenance(run):
    (run / "provenance.json").write_text("{")
    return "provenance.json"


def damage_journal(run):
    """100 zero bytes over the end of the first dwell."""
    path = run / "journal.jsonl"
    content = bytearray(path.read_bytes())
    begin = content.index(b'"dwell_finished"')
    content[begin : begin + 100] = bytes(100)
    path.write_bytes(content)
    return "journal.jsonl"


@pytest.mark.parametrize(
    ("damages", "lost"),
    [
        ((damage_blf, damage_provenance), [1]),
        pytest.param((damage_journal, damage_telemetry), [1], marks=pytest.mark.long),
    ],
)
def test_damage_is_named_and_given_up_only_on_command(run, tmp_path, damages, lost):
    names = [damage(run) for damage in damages]
    before = {path: path.read_bytes() for path in run.rglob("*") if path.is_file()}
    look = gyrobench(*BOTH, "--look", cwd=tmp_path)
    assert look.returncode == 1
    assert all(name in look.stdout for name in names)
    assert "--give-up-damaged" in look.stdout
    assert ("Measured again" in look.stdout) == bool(lost)
    refused = gyrobench(*BOTH, cwd=tmp_path)
    assert refused.returncode == 1
    assert all(name in refused.stderr for name in names)
    assert {path: path.read_bytes() for path in before} == before
    done = gyrobench(*BOTH, "--give-up-damaged", "--view", "lines", cwd=tmp_path)
    assert done.returncode == 0, done.stderr + done.stdout
    rows = read_dwells(run / "dwells.csv")
    assert sorted(row.dwell for row in rows) == [1, 2, 3, 4]
    assert [row.start_s for row in rows] == sorted(row.start_s for row in rows)
    assert all(row.flags == () for row in rows)
    again = [row.dwell for row in rows if row.run.endswith("-1")]
    assert again == sorted({1, 2} - set(lost))
    entries = list(read_journal(run / "journal.jsonl"))
    (given_up,) = [entry for entry in entries if entry["event"] == "data_given_up"]
    assert given_up["dwells"] == lost
    assert all(list(run.rglob(f"{name}.damaged")) for name in names)
    assert len(read_telemetry(run / "telemetry")["time_s"])
    numbers = [entry["run"] for entry in entries if entry["event"] == "powered_on"]
    assert len(set(numbers)) == len(numbers)


def test_each_damaged_copy_is_kept(run):
    folder = RunFolder(run)
    for _ in range(2):
        damage_journal(run)
        find_damage(folder)[0].give_up(folder, VirtualClock)
    copies = sorted(run.glob("journal.jsonl.damaged*"))
    assert [path.name for path in copies] == ["journal.jsonl.damaged", "journal.jsonl.damaged-2"]
    given_up = [each for each in read_journal(folder.journal) if each["event"] == "data_given_up"]
    assert [each["lines"] for each in given_up] == [1, 1]


def test_damage_is_found_again_until_it_is_recorded(run):
    folder = RunFolder(run)
    damage_journal(run)
    (run / "journal.jsonl.whole").mkdir()
    damage, _ = find_damage(folder)
    with pytest.raises(RunFolderError):
        damage.give_up(folder, VirtualClock)
    assert find_damage(folder)[0] == damage


def test_an_entry_without_its_dwells_is_damage(run):
    folder = RunFolder(run)
    with folder.journal.open("a") as stream:
        stream.write('{"event": "data_given_up"}\n')
    with pytest.raises(RunFolderError, match="lacks its list of dwells"):
        finished_marks(folder)
    assert find_damage(folder)[0].lines == 1


def test_lost_dwells_at_two_temperatures_are_each_approached(run, tmp_path):
    resumed(run)
    for dwell in (1, 4):
        log_part(run, dwell).write_bytes(b"")
    look = gyrobench(*BOTH, "--look", cwd=tmp_path)
    assert "dwell 1 and 4" in look.stdout
    done = gyrobench(*BOTH, "--give-up-damaged", "--view", "lines", cwd=tmp_path)
    assert done.returncode == 0, done.stderr + done.stdout
    rows = {row.dwell: row for row in read_dwells(run / "dwells.csv")}
    assert sorted(rows) == [1, 2, 3, 4]
    assert rows[1].run == rows[4].run != rows[2].run
    assert rows[1].chamber_set_c == 35.0
    assert rows[4].chamber_set_c == 25.0

    # The same run, killed while its report was written: results and report come without the bench.
    journal = (run / "journal.jsonl").read_bytes()
    over = gyrobench(*BOTH, cwd=tmp_path)
    assert (over.returncode, "nothing to resume" in over.stdout) == (0, True)
    (run / "report.html").unlink()
    (run / "acceptance.json").unlink()
    look = gyrobench(*BOTH, "--look", cwd=tmp_path)
    assert "only the results and the report remain" in look.stdout
    finished = gyrobench(*BOTH, cwd=tmp_path)
    assert finished.returncode == 0, finished.stderr
    assert (run / "report.html").is_file()
    assert (run / "acceptance.json").is_file()
    assert (run / "journal.jsonl").read_bytes() == journal


def test_a_journal_that_lost_lines_names_the_links_that_are_broken(run, tmp_path):
    journal = run / "journal.jsonl"
    assert broken_links(journal.read_bytes().splitlines(keepends=True)) == []
    damage_journal(run)
    found, _ = find_damage(RunFolder(run))
    found.give_up(RunFolder(run), lambda: VirtualClock(1e6))
    (given_up,) = [entry for entry in read_journal(journal) if entry["event"] == "data_given_up"]
    assert given_up["broken_links"]
    assert broken_links(journal.read_bytes().splitlines(keepends=True)) == []
    lines = journal.read_bytes().split(b"\n")
    assert broken_links(b"\n".join([*lines[:2], *lines[3:]]).splitlines(keepends=True))[0] == 3
