"""The uncertainty of a compensation beside what remains with it."""

from dataclasses import replace

import numpy as np
import pytest

from gyrobench.bench.closure.campaign import campaign_of
from gyrobench.bench.closure.effects.laws import G_SENSITIVITY
from gyrobench.bench.closure.loop import close_loop
from gyrobench.bench.closure.problem import predict
from gyrobench.bench.closure.uncertainty import Draws
from gyrobench.bench.verification.compensation_verification import MeasuredRun, compare_runs
from gyrobench.drivers.ins.compensation import Compensation
from tests.bench.closure.thermal_bench import measure
from tests.bench.report.made_up_verification import SITE, rows_of
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


def test_beyond_the_limits_of_an_ins_its_compensation_is_as_uncertain_as_at_the_limit():
    random = np.random.default_rng(5)
    powers = random.normal(0.0, 1e-3, (50, 3, 3))
    draws = Draws(
        np.concatenate([powers, np.zeros((50, 3, 1))], axis=2), ("run 9",), {}, ((),), np.zeros(50, int)
    )
    rows = rows_of(0.0)
    limits = Compensation(np.zeros((3, 1)), np.full(3, 20.0), np.full(3, 40.0))
    at_limit = [replace(row, gyro_c=tuple(np.clip(row.gyro_c, 20.0, 40.0))) for row in rows]

    def sigma_dph(rows, **how):
        run = MeasuredRun("declared", rows, (), (draws, ()), limits, **how)
        [result] = compare_runs([run], SITE, np.zeros((1, 3)))
        return result.total.compensation_sigma_dph

    assert sigma_dph(rows) == pytest.approx(sigma_dph(at_limit))
    assert sigma_dph(rows, is_limited=False) > 1.5 * sigma_dph(rows)


def test_without_a_compensation_there_is_no_uncertainty():
    total = compensation_result("none", measure(SIZES, cycles=1).rows, [], SITE, np.zeros((1, 3))).total
    assert np.isnan(total.compensation_sigma_dph)
    assert np.isnan(total.agreement_p_value)
