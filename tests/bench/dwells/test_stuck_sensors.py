"""A temperature sensor that keeps a plausible value is noticed from dwell to dwell."""

import math
from dataclasses import replace

import pytest

from gyrobench.bench.bias.dwell_table import DwellRow
from gyrobench.bench.dwells.stuck_sensors import stuck_sensors


def dwell(number, chamber_c, **changed):
    """Gyros near each other, 12 K above the chamber, still moving a little."""
    gyro_c = tuple(chamber_c + 12.0 + offset for offset in (0.0, 1.0, -1.0))
    row = DwellRow(
        unit="1",
        run="a",
        dwell=number,
        cycle=1,
        position="z_up",
        start_s=3600.0 * number,
        end_s=3600.0 * number + 1200.0,
        since_power_on_s=3600.0 * number,
        gyro_c=gyro_c,
        gyro_rate_c_per_h=(0.2, -0.1, 0.3),
        bias_dph=(0.0, 0.0, 0.0),
        sigma_dph=(0.001, 0.001, 0.001),
        chamber_c=chamber_c,
        case_c=chamber_c + 5.0,
        board_c=tuple(each + 10.0 for each in gyro_c),
    )
    return replace(row, **changed)


def with_stuck_x(row, stuck_c):
    return replace(
        row, gyro_c=(stuck_c, *row.gyro_c[1:]), gyro_rate_c_per_h=(0.0, *row.gyro_rate_c_per_h[1:])
    )


def found(rows):
    return dict(stuck_sensors(rows))


def test_gyros_that_follow_the_chamber_are_believed():
    rows = [dwell(number, chamber_c) for number, chamber_c in enumerate((20.0, 60.0, -20.0), start=1)]
    assert found(rows) == {}


def test_a_sensor_that_got_stuck_in_the_ramp_is_told_in_the_next_dwell():
    rows = [dwell(1, 20.0), with_stuck_x(dwell(2, 60.0), 50.0)]
    assert list(found(rows)) == [1]
    assert "x gyro keeps still to the last bit at 50.00 degC" in found(rows)[1]


def test_a_dwell_without_its_temperature_in_between_hides_no_stuck_sensor():
    told, stuck = dwell(1, 60.0), [with_stuck_x(dwell(number, 20.0), 50.0) for number in (3, 4)]
    rows = [told, with_stuck_x(dwell(2, 40.0), math.nan), *stuck]
    assert list(found(rows)) == [2, 3]


def test_one_that_got_stuck_at_a_stop_is_told_of_all_its_dwells_once_the_chamber_moves():
    stop = [dwell(1, 20.0), *(with_stuck_x(dwell(number, 20.0), 32.0) for number in (2, 3))]
    assert found(stop) == {}
    assert list(found([*stop, with_stuck_x(dwell(4, 60.0), 32.0)])) == [1, 2, 3]


def test_when_all_of_the_ins_is_stuck_the_chamber_tells():
    def stuck(number, chamber_c):
        return replace(dwell(number, 20.0), chamber_c=chamber_c, gyro_rate_c_per_h=(0.0, 0.0, 0.0))

    assert sorted(found([stuck(1, 20.0), stuck(2, 60.0)])) == [0, 1]


@pytest.mark.parametrize(
    "lacking", [{"board_c": (math.nan,) * 3}, {"case_c": math.nan}, {"chamber_c": math.nan}]
)
def test_what_the_bench_does_not_tell_is_no_evidence(lacking):
    still = {"gyro_rate_c_per_h": (0.0, 0.0, 0.0)}
    rows = [replace(dwell(number, 20.0), **lacking, **still) for number in (1, 2)]
    assert found(rows) == {}


def test_a_soaked_unit_without_sensor_noise_is_believed():
    rows = [dwell(number, 20.0, gyro_rate_c_per_h=(0.0, 0.0, 0.0)) for number in (1, 2, 3)]
    assert found(rows) == {}


def test_another_power_on_is_no_evidence():
    rows = [dwell(1, 60.0, run="a"), with_stuck_x(dwell(2, 20.0, run="b"), 32.0)]
    assert found(rows) == {}
