"""Residual bias with each compensation, and its uncertainty."""

import csv
from dataclasses import replace

import numpy as np
import pytest

from gyrobench.bench.bias.dwell_table import NOT_MEASURED
from gyrobench.bench.closure.campaign import campaign_of
from gyrobench.bench.closure.effects.laws import G_SENSITIVITY
from gyrobench.bench.closure.loop import close_loop
from gyrobench.bench.closure.problem import predict
from gyrobench.bench.closure.uncertainty import Draws
from gyrobench.bench.navigation.positions import POSITIONS
from gyrobench.bench.verification.compensation_verification import (
    COMPARISON_TABLE,
    MeasuredRun,
    compare_runs,
    is_better,
    is_worse,
    table_rows,
)
from gyrobench.drivers.ins.compensation import Compensation
from tests.bench.closure.thermal_bench import measure
from tests.bench.report.made_up_verification import SIGMA_DPH, SITE, rows_of
from tests.bench.verification.runs_alone import compensation_result

FITTED_C = np.array([[62.0], [20.0], [0.0]]) + np.zeros(3)


def residual(bias_dph=0.02, **options):
    return compensation_result("none", rows_of(bias_dph, **options), [], SITE, FITTED_C)


def test_a_varying_bias_is_separated_from_the_constant_of_the_power_cycle():
    small, large = residual(constant_dph=0.0).total, residual(constant_dph=0.1).total
    assert large.bias_rms_dph > 4.0 * small.bias_rms_dph
    assert large.varying_rms_dph == pytest.approx(small.varying_rms_dph)
    assert large.spread_dph == pytest.approx(small.spread_dph)
    assert large.position_nmi == pytest.approx(small.position_nmi, rel=0.2)
    # One of three gyros shows the 0.02 deg/h in each dwell, up or down.
    assert small.varying_rms_dph == pytest.approx(0.02 / np.sqrt(3.0), rel=0.1)
    assert small.spread_dph == pytest.approx(0.04, rel=0.1)


def test_two_power_cycles_with_different_constants_at_one_plateau_vary_by_noise_alone():
    first, second = (
        [replace(row, run=run, dwell=row.dwell + 100 * place) for row in rows_of(0.0, constant_dph=constant)]
        for place, (run, constant) in enumerate([("one", 0.0), ("two", 0.1)])
    )
    both = compensation_result("none", [*first, *second], [], SITE, FITTED_C)
    assert both.total.varying_p_value > 0.01
    assert sum(row.dwells for row in both.rows) == both.total.dwells


def test_noise_is_not_significant_and_a_bias_along_up_is():
    assert residual(0.0).total.varying_p_value > 0.01
    assert residual(0.02).total.varying_p_value < 1e-9
    assert residual(0.0).total.bias_noise_dph == pytest.approx(SIGMA_DPH)


def with_common_error(rows, common_dph):
    """The same rows with a part of the uncertainty of vertical gyros that all dwells have in common."""
    for row in rows:
        common = common_dph * np.abs(POSITIONS[row.position].C_nb()[2])
        sigma_dph = np.hypot(row.sigma_dph, common)
        yield replace(row, sigma_dph=tuple(sigma_dph.tolist()), common_sigma_dph=tuple(common.tolist()))


def test_an_error_that_dwells_have_in_common_counts_once_and_hides_no_other_bias():
    def p_value(rows):
        return compensation_result("none", rows, [], SITE, FITTED_C).total.varying_p_value

    along_up = [*with_common_error(rows_of(3.5 * SIGMA_DPH), 1.5 * SIGMA_DPH)]
    assert p_value([replace(row, common_sigma_dph=NOT_MEASURED) for row in along_up]) < 1e-3
    assert p_value(along_up) > 0.01
    varying = [
        replace(
            row, bias_dph=tuple(np.array(row.bias_dph) + (5.0 * SIGMA_DPH if row.gyro_c[0] > 40.0 else 0.0))
        )
        for row in with_common_error(rows_of(0.0), 10.0 * SIGMA_DPH)
    ]
    assert p_value(varying) < 1e-9


def compared(before_dph, after_dph, seed, common_dph=0.0):
    """Two runs with biases (n, 3) beside their noise and one error along Up, the same in both."""
    error_dph = common_dph * np.random.default_rng(1000 + seed).standard_normal(3)
    up = np.array([POSITIONS[row.position].C_nb()[2] for row in rows_of(0.0)])
    runs = [
        [
            replace(row, bias_dph=tuple(row.bias_dph + each))
            for row, each in zip(
                with_common_error(rows_of(0.0, seed=run), common_dph), bias_dph + error_dph * up, strict=True
            )
        ]
        for run, bias_dph in ((2 * seed, before_dph), (2 * seed + 1, after_dph))
    ]
    return compare_runs(
        [MeasuredRun(name, rows, []) for name, rows in zip(("none", "effect"), runs, strict=True)],
        SITE,
        FITTED_C,
    )


ALONG_UP = np.array([POSITIONS[row.position].C_nb()[2] for row in rows_of(0.0)])
WITH_TEMPERATURE = np.array([np.sign(np.array(row.gyro_c) - 30.0) for row in rows_of(0.0)])


@pytest.mark.parametrize("common", [0.0, 3.0])
def test_errors_in_common_make_no_run_better_or_worse_and_hide_no_change_beside_them(common):
    seeds, common_dph = range(5), common * SIGMA_DPH
    reversed_signs = [
        compared(*(sign * 3.0 * SIGMA_DPH * ALONG_UP for sign in (1.0, -1.0)), seed, common_dph)
        for seed in seeds
    ]
    changed = [
        compared(0.0 * ALONG_UP, 2.5 * SIGMA_DPH * WITH_TEMPERATURE, seed, common_dph) for seed in seeds
    ]
    assert not any(is_worse(after, before) or is_better(after, before) for before, after in reversed_signs)
    assert all(is_worse(after, before) for before, after in changed)


def test_the_stated_noise_is_that_of_noise_alone():
    ratios = [
        (total.spread_dph / total.spread_noise_dph, total.position_nmi / total.position_noise_nmi)
        for total in (residual(0.0, seed=seed).total for seed in range(20))
    ]
    spread, position = np.median(ratios, axis=0)
    # The larger of two plateaus.
    assert 0.9 < spread < 1.5
    assert 0.3 < position < 1.5


def test_each_plateau_has_its_position_relative_to_the_fit():
    first, on_the_way, last = residual().rows
    assert [row.plateau for row in (first, on_the_way, last)] == [1, 2, 3]
    assert [row.fit for row in (first, on_the_way, last)] == ["fitted", "between", "fitted"]
    assert [row.cycle for row in (first, on_the_way, last)] == [1, 2, 1]
    assert [row.dwells for row in (first, on_the_way, last)] == [6, 2, 6]
    assert np.isnan(on_the_way.position_nmi)
    cold = compensation_result("none", rows_of(0.0), [], SITE, FITTED_C + 30.0)
    assert [row.fit for row in cold.rows] == ["between", "fitted", "outside"]


def test_dwells_with_flags_are_left_out():
    rows = rows_of(0.0)
    rows[3] = replace(rows[3], flags=("the table moved",), bias_dph=(9.0, 9.0, 9.0))
    total = compensation_result("none", rows, [], SITE, FITTED_C).total
    assert total.dwells == 13
    assert total.bias_rms_dph < 0.01


def test_without_measurements_there_is_no_result():
    nothing = compensation_result("none", [], [], SITE, FITTED_C)
    assert nothing.rows == ()
    assert nothing.total.dwells == 0
    assert np.isnan(nothing.total.varying_rms_dph)


def test_the_table_has_a_row_for_each_plateau_and_one_for_all(tmp_path):
    COMPARISON_TABLE.write(
        tmp_path / "comparison.csv",
        table_rows([residual(), compensation_result("effect", rows_of(0.0), [], SITE, FITTED_C)]),
    )
    rows = list(csv.DictReader((tmp_path / "comparison.csv").read_text().splitlines()))
    assert [(row["compensation"], row["stop"]) for row in rows] == [
        *(("none", stop) for stop in "1230"),
        *(("effect", stop) for stop in "1230"),
    ]
    assert float(rows[3]["varying_rms_dph"]) == pytest.approx(residual().total.varying_rms_dph)
    assert rows[3]["gyro_c"] == rows[1]["position_nmi"] == ""


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
