import numpy as np
import pytest

from gyrobench.bench.investigation.blocks import catalogue
from gyrobench.bench.investigation.forecast import fit_thermal_model, forecast_dwells
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
    model = fit_thermal_model(rows)
    found = forecast_dwells(rows, plan, model)
    assert [row.dwell for row in found] == [row.dwell for row in true]
    for forecast, measured in zip(found, true, strict=True):
        assert np.allclose(forecast.gyro_c, measured.gyro_c, atol=3.0)
        assert np.allclose(forecast.board_c, measured.board_c, atol=5.0)
        assert forecast.since_power_on_s == pytest.approx(measured.since_power_on_s, abs=120.0)
        assert (forecast.run, forecast.cycle, forecast.position) == (
            measured.run, measured.cycle, measured.position
        )  # fmt: skip
    assert model.rms_c < 1.0


def test_a_longer_dwell_is_expected_to_be_less_uncertain(rows):
    plan = next(each.plan for each in catalogue(rows) if each.name == "longer dwells")
    [first, _] = forecast_dwells(rows, plan, fit_thermal_model(rows))
    assert first.sigma_dph[0] == pytest.approx(rows[0].sigma_dph[0] / np.sqrt(3.0))
