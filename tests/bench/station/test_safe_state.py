import threading
from contextlib import suppress

import numpy as np
import pytest

from gyrobench.bench.foundations.clock import VirtualClock, WallClock
from gyrobench.bench.foundations.errors import NoReplyError, RefusedError
from gyrobench.bench.foundations.shipped import find_document
from gyrobench.bench.station.instruments import Emulation, Instruments, Outputs
from gyrobench.bench.station.safe_state import (
    RAMP_PERIOD_S,
    SafeAction,
    SafePart,
    finish_ramp,
    make_safe,
    repeat,
)
from gyrobench.bench.station.station import Station
from gyrobench.drivers.emulators.bench import BenchAddress, bench_at
from gyrobench.drivers.serial_line import SerialLine


@pytest.fixture
def opened(request, changed):
    """A station whose safe state the test chooses, its instruments and the emulated bench behind them."""
    station, clock = Station(changed(*getattr(request, "param", ()))), VirtualClock()
    with Instruments(station, clock, Emulation("ideal", 0)) as instruments:
        world = str(find_document("worlds", "ideal"))
        yield station, instruments, bench_at(BenchAddress(clock.name, world, 0))


def problems(actions):
    return {action.what: action.problem for action in actions}


def test_a_turning_table_is_stopped_and_opened_and_the_chamber_set(opened):
    station, instruments, bench = opened
    instruments.table.prepare()
    instruments.table.turn_at(2, 10.0)
    instruments.chamber.set_temperature(60.0, None)
    bench.clock.sleep(5.0)
    assert set(problems(make_safe(station, instruments)).values()) == {""}
    assert not any(axis.is_moving(bench.clock.now() + 1.0) for axis in bench.world.axes.values())
    assert bench.serial["table"].feed(b":Interlock? 2\r\n", bench.clock.now()).endswith(b"Open")
    assert instruments.chamber.set_point_c() == 23.0


def test_a_port_that_went_away_is_reopened(opened):
    station, instruments, bench = opened
    instruments.table.prepare()
    instruments.table.turn_at(2, 10.0)
    instruments.table.close()
    instruments.chamber.set_temperature(60.0, None)
    instruments.chamber.close()
    actions = make_safe(station, instruments)
    assert set(problems(actions).values()) == {""}
    assert [bool(action.first_problem) for action in actions] == [True, True, False, False]
    assert not any(axis.is_moving(bench.clock.now() + 1.0) for axis in bench.world.axes.values())
    assert bench.world.air.set_point_c == 23.0


@pytest.mark.parametrize("broken", [RuntimeError("driver bug"), NoReplyError("rate table", "says nothing")])
def test_one_dead_instrument_does_not_keep_the_others_from_their_safe_state(opened, monkeypatch, broken):
    station, instruments, bench = opened
    instruments.chamber.set_temperature(60.0, None)

    def fails(line, data):
        if line.instrument == "rate table":
            raise broken
        write(line, data)

    write = SerialLine.write
    monkeypatch.setattr(SerialLine, "write", fails)
    found = problems(make_safe(station, instruments))
    assert str(broken) in found["rate table stopped"]
    assert str(broken) in found["rate table's servos off"]
    assert found["chamber's set point at 23 degC"] == ""
    assert bench.world.air.set_point_c == 23.0


def test_one_lost_reply_is_asked_again(opened, monkeypatch):
    station, instruments, bench = opened
    instruments.chamber.set_temperature(60.0, None)
    lost = iter([True])

    def loses_one(line, data):
        if line.instrument == "chamber" and next(lost, False):
            raise NoReplyError("chamber", "lost")
        write(line, data)

    write = SerialLine.write
    monkeypatch.setattr(SerialLine, "write", loses_one)
    assert set(problems(make_safe(station, instruments)).values()) == {""}
    assert bench.world.air.set_point_c == 23.0


def test_before_the_first_step_the_table_is_stopped_and_its_servos_stay(opened):
    station, instruments, bench = opened
    instruments.table.prepare()
    actions = make_safe(station, instruments, release_table=False)
    assert [action.what for action in actions] == [
        "rate table stopped", "chamber's set point at 23 degC", "INS left as it is"
    ]  # fmt: skip
    assert bench.serial["table"].feed(b":Interlock? 2\r\n", bench.clock.now()).endswith(b"Close")


def test_what_failed_can_be_tried_alone(opened):
    station, instruments, _ = opened
    (action,) = make_safe(station, instruments, only=["rate table stopped"])
    assert action == SafeAction("rate table stopped", SafePart.TABLE_AT_REST)


def test_a_chamber_that_does_not_control_its_air_is_switched_off_with_its_safe_set_point(opened):
    station, instruments, bench = opened
    for act in (
        lambda: make_safe(station, instruments, chamber_off=True),
        lambda: repeat(station, instruments, [SafeAction("chamber switched off", SafePart.CHAMBER_OFF)], str),
    ):
        instruments.chamber.set_temperature(60.0, None)
        instruments.chamber.switch(True)
        actions = act()
        assert set(problems(actions).values()) == {""}
        assert not bench.world.air.running
        is_repeat = len(actions) == 1
        assert bench.world.air.set_point_c == (60.0 if is_repeat else 23.0)


def test_a_table_that_hangs_does_not_keep_the_chamber_waiting_for_ever(changed, monkeypatch):
    station = Station(changed(("clock: virtual", "clock: wall")))
    monkeypatch.setattr("gyrobench.bench.station.safe_state._EXCHANGE_TIME_S", 3.0)
    monkeypatch.setattr("gyrobench.bench.station.safe_state._RELEASE_TIME_S", 0.5)
    hangs, beats = threading.Event(), []
    monkeypatch.setattr("gyrobench.bench.station.instruments.open_table", lambda *_: hangs.wait(60))
    with Outputs(station, WallClock()) as outputs:
        found = problems(make_safe(station, outputs, meanwhile=lambda: beats.append(1)))
        assert "its port did not respond" in found["rate table stopped"]
        assert found["chamber's set point at 23 degC"] == ""
        assert outputs.chamber.set_point_c() == 23.0
        assert beats
        hangs.set()


@pytest.mark.parametrize(
    "opened", [[("chamber_c: 23", "chamber_c: off"), ("unit: keep", "unit: off")]], indirect=True
)
def test_a_station_may_switch_chamber_and_unit_off(opened):
    station, instruments, bench = opened
    instruments.power_unit(True)
    instruments.chamber.switch(True)
    assert set(problems(make_safe(station, instruments)).values()) == {""}
    assert not bench.world.air.running
    assert not bench.world.thermal.powered


@pytest.mark.parametrize(
    ("action", "text"),
    [
        (SafeAction("rate table stopped", SafePart.TABLE_AT_REST), "rate table stopped"),
        (SafeAction("rate table stopped", SafePart.TABLE_AT_REST, "", "says nothing"), "rate table stopped"),
        (
            SafeAction("rate table stopped", SafePart.TABLE_AT_REST, "says nothing"),
            "FAILED: rate table stopped: says nothing",
        ),
    ],
)
def test_an_action_is_reported_in_one_line_with_why_it_failed(action, text):
    assert action.text == text


def test_a_table_that_does_not_come_to_rest_is_reported_and_its_servos_are_open(opened):
    station, instruments, bench = opened
    instruments.table.prepare()
    instruments.table.turn_at(2, 2.0)
    bench.clock.sleep(5.0)
    bench.world.axes[2].stop = lambda now_s: None
    bench.world.axes[2].release = lambda now_s: None
    action = make_safe(station, instruments)[-1]
    assert action.text.startswith("FAILED: rate table's servos off: rate table: still turns at 2 deg/s")
    assert bench.serial["table"].feed(b":Interlock? 2\r\n", bench.clock.now()).endswith(b"Open")


@pytest.fixture
def ramping(tmp_path):
    """A station, its outputs at 33 degC, and the chamber's controller, which does not ramp its set point."""
    faults = tmp_path / "faults.yaml"
    faults.write_text("faults:\n  - {fault: no_set_point_ramp, at_s: 0}\n")
    station, clock = Station(find_document("stations", "emulated")), VirtualClock()
    with Outputs(station, clock, Emulation("ideal", 0, str(faults))) as outputs:
        outputs.chamber.set_temperature(33.0, None)
        outputs.chamber.switch(True)
        clock.sleep(3600.0)
        yield station, outputs


def finished(station, outputs, actions, during=lambda: None):
    """The actions at the end of a ramp, how long it took, and the longest time between its yields."""
    clock, taken, yields_s = outputs.clock, {action.what: action for action in actions}, []
    begin_s = clock.now()
    for since in finish_ramp(station, outputs, actions):
        taken |= {action.what: action for action in since}
        yields_s.append(clock.now())
        during()
        clock.sleep(RAMP_PERIOD_S)
    return list(taken.values()), clock.now() - begin_s, max(np.diff([begin_s, *yields_s]))


def test_a_ramp_leaves_time_for_signs_of_life_and_counts_as_failed_until_its_end(ramping):
    station, outputs = ramping
    actions = make_safe(station, outputs)
    first = next(finish_ramp(station, outputs, actions))
    assert problems(first) == {"chamber's set point at 23 degC": "is still being ramped"}
    actions, took_s, longest_s = finished(station, outputs, actions)
    assert set(problems(actions).values()) == {""}
    assert outputs.chamber.set_point_c() == 23.0
    assert took_s > 120.0
    assert longest_s < 3.0


@pytest.mark.parametrize("ticks", [False, True], ids=["alone", "with ticks that move it too"])
def test_a_ramp_that_ends_elsewhere_is_a_set_point_that_failed(ramping, ticks):
    station, outputs = ramping
    actions, changes = make_safe(station, outputs), iter([False] * 10 + [True])

    def during():
        if next(changes, False):
            outputs.chamber._chamber.set_temperature(60.0, None)  # at the panel
        if ticks:
            outputs.clock.sleep(RAMP_PERIOD_S)
            with suppress(RefusedError):
                outputs.advance_ramp()

    actions, _, _ = finished(station, outputs, actions, during)
    failed = {what: problem for what, problem in problems(actions).items() if problem}
    assert list(failed) == ["chamber's set point at 23 degC"]
    assert "60" in failed["chamber's set point at 23 degC"]
    repeated = make_safe(station, outputs, only=failed)
    assert set(problems(finished(station, outputs, repeated)[0]).values()) == {""}
    assert outputs.chamber.set_point_c() == 23.0


def test_a_stop_that_failed_is_repeated_within_seconds_of_a_ramp(ramping, monkeypatch):
    station, outputs = ramping
    stops, clock = [], outputs.clock

    def stop(table):
        stops.append(clock.now())
        if clock.now() < stops[0] + 8.0:
            raise NoReplyError("rate table", "says nothing")

    monkeypatch.setattr(type(outputs.table), "stop", stop)
    actions = make_safe(station, outputs)
    assert problems(actions)["rate table stopped"]
    actions, took_s, _ = finished(station, outputs, actions)
    assert set(problems(actions).values()) == {""}
    assert stops[-1] - stops[0] < 20.0 < took_s


def test_a_chamber_that_refuses_its_safe_set_point_is_switched_off_and_not_reported_safe(opened):
    station, instruments, bench = opened
    instruments.chamber.switch(True)
    bench.serial["chamber"].start_profile(85.0)
    (action,) = make_safe(station, instruments, only=["chamber's set point at 23 degC"])
    assert "it was commanded off, as it refuses its set point: runs a profile" in action.problem
    assert not bench.world.air.running
