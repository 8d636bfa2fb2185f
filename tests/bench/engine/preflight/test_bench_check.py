"""Preflights of the emulated bench in virtual time: what passes, and each way in which it does not."""

import re
from pathlib import Path
from types import SimpleNamespace

import can
import numpy as np
import pytest

from gyrobench.bench.engine.preflight.bench_check import (
    check_bench,
    disk_check,
    no_instrument_answers,
    signal_map_checks,
)
from gyrobench.bench.engine.preflight.ins import CanTraffic, _observe, _stream_checks
from gyrobench.bench.foundations.clock import VirtualClock
from gyrobench.bench.foundations.errors import DocumentError
from gyrobench.bench.foundations.shipped import find_document
from gyrobench.bench.procedure.procedure_file import load_procedure
from gyrobench.bench.runs.folder import RunFolder
from gyrobench.bench.station.check_result import CheckVerdict
from gyrobench.bench.station.instruments import Emulation, Outputs, open_ins
from gyrobench.bench.station.station import Station
from gyrobench.drivers import ins
from gyrobench.drivers.emulators import can_interface
from gyrobench.drivers.emulators.bench import BenchAddress, bench_at
from gyrobench.drivers.frames import FrameBlock, concatenate
from tests.bench.engine.stations import absent_station, changed_station


@pytest.fixture
def failures_of(tmp_path):
    """Check the emulated bench with a station file changed at some places; returns failures by what."""

    def check(*changes, procedure=None, world="ideal", faults=""):
        station = changed_station(tmp_path, dict(changes))
        emulation = Emulation(world, 0, _faults_file(tmp_path, faults))
        checks = check_bench(str(station), procedure, emulation, tmp_path)
        return {f"{each.subject}: {each.what}": each for each in checks if each.verdict is CheckVerdict.FAIL}

    return check


def _faults_file(folder, faults):
    if not faults:
        return ""
    (folder / "faults.yaml").write_text(f"faults:\n  - {{{faults}}}\n")
    return str(folder / "faults.yaml")


def test_a_bench_in_order_passes_everything_and_is_left_as_it_was(tmp_path):
    clock = VirtualClock()
    world = str(find_document("worlds", "gyro_a"))
    bench = bench_at(BenchAddress(clock.name, world, 3))
    checks = check_bench("emulated", "six_position_fig7", Emulation("gyro_a", 3), tmp_path, clock)
    assert [each for each in checks if each.verdict is not CheckVerdict.PASS] == []
    assert {each.subject for each in checks} == {"procedure", "rate table", "chamber", "INS", "disk"}
    assert not any(axis.closed for axis in bench.table.axes.values())
    assert [axis.state.position_deg for axis in bench.table.axes.values()] == [0.0, 0.0]
    assert (bench.world.air.running, bench.world.air.set_point_c) == (False, 23.0)
    assert not bench.world.unit.powered
    assert 10.0 < clock.now() < 120.0


def test_a_unit_that_is_on_stays_on(tmp_path):
    clock = VirtualClock()
    bench = bench_at(BenchAddress(clock.name, str(find_document("worlds", "ideal")), 0))
    bench.chamber.feed(bytes.fromhex("01 06 07 DA 00 01 68 85"), 0.0)
    assert bench.world.unit.powered
    clock.sleep(60.0)
    check_bench("emulated", None, Emulation("ideal"), tmp_path, clock)
    assert bench.world.unit.powered


def test_a_unit_that_sends_although_its_supply_is_off_fails(tmp_path):
    clock = VirtualClock()
    bench = bench_at(BenchAddress(clock.name, str(find_document("worlds", "ideal")), 0))
    bench.world.power_unit(True)
    clock.sleep(60.0)
    checks = check_bench("emulated", None, Emulation("ideal"), tmp_path, clock)
    (failed,) = [each for each in checks if each.verdict is CheckVerdict.FAIL]
    assert (failed.what, failed.found) == ("supply", "sends although its output 2 of the chamber is off")


def test_without_a_procedure_what_depends_on_it_is_skipped(tmp_path):
    checks = check_bench("emulated", None, Emulation("ideal"), tmp_path)
    skipped = [each for each in checks if each.verdict is CheckVerdict.SKIPPED]
    assert [each.subject for each in skipped] == ["procedure", "disk"]
    assert all("--procedure" in each.advice for each in skipped)
    assert "MB/h" in skipped[1].found


DIALECTS = {"rate table": "acutrol3000", "chamber": "watlow_f4"}


@pytest.mark.parametrize("subject", DIALECTS)
def test_another_instrument_than_the_one_in_the_station_file_fails(failures_of, subject):
    line = f"dialect: {DIALECTS[subject]}"
    failures = failures_of((line, f"{line}\n  identity: 'no. 4711'"))
    failure = failures.pop(f"{subject}: answers")
    assert list(failures) == (["INS: answers"] if subject == "chamber" else [])  # its output is not commanded
    assert "lacks 'no. 4711'" in failure.found
    assert "Connect the right instrument" in failure.advice


def test_another_unit_than_the_one_in_the_station_file_fails(failures_of):
    other = ("  interface: emulator", "  identity: serial number 77\n  interface: emulator")
    (failure,) = failures_of(other).values()
    assert failure.found == (
        "identifies as serial number 1000, firmware 103, hardware 1, which lacks 'serial number 77'"
    )


FAULTS = {
    "fault: table_trips, at_s: 0": ("rate table: no faults", "rate trip"),
    "fault: interlock_opens, at_s: 0, for_s: 900": ("rate table: no faults", "interlock"),
    "fault: chamber_alarm, at_s: 0": ("chamber: no alarms", "alarm 1"),
    "fault: chamber_sensor_error, at_s: 0, for_s: 900": ("chamber: no alarms", "input 1"),
    "fault: frames_lost, at_s: 0, for_s: 900, share: 0.1": ("INS: frames without gaps", "lost"),
    "fault: second_node, at_s: 0, for_s: 900": ("INS: frames without gaps", "epochs"),
    "fault: frames_lost, at_s: 18, for_s: 900": ("INS: frames without gaps", "missing"),
    "fault: frames_repeated, at_s: 18, for_s: 900": ("INS: frames without gaps", "surplus frames"),
    "fault: bus_off, at_s: 18, for_s: 900": ("INS: frames", "bus"),
    "fault: wrong_crc, at_s: 18, for_s: 900": ("INS: switched off", "CRC"),
    "fault: counter_jump, at_s: 18, by: 500": ("INS: frames without gaps", "1 restarts"),
    "fault: time_stamp_jump, at_s: 18, for_s: 900, by_s: -30": ("INS: CAN time stamps", "jump back 1 times"),
    "fault: temperature_sensor_broken, at_s: 0, for_s: 900, sensor: case": (
        "INS: temperatures",
        "outside the interlock limits",
    ),
    "fault: port_gone, at_s: 0, for_s: 900, target: table": ("rate table: answers", ""),
}


@pytest.mark.parametrize(("fault", "found"), FAULTS.items())
def test_present_faults_fail(failures_of, fault, found):
    what, words = found
    failures = failures_of(faults=fault)
    assert what in failures
    assert words in failures[what].found
    assert failures[what].advice


CHANGES = {
    "rate of the table": (("rate_dps: 30", "rate_dps: 5000"), "rate table: limits", "5000"),
    "angle of the table": (("[-380, 380]", "[-380, 36000]"), "rate table: limits", "-380 to 36000"),
    "jerk of the table": (("jerk_dps3: 120", "jerk_dps3: 1.0e+9"), "rate table: limits", "jerk 1e+09"),
    "set points": (("high_c: 75", "high_c: 130"), "chamber: limits", "-50 to 130"),
    "epochs": (("epoch_period_s: 0.1", "epoch_period_s: 0.2"), "INS: epoch rate", "200 ms"),
    "latitude": (("latitude_deg: 36.4", "latitude_deg: 63.4"), "INS: latitude", "36.4000 deg"),
    "cold air": (("unit: keep", "unit: keep\ninterlocks:\n  chamber_air: {low_c: -60}"), None, ""),
}  # fmt: skip


@pytest.mark.parametrize(("change", "what", "words"), CHANGES.values(), ids=CHANGES)
def test_a_station_file_that_does_not_agree_with_the_instruments_fails(
    failures_of, monkeypatch, change, what, words
):
    monkeypatch.setattr(can_interface, "_check_period", lambda *_: None)  # a real INS can't refuse it
    failures = failures_of(change)
    if what is None:
        assert failures == {}
    else:
        assert what in failures
        assert words in failures[what].found


def test_output_that_is_too_coarse_fails(failures_of, tmp_path):
    dbc = (Path(ins.__file__).parent / "gyrobench_ins.dbc").read_text()
    fine, coarse = "(0.0001,0) [-214748.3648|214748.3647]", "(0.01,0) [-1|1]"
    assert fine in dbc
    (tmp_path / "coarse.dbc").write_text(dbc.replace(fine, coarse))
    failures = failures_of(("dbc: gyrobench_ins.dbc", "dbc: coarse.dbc"))
    assert "0.01 m/s" in failures["INS: resolution"].found
    assert "Map a finer output" in failures["INS: resolution"].advice


def test_a_procedure_beyond_the_limits_fails_and_the_instruments_are_still_checked(failures_of, tmp_path):
    path = tmp_path / "hot.yaml"
    hot = "  - chamber: {temperature_c: 90, ramp_c_per_min: 1}\n"
    path.write_text(find_document("procedures", "ten_minute_check").read_text() + hot)
    failures = failures_of(procedure=str(path))
    assert list(failures) == ["procedure: within limits"]
    assert "hot.yaml" in failures["procedure: within limits"].found


def test_a_procedure_that_sends_a_command_which_the_ins_lacks_fails_with_the_key_to_add(failures_of):
    lost = "    navigate: {message: INS_COMMAND, values: {COMMAND: 3, ARGUMENT: 0}}\n"
    failures = failures_of((lost, ""), procedure="ten_minute_check")
    assert "ten_minute_check.yaml:16:5" in failures["procedure: within limits"].found
    assert "Add ins.commands.navigate to the station file" in failures["procedure: within limits"].found


def test_a_mode_that_the_signal_map_lacks_fails_with_its_value(failures_of):
    failures = failures_of(("standby: 1, align", "standby: 7, align"))
    assert "(INS_STATUS.MODE is 1, no value of ins.signals.mode)" in failures["INS: mode"].found


@pytest.mark.parametrize(
    ("east", "north", "are_signs_tested", "verdict", "words"),
    [
        (0.9, 0.9, True, CheckVerdict.PASS, "agree with the tilt"),
        (0.9, 0.9, False, CheckVerdict.SKIPPED, "not tested; scale of the velocities 0.90 ± 0.20, of one"),
        (
            0.0,
            1.0,
            True,
            CheckVerdict.SKIPPED,
            "a velocity has a doubtful scale; scale of the velocities 0.50 ± 0.20, of one",
        ),
        (1.0, 0.0, True, CheckVerdict.SKIPPED, "of one alone: East 1.00 ± 0.28, North 0.00 ± 0.28"),
        (-0.1, -0.1, False, CheckVerdict.FAIL, "do not follow from the tilt of the INS; scale of the"),
    ],
)
def test_a_dwell_whose_velocities_may_have_a_wrong_sign_or_scale_never_passes(
    tmp_path, east, north, are_signs_tested, verdict, words
):
    velocities = SimpleNamespace(matrix=np.array([east, 0.0, 0.0, north]), covariance=0.08 * np.eye(4))
    dwell = SimpleNamespace(
        estimate=object(), are_signs_tested=are_signs_tested, evidence=SimpleNamespace(velocities=velocities)
    )
    (check,) = signal_map_checks(SimpleNamespace(units={}, dwells=[dwell]), RunFolder(tmp_path))
    assert check.verdict is verdict
    assert words in check.found
    assert check.found.endswith(f". Run folder: {tmp_path}")
    assert ("signs and scale of velocities" in check.advice) == (verdict is not CheckVerdict.PASS)


def test_values_of_a_new_station_file_that_are_not_filled_in_are_named(failures_of):
    failures = failures_of(("description: >\n  The", "description: >\n  fill_in: the"))
    assert failures["station: file filled in"].found == "not filled in yet: description"


@pytest.mark.parametrize(
    ("old", "new", "subject", "what", "advice"),
    [
        ("power: chamber_event", "power: operator", "INS", "answers", "Switch it on"),
        (
            "    latitude: POSITION.LATITUDE\n", "", "INS", "latitude",
            "compare the one entered in it with location.latitude_deg",
        ),
    ],
)  # fmt: skip
def test_what_only_the_operator_can_do_is_skipped(tmp_path, old, new, subject, what, advice):
    station = changed_station(tmp_path, {old: new})
    checks = check_bench(str(station), None, Emulation("ideal"), tmp_path)
    (check,) = [each for each in checks if (each.subject, each.what) == (subject, what)]
    assert check.verdict is CheckVerdict.SKIPPED
    assert advice in check.advice


def test_a_chamber_at_another_address_fails_with_its_address_and_the_unit_with_its_supply(failures_of):
    failures = failures_of(("  address: 1\n", "  address: 5\n"))
    assert "set to this baud rate and Modbus address 5?" in failures["chamber: answers"].found
    assert failures["INS: answers"].found.startswith("not switched on: the chamber, whose output feeds it,")


def test_frames_that_are_not_in_the_dbc_file_lead_to_that_file(failures_of, tmp_path):
    shipped = (Path(ins.__file__).parent / "gyrobench_ins.dbc").read_text()
    moved = re.sub(
        r"^((?:BO_|VAL_|SIG_VALTYPE_|CM_ BO_|CM_ SG_|BA_.* BO_) )(\d+)",
        lambda found: f"{found[1]}{int(found[2]) + 1024}",
        shipped,
        flags=re.MULTILINE,
    )
    (tmp_path / "own.dbc").write_text(moved)
    found = failures_of(("  dbc: gyrobench_ins.dbc", "  dbc: own.dbc"))["INS: answers"].found
    assert "frames arrive, such as 0x001, but none that is in the DBC file" in found
    assert found.endswith("Check its power, the DBC file and ins.identifier_offset.")


@pytest.mark.parametrize(("kind", "found"), [("is_remote_frame", ""), ("is_error_frame", "error frames")])
def test_error_frames_fail_and_remote_frames_do_not(failures_of, monkeypatch, kind, found):
    receive = can_interface.EmulatorBus.recv_block

    def recv_block(bus):
        block = receive(bus)
        stamps_s = block.timestamp_s[:1].tolist()
        others = [
            can.Message(each_s, 0x700, is_extended_id=False, dlc=8, **{kind: True}) for each_s in stamps_s
        ]
        return concatenate([FrameBlock.from_messages(others), block])

    monkeypatch.setattr(can_interface.EmulatorBus, "recv_block", recv_block)
    failures = failures_of()
    assert list(failures) == (["INS: frames without gaps"] if found else [])
    assert all(found in each.found for each in failures.values())


def test_a_silent_unit_that_is_always_on_fails(failures_of):
    failures = failures_of(("power: chamber_event", "power: always_on"))
    assert list(failures) == ["INS: answers"]
    assert "sends nothing" in failures["INS: answers"].found


def test_a_real_bench_with_the_gravity_of_an_emulated_one_fails_and_each_instrument_that_is_not_there(
    tmp_path,
):
    checks = check_bench(str(absent_station(tmp_path)), None, Emulation(), tmp_path)
    failed = [each for each in checks if each.verdict is CheckVerdict.FAIL]
    assert [each.subject for each in failed] == ["station", "rate table", "chamber", "INS"]
    assert "gravity_uncertainty_mps2 is 1e-06 without gravity_mps2" in failed[0].found
    assert "/dev/no_table" in failed[1].found
    assert no_instrument_answers(checks)


def test_a_run_that_does_not_fit_on_the_disk_fails(tmp_path):
    station = Station(find_document("stations", "emulated"))
    document, model = load_procedure(find_document("procedures", "six_position_fig7"))
    plan = station.plan(document, model)
    assert disk_check(station, tmp_path / "not" / "there", plan, 40.0).verdict is CheckVerdict.PASS
    check = disk_check(station, tmp_path / "not" / "there", plan, 1e9)
    assert check.verdict is CheckVerdict.FAIL
    assert f"free at {tmp_path}" in check.found
    assert "45:27 h need" in check.found


def test_a_folder_that_can_not_be_written_fails(tmp_path, monkeypatch):
    monkeypatch.setattr("os.access", lambda path, mode: False)  # root may write to every folder
    check = disk_check(Station(find_document("stations", "emulated")), tmp_path / "runs", None, 40.0)
    assert check.verdict is CheckVerdict.FAIL
    assert check.found == f"{tmp_path} can't be written by this user"


def test_a_wrong_station_file_is_refused_before_anything_is_opened(tmp_path):
    (tmp_path / "station.yaml").write_text("station: x\n")
    with pytest.raises(DocumentError):
        check_bench(str(tmp_path / "station.yaml"), None, Emulation(), tmp_path)


@pytest.mark.parametrize(("stalls", "verdict"), [(1, CheckVerdict.PASS), (20, CheckVerdict.FAIL)])
def test_one_late_epoch_is_no_fault_and_many_are(stalls, verdict):
    """A stall of this computer for 0.25 s delivers the frames of that time together at its end."""
    clock = VirtualClock()
    station = Station(find_document("stations", "emulated"))
    with Outputs(station, clock, Emulation("ideal")) as outputs:
        outputs.power_unit(True)
        ins = open_ins(station, clock, Emulation("ideal"))
        clock.sleep(60.0)
        ins.poll()
        traffic = CanTraffic()
        _observe(ins, clock, 0.1, traffic)
        begin_s = traffic.blocks[0].timestamp_s[0] + 1.0
        for index, block in enumerate(traffic.blocks):
            time_s = block.timestamp_s.copy()
            for stall in range(stalls):
                stalled_s = begin_s + 0.4 * stall
                time_s[(time_s >= stalled_s) & (time_s < stalled_s + 0.25)] = stalled_s + 0.25
            traffic.blocks[index] = block.with_fields(time_s=time_s)
        checks = {each.what: each for each in _stream_checks(station, outputs, ins, clock, traffic)}
        ins.close()
    found = checks["frames without gaps"]
    assert found.verdict is verdict
    assert " late" in found.found
