import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gyrobench.bench.bias.verification.temperature_curve import REACH_K, TemperatureCurve

SLOPE_SIGMA = 0.001
STRAIGHT = [(-20.0, 0.001, 0.0004), (10.0, 0.004, 0.0003), (30.0, 0.006, 0.0002)]

temperatures = st.floats(-60.0, 90.0)


def curve(points):
    return TemperatureCurve(points, SLOPE_SIGMA)


def test_at_a_temperature_it_gives_what_was_measured_there():
    assert curve(STRAIGHT).at(10.0) == pytest.approx((0.004, 0.0003))


def test_between_temperatures_it_is_a_straight_line_with_the_noise_of_its_ends():
    value, sigma = curve(STRAIGHT).at(0.0)
    assert value == pytest.approx(0.003)
    assert sigma == pytest.approx(math.hypot(0.0004 / 3.0, 0.0003 * 2.0 / 3.0))


@given(st.floats(-20.0, 70.0), st.floats(-1e-5, 1e-5))
def test_what_a_parabola_bends_in_a_gap_is_in_the_uncertainty(temperature_c, bend):
    points = [(each, bend * each**2, 1e-9) for each in (-20.0, 10.0, 30.0, 70.0)]
    value, sigma = curve(points).at(temperature_c)
    assert sigma == pytest.approx(abs(value - bend * temperature_c**2), rel=1e-3, abs=2e-9)


def test_what_a_knee_adds_is_in_the_uncertainty():
    points = [(each, 3e-4 * max(0.0, 50.0 - each), 5e-4) for each in (-20.0, 3.0, 33.0, 57.0, 72.0)]
    for temperature_c in np.arange(-20.0, 72.0):
        value, sigma = curve(points).at(temperature_c)
        assert abs(value - 3e-4 * max(0.0, 50.0 - temperature_c)) < 2.5 * sigma


def test_with_two_temperatures_the_whole_change_may_be_at_one_end():
    value, sigma = curve([(0.0, 0.0, 1e-9), (40.0, 0.008, 1e-9)]).at(20.0)
    parabola = 0.008 * 0.5**2  # level at 0 degC
    assert value == pytest.approx(0.004)
    assert sigma == pytest.approx(value - parabola)


def test_a_bend_that_noise_explains_adds_nothing():
    noisy = [(-20.0, 0.0, 1e-3), (10.0, 1e-3, 1e-3), (30.0, 0.0, 1e-3), (70.0, 1e-3, 1e-3)]
    _, sigma = curve(noisy).at(20.0)
    assert sigma == pytest.approx(1e-3 / math.sqrt(2.0))


def test_temperatures_close_together_beside_a_gap_make_it_no_less_certain():
    random = np.random.default_rng(3)
    nodes_c = np.array([-23.0, 2.0, 8.0, 32.0, 58.0, 72.0])
    errors, sigmas = [], []
    for _ in range(200):
        values = 1e-5 * nodes_c + 5e-4 * random.standard_normal(6)
        value, sigma = curve([(c, v, 5e-4) for c, v in zip(nodes_c, values, strict=True)]).at(-10.0)
        errors.append(value + 1e-4)
        sigmas.append(sigma)
    assert np.median(sigmas) < 1.5 * 5e-4
    assert np.std(np.array(errors) / np.array(sigmas)) == pytest.approx(0.85, abs=0.2)


def test_values_at_nearly_the_same_temperature_are_averaged():
    value, sigma = curve([(20.0, 0.001, 0.0003), (21.0, 0.0016, 0.0004)]).at(20.36)
    assert value == pytest.approx((0.001 / 9 + 0.0016 / 16) / (1 / 9 + 1 / 16))
    assert sigma == pytest.approx(0.0005 * 0.48)


def test_values_that_scatter_beyond_their_uncertainties_are_less_certain():
    _, sigma = curve([(20.0, 0.001, 0.0001), (20.0, 0.003, 0.0001)]).at(20.0)
    assert sigma == pytest.approx(0.001)  # half their difference


def test_what_was_measured_at_either_end_of_an_average_is_within_reach():
    averaged = curve([(20.0, 0.001, 0.0003), (24.9, 0.001, 0.0003)])
    for temperature_c in (20.0 - REACH_K, 24.9 + REACH_K):
        assert averaged.at(temperature_c)[0] == pytest.approx(0.001)
    assert averaged.at(24.9 + REACH_K + 0.1) is None


def test_beyond_the_outermost_temperature_it_goes_a_little_and_is_less_certain():
    value, sigma = curve(STRAIGHT).at(30.0 + REACH_K)
    assert value == pytest.approx(0.006)
    assert sigma == pytest.approx(math.hypot(0.0002, SLOPE_SIGMA * REACH_K))
    assert curve(STRAIGHT).at(30.1 + REACH_K) is None
    assert curve(STRAIGHT).at(-20.1 - REACH_K) is None


def test_a_single_temperature_serves_near_it():
    assert curve([(20.0, 0.001, 0.0003)]).at(19.0) == pytest.approx((0.001, math.hypot(0.0003, 0.001)))
    assert curve([(20.0, 0.001, 0.0003)]).at(25.0) is None


@pytest.mark.parametrize("missing", [0, 1, 2])
def test_what_was_not_measured_is_passed_over(missing):
    point = list(STRAIGHT[1])
    point[missing] = math.nan
    assert curve([tuple(point)]).at(10.0) is None
    assert curve([*STRAIGHT, tuple(point)]).at(10.0) == curve(STRAIGHT).at(10.0)
    assert curve(STRAIGHT).at(math.nan) is None


@given(
    st.lists(st.tuples(temperatures, st.floats(-1.0, 1.0), st.floats(1e-6, 1.0)), max_size=8),
    temperatures,
)
def test_any_points_give_a_certain_value_or_none(points, temperature_c):
    found = curve(points).at(temperature_c)
    if found is not None:
        value, sigma = found
        assert min(value for _, value, _ in points) - 1e-9 <= value <= max(v for _, v, _ in points) + 1e-9
        assert 0.0 < sigma < math.inf
