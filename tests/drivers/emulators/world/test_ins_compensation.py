import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gyrobench.drivers.emulators.world.ins_compensation import (
    COEFFICIENT_COUNT,
    SLOT,
    InsCompensation,
    TemperatureHistory,
    empty_table,
    table_checksum,
)

NO_UP = np.zeros(3)
Y_UP = np.array([0.0, 1.0, 0.0])


def numbers_of(axis=1, **values):
    """A table with numbers of one gyro: ``rate=2.0`` or ``growing=[1.0, 0.0, 0.0]``."""
    numbers = empty_table()
    for name, value in values.items():
        first = getattr(SLOT, name.upper())
        numbers[axis, first : first + np.size(value)] = value
    return numbers


def sensed(optics_c, electronics_c=None):
    """What has been sensed after readings a second apart, the same of all gyros."""
    sense = TemperatureHistory()
    for at_c in np.atleast_1d(optics_c):
        hot_c = at_c if electronics_c is None else electronics_c
        sense.read(np.full((1, 3), float(at_c)), np.full((1, 3), float(hot_c)))
    return sense


def bias_dph(numbers, sense, up_body=NO_UP, axis=1):
    bias = InsCompensation(numbers, sense, up_body).bias_dph
    assert not np.delete(bias, axis).any()
    return bias[axis]


def test_what_is_not_loaded_subtracts_nothing():
    sense = sensed([20.0, 30.0, 40.0], electronics_c=60.0)
    assert not InsCompensation(empty_table(), sense, Y_UP).bias_dph.any()


@pytest.mark.parametrize(
    ("optics_c", "used_c"), [(20.0, 20.0), (-15.0, -15.0), (-40.0, -15.0), (55.5, 55.0), (90.0, 55.0)]
)
def test_the_polynomial_is_held_beyond_its_temperatures(optics_c, used_c):
    coefficients = [0.5, -0.02, 3e-4, 1e-6, -2e-8, 1e-10]
    numbers = numbers_of(polynomial=coefficients, low_c=-15.0, high_c=55.0)
    expected = np.polynomial.polynomial.polyval(used_c, coefficients)
    assert bias_dph(numbers, sensed(optics_c)) == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize(
    ("ramp_c_per_h", "used_c_per_h"), [(12.0, 12.0), (-12.0, -12.0), (90.0, 30.0), (-90.0, -30.0)]
)
def test_the_rate_is_that_of_the_sensors_and_held_within_its_limit(ramp_c_per_h, used_c_per_h):
    sense = sensed(20.0 + np.arange(3600) * ramp_c_per_h / 3600.0)
    assert sense.rate_c_per_h == pytest.approx(ramp_c_per_h, rel=1e-6)
    assert bias_dph(numbers_of(rate=0.5, rate_limit=30.0), sense) == pytest.approx(
        0.5 * used_c_per_h, rel=1e-6
    )


def test_noise_of_the_sensors_hardly_shows_in_the_rate():
    noise_c = np.random.default_rng(3).normal(20.0, 0.003, 4000)
    rates = []
    sense = TemperatureHistory()
    for at_c in noise_c:
        sense.read(np.full((1, 3), at_c), np.zeros((1, 3)))
        rates.append(sense.rate_c_per_h[0])
    assert np.std(rates[1000:]) < 0.02


@pytest.mark.parametrize(("electronics_c", "used_k"), [(32.0, 12.0), (60.0, 25.0), (18.0, 5.0)])
def test_the_difference_between_electronics_and_optics_is_held_within_its_limits(electronics_c, used_k):
    numbers = numbers_of(gradient=0.01, difference_low=5.0, difference_high=25.0)
    assert bias_dph(numbers, sensed(20.0, electronics_c)) == pytest.approx(0.01 * used_k)


@pytest.mark.parametrize("optics_c", [-40.0, 20.0, 49.0, 53.0, 75.0])
@pytest.mark.parametrize("up_body", [Y_UP, -Y_UP, np.array([0.6, 0.0, -0.8])])
def test_the_attitude_acts_with_the_difference_where_it_is_cold(optics_c, up_body):
    onset = {"onset_c": 50.0, "onset_width": 2.0, "difference_low": 0.0, "difference_high": 30.0}
    sense = sensed(optics_c, optics_c + 10.0)
    along = np.array([0.1, -0.2, 0.3])
    cold = (50.0 - optics_c) / 2.0
    saturating = bias_dph(numbers_of(saturating=along, **onset), sense, up_body)
    assert saturating == pytest.approx(10.0 * along @ up_body / (1.0 + np.exp(-cold)), rel=1e-9)
    growing = bias_dph(numbers_of(growing=along, **onset), sense, up_body)
    assert growing == pytest.approx(10.0 * along @ up_body * np.log1p(np.exp(cold)), rel=1e-9)


def test_gravity_acts_along_the_body_axes():
    assert bias_dph(numbers_of(gravity=[0.1, 0.2, 0.3]), sensed(20.0), np.array([0.6, 0.0, -0.8])) == (
        pytest.approx(0.06 - 0.24)
    )


def test_the_warm_up_decays_from_power_on():
    numbers = numbers_of(warm_up=0.04, warm_up_time=600.0)
    sense = sensed(np.full(300, 20.0))
    compensation = InsCompensation(numbers, sense, NO_UP)
    assert compensation.bias_dph[1] == pytest.approx(0.04 * np.exp(-0.5))
    for _ in range(900):
        sense.read(np.full((1, 3), 20.0), np.full((1, 3), 20.0))
    compensation.update(sense, NO_UP)
    assert compensation.bias_dph[1] == pytest.approx(0.04 * np.exp(-2.0))


def course(*turning_points_c):
    """Temperatures a second apart, 0.01 K from one to the next."""
    pieces = [
        np.linspace(start, end, round(abs(end - start) * 100), endpoint=False)
        for start, end in itertools.pairwise(turning_points_c)
    ]
    return np.concatenate([*pieces, [turning_points_c[-1]]])


@pytest.mark.parametrize(
    ("turning_points_c", "behind_k"),
    [
        ((20.0, 30.0), -3.0),
        ((20.0, 22.0), -2.0),
        ((20.0, 10.0), 3.0),
        ((20.0, 30.0, 29.0), -2.0),
        ((20.0, 30.0, 10.0), 3.0),
    ],
)
@pytest.mark.parametrize("applied_late", [True, False])
def test_the_play_starts_at_power_on_however_late_it_is_applied(turning_points_c, behind_k, applied_late):
    numbers = numbers_of(hysteresis=0.5, half_width=3.0)
    sense = TemperatureHistory()
    compensation = None
    for at_c in course(*turning_points_c):
        sense.read(np.full((1, 3), at_c), np.full((1, 3), at_c))
        if not applied_late:
            compensation = compensation or InsCompensation(numbers, sense, NO_UP)
            compensation.update(sense, NO_UP)
    compensation = compensation or InsCompensation(numbers, sense, NO_UP)
    # What was sensed before is known every ten seconds, and so to 0.1 K here.
    assert compensation.bias_dph[1] == pytest.approx(0.5 * behind_k, abs=0.06 if applied_late else 1e-6)


def test_the_checksum_distinguishes_tables_that_differ_in_one_number():
    tables = [empty_table()]
    for index in range(COEFFICIENT_COUNT):
        tables.append(empty_table())
        tables[-1][2, index] = 1.0
    assert len({table_checksum(table) for table in tables}) == len(tables)
    assert InsCompensation(tables[3], sensed(20.0), NO_UP).checksum == table_checksum(tables[3])


@given(
    values=st.lists(
        st.floats(width=32, allow_nan=False, allow_infinity=False),
        min_size=COEFFICIENT_COUNT,
        max_size=COEFFICIENT_COUNT,
    )
)
def test_no_table_subtracts_more_than_the_gyros_can_mean(values):
    sense = sensed([20.0, 25.0, 15.0], electronics_c=60.0)
    bias = InsCompensation(np.tile(values, (3, 1)), sense, Y_UP).bias_dph
    assert np.isfinite(bias).all()
    assert np.abs(bias).max() <= 3600.0
