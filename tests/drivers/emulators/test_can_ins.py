import itertools
import struct
import zlib
from pathlib import Path

import can
import cantools
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

import gyrobench.drivers.ins
from gyrobench.drivers.emulators.can_ins import CanInsEmulator
from gyrobench.drivers.emulators.world.inertial_unit import AlignmentQuality, Epochs, Mode
from gyrobench.drivers.emulators.world.ins_compensation import COEFFICIENT_COUNT, SLOT, empty_table

DBC = cantools.database.load_file(Path(gyrobench.drivers.ins.__file__).with_name("gyrobench_ins.dbc"))
QUICK = {"boot_s": 1.0, "levelling_s": 1.0, "coarse_alignment_s": 2.0, "fine_alignment_s": 4.0}
SLOW = ["SYSTEM_TIME", "HEIGHT_VELOCITY_D", "INS_STATUS", "INS_IDENTITY",
        "COMPENSATION_STATUS", "POSITION", "GYRO_OPTICS_TEMPERATURE",
        "GYRO_ELECTRONICS_TEMPERATURE"]  # fmt: skip
FAST = ["VELOCITY_NE", "ROLL_PITCH", "HEADING"]
LSB_MPS, LSB_DEG, LSB_C = 1e-4, 1e-6, 0.01
TEMPERATURES_C = [-12.344, 20.0, 21.116, -40.0, 55.5, 60.004, 71.0]


class Bus:
    """An emulated INS and all frames that it sent."""

    def __init__(self, world):
        self.world, self.unit = world, world.unit
        self.ins = CanInsEmulator(world, epoch_unix_s=1_000_000.0)
        self.frames = []
        self.ins.listeners.append(lambda block: self.frames.extend(block.messages()))
        self.now_s = 0.0

    def run(self, seconds):
        """Let time pass; returns what was sent in it as (name, signals)."""
        first = len(self.frames)
        self.now_s += seconds
        self.world.advance(self.now_s)
        return [self.decoded(frame) for frame in self.frames[first:]]

    def newest(self, name):
        return next(signals for n, signals in map(self.decoded, reversed(self.frames)) if n == name)

    @staticmethod
    def decoded(frame):
        message = DBC.get_message_by_frame_id(frame.arbitration_id)
        assert not frame.is_extended_id
        assert len(frame.data) == message.length
        return message.name, message.decode(bytes(frame.data), decode_choices=False)

    def send(self, name, **signals):
        message = DBC.get_message_by_name(name)
        data = message.encode(signals)
        self.ins.receive(can.Message(arbitration_id=message.frame_id, data=data, is_extended_id=False))

    def command(self, command, argument=0):
        self.send("INS_COMMAND", COMMAND=command, ARGUMENT=argument)

    def switch_on(self):
        self.world.power_unit(True)
        self.run(2.1)
        assert self.unit.mode is Mode.STANDBY
        return self


@pytest.fixture
def bus(make_world):
    return Bus(make_world(ins=QUICK)).switch_on()


def epochs_of(states, first_second=5, mode=Mode.NAVIGATE, alignment=AlignmentQuality.FINE):
    samples = np.arange(100 * first_second, 100 * first_second + 10 * len(states), 10)
    seconds = np.count_nonzero(samples % 100 == 0)
    return Epochs(
        samples, np.array(states), mode, alignment, np.zeros(seconds), np.tile(TEMPERATURES_C, (seconds, 1))
    )


def state(attitude=None, east_mps=0.0, north_mps=0.0):
    quaternion = (attitude or Rotation.identity()).as_quat(scalar_first=True)
    return [*quaternion, east_mps, north_mps, 0.6, 0.1]


speeds = st.floats(-2e5, 2e5)
angles = st.floats(-180.0, 180.0)


@given(velocities=st.lists(st.tuples(speeds, speeds), min_size=1, max_size=5))
def test_velocities_arrive_within_half_a_step(make_world, velocities):
    bus = Bus(make_world())
    bus.world.on_epochs(epochs_of([state(None, *velocity) for velocity in velocities]))
    sent = [signals for name, signals in map(bus.decoded, bus.frames) if name == "VELOCITY_NE"]
    for signals, (east_mps, north_mps) in zip(sent, velocities, strict=True):
        assert signals["VELOCITY_EAST"] == pytest.approx(east_mps, abs=0.51 * LSB_MPS)
        assert signals["VELOCITY_NORTH"] == pytest.approx(north_mps, abs=0.51 * LSB_MPS)


def test_velocities_beyond_the_field_stay_at_its_ends(make_world):
    bus = Bus(make_world())
    bus.world.on_epochs(epochs_of([state(None, 1e9, -1e9)]))
    assert bus.newest("VELOCITY_NE") == {"VELOCITY_EAST": 214748.3647, "VELOCITY_NORTH": -214748.3648}


@given(rotation=st.tuples(angles, st.floats(-89.0, 89.0), angles), pitch_first=st.booleans())
def test_the_angles_rebuild_the_attitude_in_either_sequence(make_world, rotation, pitch_first):
    bus = Bus(make_world())
    bus.unit.pitch_first = pitch_first
    attitude = Rotation.from_euler("ZXY", rotation, degrees=True)
    bus.world.on_epochs(epochs_of([state(attitude)]))
    angles, heading = bus.newest("ROLL_PITCH"), bus.newest("HEADING")["HEADING"]
    assert 0.0 <= heading < 360.0
    order = [angles["ROLL"], angles["PITCH"]] if pitch_first else [angles["PITCH"], angles["ROLL"]]
    # The body is turned about the vertical first and then about its own y and x, or x and y.
    rebuilt = Rotation.from_euler("ZYX" if pitch_first else "ZXY", [-heading, *order], degrees=True)
    # Near the singularity an angle's last digit is worth more.
    assert np.degrees((rebuilt * attitude.inv()).magnitude()) < 3 * LSB_DEG


def test_heading_is_clockwise_from_north(make_world):
    bus = Bus(make_world())
    for turned_deg, heading_deg in ((-90.0, 90.0), (10.0, 350.0), (0.0, 0.0), (1e-9, 0.0)):
        bus.world.on_epochs(epochs_of([state(Rotation.from_euler("Z", turned_deg, degrees=True))]))
        assert bus.newest("HEADING")["HEADING"] == pytest.approx(heading_deg, abs=LSB_DEG)


def test_temperatures_are_those_read_from_the_sensors(make_world):
    bus = Bus(make_world())
    bus.world.on_epochs(epochs_of([state()]))
    optics, electronics = bus.newest("GYRO_OPTICS_TEMPERATURE"), bus.newest("GYRO_ELECTRONICS_TEMPERATURE")
    read_c = [electronics["CASE"], *(optics[axis] for axis in "XYZ"), *(electronics[axis] for axis in "XYZ")]
    np.testing.assert_allclose(read_c, TEMPERATURES_C, atol=0.51 * LSB_C)


@pytest.mark.parametrize("second", [0, 1, 86_400, 2**32 - 1])
def test_time_is_whole_seconds(make_world, second):
    bus = Bus(make_world())
    bus.world.on_epochs(epochs_of([state()], first_second=second))
    assert bus.newest("SYSTEM_TIME") == {"TIME_S": second, "TIME_NS": 0}


def test_height_and_identity_are_those_of_the_world_file(make_world):
    bus = Bus(make_world(height_m=-12.34, ins={"serial_number": 4_000_000_000}))
    bus.world.on_epochs(epochs_of([state()]))
    assert bus.newest("HEIGHT_VELOCITY_D") == {"HEIGHT": -12.34, "VELOCITY_DOWN": 0.0}
    identity = bus.newest("INS_IDENTITY")
    assert identity["SERIAL_NUMBER"] == 4_000_000_000
    assert identity["FIRMWARE"] > 0


@pytest.mark.parametrize("mode", [Mode.STANDBY, Mode.ALIGN, Mode.NAVIGATE])
@pytest.mark.parametrize("alignment", list(AlignmentQuality))
def test_mode_and_alignment_arrive_and_say_whether_the_attitude_is_valid(make_world, mode, alignment):
    bus = Bus(make_world())
    bus.world.on_epochs(epochs_of([state()], mode=mode, alignment=alignment))
    heading = bus.newest("HEADING")
    assert bus.newest("INS_STATUS")["MODE"] == mode
    assert heading["ALIGNMENT"] == alignment
    assert heading["ATTITUDE_VALID"] == (mode is Mode.NAVIGATE or alignment is not AlignmentQuality.INVALID)


def test_an_unpowered_unit_sends_nothing(make_world):
    bus = Bus(make_world(ins=QUICK))
    assert bus.run(20.0) == []
    bus.switch_on()
    bus.frames.clear()
    bus.world.power_unit(False)
    assert bus.run(20.0) == []


def test_each_second_begins_with_the_slow_frames_and_has_all_epochs_in_order(bus):
    bus.run(0.89)  # up to just before a whole second
    names = [name for name, _ in bus.run(3.0)]
    assert names == [*SLOW, *(FAST * 10)] * 3


def test_time_stamps_increase_and_belong_to_the_epochs(bus):
    bus.run(7.0)
    stamps = [frame.timestamp for frame in bus.frames]
    assert all(later > earlier for earlier, later in itertools.pairwise(stamps))
    first = [frame.timestamp for frame in bus.frames if frame.arbitration_id == 0x004][:20]
    since_s = np.array(first) - 1_000_000.0
    assert ((since_s - np.round(since_s, 1) >= -1e-6) & (since_s - np.round(since_s, 1) < 0.005)).all()


def test_counters_go_up_by_one_and_wrap(bus):
    bus.ins.format._epoch_counter = bus.ins.format._status_counter = 0xFFFF - 3
    frames = bus.run(7.0)

    def counted(name, signal):
        values = [signals[signal] for n, signals in frames if n == name]
        assert 0 in values
        return set((np.diff(values) % 0x10000).tolist())

    assert counted("HEADING", "EPOCH_COUNTER") == {1}
    assert counted("INS_STATUS", "STATUS_COUNTER") == {1}
    assert counted("GYRO_OPTICS_TEMPERATURE", "TEMPERATURE_COUNTER") == {1}


@pytest.mark.parametrize(("period_s", "epochs"), [(0.01, 100), (0.25, 4), (1.0, 1)])
def test_every_epoch_period_keeps_the_slow_frames_at_one_a_second(make_world, period_s, epochs):
    bus = Bus(make_world(ins=QUICK | {"epoch_period_s": period_s})).switch_on()
    bus.run(0.89)  # up to just before a whole second
    names = [name for name, _ in bus.run(2.0)]
    assert names == [*SLOW, *(FAST * epochs)] * 2
    stamps = [frame.timestamp for frame in bus.frames]
    assert stamps == sorted(stamps)


def test_the_latitude_is_the_one_that_was_entered(make_world):
    bus = Bus(make_world(ins=QUICK | {"latitude_error_arcmin": 3.0})).switch_on()
    entered_deg = bus.world.file.latitude_deg + 0.05
    assert bus.newest("POSITION") == {"LATITUDE": pytest.approx(entered_deg, abs=1e-7), "LONGITUDE": 0.0}


def test_several_listeners_get_the_same_frames(bus):
    ours, others = [], []
    bus.ins.listeners += (ours.append, others.append)
    bus.frames.clear()
    bus.run(2.0)
    assert sum(map(len, others)) == len(bus.frames) == 76
    assert all((one.rows == other.rows).all() for one, other in zip(ours, others, strict=True))


def test_align_navigate_and_standby_commands_act(bus):
    bus.command(2)
    bus.run(1.0)
    assert bus.newest("INS_STATUS")["MODE"] == Mode.ALIGN
    bus.command(3)  # too early
    bus.run(1.0)
    assert bus.newest("INS_STATUS")["MODE"] == Mode.ALIGN
    bus.run(4.0)
    status, heading = bus.newest("INS_STATUS"), bus.newest("HEADING")
    assert status["ALIGN_TIME_S"] in (3, 4)
    assert heading["ALIGNMENT"] in (AlignmentQuality.COARSE, AlignmentQuality.FINE)
    assert heading["ATTITUDE_VALID"] == 1
    bus.command(3)
    bus.run(1.0)
    assert bus.newest("INS_STATUS")["MODE"] == Mode.NAVIGATE
    bus.command(1)
    bus.run(1.0)
    assert bus.newest("INS_STATUS")["MODE"] == Mode.STANDBY
    assert bus.newest("HEADING")["ATTITUDE_VALID"] == 0


def test_the_euler_sequence_is_commanded_and_reported(bus):
    for sequence in (1, 0, 1):
        bus.command(4, sequence)
        bus.run(1.0)
        assert bus.newest("INS_STATUS")["EULER_SEQUENCE"] == sequence
    bus.command(4, 7)
    bus.run(1.0)
    assert bus.newest("INS_STATUS")["EULER_SEQUENCE"] == 1


def load(bus, axis, coefficients, low_c, high_c):
    for index, value in enumerate([*coefficients, low_c, high_c]):
        bus.send("COMPENSATION_COEFFICIENT", AXIS=axis, INDEX=index, VALUE=value)


def test_a_compensation_is_loaded_applied_reported_and_cleared(bus):
    coefficients = [0.5, -0.25, 0.125, 0.0, 0.0, 2.0**-20]
    load(bus, 2, coefficients, -20.0, 50.0)
    bus.run(1.0)
    assert bus.unit.compensation is None
    assert bus.newest("INS_STATUS")["COMPENSATION"] == 0
    bus.command(6)
    bus.run(1.0)
    assert bus.newest("INS_STATUS")["COMPENSATION"] == 1
    for optics_c, used_c in ((10.0, 10.0), (70.0, 50.0), (-40.0, -20.0)):
        expected = np.polynomial.polynomial.polyval(used_c, coefficients)
        bus.unit.sense_temperatures(np.full((1, 3), optics_c), np.full((1, 3), optics_c))
        np.testing.assert_allclose(bus.unit.compensation.bias_dph, [0.0, 0.0, expected], rtol=1e-12)
    bus.command(5)
    bus.run(1.0)
    assert bus.unit.compensation is None
    assert bus.newest("INS_STATUS")["COMPENSATION"] == 0


def test_loading_does_not_change_what_is_applied(bus):
    load(bus, 0, [0.5, 0, 0, 0, 0, 0], -20.0, 50.0)
    bus.command(6)
    load(bus, 0, [9.0, 0, 0, 0, 0, 0], -20.0, 50.0)
    assert bus.unit.compensation.bias_dph[0] == 0.5


def test_the_status_has_the_checksums_of_the_loaded_and_applied_tables(bus):
    bus.run(1.0)
    empty = bus.newest("COMPENSATION_STATUS")
    assert empty["IN_USE"] == 0
    of_biases = bus.unit.loaded_table[:, :28]  # all that a table without other coefficients covers
    assert empty["LOADED"] == zlib.crc32(of_biases.astype("<f4").tobytes())
    load(bus, 1, [0.5, 0, 0, 0, 0, 0], -20.0, 50.0)
    bus.run(1.0)
    loaded = bus.newest("COMPENSATION_STATUS")["LOADED"]
    assert loaded != empty["LOADED"]
    bus.command(6)
    load(bus, 1, [0.25, 0, 0, 0, 0, 0], -20.0, 50.0)
    bus.run(1.0)
    assert bus.newest("COMPENSATION_STATUS")["IN_USE"] == loaded
    assert bus.newest("COMPENSATION_STATUS")["LOADED"] != loaded
    bus.command(5)
    bus.run(1.0)
    assert bus.newest("COMPENSATION_STATUS") == empty


def test_the_checksum_covers_other_coefficients_once_one_is_loaded(bus):
    load(bus, 1, [0.5, 0, 0, 0, 0, 0], -20.0, 50.0)
    bus.send("COMPENSATION_COEFFICIENT", AXIS=0, INDEX=28, VALUE=12.5)
    bus.run(1.0)
    without_limits = zlib.crc32(bus.unit.loaded_table[:, : SLOT.LIMITS].astype("<f4").tobytes())
    assert bus.newest("COMPENSATION_STATUS")["LOADED"] == without_limits
    bus.send("COMPENSATION_COEFFICIENT", AXIS=0, INDEX=SLOT.LIMITS + 1, VALUE=40.0)
    bus.run(1.0)
    whole = zlib.crc32(bus.unit.loaded_table.astype("<f4").tobytes())
    assert bus.newest("COMPENSATION_STATUS")["LOADED"] == whole


def test_numbers_that_no_gyro_has_are_not_taken(bus):
    for axis, index in ((3, 0), (0, COEFFICIENT_COUNT), (255, 255)):
        data = struct.pack("<BBxxf", axis, index, 1.0)
        bus.ins.receive(can.Message(arbitration_id=0x201, data=data, is_extended_id=False))
    assert np.array_equal(bus.unit.loaded_table, empty_table())


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_a_coefficient_that_is_no_number_is_not_taken(bus, value):
    bus.ins.receive(
        can.Message(arbitration_id=0x201, data=struct.pack("<BBxxf", 0, 0, value), is_extended_id=False)
    )
    assert np.array_equal(bus.unit.loaded_table, empty_table())


@pytest.mark.parametrize("moment", ["off", "booting"])
def test_a_unit_that_is_off_or_boots_hears_nothing(make_world, moment):
    bus = Bus(make_world(ins=QUICK | {"boot_s": 5.0}))
    if moment == "booting":
        bus.world.power_unit(True)
        bus.run(2.0)
    bus.command(4, 1)
    load(bus, 0, [1.0] * 6, -20.0, 50.0)
    bus.command(6)
    bus.command(2)
    bus.world.power_unit(True)
    bus.run(8.0)
    assert bus.newest("INS_STATUS") | {"STATUS_COUNTER": 0} == {
        "MODE": 1,
        "EULER_SEQUENCE": 0,
        "ALIGN_TIME_S": 0,
        "COMPENSATION": 0,
        "FAULTS": 0,
        "STATUS_COUNTER": 0,
    }
    assert np.array_equal(bus.unit.loaded_table, empty_table())


def snapshot(unit):
    return unit.mode, unit.alignment, unit.pitch_first, unit.compensation is None, unit.loaded_table.tolist()


@st.composite
def foreign_frames(draw):
    """Frames that are not for the INS, or that no data frame of the DBC looks like."""
    kind = draw(st.sampled_from(["identifier", "extended", "remote", "error", "short"]))
    identifier = draw(st.sampled_from([0x200, 0x201]))
    data = draw(st.sampled_from([b"\2\0", b"\1\0\0\0\0\0\0\0", b"\4\1\0\0\0\0\x80\x3f"]))
    options = {"is_extended_id": False}
    match kind:
        case "identifier":
            identifier = draw(st.integers(0, 0x7FF).filter(lambda i: i not in (0x200, 0x201)))
        case "extended":
            options["is_extended_id"] = True
        case "remote":
            options["is_remote_frame"], data = True, None
        case "error":
            options["is_error_frame"] = True
        case "short":
            data = data[: draw(st.integers(0, 1 if identifier == 0x200 else 7))]
    return can.Message(arbitration_id=identifier, data=data, **options)


@pytest.mark.long
@given(frame=foreign_frames())
def test_frames_that_are_not_for_the_ins_change_nothing(make_world, frame):
    bus = Bus(make_world(ins=QUICK)).switch_on()
    before = snapshot(bus.unit)
    bus.ins.receive(frame)
    assert snapshot(bus.unit) == before


any_frame = st.builds(
    lambda identifier, data: can.Message(arbitration_id=identifier, data=data, is_extended_id=False),
    st.one_of(st.sampled_from([0x200, 0x201]), st.integers(0, 0x7FF)),
    st.one_of(
        st.binary(max_size=8),
        st.builds(bytes, st.tuples(st.integers(0, 8), st.integers(0, 3))),
        st.builds(
            lambda axis, index, value: struct.pack("<BBxxf", axis, index, value),
            st.integers(0, 3), st.integers(0, COEFFICIENT_COUNT), st.floats(width=32),
        ),
    ),
)  # fmt: skip


@pytest.mark.long
@given(frames=st.lists(any_frame, max_size=12))
def test_no_frame_ever_breaks_the_ins(make_world, frames):
    bus = Bus(make_world(ins=QUICK)).switch_on()
    for command in (2, 3):
        for frame in frames:
            bus.ins.receive(frame)
        bus.command(6)
        bus.command(command)
        bus.run(4.0)
    assert bus.newest("INS_STATUS")["MODE"] in (1, 2, 3)
