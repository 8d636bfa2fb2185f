"""The dwells of a run: what is kept of them, and flags that a later one brings."""

from dataclasses import replace

import pytest

from gyrobench.bench.dwells.dwell import measure_dwell
from gyrobench.bench.dwells.run_dwells import add_dwell


@pytest.fixture(scope="module")
def measured(recorded):
    return measure_dwell(*recorded)


def test_the_navigation_of_a_long_run_is_kept_of_some_dwells_evenly_spread(measured):
    dwells = []
    for number in range(1, 1001):
        add_dwell(dwells, replace(measured, row=replace(measured.row, dwell=number)))
    kept = [index for index, each in enumerate(dwells) if each.windows]
    assert kept == list(range(0, 1000, 8))
    assert [each.row.dwell for each in dwells] == list(range(1, 1001))


def test_the_navigation_of_a_short_run_is_kept_of_all(measured):
    dwells = []
    for number in range(1, 129):
        add_dwell(dwells, replace(measured, row=replace(measured.row, dwell=number)))
    assert all(each.windows for each in dwells)


def test_a_stuck_sensor_flags_the_dwells_since_it_is_stuck_once(measured):
    dwells = []
    x, y, z = measured.row.gyro_c
    for number, moved_k in enumerate((0.0, 30.0, 60.0), start=1):
        row = replace(
            measured.row,
            dwell=number,
            gyro_c=(x, y + moved_k, z + moved_k),
            case_c=measured.row.case_c + moved_k,
            gyro_rate_c_per_h=(0.0, *measured.row.gyro_rate_c_per_h[1:]),
        )
        add_dwell(dwells, replace(measured, row=row))
    assert [each.row.flags.count("its sensor is stuck") for each in dwells] == [1, 1, 1]
    assert all(each.is_spoilt for each in dwells)
