"""`gyrobench control`, its old name, and help with names."""

import json
import os
import subprocess
import sys

import pytest

from gyrobench import __version__
from gyrobench.bench.cli.output import EXIT_INSTRUMENT, EXIT_NOT_FINISHED
from gyrobench.bench.engine import operator
from gyrobench.bench.engine.operator import RunCommand, take_sender
from gyrobench.bench.foundations.clock import VirtualClock, WallClock
from gyrobench.bench.foundations.errors import RunFolderError
from tests.bench.command_line import gyrobench, output_of, refusal_of

#: Holds a run folder as a run does, records each command with the text in the file `refused`, and prints the
#: signal.
HOLDER = """
import signal, sys, time
from pathlib import Path
from gyrobench.bench.foundations.clock import WallClock
from gyrobench.bench.runs.journal import Journal
from gyrobench.bench.runs.locks import RunLock
signals = []
signal.signal(signal.SIGUSR1, lambda number, frame: signals.append(signal.Signals(number).name))
run = Path(sys.argv[1])
with RunLock(run, WallClock()), Journal(run / "journal.jsonl", WallClock()) as journal:
    print("held", flush=True)
    while True:
        while not signals:
            time.sleep(0.01)
        refused = run / "refused"
        journal.record("ordered", order="hold", refused=refused.read_text() if refused.exists() else "")
        print(signals.pop(), flush=True)
"""


@pytest.fixture(scope="module")
def run_in_progress(tmp_path_factory):
    run = tmp_path_factory.mktemp("run")
    with subprocess.Popen([sys.executable, "-c", HOLDER, run], stdout=subprocess.PIPE, text=True) as holder:
        assert holder.stdout.readline() == "held\n"
        yield run, holder
        holder.kill()


def test_a_command_is_sent_to_the_process_of_the_run(run_in_progress):
    run, holder = run_in_progress
    printed = output_of("control", run, "hold", cwd=run.parent)
    assert f"Sent to process {holder.pid}: hold" in printed
    assert holder.stdout.readline() == "SIGUSR1\n"


def test_a_command_that_the_run_does_not_accept_is_an_error_with_its_reason(run_in_progress):
    run, holder = run_in_progress
    reason = run / "refused"
    reason.write_text("the run holds: it accepts continue or abort, not hold")
    try:
        done = gyrobench("control", run, "hold", cwd=run.parent)
    finally:
        reason.unlink()
    assert holder.stdout.readline() == "SIGUSR1\n"
    assert done.returncode == EXIT_NOT_FINISHED
    assert "hold was not accepted: the run holds: it accepts continue or abort" in done.stderr


@pytest.mark.parametrize("name", ["finish", "skip"])
def test_a_command_whose_signal_would_end_the_process_is_not_sent(run_in_progress, name):
    run, holder = run_in_progress
    refusal = refusal_of("control", run, name, cwd=run.parent, code=EXIT_NOT_FINISHED)
    assert f"process {holder.pid} does not know {name}" in " ".join(refusal.split())
    assert holder.poll() is None


def test_a_command_is_sent_without_its_sender_where_the_disk_is_full(run_in_progress, monkeypatch):
    run, holder = run_in_progress

    def fail(path, data):
        raise RunFolderError(f"{path}: can't be written: No space left on device")

    monkeypatch.setattr(operator, "write_whole", fail)
    assert (
        operator.send_command(run, RunCommand.HOLD, holder.pid, "").refusal(WallClock(), lambda: True) == ""
    )
    assert holder.stdout.readline() == "SIGUSR1\n"


def test_a_run_that_ended_meanwhile_did_not_accept_the_command(tmp_path):
    assert (
        operator.PendingReply(tmp_path, RunCommand.SKIP, 0).refusal(VirtualClock(), lambda: False)
        == "the run has ended"
    )


def test_a_run_that_does_not_react_did_not_accept_the_command(tmp_path):
    refusal = operator.PendingReply(tmp_path, RunCommand.ABORT, 0).refusal(VirtualClock(), lambda: True)
    assert refusal.startswith("the run has not reacted within 30 s")


def test_a_hold_of_a_run_on_virtual_time_is_stated_to_end_at_once(run_in_progress):
    run, holder = run_in_progress
    provenance = run / "provenance.json"
    for clock, is_stated in (("virtual", True), ("wall", False)):
        provenance.write_text(json.dumps({"options": {"clock": clock}}))
        done = gyrobench("control", run, "hold", cwd=run.parent)
        assert ("waits for no operator: it continues at once" in done.stdout) is is_stated
        assert holder.stdout.readline() == "SIGUSR1\n"
    provenance.unlink()


@pytest.mark.parametrize("options", [[], ["--look"]])
def test_resume_of_a_run_in_progress_says_that_it_is_in_progress(run_in_progress, options):
    run, holder = run_in_progress
    done = gyrobench("resume", run, *options, cwd=run.parent)
    assert done.returncode == EXIT_INSTRUMENT
    assert done.stdout == ""
    assert f"the run folder {run} is in use by run {run} (process {holder.pid} of " in done.stderr
    assert "That run is still in progress" in done.stderr


def test_the_sender_of_a_command_is_known_to_the_run_that_it_was_sent_to_only(run_in_progress, monkeypatch):
    run, holder = run_in_progress
    assert gyrobench("control", run, "hold", "--operator", "A. Smith", cwd=run.parent).returncode == 0
    assert holder.stdout.readline() == "SIGUSR1\n"
    assert take_sender(run, RunCommand.SKIP) == ""
    monkeypatch.setattr("os.getpid", lambda: holder.pid)
    assert take_sender(run, RunCommand.HOLD) == "A. Smith"
    assert take_sender(run, RunCommand.HOLD) == ""


def test_the_old_name_works_and_names_its_replacement(run_in_progress):
    run, holder = run_in_progress
    done = gyrobench("tell", run, "hold", cwd=run.parent)
    assert done.returncode == 0, done.stderr
    assert done.stderr == "'gyrobench tell' is an old name. Use 'gyrobench control'.\n"
    assert holder.stdout.readline() == "SIGUSR1\n"
    assert "tell" not in gyrobench("--help", cwd=run.parent).stdout


def test_a_folder_without_a_run_in_progress_is_an_error(tmp_path):
    problem = refusal_of("control", tmp_path, "pause", cwd=tmp_path, code=EXIT_NOT_FINISHED)
    assert problem.endswith("no run is in progress there on this machine\n")
    (tmp_path / "journal.jsonl").touch()
    done = gyrobench("control", tmp_path, "pause", cwd=tmp_path)
    assert f"`gyrobench resume {tmp_path} --look` shows what is left of it" in done.stderr


@pytest.mark.parametrize("pid", [1, -1, 0, "own"])
def test_a_process_that_does_not_hold_the_run_gets_no_signal(run_in_progress, pid, monkeypatch):
    run, _ = run_in_progress
    lock = run / ".lock"
    assert lock.stat().st_mode & 0o777 == 0o644
    true = lock.read_text()
    lock.write_text(json.dumps(json.loads(true) | {"pid": os.getpid() if pid == "own" else pid}))
    with monkeypatch.context() as patch:
        patch.setattr("os.kill", lambda *_: pytest.fail("a signal was sent"))
        done = gyrobench("control", run, "hold", cwd=run.parent)
    lock.write_text(true)
    assert done.returncode == EXIT_NOT_FINISHED
    assert "does not hold it" in done.stderr


def test_the_version_is_printed(tmp_path):
    assert gyrobench("--version", cwd=tmp_path).stdout == f"gyrobench {__version__}\n"
    assert "--no-version" not in gyrobench("--help", cwd=tmp_path).stdout


@pytest.mark.parametrize(
    ("mistyped", "suggestion"),
    [(("pln",), "Did you mean 'plan'?"), (("plan", "x", "--figur", "a.png"), "--figure")],
)
def test_a_mistyped_command_or_option_gets_a_suggestion(tmp_path, mistyped, suggestion):
    assert suggestion in refusal_of(*mistyped, cwd=tmp_path)
