"""Dwells of a verification from the frames of a real run: its first navigation follows an alignment."""

from dataclasses import replace

import numpy as np
import pytest

from gyrobench.bench.bias.dwell import DwellPurpose
from gyrobench.bench.dwells.measure_dwell import measure_check_dwell
from tests.bench.dwells.conftest import with_wild_velocity


@pytest.fixture(scope="module")
def recorded(recorded):
    """Marks of one navigation after an alignment, its frames, what measures them, and the whole marks."""
    marks, frames, setup = recorded
    alone = replace(marks, windows=marks.windows[:1], purpose=DwellPurpose.CALIBRATION_CHECK)
    return alone, frames, setup, marks


def test_one_navigation_is_taken_with_temperatures_of_both_its_parts(recorded):
    marks, frames, setup, _ = recorded
    verified = measure_check_dwell(marks, frames, setup)
    assert verified.flags == ()
    (window,) = verified.navigation.dwell.windows
    np.testing.assert_allclose(np.diff(window.time_s), 1.0, atol=1e-6)
    assert verified.navigation.noise == setup.noise
    assert window.gyro_c is not None
    # The unit warms up.
    assert all(np.less(verified.alignment_c, verified.temperatures.gyro_c))
    assert verified.counts.lost == 0


def test_noise_that_is_not_declared_is_estimated_from_all_epochs(recorded):
    marks, frames, setup, _ = recorded
    verified = measure_check_dwell(marks, frames, replace(setup, noise=None))
    assert verified.flags == ()
    assert verified.navigation.noise.angle_random_walk == pytest.approx(
        setup.noise.angle_random_walk, rel=0.5
    )


def test_an_alignment_in_the_window_is_no_navigation(recorded):
    marks, frames, setup, _ = recorded
    early = replace(marks, windows=(replace(marks.windows[0], first_frame=0),))
    verified = measure_check_dwell(early, frames, setup)
    assert verified.navigation is None
    assert "left navigation" in str(verified.flags)


def test_without_frames_there_is_nothing_and_the_flag_says_why(recorded):
    marks, frames, setup, _ = recorded
    verified = measure_check_dwell(marks, frames.take(slice(0, 0)), setup)
    assert verified.navigation is None
    assert "no navigation frames" in str(verified.flags)


def test_two_navigations_are_no_verification(recorded):
    _, frames, setup, both = recorded
    verified = measure_check_dwell(both, frames, setup)
    assert verified.navigation is None
    assert "2 navigations; a calibration check has one" in str(verified.flags)


def test_an_ins_that_is_silent_while_it_aligns_has_the_temperatures_of_the_navigation(recorded):
    marks, frames, setup, _ = recorded
    first, end = marks.windows[0].first_frame, marks.windows[0].end_frame
    # The last frames of the alignment show the Euler sequence and the mode.
    silent = frames.take(slice(first - 40, None))
    shifted = replace(marks, windows=(replace(marks.windows[0], first_frame=40, end_frame=end - first + 40),))
    verified = measure_check_dwell(shifted, silent, setup)
    assert verified.flags == ()
    assert verified.alignment_c == verified.temperatures.gyro_c


def test_disturbances_stay_and_what_is_there_is_taken(recorded):
    marks, frames, setup, _ = recorded
    verified = measure_check_dwell(replace(marks, disturbances=("door opened",)), frames, setup)
    assert verified.flags == ("door opened",)
    assert verified.navigation is not None


def test_one_wild_velocity_is_flagged(recorded):
    marks, frames, setup, _ = recorded
    verified = measure_check_dwell(marks, with_wild_velocity(marks, frames), setup)
    assert "times as large as the noise explains" in str(verified.flags)
