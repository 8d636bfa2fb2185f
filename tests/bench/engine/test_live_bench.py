"""The bench between ticks: frames that are lost, frames that stop."""

import math
import os
import re
import threading
import tty
from contextlib import closing, contextmanager
from itertools import cycle
from threading import Event
from types import SimpleNamespace

import can
import numpy as np
import pytest

from gyrobench.bench.engine.actions import _wait_until_sending
from gyrobench.bench.engine.interlocks.watch import text_of_trips
from gyrobench.bench.engine.live_bench import LiveBench
from gyrobench.bench.engine.step_context import StepContext
from gyrobench.bench.foundations.clock import VirtualClock, WallClock
from gyrobench.bench.foundations.errors import ConnectionFailedError, NoReplyError, ReplyError
from gyrobench.bench.foundations.shipped import find_document
from gyrobench.bench.runs.can_log import CanLog, read_can_log
from gyrobench.bench.station.instruments import RATE_TABLE, Emulation, Instruments
from gyrobench.bench.station.station import Station
from gyrobench.drivers.chamber import ChamberReading
from gyrobench.drivers.emulators.bench import BenchAddress, bench_at
from gyrobench.drivers.frames import FrameBlock, concatenate
from gyrobench.drivers.rate_table import TableReading
from tests.bench.engine.stations import changed_station, served_station
from tests.drivers.ins.test_text_buses import Slcan


@contextmanager
def live_bench(can_log=None, faults=""):
    """A started bench whose INS sends, and what was reported of it. ``faults``: path of their file."""
    clock, reported = VirtualClock(), []
    station = Station(find_document("stations", "quick"))
    with Instruments(station, clock, Emulation("quick", 0, str(faults))) as instruments:
        logs = [(can_log, None)] if can_log else []
        bench = LiveBench(station, instruments, clock, logs, lambda *each: reported.append(each))
        instruments.power_unit(True)
        bench.start()
        while bench.readings.ins.age_s > 1.0:
            bench.tick()
        reported.clear()
        yield bench, reported


def test_lost_frames_are_reported_and_do_not_reopen_a_bus_that_gives_others(monkeypatch):
    with live_bench() as (bench, reported):
        ins, clock = bench.instruments.ins, bench.clock
        poll, opened = ins.poll, []

        def lossy():
            poll()
            raise ReplyError("INS", "7 frames are lost")

        monkeypatch.setattr(ins, "poll", lossy)
        monkeypatch.setattr(ins._bus, "keeps_frames", False)
        monkeypatch.setattr(ins, "replace_bus", opened.append)
        begin_s = clock.now()
        while clock.now() < begin_s + 60.0:
            bench.tick()
            assert bench.silent == ()
        errors = [str(error) for instrument, error in reported if instrument == "INS" and error]
        assert 5 <= len(errors) <= 7
        assert set(errors) == {"INS: 7 frames are lost"}
        assert not opened


def test_the_last_frames_before_an_ins_falls_silent_are_in_the_log_seconds_later(tmp_path):
    log = CanLog(tmp_path)
    with live_bench(log) as (bench, _):
        bench.instruments.power_unit(False)
        end_s = bench.clock.now() + 12.0
        while bench.clock.now() < end_s:
            bench.tick()
        logged = sum(len(block) for _, block in read_can_log(tmp_path))
        assert logged == bench.instruments.ins.frames > 0
    log.cut()


def test_a_bus_that_gives_nothing_but_invalid_bytes_is_reopened(monkeypatch):
    with live_bench() as (bench, reported):
        ins, clock = bench.instruments.ins, bench.clock
        replace, opened = ins.replace_bus, []

        def garbled():
            raise ReplyError("INS", "received bytes are no CAN frame")

        def replaced(bus):
            opened.append(bus)
            replace(bus)
            monkeypatch.undo()

        monkeypatch.setattr(ins, "poll", garbled)
        monkeypatch.setattr(ins, "replace_bus", replaced)
        begin_s = clock.now()
        while not opened:
            bench.tick()
            assert clock.now() < begin_s + 60.0
        bench.tick()
        assert bench.silent == ()
        assert reported[-1] == ("INS", None)


def test_a_silent_bus_is_reopened_between_ticks_and_answers_again_with_its_first_frame(monkeypatch):
    with live_bench() as (bench, reported):
        ins, clock = bench.instruments.ins, bench.clock
        bench.units[0].state.powered()
        replace, opened = ins.replace_bus, []

        def replaced(bus):
            opened.append(clock.now())
            replace(bus)
            if len(opened) == 3:
                monkeypatch.undo()

        monkeypatch.setattr(ins, "poll", lambda: concatenate([]))  # as of a half-open connection
        monkeypatch.setattr(ins, "replace_bus", replaced)
        begin_s = clock.now()
        while len(opened) < 3:
            monkeypatch.setattr(ins._bus, "keeps_frames", False)
            bench.tick()
            assert clock.now() < begin_s + 60.0
        assert [error is None for _, error in reported] == [False]
        while bench.silent:
            bench.tick()
        assert [error is None for _, error in reported] == [False, True]
        assert bench.readings.ins.age_s < 2.0


def test_a_bus_that_was_away_when_the_bench_was_read_is_no_restart_of_the_ins():
    with live_bench() as (bench, _):
        bus, unit = bench_at(BenchAddress(bench.clock.name, "quick")).units[0].connection, bench.units[0]
        unit.state.powered()
        bus.disconnect()
        bench.clock.sleep(4.5)
        bench.read_instruments()
        assert 4.0 < bench.readings.ins.age_s < 5.0
        bus.reconnect()
        bench.clock.sleep(2.0)
        while bench.silent or bench.readings.ins.age_s > 1.0:
            bench.tick()
        assert not unit.state.has_restarted


def test_time_in_which_nothing_was_asked_is_no_silence(monkeypatch):
    """As where the process is stopped, the computer suspended, or another instrument blocks."""
    with live_bench() as (bench, reported):
        bench.units[0].state.powered()
        chamber, blocks_s = bench.instruments.chamber, [100.0]
        read = chamber.read

        def blocking():
            bench.clock.sleep(blocks_s.pop() if blocks_s else 0.0)
            return read()

        monkeypatch.setattr(chamber, "read", blocking)
        bench.read_instruments()
        assert bench.clock.now() - bench.readings.table_s == pytest.approx(100.0, abs=1.0)
        assert bench.trips() == []
        bench.clock.sleep(100.0)
        assert bench.trips() == []
        assert reported == []


def test_an_instrument_that_did_not_answer_after_such_a_time_is_silent(monkeypatch):
    with live_bench() as (bench, _):

        def silent():
            raise NoReplyError("rate table", "no reply")

        monkeypatch.setattr(bench.instruments.table, "read", silent)
        bench.clock.sleep(100.0)
        assert [trip.name for trip in bench.trips()] == ["table_silence"]


def test_a_faulty_sensor_of_the_chamber_is_an_alarm_and_its_last_temperature_grows_old():
    with live_bench() as (bench, _):
        before = bench.readings
        chamber = bench_at(BenchAddress(bench.clock.name, "quick")).chamber
        chamber.break_sensor(1)
        bench.clock.sleep(10.0)
        bench.read_instruments()
        after = bench.readings
        assert after.chamber.alarms == ("error 1 of input 1 (register 101); check the temperature sensor",)
        assert (after.chamber.temperature_c, after.chamber_s) == (
            before.chamber.temperature_c, before.chamber_s,
        )  # fmt: skip
        assert bench.silent == ()
        chamber.repair_sensor()
        bench.instruments.chamber.clear_alarms()
        bench.read_instruments()
        assert bench.readings.chamber.alarms == ()
        assert bench.readings.chamber_s > before.chamber_s


def test_ticks_that_are_late_by_different_times_do_not_change_the_period_of_readings(monkeypatch):
    """As in real time, where a tick that is less late than the one before is no reason to skip a reading."""
    with live_bench() as (bench, _):
        sleep_until, late_s, readings_s = bench.clock.sleep_until, cycle((0.02, 0.01)), []
        monkeypatch.setattr(bench.clock, "sleep_until", lambda time_s: sleep_until(time_s + next(late_s)))
        end_s = bench.clock.now() + 100.0
        while bench.clock.now() < end_s:
            bench.tick()
            if bench.readings.polled_s not in readings_s:
                readings_s.append(bench.readings.polled_s)
        assert np.diff(readings_s[1:]) == pytest.approx(bench.station.file.instruments_period_s, abs=0.1)


def test_a_lost_port_is_reopened_soon_at_first_then_every_five_seconds(monkeypatch):
    with live_bench() as (bench, _):
        bus, attempts_s = bench_at(BenchAddress(bench.clock.name, "quick")).units[0].connection, []
        reopen = bench.instruments.reopen

        def noted(instrument):
            attempts_s.append(bench.clock.now())
            reopen(instrument)

        def gaps_of_a_loss():
            attempts_s.clear()
            bus.disconnect()
            while len(attempts_s) < 8:
                bench.tick()
                bus.disconnect()  # also from the port that has just been opened
                bench.units[0].status()
            bus.reconnect()
            return np.diff(attempts_s)

        monkeypatch.setattr(bench.instruments, "reopen", noted)
        first = gaps_of_a_loss()
        assert first[:2].max() <= 2.0, "at the next tick"
        assert (np.diff(first) >= 0.0).all()
        assert first[-1] == pytest.approx(6.0), "the first tick after 5 s"
        while bench.silent or bench.clock.now() < attempts_s[-1] + 60.0:
            bench.tick()
        assert gaps_of_a_loss().tolist() == first.tolist()


def test_a_table_that_does_not_answer_blocks_the_ticks_about_half_of_the_time(tmp_path):
    """Each of its time-outs takes seconds, in which no interlock of the chamber or the INS is evaluated."""
    (tmp_path / "faults.yaml").write_text(
        "faults:\n  - {fault: lost_request, target: table, at_s: 100, for_s: 300}\n"
    )
    with live_bench(faults=tmp_path / "faults.yaml") as (bench, _):
        bench.instruments.identify("rate table")
        clock, tick_s, late_s = bench.clock, bench.station.file.tick_s, []
        while clock.now() < 400.0:
            due_s = tick_s * (math.floor(clock.now() / tick_s + 1e-9) + 1)
            bench.tick()
            late_s.append(clock.now() - due_s)
        assert bench.silent == ("rate table",)
        assert sum(late_s) < 0.6 * 300.0
        assert max(late_s) < 8.0
        while bench.silent:
            bench.tick()
        assert clock.now() < 420.0


def test_a_silent_instrument_whose_port_is_gone_is_reported_with_the_present_problem_of_the_port(tmp_path):
    """As an adapter that came back under another name."""
    (tmp_path / "faults.yaml").write_text(
        "faults:\n  - {fault: port_gone, target: table, at_s: 60, for_s: 300}\n"
    )
    with live_bench(faults=tmp_path / "faults.yaml") as (bench, _):
        texts = []
        while bench.clock.now() < 400.0:
            bench.tick()
            texts += [text_of_trips(trips)] if (trips := bench.trips()) else []
        assert texts
        problem = r"limit is \d+ s\. Can't open emulator://table: .* Check the station file's port and the"
        assert all(re.search(problem, text) for text in texts)
        assert not bench.silent


def test_bus_errors_of_an_ins_that_is_silent_or_does_not_start_are_named():
    with live_bench() as (bench, _):
        ins, clock, notes = bench.instruments.ins, bench.clock, []
        unit = SimpleNamespace(live=bench.units[0], note=notes.append)
        unit.live.state.powered()
        bench.instruments.power_unit(False)
        errors = FrameBlock.from_messages([can.Message(arbitration_id=0x40, is_error_frame=True, dlc=8)])
        bench.tick()
        ins._bus._blocks.append(errors)
        while not bench.trips():
            bench.tick()
        assert re.search(
            r"the limit is 5 s\. The adapter is bus-off after .*\. Check bit rate, ",
            text_of_trips(bench.trips()),
        )
        for _ in _wait_until_sending(unit, bench):
            bench.tick()
            if notes or clock.now() > 200.0:
                break
        (note,) = notes
        assert note.startswith("the INS has not started; the adapter is bus-off after too many errors")


def test_frames_of_other_nodes_are_not_named_as_the_reason_of_an_ins_that_sends_while_it_boots(monkeypatch):
    with live_bench() as (bench, _):
        ins, clock, notes = bench.instruments.ins, bench.clock, []
        unit = SimpleNamespace(live=bench.units[0], note=notes.append)
        monkeypatch.setattr(unit.live, "has_started", lambda: False)
        monkeypatch.setattr(bench, "reopen", lambda _: None)
        ins._bus._blocks.append(FrameBlock.from_messages([can.Message(arbitration_id=0x700, dlc=8)]))
        begin_s = clock.now()
        for _ in _wait_until_sending(unit, bench):
            bench.tick()
            if notes or clock.now() > begin_s + 60.0:
                break
        assert ins.has_foreign_frames
        assert notes == []


@pytest.fixture
def threaded(tmp_path, monkeypatch):
    """A started bench without emulators; its table's port opens when ``answers`` is set."""
    changes = {
        "port: emulator://table": "port: none",
        "port: emulator://chamber": "port: neither",
        "interface: emulator": "interface: virtual",
        "  bitrate: 500000\n": "",
        "clock: virtual": "clock: wall",
    }
    station, clock = Station(changed_station(tmp_path, changes)), WallClock(speed=20.0)
    reading, answers, opened = TableReading((0.0, 0.0), (0.0, 0.0), is_servoed=True, faults=()), Event(), []
    chamber = SimpleNamespace(read=lambda: ChamberReading(20.0, alarms=()), close=str)

    def table(*_):
        assert answers.wait(60)
        opened.append(SimpleNamespace(read=lambda: reading, stop=str, close=str))
        return opened[-1]

    monkeypatch.setattr("gyrobench.bench.station.instruments.open_table", table)
    monkeypatch.setattr("gyrobench.bench.station.instruments.open_chamber", lambda *_: chamber)
    answers.set()
    with Instruments(station, clock, Emulation("ideal", 0)) as instruments:
        bench = LiveBench(station, instruments, clock, [], lambda *_: None)
        bench.start()
        yield bench, answers, opened


def test_a_port_whose_reopening_an_exchange_awaited_is_not_reopened_again(threaded):
    bench, answers, opened = threaded
    answers.clear()
    bench.handle_failure(NoReplyError(RATE_TABLE, "no reply"))
    bench.tick()
    assert bench.is_reopening(RATE_TABLE)
    answers.set()
    bench.instruments.table.stop()
    while bench.silent or bench.is_reopening(RATE_TABLE):
        bench.tick()
    assert len(opened) == 2


def test_a_port_that_opens_late_is_not_reopened_before_it_is_asked(threaded):
    """Its opening takes longer than the longest pause between two attempts."""
    bench, answers, opened = threaded
    answers.clear()
    bench.handle_failure(NoReplyError(RATE_TABLE, "no reply"))
    end_s = bench.clock.now() + 8.0
    while bench.clock.now() < end_s:
        bench.tick()
    (thread,) = (each for each in threading.enumerate() if each.name == "limited: rate table")
    answers.set()
    thread.join(60)
    while bench.silent:
        bench.tick()
    assert len(opened) == 2


def test_a_silent_ins_whose_port_is_open_again_is_not_reported_with_the_earlier_problem(
    threaded, monkeypatch
):
    bench, _, _ = threaded
    (unit,), problems = bench.units, [ConnectionFailedError("INS", "can't open can0")]
    bus = SimpleNamespace(shutdown=str, recv=lambda _: None)

    def open_bus(*_):
        if problems:
            raise problems.pop()
        return bus

    monkeypatch.setattr("gyrobench.bench.station.instruments._open_ins_bus", open_bus)
    unit.state.powered()
    texts = []
    while unit.ins._bus is not bus:
        bench.tick()
        texts.append(text_of_trips(bench.trips()))
    assert any("Can't open can0" in text for text in texts[:-1])
    assert "an't open can0" not in text_of_trips(bench.trips())


def test_a_command_waits_until_the_bus_of_its_unit_is_open_again(threaded, monkeypatch):
    bench, _, _ = threaded
    (unit,), opens, failed = bench.units, Event(), []
    bus = SimpleNamespace(shutdown=str, recv=lambda _: None)

    def open_bus(*_):
        assert opens.wait(60)
        return bus

    def poll(measured):
        measured.live.ins.poll()
        yield

    monkeypatch.setattr("gyrobench.bench.station.instruments._open_ins_bus", open_bus)
    unit.ins.close()
    bench.reopen(unit.name)
    measured = type("Measured", (), {"live": unit})()
    units = SimpleNamespace(measuring=[measured], fail=lambda *each: failed.append(each))
    ticks = StepContext(SimpleNamespace(bench=bench), units).command_all(poll)
    next(ticks)
    opens.set()
    for _ in ticks:
        bench.tick()
    assert not failed
    assert unit.ins._bus is bus


def test_a_command_is_not_sent_to_a_unit_that_is_dropped_while_its_bus_is_reopened(threaded, monkeypatch):
    bench, _, _ = threaded
    (unit,), opens, sent = bench.units, Event(), []
    bus = SimpleNamespace(shutdown=str, is_shut_down=False)

    def open_bus(*_):
        assert opens.wait(60)
        return bus

    def send(measured):
        sent.append(measured)
        yield

    monkeypatch.setattr("gyrobench.bench.station.instruments._open_ins_bus", open_bus)
    bench.reopen(unit.name)
    units = SimpleNamespace(measuring=[type("Measured", (), {"live": unit})()])
    for _ in StepContext(SimpleNamespace(bench=bench), units).command_all(send):
        bench.tick()
        units.measuring.clear()
        bench.leave_out(unit)
    opens.set()
    assert not sent


def test_a_command_waits_until_the_port_of_its_instrument_is_open_again_between_ticks(threaded):
    bench, answers, opened = threaded
    answers.clear()
    bench.reopen(RATE_TABLE)
    context = StepContext(SimpleNamespace(bench=bench), None)
    ticks = context.with_retries(lambda: bench.instruments.table.stop())
    for _ in range(3):
        next(ticks)
        bench.tick()
    answers.set()
    for _ in ticks:
        bench.tick()
    assert len(opened) == 2


def test_a_command_does_not_use_its_retries_up_while_the_port_of_its_instrument_is_lost(
    threaded, monkeypatch
):
    bench, _, _ = threaded
    problems, tries = [ConnectionFailedError(RATE_TABLE, "can't open it")] * 3, []

    def table(*_):
        if problems:
            raise problems.pop()
        return SimpleNamespace(read=lambda: bench.readings.table, stop=str, close=str)

    def stop():
        tries.append(len(problems))
        bench.instruments.table.stop()

    monkeypatch.setattr("gyrobench.bench.station.instruments.open_table", table)
    bench.handle_failure(NoReplyError(RATE_TABLE, "no reply"))
    bench.tick()
    for _ in StepContext(SimpleNamespace(bench=bench), None).with_retries(stop):
        bench.tick()
    assert tries == [0]


def test_the_bus_of_a_unit_that_is_dropped_while_it_is_reopened_stays_closed(threaded, monkeypatch):
    bench, _, _ = threaded
    (unit,), opens, closed = bench.units, Event(), []
    bus = SimpleNamespace(shutdown=lambda: closed.append(True), is_shut_down=False)

    def open_bus(*_):
        assert opens.wait(60)
        return bus

    monkeypatch.setattr("gyrobench.bench.station.instruments._open_ins_bus", open_bus)
    bench.reopen(unit.name)
    (thread,) = (each for each in threading.enumerate() if each.name == f"limited: {unit.name}")
    bench.leave_out(unit)
    opens.set()
    thread.join(60)
    bench._reopen()
    assert closed
    assert not bench.silent
    assert not bench.is_reopening(unit.name)


@pytest.mark.long
@pytest.mark.wall_time
@pytest.mark.parametrize("link", ["table", "chamber", "ins"])
def test_a_port_that_hangs_does_not_keep_the_ticks_from_the_other_instruments(tmp_path, link):
    """As a serial server that accepts a connection and does not answer."""
    controller, silent = os.openpty()
    tty.setraw(silent)
    with served_station(tmp_path, speed=10) as path:
        station = Station(path).file
        port = {"table": station.rate_table.port, "chamber": station.chamber.port, "ins": station.ins.channel}
        (tmp_path / link).symlink_to(port[link])
        path.write_text(path.read_text().replace(port[link], str(tmp_path / link)))
        clock = WallClock(speed=10.0)
        with Instruments(Station(path), clock, Emulation("ideal", 0)) as instruments:
            bench = LiveBench(Station(path), instruments, clock, [], lambda *_: None)
            instruments.power_unit(True)
            bench.start()
            bench.units[0].state.powered()
            opened = {"table": instruments.table, "chamber": instruments.chamber, "ins": instruments.ins}
            (tmp_path / link).unlink()
            (tmp_path / link).symlink_to(os.ttyname(silent))
            opened[link].close()
            while not bench.silent:
                bench.tick()
            missed = bench.lateness.summary()["missed"]  # in the exchange that failed
            for _ in range(40):
                bench.tick()
                if link != "table":
                    assert clock.now() - bench.readings.table_s < 5.0
            assert bench.silent
            if link != "ins":
                reason = text_of_trips(bench.trips())
                assert "Its port is open, but " in reason
                assert "Check its power, cable and port." not in reason
            assert bench.lateness.summary()["missed"] <= missed + 10
            (tmp_path / link).unlink()
            (tmp_path / link).symlink_to(port[link])
            while bench.silent:
                bench.tick()
    os.close(controller)
    os.close(silent)


@pytest.mark.parametrize(
    ("fault", "shows_two_nodes"),
    [
        ("second_node, for_s: 60", True),
        ("frames_out_of_order, share: 0.5, for_s: 60", False),
        ("frames_repeated, share: 0.5, for_s: 60", False),
        ("frames_lost, share: 0.5, for_s: 60", False),
        ("frames_corrupted, share: 0.5, bits: 2, for_s: 60", False),
        ("counter_jump, by: 1000", False),
        ("ins_restarts", False),
    ],
)
def test_a_second_node_with_the_same_identifiers_is_named(tmp_path, fault, shows_two_nodes):
    (tmp_path / "faults.yaml").write_text(f"faults:\n  - {{fault: {fault}, at_s: 60}}\n")
    with live_bench(faults=tmp_path / "faults.yaml") as (bench, _):
        texts = []
        while bench.clock.now() < 130.0:
            bench.tick()
            texts += filter(None, [bench.instruments.ins.describe_second_node()])
        assert (len(texts) > 20) == shows_two_nodes
        problem = (
            "two nodes send the frames of the INS: its count of epochs (HEADING.EPOCH_COUNTER) jumps back"
        )
        assert all(text.startswith(problem) for text in texts)
        assert shows_two_nodes or not texts


def test_a_bus_of_one_of_several_units_that_gives_invalid_bytes_is_reopened():
    clock, station = VirtualClock(), Station(find_document("stations", "four_units"))
    with (
        Instruments(station, clock, Emulation("four_units", 0)) as instruments,
        closing(Slcan("pty")) as adapter,
    ):
        bench = LiveBench(station, instruments, clock, [], lambda *_: None)
        bench.start()
        instruments.units["INS 1102"].replace_bus(adapter.open())
        adapter.send(b"t00zgarbage\r")
        while not bench.silent:
            bench.poll_units()
        assert bench.silent == ("INS 1102",)
        while bench.silent:
            bench.tick()
