"""Several units on one table: measured at once, each in a complete run folder; one that fails is dropped."""

import shutil
from dataclasses import replace
from types import SimpleNamespace

import pytest

from gyrobench.bench.bias.dwell_table import read_dwells, write_dwells
from gyrobench.bench.dwells.run_results import recompute_run
from gyrobench.bench.engine.job import prepare_job
from gyrobench.bench.engine.observers import ObserverGroup, RunObserver
from gyrobench.bench.engine.operator import ConsentingOperator
from gyrobench.bench.engine.resume import prepare_resumption
from gyrobench.bench.engine.run import resume_run, run_job
from gyrobench.bench.engine.units import Units
from gyrobench.bench.foundations.clock import WallClock
from gyrobench.bench.foundations.errors import RunFolderError
from gyrobench.bench.foundations.shipped import find_document
from gyrobench.bench.monitor.snapshot import RunSnapshot
from gyrobench.bench.monitor.snapshot_recorder import SnapshotRecorder
from gyrobench.bench.monitor.terminal_screen import screen
from gyrobench.bench.monitor.website import Website
from gyrobench.bench.report import units_report
from gyrobench.bench.report.run_content import read_run
from gyrobench.bench.report.run_report import WrittenReport
from gyrobench.bench.report.units_report import write_units_report
from gyrobench.bench.runs.folder import RunFolder
from gyrobench.bench.runs.index.store import find_run_folders
from gyrobench.bench.runs.journal import facts_of, read_journal
from gyrobench.bench.station.instruments import Emulation
from gyrobench.bench.station.station import Station
from tests.bench.engine.intervention import TWO_TEMPERATURES, KilledError
from tests.bench.monitor.served_run import ask, served
from tests.bench.monitor.test_metrics import scraped

NUMBERS = ["1101", "1102", "1103", "1104"]
#: As a unit whose plug is pulled in its third dwell.
SILENT = "fault: frames_lost, during: navigate, nth: 3, after_s: 20, for_s: 90000"
#: As a plug with a loose contact.
BRIEFLY_SILENT = SILENT.replace("90000", "10")
RESTARTING = "fault: ins_restarts, during: align, nth: 2, after_s: 5"
UNALIGNED = "fault: alignment_never_done, during: align, nth: 2"


class Watcher(RunObserver):
    """Notes what it is notified of, and ends the run in the nth step of a kind as a kill does."""

    def __init__(self, kind="", nth=1):
        self.kind, self.left, self.lost, self.notes = kind, nth, {}, []

    def noted(self, text):
        self.notes.append(text)

    def dropped(self, unit, why):
        self.lost[unit] = why

    def step_started(self, planned, bench):
        self.left -= planned.step.name == self.kind

    def ticked(self, bench, left_s):
        if self.kind and self.left == 0:
            raise KilledError


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("files")
    (folder / "two_temperatures.yaml").write_text(TWO_TEMPERATURES)
    return folder


def job_of(files, station="four_units", faulty=(), fault=SILENT):
    faults = files / f"faults-{hash(fault)}-{'-'.join(map(str, faulty))}.yaml"
    faults.write_text("faults:\n" + "".join(f"  - {{{fault}, unit: {unit}}}\n" for unit in faulty))
    emulation = Emulation("four_units", 0, str(faults) if faulty else "")
    return prepare_job(str(files / "two_temperatures.yaml"), str(station), emulation)


def run_of(job, path, observer=None):
    return run_job(job, path, observer or Watcher(), ConsentingOperator())


def dwells_of(folder, number):
    return folder.unit(number).dwells.read_bytes()


@pytest.fixture(scope="module")
def whole(files, tmp_path_factory):
    folder, outcome = run_of(job_of(files), tmp_path_factory.mktemp("whole") / "run")
    assert outcome.ended == "finished", outcome.reason
    return folder, outcome


def test_each_unit_has_its_dwells_in_its_run_folder(whole):
    folder, outcome = whole
    assert list(outcome.units) == NUMBERS == [unit.path.name for unit in folder.unit_folders]
    for number in NUMBERS:
        rows = read_dwells(folder.unit(number).dwells)
        assert [(row.dwell, row.unit, row.flags) for row in rows] == [(n, number, ()) for n in range(1, 5)]
    assert not folder.dwells.exists()


def test_the_biases_of_each_unit_differ_and_repeat(whole):
    folder, _ = whole
    warm = {number: read_dwells(folder.unit(number).dwells) for number in NUMBERS}
    for first, second, *_ in warm.values():
        for axis in range(3):
            spread = (first.sigma_dph[axis] ** 2 + second.sigma_dph[axis] ** 2 + 2e-6) ** 0.5
            assert abs(first.bias_dph[axis] - second.bias_dph[axis]) < 4.5 * spread
    assert len({rows[0].bias_dph for rows in warm.values()}) == len(NUMBERS)


def test_a_unit_with_another_mounting_is_in_another_position(whole):
    folder, _ = whole
    positions = {
        number: [row.position for row in read_dwells(folder.unit(number).dwells)] for number in NUMBERS
    }
    assert positions == {
        "1101": ["z_up", "y_down"] * 2,
        "1102": ["z_up", "y_down"] * 2,
        "1103": ["z_up", "x_up"] * 2,
        "1104": ["z_up", "y_down"] * 2,
    }


def test_a_units_folder_is_a_run_folder_of_a_bench_with_that_unit_alone(whole, tmp_path):
    folder, _ = whole
    copy = RunFolder(tmp_path / "1103")
    shutil.copytree(folder.unit("1103").path, copy.path)
    copy.dwells.unlink()
    recompute_run(copy.path)
    assert copy.dwells.read_bytes() == dwells_of(folder, "1103")
    facts = facts_of(read_journal(copy.journal))
    assert (facts.unit, facts.dwells, facts.ended) == ("1103", 4, "finished")
    assert Station(copy.station).units[0].file.ins.channel == "ins-3"
    with pytest.raises(RunFolderError, match="is a unit of the run"):
        prepare_resumption(folder.unit("1103").path)


class BusExchanger(Watcher):
    """Exchanges the buses of the first two units before the second position, as adapters that come back."""

    def step_started(self, planned, bench):
        super().step_started(planned, bench)
        if self.left == 0 and planned.step.name == "go_to":
            one, other = (unit.ins for unit in bench.units[:2])
            for name in ("_bus", "_receive"):
                mine, theirs = getattr(one, name), getattr(other, name)
                setattr(one, name, theirs)
                setattr(other, name, mine)

    def ticked(self, bench, left_s):
        pass


@pytest.mark.long
def test_units_whose_adapters_exchange_their_names_between_dwells_are_not_mixed_up(files, tmp_path):
    watcher = BusExchanger("go_to", 2)
    folder, outcome = run_of(job_of(files), tmp_path / "run", watcher)
    assert outcome.ended == "finished"
    assert watcher.lost == {
        one: f"INS {one}: is unit {other}, but this run measures {one}. Connect {one}."
        for one, other in (("1101", "1102"), ("1102", "1101"))
    }
    assert [row.dwell for row in read_dwells(folder.unit("1101").dwells)] == [1]


def test_each_unit_is_a_run_for_commands_that_evaluate_runs(whole):
    folder, _ = whole
    assert find_run_folders([str(folder.path)]) == [folder.unit(number).path for number in NUMBERS]
    with pytest.raises(RunFolderError, match="several units"):
        recompute_run(folder.path)
    assert not folder.bias_bins.exists()


@pytest.mark.long
def test_a_killed_run_resumes_with_all_units(files, whole, tmp_path):
    path = tmp_path / "run"
    with pytest.raises(KilledError):
        run_of(job_of(files), path, Watcher("navigate", 6))
    resumption = prepare_resumption(path)
    assert resumption.progress.finished == {1, 2}
    assert "units 1101, 1102, 1103 and 1104" in resumption.describe()
    folder, outcome = resume_run(resumption, Watcher(), ConsentingOperator())
    assert outcome.ended == "finished", outcome.reason
    for number in NUMBERS:
        rows, others = (read_dwells(each.unit(number).dwells) for each in (folder, whole[0]))
        assert rows[:2] == others[:2]
        for row, other in zip(rows[2:], others[2:], strict=True):
            assert (row.dwell, row.position, row.flags) == (other.dwell, other.position, ())
            for bias, sigma, bias_2, sigma_2 in zip(
                row.bias_dph, row.sigma_dph, other.bias_dph, other.sigma_dph, strict=True
            ):
                # Each power-on has biases a little different, beside the noise of both.
                assert abs(bias - bias_2) < 4.5 * (sigma**2 + sigma_2**2 + 2e-6) ** 0.5


def test_a_dwell_that_one_unit_has_not_finished_is_measured_again_for_it_alone(files, whole, tmp_path):
    path = tmp_path / "run"
    shutil.copytree(whole[0].path, path)
    folder = RunFolder(path)
    # As a kill between the entries of two units for the last dwell leaves it.
    for number, end in (("", "dwell_over"), ("1103", "dwell_finished"), ("1104", "dwell_finished")):
        journal = folder.unit(number).journal
        lines = journal.read_bytes().splitlines(keepends=True)
        last = max(place for place, line in enumerate(lines) if f'"event": "{end}"'.encode() in line)
        journal.write_bytes(b"".join(lines[:last]))
    resumption = prepare_resumption(path)
    assert resumption.progress.finished == {1, 2, 3}
    _, outcome = resume_run(resumption, Watcher(), ConsentingOperator())
    assert outcome.ended == "finished", outcome.reason
    for number in NUMBERS:
        again, before = (read_dwells(each.unit(number).dwells) for each in (folder, whole[0]))
        assert (again == before) is (number in ("1101", "1102"))
        assert [row.dwell for row in again] == [1, 2, 3, 4]


class Scraper(RunObserver):
    """Holds the run in its 7th window until a monitor serves that unit 1101 has 3 dwells, and keeps that."""

    def __init__(self, recorder, root):
        self.recorder, self.root, self.left, self.found = recorder, root, 7, {}

    def step_started(self, planned, bench):
        self.left -= planned.step.name == "navigate"
        if self.left or self.found:
            return
        with served(Website(self.root, WallClock().utc).answer) as server:
            dwells = ("gyrobench_dwells_measured", "run=run", "unit=1101")
            while self.found.get(dwells) != 3.0:
                self.recorder.beat(bench)
                self.found = scraped(ask(server, "/metrics")[1].decode())


@pytest.mark.long
def test_a_flagged_dwell_is_measured_again_on_command_for_its_unit_alone(whole, tmp_path):
    folder = RunFolder(shutil.copytree(whole[0].path, tmp_path / "run"))
    flagged = folder.unit("1103").dwells
    rows = [replace(row, flags=("a gap",) if row.dwell == 2 else ()) for row in read_dwells(flagged)]
    write_dwells(flagged, rows)
    resumption = prepare_resumption(folder.path, repeat=["flagged"])
    assert (resumption.progress.lost, resumption.progress.replaced) == ({2}, {2})
    _, outcome = resume_run(resumption, Watcher(), ConsentingOperator())
    assert outcome.ended == "finished", outcome.reason
    for number in NUMBERS:
        again = [row.dwell for row in read_dwells(folder.unit(number).dwells) if row.run.endswith("-2")]
        assert again == ([2] if number == "1103" else [])
        if number != "1103":
            assert dwells_of(folder, number) == dwells_of(whole[0], number)
    assert prepare_resumption(folder.path, repeat=["1"]).progress.lost == {1}


@pytest.fixture(scope="module")
def without_1102(files, tmp_path_factory):
    root, job, watcher = tmp_path_factory.mktemp("silent"), job_of(files, faulty=[2]), Watcher()
    recorder = SnapshotRecorder(job.plan)
    scraper = Scraper(recorder, root)
    folder, outcome = run_of(job, root / "run", ObserverGroup(watcher, recorder, scraper))
    return folder, outcome, watcher, recorder, scraper.found


def test_a_unit_that_falls_silent_is_dropped_and_the_others_measure_the_same(whole, without_1102):
    folder, outcome, watcher, *_ = without_1102
    assert outcome.ended == "finished"
    assert list(watcher.lost) == ["1102"]
    assert "silent" in watcher.lost["1102"]
    for number in ("1101", "1103", "1104"):
        rows, before = (read_dwells(each.unit(number).dwells) for each in (folder, whole[0]))
        assert [replace(row, other=()) for row in rows] == [replace(row, other=()) for row in before]
        assert [dict(row.other) for row in before] == [{"neighbours_on": 3.0}] * 4
        on = [dict(row.other)["neighbours_on"] for row in rows]
        assert (on[:2], on[3]) == ([3.0, 3.0], 2.0)
        assert 2.0 < on[2] < 3.0
    rows, before = (read_dwells(each.unit("1102").dwells) for each in (folder, whole[0]))
    assert rows == before[:2]
    facts = facts_of(read_journal(folder.unit("1102").journal))
    assert (facts.ended, facts.reason) == ("failed", watcher.lost["1102"])
    assert outcome.units["1102"].ended == "failed"
    assert "Unit 1102" in outcome.shortcoming("rejected")


def test_a_unit_that_is_silent_for_seconds_repeats_its_dwell(files, whole, tmp_path):
    watcher, job = Watcher(), job_of(files, faulty=[1, 3], fault=BRIEFLY_SILENT)
    shown = ObserverGroup(watcher, SnapshotRecorder(job.plan))
    folder, outcome = run_of(job, tmp_path / "run", shown)
    assert outcome.ended == "finished", outcome.reason
    assert not watcher.lost
    for number in NUMBERS:
        rows, before = (read_dwells(each.unit(number).dwells) for each in (folder, whole[0]))
        assert [(row.dwell, row.flags) for row in rows] == [(row.dwell, row.flags) for row in before]
        given_up = [
            entry["dwell"]
            for entry in read_journal(folder.unit(number).journal)
            if entry["event"] == "dwell_given_up"
        ]
        is_faulty = number in ("1101", "1103")
        assert given_up == ([3] if is_faulty else [])
        same = [replace(a, other=()) == replace(b, other=()) for a, b in zip(rows, before, strict=True)]
        assert same[:3] == [True, True, not is_faulty]


@pytest.mark.long
def test_a_unit_that_restarts_while_it_aligns_repeats_its_dwell_in_another_power_cycle(files, tmp_path):
    watcher = Watcher()
    folder, outcome = run_of(job_of(files, faulty=[2], fault=RESTARTING), tmp_path / "run", watcher)
    assert outcome.ended == "finished", outcome.reason
    assert not watcher.lost
    assert any("1102: dwell 2 is repeated: the INS left its alignment" in note for note in watcher.notes)
    for number in NUMBERS:
        rows = read_dwells(folder.unit(number).dwells)
        assert [(row.dwell, row.flags) for row in rows] == [(dwell, ()) for dwell in range(1, 5)]
        # Switched off and on after the first dwell, or after the second where that was good.
        first = 1 if number == "1102" else 2
        assert [row.run[-2:] for row in rows] == ["-1"] * first + ["-2"] * (4 - first)


@pytest.mark.long
def test_a_unit_that_restarts_while_it_aligns_has_its_dwell_flagged_where_none_is_repeated(files, tmp_path):
    job = job_of(files, faulty=[2], fault=RESTARTING)
    procedure = job.plan.procedure.model_copy(update={"disturbed_dwell": "flag"})
    flagging = replace(job, plan=replace(job.plan, procedure=procedure))
    folder, outcome = run_of(flagging, tmp_path / "run")
    assert outcome.ended == "finished", outcome.reason
    for number in NUMBERS:
        rows = read_dwells(folder.unit(number).dwells)
        assert [row.dwell for row in rows] == [1, 2, 3, 4]
        assert [bool(row.flags) for row in rows] == [False, number == "1102", False, False]
        assert [row.run[-2:] for row in rows] == ["-1", "-1", "-2", "-2"]


@pytest.mark.long
def test_a_dropped_unit_stays_dropped_when_the_run_resumes(files, tmp_path):
    path, watcher = tmp_path / "run", Watcher("navigate", 7)
    with pytest.raises(KilledError):
        run_of(job_of(files, faulty=[2]), path, watcher)
    assert list(watcher.lost) == ["1102"]
    resumption = prepare_resumption(path)
    assert "Unit 1102 was dropped and is not measured" in resumption.describe()
    folder, outcome = resume_run(resumption, Watcher(), ConsentingOperator())
    assert outcome.ended == "finished", outcome.reason
    assert [len(read_dwells(folder.unit(number).dwells)) for number in NUMBERS] == [4, 2, 4, 4]
    assert outcome.units["1102"].ended == "failed"


@pytest.mark.long
def test_a_run_whose_units_are_all_silent_holds_until_they_are_back(files, tmp_path):
    watcher = Watcher()
    job = job_of(files, faulty=[1, 2, 3, 4], fault=SILENT.replace("90000", "200"))
    folder, outcome = run_of(job, tmp_path / "run", watcher)
    assert outcome.ended == "finished", outcome.reason
    assert not watcher.lost
    held = [entry["after"] for entry in read_journal(folder.journal) if entry["event"] == "held"]
    assert held == [["ins_silence"] * len(NUMBERS)]
    assert [len(read_dwells(folder.unit(number).dwells)) for number in NUMBERS] == [4] * len(NUMBERS)


def test_a_run_without_units_fails(files, tmp_path):
    job = job_of(files, faulty=[1, 2, 3, 4], fault=UNALIGNED)
    folder, outcome = run_of(job, tmp_path / "run")
    assert outcome.ended == "failed"
    assert outcome.reason.startswith("no unit is left")
    assert outcome.is_safe
    with pytest.raises(RunFolderError, match="every unit"):
        prepare_resumption(folder.path)


def test_without_dropping_the_run_holds_for_all(files, tmp_path):
    path = find_document("stations", "four_units")
    held = tmp_path / "held.yaml"
    held.write_text(path.read_text() + "drop_units: false\ninterlocks: {max_hold_s: 60}\n")
    watcher = Watcher()
    folder, outcome = run_of(job_of(files, held, [2]), tmp_path / "run", watcher)
    assert outcome.ended == "stopped"
    assert outcome.reason.startswith("held for longer than 60 s: ")
    held = [entry["after"] for entry in read_journal(folder.journal) if entry["event"] == "held"]
    assert held[0] == ["ins_silence"]
    assert not watcher.lost


def test_a_unit_that_is_dropped_while_the_operator_is_asked_about_compensations_gets_no_command():
    settled = []

    def compensation_of(number):
        def settle(_):
            yield
            settled.append(number)

        return SimpleNamespace(settle=settle)

    units = SimpleNamespace(running=NUMBERS, _compensations={each: compensation_of(each) for each in NUMBERS})
    for _ in Units.settle_compensation(units, after_power_on=True):
        units.running = NUMBERS[2:]
    assert settled == NUMBERS[2:]


@pytest.mark.long
def test_units_share_a_bus_by_an_offset_of_their_identifiers(files, whole, tmp_path):
    text = find_document("stations", "four_units").read_text()
    for number, offset in ((2, 64), (3, 128), (4, 192)):
        text = text.replace(
            f"    channel: ins-{number}\n",
            f"    options: {{unit: {number}}}\n    identifier_offset: {offset}\n",
        )
    shared = tmp_path / "shared.yaml"
    shared.write_text(text)
    folder, outcome = run_of(job_of(files, shared), tmp_path / "run")
    assert outcome.ended == "finished", outcome.reason
    for number in NUMBERS:
        assert dwells_of(folder, number) == dwells_of(whole[0], number)
    recompute_run(folder.unit("1104").path)
    assert dwells_of(folder, "1104") == dwells_of(whole[0], "1104")


def test_the_units_stand_side_by_side_and_each_folder_is_read_once(without_1102, monkeypatch):
    folder, *_ = without_1102
    reads = []

    def read(read_folder, **_):
        reads.append(read_folder.path.name)
        return read_run(read_folder)

    monkeypatch.setattr(
        units_report, "write_report", lambda each, *_, **__: WrittenReport(each.report, read(each))
    )
    monkeypatch.setattr(units_report, "read_run", read)
    (table,) = write_units_report(folder).comparison.tables
    assert reads == [*NUMBERS, folder.path.name]
    assert [row[:2] for row in table.rows] == [
        [number, "dropped" if number == "1102" else "not judged"] for number in NUMBERS
    ]


@pytest.mark.long
def test_the_report_links_those_of_all_units(without_1102):
    folder, *_ = without_1102
    write_units_report(folder)
    page = folder.report.read_text()
    assert "Gyro bias of 4 units" in page
    assert "The run finished." in page
    assert "rate table stopped" in page.rpartition("Safe state")[2]
    assert "Unit 1102 was dropped: the INS has been silent" in page
    assert all(f'<a href="units/{number}/report.html">' in page for number in NUMBERS)
    assert all(folder.unit(number).report.exists() for number in NUMBERS)
    dropped = folder.unit("1102").report.read_text()
    assert f"Unit 1102 was dropped from the run {folder.path.name} after 0:" in dropped
    assert "The run failed" not in dropped
    assert f"Gyro bias of unit 1101: {folder.path.name}" in folder.unit("1101").report.read_text()


def test_the_live_view_and_the_metrics_of_a_run_under_way_show_all_units(without_1102):
    folder, _, _, recorder, found = without_1102
    run = "run=run"
    assert found["gyrobench_run_state", run, "state=running"] == 1.0
    for number in NUMBERS:
        unit = f"unit={number}"
        rows = [row for row in read_dwells(folder.unit(number).dwells) if row.dwell < 4]
        assert found["gyrobench_dwells_measured", run, unit] == len(rows)
        assert found["gyrobench_unit_dropped", run, unit] == float(number == "1102")
        key = ("gyrobench_bias_degrees_per_hour", "gyro=y", f"position={rows[-1].position}", run, unit)
        assert found[key] == pytest.approx(rows[-1].bias_dph[1], abs=1e-6)
        is_known = ("gyrobench_temperature_celsius", run, "sensor=gyro_z", unit) in found
        assert is_known is (number != "1102")
    snapshot = RunSnapshot.from_json(recorder.snapshot().to_json())
    assert [(unit.number, unit.dwells, bool(unit.dropped)) for unit in snapshot.units] == [
        (number, 4 - 2 * (number == "1102"), number == "1102") for number in NUMBERS
    ]
    lines = [line.plain for line in screen(snapshot, 100, 40, is_ascii=True)]
    assert sum(line.startswith("unit 11") for line in lines) == len(NUMBERS)
    assert any("dropped: the INS has been silent" in line for line in lines)
    site = Website(folder.path.parent, WallClock().utc)
    page = site.answer("/runs/run/").body.decode()
    assert "units 1101, 1102, 1103, 1104</p>" in page
    assert "Unit 1102 was dropped.</strong> the INS has been silent" in page
    for number in NUMBERS:
        assert f'href="units/{number}/"' in page
        page_of_unit = site.answer(f"/runs/run/units/{number}/").body.decode()
        assert f"unit {number}</p>" in page_of_unit
        dwells = page_of_unit.split('<section id="dwells"')[1].split("</section>")[0]
        assert dwells.count('<th scope="row"') == 4 - 2 * (number == "1102")
    for elsewhere in ("units/1105/", "units/../", "units/1101/journal.jsonl"):
        assert site.answer(f"/runs/run/{elsewhere}").status == 404
