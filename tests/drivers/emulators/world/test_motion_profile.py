import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gyrobench.drivers.emulators.world.table_axis import (
    AxisState,
    Motion,
    MotionLimits,
    Settling,
    change_rate,
    move,
    rest_position,
)

LIMITS = MotionLimits(rate_dps=30.0, acceleration_dps2=30.0, jerk_dps3=60.0, low_deg=-400.0, high_deg=400.0)
NO_SETTLING = Settling(0.0, 0.3)

rates = st.floats(-30.0, 30.0)
limits = st.builds(
    MotionLimits,
    rate_dps=st.floats(0.1, 200.0),
    acceleration_dps2=st.floats(0.1, 500.0),
    jerk_dps3=st.floats(1.0, 5000.0),
    low_deg=st.just(-math.inf),
    high_deg=st.just(math.inf),
)


def end_of(start, pieces):
    for piece in pieces:
        start = start.after(*piece)
    return start


@given(start_dps=rates, acceleration=st.floats(-20.0, 20.0), end_dps=rates)
def test_a_change_of_rate_ends_at_the_rate_without_acceleration(start_dps, acceleration, end_dps):
    end = end_of(
        AxisState(0.0, start_dps, acceleration),
        change_rate(AxisState(0.0, start_dps, acceleration), end_dps, LIMITS),
    )
    assert end.rate_dps == pytest.approx(end_dps, abs=1e-9)
    assert end.acceleration_dps2 == pytest.approx(0.0, abs=1e-9)


def test_a_small_change_of_rate_never_reaches_the_acceleration_limit():
    up, hold, down = change_rate(AxisState(0.0), 5.0, LIMITS)
    assert hold.duration_s == 0.0
    assert up.duration_s == down.duration_s == pytest.approx(math.sqrt(5.0 / 60.0))


def test_a_large_change_of_rate_takes_the_time_that_the_limits_imply():
    duration_s = sum(piece.duration_s for piece in change_rate(AxisState(0.0), 30.0, LIMITS))
    assert duration_s == pytest.approx(30.0 / 30.0 + 30.0 / 60.0)


@given(target=st.floats(-1000.0, 1000.0), bounds=limits)
def test_a_move_from_rest_ends_at_its_target_within_all_limits(target, bounds):
    up, along, down = move(AxisState(0.0), target, bounds)
    motion = Motion(0.0, AxisState(0.0), [*up, *along, *down], NO_SETTLING)
    assert motion.last_state.position_deg == pytest.approx(target, abs=1e-7)
    times_s = np.linspace(0.0, motion.end_s, 400)
    states = np.array([motion.at(t) for t in times_s])
    assert np.abs(states[:, 1]).max() <= bounds.rate_dps * (1.0 + 1e-9)
    assert np.abs(states[:, 2]).max() <= bounds.acceleration_dps2 * (1.0 + 1e-9)
    assert max(abs(piece.jerk_dps3) for piece in [*up, *along, *down]) <= bounds.jerk_dps3


@given(target=st.floats(-300.0, 300.0), start_dps=rates, acceleration=st.floats(-5.0, 5.0))
def test_a_move_that_starts_in_motion_still_ends_at_its_target(target, start_dps, acceleration):
    start = AxisState(7.0, start_dps, acceleration)
    up, along, down = move(start, target, LIMITS)
    end = end_of(start, [*up, *along, *down])
    assert end.position_deg == pytest.approx(target, abs=1e-7)
    assert end.rate_dps == pytest.approx(0.0, abs=1e-9)


def test_a_move_to_where_a_stop_would_end_is_that_stop():
    start = AxisState(0.0, 20.0, 0.0)
    up, along, down = move(start, rest_position(start, LIMITS), LIMITS)
    assert (up, along) == ([], [])
    assert down == change_rate(start, 0.0, LIMITS)


def test_a_move_to_infinity_turns_for_ever():
    up, along, down = move(AxisState(0.0), -math.inf, LIMITS)
    motion = Motion(5.0, AxisState(0.0), [*up, *along, *down], NO_SETTLING)
    assert motion.settled_from_s == math.inf
    assert motion.at(1e6).rate_dps == pytest.approx(-30.0)


def test_settling_begins_smoothly_peaks_at_its_size_and_ends():
    settling = Settling(size_deg=0.01, time_constant_s=0.2)
    assert settling.state(0.6).position_deg == pytest.approx(0.01)
    assert settling.state(0.0) == settling.state(settling.duration_s) == (0.0, 0.0, 0.0)
    assert settling.state(1e-6) == pytest.approx((0.0, 0.0, 0.0), abs=1e-4)
    assert abs(settling.state(settling.duration_s - 1e-9).position_deg) < 1e-8


@given(time_s=st.floats(0.01, 4.0))
def test_rate_and_acceleration_of_settling_are_derivatives_of_its_position(time_s):
    settling, h = Settling(0.01, 0.2), 1e-5
    before, at, after = (settling.state(time_s + each_s) for each_s in (-h, 0.0, h))
    assert at.rate_dps == pytest.approx((after.position_deg - before.position_deg) / 2 / h, abs=1e-7)
    assert at.acceleration_dps2 == pytest.approx((after.rate_dps - before.rate_dps) / 2 / h, abs=1e-6)


@given(time_s=st.floats(0.0, 20.0))
def test_single_times_and_arrays_give_the_same_motion(time_s):
    up, along, down = move(AxisState(0.0), 90.0, LIMITS)
    motion = Motion(1.0, AxisState(0.0), [*up, *along, *down], Settling(0.005, 0.3))
    state = motion.at(1.0 + time_s)
    times_s = np.array([1.0 + time_s])
    assert motion.positions_deg(times_s)[0] == pytest.approx(state.position_deg, abs=1e-12)
