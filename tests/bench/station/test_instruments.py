import gc
import os
import socket
import struct
import threading
import tty
from contextlib import closing
from functools import partial
from types import SimpleNamespace

import pytest

from gyrobench.bench.foundations.clock import VirtualClock, WallClock
from gyrobench.bench.foundations.errors import ConnectionFailedError, NoReplyError
from gyrobench.bench.foundations.shipped import find_document
from gyrobench.bench.station.instruments import CHAMBER, RATE_TABLE, Emulation, Instruments, Outputs, open_ins
from gyrobench.bench.station.station import Station
from gyrobench.drivers.chamber.watlow_f4 import WatlowF4
from gyrobench.drivers.ins.can_bus import INSTRUMENT as INS
from gyrobench.drivers.rate_table.acutrol3000 import Acutrol3000
from gyrobench.drivers.serial_line import SerialLine
from tests.drivers.emulators.forked import served

EMULATED_TABLE = "Acutronic R&D USA,Acutrol3000,0,gyrobench emulator"


@pytest.fixture
def station():
    return Station(find_document("stations", "emulated"))


def test_one_port_that_can_not_be_opened_leaves_the_other_in_use(changed):
    path = changed(("port: emulator://table", "port: /dev/does-not-exist"), ("clock: virtual", "clock: wall"))
    with Outputs(Station(path), VirtualClock()) as outputs:
        with pytest.raises(ConnectionFailedError, match="/dev/does-not-exist"):
            outputs.table.stop()
        outputs.chamber.set_temperature(30.0, None)
        assert outputs.chamber.set_point_c() == 30.0


def test_a_world_given_by_path_is_found_from_any_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "hidden.yaml").touch()
    assert Emulation("hidden.yaml").world == str(tmp_path / "hidden.yaml")
    assert Emulation("ideal").world == "ideal"


@pytest.mark.parametrize("instrument", [RATE_TABLE, CHAMBER, INS])
def test_a_closed_port_is_reopened_and_works(station, instrument):
    clock = VirtualClock()
    with Instruments(station, clock, Emulation("ideal", 0)) as instruments:
        {RATE_TABLE: instruments.table, CHAMBER: instruments.chamber, INS: instruments.ins}[
            instrument
        ].close()
        instruments.reopen(instrument)
        instruments.power_unit(True)
        clock.sleep(20.0)
        assert instruments.table.read().rate_dps == (0.0, 0.0)
        assert instruments.ins.identity()["serial_number"] == 1000


def test_the_frames_of_a_reopened_ins_go_to_whom_they_went_before(station):
    clock, frames = VirtualClock(), []
    with Instruments(station, clock, Emulation("ideal", 0)) as instruments:
        instruments.ins.on_frames = frames.append
        instruments.power_unit(True)
        instruments.reopen(INS)
        clock.sleep(20.0)
        instruments.ins.poll()
        assert frames


def test_an_instrument_that_is_gone_can_not_be_reopened_until_it_is_back(changed, tmp_path):
    port = tmp_path / "port"
    path = changed(("port: emulator://table", f"port: {port}"), ("clock: virtual", "clock: wall"))
    controller, line = os.openpty()
    tty.setraw(line)
    with Outputs(Station(path), WallClock()) as outputs:
        with pytest.raises(ConnectionFailedError, match="rate table: can't open"):
            outputs.reopen(RATE_TABLE)
        port.symlink_to(os.ttyname(line))
        outputs.reopen(RATE_TABLE)
        answer = threading.Thread(target=answer_once, args=(controller,))
        answer.start()
        outputs.table.stop()
        answer.join()
    os.close(controller)
    os.close(line)


@pytest.fixture
def real_ports(changed):
    """A station without emulated instruments."""
    ports = [("port: emulator://table", "port: none"), ("port: emulator://chamber", "port: neither")]
    bus = [("interface: emulator", "interface: virtual"), ("  bitrate: 500000\n", "")]
    return Station(changed(*ports, *bus, ("clock: virtual", "clock: wall")))


@pytest.mark.parametrize("take", ["try_reopen", "exchange", "close"])
def test_a_port_that_hangs_is_opened_by_one_thread_until_its_result_is_taken(real_ports, monkeypatch, take):
    answers, opened, closed, before = threading.Event(), [], [], threading.enumerate()

    def table(*_):
        if opened:
            assert answers.wait(60)
        opened.append(SimpleNamespace(read=list, stop=str, close=partial(closed.append, len(opened))))
        return opened[-1]

    monkeypatch.setattr("gyrobench.bench.station.instruments.open_table", table)
    with Outputs(real_ports, WallClock()) as outputs:
        outputs.table.stop()
        assert not outputs.try_reopen(RATE_TABLE)
        started = [each for each in threading.enumerate() if each not in before]
        (thread,) = (each for each in started if each.name == "limited: rate table")
        assert not outputs.try_reopen(RATE_TABLE)
        answers.set()
        thread.join(60)
        if take == "try_reopen":
            assert outputs.try_reopen(RATE_TABLE)
        if take != "close":
            outputs.table.stop()
    assert (len(opened), closed) == (2, [0, 1])


def test_a_thread_that_hangs_is_abandoned_and_the_port_opened_by_another_one(real_ports, monkeypatch):
    ends, opened = threading.Event(), []

    def table(*_):
        opened.append(SimpleNamespace(read=list, stop=str, close=ends.set))
        assert len(opened) > 1 or ends.wait(60)
        return opened[-1]

    monkeypatch.setattr("gyrobench.bench.station.instruments.open_table", table)
    with Outputs(real_ports, clock := WallClock(speed=1000.0)) as outputs:
        monkeypatch.setattr("gyrobench.bench.station.time_limit._OPENING_TIME_S", 0.01)
        assert not outputs.try_reopen(RATE_TABLE)
        clock.sleep(21.0)
        with pytest.raises(ConnectionFailedError, match=r"did not respond within 20 s"):
            outputs.try_reopen(RATE_TABLE)
        monkeypatch.setattr("gyrobench.bench.station.time_limit._OPENING_TIME_S", 60.0)
        while not outputs.try_reopen(RATE_TABLE):
            clock.sleep(1.0)
        outputs.table.stop()
    assert len(opened) == 2


def test_a_port_that_opens_and_does_not_answer_is_closed_again_by_the_thread(real_ports, monkeypatch):
    closed, before = threading.Event(), threading.enumerate()

    def silent():
        raise NoReplyError(RATE_TABLE, "says nothing")

    table = SimpleNamespace(read=silent, close=closed.set)
    monkeypatch.setattr("gyrobench.bench.station.instruments.open_table", lambda *_: table)
    monkeypatch.setattr("gyrobench.bench.station.instruments._LATE_REPLY_S", 0.01)
    with Outputs(real_ports, WallClock()) as outputs:
        assert not outputs.try_reopen(RATE_TABLE)
        started = [each for each in threading.enumerate() if each not in before]
        (thread,) = (each for each in started if each.name == "limited: rate table")
        thread.join(60)
        assert closed.is_set()
        with pytest.raises(ConnectionFailedError, match="its port is open, but says nothing"):
            outputs.try_reopen(RATE_TABLE)


def answer_once(controller):
    """Say what the table says to a message that it takes."""
    received = b""
    while not received.endswith(b"\r\n"):
        received += os.read(controller, 1000)
    os.write(controller, OK)


#: A reply without error and with the text OK, as the controller frames it.
OK = struct.pack("<II", 0, 2) + b"OK"


def test_a_name_that_no_instrument_has_is_refused(station):
    with Outputs(station, VirtualClock()) as outputs, pytest.raises(ValueError, match="oven"):
        outputs.reopen("oven")


def socketcand_station(changed, port):
    options = f"options: {{host: 127.0.0.1, port: {port}}}"
    return Station(
        changed(
            ("clock: virtual", "clock: wall"),
            ("interface: emulator", "interface: socketcand"),
            ("bitrate: 500000", options),
        )
    )


def test_a_socketcand_server_that_is_not_there_is_reported_at_once(changed):
    with closing(socket.create_server(("127.0.0.1", 0))) as listener:
        port = listener.getsockname()[1]
    with pytest.raises(ConnectionFailedError, match=f"INS: .*no socketcand server at 127.0.0.1:{port}"):
        open_ins(socketcand_station(changed, port), WallClock(), Emulation())


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")  # python-can leaves it open
def test_a_socketcand_server_that_says_nothing_is_given_up(changed, monkeypatch):
    monkeypatch.setattr("gyrobench.bench.station.time_limit._OPENING_TIME_S", 3.0)
    with closing(socket.create_server(("127.0.0.1", 0))) as listener:
        station = socketcand_station(changed, listener.getsockname()[1])
        with pytest.raises(ConnectionFailedError, match="INS: its port did not respond"):
            Instruments(station, WallClock(), Emulation("ideal", 0))
    for thread in threading.enumerate():
        if thread.name == "limited: INS":
            thread.join(20)
    gc.collect()


def test_an_instrument_without_the_identity_of_its_section_is_not_commanded(changed):
    path = changed(("  dialect: watlow_f4\n", "  dialect: watlow_f4\n  identity: model number 5271\n"))
    with Outputs(Station(path), VirtualClock()) as outputs:
        with pytest.raises(ConnectionFailedError, match=r"model number 5270.*lacks 'model number 5271'"):
            outputs.chamber.switch(True)
        outputs.table.stop()


def test_a_damaged_identification_is_asked_again(station, monkeypatch):
    answers, identify = ["Acutronic R&D USA,Acutrol3000,0,gyr#bench emulator"], Acutrol3000.identify
    monkeypatch.setattr(Acutrol3000, "identify", lambda table: answers.pop() if answers else identify(table))
    with Outputs(station, VirtualClock(), identities={RATE_TABLE: EMULATED_TABLE}) as outputs:
        assert outputs.identify(RATE_TABLE) == EMULATED_TABLE
        assert not answers


def test_a_silent_table_may_be_the_right_one_and_is_stopped(station, monkeypatch):
    def silent(table):
        raise NoReplyError(RATE_TABLE, "says nothing")

    monkeypatch.setattr(Acutrol3000, "identify", silent)
    with Outputs(station, VirtualClock(), identities={RATE_TABLE: EMULATED_TABLE}) as outputs:
        outputs.table.stop()
        with pytest.raises(NoReplyError):
            outputs.identify(RATE_TABLE)


@pytest.mark.long
def test_another_chamber_under_the_name_of_the_first_is_not_commanded(changed, tmp_path):
    """Two adapters that came back with exchanged names."""
    benches = [served("--chamber-option", f"model={model}", "--for-s", "600") for model in ("F4P", "F4S")]
    ours, theirs = (urls["chamber"] for _, urls in benches)
    port = tmp_path / "port"
    port.symlink_to(ours)
    path = changed(("port: emulator://chamber", f"port: {port}"), ("clock: virtual", "clock: wall"))
    with Outputs(Station(path), WallClock()) as outputs:
        outputs.identify(CHAMBER)
        outputs.chamber.set_temperature(30.0, None)
        port.unlink()
        port.symlink_to(theirs)
        with pytest.raises(
            ConnectionFailedError, match=r"another instrument answers.*ramps by profiles only"
        ):
            outputs.reopen(CHAMBER)
        with pytest.raises(ConnectionFailedError):
            outputs.chamber.set_temperature(60.0, None)
        with closing(WatlowF4(SerialLine(CHAMBER, theirs, WallClock()))) as chamber:
            assert chamber.set_point_c() == 23.0
        port.unlink()
        port.symlink_to(ours)
        outputs.reopen(CHAMBER)
        assert outputs.chamber.set_point_c() == 30.0
    for process, _ in benches:
        process.close()
