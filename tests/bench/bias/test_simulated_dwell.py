from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gyrobench.bench.foundations.arrays import DPH_TO_RADPS
from gyrobench.drivers.emulators.world.inertial_unit import SAMPLE_RATE_HZ, InertialUnit, Mode
from gyrobench.drivers.emulators.world.sensor_errors import MICRO_G, sense
from gyrobench.drivers.emulators.world.strapdown import EARTH_RATE, matrix_of, true_increments
from gyrobench.drivers.emulators.world.world_file import InsBehaviour
from tests.bench.bias.simulated_dwell import DwellScenario, Sensors, Table, simulate_dwell

EAST, NORTH, UP = np.eye(3)
LATITUDE, HEIGHT = np.radians(36.4), 3000.0
TABLE = Table(UP, EAST, Rotation.from_euler("ZX", [30.0, 90.0], degrees=True).as_matrix())
HALF_TURN = DwellScenario(TABLE, [(0.0, 0.0), (np.pi, 0.0)], LATITUDE, HEIGHT)
RESTING = replace(HALF_TURN, angles_rad=[(0.0, 0.0)])
BIASED = Sensors(np.array([0.05, -0.03, 0.04]) * DPH_TO_RADPS, np.array([50.0, -80.0, 30.0]) * MICRO_G)


def phi(rest, C_true):
    """Attitude error (n, 3) in ENU with ``C_computed = (I - [phi x]) C_true``."""
    return -Rotation.from_matrix(rest.C_nb @ C_true.T).as_rotvec()


def test_a_turn_of_both_axes_ends_in_the_true_attitude():
    table = Table(EAST, UP, np.eye(3))
    stops = [(np.pi / 2, 0.0), (-np.pi / 2, np.pi)]
    _, second = simulate_dwell(DwellScenario(table, stops, LATITUDE, HEIGHT), Sensors())
    np.testing.assert_allclose(
        table.attitude(*stops[1]),
        Rotation.from_rotvec(np.pi * UP).as_matrix() @ table.attitude(*stops[0]),
        atol=1e-12,
    )
    assert np.abs(phi(second, table.attitude(*stops[1]))).max() < 1e-8
    assert np.abs(second.velocity_en_mps).max() < 1e-3


def test_it_navigates_as_the_emulated_unit_does_with_the_same_sensors():
    seconds, align_s = 300, 120
    scenario = replace(RESTING, window_s=float(seconds), align_s=float(align_s))
    (rest,) = simulate_dwell(scenario, BIASED)
    behaviour = InsBehaviour(
        boot_s=0.0,
        levelling_s=0.0,
        coarse_alignment_s=align_s - 1.0,
        fine_alignment_s=float(align_s),
        epoch_period_s=1.0,
    )
    unit = InertialUnit(behaviour, LATITUDE, HEIGHT)
    still = np.zeros(SAMPLE_RATE_HZ + 1)
    dt, none = 1.0 / SAMPLE_RATE_HZ, np.zeros((SAMPLE_RATE_HZ, 3))
    rotation, velocity = true_increments(
        TABLE.outer_axis, TABLE.inner_axis, TABLE.mounting, still, still, LATITUDE, HEIGHT, dt
    )
    rotation = sense(rotation, np.zeros((3, 3)), BIASED.gyro_bias, none, dt, 0.0, np.zeros(3))
    velocity = sense(velocity, np.zeros((3, 3)), BIASED.accelerometer_bias, none, dt, 0.0, np.zeros(3))

    unit.power(True)
    unit.advance(0, rotation, velocity)
    unit.align()
    states, second = [], 1
    while len(states) < seconds:
        if unit.align_time_s >= align_s and unit.mode is Mode.ALIGN:
            unit.navigate()
        epochs = unit.advance(second * SAMPLE_RATE_HZ, rotation, velocity)
        if epochs.mode is Mode.NAVIGATE:
            states += list(epochs.states)
        second += 1
    ours = np.array(states)
    np.testing.assert_allclose(rest.velocity_en_mps[1:], ours[:, 4:6], rtol=0, atol=1e-7)
    attitudes = np.array([matrix_of(state[:4]) for state in ours])
    np.testing.assert_allclose(rest.C_nb[1:], attitudes, rtol=0, atol=1e-9)


def test_a_wrong_latitude_is_a_rate_fixed_to_the_earth():
    error = np.radians(1.0 / 60.0)
    (rest,) = simulate_dwell(replace(RESTING, latitude_error=error, window_s=60.0), Sensors())
    turned = phi(rest, TABLE.mounting)
    rate = (turned[-1] - turned[0]) / 60.0
    taken, true = (
        EARTH_RATE * np.array([0.0, np.cos(lat), np.sin(lat)]) for lat in (LATITUDE + error, LATITUDE)
    )
    np.testing.assert_allclose(rate, taken - true, rtol=0, atol=3e-3 * EARTH_RATE * error)


def test_a_changing_bias_acts_in_alignment_and_navigation_at_its_time():
    def after_a_minute(time_s):
        return np.where(time_s[:, None] > 60.0, 10.0 * DPH_TO_RADPS * TABLE.mounting[2], 0.0)

    def while_aligning(time_s):
        return np.where(time_s[:, None] < 0.0, 0.1 * DPH_TO_RADPS * TABLE.mounting[0], 0.0)

    scenario = replace(RESTING, window_s=120.0)
    (rest,) = simulate_dwell(scenario, Sensors(gyro_bias_change=after_a_minute))
    turned = phi(rest, TABLE.mounting)[:, 2]
    assert np.abs(turned[:61]).max() < 1e-8
    assert turned[-1] == pytest.approx(-10.0 * DPH_TO_RADPS * 60.0, rel=1e-4)
    (rest,) = simulate_dwell(scenario, Sensors(gyro_bias_change=while_aligning))
    expected = -0.1 * DPH_TO_RADPS / (EARTH_RATE * np.cos(LATITUDE))
    assert phi(rest, TABLE.mounting)[0, 2] == pytest.approx(expected, rel=2e-2)


def test_a_misaligned_accelerometer_tilts_the_ins():
    matrix = 1e-5 * np.outer(TABLE.mounting.T @ NORTH, TABLE.mounting.T @ UP)
    (rest,) = simulate_dwell(replace(RESTING, window_s=60.0), Sensors(accelerometer_matrix=matrix))
    assert phi(rest, TABLE.mounting)[0, 0] == pytest.approx(-1e-5, rel=1e-3)


def test_a_scale_factor_error_turns_the_heading_in_the_turn():
    matrix = 5e-6 * np.eye(3)
    rests = simulate_dwell(HALF_TURN, Sensors(gyro_matrix=matrix))
    before, after = (
        phi(rest, TABLE.attitude(outer, 0.0))[:, 2] for rest, outer in zip(rests, (0.0, np.pi), strict=True)
    )
    assert after[0] - before[-1] == pytest.approx(-5e-6 * np.pi, rel=1e-2)
