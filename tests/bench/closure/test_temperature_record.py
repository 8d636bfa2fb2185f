import numpy as np
import pytest

from gyrobench.bench.closure.campaign import campaign_of
from gyrobench.bench.closure.effects.grammar import MEMORIES
from gyrobench.bench.closure.temperature_record import (
    SAMPLES,
    TemperatureRecord,
    followed_with_play,
    lag,
    record_of_dwells,
    set_point_path,
)
from tests.bench.closure.thermal_bench import measure

DWELL_S = 1800.0


def of_course(temperature_c, starts_s, length_s=DWELL_S):
    """Record of dwells in which all three gyros follow one function of time."""
    inside_s = (np.arange(400) + 0.5) / 400 * length_s
    courses = temperature_c(starts_s[:, None] + inside_s)
    centred = inside_s - inside_s.mean()
    rates = courses @ centred / (centred @ centred) * 3600.0
    three = np.ones(3)
    return record_of_dwells(
        starts_s, starts_s + length_s, np.outer(courses.mean(axis=1), three), np.outer(rates, three)
    ), courses


def settling_c(time_s):
    return 20.0 + 40.0 * (1.0 - np.exp(-time_s / 7200.0))


def test_a_smooth_course_is_recovered_between_the_dwells_middles():
    record, _ = of_course(settling_c, DWELL_S * np.arange(16))
    inside = (record.time_s > DWELL_S) & (record.time_s < 15 * DWELL_S)
    np.testing.assert_allclose(
        record.gyro_c[inside], np.repeat(settling_c(record.time_s[inside])[:, None], 3, axis=1), atol=0.05
    )


def test_means_over_the_dwells_are_those_measured():
    starts_s = DWELL_S * np.arange(16)
    record, courses = of_course(settling_c, starts_s)
    means = record.means_over(starts_s, starts_s + DWELL_S)(record.gyro_c)
    np.testing.assert_allclose(means[1:-1, 0], courses.mean(axis=1)[1:-1], atol=0.01)
    np.testing.assert_allclose(means[[0, -1], 0], courses.mean(axis=1)[[0, -1]], atol=0.2)


def test_means_of_a_simulated_campaign_are_reproduced(clean):
    means = clean.means_over_dwells(clean.record.gyro_c)
    np.testing.assert_allclose(means, clean.gyro_c, atol=0.1)


def test_the_fine_course_of_a_simulated_campaign_is_recovered():
    measured = measure(cycles=2)
    record = campaign_of(measured.rows).record
    true_c = np.interp(record.time_s / 3600.0, measured.course.time_h, measured.course.optics_c[:, 0])
    assert np.sqrt(np.mean((record.gyro_c[:, 0] - true_c) ** 2)) < 0.1
    assert np.abs(record.gyro_c[:, 0] - true_c).max() < 1.0


def test_a_long_pause_is_bridged_without_running_away():
    starts_s = np.concatenate([DWELL_S * np.arange(6), 40 * 3600.0 + DWELL_S * np.arange(6)])
    record, _ = of_course(lambda time_s: np.where(time_s < 36_000.0, 20.0, 30.0) + 0.0 * time_s, starts_s)
    assert record.gyro_c.min() > 19.9
    assert record.gyro_c.max() < 30.1
    assert np.diff(record.time_s) == pytest.approx(np.diff(record.time_s)[0])


def test_beyond_the_first_and_last_middle_the_course_goes_on_straight():
    record, _ = of_course(lambda time_s: 20.0 + time_s / 3600.0, DWELL_S * np.arange(5))
    np.testing.assert_allclose(record.gyro_c[:, 0], 20.0 + record.time_s / 3600.0, atol=1e-6)


def test_one_dwell_alone_has_one_temperature():
    record = record_of_dwells(
        np.array([0.0]), np.array([1800.0]), np.full((1, 3), 25.0), np.full((1, 3), 7.0)
    )
    assert len(record.time_s) >= 2
    assert np.all(record.gyro_c == 25.0)


def test_two_dwells_at_one_time_count_once():
    times = np.array([0.0, 0.0, 1800.0, 3600.0])
    temperatures = np.repeat([[20.0], [20.0], [21.0], [22.0]], 3, axis=1)
    record = record_of_dwells(times, times + 1800.0, temperatures, np.full((4, 3), 2.0))
    np.testing.assert_allclose(record.gyro_c[:, 1], 20.0 + (record.time_s - 900.0) / 1800.0, atol=1e-6)


def test_means_of_a_straight_course_are_exact_also_off_the_grid():
    record = TemperatureRecord(
        np.arange(0.0, 101.0, 10.0), np.repeat(np.arange(0.0, 101.0, 10.0)[:, None], 3, 1)
    )
    squares = record.gyro_c * 0.0 + 5.0
    starts, ends = np.array([0.0, 20.0, 30.0]), np.array([100.0, 40.0, 30.0 + 20.0])
    np.testing.assert_allclose(record.means_over(starts, ends)(record.gyro_c)[:, 0], [50.0, 30.0, 40.0])
    np.testing.assert_allclose(record.means_over(starts + 3.0, ends - 4.0)(squares), 5.0)


def random_walk(count, seed=3):
    return np.random.default_rng(seed).standard_normal((count, 3)).cumsum(axis=0)


@pytest.mark.parametrize("count", [2, 4321])
@pytest.mark.parametrize("tau_s", [1.0, 3000.0, 1e6])
@pytest.mark.parametrize("jitter", [0.0, 0.2])
def test_a_lag_follows_step_by_step(count, tau_s, jitter):
    steps_s = 300.0 * (1.0 + jitter * np.random.default_rng(4).uniform(-1.0, 1.0, count - 1))
    values, behind = random_walk(count), np.zeros((count, 3))
    for index, step_s in enumerate(steps_s, start=1):
        keep = np.exp(-step_s / tau_s)
        change = values[index] - values[index - 1]
        behind[index] = keep * behind[index - 1] - (1.0 - keep) * tau_s / step_s * change
    time_s = np.concatenate([[0.0], np.cumsum(steps_s)])
    np.testing.assert_allclose(lag(values, time_s, tau_s), behind, atol=1e-8)


@pytest.mark.parametrize("half_width", [0.1, 3.0, 1000.0])
@pytest.mark.parametrize("count", [1, 2, 33, 1000])
def test_a_follower_with_play_is_pushed_step_by_step(count, half_width):
    state = random_walk(count)
    follower = [state[0]]
    for each in state[1:]:
        follower.append(np.clip(follower[-1], each - half_width, each + half_width))
    found = MEMORIES["play"](state, np.arange(count), half_width)
    np.testing.assert_array_equal(found, np.array(follower) - state)


def test_a_follower_begins_where_it_stands_and_is_lost_where_the_quantity_is():
    state = np.array([[0.0, 0.0], [1.0, np.nan], [2.0, 2.0]])
    found = followed_with_play(state, np.array([1.0, 0.5]), np.array([-0.5, 9.0]))
    np.testing.assert_array_equal(found, [[-0.5, 0.5], [0.0, np.nan], [1.0, np.nan]])


DWELL_MIN = 30.0


def means_and_course(corners, dwells, first_min=0.0):
    """Means over dwells of a course with corners (minutes, degC), and the course at the path's instants."""
    times_min, temperatures_c = np.array(corners, dtype=float).T
    starts_min = first_min + DWELL_MIN * np.arange(dwells)[:, None]

    def sampled(count):
        return np.interp(starts_min + (np.arange(count) + 0.5) / count * DWELL_MIN, times_min, temperatures_c)

    return sampled(3000).mean(axis=1), sampled(SAMPLES)


def path_of(set_c, air_c=np.nan):
    starts_s = 60.0 * DWELL_MIN * np.arange(len(set_c))
    return set_point_path(starts_s, starts_s + 60.0 * DWELL_MIN, set_c, air_c + np.zeros(len(set_c)))


@pytest.mark.parametrize("begin_min", [60.0, 67.0, 76.0, 85.0])
@pytest.mark.parametrize("rate_c_per_min", [0.3, 0.8, 1.4])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_ramp_over_several_dwells_is_recovered_from_the_means(begin_min, rate_c_per_min, sign):
    end_min = begin_min + 50.0 / rate_c_per_min
    corners = [(0, 10), (begin_min, 10), (end_min, 10 + sign * 50), (end_min + 120, 10 + sign * 50)]
    set_c, course_c = means_and_course(corners, int((end_min + 100) // DWELL_MIN))
    # A minute of a ramp at the edge of a dwell can't be distinguished from a hold.
    np.testing.assert_allclose(path_of(set_c), course_c, atol=rate_c_per_min)
    assert np.sqrt(np.mean((path_of(set_c) - course_c) ** 2)) < 0.05


def test_a_ramp_within_one_dwell_takes_the_rate_of_the_nearest_other_ramp():
    corners = [(0, 0), (65, 0), (165, 100), (250, 100), (260, 110), (400, 110)]
    set_c, course_c = means_and_course(corners, 13)
    np.testing.assert_allclose(path_of(set_c), course_c, atol=0.05)


def test_a_ramp_within_one_dwell_without_any_other_stays_at_its_mean():
    set_c, _ = means_and_course([(0, 0), (65, 0), (75, 10), (400, 10)], 10)
    np.testing.assert_allclose(path_of(set_c), np.repeat(set_c[:, None], SAMPLES, 1))


def test_a_hold_of_one_dwell_is_known_by_its_air():
    corners = [(0, 0), (60, 0), (120, 60), (150, 60), (210, 0), (300, 0)]
    set_c, course_c = means_and_course(corners, 10)
    air_c = np.where(set_c == 60.0, 59.95, np.where(set_c == 0.0, 0.02, set_c + 3.0))
    np.testing.assert_allclose(path_of(set_c, air_c), course_c, atol=0.05)


def test_a_ramp_at_the_begin_of_the_table_reaches_its_hold():
    set_c, course_c = means_and_course([(0, 0), (100, 50), (300, 50)], 9)
    np.testing.assert_allclose(path_of(set_c), course_c, atol=0.05)


def test_a_ramp_at_the_end_of_the_table_leaves_its_hold():
    set_c, course_c = means_and_course([(0, 50), (110, 50), (300, -45)], 10)
    np.testing.assert_allclose(path_of(set_c), course_c, atol=0.05)


def test_a_set_point_that_never_moves_is_held():
    set_c = np.full(8, 20.0)
    assert np.all(path_of(set_c) == 20.0)


def test_one_dwell_alone_is_held():
    assert np.all(path_of(np.array([20.0])) == 20.0)


def test_means_of_the_path_are_the_measured_ones(clean):
    np.testing.assert_allclose(clean.set_point_path_c.mean(axis=1), clean.set_c, atol=0.3)
