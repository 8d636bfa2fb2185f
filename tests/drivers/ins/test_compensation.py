"""The compensation of an INS: its numbers, and what they subtract."""

import struct
import zlib

import numpy as np
import pytest

from gyrobench.bench.foundations.errors import MeasurementError
from gyrobench.drivers.ins.compensation import TERMS, Compensation, checksum
from tests.drivers.ins.compensation_reference import Conditions, compensated_dph, play

BASE = {
    "polynomial_dph": np.array([[0.01, 1e-4, -2e-6], [0.02, 0.0, 0.0], [-0.01, 2e-4, 1e-6]]),
    "low_c": np.full(3, -20.0),
    "high_c": np.full(3, 70.0),
}
TERM_NUMBERS = {
    "temperature_rate": {"rate_dph_per_c_per_h": [2e-4, 0.0, -1e-4], "rate_limit_c_per_h": [30.0] * 3},
    "thermal_gradient": {
        "gradient_dph_per_k": [1e-3, -1e-3, 0.0],
        "difference_low_k": [5.0] * 3,
        "difference_high_k": [25.0] * 3,
    },
    "attitude_thermal": {
        "saturating_dph_per_k": 1e-3 * np.arange(9.0).reshape(3, 3),
        "onset_c": [50.0, 48.0, 52.0],
        "onset_width_c": [2.0, 3.0, 4.0],
        "difference_low_k": [5.0] * 3,
        "difference_high_k": [25.0] * 3,
    },
    "attitude_thermal_growing": {
        "growing_dph_per_k": 1e-4 * np.arange(9.0).reshape(3, 3),
        "onset_c": [50.0, 48.0, 52.0],
        "onset_width_c": [2.0, 3.0, 4.0],
        "difference_low_k": [5.0] * 3,
        "difference_high_k": [25.0] * 3,
    },
    "g_sensitivity": {"gravity_dph_per_g": [[0.01, 0.0, 0.0], [0.0, 0.02, 0.01], [0.0, 0.0, -0.01]]},
    "warm_up": {"warm_up_dph": [0.04, 0.0, -0.02], "warm_up_s": [900.0] * 3},
    "thermal_hysteresis": {"hysteresis_dph_per_k": [0.005, 0.0, -0.002], "half_width_k": [3.0, 2.0, 4.0]},
}
RESTING = Conditions(
    optics_c=np.full((1, 3), 20.0),
    board_c=np.full((1, 3), 32.0),
    rate_c_per_h=np.zeros((1, 3)),
    up_body=np.array([[0.6, 0.0, 0.8]]),
    since_power_on_s=np.array([1e9]),
)


def compensation(*terms, **changes):
    numbers = {name: np.array(value) for term in terms for name, value in TERM_NUMBERS[term].items()}
    return Compensation(**{**BASE, **numbers, **changes})


def conditions(**changes):
    return Conditions(**{**vars(RESTING), **changes})


def test_the_polynomial_is_held_beyond_its_temperatures():
    optics_c = np.array([[-40.0, 20.0, 90.0], [-20.0, 20.0, 70.0]])
    outside, inside = compensated_dph(compensation(), conditions(optics_c=optics_c, board_c=optics_c))
    np.testing.assert_array_equal(outside, inside)
    assert inside[2] == pytest.approx(-0.01 + 2e-4 * 70.0 + 1e-6 * 70.0**2)


def added_dph(term, **changes):
    """What one term adds to the polynomial, for the x gyro, with the conditions changed."""
    there = conditions(**changes)
    return (compensated_dph(compensation(term), there) - compensated_dph(compensation(), there))[-1, 0]


@pytest.mark.parametrize(("rate_c_per_h", "used"), [(10.0, 10.0), (100.0, 30.0), (-100.0, -30.0)])
def test_the_rate_is_held_within_its_limit(rate_c_per_h, used):
    assert added_dph("temperature_rate", rate_c_per_h=np.full((1, 3), rate_c_per_h)) == pytest.approx(
        2e-4 * used
    )


@pytest.mark.parametrize(("board_c", "used_k"), [(32.0, 12.0), (60.0, 25.0), (20.0, 5.0)])
def test_the_difference_is_held_within_its_limits(board_c, used_k):
    assert added_dph("thermal_gradient", board_c=np.full((1, 3), board_c)) == pytest.approx(1e-3 * used_k)


@pytest.mark.parametrize("optics_c", [-60.0, 10.0, 50.0, 58.0])
def test_the_attitude_acts_in_the_cold_alone(optics_c):
    there = {"optics_c": np.full((1, 3), optics_c), "board_c": np.full((1, 3), optics_c + 12.0)}
    cold = (50.0 - max(optics_c, -20.0)) / 2.0
    along = 0.0 * 0.6 + 2.0 * 0.8
    saturated = 1e-3 * along * 12.0 / (1.0 + np.exp(-cold))
    assert added_dph("attitude_thermal", **there) == pytest.approx(saturated)
    grown = 1e-4 * along * 12.0 * np.log1p(np.exp(cold))
    assert added_dph("attitude_thermal_growing", **there) == pytest.approx(grown)


def test_gravity_and_warm_up_add_what_their_numbers_say():
    assert added_dph("g_sensitivity") == pytest.approx(0.006)
    assert added_dph("warm_up", since_power_on_s=np.array([900.0])) == pytest.approx(0.04 / np.e)


def test_hysteresis_follows_the_way_that_the_temperature_came():
    up, down = np.linspace(0.0, 20.0, 50), np.linspace(40.0, 20.0, 50)
    for course_c, behind_k in ((up, -3.0), (down, 3.0)):
        there = {
            "optics_c": np.tile(course_c[:, np.newaxis], 3),
            "board_c": np.tile(course_c[:, np.newaxis], 3) + 12.0,
            "rate_c_per_h": np.zeros((50, 3)),
            "up_body": np.tile([0.0, 0.0, 1.0], (50, 1)),
            "since_power_on_s": np.arange(50.0),
        }
        assert added_dph("thermal_hysteresis", **there) == pytest.approx(0.005 * behind_k)


def test_the_play_is_never_farther_behind_than_its_half_width():
    values = np.array([[0.0] * 3, [5.0] * 3, [4.0] * 3, [-5.0] * 3])
    half_width = np.array([0.0, 3.0, 100.0])
    np.testing.assert_array_equal(play(values, half_width), [[0, 0, 0], [5, 2, 0], [4, 2, 0], [-5, -2, 0]])


def test_the_terms_in_use_are_named():
    assert compensation().terms() == ()
    assert compensation(*TERMS).terms() == tuple(TERMS)
    assert compensation("warm_up").terms() == ("warm_up",)


def test_the_checksum_is_the_crc_of_32_bit_floats():
    numbers = [0.1, -2.5, 1e-7]
    assert checksum(numbers) == zlib.crc32(struct.pack("<3f", *numbers))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"low_c": np.full(3, 80.0)}, "low_c must not be above high_c"),
        ({"low_c": np.zeros(2)}, r"low_c has the shape \(2,\), not \(3,\)"),
        ({"polynomial_dph": np.full((3, 2), np.nan)}, "polynomial_dph must hold finite numbers"),
        ({"polynomial_dph": np.zeros((2, 4))}, "polynomial_dph has the shape"),
        ({"polynomial_dph": np.zeros((3, 0))}, "polynomial_dph has the shape"),
        ({"rate_dph_per_c_per_h": np.array([0.0, 1.0, 0.0])}, "needs rate_limit_c_per_h above zero"),
        ({"warm_up_dph": np.ones(3), "warm_up_s": np.array([1.0, 0.0, 1.0])}, "needs warm_up_s above zero"),
        ({"growing_dph_per_k": np.ones((3, 3))}, "needs onset_width_c above zero"),
        ({"gradient_dph_per_k": np.ones(3)}, "needs difference_low_k below difference_high_k"),
    ],
)
def test_numbers_that_mean_nothing_are_mistakes(changes, message):
    with pytest.raises(MeasurementError, match=message):
        compensation(**changes)
