"""Temperatures of a dwell, and sensors that are not valid."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from gyrobench.bench.bias.dwell_table import DwellRow
from gyrobench.bench.dwells.temperatures import (
    dwell_temperatures,
    slopes_c_per_h,
    stuck_sensors,
    temperatures_at,
    triple,
)
from gyrobench.bench.foundations.errors import MeasurementError
from gyrobench.drivers.ins.navigation_data import EpochCounts, NavigationData, Temperatures

START_C, SLOPE_C_PER_H = np.array([20.0, -30.0, 65.0]), np.array([3.6, 0.0, -7.2])
EPOCHS, TEMPERATURE_S = 400, 5.0


def optics_c(time_s):
    return START_C + np.multiply.outer(time_s / 3600.0, SLOPE_C_PER_H)


def series(time_s, **changed):
    """Temperatures that change evenly, the electronics 10 K hotter, the case 5 K cooler than the x gyro."""
    values = {"optics_c": optics_c(time_s), "case_c": optics_c(time_s)[:, 0] - 5.0}
    values["spread_k"] = np.zeros((len(time_s), 7))
    return Temperatures(time_s, **{**values, "electronics_c": values["optics_c"] + 10.0, **changed})


def recording(temperatures):
    """Epochs each second from 100 s on, with three frames each."""
    time_s = 100.0 + np.arange(EPOCHS)
    return NavigationData(
        ins_time_s=time_s,
        timestamp_s=time_s,
        row=3 * np.arange(EPOCHS) + 2,
        segment=np.zeros(EPOCHS, np.int64),
        velocity_enu_mps=np.zeros((EPOCHS, 3)),
        attitude=np.tile(np.eye(3), (EPOCHS, 1, 1)),
        mode=np.zeros(EPOCHS, np.int8),
        alignment=np.zeros(EPOCHS, np.int8),
        temperatures=temperatures,
        counts=EpochCounts(),
        short_frames=0,
    )


@pytest.fixture
def navigation():
    return recording(series(np.arange(0.0, 600.0, TEMPERATURE_S)))


def test_means_and_slopes_are_those_between_two_frames(navigation):
    # Rows 300 to 899 are the epochs from 200 to 399 s, temperatures those from 200 to 395 s.
    found = dwell_temperatures(navigation, 300, 900)
    np.testing.assert_allclose(found.gyro_c, optics_c(297.5))
    np.testing.assert_allclose(found.gyro_rate_c_per_h, SLOPE_C_PER_H, atol=1e-9)
    np.testing.assert_allclose(found.board_c, optics_c(297.5) + 10.0)
    assert found.case_c == pytest.approx(optics_c(297.5)[0] - 5.0)


def test_what_the_ins_does_not_show_is_not_a_number():
    time_s = np.arange(0.0, 600.0, TEMPERATURE_S)
    unknown = np.full((len(time_s), 3), np.nan)
    found = dwell_temperatures(
        recording(series(time_s, electronics_c=unknown, case_c=unknown[:, 0])), 300, 900
    )
    assert np.isnan([*found.board_c, found.case_c]).all()
    np.testing.assert_allclose(found.gyro_c, optics_c(297.5))


def test_no_epoch_between_the_frames_is_an_error(navigation):
    with pytest.raises(MeasurementError, match="no navigation frames in the dwell"):
        dwell_temperatures(navigation, 5000, 6000)


@pytest.mark.parametrize("count", [0, 1])
def test_fewer_than_two_temperatures_are_an_error(count):
    few = series(200.0 + np.arange(count))
    with pytest.raises(MeasurementError, match="no gyro temperatures in the dwell"):
        dwell_temperatures(recording(few), 300, 900)


def test_slope_is_that_of_least_squares():
    time_s = np.array([0.0, 1.0, 2.0, 5.0])
    values = np.column_stack([2.0 * time_s + 1.0, [0.0, 1.0, -1.0, 0.5]])
    expected = [np.polyfit(time_s / 3600.0, column, 1)[0] for column in values.T]
    np.testing.assert_allclose(slopes_c_per_h(time_s, values), expected)


def test_temperatures_at_epochs_lie_between_their_neighbours():
    time_s = np.array([0.0, 2.5, 7.0, 595.0, 700.0])
    found, case_c = temperatures_at(time_s, series(np.arange(0.0, 600.0, TEMPERATURE_S)))
    np.testing.assert_allclose(found[:-1], optics_c(time_s[:-1]))
    np.testing.assert_allclose(case_c, found[:, 0] - 5.0)
    np.testing.assert_allclose(found[-1], optics_c(595.0))  # the last one known


@pytest.mark.parametrize("count", [0, 1])
def test_too_few_temperatures_are_as_good_as_none(count):
    assert temperatures_at(np.arange(5.0), series(np.arange(float(count)))) == (None, None)


@pytest.mark.parametrize("sent", [0, 10])
def test_the_gyros_stand_in_for_a_case_that_is_never_sent(sent):
    time_s = np.arange(0.0, 600.0, TEMPERATURE_S)
    case_c = np.where(np.arange(len(time_s)) < sent, 20.0, math.nan)
    gyro_c, found_c = temperatures_at(time_s, series(time_s, case_c=case_c))
    if sent:
        assert found_c is None
    else:
        np.testing.assert_allclose(found_c, gyro_c.mean(axis=1))


def test_a_gyro_without_temperature_leaves_them_all_out():
    time_s = np.arange(0.0, 600.0, TEMPERATURE_S)
    lacking = optics_c(time_s)
    lacking[:, 1] = math.nan
    assert temperatures_at(time_s, series(time_s, optics_c=lacking))[0] is None


def test_triple_is_made_of_plain_numbers():
    assert [type(value) for value in triple(np.array([1, 2, 3], np.int32))] == [float] * 3


def with_gaps(time_s, share, axis=1):
    """Optics of which one gyro's samples are not a number, in even steps."""
    values = optics_c(time_s)
    values[:: round(1.0 / share), axis] = math.nan
    return values


def test_a_few_temperatures_that_are_no_numbers_do_not_matter():
    time_s = np.arange(0.0, 600.0, TEMPERATURE_S)
    reported = series(time_s, optics_c=with_gaps(time_s, 0.05))
    found = dwell_temperatures(recording(reported), 300, 900)
    np.testing.assert_allclose(found.gyro_c, optics_c(297.5), atol=0.01)
    np.testing.assert_allclose(found.gyro_rate_c_per_h, SLOPE_C_PER_H, atol=1e-9)
    at_s = np.array([12.0, 100.0, 400.0])
    np.testing.assert_allclose(temperatures_at(at_s, reported)[0], optics_c(at_s))


def test_a_gyro_that_often_shows_no_number_is_not_measured_and_the_others_are():
    time_s = np.arange(0.0, 600.0, TEMPERATURE_S)
    reported = series(time_s, optics_c=with_gaps(time_s, 0.2))
    found = dwell_temperatures(recording(reported), 300, 900)
    assert np.isnan([found.gyro_c[1], found.gyro_rate_c_per_h[1]]).all()
    np.testing.assert_allclose(np.array(found.gyro_c)[[0, 2]], optics_c(297.5)[[0, 2]])
    np.testing.assert_allclose(np.array(found.gyro_rate_c_per_h)[[0, 2]], SLOPE_C_PER_H[[0, 2]], atol=1e-9)
    assert temperatures_at(time_s, reported)[0] is None


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


def test_a_sensor_that_got_stuck_in_the_ramp_is_reported_in_the_next_dwell():
    rows = [dwell(1, 20.0), with_stuck_x(dwell(2, 60.0), 50.0)]
    assert list(found(rows)) == [1]
    assert "x gyro is constant to the last bit at 50.00 degC" in found(rows)[1]


def test_a_dwell_without_its_temperature_in_between_hides_no_stuck_sensor():
    reported, stuck = dwell(1, 60.0), [with_stuck_x(dwell(number, 20.0), 50.0) for number in (3, 4)]
    rows = [reported, with_stuck_x(dwell(2, 40.0), math.nan), *stuck]
    assert list(found(rows)) == [2, 3]


def test_one_that_got_stuck_at_a_stop_is_reported_of_all_its_dwells_once_the_chamber_moves():
    stop = [dwell(1, 20.0), *(with_stuck_x(dwell(number, 20.0), 32.0) for number in (2, 3))]
    assert found(stop) == {}
    assert list(found([*stop, with_stuck_x(dwell(4, 60.0), 32.0)])) == [1, 2, 3]


def test_when_all_of_the_ins_is_stuck_the_chamber_shows():
    def stuck(number, chamber_c):
        return replace(dwell(number, 20.0), chamber_c=chamber_c, gyro_rate_c_per_h=(0.0, 0.0, 0.0))

    assert sorted(found([stuck(1, 20.0), stuck(2, 60.0)])) == [0, 1]


@pytest.mark.parametrize(
    "lacking", [{"board_c": (math.nan,) * 3}, {"case_c": math.nan}, {"chamber_c": math.nan}]
)
def test_what_the_bench_does_not_show_is_no_evidence(lacking):
    still = {"gyro_rate_c_per_h": (0.0, 0.0, 0.0)}
    rows = [replace(dwell(number, 20.0), **lacking, **still) for number in (1, 2)]
    assert found(rows) == {}


def test_a_soaked_unit_without_sensor_noise_is_believed():
    rows = [dwell(number, 20.0, gyro_rate_c_per_h=(0.0, 0.0, 0.0)) for number in (1, 2, 3)]
    assert found(rows) == {}


def test_another_power_on_is_no_evidence():
    rows = [dwell(1, 60.0, run="a"), with_stuck_x(dwell(2, 20.0, run="b"), 32.0)]
    assert found(rows) == {}
