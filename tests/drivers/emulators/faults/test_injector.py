import json
import struct

import numpy as np
import pytest

from gyrobench.bench.foundations.clock import VirtualClock
from gyrobench.bench.foundations.errors import DocumentError
from gyrobench.bench.foundations.shipped import find_document
from gyrobench.drivers.emulators.bench import BenchAddress, EmulatedBench, bench_at

QUICK = find_document("worlds", "quick")
RANDOM = (
    {"fault": "frames_lost", "every_s": 30},
    {"fault": "counter_jump", "every_s": 50, "by": 7},
    {"fault": "falls_back_to_alignment", "every_s": 60},
)


def heard(bench, until_s, step_s):
    """Data of all frames of an INS that aligns and navigates, the world brought on in such steps."""
    bench.world.power_unit(True)
    frames = []
    bench.bench.bus.listeners.append(lambda block: frames.extend(map(bytes, block.data)))
    for number, time_s in enumerate(np.arange(step_s, until_s + 1e-9, step_s)):
        bench.until(float(time_s))
        if number % 4 == 0:
            bench.world.unit.navigate()
        if bench.world.unit.mode == 1:
            bench.world.unit.align()
    return frames


def test_equal_benches_have_equal_faults_and_equal_frames(rig):
    first, second, other = rig(*RANDOM), rig(*RANDOM), rig(*RANDOM, seed=1)
    assert heard(first, 400.0, 2.5) == heard(second, 400.0, 2.5)
    assert first.bench.injected == second.bench.injected
    assert len(first.bench.injected) > 10
    heard(other, 400.0, 2.5)
    assert first.bench.injected != other.bench.injected


def test_an_entry_does_not_move_the_random_times_of_those_before_it(rig):
    few, more = rig(RANDOM[1]), rig(RANDOM[1], RANDOM[0])
    for bench in (few, more):
        bench.until(1000.0)
    assert [each for each in more.bench.injected if each.kind == "counter_jump"] == few.bench.injected


def test_faults_come_at_their_time_however_seldom_the_bench_is_looked_at(rig):
    entries = (
        {"fault": "door_opened", "at_s": 100.25, "for_s": 50},
        {"fault": "set_point_changed_at_panel", "at_s": 140, "to_c": 40},
    )
    seldom, often = rig(*entries), rig(*entries)
    for bench in (seldom, often):
        bench.world.air.running = True
    seldom.until(400.0)
    for time_s in np.arange(0.7, 400.0, 0.7):
        often.until(float(time_s))
    often.until(400.0)
    assert seldom.bench.injected == often.bench.injected == [
        (100.25, "door_opened"), (140.0, "set_point_changed_at_panel"),
    ]  # fmt: skip
    assert seldom.world.air.air_c == often.world.air.air_c


def test_an_empty_list_changes_nothing(rig):
    clock = VirtualClock()
    plain = EmulatedBench(clock, QUICK, 0)
    frames = []
    plain.bus.listeners.append(lambda block: frames.extend(map(bytes, block.data)))
    plain.world.power_unit(True)
    clock.sleep(100.0)
    plain.advance()
    bench = rig()
    bench.world.power_unit(True)
    with bench.bus() as bus:
        bench.until(100.0)
        assert [bytes(m.data) for m in iter(lambda: bus.recv(0.0), None)] == frames
    assert bench.bench.injected == []


def test_turns_ramps_and_power_on_are_derived_from_the_world(rig):
    bench = rig(
        {"fault": "counter_jump", "during": "turn", "by": 1, "times": 5},
        {"fault": "set_point_changed_at_panel", "during": "ramp", "nth": 2, "to_c": 30},
        {"fault": "temperature_sensor_broken", "during": "power_on", "after_s": 5, "sensor": "case"},
    )
    bench.until(10.0)
    bench.world.power_unit(True)
    bench.world.axes[1].move_to(5.0, 10.0)
    bench.until(20.0)
    bench.world.axes[2].move_to(5.0, 20.0)
    bench.world.air.set_point_c, bench.world.air.running = 40.0, True
    bench.until(1000.0)
    bench.world.air.set_point_c = 60.0
    bench.until(1001.0)
    assert bench.bench.injected == [
        (10.0, "counter_jump"), (15.0, "temperature_sensor_broken"),
        (20.0, "counter_jump"), (1000.0, "set_point_changed_at_panel"),
    ]  # fmt: skip


def test_addresses_with_the_same_list_mean_one_bench_and_without_it_another(rig):
    bench = rig({"fault": "lost_reply", "target": "table", "at_s": 0})
    assert bench.port("table")._bench is bench.port("chamber")._bench is bench.bench
    with bench.bus() as bus:
        assert bus._bench is bench.bench
    plain = bench_at(BenchAddress(bench.clock.name, "quick", 0))
    assert plain is not bench.bench
    assert plain.serial["table"] is plain.table


def test_injections_are_added_to_the_log_beside_the_list(tmp_path):
    path = tmp_path / "list.yaml"
    path.write_text("log: injected.jsonl\nfaults: [{fault: door_opened, at_s: 2.5, for_s: 1}]\n")
    for _ in range(2):
        clock = VirtualClock()
        bench = EmulatedBench(clock, QUICK, 0, path)
        clock.sleep(10.0)
        bench.advance()
    lines = (tmp_path / "injected.jsonl").read_text().splitlines()
    assert [json.loads(line) for line in lines] == [{"time_s": 2.5, "fault": "door_opened"}] * 2


def test_a_log_that_can_not_be_written_is_reported_at_the_start(tmp_path):
    path = tmp_path / "list.yaml"
    path.write_text("faults: []\n")
    with pytest.raises(DocumentError, match="can't write the log of faults"):
        EmulatedBench(VirtualClock(), QUICK, 0, path, tmp_path / "absent" / "log")


def test_the_error_for_a_missing_list_names_the_shipped_ones():
    clock = VirtualClock()
    with pytest.raises(DocumentError, match=r"no such file or shipped name. Shipped faults: every_kind"):
        bench_at(BenchAddress(clock.name, "quick", 0, "atlantis"))


def test_a_restarted_bench_has_faults_that_still_last_and_default_settings(rig):
    entries = (
        {"fault": "switched_off_at_panel", "at_s": 5000, "for_s": 1000},
        {"fault": "table_trips", "at_s": 5100},
    )
    bench = rig(*entries, start_s=5500.5)
    assert bench.world.air.faults.stopped
    assert not bench.bench.table.axes[2].faulted
    bench.until(6001.0)
    assert not bench.world.air.faults.stopped
    assert bench.bench.injected == [(5500.0, "switched_off_at_panel")]


def test_random_times_of_a_restarted_bench_differ(rig):
    begun, restarted = rig(*RANDOM), rig(*RANDOM, start_s=5000)
    begun.until(1000.0)
    restarted.until(6000.0)
    later = [time_s - 5000.0 for time_s, kind in restarted.bench.injected if kind == "counter_jump"]
    assert later
    assert set(later).isdisjoint(time_s for time_s, _ in begun.bench.injected)


def test_the_ins_of_a_restarted_bench_counts_from_zero(rig):
    bench = rig(start_s=200_000.0)
    bench.world.power_unit(True)
    with bench.bus() as bus:
        bench.until(200_010.0)
        frames = list(iter(lambda: bus.recv(0.0), None))
    numbers = [struct.unpack_from("<H", m.data, 4)[0] for m in frames if m.arbitration_id == 0x007]
    assert numbers == list(range(len(numbers)))
    assert len(numbers) == 7
    assert frames[-1].timestamp - bench.clock.epoch.timestamp() == pytest.approx(200_010.0, abs=0.01)
