from dataclasses import replace

import numpy as np
import pytest

from gyrobench.bench.closure.campaign import campaign_of
from tests.bench.closure.thermal_bench import measure

ALL = ("set", "air", "case", "board")


def above_optics(measured):
    """What the campaign says of the electronics above the optics, and what is true."""
    course = measured.course
    true_c = course.board_c - course.optics_c
    steps = round((measured.rows[0].end_s - measured.rows[0].start_s) / 60.0)
    starts = [round(row.start_s / 60.0) for row in measured.rows]
    means_c = np.array([true_c[first : first + steps].mean(axis=0) for first in starts])
    return campaign_of(measured.rows).above_optics_c, means_c


@pytest.mark.parametrize("attitude_convection", [0.0, 0.3])
def test_a_network_off_by_several_times_the_noise_of_the_sensors_does_not_replace_them(attitude_convection):
    """It is off by 25 mK, the sensors by 5 mK."""
    estimated_c, true_c = above_optics(
        measure(cycles=2, attitude_convection=attitude_convection, sensors=ALL)
    )
    assert np.sqrt(np.mean((estimated_c - true_c) ** 2)) < 0.01


@pytest.mark.parametrize("attitude_convection", [0.0, 0.3])
def test_with_noisy_sensors_the_network_is_closer_to_the_truth_than_they_are(attitude_convection):
    measured = measure(cycles=2, attitude_convection=attitude_convection, sensors=ALL)
    draw = np.random.default_rng(2)
    rows = [replace(row, board_c=tuple(draw.normal(row.board_c, 0.08).tolist())) for row in measured.rows]
    estimated_c, true_c = above_optics(replace(measured, rows=rows))
    assert np.sqrt(np.mean((estimated_c - true_c) ** 2)) < 0.06


def test_where_no_network_describes_the_temperatures_the_sensors_say_it():
    measured = measure(cycles=2, power_steps_h=5.3, sensors=ALL)
    estimated_c, true_c = above_optics(measured)
    np.testing.assert_allclose(estimated_c, true_c, atol=0.03)


def test_pauses_leave_the_sensors_alone_to_say_it():
    estimated_c, true_c = above_optics(measure(cycles=2, pause_s=600.0, sensors=ALL))
    np.testing.assert_allclose(estimated_c, true_c, atol=0.03)
    assert campaign_of(measure(cycles=2, pause_s=600.0, sensors=("case",)).rows).above_optics_c is None


def test_flagged_dwells_in_between_are_no_pauses():
    rows = measure(cycles=2, attitude_convection=0.3, sensors=("case",)).rows
    flagged = [replace(row, flags=("vibration",)) if row.dwell % 7 == 0 else row for row in rows]
    good = np.array([not row.flags for row in flagged])
    np.testing.assert_array_equal(campaign_of(flagged).above_optics_c, campaign_of(rows).above_optics_c[good])


def test_after_a_dwell_without_temperatures_the_network_is_initialized_again():
    rows = measure(cycles=2, attitude_convection=0.3, sensors=("case",)).rows
    whole_c = campaign_of(rows).above_optics_c
    rows[9] = replace(rows[9], gyro_c=(np.nan,) * 3)
    estimated_c = campaign_of(rows).above_optics_c
    for estimated, whole in zip(estimated_c.T, np.delete(whole_c, 9, axis=0).T, strict=True):
        assert np.corrcoef(estimated, whole)[0, 1] > 0.99


def test_many_pauses_leave_the_network_nothing_to_go_by():
    assert campaign_of(measure(cycles=2, pause_s=600.0, sensors=("case",)).rows).above_optics_c is None


def test_held_out_temperatures_do_not_change_the_others():
    rows = measure(cycles=3, attitude_convection=0.3, sensors=("case", "board")).rows
    few = [row for row in rows if row.cycle < 3] + [row for row in rows if row.cycle == 3][:4]
    seen, short = (campaign_of(each).holding_out([3]).part for each in (rows, few))
    searched = [np.array([row.cycle < 3 for row in each]) for each in (rows, few)]
    np.testing.assert_array_equal(seen(searched[0]).above_optics_c, short(searched[1]).above_optics_c)


def test_without_sensors_at_the_electronics_the_difference_is_known_but_for_scale_and_offset():
    estimated_c, true_c = above_optics(measure(cycles=2, attitude_convection=0.3, sensors=("case",)))
    for estimated, true in zip(estimated_c.T, true_c.T, strict=True):
        line = np.polyval(np.polyfit(estimated, true, 1), estimated)
        assert np.std(true - line) < 0.2 * np.std(true)
