"""What a rescue does where the chamber's controller does not ramp, on an emulated bench in virtual time."""

import json
import os
import threading
from functools import partial
from types import SimpleNamespace

import pytest

from gyrobench.bench.foundations.clock import VirtualClock
from gyrobench.bench.foundations.errors import ConnectionFailedError, NoReplyError
from gyrobench.bench.foundations.shipped import find_document
from gyrobench.bench.guard.rescue import Rescue
from gyrobench.bench.guard.watching import EngineEnd, EngineProcess, GuardConfig, GuardLog
from gyrobench.bench.runs.folder import RunFolder
from gyrobench.bench.runs.journal import read_journal
from gyrobench.bench.station.instruments import RATE_TABLE, Emulation, Outputs
from gyrobench.bench.station.station import Station
from gyrobench.drivers import serial_line
from gyrobench.drivers.rate_table.acutrol3000 import Acutrol3000
from gyrobench.drivers.serial_line import SerialLine
from tests.bench.guard.served_bench import SmallEngine, is_running, wait_for
from tests.bench.messages.servers import Server, free_port

NO_RAMP = "  - {fault: no_set_point_ramp, at_s: 0}\n"
CHANGED = "  - {fault: set_point_changed_at_panel, at_s: 3660, to_c: 60}\n"
TABLE, CHAMBER = "rate table stopped", "chamber's set point at 23 degC"


@pytest.fixture
def rescued(tmp_path, monkeypatch):
    """Let a guard act on a chamber at 33 degC; returns the bench's outputs, the log and the journal."""
    clock, path = VirtualClock(), find_document("stations", "emulated")

    def rescue(faults, has_log=True):
        listed = tmp_path / "faults.yaml"
        listed.write_text(f"faults:\n{faults}")
        opened = partial(Outputs, emulation=Emulation("ideal", 0, str(listed)))
        monkeypatch.setattr("gyrobench.bench.guard.rescue.Outputs", opened)
        with opened(Station(path), clock) as outputs:
            outputs.chamber.set_temperature(33.0, None)
            outputs.chamber.switch(True)
            clock.sleep(3600.0)
        log = tmp_path / "guard.log"
        config = GuardConfig(str(path), str(tmp_path), 5.0, 0, clock.epoch.isoformat(), 0.0)
        Rescue(config, EngineProcess(0), clock, GuardLog(log, clock)).act(EngineEnd.CLOSED)
        journal = tmp_path / "journal.jsonl"
        entries = list(read_journal(journal)) if journal.exists() else []
        return opened(Station(path), clock), *([log.read_text()] if has_log else []), entries

    return rescue


def test_another_table_under_the_name_of_the_first_is_not_commanded_and_the_chamber_is_safe(
    rescued, tmp_path, monkeypatch
):
    stops = []
    monkeypatch.setattr(Acutrol3000, "stop", stops.append)
    monkeypatch.setattr(Acutrol3000, "release", stops.append)
    monkeypatch.setattr("gyrobench.bench.guard.rescue._PAUSES_S", (0.0, 1.0))
    RunFolder(tmp_path).provenance.write_text(json.dumps({"instruments": {RATE_TABLE: "the first table"}}))
    outputs, log, entries = rescued("  []\n")
    with outputs:
        assert outputs.chamber.set_point_c() == 23.0
    assert not stops
    problems = last_problems(entries[:1])
    assert "in place of the first table" in problems.pop(TABLE)
    assert "in place of the first table" in problems.pop("rate table's servos off")
    assert set(problems.values()) == {""}
    assert "gives up: the bench is NOT in its safe state" in log


def last_problems(entries):
    return {each["what"]: each["problem"] for entry in entries for each in entry["safe_state"]}


def test_a_killed_engine_that_hangs_in_the_kernel_does_not_keep_the_ports(tmp_path, monkeypatch):
    master, slave = os.openpty()
    port, clock = os.ttyname(slave), VirtualClock()
    monkeypatch.setattr(serial_line, "_is_shared", threading.Event())
    config = GuardConfig(str(find_document("stations", "emulated")), str(tmp_path), 5.0, 0, "", 0.0)
    engine = SimpleNamespace(kill=lambda: None, wait_for_end=lambda _: False)
    rescue = Rescue(config, engine, clock, GuardLog(tmp_path / "guard.log", clock))
    with SerialLine("rate table", port, clock):  # of the engine
        with pytest.raises(ConnectionFailedError, match="another program uses it"):
            SerialLine("rate table", port, clock)
        rescue.act(EngineEnd.SILENT)
        SerialLine("rate table", port, clock).close()
    os.close(slave)
    os.close(master)


def test_a_disk_that_hangs_delays_no_safe_action(rescued, tmp_path, monkeypatch):
    monkeypatch.setattr("gyrobench.bench.guard.watching.MAX_DISK_S", 0.1)
    os.mkfifo(tmp_path / "guard.log")  # as a file on a network disk whose server is down: opening it blocks
    outputs, entries = rescued("  []\n", has_log=False)
    with outputs:
        assert outputs.chamber.set_point_c() == 23.0
        assert not outputs.table.read().is_servoed
    assert entries == []


def test_a_ramp_that_failed_is_repeated_until_the_set_point_has_its_safe_value(rescued):
    outputs, log, entries = rescued(NO_RAMP + CHANGED)
    with outputs:
        assert outputs.chamber.set_point_c() == 23.0
    assert f"{CHAMBER}: chamber: its set point was changed" in log
    assert log.splitlines()[-1].endswith("the bench is in its safe state")
    assert set(last_problems(entries).values()) == {""}
    assert entries[-1]["time_s"] > 3660.0 + 120.0


def test_what_failed_is_in_the_journal_at_once_and_repeated_before_the_ramp_ends(rescued, monkeypatch):
    begun_s, stop = [], Acutrol3000.stop

    def fails_at_first(table):
        now_s = table._line.clock.now()
        begun_s.append(now_s)
        if now_s < begun_s[0] + 8.0:
            raise NoReplyError("rate table", "says nothing")
        stop(table)

    monkeypatch.setattr(Acutrol3000, "stop", fails_at_first)
    outputs, log, entries = rescued(NO_RAMP)
    with outputs:
        assert outputs.chamber.set_point_c() == 23.0
    first, repeated, last = entries
    assert last_problems([first])[TABLE] == "rate table: says nothing"
    assert last_problems([first])[CHAMBER] == "is still being ramped"
    assert first["time_s"] - begun_s[0] < 10.0
    assert last_problems([repeated])[TABLE] == ""
    assert repeated["time_s"] - begun_s[0] < 20.0
    assert last_problems([last]) == {CHAMBER: ""}
    assert last["time_s"] - begun_s[0] > 120.0
    assert log.splitlines()[-1].endswith("the bench is in its safe state")


pytestmark = pytest.mark.wall_time


@pytest.fixture
def start_engine_with_webhook(served, tmp_path):
    """Start an engine in small whose station has a webhook at this address."""
    engines = []

    def start(url):
        station = tmp_path / "alarm.yaml"
        text = served.station.path.read_text()
        station.write_text(f"{text}\nmessages:\n  - {{kind: webhook, address: '{url}', on: [ends]}}\n")
        engines.append(SmallEngine(station, tmp_path / "run"))
        return engines[-1]

    yield start
    for engine in engines:
        engine.close()


def test_an_alarm_is_sent_once_the_network_is_up_and_the_bench_does_not_wait_for_it(
    start_engine_with_webhook,
):
    port = free_port()
    engine = start_engine_with_webhook(f"http://127.0.0.1:{port}")
    engine.process.kill()
    wait_for(lambda: "message delayed" in engine.log() and "the bench is in its safe state" in engine.log())
    server = Server(port=port)
    wait_for(lambda: not is_running(engine.guard_pid))
    ((_, _, body),) = server.received
    server.close()
    received = json.loads(body)
    assert (received["event"], received["station"], received["run"]) == ("guard_acted", "emulated", "run")
    assert received["urgent"]
    assert (
        "The engine died without releasing the guard, so the guard acted. The bench is in its safe state."
        in received["why"]
    )
    assert "message sent" in engine.log()
