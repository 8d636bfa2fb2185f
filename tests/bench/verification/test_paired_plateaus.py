"""Plateaus of several runs are paired by what they are, not by their number in a run."""

from dataclasses import replace

import numpy as np
import pytest

from gyrobench.bench.verification.compensation_verification import MeasuredRun, compare_runs
from gyrobench.bench.verification.paired_plateaus import PlateauProperties, pair_dwells, pair_plateaus
from tests.bench.report.made_up_verification import SITE, rows_of

FITTED_C = np.array([[62.0], [20.0], [0.0]]) + np.zeros(3)


def numbers(plateaus):
    return [[[each.dwell for each in run] for run in plateau] for plateau in plateaus]


def at(rows, **temperatures_c):
    """The rows at other gyro temperatures, by "d" and the number of the dwell."""
    return [
        replace(row, gyro_c=(temperatures_c[name],) * 3)
        if (name := f"d{row.dwell}") in temperatures_c
        else row
        for row in rows
    ]


def compare(*runs):
    names = ("none", "declared", "effect")
    return compare_runs(
        [MeasuredRun(name, rows, []) for name, rows in zip(names, runs, strict=False)], SITE, FITTED_C
    )


def test_a_plateau_that_a_run_lacks_is_empty_and_the_next_ones_keep_their_place():
    lost = [row for row in rows_of(0.0) if row.dwell not in (7, 8)]
    first, second, third = numbers(pair_dwells([rows_of(0.0), lost]))
    assert first == [[1, 2, 3, 4, 5, 6]] * 2
    assert second == [[7, 8], []]
    assert third == [[9, 10, 11, 12, 13, 14]] * 2


def test_dwells_on_a_ramp_are_grouped_alike_though_one_is_missing():
    """Alone, the second run would group 4 K and 9 K below the first dwell together, not 0 K and 4 K."""
    ramp = at(rows_of(0.0)[:3], d1=45.0, d2=41.0, d3=36.5)
    assert numbers(pair_dwells([ramp, ramp[1:]])) == [[[1, 2], [2]], [[3], [3]]]
    flagged = [replace(ramp[0], flags=("the table moved",), gyro_c=(np.nan,) * 3), *ramp[1:]]
    assert numbers(pair_dwells([ramp, flagged])) == [[[1, 2], [2]], [[3], [3]]]


def test_a_set_point_that_a_cycle_visits_twice_stays_two_plateaus_without_the_one_between():
    first, between, second = rows_of(0.0)[0], rows_of(0.0)[6], rows_of(0.0)[9]
    second = replace(second, gyro_c=first.gyro_c, chamber_set_c=first.chamber_set_c)
    whole = [first, between, second]
    without = [first, replace(between, flags=("the table moved",)), second]
    assert numbers(pair_dwells([whole, without])) == [[[1], [1]], [[7], []], [[10], [10]]]
    assert numbers(pair_dwells([whole, [second]]))[0] == [[1], []]


def test_gyros_more_than_5_kelvin_apart_are_at_two_plateaus():
    warm = [replace(row, gyro_c=(row.gyro_c[0] + 6.0,) * 3) for row in rows_of(0.0)]
    plateaus = numbers(pair_dwells([rows_of(0.0), warm]))
    assert [[bool(run) for run in each] for each in plateaus] == [[True, False], [False, True]] * 3
    near = [replace(row, gyro_c=(row.gyro_c[0] + 4.0,) * 3) for row in rows_of(0.0)]
    assert all(all(each) for each in pair_dwells([rows_of(0.0), near]))


def test_a_power_cycle_in_one_run_divides_the_plateau_of_all():
    interrupted = [replace(row, run="run 10" if row.dwell > 3 else "run 9") for row in rows_of(0.0)]
    assert numbers(pair_dwells([rows_of(0.0), interrupted]))[:2] == [[[1, 2, 3]] * 2, [[4, 5, 6]] * 2]


def test_numbers_of_plateaus_are_the_same_in_all_runs():
    lost = [replace(row, flags=("the table moved",) if row.cycle == 2 else ()) for row in rows_of(0.02)]
    none, declared = compare(rows_of(0.02), lost)
    assert [row.plateau for row in none.rows] == [1, 2, 3]
    assert [row.plateau for row in declared.rows] == [1, 3]
    for row in declared.rows:
        assert row.gyro_c == none.rows[row.plateau - 1].gyro_c


def test_a_dwell_that_one_run_lost_counts_in_none():
    """One run measured 9 deg/h in a dwell that the other lost: it changes neither rms nor spread."""
    large = rows_of(0.0)
    large[2] = replace(large[2], bias_dph=(9.0, 9.0, 9.0))
    lost = [replace(row, flags=("the table moved",) if row.dwell == 3 else ()) for row in rows_of(0.0)]
    one, other = compare(large, lost)
    for result in (one, other):
        assert result.total.dwells == 13
        assert result.rows[0].dwells == 5
        assert result.total.varying_rms_dph < 0.01
        assert result.total.spread_dph < 0.01
    # Of the position errors only the plateau remains at which both have all six positions.
    assert one.rows[0].position_nmi > 100.0
    assert np.isnan(other.rows[0].position_nmi)
    assert one.total.position_nmi == one.rows[2].position_nmi


def test_a_plateau_that_one_run_lacks_keeps_its_values_and_is_not_in_the_total():
    large = [replace(row, bias_dph=(0.5, -0.5, 0.5)) if row.dwell == 7 else row for row in rows_of(0.0)]
    lost = [row for row in rows_of(0.0) if row.cycle == 1]
    one, other = compare(large, lost)
    assert one.rows[1].dwells == 2
    assert one.rows[1].bias_rms_dph > 0.3
    assert one.rows[1].spread_dph > 0.3
    assert one.total.dwells == other.total.dwells == 12
    assert one.total.spread_dph == max(one.rows[0].spread_dph, one.rows[2].spread_dph)
    # The mean that is subtracted is that of the dwells compared, so the others do not change either.
    assert one.total.varying_rms_dph == pytest.approx(other.total.varying_rms_dph)
    assert one.rows[0].varying_rms_dph == pytest.approx(other.rows[0].varying_rms_dph)


def test_places_are_paired_by_cycle_set_point_and_temperature():
    places = [
        PlateauProperties(1, 50.0, 62.0),
        PlateauProperties(2, 20.0, 32.0),
        PlateauProperties(1, -10.0, 2.0),
    ]
    assert pair_plateaus([places, places]) == [[1, 2, 3]] * 2
    assert pair_plateaus([places, [places[0], places[2]]]) == [[1, 2, 3], [1, 3]]
    assert pair_plateaus([[places[0], places[2]], places]) == [[1, 3], [1, 2, 3]]
    warm = replace(places[1], gyro_c=38.0)
    assert pair_plateaus([places, [places[0], warm, places[2]]]) == [[1, 3, 4], [1, 2, 4]]
    unknown = [replace(each, chamber_set_c=np.nan) for each in places]
    assert pair_plateaus([unknown, unknown[1:]]) == [[1, 2, 3], [2, 3]]
