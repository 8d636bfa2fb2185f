import numpy as np
import pytest

from gyrobench.bench.closure.temperature_record import SAMPLES, set_point_path

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
