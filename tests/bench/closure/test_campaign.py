from dataclasses import replace

import numpy as np
import pytest

from bench.closure.campaign import campaign_of
from bench.closure.temperature_record import TemperatureRecord
from bench.errors import MeasurementError
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


def test_dwells_with_flags_are_left_out(rows):
    flagged = [replace(row, flags="vibration") if row.dwell in (3, 4) else row for row in rows]
    assert {3, 4}.isdisjoint(campaign_of(flagged).dwell)
    assert len(campaign_of(flagged)) == len(rows) - 2


def test_a_table_with_flags_alone_is_told(rows):
    with pytest.raises(MeasurementError, match="nothing to search"):
        campaign_of([replace(row, flags="vibration") for row in rows])


def test_dwells_of_two_units_are_not_mixed(rows):
    with pytest.raises(MeasurementError, match=r"2 units \(T1, T2\)"):
        campaign_of([rows[0], replace(rows[1], unit="T2"), *rows[2:]])


def test_a_flagged_dwell_of_another_unit_does_not_count(rows):
    assert len(campaign_of([replace(rows[0], unit="T2", flags="aborted"), *rows[1:]])) == len(rows) - 1


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


def test_electronics_are_above_the_optics_by_what_the_sensors_say():
    campaign = campaign_of(measure(cycles=2).rows)
    np.testing.assert_array_equal(campaign.above_optics_c, campaign.board_c - campaign.gyro_c)


def test_nothing_tells_the_electronics_temperature_without_sensors_at_them_and_at_the_case():
    assert campaign_of(measure(cycles=2, sensors=("set", "air")).rows).above_optics_c is None
