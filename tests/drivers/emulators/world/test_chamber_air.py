import itertools
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gyrobench.drivers.emulators.world.thermal import ChamberAir, ChamberParameters

MINUTE, HOUR = 60, 3600


def run(air: ChamberAir, duration_s: int, dt_s: float = 1.0) -> list[float]:
    temperatures = [air.air_c]
    for _ in range(round(duration_s / dt_s)):
        air.step(dt_s)
        temperatures.append(air.air_c)
    return temperatures


def running(set_point_c: float, rate_c_per_min: float | None = None, **parameters: float) -> ChamberAir:
    air = ChamberAir(ChamberParameters(**parameters))
    air.set_point_c, air.ramp_rate_c_per_min, air.running = set_point_c, rate_c_per_min, True
    return air


def test_it_starts_at_room_temperature_and_stays_there_when_off():
    air = ChamberAir()
    air.set_point_c = 85.0
    assert set(run(air, HOUR)) == {23.0}
    assert air.compressor_duty == 0.0


def test_the_working_set_point_ramps_from_the_air_at_the_rate():
    air = running(60.0, 2.0)
    run(air, 10 * MINUTE)
    assert air.working_set_point_c == pytest.approx(43.0)
    run(air, HOUR)
    assert air.working_set_point_c == 60.0


def test_air_follows_a_ramp_with_the_lag_of_the_control():
    air = running(60.0, 2.0)
    run(air, 15 * MINUTE)
    assert air.working_set_point_c - air.air_c == pytest.approx(2.0 * 1.5, rel=0.01)


def test_without_a_ramp_heating_and_cooling_go_at_full_power():
    hot, cold = run(running(85.0), 5 * MINUTE), run(running(-40.0), 5 * MINUTE)
    assert hot[-1] == pytest.approx(23.0 + 5 * 5.0)
    assert cold[-1] == pytest.approx(23.0 - 5 * 3.0)


def test_the_set_point_is_reached_and_held():
    for set_point_c in (-40.0, 23.0, 85.0):
        air = running(set_point_c)
        run(air, 3 * HOUR)
        assert air.air_c == pytest.approx(set_point_c, abs=1e-6)


def test_a_set_point_out_of_reach_ends_at_the_limit():
    air = running(-90.0, low_c=-55.0)
    assert min(run(air, 4 * HOUR)) == pytest.approx(-55.0, abs=1e-6)


@given(
    set_points_c=st.lists(st.floats(-80.0, 120.0), min_size=1, max_size=4),
    rate_c_per_min=st.none() | st.floats(0.05, 20.0),
    dt_s=st.sampled_from([0.1, 1.0, 10.0]),
)
def test_air_never_changes_faster_than_the_machinery_can(set_points_c, rate_c_per_min, dt_s):
    air = running(23.0, rate_c_per_min)
    for set_point_c in set_points_c:
        air.set_point_c = set_point_c
        temperatures = run(air, 20 * MINUTE, dt_s * 10)
        steps = [after - before for before, after in itertools.pairwise(temperatures)]
        assert -3.0 * dt_s / 6.0 - 1e-9 <= min(steps)
        assert max(steps) <= 5.0 * dt_s / 6.0 + 1e-9
        assert -60.0 <= min(temperatures) <= max(temperatures) <= 100.0
        assert -1.0 <= air.power <= 1.0


def test_switched_off_it_drifts_to_the_room_with_its_time_constant():
    air = running(83.0)
    run(air, 2 * HOUR)
    air.running = False
    run(air, 5400)
    assert air.air_c == pytest.approx(23.0 + 60.0 / math.e, abs=0.01)


def test_switched_on_again_the_ramp_starts_at_the_air():
    air = running(83.0)
    run(air, 2 * HOUR)
    air.running = False
    run(air, HOUR)
    left_c = air.air_c
    air.ramp_rate_c_per_min, air.running = 1.0, True
    air.step(1.0)
    assert air.working_set_point_c == pytest.approx(left_c + 1.0 / 60.0)


def test_the_compressor_runs_without_a_pause_on_a_ramp_down():
    air = running(-40.0, 2.0)
    run(air, 10 * MINUTE)
    assert air.compressor_duty == 1.0
    assert -1.0 < air.power < -0.3


def test_holding_a_temperature_takes_the_compressor_the_longer_the_colder_it_is():
    duties = []
    for set_point_c in (60.0, 23.0, 10.0, -10.0, -20.0):
        air = running(set_point_c)
        run(air, 3 * HOUR)
        duties.append(air.compressor_duty)
    assert duties[0] == 0.0
    assert duties[1] == pytest.approx(0.0, abs=1e-6)
    assert duties[1] < duties[2] < duties[3] < duties[4] < 1.0
    assert duties[4] > 0.3


def test_the_compressor_stands_while_the_chamber_heats():
    air = running(-40.0)
    run(air, HOUR)
    air.set_point_c = 60.0
    run(air, 10 * MINUTE)
    assert air.power > 0.0
    assert air.compressor_duty == 0.0


def test_the_compressor_stops_with_the_chamber():
    air = running(-40.0)
    run(air, HOUR)
    assert air.compressor_duty > 0.0
    air.running = False
    air.step(1.0)
    assert air.compressor_duty == 0.0
    assert air.power == 0.0


def test_a_disturbance_is_controlled_away():
    air = running(50.0)
    run(air, HOUR)
    air.air_c -= 4.0
    assert air.air_c == pytest.approx(46.0, abs=0.01)
    run(air, HOUR)
    assert air.air_c == pytest.approx(50.0, abs=0.01)


def test_results_do_not_depend_on_the_step_size():
    fine, coarse = running(60.0, 2.0), running(60.0, 2.0)
    run(fine, HOUR, 0.1)
    run(coarse, HOUR, 1.0)
    assert fine.air_c == pytest.approx(coarse.air_c, abs=0.02)
