"""The campaign predicted from a plan, compared with a run of the plan."""

from pathlib import Path

import numpy as np
import pytest

from gyrobench.bench.bias.dwell_table import read_dwells
from gyrobench.bench.cli.plan import declared_properties
from gyrobench.bench.closure.campaign import campaign_of
from gyrobench.bench.closure.planned_campaign import (
    UnitProperties,
    forecast_temperatures,
    planned_campaign,
    unreachable_limits,
)
from gyrobench.bench.closure.unit_thermal import ELECTRONICS_ABOVE_OPTICS_K
from gyrobench.bench.foundations.documents import parse_document
from gyrobench.bench.foundations.errors import MeasurementError
from tests.bench.closure.plans import dwell, planned, shipped, station


@pytest.fixture(scope="module")
def fig7():
    _, plan = shipped("six_position_fig7")
    return plan, planned_campaign(plan, declared_properties(station()))


def test_every_dwell_of_the_plan_is_in_it(fig7):
    plan, campaign = fig7
    assert len(campaign) == plan.dwell_count == 60
    assert np.bincount(campaign.cycle).tolist() == [0, 30, 30]
    assert campaign.position[:7] == ("z_up", "z_down", "y_up", "y_down", "x_up", "x_down", "z_up")
    np.testing.assert_allclose(campaign.up_body[:3], [[0, 0, 1], [0, 0, -1], [0, 1, 0]], atol=1e-12)


def test_a_dwell_lasts_from_its_first_navigation_to_the_end_of_its_last(fig7):
    plan, campaign = fig7
    windows = [each for each in plan.steps if each.dwell == 7 and each.step.name == "navigate"]
    assert campaign.start_s[6] == windows[0].start_s
    assert campaign.end_s[6] == windows[-1].end_s


def test_the_uncertainty_is_the_random_walk_over_the_time_of_navigation(fig7):
    _, campaign = fig7
    np.testing.assert_allclose(campaign.sigma_dph, 0.0006 / np.sqrt(1200.0 / 3600.0))


def limits_beyond(acceptance, cycles=1):
    walk_dph = 0.0006 / np.sqrt(1200.0 / 3600.0)  # of a dwell on the emulated bench
    values = {key: float(factor * walk_dph) for key, factor in acceptance.items()}
    positions = dwell("z_up") + dwell("z_down")
    loop = "".join(f"      {line}\n" for line in positions.splitlines())
    steps = f"  - repeat:\n      over: {{cycle: {[*range(1, cycles + 1)]}}}\n      steps:\n{loop}"
    text = f"procedure: test\nacceptance: {values}\nsteps:\n  - power_on: {{settle_s: 80000}}\n{steps}"
    plan = station().plan_document(parse_document(text, Path("test.yaml")))
    return unreachable_limits(plan, declared_properties(station()))


def test_a_limit_that_even_equal_biases_can_not_pass_is_named():
    """Single-sided 95 % of a difference of two dwells: 1.645 * sqrt(2) = 2.33 times the sigma of one."""
    assert limits_beyond({"position_difference_dph": 2.5}) == []
    [text] = limits_beyond({"position_difference_dph": 2.2})
    assert text.startswith("position_difference_dph: at best below 0.0024 deg/h (95 %), limit")
    assert limits_beyond({"position_difference_dph": 2.2}, cycles=2) == []


def test_limits_of_biases_and_of_their_uncertainty_are_named_too():
    found = limits_beyond({"position_difference_dph": 9.0, "bias_dph": 1.6})
    assert [text.partition(":")[0] for text in found] == ["bias_dph"]
    [text] = limits_beyond({"position_difference_dph": 9.0, "bias_dph": 9.0, "bias_sigma_dph": 0.9})
    assert text.startswith("bias_sigma_dph: up to 0.001 deg/h, above the limit of")
    assert text.endswith("in 2 of 2 dwells")


@pytest.mark.parametrize("procedure", ["six_position_fig7", "rotations", "signal_map_check"])
def test_shipped_limits_can_be_passed(procedure):
    _, plan = shipped(procedure)
    assert unreachable_limits(plan, declared_properties(station())) == []


def test_each_power_on_begins_a_run():
    _, plan = planned(
        f"  - power_on: {{settle_s: 60}}\n{dwell('z_up')}  - power_off\n  - wait: {{duration_s: 600}}\n"
        f"  - power_on: {{settle_s: 60}}\n{dwell('z_down')}{dwell('y_up')}"
    )
    campaign = planned_campaign(plan, UnitProperties())
    assert campaign.run.tolist() == [0, 1, 1]
    assert len(campaign.run_names) == 2
    # The travel to the two positions differs.
    in_position_s = campaign.since_power_on_s - [
        each.duration_s for each in plan.steps if each.step.name == "go_to"
    ]
    np.testing.assert_allclose(in_position_s[:2], in_position_s[0])
    assert len(campaign.power_on_s) == 2


def test_temperatures_without_sensors_are_unknown(fig7):
    plan, campaign = fig7
    without = planned_campaign(plan, UnitProperties(has_boards=False, has_case=False))
    assert np.isfinite(campaign.board_c).all()
    assert np.isfinite(campaign.case_c).all()
    assert np.isnan(without.board_c).all()
    assert np.isnan(without.case_c).all()


def test_without_a_chamber_there_is_no_set_point():
    _, plan = planned(f"  - power_on\n{dwell('z_up')}")
    assert np.isnan(planned_campaign(plan, UnitProperties()).set_c).all()


def test_a_calibration_check_gives_no_campaign():
    _, plan = shipped("calibration_check")
    with pytest.raises(MeasurementError, match="calibration_check has no dwell that measures a bias"):
        planned_campaign(plan, UnitProperties())


def test_noise_that_a_station_does_not_declare_is_taken_as_typical(tmp_path):
    there = station()
    noise = {"noise": "estimated"}
    there.file = there.file.model_copy(update={"ins": there.file.ins.model_copy(update=noise)})
    assert declared_properties(there) == UnitProperties()
    assert declared_properties(station()).noise_source == "declared by the station"


def test_it_is_close_to_the_measurements_of_a_run(short_run):
    _, plan = shipped("ten_minute_check")
    folder = short_run[0]
    measured = campaign_of(read_dwells(folder.dwells))
    expected = planned_campaign(plan, declared_properties(station()))
    assert expected.position == measured.position
    assert abs(expected.start_s - measured.start_s) < 60.0
    assert abs(expected.since_power_on_s - measured.since_power_on_s) < 60.0
    for name, within in (("gyro_c", 1.5), ("case_c", 2.5), ("board_c", 3.0)):
        assert np.abs(getattr(expected, name) - getattr(measured, name)).max() < within, name
    # Accelerometers add to the uncertainty of the level gyros alone; z is the vertical one.
    assert expected.sigma_dph[0, 2] == pytest.approx(measured.sigma_dph[0, 2], rel=0.02)
    assert np.all(expected.sigma_dph[0] < 1.01 * measured.sigma_dph[0])
    assert np.all(measured.sigma_dph[0] < 1.4 * expected.sigma_dph[0])


RAMP = "  - chamber: {temperature_c: 60, ramp_c_per_min: 4}\n"


def test_all_ends_at_the_chambers_temperature_and_the_units_own_heating():
    _, plan = planned(f"  - power_on: {{settle_s: 120}}\n{RAMP}  - soak: {{for_s: 40000}}\n")
    forecast = forecast_temperatures(plan)
    heating_c = station().file.unit.thermal.self_heating_c
    assert forecast.air_c[-1] == pytest.approx(60.0, abs=0.01)
    np.testing.assert_allclose(forecast.optics_c[-1], 60.0 + heating_c, atol=0.05)
    assert forecast.air_c[-1] < forecast.case_c[-1] < forecast.optics_c[-1].min()
    above_c = forecast.electronics_c[-1] - forecast.optics_c[-1]
    np.testing.assert_allclose(above_c, ELECTRONICS_ABOVE_OPTICS_K, atol=0.05)


def test_a_unit_that_is_off_follows_the_chamber_alone():
    _, plan = planned(f"{RAMP}  - soak: {{for_s: 40000}}\n")
    forecast = forecast_temperatures(plan)
    np.testing.assert_allclose(forecast.optics_c[-1], 60.0, atol=0.05)
    np.testing.assert_allclose(forecast.electronics_c[-1], 60.0, atol=0.05)


def test_the_optics_lag_behind_a_ramp_by_the_stations_time_constant():
    _, plan = planned("  - chamber: {temperature_c: -40, ramp_c_per_min: 0.1, within_c: 1}\n")
    forecast = forecast_temperatures(plan)
    behind_s = (forecast.optics_c[-1, 0] - forecast.air_c[-1]) / (0.1 / 60.0)
    assert behind_s == pytest.approx(station().file.unit.thermal.time_constant_s, rel=0.05)


def test_electronics_below_their_optics_are_cooler_than_above_them():
    _, plan = planned(
        "  - power_on\n  - go_to: {position: z_up}\n  - wait: {duration_s: 30000}\n"
        "  - go_to: {position: z_down}\n  - wait: {duration_s: 30000}\n"
    )
    forecast = forecast_temperatures(plan)
    above_c = forecast.electronics_c - forecast.optics_c
    up_c, down_c = above_c[len(above_c) // 2 - 2], above_c[-1]
    assert np.abs(up_c - down_c).max() > 1.0
    assert (up_c[0], up_c[1]) == (pytest.approx(up_c[1]), pytest.approx(up_c[0]))
    assert up_c[2] == pytest.approx(down_c[2], abs=0.01)  # its heat path is level in both


def test_means_are_taken_over_each_stretch():
    _, plan = planned("  - chamber: {temperature_c: 60, ramp_c_per_min: 0.5}\n")
    forecast = forecast_temperatures(plan)
    means = forecast.means(forecast.time_s, np.array([0.0, 600.0]), np.array([600.0, 1800.0]))
    np.testing.assert_allclose(means, [300.0, 1200.0])
