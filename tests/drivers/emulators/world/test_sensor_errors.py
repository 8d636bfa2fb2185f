import itertools
import math

import numpy as np
import pytest

from gyrobench.bench.foundations.arrays import DPH_TO_RADPS
from gyrobench.drivers.emulators.world.sensor_errors import (
    ARCSEC,
    MICRO_G,
    PPM,
    accelerometer_errors,
    gyro_errors,
    sense,
)
from gyrobench.drivers.emulators.world.world_file import AccelerometerErrors, GyroErrors

AXES = "xyz"
#: Each kind of sensor: its model, what turns it into SI, its key of the bias and that key's unit.
KINDS = {
    "gyro": (GyroErrors, gyro_errors, "bias_dph", DPH_TO_RADPS),
    "accelerometer": (AccelerometerErrors, accelerometer_errors, "bias_ug", MICRO_G),
}
#: The twelve coefficients of one equation: group, key, sensor that it acts on, component it multiplies.
COEFFICIENTS = [
    *(("bias", AXES[i], i, None) for i in range(3)),
    *(("scale_factor_ppm", AXES[i], i, i) for i in range(3)),
    *(("misalignment_arcsec", AXES[i] + AXES[j], i, j) for i, j in itertools.permutations(range(3), 2)),
]
DT = 0.01
#: A motion whose components can't be mistaken for each other, and temperatures likewise.
TRUE = np.array([1.0, -20.0, 300.0])
DIFFERENCE_C = np.array([10.0, -30.0, 45.0])

over_all_24 = pytest.mark.parametrize(
    ("kind", "group", "key", "sensor", "component"),
    [(kind, *coefficient) for kind in KINDS for coefficient in COEFFICIENTS],
    ids=lambda value: str(value),
)


def triad(kind, group, key, value):
    model, in_si, bias_key, unit = KINDS[kind]
    errors = in_si(model.model_validate({bias_key if group == "bias" else group: {key: value}}))
    return errors, {"bias": unit, "scale_factor_ppm": PPM, "misalignment_arcsec": ARCSEC}[group]


def output_error(errors, difference_c):
    """Error of the sensors' output per second while they feel ``TRUE``."""
    bias, matrix = errors.at(difference_c)
    rows = np.tile(TRUE * DT, (4, 1))
    sensed = sense(rows, matrix, bias, np.zeros_like(rows), DT, 0.0, np.zeros(3))
    return (sensed - rows)[-1] / DT


@over_all_24
def test_each_coefficient_acts_where_the_equations_say(kind, group, key, sensor, component):
    errors, unit = triad(kind, group, key, 50.0)
    expected = np.zeros(3)
    expected[sensor] = 50.0 * unit * (1.0 if component is None else TRUE[component])
    np.testing.assert_allclose(output_error(errors, DIFFERENCE_C), expected, rtol=1e-8, atol=1e-12)


@over_all_24
def test_each_coefficient_follows_the_temperature_of_its_own_sensor(kind, group, key, sensor, component):
    polynomial = [50.0, -0.3, 0.02, 1e-3, -2e-5, 1e-7]
    errors, unit = triad(kind, group, key, polynomial)
    value = sum(c * DIFFERENCE_C[sensor] ** degree for degree, c in enumerate(polynomial))
    expected = np.zeros(3)
    expected[sensor] = value * unit * (1.0 if component is None else TRUE[component])
    np.testing.assert_allclose(output_error(errors, DIFFERENCE_C), expected, rtol=1e-8, atol=1e-12)


def test_all_coefficients_act_together_as_their_sum():
    data = {
        "bias_dph": {"x": 5.0},
        "scale_factor_ppm": {"x": 20.0},
        "misalignment_arcsec": {"xy": 3.0, "xz": 2.0},
    }
    error = output_error(gyro_errors(GyroErrors.model_validate(data)), np.zeros(3))[0]
    expected = 5.0 * DPH_TO_RADPS + 20.0 * PPM * TRUE[0] + 3.0 * ARCSEC * TRUE[1] + 2.0 * ARCSEC * TRUE[2]
    assert error == pytest.approx(expected, rel=1e-8)


def test_units_are_what_they_say():
    assert math.degrees(DPH_TO_RADPS) * 3600 == pytest.approx(1.0)
    assert math.degrees(ARCSEC) * 3600 == pytest.approx(1.0)
    assert pytest.approx(9.80665) == MICRO_G * 1e6


def test_without_noise_given_the_sensors_have_none():
    assert gyro_errors(GyroErrors()).random_walk == 0.0
    assert accelerometer_errors(AccelerometerErrors()).random_walk == 0.0


def test_pulse_sizes_become_si():
    assert gyro_errors(GyroErrors(pulse_arcsec=2.0)).pulse == pytest.approx(math.radians(2.0 / 3600.0))
    assert accelerometer_errors(AccelerometerErrors(pulse_um_per_s=30.0)).pulse == pytest.approx(3e-5)


def felt_by_a_resting_unit(world, seconds):
    """What gyros and accelerometers add to what they feel, summed over each second."""
    resting = world._at_rest()
    normal = world._random.standard_normal((seconds, 1, 600))
    measured = [world._measured_increments(each, 100, resting) for each in normal]
    return [
        np.array([rows[kind].sum(axis=0) for rows in measured]) - resting[kind].sum(axis=0) for kind in (0, 1)
    ]


@pytest.mark.parametrize("average_s", [1, 20])
def test_random_walks_have_the_size_that_the_world_file_says(make_world, average_s):
    world = make_world(
        seed=3,
        gyro={"bias_dph": {}, "angle_random_walk_deg_per_sqrt_h": 0.0006},
        accelerometer={"velocity_random_walk_ug_per_sqrt_hz": 5.0},
    )
    gyros, accelerometers = felt_by_a_resting_unit(world, 6000)
    walks_deg = np.degrees(gyros).reshape(-1, average_s, 3).sum(axis=1)
    walks_mps = accelerometers.reshape(-1, average_s, 3).sum(axis=1)
    relative = 4.0 / math.sqrt(2 * walks_deg.size)
    assert walks_deg.std() == pytest.approx(0.0006 / 60.0 * math.sqrt(average_s), rel=relative)
    assert walks_mps.std() == pytest.approx(5.0 * MICRO_G * math.sqrt(average_s), rel=relative)
    assert abs(walks_deg.mean()) < 4.0 * walks_deg.std() / math.sqrt(walks_deg.size)


def test_the_noises_of_the_six_sensors_have_nothing_to_do_with_each_other(make_world):
    world = make_world(
        gyro={"angle_random_walk_deg_per_sqrt_h": 0.0006},
        accelerometer={"velocity_random_walk_ug_per_sqrt_hz": 5.0},
    )
    correlation = np.corrcoef(np.hstack(felt_by_a_resting_unit(world, 3000)), rowvar=False)
    assert np.abs(correlation - np.eye(6)).max() < 0.08
