from dataclasses import replace

import numpy as np
import pytest

from gyrobench.bench.closure.campaign import campaign_of, common_errors, heading_numbers
from gyrobench.bench.closure.temperature_record import TemperatureRecord
from gyrobench.bench.foundations.errors import MeasurementError
from tests.bench.closure.thermal_bench import UP, measure


@pytest.fixture(scope="module")
def rows():
    return measure(cycles=2, power_on_each_cycle=True).rows


def test_dwells_are_gathered_in_the_order_of_time(rows):
    campaign = campaign_of(rows[::-1])
    assert campaign.dwell.tolist() == [row.dwell for row in rows]
    assert campaign.position == tuple(row.position for row in rows)
    assert campaign.run_names == ("R1", "R2")
    np.testing.assert_array_equal(campaign.bias_dph, [row.bias_dph for row in rows])
    np.testing.assert_array_equal(campaign.rate_c_per_h, [row.gyro_rate_c_per_h for row in rows])
    assert len(campaign) == len(rows)


def test_up_points_along_the_axis_that_the_position_names(rows):
    campaign = campaign_of(rows)
    np.testing.assert_allclose(campaign.up_body, [UP[row.position] for row in rows], atol=1e-15)


def test_headings_that_hardly_differ_are_one_also_across_north():
    assert heading_numbers([0.4, 0.6, 359.8, -0.3, 90.0, 88.0, 180.0, np.nan]) == [0, 0, 0, 0, 1, 1, 2, -1]
    assert heading_numbers([359.0, 181.0, 90.0, 272.0], 180.0) == [0, 0, 1, 1]
    common = np.full((4, 3), 0.001)
    errors = [common_errors(["z_up"] * 4, each, common) for each in ([0.4, 0.6, -0.4, 359.7], [0.0] * 4)]
    np.testing.assert_array_equal(*errors)


def test_no_course_over_attitudes_is_more_certain_than_a_level_error_in_one():
    positions = ["y_up", "y_down"] * 4 + ["z_up"]
    headings_deg = [*np.repeat([0.0, 90.0, 180.0, 270.0], 2), 0.0]
    errors = common_errors(positions, headings_deg, np.full((9, 3), 0.001))[0]
    covariance = errors @ errors.T
    for course in (np.ones(8), np.tile([1.0, -1.0], 4), np.repeat([1.0, -1.0, 1.0, -1.0], 2)):
        assert course @ np.linalg.solve(covariance[:8, :8], course) == pytest.approx(1.0 / 0.001**2)
    assert covariance[8, 8] == pytest.approx(0.001**2)


def test_dwells_with_flags_are_left_out(rows):
    flagged = [replace(row, flags=("vibration",)) if row.dwell in (3, 4) else row for row in rows]
    assert {3, 4}.isdisjoint(campaign_of(flagged).dwell)
    assert len(campaign_of(flagged)) == len(rows) - 2


def test_a_table_of_flagged_dwells_is_refused(rows):
    with pytest.raises(MeasurementError, match="has a result without flags"):
        campaign_of([replace(row, flags=("vibration",)) for row in rows])


def test_dwells_of_two_units_are_not_mixed(rows):
    with pytest.raises(MeasurementError, match=r"2 units \(T1, T2\)"):
        campaign_of([rows[0], replace(rows[1], unit="T2"), *rows[2:]])


def test_a_flagged_dwell_of_another_unit_is_not_mixed_in_either(rows):
    with pytest.raises(MeasurementError, match="2 units"):
        campaign_of([replace(rows[0], unit="T2", flags=("aborted",)), *rows[1:]])


def test_a_dwell_of_another_unit_without_temperatures_does_not_count(rows):
    campaign = campaign_of([replace(rows[0], unit="T2", gyro_c=(np.nan,) * 3), *rows[1:]])
    assert campaign.unit == "T1"
    assert campaign.dwell.tolist() == [row.dwell for row in rows[1:]]


def test_a_dwell_without_a_bias_is_left_out_like_a_flagged_one(rows):
    without = [replace(row, bias_dph=(0.1, np.nan, 0.1)) if row.dwell == 5 else row for row in rows]
    assert campaign_of(without).dwell.tolist() == [row.dwell for row in rows if row.dwell != 5]


def test_dwells_without_a_gyros_temperature_are_named(rows):
    blind = [
        replace(row, gyro_c=(row.gyro_c[0], np.nan, row.gyro_c[2])) if row.dwell == 9 else row for row in rows
    ]
    blind[3] = replace(blind[3], gyro_rate_c_per_h=(np.nan,) * 3, flags=("aborted",))
    campaign = campaign_of(blind)
    assert campaign.without_temperatures == (4, 9)
    assert {4, 9}.isdisjoint(campaign.whole.dwell)


def test_a_table_with_good_dwells_alone_is_whole(rows):
    campaign = campaign_of(rows)
    assert campaign.part_of is None
    assert campaign.whole is campaign


def test_flagged_dwells_contribute_to_the_course_of_temperatures(rows):
    # One of them is the dwell with the power-on, and one the first of the second cycle.
    flagged = [replace(row, flags=("vibration",)) if row.dwell in (7, 38, 39) else row for row in rows]
    campaign, undisturbed = campaign_of(flagged), campaign_of(rows)
    good = np.array([not row.flags for row in flagged])
    whole, chosen = campaign.part_of
    assert campaign.whole is whole
    np.testing.assert_array_equal(chosen, good)
    assert whole.dwell.tolist() == [row.dwell for row in rows]
    np.testing.assert_array_equal(campaign.power_on_s, undisturbed.power_on_s)
    for name in ("run_shares", "set_point_path_c", "above_optics_c"):
        np.testing.assert_array_equal(getattr(campaign, name), getattr(undisturbed, name)[good], err_msg=name)
    np.testing.assert_array_equal(campaign.record.gyro_c, undisturbed.record.gyro_c)


@pytest.mark.parametrize("name", ["chamber_set_c", "chamber_c", "case_c"])
def test_few_missing_readings_lie_on_a_line_between_their_neighbours(name):
    rows = measure(cycles=2, sensors=("set", "air", "case", "board")).rows
    holed = [replace(row, **{name: np.nan}) if row.dwell in (11, 12) else row for row in rows]
    whole, filled = (
        getattr(campaign_of(each), {"chamber_set_c": "set_c", "chamber_c": "air_c"}.get(name, name))
        for each in (rows, holed)
    )
    expected = whole.copy()
    expected[10:12] = np.interp([1, 2], [0, 3], whole[[9, 12]])
    np.testing.assert_allclose(filled, expected)


def test_few_missing_readings_of_one_board_leave_the_others_as_they_are(rows):
    holed = [
        replace(row, board_c=(row.board_c[0], np.nan, row.board_c[2])) if row.dwell == 20 else row
        for row in rows
    ]
    whole_c, filled_c = (campaign_of(each).board_c for each in (rows, holed))
    np.testing.assert_array_equal(filled_c[:, [0, 2]], whole_c[:, [0, 2]])
    assert filled_c[19, 1] == pytest.approx(whole_c[[18, 20], 1].mean())


def test_many_missing_readings_are_not_made_up(rows):
    holed = [replace(row, chamber_set_c=np.nan) if row.dwell % 5 == 0 else row for row in rows]
    assert np.isnan(campaign_of(holed).set_c).sum() == len(rows) // 5


def test_a_dwell_belongs_to_its_run_alone(rows):
    shares = campaign_of(rows).run_shares
    np.testing.assert_allclose(shares.sum(axis=1), 1.0)
    whole = [row.end_s - row.start_s <= 1800.0 and row.dwell != 38 for row in rows]
    expected = [[row.run == "R1", row.run == "R2"] for row in rows]
    np.testing.assert_array_equal(shares[whole], np.array(expected, dtype=float)[whole])


def test_a_dwell_with_a_power_on_inside_is_shared_between_the_runs(rows):
    # The second cycle begins 18 h 40 min after the first: 20 minutes into dwell 38.
    campaign = campaign_of(rows)
    np.testing.assert_allclose(campaign.power_on_s, [0.0, 67_200.0])
    np.testing.assert_allclose(campaign.run_shares[37], [1 / 3, 2 / 3])


def test_without_a_power_on_inside_a_dwell_there_is_one_for_each_run():
    campaign = campaign_of(measure(cycles=2, power_on_each_cycle=True, dwell_s=1680.0).rows)
    assert set(campaign.run_shares.ravel()) == {0.0, 1.0}
    np.testing.assert_allclose(campaign.power_on_s, [0.0, 67_200.0])


def test_the_record_given_is_the_one_used(rows):
    record = TemperatureRecord(np.array([0.0, 1e6]), np.full((2, 3), 20.0))
    assert campaign_of(rows, record).record is record


def test_electronics_are_above_the_optics_by_the_reading_of_the_sensors():
    campaign = campaign_of(measure(cycles=2).rows)
    np.testing.assert_array_equal(campaign.above_optics_c, campaign.board_c - campaign.gyro_c)


def test_the_electronics_temperature_is_unknown_without_sensors_at_them_and_at_the_case():
    assert campaign_of(measure(cycles=2, sensors=("set", "air")).rows).above_optics_c is None
