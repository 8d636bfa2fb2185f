import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from gyrobench.bench.foundations.arrays import DPH_TO_RADPS
from gyrobench.drivers.emulators.world.inertial_unit import AlignmentQuality, InertialUnit, Mode
from gyrobench.drivers.emulators.world.ins_compensation import SLOT, empty_table
from gyrobench.drivers.emulators.world.sensor_errors import MICRO_G
from gyrobench.drivers.emulators.world.strapdown import EARTH_RATE, matrix_of, normal_gravity
from gyrobench.drivers.emulators.world.world_file import InsBehaviour

LATITUDE, HEIGHT = np.radians(36.4), 60.0
EARTH = EARTH_RATE * np.array([0.0, np.cos(LATITUDE), np.sin(LATITUDE)])
GRAVITY = normal_gravity(LATITUDE, HEIGHT)
UP = np.array([0.0, 0.0, 1.0])
QUICK = {"boot_s": 0.0, "levelling_s": 2.0, "coarse_alignment_s": 5.0, "fine_alignment_s": 12.0}


class Line:
    """A unit and the samples that come to it, at rest by default."""

    def __init__(self, attitude=None, gyro_error=0.0, accelerometer_error=0.0, **behaviour):
        self.unit = InertialUnit(InsBehaviour(**behaviour), LATITUDE, HEIGHT)
        C_bn = (np.eye(3) if attitude is None else attitude).T
        self.rate = C_bn @ EARTH + gyro_error
        self.force = C_bn @ (GRAVITY * UP) + accelerometer_error
        self.sample = 0

    def run(self, seconds, turning_radps=0.0):
        epochs = []
        for _ in range(seconds):
            rows = np.full((100, 1), 0.01)
            epochs.append(
                self.unit.advance(self.sample, rows * (self.rate + turning_radps), rows * self.force)
            )
            self.sample += 100
        return epochs

    def switch_on(self):
        self.unit.power(True)
        self.run(1 + round(self.unit._behaviour.boot_s))
        assert self.unit.mode is Mode.STANDBY
        return self

    def align(self, seconds):
        self.unit.align()
        return self.run(seconds)


def test_without_power_it_stays_off_and_says_nothing():
    line = Line()
    assert set(line.run(60)) == {None}
    assert line.unit.mode is Mode.OFF


def test_it_boots_into_standby_and_hears_no_command_before():
    line = Line(boot_s=8.0)
    line.unit.power(True)
    for command in (line.unit.align, line.unit.navigate, line.unit.standby):
        command()
    assert line.run(8) == [None] * 8
    (epochs,) = line.run(1)
    assert epochs.mode is Mode.STANDBY
    assert epochs.alignment is AlignmentQuality.INVALID


def test_epochs_come_at_whole_multiples_of_the_period():
    line = Line(boot_s=0.0, epoch_period_s=0.25).switch_on()
    samples = np.concatenate([epochs.sample for epochs in line.run(3)])
    assert samples.tolist() == [*range(125, 401, 25)]


def test_alignment_is_coarse_and_then_fine_after_levelling_and_their_times():
    line = Line(boot_s=0.0, levelling_s=10.0, coarse_alignment_s=30.0, fine_alignment_s=240.0).switch_on()
    alignments = [epochs.alignment for epochs in line.align(260)]
    assert alignments.index(AlignmentQuality.COARSE) == 40
    assert alignments.index(AlignmentQuality.FINE) == 250
    assert alignments == sorted(alignments)
    assert line.unit.align_time_s == 249.0  # the second under way is not counted yet


def test_the_unit_outputs_no_attitude_before_coarse_alignment():
    line = Line(Rotation.from_rotvec([0.1, 0.2, 1.0]).as_matrix(), **QUICK).switch_on()
    epochs = line.align(8)
    assert all(np.array_equal(each.states[:, :4], [[1, 0, 0, 0]] * 10) for each in epochs[:7])
    assert not np.array_equal(epochs[7].states[0, :4], [1, 0, 0, 0])


@pytest.mark.parametrize("rate_dps", [0.03, -0.03, 5.0])
def test_motion_restarts_the_alignment(rate_dps):
    line = Line(**QUICK).switch_on()
    line.align(9)
    assert line.unit.alignment is AlignmentQuality.COARSE
    line.run(1, np.radians(rate_dps) * UP)
    (epochs,) = line.run(1)
    assert epochs.alignment is AlignmentQuality.INVALID
    assert line.unit.align_time_s == 0.0
    assert line.unit.mode is Mode.ALIGN
    alignments = [epochs.alignment for epochs in line.run(7)]
    assert alignments == [AlignmentQuality.INVALID] * 6 + [AlignmentQuality.COARSE]


def test_what_a_resting_table_does_is_no_motion():
    line = Line(**QUICK).switch_on()
    line.align(9)
    (epochs, _) = line.run(2, np.radians(0.01) * UP)
    assert epochs.alignment is AlignmentQuality.COARSE
    assert line.unit.alignment is AlignmentQuality.COARSE


def test_a_new_align_command_restarts_the_alignment():
    line = Line(**QUICK).switch_on()
    line.align(9)
    assert [epochs.alignment for epochs in line.align(8)] == [AlignmentQuality.INVALID] * 7 + [
        AlignmentQuality.COARSE
    ]


def test_it_navigates_only_from_an_alignment_that_is_coarse_at_least():
    line = Line(**QUICK).switch_on()
    line.unit.navigate()
    assert line.unit.mode is Mode.STANDBY
    line.align(7)
    line.unit.navigate()
    assert line.unit.mode is Mode.ALIGN
    line.run(1)
    line.unit.navigate()
    (epochs,) = line.run(1)
    assert epochs.mode is line.unit.mode is Mode.NAVIGATE
    assert epochs.alignment is AlignmentQuality.COARSE


def test_navigation_at_rest_continues_from_the_alignment():
    attitude = Rotation.from_rotvec([0.3, -1.0, 2.0]).as_matrix()
    line = Line(attitude, **QUICK).switch_on()
    line.align(9)
    line.unit.navigate()
    last = line.run(60)[-1].states[-1]
    np.testing.assert_allclose(matrix_of(last[:4]), attitude, atol=1e-9)
    np.testing.assert_allclose(last[4:6], 0.0, atol=1e-6)


def test_standby_ends_navigation_and_its_attitude():
    line = Line(**QUICK).switch_on()
    line.align(9)
    line.unit.navigate()
    line.run(2)
    line.unit.standby()
    (epochs,) = line.run(1)
    assert epochs.mode is Mode.STANDBY
    assert epochs.alignment is AlignmentQuality.INVALID
    assert not line.unit.uses_sensors


def attitude_error(line, attitude):
    """phi (3,) in ENU with ``C_computed = (I - [phi x]) C_true``."""
    line.unit.align()
    states = line.run(20)[-1].states
    minus_cross = matrix_of(states[-1, :4]) @ attitude.T - np.eye(3)
    return np.array([minus_cross[1, 2], minus_cross[2, 0], minus_cross[0, 1]])


ATTITUDES = [np.eye(3), Rotation.from_euler("ZXY", [70.0, -25.0, 130.0], degrees=True).as_matrix()]


@pytest.mark.parametrize("attitude", ATTITUDES)
def test_alignment_with_perfect_sensors_is_perfect(attitude):
    line = Line(attitude, **QUICK).switch_on()
    np.testing.assert_allclose(attitude_error(line, attitude), 0.0, atol=1e-12)


@pytest.mark.parametrize("attitude", ATTITUDES)
@pytest.mark.parametrize(("east_ug", "north_ug"), [(50.0, 0.0), (0.0, 50.0), (-20.0, 80.0)])
def test_alignment_is_tilted_by_accelerometer_bias_over_gravity(attitude, east_ug, north_ug):
    error = attitude.T @ (np.array([east_ug, north_ug, 30.0]) * MICRO_G)
    line = Line(attitude, accelerometer_error=error, **QUICK).switch_on()
    phi = attitude_error(line, attitude)
    assert phi[0] == pytest.approx(-north_ug * MICRO_G / GRAVITY, rel=1e-3, abs=1e-8)
    assert phi[1] == pytest.approx(east_ug * MICRO_G / GRAVITY, rel=1e-3, abs=1e-8)
    # The tilt turns part of the vertical Earth rate into the east gyro.
    assert phi[2] == pytest.approx(phi[1] * np.tan(LATITUDE), rel=1e-3, abs=1e-8)


@pytest.mark.parametrize("attitude", ATTITUDES)
@pytest.mark.parametrize("east_dph", [0.01, -0.05])
def test_alignment_is_turned_by_the_east_gyro_over_the_horizontal_earth_rate(attitude, east_dph):
    error = attitude.T @ (np.array([east_dph, 0.01, -0.02]) * DPH_TO_RADPS)
    line = Line(attitude, gyro_error=error, **QUICK).switch_on()
    phi = attitude_error(line, attitude)
    assert phi[2] == pytest.approx(-east_dph * DPH_TO_RADPS / (EARTH_RATE * np.cos(LATITUDE)), rel=2e-3)
    np.testing.assert_allclose(phi[:2], 0.0, atol=1e-9)


def test_navigation_starts_with_the_latitude_entered():
    line = Line(latitude_error_arcmin=3.0, **QUICK).switch_on()
    latitude = line.align(1)[0].states[0, 6]
    assert np.degrees(latitude) == pytest.approx(36.4 + 3.0 / 60.0, abs=1e-12)


def noisy_story(sizes):
    """Epochs of a unit that boots, aligns, is moved, aligns again and navigates, with cut samples."""
    random = np.random.default_rng(5)
    rotation = 0.01 * EARTH + random.normal(0.0, 1e-8, (4000, 3))
    velocity = 0.01 * GRAVITY * UP + random.normal(0.0, 1e-5, (4000, 3))
    rotation[1430:1460] += 1e-3
    unit = InertialUnit(InsBehaviour(**QUICK | {"boot_s": 1.5}), LATITUDE, HEIGHT)
    commands = {30: lambda: unit.power(True), 310: unit.align, 2755: unit.navigate, 3990: unit.standby}
    stops = sorted({*commands, *range(0, 4001, 100)})
    story, sample, turn = [], 0, 0
    while sample < 4000:
        if sample in commands:
            commands[sample]()
        stop = min(next(s for s in stops if s > sample), sample + sizes[turn % len(sizes)])
        epochs = unit.advance(sample, rotation[sample:stop], velocity[sample:stop])
        if epochs is not None:
            story += [
                (int(k), state.tobytes(), epochs.mode, epochs.alignment)
                for k, state in zip(epochs.sample, epochs.states, strict=True)
            ]
        sample, turn = stop, turn + 1
    return story


@given(sizes=st.lists(st.integers(1, 130), min_size=1, max_size=5))
def test_epochs_are_equal_to_the_bit_however_the_samples_are_cut(sizes):
    story = noisy_story(sizes)
    assert {mode for _, _, mode, _ in story} == {Mode.STANDBY, Mode.ALIGN, Mode.NAVIGATE}
    assert story == noisy_story([100])


def test_what_is_loaded_waits_until_it_is_applied():
    unit = Line().unit
    assert unit.compensation is None
    unit.loaded_table[0, 0] = 0.25
    assert unit.compensation is None
    unit.apply_compensation()
    unit.loaded_table[0, 0] = 7.0
    assert unit.compensation.bias_dph.tolist() == [0.25, 0.0, 0.0]
    unit.apply_compensation()
    assert unit.compensation.bias_dph.tolist() == [7.0, 0.0, 0.0]
    unit.clear_compensation()
    unit.apply_compensation()
    assert unit.compensation.bias_dph.tolist() == [0.0, 0.0, 0.0]


def along_up(line):
    """What a compensation that follows Up with a vector of 1, 2 and 3 deg/h/g subtracts."""
    line.unit.loaded_table[:, SLOT.GRAVITY : SLOT.GRAVITY + 3] = np.diag([1.0, 2.0, 3.0])
    line.unit.apply_compensation()
    line.unit.sense_temperatures(np.full((1, 3), 20.0), np.full((1, 3), 30.0))
    return line.unit.compensation.bias_dph


@pytest.mark.parametrize("attitude", ATTITUDES)
def test_a_compensation_knows_up_by_the_accelerometers_and_then_as_navigated(attitude):
    line = Line(attitude, **QUICK).switch_on()
    assert along_up(line).tolist() == [0.0, 0.0, 0.0]
    line.align(1)
    np.testing.assert_allclose(along_up(line), attitude[2] * [1.0, 2.0, 3.0], rtol=1e-9)
    line.run(9)
    line.unit.navigate()
    line.rate = line.rate + np.radians(0.1) * UP
    line.run(100)
    turned = matrix_of(line.unit._state[:4])[2]
    np.testing.assert_allclose(along_up(line), turned * [1.0, 2.0, 3.0], rtol=1e-9)
    line.unit.standby()
    assert along_up(line).tolist() == [0.0, 0.0, 0.0]


def test_power_off_loses_everything():
    line = Line(**QUICK | {"boot_s": 3.0}).switch_on()
    unit = line.unit
    line.align(9)
    unit.navigate()
    unit.pitch_first = True
    unit.loaded_table[1, 0] = 0.5
    unit.apply_compensation()
    unit.power(False)
    assert set(line.run(20)) == {None}
    assert (unit.mode, unit.alignment) == (Mode.OFF, AlignmentQuality.INVALID)
    unit.power(True)
    assert line.run(3) == [None] * 3
    (epochs,) = line.run(1)
    assert (epochs.mode, epochs.alignment) == (Mode.STANDBY, AlignmentQuality.INVALID)
    assert not unit.pitch_first
    assert unit.compensation is None
    assert np.array_equal(unit.loaded_table, empty_table())
    unit.navigate()
    assert unit.mode is Mode.STANDBY


def test_switching_on_what_is_on_already_changes_nothing():
    line = Line(**QUICK).switch_on()
    line.align(9)
    line.unit.power(True)
    assert (line.unit.mode, line.unit.alignment) == (Mode.ALIGN, AlignmentQuality.COARSE)
