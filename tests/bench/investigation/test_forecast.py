import numpy as np
import pytest

from gyrobench.bench.closure.campaign import campaign_of
from gyrobench.bench.investigation.blocks import catalogue
from gyrobench.bench.investigation.forecast import Forecast
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
    forecast = Forecast(rows, campaign_of(rows))
    found = forecast.rows(plan)
    assert [row.dwell for row in found] == [row.dwell for row in true]
    for expected, measured in zip(found, true, strict=True):
        assert np.allclose(expected.gyro_c, measured.gyro_c, atol=3.0)
        assert np.allclose(expected.board_c, measured.board_c, atol=5.0)
        assert expected.since_power_on_s == pytest.approx(measured.since_power_on_s, abs=120.0)
        assert (expected.run, expected.cycle, expected.position) == (
            measured.run, measured.cycle, measured.position
        )  # fmt: skip
    assert forecast.thermal.rms_k < 1.0


def test_a_longer_dwell_is_expected_to_be_less_uncertain(rows):
    plan = next(each.plan for each in catalogue(rows) if each.name == "longer dwells")
    [first, _] = Forecast(rows, campaign_of(rows)).rows(plan)
    assert first.sigma_dph[0] == pytest.approx(rows[0].sigma_dph[0] / np.sqrt(3.0))
