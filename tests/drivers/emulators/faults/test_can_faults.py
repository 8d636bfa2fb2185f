import struct
from itertools import pairwise

import can
import pytest

SYSTEM_TIME, VELOCITY_NE, ROLL_PITCH, HEADING, STATUS = 0x001, 0x004, 0x006, 0x007, 0x010


def seen(bench, until_s, begin_s=20.0):
    """Frames from a moment on, with the INS switched on at the start."""
    bench.world.power_unit(True)
    bench.until(begin_s)
    with bench.bus() as bus:
        bench.until(until_s)
        return list(iter(lambda: bus.recv(0.0), None))


def content(frames):
    return [(frame.arbitration_id, bytes(frame.data)) for frame in frames]


def counters(frames):
    return [struct.unpack_from("<H", frame.data, 4)[0] for frame in frames if frame.arbitration_id == HEADING]


@pytest.fixture
def right(rig):
    """Frames without a fault, from 20 s to a time."""
    return lambda until_s: seen(rig(), until_s)


def test_one_frame_is_lost(rig, right):
    bench = rig({"fault": "frames_lost", "at_s": 20.5, "ids": [ROLL_PITCH]})
    frames = seen(bench, 25.0)
    assert len(frames) == len(right(25.0)) - 1
    assert sum(frame.arbitration_id == ROLL_PITCH for frame in frames) == 4
    assert bench.kinds == ["frames_lost"]


def test_a_share_of_the_frames_is_lost(rig, right):
    bench = rig({"fault": "frames_lost", "at_s": 20, "for_s": 1000, "share": 0.1})
    whole = len(right(1020.0))
    assert len(seen(bench, 1020.0)) == pytest.approx(0.9 * whole, rel=0.02)
    assert bench.kinds == ["frames_lost"]


def test_all_frames_are_lost_for_a_time(rig, right):
    bench = rig({"fault": "frames_lost", "at_s": 20, "for_s": 600})
    frames = seen(bench, 630.0)
    assert counters(frames) == counters(right(630.0))[-10:]


def test_frames_come_twice(rig):
    frames = seen(rig({"fault": "frames_repeated", "at_s": 20, "frames": 2, "ids": [HEADING]}), 23.0)
    assert [b - a for a, b in pairwise(counters(frames))] == [0, 1, 0, 1]


def test_frames_come_out_of_order(rig, right):
    frames = seen(rig({"fault": "frames_out_of_order", "at_s": 20, "ids": [HEADING]}), 21.0)
    before = [frame.arbitration_id for frame in right(21.0)]
    before[-2:] = [HEADING, ROLL_PITCH]
    assert [frame.arbitration_id for frame in frames] == before


def test_bits_of_a_frame_are_wrong(rig, right):
    frames = seen(rig({"fault": "frames_corrupted", "at_s": 20, "bits": 2, "ids": [HEADING]}), 23.0)
    wrong = [
        (int.from_bytes(a.data) ^ int.from_bytes(b.data)).bit_count()
        for a, b in zip(frames, right(23.0), strict=True)
    ]
    assert sorted(wrong)[-2:] == [0, 2]


def test_the_epoch_counter_jumps_and_no_epoch_is_lost(rig):
    bench = rig({"fault": "counter_jump", "at_s": 22.5, "by": 100})
    numbers = counters(seen(bench, 25.0))
    assert [b - a for a, b in pairwise(numbers)] == [1, 101, 1, 1]


def test_time_stamps_jump_and_come_back(rig, right):
    frames = seen(rig({"fault": "time_stamp_jump", "at_s": 22.5, "for_s": 2, "by_s": -3600}), 27.0)
    shifts_s = [a.timestamp - b.timestamp for a, b in zip(frames, right(27.0), strict=True)]
    assert set(shifts_s) == {0.0, -3600.0}
    assert content(frames) == content(right(27.0))
    assert shifts_s[0] == shifts_s[-1] == 0.0


def test_bus_off_lasts_until_the_bus_is_reopened(rig):
    bench = rig({"fault": "bus_off", "at_s": 30, "for_s": 10})
    bench.world.power_unit(True)
    command = can.Message(arbitration_id=0x200, data=b"\x02\x00", is_extended_id=False)
    with bench.bus() as bus:
        bench.until(31.0)
        for use in (lambda: bus.recv(1.0), lambda: bus.send(command)):
            with pytest.raises(can.CanOperationError, match="bus-off"):
                use()
        bench.until(45.0)
        with pytest.raises(can.CanOperationError, match="bus-off"):
            bus.recv(1.0)
    with bench.bus() as bus:
        assert bus.recv(2.0) is not None
        bus.send(command)
    assert bench.world.unit.mode == 2
    assert bench.kinds == ["bus_off"]


def test_a_bus_opened_during_bus_off_hears_nothing_and_has_to_be_opened_again(rig):
    bench = rig({"fault": "bus_off", "at_s": 30, "for_s": 10})
    bench.world.power_unit(True)
    bench.until(31.0)
    with bench.bus() as bus:
        assert bus.recv(5.0) is None
        bench.until(41.0)
        with pytest.raises(can.CanOperationError, match="bus-off"):
            bus.recv(1.0)


def test_a_second_node_sends_the_same_ids_with_separate_counters(rig, right):
    frames = seen(rig({"fault": "second_node", "at_s": 22.5, "for_s": 3}), 27.0)
    assert len(frames) > len(right(27.0))
    numbers = counters(frames)
    assert numbers[2:8:2] == counters(right(27.0))[2:5]
    assert numbers[3:9:2] == [0, 1, 2]


def test_foreign_frames_fill_the_bus(rig, right):
    bench = rig({"fault": "foreign_frames", "at_s": 20, "for_s": 10})
    frames = seen(bench, 30.0)
    foreign = [frame for frame in frames if frame.arbitration_id >= 0x300]
    assert len(frames) == pytest.approx(10 * 500_000 / 130, rel=0.01)
    assert content(f for f in frames if f.arbitration_id < 0x300) == content(right(30.0))
    times_s = [frame.timestamp for frame in frames]
    assert times_s == sorted(times_s)
    assert len({frame.arbitration_id for frame in foreign}) == 64
    assert bench.kinds == ["foreign_frames"]
