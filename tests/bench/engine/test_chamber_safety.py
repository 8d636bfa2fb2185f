"""Chambers that do not do what a run expects: no ramp, a profile, other units, lost acknowledgements."""

from dataclasses import replace

import numpy as np
import pytest

from gyrobench.bench.engine.job import prepare_job
from gyrobench.bench.engine.observers import RunObserver
from gyrobench.bench.engine.preflight.bench_check import check_bench
from gyrobench.bench.engine.preflight.instruments import chamber_checks
from gyrobench.bench.engine.run import run_job
from gyrobench.bench.foundations.errors import RefusedError
from gyrobench.bench.foundations.shipped import find_document
from gyrobench.bench.runs.journal import read_journal
from gyrobench.bench.runs.telemetry import read_telemetry
from gyrobench.bench.station.check_result import CheckVerdict
from gyrobench.bench.station.instruments import Emulation
from gyrobench.drivers.chamber.watlow_f4 import WatlowF4
from gyrobench.drivers.emulators.watlow_f4 import WatlowF4Emulator
from tests.bench.engine.intervention import RefusingOperator
from tests.bench.engine.test_resumption import Watcher
from tests.drivers.conftest import Rig

HEAT = """procedure: heat
steps:
  - chamber: {temperature_c: 33, ramp_c_per_min: 2, within_c: 0.5}
  - soak: {for_s: 60}
"""
END_PROFILES = {"chamber:\n": "chamber:\n  running_profile: end\n"}


@pytest.fixture
def prepared(tmp_path):
    """A job of heating on the quick bench with faults, and the path of its station file."""

    def make(*faults, procedure=HEAT, replaced=()):
        station = tmp_path / "station.yaml"
        text = find_document("stations", "quick").read_text()
        for old, new in dict(replaced).items():
            assert old in text
            text = text.replace(old, new)
        station.write_text(text)
        (tmp_path / "heat.yaml").write_text(procedure)
        listed = tmp_path / "faults.yaml"
        listed.write_text("faults:\n" + "".join(f"  - {{{fault}}}\n" for fault in faults))
        emulation = Emulation("quick", 0, str(listed))
        return prepare_job(str(tmp_path / "heat.yaml"), str(station), emulation)

    return make


def run(job, tmp_path, operator=None):
    watcher = Watcher()
    folder, outcome = run_job(job, tmp_path / "run", watcher, operator or RefusingOperator())
    return folder, outcome, list(read_journal(folder.journal))


def of(entries, event):
    return [entry for entry in entries if entry["event"] == event]


def test_the_set_point_is_walked_where_the_controller_does_not_ramp(prepared, tmp_path):
    folder, outcome, entries = run(prepared("fault: no_set_point_ramp, at_s: 0"), tmp_path)
    assert outcome.ended == "finished", outcome.reason
    assert outcome.is_safe
    (heated,) = (each for each in of(entries, "step_finished") if each["kind"] == "chamber")
    assert 280.0 < heated["took_s"] < 480.0  # 10 K at 2 K/min and the lag of the air, 90 s
    telemetry = read_telemetry(folder.telemetry)
    assert telemetry["time_s"][-1] > outcome.duration_s + 50.0  # the safe state's ramp of 60 s
    before = telemetry["time_s"] < outcome.duration_s
    times_s, chamber_c = telemetry["time_s"][before], telemetry["chamber_c"][before]
    rises_c_per_min = np.diff(chamber_c) / np.diff(times_s) * 60.0
    assert np.nanmax(rises_c_per_min) < 2.5  # the chamber alone manages 5
    assert outcome.duration_s == pytest.approx(heated["took_s"] + 60.0, abs=30.0)


class TurnsTheTable(Watcher):
    """Another program sets the table turning in the safe state's ramp."""

    def noted(self, text):
        if self.ramp_s is None and text.startswith("The chamber's set point is being ramped"):
            self.ramp_s = self.clock.now()

    def begun(self, folder, bench, outcome):
        self.clock, self.ramp_s = bench.clock, None

    def beat(self, bench):
        now_s = bench.clock.now()
        if self.ramp_s is not None and self.ramp_s + 10.0 < now_s < self.ramp_s + 15.0:
            bench.instruments.table.prepare()
            bench.instruments.table.turn_at(2, 0.3)


def test_interlocks_are_watched_in_the_ramp_of_the_safe_state(prepared, tmp_path):
    job = prepared("fault: no_set_point_ramp, at_s: 0")
    folder, outcome = run_job(job, tmp_path / "run", TurnsTheTable(), RefusingOperator())
    entries = list(read_journal(folder.journal))
    assert outcome.ended == "finished", outcome.reason
    assert outcome.is_safe
    (trip,) = of(entries, "tripped")
    assert "although the table was stopped" in trip["why"]
    (ended,) = of(entries, "run_ended")
    assert trip["time_s"] + 10.0 < ended["time_s"]  # the ramp began again


def test_switching_the_chamber_off_in_a_ramp_trips_nothing(prepared, tmp_path):
    procedure = """procedure: off
steps:
  - chamber: {temperature_c: 26, ramp_c_per_min: 2, within_c: 2}
  - chamber_off: {}
  - soak: {for_s: 60}
"""
    _, outcome, entries = run(prepared("fault: no_set_point_ramp, at_s: 0", procedure=procedure), tmp_path)
    assert of(entries, "tripped") == []
    assert outcome.ended == "finished", outcome.reason


def checked(tmp_path, prepared, fault, **options):
    job = prepared(fault, **options)
    checks = check_bench(str(job.station.path), None, job.emulation, tmp_path)
    return {check.what: check for check in checks if check.subject == "chamber"}


def test_the_preflight_check_tries_a_set_point_and_names_who_ramps(tmp_path, prepared):
    found = checked(tmp_path, prepared, "fault: no_set_point_ramp, at_s: 0")["set point"]
    assert found.verdict is CheckVerdict.PASS
    assert found.found.endswith("the controller does not ramp, so the bench moves it in steps")
    refused = checked(tmp_path, prepared, "fault: exception_code, at_s: 0, for_s: 100000")["answers"]
    assert refused.verdict is CheckVerdict.FAIL


class UnreadableSwitch:
    """A chamber that does not report whether it is on."""

    def __init__(self, chamber):
        self._chamber = chamber

    def __getattr__(self, name):
        return getattr(self._chamber, name)

    def read(self):
        return replace(self._chamber.read(), is_on=None)


@pytest.mark.parametrize(
    ("air_c", "verdict", "found"),
    [
        (60.0, CheckVerdict.SKIPPED, "is not tried while the chamber changes its temperature"),
        (23.0, CheckVerdict.PASS, "the controller ramps and keeps 10 degC/min as its ramp"),
    ],
)
def test_the_preflight_check_writes_nothing_to_a_chamber_that_may_change_its_temperature(
    prepared, air_c, verdict, found
):
    rig = Rig()
    line, heard = rig.line("chamber", WatlowF4Emulator(rig.air))
    chamber = WatlowF4(line)
    rig.air.air_c = air_c
    heard.requests.clear()
    checks = {
        each.what: each for each in chamber_checks(prepared().station, lambda: UnreadableSwitch(chamber))
    }
    assert (checks["set point"].verdict, found in checks["set point"].found) == (verdict, True)
    writes = [request for request in heard.requests if request[1] == 6]  # Modbus function
    assert bool(writes) == (verdict is CheckVerdict.PASS)


def test_the_preflight_check_sees_a_profile_and_leaves_it(tmp_path, prepared):
    fault = "fault: profile_started_at_panel, at_s: 0, to_c: 60"
    found = checked(tmp_path, prepared, fault)
    assert found["no profile"].verdict is CheckVerdict.FAIL
    assert "register 200 reads 2" in found["no profile"].found
    assert found["set point"].verdict is CheckVerdict.SKIPPED
    found = checked(tmp_path, prepared, fault, replaced=END_PROFILES)
    assert found["no profile"].verdict is CheckVerdict.PASS
    assert found["no profile"].found.endswith("a run ends it")


def test_a_run_is_refused_while_a_profile_runs(tmp_path, prepared):
    job = prepared("fault: profile_started_at_panel, at_s: 0, to_c: 60")
    with pytest.raises(RefusedError, match=r"runs a profile .register 200 reads 2. by itself"):
        run(job, tmp_path)
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize("dialect", ["watlow_f4", "watlow_f4t", "thermotron_8800"])
def test_a_profile_is_ended_where_the_station_file_says_so(tmp_path, prepared, dialect):
    replaced = END_PROFILES | {"dialect: watlow_f4\n": f"dialect: {dialect}\n", "  address: 1\n": ""}
    job = prepared("fault: profile_started_at_panel, at_s: 0, to_c: 60", replaced=replaced)
    _, outcome, _ = run(job, tmp_path)
    assert outcome.ended == "finished", outcome.reason
    assert outcome.is_safe


@pytest.mark.parametrize(
    ("fault", "problem"),
    [
        ("fault: decimals_changed_at_panel, decimals: 2", "decimals (register 606) were changed from 1 to 2"),
        ("fault: decimals_changed_at_panel, decimals: 0", "decimals (register 606) were changed from 1 to 0"),
        ("fault: unit_changed_at_panel", "unit (register 901) was changed from °C to °F"),
    ],
)
def test_after_a_change_of_its_numbers_the_chamber_is_off_and_the_bench_not_reported_safe(
    tmp_path, prepared, fault, problem
):
    _, outcome, entries = run(prepared(f"{fault}, at_s: 30"), tmp_path)
    assert of(entries, "tripped")
    assert not outcome.is_safe
    (failed,) = (action for action in outcome.safe_state if action.problem)
    assert problem in failed.problem
    assert "the chamber was switched off" in failed.problem


HEAT_THE_UNIT = """procedure: heat_the_unit
steps:
  - power_on: {settle_s: 20}
  - chamber: {temperature_c: 60, ramp_c_per_min: 5}
  - soak: {for_s: 60}
"""


class AbsentForAnHour(RefusingOperator, RunObserver):
    """Aborts an hour after the first question; keeps the temperature of the unit's case at each tick."""

    def __init__(self):
        super().__init__()
        self.case_c, self._asked_s = [], np.inf

    def ask(self, question, answers):
        self._asked_s = min(self._asked_s, self.bench.clock.now())
        super().ask(question, answers)

    def answer(self):
        return super().answer() if self.bench.clock.now() > self._asked_s + 3600.0 else None

    def beat(self, bench):
        self.bench = bench
        self.case_c.append(bench.readings.ins.case_c)


def test_a_chamber_whose_sensor_is_stuck_is_switched_off_before_it_damages_the_unit(prepared, tmp_path):
    job = prepared("fault: chamber_sensor_stuck, during: ramp, after_s: 30", procedure=HEAT_THE_UNIT)
    operator = AbsentForAnHour()
    folder, outcome = run_job(job, tmp_path / "run", operator, operator)
    trip = of(list(read_journal(folder.journal)), "tripped")[0]
    assert trip["interlocks"] == ["chamber_sensor"]
    assert "away from the chamber's air, which reads 2" in trip["why"]
    assert np.nanmax(operator.case_c) < 80.0  # full power leads to 100
    assert 23.0 < operator.case_c[-1] < 60.0  # and to -60 with the safe set point below the reading
    assert outcome.ended == "stopped"
    assert outcome.is_safe
    assert not operator.bench.state.expected.chamber_on


WAIT = """procedure: wait
steps:
  - chamber: {temperature_c: 30, ramp_c_per_min: 5, retries: 5}
  - go_to: {position: z_up, rate_dps: 30, retries: 5}
  - wait: {duration_s: 3000}
"""


@pytest.mark.parametrize("target", ["table", "chamber"])
def test_a_damaged_byte_of_text_trips_nothing(prepared, tmp_path, target):
    thermotron = {"dialect: watlow_f4\n": "dialect: thermotron_8800\n", "  address: 1\n": ""}
    fault = f"fault: damaged_reply, target: {target}, every_s: 60"
    _, outcome, entries = run(prepared(fault, procedure=WAIT, replaced=thermotron), tmp_path)
    assert outcome.ended == "finished", outcome.reason
    assert of(entries, "tripped") == []
    assert len(of(entries, "retry")) > 20  # others are damaged so that they still can be read
