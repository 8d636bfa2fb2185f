import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gyrobench.bench.foundations.shipped import find_document
from gyrobench.bench.procedure.estimate import (
    SETTLING_S,
    BenchEstimate,
    TableEstimate,
    ThermalEstimate,
    lagged,
)
from gyrobench.bench.station.station import Station
from gyrobench.drivers.emulators.world.table_axis import AxisState, MotionLimits, move

TABLE = Station(find_document("stations", "emulated")).table
THERMAL = ThermalEstimate(time_constant_s=2000.0, self_heating_c=10.0, air_lag_s=100.0, room_c=20.0)


def bench(**changes):
    values = {"thermal": THERMAL, "chamber_c": 20.0, "gyro_c": 20.0, **changes}
    return BenchEstimate(**values)


def test_bench_at_rest_stays_at_room_temperature():
    assert BenchEstimate.at_rest(THERMAL).passed(1e5).gyro_c == pytest.approx(20.0)


def test_powered_gyros_make_up_63_percent_of_their_self_heating_in_one_time_constant():
    assert bench(powered=True).passed(2000.0).gyro_c == pytest.approx(20.0 + 10.0 * (1.0 - math.exp(-1.0)))


def test_gyros_follow_a_long_ramp_one_time_constant_behind():
    ramping = bench(set_point_c=1020.0, ramp_c_per_s=0.01).passed(90_000.0)
    assert ramping.chamber_c == pytest.approx(920.0)
    assert ramping.gyro_c == pytest.approx(920.0 - 0.01 * 2000.0)


def test_a_ramp_ends_at_its_set_point_and_the_chamber_holds_it():
    cold = bench(set_point_c=-40.0, ramp_c_per_s=1.0 / 60.0)
    assert cold.ramp_left_s() == pytest.approx(3600.0)
    assert cold.passed(3600.0).chamber_c == pytest.approx(-40.0)
    assert cold.passed(50_000.0).chamber_c == pytest.approx(-40.0)
    assert cold.passed(50_000.0).gyro_c == pytest.approx(-40.0)


@given(st.floats(-60.0, 90.0), st.floats(1e-4, 0.1), st.booleans(), st.floats(0.0, 2e4), st.floats(0.0, 2e4))
def test_two_waits_are_one_wait(goal_c, ramp_c_per_s, powered, first_s, second_s):
    start = bench(set_point_c=goal_c, ramp_c_per_s=ramp_c_per_s, powered=powered)
    once, twice = start.passed(first_s + second_s), start.passed(first_s).passed(second_s)
    assert twice.chamber_c == pytest.approx(once.chamber_c, abs=1e-6)
    assert twice.gyro_c == pytest.approx(once.gyro_c, abs=1e-6)


def test_after_the_predicted_settling_time_the_gyros_change_at_the_rate_asked_for():
    start = bench(gyro_c=60.0, powered=True)
    settled = start.passed(start.time_until_gyro_rate_s(2.0))
    change_c_per_h = (settled.passed(1.0).gyro_c - settled.gyro_c) * 3600.0
    assert change_c_per_h == pytest.approx(-2.0, rel=1e-3)


def test_settled_gyros_need_no_time():
    assert bench(gyro_c=30.0, powered=True).time_until_gyro_rate_s(0.1) == 0.0


def test_lag_solves_its_differential_equation():
    value, goal, slope, tau_s, step_s = 3.0, 10.0, 0.02, 50.0, 0.01
    by_steps = value
    for index in range(10_000):
        middle = goal + slope * (index + 0.5) * step_s
        by_steps += (middle - by_steps) * (1.0 - math.exp(-step_s / tau_s))
    assert lagged(value, goal, slope, tau_s, 100.0) == pytest.approx(by_steps, rel=1e-6)


@given(st.floats(0.01, 720.0), st.floats(0.1, 100.0), st.floats(0.5, 500.0), st.floats(0.5, 5000.0))
def test_a_motion_takes_the_time_that_acceleration_and_jerk_allow(
    distance_deg: float, rate_dps: float, acceleration_dps2: float, jerk_dps3: float
) -> None:
    limits = MotionLimits(rate_dps, acceleration_dps2, jerk_dps3, -math.inf, math.inf)
    pieces = [piece for part in move(AxisState(0.0), -distance_deg, limits) for piece in part]
    table = TableEstimate(TABLE, acceleration_dps2, jerk_dps3, tick_s=0.001)
    motion_s = table.motion_s((-distance_deg, 0.5 * distance_deg), rate_dps)
    moving_s = sum(piece.duration_s for piece in pieces)
    assert motion_s - SETTLING_S == pytest.approx(moving_s, rel=1e-6, abs=0.0011)


def test_motions_and_waits_after_them_end_at_ticks() -> None:
    table = TableEstimate(TABLE, 30.0, 120.0, tick_s=2.0)
    assert [table.motion_s((0.0, angle_deg), 10.0) for angle_deg in (0.0, 90.0, 180.0)] == [2.0, 12.0, 20.0]
    assert [table.wait_s(duration_s) for duration_s in (0.0, 1.0, 5.0)] == [0.0, 2.0, 6.0]
