import itertools
from dataclasses import replace

import numpy as np
import pytest

from gyrobench.bench.closure.campaign import campaign_of
from gyrobench.bench.investigation.blocks import catalogue
from gyrobench.bench.investigation.forecast import Forecast, chamber_c
from tests.bench.investigation.simulated_bench import first_campaign, simulate

UNIT = {"unit": "S1", "seed": 4, "effects": {}, "steps": first_campaign([45.0, 10.0, -20.0])}


@pytest.fixture(scope="module")
def rows():
    return simulate(UNIT)


@pytest.mark.parametrize("name", ["soak from above", "slow ramp", "power cycle", "hot, six positions"])
def test_forecast_temperatures_agree_with_a_network_of_other_physics(rows, name):
    plan = next(each.plan for each in catalogue(rows) if each.name == name)
    steps = [step.model_dump() for step in plan.steps]
    true = [row for row in simulate(UNIT | {"steps": UNIT["steps"] + steps}) if row.dwell > rows[-1].dwell]
    forecast = Forecast(rows)
    found = forecast.rows(plan)
    assert [row.dwell for row in found] == [row.dwell for row in true]
    for expected, measured in zip(found, true, strict=True):
        assert np.allclose(expected.gyro_c, measured.gyro_c, atol=3.0)
        assert np.allclose(expected.board_c, measured.board_c, atol=5.0)
        assert expected.since_power_on_s == pytest.approx(measured.since_power_on_s, abs=120.0)
        assert (expected.run, expected.cycle, expected.position) == (
            measured.run, measured.cycle, measured.position
        )  # fmt: skip
    assert forecast._thermal_model[0].rms_k < 1.0


def test_a_longer_dwell_is_expected_to_be_less_uncertain(rows):
    plan = next(each.plan for each in catalogue(rows) if each.name == "longer dwells")
    [first, _] = Forecast(rows).rows(plan)
    assert first.sigma_dph[0] == pytest.approx(rows[0].sigma_dph[0] / np.sqrt(3.0))


def test_without_temperatures_of_the_chamber_blocks_are_planned_below_the_gyros(rows):
    bare = [replace(row, chamber_set_c=np.nan, chamber_c=np.nan) for row in rows]
    assert chamber_c(bare) == pytest.approx(chamber_c(rows), abs=14.0)
    alone = catalogue(bare)
    blocks = [*alone, *catalogue(bare, itertools.permutations([each.name for each in alone], 2))]
    assert all(
        np.isfinite(step.to_c) for each in blocks for step in each.plan.steps if step.kind == "chamber"
    )
    forecast = Forecast(bare)
    [hot] = [each.plan for each in blocks if each.name == "hot, six positions"]
    expected = Forecast(rows).rows(
        next(each.plan for each in catalogue(rows) if each.name == "hot, six positions")
    )
    for one, other in zip(forecast.rows(hot), expected, strict=True):
        assert np.allclose(one.gyro_c, other.gyro_c, atol=14.0)
        assert np.isfinite(one.board_c).all()


def test_electronics_without_a_sensor_are_forecast_as_the_table_shows_them(rows):
    campaign = campaign_of(rows)
    plan = next(each.plan for each in catalogue(rows) if each.name == "hot, six positions")
    forecast = Forecast([replace(row, board_c=(np.nan,) * 3) for row in rows])
    vars(forecast.campaign)["above_optics_c"] = 2.0 * (campaign.board_c - campaign.gyro_c) + 1.0
    above = np.array([np.subtract(row.board_c, row.gyro_c) for row in forecast.rows(plan)])
    known = np.array([np.subtract(row.board_c, row.gyro_c) for row in Forecast(rows).rows(plan)])
    assert above == pytest.approx(2.0 * known + 1.0, abs=4.0)
