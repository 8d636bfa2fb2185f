"""The uncertainty of a compensation beside what remains with it."""

from dataclasses import replace

import numpy as np
import pytest

from gyrobench.bench.closure.campaign import campaign_of
from gyrobench.bench.closure.effects.laws import G_SENSITIVITY
from gyrobench.bench.closure.loop import close_loop
from gyrobench.bench.closure.problem import predict
from tests.bench.closure.thermal_bench import measure
from tests.bench.report.made_up_verification import SITE
from tests.bench.verification.runs_alone import compensation_result

SIZES = {"g_sensitivity": 4.0}
#: Noise of the new measurements, as a share of that of the campaign.
FINER = 0.3


def remaining(seed, name="effect"):
    """What remains in finer measurements with a compensation from a campaign of two cycles."""
    closure = close_loop(campaign_of(measure(SIZES, cycles=2, seed=seed).rows), effects=[G_SENSITIVITY])
    rows = measure(SIZES, cycles=1, seed=seed + 1000, noise=FINER).rows
    rows = [replace(row, sigma_dph=tuple(FINER * each for each in row.sigma_dph)) for row in rows]
    campaign = campaign_of(rows)
    model, draws, found = closure.declared, closure.declared_draws, ()
    if name == "effect":
        model, draws, found = closure.model, closure.model_draws, closure.effects
    bias_dph = predict(
        campaign,
        model.declared[:, : 3 + len(campaign.run_names)],
        [each.sizes_dph for each in found],
        [each.candidate.columns(campaign) for each in found],
    )
    left = [
        replace(row, bias_dph=tuple((each - modelled).tolist()))
        for row, each, modelled in zip(rows, campaign.bias_dph, bias_dph, strict=True)
    ]
    fitted = draws, [each.effect.name for each in found]
    return compensation_result(name, left, [], SITE, campaign.gyro_c, fitted).total


@pytest.mark.long
def test_what_remains_agrees_with_the_uncertainty_of_the_compensation():
    totals = [remaining(seed) for seed in range(10)]
    assert max(each.varying_p_value for each in totals) < 1e-3
    assert sum(each.agreement_p_value > 0.05 for each in totals) >= 8


def test_a_compensation_without_the_effect_does_not_agree():
    total = remaining(0, "declared")
    assert total.agreement_p_value < 1e-9
    assert total.varying_rms_dph > 3.0 * total.compensation_sigma_dph


def test_without_a_compensation_there_is_no_uncertainty():
    total = compensation_result("none", measure(SIZES, cycles=1).rows, [], SITE, np.zeros((1, 3))).total
    assert np.isnan(total.compensation_sigma_dph)
    assert np.isnan(total.agreement_p_value)
