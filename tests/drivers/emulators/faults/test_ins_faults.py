import struct

import pytest

from gyrobench.bench.foundations.errors import DocumentError
from gyrobench.drivers.emulators.world.inertial_unit import AlignmentQuality, Mode

VELOCITY_NE, ROLL_PITCH, HEADING, STATUS, OPTICS, ELECTRONICS = 0x004, 0x006, 0x007, 0x010, 0x020, 0x021
INVALID, LARGEST = -(2**31), 2**31 - 1


def navigate(bench):
    """Bring the INS to navigation, 30 s after the start."""
    bench.world.power_unit(True)
    bench.until(5.0)
    bench.world.unit.align()
    bench.until(29.0)
    bench.world.unit.navigate()
    bench.until(30.0)


def signals(bench, until_s):
    """Velocity north and east, roll, pitch, heading and counter of each epoch up to a time."""
    values = {VELOCITY_NE: [], ROLL_PITCH: [], HEADING: []}
    with bench.bus() as bus:
        bench.until(until_s)
        for frame in iter(lambda: bus.recv(0.0), None):
            if frame.arbitration_id in values:
                layout = "<iH" if frame.arbitration_id == HEADING else "<ii"
                values[frame.arbitration_id].append(struct.unpack_from(layout, frame.data))
    return [sum(parts, ()) for parts in zip(*values.values(), strict=True)]


def temperatures_c(bench, until_s):
    with bench.bus() as bus:
        bench.until(until_s)
        frames = {frame.arbitration_id: frame for frame in iter(lambda: bus.recv(0.0), None)}
    optics = struct.unpack_from("<hhh", frames[OPTICS].data)
    return [each / 100 for each in optics + struct.unpack_from("<hhhh", frames[ELECTRONICS].data)]


def test_an_ins_that_restarts_boots_with_other_biases_and_resets_its_counters(rig):
    bench = rig({"fault": "ins_restarts", "at_s": 40})
    navigate(bench)
    bias = bench.world.true_gyro_bias()
    numbers = [row[-1] for row in signals(bench, 50.0)]
    assert bench.world.unit.mode is Mode.STANDBY
    assert (bench.world.true_gyro_bias() != bias).all()
    assert numbers[-7:] == [0, 1, 2, 3, 4, 5, 6]
    assert bench.kinds == ["ins_restarts"]


def test_an_ins_that_is_off_does_not_restart(rig):
    bench = rig({"fault": "ins_restarts", "at_s": 40})
    bench.until(50.0)
    assert not bench.world.unit.powered
    assert bench.kinds == []


def test_the_ins_falls_back_to_alignment(rig):
    bench = rig({"fault": "falls_back_to_alignment", "during": "navigate", "after_s": 10})
    navigate(bench)
    bench.until(38.5)
    assert bench.world.unit.mode is Mode.NAVIGATE
    bench.until(39.5)
    assert bench.world.unit.mode is Mode.ALIGN
    assert bench.kinds == ["falls_back_to_alignment"]


def test_alignment_is_never_done_while_the_fault_lasts(rig):
    bench = rig({"fault": "alignment_never_done", "during": "align", "for_s": 100})
    bench.world.power_unit(True)
    bench.until(5.0)
    bench.world.unit.align()
    bench.until(104.0)
    assert bench.world.unit.alignment is AlignmentQuality.INVALID
    bench.until(110.0)
    assert bench.world.unit.alignment is AlignmentQuality.FINE


def test_stuck_signals_keep_their_value_while_the_counter_continues(rig):
    bench = rig({"fault": "stuck_output", "at_s": 40, "for_s": 10})
    navigate(bench)
    rows = signals(bench, 60.0)
    stuck = rows[10:20]
    assert len({row[:5] for row in stuck}) == 1
    assert len({row[:5] for row in rows[20:]}) == 10
    assert [row[5] for row in rows] == list(range(rows[0][5], rows[0][5] + 30))


@pytest.mark.parametrize(("kind", "value"), [("invalid_output", INVALID), ("saturated_output", LARGEST)])
def test_chosen_signals_have_a_value_that_means_nothing(rig, kind, value):
    bench = rig({"fault": kind, "at_s": 40, "for_s": 10, "signals": ["velocity_north", "heading"]})
    navigate(bench)
    for number, row in enumerate(signals(bench, 60.0)):
        assert [row[place] == value for place in range(5)] == [*([10 <= number < 20, False, False, False]),
                                                               10 <= number < 20]  # fmt: skip


@pytest.mark.parametrize(("end", "reading_c"), [("high", 327.67), ("low", -327.67)])
def test_a_broken_temperature_sensor_reads_the_end_of_its_range(rig, end, reading_c):
    bench = rig(
        {"fault": "temperature_sensor_broken", "sensor": "optics_y", "at_s": 40, "for_s": 10, "end": end}
    )
    navigate(bench)
    broken = temperatures_c(bench, 45.0)
    assert broken[1] == reading_c
    assert all(0.0 < each < 60.0 for each in broken[:1] + broken[2:])
    assert 0.0 < temperatures_c(bench, 55.0)[1] < 60.0


def test_a_frozen_temperature_sensor_keeps_a_plausible_value(rig):
    bench = rig({"fault": "temperature_sensor_frozen", "sensor": "case", "at_s": 40})
    navigate(bench)
    frozen_c = temperatures_c(bench, 45.0)[6]
    bench.world.air.air_c -= 30.0
    assert temperatures_c(bench, 300.0)[6] == frozen_c
    assert bench.world.thermal.nodes_c[0] < frozen_c - 5.0


def test_a_supply_that_fails_keeps_the_ins_off_until_it_returns(rig):
    bench = rig({"fault": "ins_supply_lost", "at_s": 40, "for_s": 20})
    bench.world.power_unit(True)
    for time_s, on in ((30.0, True), (45.0, False), (61.0, True)):
        bench.until(time_s)
        assert bench.world.unit.powered == on
        if time_s == 45.0:
            bench.world.power_unit(True)
            assert not bench.world.unit.powered
    assert bench.kinds == ["ins_supply_lost"]


def test_a_fault_affects_its_unit_alone(rig):
    bench = rig(
        {"fault": "ins_supply_lost", "at_s": 40, "unit": 2},
        {"fault": "falls_back_to_alignment", "during": "navigate", "after_s": 3, "unit": 3},
        world="four_units",
    )
    worlds = [unit.world for unit in bench.bench.units]
    for world in worlds:
        world.power_unit(True)
    bench.until(10.0)
    for world in worlds:
        world.unit.align()
    bench.until(30.0)
    for world in worlds:
        world.unit.navigate()
    bench.until(45.0)
    modes = [Mode.NAVIGATE, Mode.OFF, Mode.ALIGN, Mode.NAVIGATE]
    assert [world.unit.mode for world in worlds] == modes
    assert bench.kinds == ["falls_back_to_alignment", "ins_supply_lost"]


def test_a_fault_of_a_unit_that_is_not_there_is_refused(rig):
    with pytest.raises(DocumentError, match="unit 5 is not on the bench; it has 4"):
        rig({"fault": "ins_supply_lost", "at_s": 40, "unit": 5}, world="four_units")
