"""A killed run resumes: what is finished stays, the interrupted dwell is repeated."""

import os
import shutil
import signal
import sys
from dataclasses import replace

import pytest
import typer
from typer.testing import CliRunner

from gyrobench.bench.bias.dwell_table import read_dwells, write_dwells
from gyrobench.bench.cli import main
from gyrobench.bench.cli.resume import resume
from gyrobench.bench.engine.job import prepare_job
from gyrobench.bench.engine.observers import RunObserver
from gyrobench.bench.engine.operator import ConsentingOperator, RunCommand, send_command
from gyrobench.bench.engine.resume import MAX_RESUMES_WITHOUT_PROGRESS, prepare_resumption
from gyrobench.bench.engine.run import resume_run, run_job
from gyrobench.bench.foundations.clock import VirtualClock
from gyrobench.bench.foundations.errors import (
    BenchInUseError,
    ConnectionFailedError,
    DocumentError,
    RunFinishedError,
    RunFolderError,
)
from gyrobench.bench.report.run_report import write_report
from gyrobench.bench.runs.folder import open_run_folder
from gyrobench.bench.runs.journal import Journal, facts_of, read_journal
from gyrobench.bench.runs.locks import RunLock
from gyrobench.bench.runs.provenance import read_provenance
from gyrobench.bench.runs.seal import verify_seals
from gyrobench.bench.station.instruments import CHAMBER, RATE_TABLE, Emulation
from gyrobench.drivers.chamber.watlow_f4 import WatlowF4
from gyrobench.drivers.ins.can_ins import CanIns
from gyrobench.drivers.rate_table.acutrol3000 import Acutrol3000
from tests.bench.engine.intervention import TWO_TEMPERATURES, KilledError, RefusingOperator
from tests.drivers.emulators.forked import ForkedProcess


class Watcher(RunObserver):
    """Ends the run in the nth step of a kind by an exception that nothing catches."""

    def __init__(self, kind="", nth=1):
        self.kind, self.left, self.notes = kind, nth, []

    def noted(self, text):
        self.notes.append(text)

    def step_started(self, planned, bench):
        if planned.step.name == self.kind:
            self.left -= 1

    def ticked(self, bench, left_s):
        if self.kind and self.left == 0:
            self.left = -1
            raise KilledError


@pytest.fixture(scope="module")
def procedure(tmp_path_factory):
    path = tmp_path_factory.mktemp("procedure") / "two_temperatures.yaml"
    path.write_text(TWO_TEMPERATURES)
    return path


@pytest.fixture(scope="module")
def finished_run(procedure, tmp_path_factory):
    """A run without interruption, with its seal."""
    path = tmp_path_factory.mktemp("undisturbed") / "run"
    job = prepare_job(str(procedure), "quick", Emulation("quick", 0))
    folder, outcome = run_job(job, path, Watcher(), ConsentingOperator())
    assert outcome.ended == "finished"
    write_report(folder)
    return path


@pytest.fixture(scope="module")
def undisturbed(finished_run):
    return read_dwells(finished_run / "dwells.csv")


@pytest.fixture
def finished(finished_run, tmp_path):
    """A copy of it that a test may resume."""
    return shutil.copytree(finished_run, tmp_path / "finished")


def broken_off(procedure, path, kind, nth=1):
    job = prepare_job(str(procedure), "quick", Emulation("quick", 0))
    with pytest.raises(KilledError):
        run_job(job, path, Watcher(kind, nth), ConsentingOperator())
    return path


@pytest.fixture(scope="module")
def broken(procedure, tmp_path_factory):
    """A run that was killed in the turn of its third dwell."""
    return broken_off(procedure, tmp_path_factory.mktemp("broken") / "run", "turn", 3)


@pytest.fixture
def in_third_dwell(broken, tmp_path):
    """A copy of it that a test may resume."""
    return shutil.copytree(broken, tmp_path / "run")


def resumed(path, repeat=()):
    watcher = Watcher()
    folder, outcome = resume_run(prepare_resumption(path, repeat=repeat), watcher, ConsentingOperator())
    assert outcome.ended == "finished", outcome.reason
    return folder, outcome, watcher


def assert_agree(rows, others):
    assert [(row.dwell, row.position) for row in rows] == [(row.dwell, row.position) for row in others]
    for row, other in zip(rows, others, strict=True):
        assert row.flags == ()
        for bias, sigma, bias_2, sigma_2 in zip(
            row.bias_dph, row.sigma_dph, other.bias_dph, other.sigma_dph, strict=True
        ):
            # Each power-on has biases a little different, beside the noise of both.
            assert abs(bias - bias_2) < 4.5 * (sigma**2 + sigma_2**2 + 2e-6) ** 0.5


def run_until_killed(*arguments):
    """Run the command line in a process that is killed when the first dwell has finished."""
    record = Journal.record

    def record_and_die(self, event, **details):
        record(self, event, **details)
        if event == "dwell_finished":
            os.kill(os.getpid(), signal.SIGKILL)

    Journal.record = record_and_die
    sys.argv = ["gyrobench", *arguments]
    main()


def test_a_killed_run_is_resumed_by_another_process(procedure, undisturbed, tmp_path):
    path = tmp_path / "run"
    options = ("--station", "quick", "--world", "quick", "--out", str(path))
    killed = ForkedProcess(run_until_killed, "run", str(procedure), *options)
    killed.wait()
    assert killed.returncode == -signal.SIGKILL
    killed.close()
    before = [entry for entry in read_journal(path / "journal.jsonl") if entry["event"] == "dwell_finished"]
    assert len(before) == 1
    folder, _, _ = resumed(path)
    rows = read_dwells(folder.dwells)
    assert_agree(rows, undisturbed)
    assert rows[0].run.endswith("-1")
    assert rows[-1].run.endswith("-2")


@pytest.mark.parametrize(
    ("kind", "nth"),
    [
        ("soak", 1),
        ("turn", 4),
        *(
            pytest.param(*each, marks=pytest.mark.long)
            for each in (("align", 3), ("power_on", 1), ("chamber", 2), ("go_to", 2))
        ),
    ],
)
def test_a_run_resumes_from_any_kind_of_step(procedure, undisturbed, tmp_path, kind, nth):
    folder, _, _ = resumed(broken_off(procedure, tmp_path / "run", kind, nth))
    assert_agree(read_dwells(folder.dwells), undisturbed)


def test_a_run_interrupted_during_its_approach_resumes_as_well(undisturbed, in_third_dwell):
    path = in_third_dwell
    with pytest.raises(KilledError):
        resume_run(prepare_resumption(path), Watcher("soak"), ConsentingOperator())
    folder, _, _ = resumed(path)
    assert_agree(read_dwells(folder.dwells), undisturbed)


def test_times_and_counts_of_power_ons_continue_and_the_approach_is_noted_as_it_begins(in_third_dwell):
    path = in_third_dwell
    _, _, watcher = resumed(path)
    (way,) = [text for text in watcher.notes if text.startswith("returning to step")]
    assert "power on" in way
    assert "chamber to 25 degC" in way
    assert "soak 30 s" in way
    assert "go to z_up" in way
    entries = list(read_journal(path / "journal.jsonl"))
    times_s = [entry["time_s"] for entry in entries]
    assert times_s == sorted(times_s)
    assert [entry["run"] for entry in entries if entry["event"] == "powered_on"] == [1, 2]
    rows = read_dwells(path / "dwells.csv")
    assert [row.start_s for row in rows] == sorted(row.start_s for row in rows)


def test_it_describes_what_it_found_and_what_it_will_do(broken):
    words = prepare_resumption(broken).describe()
    assert "2 of 4 dwells are finished and kept" in words
    assert "dwell 3 (25 degC, z_up) from its start" in words
    assert "unit 1003" in words


def test_an_ins_that_is_always_on_is_not_said_to_be_switched(broken, in_third_dwell):
    assert (
        "Before that the INS is switched off and on, and temperature" in prepare_resumption(broken).describe()
    )
    station = in_third_dwell / "station.yaml"
    station.write_text(station.read_text().replace("power: chamber_event", "power: always_on"))
    words = prepare_resumption(in_third_dwell).describe()
    assert "Before that temperature and position are approached again.\nThe INS stays on" in words
    assert "switched off" not in words


def test_an_aborted_run_can_be_resumed(procedure, undisturbed, tmp_path):
    job = prepare_job(str(procedure), "quick", Emulation("quick", 0))

    class Aborter(ConsentingOperator):
        left = 300

        def command(self):
            self.left -= 1
            return RunCommand.ABORT if self.left == 0 else None

    folder, outcome = run_job(job, tmp_path / "run", Watcher(), Aborter())
    assert outcome.ended == "stopped"
    folder, _, _ = resumed(folder.path)
    assert_agree(read_dwells(folder.dwells), undisturbed)


def test_a_run_in_progress_is_not_resumed(procedure, tmp_path):
    path = broken_off(procedure, tmp_path / "run", "soak")
    resumption = prepare_resumption(path)
    with (
        RunLock(path, VirtualClock()),
        pytest.raises(
            BenchInUseError, match=rf"run folder.* watch it with `gyrobench monitor {path}`, or end it"
        ),
    ):
        resume_run(resumption, Watcher(), ConsentingOperator())


def test_a_run_without_progress_is_resumed_only_anyway(procedure, tmp_path):
    path = broken_off(procedure, tmp_path / "run", "soak")
    for _ in range(MAX_RESUMES_WITHOUT_PROGRESS):
        with pytest.raises(KilledError):
            resume_run(prepare_resumption(path), Watcher("soak"), ConsentingOperator())
    with pytest.raises(RunFolderError, match="--anyway"):
        prepare_resumption(path)
    assert prepare_resumption(path, anyway=True)


def test_a_run_of_another_unit_is_not_continued(in_third_dwell):
    path = in_third_dwell
    journal = path / "journal.jsonl"
    journal.write_text(journal.read_text().replace('"unit": "1003"', '"unit": "77"'))
    _, outcome = resume_run(prepare_resumption(path), Watcher(), RefusingOperator())
    assert outcome.ended == "stopped"
    assert "is unit 1003, but this run measures 77" in outcome.reason
    assert open_run_folder(path).journal.exists()


@pytest.mark.parametrize(("instrument", "driver"), [(RATE_TABLE, Acutrol3000), (CHAMBER, WatlowF4)])
def test_another_instrument_continues_no_run_unless_it_replaces_the_first(
    in_third_dwell, monkeypatch, instrument, driver
):
    """Adapters that exchanged their names in a power cut, and a controller that was replaced."""
    path, before = in_third_dwell, (in_third_dwell / "journal.jsonl").read_bytes()
    monkeypatch.setattr(driver, "identify", lambda _: "another one")
    with pytest.raises(ConnectionFailedError, match=f"{instrument}: .* another one in place of .*--other-i"):
        resume_run(prepare_resumption(path), Watcher(), ConsentingOperator())
    assert (path / "journal.jsonl").read_bytes() == before
    watcher = Watcher("power_on")
    with pytest.raises(KilledError):
        resume_run(prepare_resumption(path), watcher, ConsentingOperator(), other_instruments=True)
    assert any(f"The {instrument} was replaced: another one" in note for note in watcher.notes)
    assert read_provenance(open_run_folder(path))["instruments"][instrument] == "another one"
    with pytest.raises(KilledError):
        resume_run(prepare_resumption(path), Watcher("power_on"), ConsentingOperator())


def test_an_ins_that_identifies_otherwise_than_before_is_noted(in_third_dwell, monkeypatch):
    monkeypatch.setattr(CanIns, "identify", lambda *_: "serial number 1003, firmware 104")
    watcher = Watcher("chamber")
    with pytest.raises(KilledError):
        resume_run(prepare_resumption(in_third_dwell), watcher, ConsentingOperator())
    assert any("firmware 104; before as serial number 1003, firmware 103" in note for note in watcher.notes)


def test_it_is_noted_that_an_ins_without_serial_number_may_be_another(in_third_dwell, monkeypatch):
    monkeypatch.setattr(CanIns, "identity", lambda *_: {})
    watcher = Watcher("chamber")
    with pytest.raises(KilledError):
        resume_run(prepare_resumption(in_third_dwell), watcher, ConsentingOperator())
    (note,) = [note for note in watcher.notes if "sends no serial number" in note]
    assert "whether another unit is connected is not checked" in note


def test_an_ins_without_the_identity_of_its_section_is_not_measured(in_third_dwell):
    station = in_third_dwell / "station.yaml"
    station.write_text(station.read_text().replace("ins:\n", "ins:\n  identity: firmware 7\n", 1))
    _, outcome = resume_run(prepare_resumption(in_third_dwell), Watcher(), RefusingOperator())
    assert (
        "identifies as serial number 1003, firmware 103, hardware 1, which lacks 'firmware 7'"
        in outcome.reason
    )


class Script(ConsentingOperator):
    """Types commands, one at each tick."""

    def __init__(self, *commands):
        super().__init__()
        self._left = list(commands)

    def command(self):
        return self._left.pop(0) if self._left else None


def test_nothing_is_approached_when_the_only_dwell_left_is_skipped(procedure, tmp_path):
    path = broken_off(procedure, tmp_path / "run", "turn", 4)
    before = list(read_journal(path / "journal.jsonl"))
    operator = Script(None, RunCommand.HOLD, RunCommand.SKIP)
    _, outcome = resume_run(prepare_resumption(path), Watcher(), operator)
    assert outcome.ended == "finished"
    entries = list(read_journal(path / "journal.jsonl"))[len(before) :]
    events = [entry["event"] for entry in entries]
    skipped = events.index("dwell_skipped")
    assert "approach_started" not in events[skipped:]
    assert "powered_on" not in events
    assert not [entry for entry in entries if "restarted" in entry.get("text", "")]
    given = [(entry["order"], entry["by"]) for entry in entries if entry["event"] == "ordered"]
    assert given == [("hold", "the terminal"), ("skip", "the terminal")]
    notes = [entry["text"] for entry in entries if entry["event"] == "note"]
    assert "holds at the end of the present step or dwell" in notes
    assert [entry["kind"] for entry in entries[skipped:] if entry["event"] == "step_started"] == [
        "power_off",
        "chamber_off",
    ]


def runs_of(path):
    """Number of the power cycle of each dwell in the table, in order."""
    return {row.dwell: int(row.run.rsplit("-")[-1]) for row in read_dwells(path / "dwells.csv")}


def entries_of(path, event):
    return [entry for entry in read_journal(path / "journal.jsonl") if entry["event"] == event]


def test_a_flagged_dwell_of_a_finished_run_is_measured_again(finished, undisturbed):
    flagged = [replace(row, flags=("a gap",)) if row.dwell == 4 else row for row in undisturbed]
    write_dwells(finished / "dwells.csv", flagged)
    words = prepare_resumption(finished, repeat=["flagged"]).describe()
    assert "Measured again, before step 26: dwell 4 (flagged: a gap)." in words
    folder, outcome, watcher = resumed(finished, ["flagged"])
    assert_agree(read_dwells(folder.dwells), undisturbed)
    assert [each.row.dwell for each in outcome.dwells] == [1, 2, 3, 4]
    assert runs_of(finished) == {1: 1, 2: 1, 3: 1, 4: 2}
    (way,) = [text for text in watcher.notes if text.startswith("returning to step")]
    assert "power on" in way
    assert "chamber to 25 degC" in way
    (commanded,) = entries_of(finished, "repeat_commanded")
    assert (commanded["dwells"], commanded["why"]) == ([4], ["flagged: a gap"])
    assert entries_of(finished, "dwell_finished")[-1]["replaces_earlier"]
    assert entries_of(finished, "step_finished")[-1]["kind"] == "chamber_off"
    assert facts_of(read_journal(folder.journal)).dwells == 4
    write_report(folder)
    assert verify_seals(finished).is_intact
    assert "measured again in place of earlier ones: 4" in folder.report.read_text()
    for repeat, reasons in (("flagged", "flagged"), ("plateaus", "flagged or skipped")):
        with pytest.raises(RunFinishedError, match=f"no dwell is {reasons}\\.$"):
            prepare_resumption(finished, repeat=[repeat])


def test_repeated_dwells_share_the_approach_of_their_plateau(finished):
    resumption = prepare_resumption(finished, repeat=["4", "1", "2"])
    planned_s = resumption.progress.remaining_plan(resumption.job.plan).duration_s
    resumed(finished, ["4", "1", "2"])
    assert list(runs_of(finished).items()) == [(3, 1), (1, 2), (2, 2), (4, 2)]
    approached = [entry for entry in entries_of(finished, "approach_started") if entry["kind"] != "go_to"]
    assert [each["what"] for each in approached if each["kind"] == "chamber"] == [
        "chamber to 35 degC at 10 degC/min",
        "chamber to 25 degC at 10 degC/min",
    ]
    assert [each["kind"] for each in approached].count("soak") == 2
    entries = list(read_journal(finished / "journal.jsonl"))
    resumed_at = [entry["event"] for entry in entries].index("run_resumed")
    assert sum(entry.get("planned_s", 0.0) for entry in entries[resumed_at:]) == pytest.approx(
        planned_s, rel=0.05
    )


def test_a_killed_repeat_resumes_with_the_dwells_that_are_left(finished, undisturbed):
    with pytest.raises(KilledError):
        resume_run(prepare_resumption(finished, repeat=["1", "3"]), Watcher("turn", 2), ConsentingOperator())
    assert runs_of(finished) == {1: 2, 2: 1, 3: 1, 4: 1}
    progress = prepare_resumption(finished).progress
    assert (progress.lost, progress.replaced, progress.finished) == ({3}, {3}, {1, 2, 4})
    folder, _, _ = resumed(finished)
    assert runs_of(finished) == {1: 2, 2: 1, 3: 3, 4: 1}
    by_dwell = sorted(read_dwells(folder.dwells), key=lambda row: row.dwell)
    assert_agree(by_dwell, undisturbed)


def test_the_earlier_measurement_counts_if_its_repeat_is_skipped(finished):
    operator = Script(None, None, RunCommand.SKIP)
    _, outcome = resume_run(prepare_resumption(finished, repeat=["2"]), Watcher(), operator)
    assert (outcome.ended, outcome.skipped_text) == ("finished", "")
    assert runs_of(finished) == {1: 1, 2: 1, 3: 1, 4: 1}
    assert prepare_resumption(finished).progress.finished == {1, 2, 3, 4}


def test_only_dwells_that_are_over_are_repeated(finished, in_third_dwell):
    for path, dwell in ((finished, "5"), (in_third_dwell, "3")):
        with pytest.raises(DocumentError, match=f"dwell {dwell} was neither measured nor skipped"):
            prepare_resumption(path, repeat=[dwell])
    assert prepare_resumption(in_third_dwell, repeat=["2"]).progress.lost == {2}


def test_all_dwells_of_a_plateau_with_a_flagged_one_are_chosen(finished, undisturbed):
    flagged = [replace(row, flags=("a gap",)) if row.dwell == 3 else row for row in undisturbed]
    write_dwells(finished / "dwells.csv", flagged)
    assert prepare_resumption(finished, repeat=["plateaus"]).progress.lost == {3, 4}


#: Ticks until the first dwell.
UNTIL_FIRST_DWELL = [None] * 150


def test_a_run_that_is_to_finish_its_plateau_ends_after_it_and_can_be_resumed(
    procedure, undisturbed, tmp_path
):
    job = prepare_job(str(procedure), "quick", Emulation("quick", 0))

    class Sender(Script):
        def command(self):
            if len(self._left) == 1:
                send_command(tmp_path / "run", RunCommand.FINISH, os.getpid(), "B. Jones")
            return super().command()

    folder, outcome = run_job(job, tmp_path / "run", Watcher(), Sender(*UNTIL_FIRST_DWELL))
    assert (outcome.ended, outcome.reason) == (
        "stopped",
        "ended after the plateau 35 degC, as commanded by B. Jones (gyrobench control)",
    )
    assert [row.dwell for row in read_dwells(folder.dwells)] == [1, 2]
    assert folder.bias_bins.is_file()
    folder, _, _ = resumed(folder.path)
    assert_agree(read_dwells(folder.dwells), undisturbed)


def test_the_end_after_a_plateau_can_be_cancelled(procedure, tmp_path):
    job = prepare_job(str(procedure), "quick", Emulation("quick", 0))
    _, outcome = run_job(
        job, tmp_path / "run", Watcher(), Script(*UNTIL_FIRST_DWELL, RunCommand.FINISH, RunCommand.CONTINUE)
    )
    assert outcome.ended == "finished", outcome.reason


def test_a_run_that_is_to_finish_its_last_plateau_finishes(finished):
    operator = Script(None, None, RunCommand.FINISH)
    _, outcome = resume_run(prepare_resumption(finished, repeat=["4"]), Watcher(), operator)
    assert outcome.ended == "finished", outcome.reason


def test_the_plan_of_a_repeat_is_shown_before_it_begins(finished):
    before = {path: path.read_bytes() for path in finished.rglob("*") if path.is_file()}
    app = typer.Typer()
    app.command()(resume)
    printed = CliRunner().invoke(app, [str(finished), "--repeat", "2,4", "--look"])
    assert printed.exit_code == 0, printed.output
    assert "4 of 4 dwells are finished and kept" in printed.output  # until their repeats have finished
    assert "Measured again, before step 26: dwells 2 and 4." in printed.output
    assert "They belong to another power cycle" in printed.output
    lines = [line.split() for line in printed.output.splitlines()]
    assert [line[2] for line in lines if line[:1] == ["all"]] == ["2"]
    assert {path: path.read_bytes() for path in before} == before
    refused = CliRunner().invoke(app, [str(finished), "--repeat", "two"])
    assert "--repeat two: give flagged, skipped, plateaus, or numbers" in str(refused.exception)
