import numpy as np

from gyrobench.bench.closure.campaign import campaign_of
from gyrobench.bench.closure.effects.laws import AGEING
from tests.bench.closure.thermal_bench import measure

TAU_H = 20.0


def test_the_logarithmic_form_is_the_mean_logarithm_over_each_dwell():
    rows = measure(cycles=3, power_on_each_cycle=True).rows
    [form] = [each for each in AGEING.forms if each.name == "logarithmic"]
    found = form.columns(campaign_of(rows), (3600.0 * TAU_H,))
    for gyro in range(3):
        means = [
            np.log1p((np.linspace(row.start_s, row.end_s, 1001) - rows[0].start_s) / 3600.0 / TAU_H).mean()
            for row in rows
        ]
        np.testing.assert_allclose(found[:, gyro, 0], means, rtol=1e-4, atol=1e-6)


def test_it_needs_two_power_cycles_as_the_exponential_one_does():
    campaign = campaign_of(measure(cycles=3).rows)
    assert {form.missing_input(campaign) for form in AGEING.forms} == {AGEING.missing_input(campaign)}
    assert "two power cycles" in AGEING.missing_input(campaign)
