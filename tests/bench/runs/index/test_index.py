"""The index follows the run folders, and can't be used for anything else."""

import json
import shutil
import time
from datetime import datetime
from functools import partial

import duckdb
import fsspec
import pytest

from gyrobench.bench.foundations.errors import DocumentError, RunFolderError
from gyrobench.bench.foundations.files import file_sha256
from gyrobench.bench.runs.index.run_index import IndexUpdate, RunIndex, Selection, find_runs
from gyrobench.bench.runs.index.store import open_store
from tests.bench.runs.index.sample_runs import copy_run, write_verdict
from tests.drivers.emulators.forked import ForkedProcess


@pytest.fixture
def runs(sample, tmp_path):
    """Two runs of unit 1001 and one of unit 1002, and the table of the units."""
    root = tmp_path / "runs"
    copy_run(sample, root / "a", "1001", "2026-01-05T08:00:00+00:00")
    copy_run(sample, root / "b", "1001", "2026-03-05T01:00:00+02:00")
    copy_run(sample, root / "deep" / "c", "1002", "2026-02-05T08:00:00+00:00")
    (root / "units.csv").write_text("unit,batch,hardware\n1001,B7,\n1002,B8,2\n")
    return root


def index_of(root):
    return RunIndex(open_store(str(root)))


@pytest.fixture
def index(runs):
    """Index of the runs, up to date."""
    index = index_of(runs)
    index.update()
    return index


def test_a_run_stands_in_the_index_as_its_folder_shows_it(runs, sample):
    index = index_of(runs)
    assert index.update() == IndexUpdate(read=3, removed=0, unchanged=0)
    newest = find_runs(index, Selection())[0]
    assert newest["path"] == "b"
    assert newest["started_utc"] == datetime(2026, 3, 4, 23)
    assert (newest["unit"], newest["batch"], newest["station"]) == ("1001", "B7", "quick")
    assert (newest["procedure"], newest["ended"], newest["dwells"]) == ("fleet_sample", "finished", 12)
    provenance = json.loads((sample / "provenance.json").read_text())
    assert newest["procedure_sha256"] == provenance["files_sha256"]["procedure.yaml"]
    assert newest["ins_identity"] == provenance["instruments"]["INS"] != ""
    assert newest["operator"] == provenance["operator"] != ""
    assert (newest["verdict"], newest["error_before_dph"]) == ("", None)
    dwell = index.query("SELECT * FROM dwells WHERE path = 'b' AND dwell = 3").records()[0]
    assert dwell["position"] == "y_down"
    assert 0.0 < dwell["sigma_x_dph"] < 0.01


def test_only_runs_whose_files_changed_are_read_again(index, runs, sample):
    unchanged = index.update()
    assert (unchanged, unchanged.text) == (IndexUpdate(read=0, removed=0, unchanged=3), "")
    write_verdict(copy_run(sample, runs / "d"), "explained", [("thermal_lag", 0.004)])
    with (runs / "a" / "journal.jsonl").open("a") as journal:
        journal.write(json.dumps({"time_s": 9000.0, "event": "run_resumed", "station": "quick"}) + "\n")
    shutil.rmtree(runs / "deep")
    changes = index.update()
    assert changes == IndexUpdate(read=2, removed=1, unchanged=1)
    assert changes.text == "2 of 3 runs read, 1 run removed"
    found = {run["path"]: (run["ended"], run["verdict"]) for run in find_runs(index, Selection())}
    assert found == {"a": ("not ended", ""), "b": ("finished", ""), "d": ("finished", "explained")}
    assert index.query("SELECT effect, rms_dph FROM effects").rows == [("thermal_lag", 0.004)]
    assert index.query("SELECT count(*) FROM dwells WHERE path LIKE 'deep%'").rows == [(0,)]


def test_the_batch_of_a_unit_follows_the_table_of_units(index, runs):
    (runs / "units.csv").write_text("unit,batch\n1002,B9\n")
    index.update()
    assert {run["unit"]: run["batch"] for run in find_runs(index, Selection())} == {"1001": "", "1002": "B9"}
    (runs / "units.csv").write_text("unit,batch\n1002,B9\n1002,B8\n")
    with pytest.raises(DocumentError, match="unit 1002 is also in line 2"):
        index.update()


DAMAGES = [
    ("journal.jsonl", b"no journal\n{}\n", "damaged entry"),
    ("provenance.json", b'{"gyrobench": "1"}', "started_utc: Field required"),
    ("provenance.json", b"[", "Invalid JSON"),
    ("dwells.csv", b"unit\n", "dwells.csv"),
    ("bias_bins.csv", b"\xff\xfe", "not UTF-8"),
    ("acceptance.json", b'{"verdict": 3}', "verdict: Input should be a valid string"),
    ("closure/closure.json", b'{"effects": 1}', "effects"),
]


def test_a_damaged_run_is_listed_with_the_reason_and_read_again_when_repaired(index, runs):
    """Each damage is repaired as another run gets the next one."""
    repair = list
    for number, (name, content, reason) in enumerate(DAMAGES):
        repair()
        damaged, sound = ("b", "a") if number % 2 else ("a", "b")
        file = runs / damaged / name
        whole = file.read_bytes() if file.exists() else None
        file.parent.mkdir(exist_ok=True)
        file.write_bytes(content)
        repair = file.unlink if whole is None else partial(file.write_bytes, whole)
        index.update()
        problems = index.problems()
        assert list(problems) == [damaged], name
        assert reason in problems[damaged]
        assert name.rpartition("/")[2] in problems[damaged]
        assert {run["path"] for run in find_runs(index, Selection())} == {sound, "deep/c"}
    repair()
    index.update()
    assert not index.problems()
    assert len(find_runs(index, Selection())) == 3


def test_a_folder_with_a_journal_alone_is_reported(runs):
    (runs / "a" / "provenance.json").unlink()
    index = index_of(runs)
    index.update()
    assert "has a journal but no provenance.json" in index.problems()["a"]


def test_an_object_store_is_indexed_like_a_folder(runs, tmp_path):
    memory = fsspec.filesystem("memory")
    memory.put(str(runs), "/bucket/runs", recursive=True)
    try:
        index = RunIndex(open_store("memory://bucket/runs"), tmp_path / "memory.duckdb")
        assert index.update().read == 3
        assert index.update() == IndexUpdate(read=0, removed=0, unchanged=3)
        assert [run["path"] for run in find_runs(index, Selection(batch="B8"))] == ["deep/c"]
    finally:
        memory.rm("/bucket", recursive=True)


def test_a_query_can_only_read_and_sees_the_index_alone(runs, tmp_path):
    (tmp_path / "secret.csv").write_text("a,b\n1,2\n")
    index = index_of(runs)
    index.update()
    for sql in (
        "DELETE FROM runs",
        "COPY runs TO '{folder}/out.csv'",
        "SELECT * FROM read_csv('{folder}/secret.csv')",
        "ATTACH '{folder}/other.duckdb' AS other",
        "SET enable_external_access = true",
        "SELECT nothing FROM runs",
    ):
        with pytest.raises(DocumentError, match="invalid query"):
            index.query(sql.format(folder=tmp_path))
    assert len(find_runs(index, Selection())) == 3
    assert sorted(path.name for path in tmp_path.iterdir()) == ["runs", "secret.csv"]


def test_an_index_is_rebuilt_from_the_folders_and_no_other_file_is_replaced(index, runs, tmp_path):
    index.path.unlink()
    assert index.update().read == 3
    assert index.update(rebuild=True).read == 3
    letter = tmp_path / "letter.txt"
    letter.write_text("Dear all")
    other = RunIndex(open_store(str(runs)), letter)
    for rebuild in (False, True):
        with pytest.raises(RunFolderError, match="not an index of runs"):
            other.update(rebuild=rebuild)
    assert letter.read_text() == "Dear all"


@pytest.mark.parametrize(
    "change",
    [
        "ALTER TABLE dwells DROP COLUMN case_c",
        "ALTER TABLE dwells ALTER case_c TYPE BIGINT",
        "ALTER TABLE runs ADD x INT",
        "DROP TABLE bins",
    ],
)
def test_an_index_with_other_columns_than_the_tables_is_rebuilt(index, change):
    assert index.update().read == 0
    with duckdb.connect(str(index.path)) as connection:
        connection.execute(change)
    assert index.update().read == 3
    assert index.query("SELECT case_c FROM dwells").columns == ["case_c"]


def test_a_damaged_index_is_rebuilt_at_once(index, runs):
    content = bytearray(index.path.read_bytes())
    content[12:200] = bytes(188)
    index.path.write_bytes(bytes(content[:5000]))
    assert index_of(runs).update().read == 3


def hold(path):
    """Hold an index open for writing until the process is ended."""
    with duckdb.connect(path):
        print("held", flush=True)
        time.sleep(600.0)


@pytest.mark.long
def test_an_index_that_another_process_writes_is_not_rebuilt_under_it(index, monkeypatch):
    monkeypatch.setattr("gyrobench.bench.runs.index.run_index._LOCK_TIMEOUT_S", 0.1)
    holder = ForkedProcess(hold, str(index.path))
    assert holder.stdout.readline() == "held\n"
    with pytest.raises(RunFolderError, match="another process is using this index"):
        index.update(rebuild=True)
    holder.kill()
    holder.wait()
    holder.close()
    assert index.update() == IndexUpdate(read=0, removed=0, unchanged=3)
    assert index.update(rebuild=True) == IndexUpdate(read=3, removed=0, unchanged=0)
    index.path.with_name(f"{index.path.name}.wal").write_bytes(b"of another file" * 100)
    assert index.update(rebuild=True) == IndexUpdate(read=3, removed=0, unchanged=0)


def test_one_query_is_answered_at_a_time(index):
    for sql, count in (("", 0), (";", 0), ("-- nothing", 0), ("SELECT 1; SELECT 2", 2)):
        with pytest.raises(DocumentError, match=f"{count} queries given"):
            index.query(sql)


def test_a_verdict_on_dwells_that_were_re_evaluated_is_stale(runs, sample):
    folder = copy_run(sample, runs / "d")
    write_verdict(folder, "clean", [("thermal_lag", 0.004)])
    findings = folder.closure / "findings.json"
    findings.write_text(json.dumps({"dwells_sha256": file_sha256(folder.dwells)}))
    index = index_of(runs)
    index.update()
    assert index.query("SELECT verdict FROM runs WHERE path = 'd'").rows == [("clean",)]
    findings.write_text(json.dumps({"dwells_sha256": "0" * 64}))
    index.update()
    assert index.query("SELECT verdict FROM runs WHERE path = 'd'").rows == [("stale",)]
    assert index.query("SELECT count(*) FROM effects").rows == [(0,)]


def test_runs_are_found_by_each_thing_that_can_be_asked(runs):
    (runs / "b" / "acceptance.json").write_text('{"verdict": "marginal"}')
    index = index_of(runs)
    index.update()
    sha256 = find_runs(index, Selection())[0]["procedure_sha256"]

    def found(**asked):
        return [run["path"] for run in find_runs(index, Selection(**asked))]

    assert found(unit="1001") == ["b", "a"]
    assert found(since=datetime(2026, 2, 5).date(), until=datetime(2026, 2, 5).date()) == ["deep/c"]
    assert found(until=datetime(2026, 2, 4).date()) == ["a"]
    assert found(verdict="marginal") == ["b"]
    assert len(found(procedure=sha256[:9], bench="quick", ended="finished")) == 3
    assert not found(procedure="other")
    assert not found(unit="' OR true --")


def test_a_place_without_runs_is_reported(tmp_path):
    with pytest.raises(RunFolderError, match="no such folder"):
        index_of(tmp_path / "nowhere").update()
    with pytest.raises(RunFolderError, match="can't be opened"):
        open_store("nothing://bucket")


def test_the_index_of_a_read_only_folder_is_in_the_users_cache(runs, tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setattr("os.access", lambda path, mode: str(path) != str(runs))
    index = index_of(runs)
    assert index.update().read == 3
    assert index.path.parent == tmp_path / "cache" / "gyrobench"
    assert not (runs / "index.duckdb").exists()


def test_an_index_that_cant_be_written_is_named_with_the_way_out(runs, monkeypatch):
    def full_disk(*_):
        raise duckdb.TransactionException("Failed to commit: No space left on device")

    monkeypatch.setattr("gyrobench.bench.runs.index.run_index._insert", full_disk)
    with pytest.raises(RunFolderError, match=r"index\.duckdb: can't be written: .*No space left.*--index"):
        index_of(runs).update()
