"""Commands that fail: the safe state is repeated in the hold, and nothing counts as done before it is."""

import pytest

from gyrobench.bench.engine.job import prepare_job
from gyrobench.bench.engine.operator import ConsentingOperator
from gyrobench.bench.engine.run import run_job
from gyrobench.bench.foundations.shipped import find_document
from gyrobench.bench.runs.journal import read_journal
from gyrobench.bench.station.instruments import Emulation
from gyrobench.drivers.emulators.acl_axis import SoftwareFault
from gyrobench.drivers.emulators.bench import BenchAddress, EmulatedBench, bench_at
from tests.bench.engine.test_resumption import Watcher

MOVE = """procedure: move
steps:
  - chamber: {temperature_c: 30, ramp_c_per_min: 10, within_c: 1}
  - go_to: {position: z_up, rate_dps: 10}
  - go_to: {position: z_down, rate_dps: 0.5}
"""


class Observer(Watcher):
    """Adds up for how long the true table moves while the run holds."""

    def __init__(self, faults):
        super().__init__()
        self.faults, self.is_held, self.moved_s, self.last_s = faults, False, 0.0, 0.0
        self.act = lambda bench, now_s: None
        self._emulated = None

    def held(self, why, needs_person, command):
        self.is_held = True

    def continued(self):
        self.is_held = False

    def beat(self, bench):
        now_s = bench.clock.now()
        if self._emulated is None:
            world = str(find_document("worlds", "quick"))
            self._emulated = bench_at(BenchAddress(bench.clock.name, world, 0, self.faults))
        axes = self._emulated.world.axes.values()
        moves = any(abs(axis.encoder(now_s).rate_dps) > 0.01 for axis in axes)
        self.moved_s += (now_s - self.last_s) * (self.is_held and moves)
        self.last_s = now_s
        self.act(self._emulated, now_s)


def run(tmp_path, fault, act=None):
    (tmp_path / "move.yaml").write_text(MOVE)
    faults = tmp_path / "faults.yaml"
    faults.write_text(f"faults:\n  - {{{fault}}}\n")
    observer = Observer(str(faults))
    observer.act = act or observer.act
    job = prepare_job(str(tmp_path / "move.yaml"), "quick", Emulation("quick", 0, str(faults)))
    folder, outcome = run_job(job, tmp_path / "run", observer, ConsentingOperator())
    return outcome, list(read_journal(folder.journal)), observer


def trips(entries):
    return [entry["interlocks"] for entry in entries if entry["event"] == "tripped"]


def test_a_table_whose_port_was_gone_in_a_move_is_stopped_as_soon_as_it_answers(tmp_path):
    gone = "fault: port_gone, target: table, during: turn, after_s: 30, for_s: 14"
    outcome, entries, observer = run(tmp_path, gone)
    assert outcome.ended == "finished", outcome.reason
    assert trips(entries) == [["table_silence"]]
    assert observer.moved_s < 14.0
    _, failed, repeated = (
        [(action["what"], not action["problem"]) for action in entry["actions"]]
        for entry in entries
        if entry["event"] == "made_safe"
    )
    assert ("rate table stopped", False) in failed
    assert repeated == [("rate table stopped", True), ("rate table's servos off", True)]


def test_a_fault_of_a_table_whose_port_was_gone_is_not_cleared_before_the_operator_has_seen_it(tmp_path):
    def trip(emulated, now_s):
        if 120.0 <= now_s < 125.0:
            emulated.table.trip(1, SoftwareFault.RATE_TRIP, now_s)

    gone = "fault: port_gone, target: table, at_s: 100, for_s: 100"
    outcome, entries, _ = run(tmp_path, gone, trip)
    assert outcome.ended == "finished", outcome.reason
    assert trips(entries) == [["table_silence"], ["table_fault"]]
    assert "reported axis 1: rate trip before its servos were switched on" in str(entries)


def test_a_table_that_moves_although_it_was_stopped_trips(tmp_path):
    def turn(emulated, now_s):
        if 260.0 <= now_s <= 262.0:  # in the hold: another program commands the table
            emulated.table.feed(b":Interlock:Close 1;Close 2\r\n", now_s)
            emulated.table.feed(b":Demand:Rate 2,0.3;:Mode:Rate 2\r\n", now_s)

    gone = "fault: port_gone, target: table, during: turn, after_s: 30, for_s: 14"
    outcome, entries, _ = run(tmp_path, gone, turn)
    assert outcome.ended == "finished", outcome.reason
    assert trips(entries)[1] == ["table_silence", "table_fault"]
    (why,) = (entry["why"] for entry in entries if entry["event"] == "tripped" and "although" in entry["why"])
    assert "axis turns at 0.30 deg/s although the table was stopped" in why


@pytest.mark.parametrize(
    "fault",
    [
        "fault: port_gone, target: chamber, at_s: 200, for_s: 200",
        "fault: lost_reply, target: chamber, at_s: 200, for_s: 200",
        "fault: lost_request, target: chamber, at_s: 200, for_s: 200",
        "fault: late_reply, target: chamber, at_s: 200, for_s: 100, delay_s: 2.5",
    ],
)
def test_a_chamber_that_did_not_acknowledge_is_not_taken_for_one_that_an_operator_changed(tmp_path, fault):
    outcome, entries, _ = run(tmp_path, fault)
    assert outcome.ended == "finished", outcome.reason
    assert trips(entries) == [["chamber_silence"]]
    assert [entry["by"] for entry in entries if entry["event"] == "continued"] == ["itself"]


@pytest.mark.parametrize("delay_s", [2.5, 3.3, 8])
def test_late_replies_of_the_table_trip_nothing(tmp_path, delay_s):
    late = f"fault: late_reply, target: table, at_s: 200, for_s: 40, delay_s: {delay_s}"
    outcome, entries, _ = run(tmp_path, late)
    assert outcome.ended == "finished", outcome.reason
    assert trips(entries) == []


@pytest.mark.parametrize("is_inverted", [False, True])
def test_an_ins_that_sends_although_it_was_switched_off_holds_the_run(tmp_path, monkeypatch, is_inverted):
    switch = EmulatedBench.chamber_event
    monkeypatch.setattr(
        EmulatedBench,
        "chamber_event",
        lambda bench, number, on: switch(bench, number, not (on and is_inverted)),
    )
    (tmp_path / "power.yaml").write_text("procedure: power\nsteps: [power_on, power_off]\n")
    job = prepare_job(str(tmp_path / "power.yaml"), "quick", Emulation("quick", 0))
    folder, outcome = run_job(job, tmp_path / "run", Watcher(), ConsentingOperator(patience=0))
    assert outcome.ended != "finished"
    entries = list(read_journal(folder.journal))
    assert trips(entries)[-1] == ["ins_fault"]
    assert "still sends 30 s after its supply was switched off" in str(entries)
