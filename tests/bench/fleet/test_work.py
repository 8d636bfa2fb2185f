"""Many runs on real workers: what goes wrong with one stays with it."""

import os
import signal

import psutil
import pytest

import gyrobench.bench.fleet.jobs
from gyrobench.bench.fleet.jobs import FleetRecord, JobKind, JobState, do_job, read_record
from gyrobench.bench.fleet.workers import Workers, connect_workers, work_through
from gyrobench.bench.foundations.errors import GyrobenchError
from tests.bench.runs.index.sample_runs import copy_run

pytestmark = pytest.mark.long


def do_or_die(kind, path, **options):
    """End a worker as the kernel ends one that takes all memory, when it opens a run of that name."""
    if path.endswith("deadly"):
        os.kill(os.getpid(), signal.SIGKILL)
    return do_job(kind, path, **options)


@pytest.fixture
def runs(sample, tmp_path):
    return [copy_run(sample, tmp_path / name).path for name in ("a", "deadly", "c")]


def test_a_run_that_kills_its_worker_fails_and_the_others_are_done(runs, tmp_path, monkeypatch):
    monkeypatch.setattr("gyrobench.bench.fleet.workers.do_job", do_or_die)
    record = FleetRecord(JobKind.BINS, tmp_path / "record")
    (runs[2] / "station.yaml").write_text("station: [")
    with connect_workers(Workers(count=1)) as client:
        results = {result.path: result for result in work_through(client, record, runs)}
    assert [results[str(path)].state for path in runs] == [JobState.DONE, JobState.FAILED, JobState.FAILED]
    assert "its worker was killed" in results[str(runs[1])].text
    assert "station.yaml" in results[str(runs[2])].text
    assert read_record(JobKind.BINS, tmp_path / "record").pending(runs) == runs[1:]


def test_local_workers_open_no_port_and_import_nothing_from_the_current_folder(runs, tmp_path, monkeypatch):
    for name in ("struct", "pickle", "_compat_pickle"):
        (tmp_path / f"{name}.py").write_text(f"open({str(tmp_path / 'trapped')!r}, 'w')\n")
    monkeypatch.chdir(tmp_path)
    record = FleetRecord(JobKind.BINS, tmp_path / "record")
    with connect_workers(Workers(count=1)) as pool:
        (result,) = work_through(pool, record, runs[:1])
        family = [psutil.Process(), *psutil.Process().children(recursive=True)]
        assert len(family) > 1
        assert not [
            each for process in family for each in process.net_connections() if each.status == "LISTEN"
        ]
    assert result.state == JobState.DONE
    assert not (tmp_path / "trapped").exists()


def test_threads_do_the_same_and_a_bug_is_a_failure_of_its_run(runs, tmp_path, monkeypatch):
    def broken(folder):
        if folder.path.name == "deadly":
            raise ZeroDivisionError("a bug")
        return "done"

    monkeypatch.setattr(gyrobench.bench.fleet.jobs, "_PROCESSORS", {JobKind.REPORT: broken})
    record = FleetRecord(JobKind.REPORT, tmp_path / "record")
    with connect_workers(Workers(count=2, are_threads=True)) as client:
        results = {result.path: result for result in work_through(client, record, runs)}
    assert results[str(runs[1])].text == "ZeroDivisionError: a bug"
    assert sum(result.state == JobState.DONE for result in results.values()) == 2


def test_what_was_done_is_on_record_when_the_rest_is_given_up(runs, tmp_path):
    record = FleetRecord(JobKind.REPORT, tmp_path / "record")
    with connect_workers(Workers(count=1, are_threads=True)) as client:
        work = work_through(client, record, runs)
        next(work)
        work.close()
    assert len(read_record(JobKind.REPORT, tmp_path / "record").pending(runs)) == 2


def test_an_external_scheduler_is_used_and_stays(runs, tmp_path):
    from distributed import LocalCluster

    record = FleetRecord(JobKind.REPORT, tmp_path / "record")
    with LocalCluster(
        n_workers=1, processes=False, protocol="tcp", dashboard_address="127.0.0.1:0"
    ) as cluster:
        with connect_workers(Workers(scheduler=cluster.scheduler_address)) as client:
            (result,) = work_through(client, record, runs[:1])
        assert result.state == JobState.DONE
        assert len(cluster.scheduler_info["workers"]) == 1


def test_an_address_without_scheduler_is_reported(monkeypatch):
    monkeypatch.setattr("gyrobench.bench.fleet.workers._SCHEDULER_TIMEOUT_S", 0.5)
    with (
        pytest.raises(GyrobenchError, match="no Dask scheduler answers"),
        connect_workers(Workers(scheduler="tcp://127.0.0.1:9")),
    ):
        pass
