import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from gyrobench.drivers.emulators.world.table_axis import AxisParameters, TableAxis

PARAMETERS = AxisParameters()
IDEAL = AxisParameters(position_error_arcsec=0.0, settling_amplitude_arcsec=0.0)
ARCSEC = 1.0 / 3600.0

#: (what, argument, pause before it in s): any commands in any order
commands = st.lists(
    st.tuples(
        st.sampled_from(["move_to", "turn_at", "stop", "release"]),
        st.floats(-500.0, 500.0),
        st.floats(0.0, 12.0),
    ),
    min_size=1,
    max_size=6,
)


def command(axis, what, argument, now_s):
    method = getattr(axis, what)
    if what in ("move_to", "turn_at"):
        method(argument, now_s)
    else:
        method(now_s)


def time_of_rest(axis, now_s):
    while axis.is_moving(now_s):
        now_s += 0.5
    return now_s


def position(axis, time_s):
    return float(axis.position_deg(np.array([time_s]))[0])


def rate(axis, time_s):
    """True rate, from two positions."""
    before_deg, after_deg = axis.position_deg(time_s + np.array([-1e-4, 1e-4]))
    return (after_deg - before_deg) / 2e-4


@given(commands)
def test_no_sequence_of_commands_makes_an_ideal_axis_break_a_limit(sequence):
    axis = TableAxis(IDEAL)
    now_s = 0.0
    for what, argument, pause_s in sequence:
        times_s = np.linspace(now_s, now_s + pause_s, 60)
        states = np.array([axis.encoder(t) for t in times_s])
        assert np.abs(states[:, 0]).max() <= 400.0 + 1e-6
        assert np.abs(states[:, 1]).max() <= 30.0 + 1e-6
        assert np.abs(states[:, 2]).max() <= 30.0 + 1e-6
        assert np.abs(np.diff(states[:, 2])).max() <= 60.0 * pause_s / 59.0 + 1e-6
        now_s += pause_s
        command(axis, what, argument, now_s)


@example([("turn_at", 7.5, 2.0), ("move_to", 5e-324, 3.5)])  # reached but for rounding
@given(commands)
def test_position_and_rate_never_jump_for_any_commands(sequence):
    axis = TableAxis(PARAMETERS)
    now_s = 0.0
    for what, argument, pause_s in sequence:
        now_s += pause_s
        before = position(axis, now_s), axis.encoder(now_s).rate_dps
        command(axis, what, argument, now_s)
        assert position(axis, now_s) == pytest.approx(before[0], abs=1e-8)
        assert axis.encoder(now_s).rate_dps == pytest.approx(before[1], abs=1e-7)


@given(commands, st.floats(0.001, 0.01))
def test_samples_that_straddle_a_command_see_no_jump(sequence, lag_s):
    axis = TableAxis(PARAMETERS)
    now_s = 2.0
    for what, argument, pause_s in sequence:
        now_s += pause_s
        before = position(axis, now_s - lag_s)
        command(axis, what, argument, now_s)
        assert position(axis, now_s - lag_s) == pytest.approx(before, abs=1e-9)


@given(st.floats(-400.0, 400.0))
def test_a_move_ends_at_its_position_within_the_error_of_the_encoder(target):
    axis = TableAxis(PARAMETERS)
    axis.move_to(target, 1.0)
    end_s = time_of_rest(axis, 1.0)
    assert axis.encoder(end_s).position_deg == target
    assert abs(position(axis, end_s) - target) <= PARAMETERS.position_error_arcsec * ARCSEC + 1e-12


def test_the_error_of_the_encoder_is_the_same_each_time_and_reaches_its_bound():
    axis = TableAxis(replace(PARAMETERS, settling_amplitude_arcsec=0.0))
    errors = []
    for target in (60.0, 0.0, 60.0):
        now_s = time_of_rest(axis, axis._motions[-1].start_s)
        axis.move_to(target, now_s)
        errors.append(position(axis, time_of_rest(axis, now_s)) - target)
    assert errors[0] == errors[2] != errors[1]
    degrees = np.arange(0.0, 360.0)
    errors = [position(TableAxis(PARAMETERS, position_deg=angle), 1.0) - angle for angle in degrees]
    assert 0.8 * ARCSEC < max(errors) <= ARCSEC


def test_phases_shift_the_error_of_the_encoder():
    shifted = replace(PARAMETERS, position_error_phases_deg=(90.0, 90.0))
    assert position(TableAxis(shifted), 0.0) == pytest.approx(ARCSEC)
    assert position(TableAxis(PARAMETERS), 0.0) == 0.0


def test_once_still_the_angle_stays_exactly_what_it_is():
    axis = TableAxis(PARAMETERS)
    axis.move_to(123.4, 0.0)
    end_s = time_of_rest(axis, 0.0)
    later_s = end_s + np.array([0.0, 1e-3, 1.0, 3600.0, 1e6])
    assert len(set(axis.position_deg(later_s))) == 1
    # evaluated together with times of the motion the same angle results
    assert axis.position_deg(np.array([end_s / 2, end_s]))[1] == position(axis, end_s)


def test_after_the_profile_the_axis_overshoots_and_settles():
    axis = TableAxis(PARAMETERS)
    axis.move_to(90.0, 0.0)
    profile_s = next(t for t in np.arange(0.0, 20.0, 0.01) if axis.profile_complete(t))
    times_s = np.arange(profile_s, profile_s + 20.0, 0.01)
    overshoot = np.array([axis.following_error_deg(t) for t in times_s])
    assert overshoot.max() == pytest.approx(20.0 * ARCSEC, rel=0.01)
    assert axis.is_moving(profile_s)
    assert not axis.is_moving(times_s[-1])
    assert overshoot[-1] == 0.0


def test_a_gentle_move_overshoots_less_than_a_hard_one():
    def overshoot(distance_deg):
        axis = TableAxis(PARAMETERS)
        axis.move_to(distance_deg, 0.0)
        return max(axis.following_error_deg(t) for t in np.arange(0.0, 10.0, 0.01))

    assert overshoot(0.01) < 0.2 * overshoot(90.0)


def test_turning_holds_the_rate_until_the_position_limit_and_stops_there():
    axis = TableAxis(IDEAL)
    axis.turn_at(20.0, 0.0)
    assert not axis.profile_complete(0.1)
    assert axis.profile_complete(5.0)
    assert [rate(axis, time_s) for time_s in (5.0, 10.0, 15.0)] == pytest.approx([20.0, 20.0, 20.0])
    assert position(axis, 10.0) - position(axis, 5.0) == pytest.approx(100.0)
    assert axis.encoder(60.0) == (400.0, 0.0, 0.0)
    assert not axis.profile_complete(60.0)
    axis.turn_at(5.0, 70.0)
    assert not axis.is_moving(90.0)


def test_an_axis_without_position_limits_turns_for_ever():
    axis = TableAxis(replace(IDEAL, position_low_deg=-math.inf, position_high_deg=math.inf))
    axis.turn_at(-10.0, 0.0)
    assert axis.is_moving(1e5)
    assert axis.profile_complete(1e5)
    assert rate(axis, 1e5) == pytest.approx(-10.0)
    axis.stop(1e5)
    assert not axis.is_moving(1e5 + 10.0)


def test_rates_and_positions_beyond_the_limits_mean_the_limits():
    axis = TableAxis(IDEAL)
    axis.turn_at(99.0, 0.0)
    assert rate(axis, 3.0) == pytest.approx(30.0)
    axis.move_to(-999.0, 4.0)
    assert axis.encoder(100.0).position_deg == -400.0


def test_narrower_limits_slow_the_next_move():
    axis = TableAxis(IDEAL)
    axis.limits = replace(axis.limits, rate_dps=5.0)
    axis.move_to(50.0, 0.0)
    assert max(rate(axis, time_s) for time_s in np.arange(0.01, 20.0, 0.01)) == pytest.approx(5.0)


def test_a_released_axis_brakes_to_rest_without_settling():
    axis = TableAxis(PARAMETERS)
    axis.turn_at(30.0, 0.0)
    axis.release(5.0)
    assert axis.is_moving(5.5)
    assert not axis.is_moving(7.0)
    assert rate(axis, 7.0) == 0.0


def test_an_axis_starts_at_rest_where_it_is_put():
    axis = TableAxis(IDEAL, position_deg=12.5)
    assert not axis.is_moving(0.0)
    assert axis.profile_complete(0.0)
    assert position(axis, 0.0) == 12.5
    assert axis.position_deg(np.zeros((2, 3))).shape == (2, 3)


def test_an_axis_that_is_overcome_does_not_follow_its_command_until_it_is_let_go():
    axis = TableAxis(AxisParameters())
    axis.hold_by_force(0.0)
    axis.move_to(30.0, 1.0)
    assert axis.encoder(20.0).position_deg == 0.0
    assert axis.following_error_deg(20.0) == pytest.approx(-30.0)
    assert axis.profile_complete(20.0)
    axis.end_force(20.0, servo=True)
    assert axis.encoder(40.0).position_deg == 30.0
    assert axis.following_error_deg(40.0) == 0.0


def test_an_axis_without_a_servo_stays_where_it_was_let_go():
    axis = TableAxis(AxisParameters())
    axis.hold_by_force(0.0, by_deg=-5.0)
    axis.end_force(20.0, servo=False)
    assert axis.encoder(40.0).position_deg == pytest.approx(-5.0)
    assert axis.following_error_deg(40.0) == 0.0


def test_a_rate_that_was_not_kept_is_not_made_up_for():
    axis = TableAxis(AxisParameters())
    axis.turn_at(2.0, 0.0)
    axis.hold_by_force(10.0)
    stalled_deg = axis.encoder(11.0).position_deg
    axis.end_force(20.0, servo=True)
    assert axis.encoder(40.0).position_deg == pytest.approx(stalled_deg)
    assert not axis.is_moving(40.0)


def test_an_axis_that_is_overcome_twice_keeps_its_command():
    axis = TableAxis(AxisParameters())
    axis.move_to(10.0, 0.0)
    axis.hold_by_force(20.0, by_deg=1.0)
    axis.hold_by_force(30.0)
    axis.end_force(40.0, servo=True)
    assert axis.encoder(60.0).position_deg == 10.0


def test_friction_ends_a_move_before_its_target_and_never_moves_it_back():
    axis = TableAxis(AxisParameters())
    axis.friction_deg = 0.5
    axis.move_to(-20.0, 0.0)
    assert axis.encoder(20.0).position_deg == -19.5
    assert axis.following_error_deg(20.0) == 0.5
    axis.move_to(-19.7, 20.0)
    assert axis.encoder(40.0).position_deg == -19.5
    assert axis.following_error_deg(40.0) == pytest.approx(0.2)
