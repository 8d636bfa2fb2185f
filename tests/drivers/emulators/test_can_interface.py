import time

import can
import numpy as np
import pytest

from gyrobench.bench.foundations.clock import VirtualClock, WallClock
from gyrobench.drivers.emulators.bench import BenchAddress, bench_at
from gyrobench.drivers.emulators.can_interface import EmulatorBus
from gyrobench.drivers.emulators.world.inertial_unit import Mode

STANDBY_DATA, ALIGN_DATA = b"\1\0", b"\2\0"
HEADING, STATUS, COMMAND = 0x007, 0x010, 0x200
IDENTITY, OPTICS_TEMPERATURE = 0x011, 0x020
BOOTED_S = 9.0  # the shipped world boots for eight seconds


@pytest.fixture
def clock():
    return VirtualClock()


@pytest.fixture
def bench(clock):
    return bench_at(BenchAddress(clock.name, "ideal", 0))


@pytest.fixture
def join(clock):
    """Open a bus on the bench of the test's clock; all are left at the end."""
    buses = []

    def open_bus(**options):
        options = {"channel": "ins", "clock": clock.name, "world": "ideal"} | options
        buses.append(can.Bus(interface="emulator", ignore_config=True, **options))
        return buses[-1]

    yield open_bus
    for bus in buses:
        bus.shutdown()


def drained(bus):
    return list(iter(lambda: bus.recv(0.0), None))


def message(data, identifier=COMMAND):
    return can.Message(arbitration_id=identifier, data=data, is_extended_id=False)


def test_python_can_finds_the_interface_by_its_entry_point(join):
    bus = join()
    assert isinstance(bus, EmulatorBus)
    assert "ideal" in str(bus)


def test_recv_waits_on_the_virtual_clock_alone(join, clock):
    bus = join()
    started_s = time.monotonic()
    assert bus.recv(3600.0) is None
    assert time.monotonic() - started_s < 30.0
    assert clock.now() == 3600.0


@pytest.mark.parametrize("timeout_s", [0.0, -1.0, 0.05, 0.333, 7.0])
def test_recv_without_a_frame_takes_exactly_its_time_out(join, clock, timeout_s):
    bus = join()
    clock.sleep(2.0)
    assert bus.recv(timeout_s) is None
    assert clock.now() == pytest.approx(2.0 + max(timeout_s, 0.0), abs=1e-9)


def test_recv_returns_as_soon_as_a_frame_is_there(join, clock, bench):
    bus = join()
    bench.world.power_unit(True)
    frame = bus.recv(60.0)
    assert frame is not None
    assert BOOTED_S - 1.0 < clock.now() < BOOTED_S + 0.2
    taken_s = clock.now()
    while bus.recv(0.0) is not None:
        assert clock.now() == taken_s
    assert bus.recv(1.0) is not None
    assert clock.now() - taken_s <= 0.1 + 1e-9


def test_recv_without_a_time_out_waits_for_a_frame(join, clock, bench):
    bus = join()
    bench.world.power_unit(True)
    assert bus.recv(None) is not None
    assert clock.now() < BOOTED_S + 0.2


def test_frames_are_stamped_with_the_calendar_time_of_the_clock(join, clock, bench):
    bus = join()
    bench.world.power_unit(True)
    clock.sleep(BOOTED_S + 2.0)
    *_, last = drained(bus)
    # The frames of an epoch follow each other within milliseconds of it.
    assert -0.003 < clock.utc().timestamp() - last.timestamp < 0.11


def test_filters_are_kept(join, clock, bench):
    bus = join(can_filters=[{"can_id": HEADING, "can_mask": 0x7FF}])
    other = join()
    bench.world.power_unit(True)
    clock.sleep(BOOTED_S + 2.0)
    assert {frame.arbitration_id for frame in drained(bus)} == {HEADING}
    bus.set_filters([{"can_id": STATUS, "can_mask": 0x7FF}])
    assert bus.recv(5.0).arbitration_id == STATUS
    bus.set_filters(None)
    drained(bus)
    drained(other)
    clock.sleep(1.0)
    assert len(drained(bus)) == len(drained(other)) == 38


def test_a_time_out_counts_frames_that_do_not_pass_as_nothing(join, clock, bench):
    bus = join(can_filters=[{"can_id": 0x7FF, "can_mask": 0x7FF}])
    bench.world.power_unit(True)
    assert bus.recv(20.0) is None
    assert clock.now() == pytest.approx(20.0, abs=1e-9)


def test_commands_reach_the_ins_at_the_time_of_the_clock(join, clock, bench):
    bus = join()
    bench.world.power_unit(True)
    clock.sleep(BOOTED_S + 1.05)
    bus.send(message(ALIGN_DATA))
    clock.sleep(1.0)
    modes = [frame.data[0] for frame in drained(bus) if frame.arbitration_id == STATUS]
    assert modes[-2:] == [1, 2]


def contents(messages):
    return [(m.timestamp, m.arbitration_id, m.is_extended_id, bytes(m.data)) for m in messages]


@pytest.mark.parametrize(
    "filters",
    [
        None,
        [],
        [{"can_id": HEADING, "can_mask": 0x7FF}, {"can_id": STATUS, "can_mask": 0x7F0, "extended": False}],
        [{"can_id": HEADING, "can_mask": 0x7FF, "extended": True}],
        [{"can_id": 0, "can_mask": 0}],
    ],
)
def test_blocks_and_messages_are_the_same_frames(join, clock, bench, filters):
    in_messages, in_blocks, in_both = (join(can_filters=filters) for _ in range(3))
    bench.world.power_unit(True)
    clock.sleep(BOOTED_S + 2.0)
    expected = contents(drained(in_messages))
    assert contents(in_blocks.recv_block().messages()) == expected
    assert len(in_blocks.recv_block()) == 0
    first = in_both.recv(0.0)
    assert contents([first] if first else []) + contents(in_both.recv_block().messages()) == expected


def test_at_bus_off_there_are_no_blocks(join, bench):
    bus = join()
    bench.connections["ins"].disconnect()
    with pytest.raises(can.CanOperationError, match="bus-off"):
        bus.recv_block()


def test_several_buses_get_all_frames_and_one_world(join, clock, bench):
    first, second = join(), join()
    bench.world.power_unit(True)
    clock.sleep(BOOTED_S + 3.0)
    one = drained(first)
    two = drained(second)
    assert len(one) > 70
    assert [(f.timestamp, f.arbitration_id, bytes(f.data)) for f in one] == [
        (f.timestamp, f.arbitration_id, bytes(f.data)) for f in two
    ]


def test_shutdown_leaves_the_bus_and_the_ins_continues(join, clock, bench):
    leaving, staying = join(), join()
    listeners = len(bench.channels["ins"].listeners)
    leaving.shutdown()
    leaving.shutdown()
    assert len(bench.channels["ins"].listeners) == listeners - 1
    bench.world.power_unit(True)
    clock.sleep(BOOTED_S + 2.0)
    assert len(drained(staying)) > 30
    assert drained(leaving) == []


def test_as_a_context_it_leaves_at_the_end(clock, bench):
    with can.Bus(interface="emulator", channel="ins", clock=clock.name, world="ideal", ignore_config=True):
        assert len(bench.channels["ins"].listeners) == 1
    assert bench.channels["ins"].listeners == []


def test_it_takes_the_wall_clock_where_that_is_the_clock():
    clock = WallClock()
    with can.Bus(
        interface="emulator", channel="ins", clock=clock.name, world="ideal", ignore_config=True
    ) as bus:
        before_s = clock.now()
        assert bus.recv(0.1) is None
        assert 0.1 <= clock.now() - before_s < 2.0


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"channel": "can0"}, "can0"),
        ({"world": "atlantis"}, "atlantis"),
        ({"world": "missing/file.yaml"}, "missing/file.yaml"),
        ({"clock": "unknown-clock"}, "unknown-clock"),
        ({"seed": -1}, "seed"),
    ],
)
def test_a_wrong_address_is_an_initialization_error(join, options, words):
    with pytest.raises(can.CanInitializationError, match=words):
        join(**options)


def test_a_wrong_world_file_is_an_initialization_error_with_the_place(join, tmp_path):
    path = tmp_path / "w.yaml"
    path.write_text("world: w\nlatitude_deg: 95\n")
    with pytest.raises(can.CanInitializationError, match=r"w\.yaml:2:1: .*85"):
        join(world=str(path))


def test_another_seed_or_world_is_another_bench(clock, bench):
    assert bench_at(BenchAddress(clock.name, "ideal", 0)) is bench
    assert bench_at(BenchAddress(clock.name, "ideal", 1)) is not bench
    assert bench_at(BenchAddress(clock.name, "gyro_b", 0)) is not bench
    assert bench_at(BenchAddress(VirtualClock().name, "ideal", 0)) is not bench


# Several units on the table.


def serial_number(frames):
    return int.from_bytes(frames.with_id(IDENTITY).data[0, :4].tobytes(), "little")


def test_each_channel_is_a_unit_with_its_own_serial_number_and_noise(join, clock):
    first, second = join(world="quick"), join(world="quick", channel="ins-2")
    quick = bench_at(BenchAddress(clock.name, "quick", 0))
    for unit in quick.units:
        unit.world.power_unit(True)
    clock.sleep(20.0)
    frames = [bus.recv_block() for bus in (first, second)]
    assert [serial_number(each) for each in frames] == [1003, 1004]
    temperatures = [each.with_id(OPTICS_TEMPERATURE).data.tolist() for each in frames]
    assert temperatures[0] != temperatures[1]
    assert np.ptp(temperatures[0], axis=0).max() < 100 > np.ptp(temperatures[1], axis=0).max()


def test_the_frames_of_the_first_unit_do_not_depend_on_the_others():
    def frames_of_first(count):
        clock = VirtualClock()
        bus = can.Bus(interface="emulator", channel="ins", clock=clock.name, world="quick", units=count,
                      ignore_config=True)  # fmt: skip
        bench = bench_at(BenchAddress(clock.name, "quick"))
        for unit in bench.units:
            unit.world.power_unit(True)
        clock.sleep(8.0)
        bus.send(message(ALIGN_DATA))
        clock.sleep(20.0)
        frames = bus.recv_block()
        bus.shutdown()
        assert len(bench.units) == count
        return frames.rows.tobytes()

    assert frames_of_first(1) == frames_of_first(4)


def test_units_on_one_bus_differ_by_their_identifiers(join, clock):
    address = BenchAddress(clock.name, "quick")
    first = join(world="quick")
    second = join(world="quick", unit=2, identifier_offset=0x100)
    bench = bench_at(address)
    for unit in bench.units:
        unit.world.power_unit(True)
    clock.sleep(8.0)
    second.send(message(ALIGN_DATA, COMMAND + 0x100))
    clock.sleep(1.0)
    assert [unit.world.unit.mode for unit in bench.units] == [Mode.STANDBY, Mode.ALIGN]
    for frames in (first.recv_block(), second.recv_block()):
        assert set(frames.arbitration_id // 0x100) == {0, 1}
        assert np.all(np.diff(frames.timestamp_s) >= 0.0)
        assert serial_number(frames) == 1003
        assert serial_number(frames.with_fields(id=frames.arbitration_id - np.uint32(0x100))) == 1004


def test_a_unit_is_powered_by_its_event_output(join, clock):
    join(world="quick")
    join(world="quick", channel="ins-2")
    join(world="quick", channel="ins-3", power_event=2)
    bench = bench_at(BenchAddress(clock.name, "quick"))
    bench.chamber_event(2, True)
    assert [unit.world.unit.powered for unit in bench.units] == [True, False, True]
    bench.chamber_event(3, True)
    assert [unit.world.unit.powered for unit in bench.units] == [True, True, True]
