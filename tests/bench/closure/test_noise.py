"""Noise that is larger than stated, and outliers: recognized, named, and not called an effect."""

from dataclasses import replace

import numpy as np
import pytest

from gyrobench.bench.closure.campaign import campaign_of
from gyrobench.bench.closure.effects.laws import (
    AGEING,
    BIAS_JUMP,
    TEMPERATURE_RATE,
    THERMAL_LAG,
    TIME_DRIFT,
    WARM_UP,
)
from gyrobench.bench.closure.effects.surroundings import SUPPLY_POWER
from gyrobench.bench.closure.loop import close_loop, without_search
from gyrobench.bench.closure.noise import OUTLIER_SIGMA, estimate_campaign_noise, outweighing_dwell
from gyrobench.bench.report.closure_text import held_out_error_sentence
from tests.bench.closure.conftest import among
from tests.bench.closure.thermal_bench import EFFECTS, measure
from tests.benchmarks.closure_units import make_unit

HARD = ("understated", "outliers", "understated, outliers")


@pytest.mark.long
def test_clean_units_with_noise_larger_than_stated_or_outliers_are_called_clean():
    """Of 30, at most one is not; on all the noise is named."""
    verdicts, named = [], []
    for seed in range(30):
        noise = HARD[seed % 3]
        rows, truth = make_unit(seed, noise=noise)
        closure = close_loop(campaign_of(rows))
        verdicts.append(closure.verdict)
        searched = {row.dwell for row in rows if row.cycle < rows[-1].cycle}
        far = {each.dwell for each in closure.noise.outliers}
        assert far <= set(truth.outliers)
        if "understated" in noise:
            named.append(closure.noise.scale > 1.15)
        elif searched & set(truth.outliers):
            named.append(bool(far))
    assert verdicts.count("clean") >= 29
    assert np.mean(named) >= 0.95


@pytest.mark.long
@pytest.mark.parametrize("seed", [3, 5])
def test_clean_units_with_noise_that_gyros_share_are_called_clean(seed):
    rows, truth = make_unit(seed)
    random, correlations = np.random.default_rng([seed, 99]), np.full((3, 3), 0.8) + 0.2 * np.eye(3)
    noise = random.standard_normal((len(rows), 3)) @ np.linalg.cholesky(correlations).T
    biases_dph = truth.bias_dph + noise * [row.sigma_dph for row in rows]
    rows = [replace(row, bias_dph=tuple(each)) for row, each in zip(rows, biases_dph.tolist(), strict=True)]
    closure = close_loop(campaign_of(rows))
    assert (closure.verdict, closure.names) == ("clean", ())
    assert 1.5 < closure.noise.correlation_factor < 3.0


@pytest.mark.parametrize("scale", [1.2, 1.4, 1.6])
def test_the_scale_is_that_of_the_noise(scale):
    campaign = campaign_of(measure(noise=scale).rows)
    noise = estimate_campaign_noise(campaign, campaign.all_dwells)
    assert noise.scale == pytest.approx(scale, rel=0.08)
    assert noise.outliers == ()
    assert np.all(noise.factors == 1.0)


def with_sigmas_times(rows, factors):
    """The same dwells with other stated uncertainties of the gyros."""
    return [replace(row, sigma_dph=tuple((np.array(row.sigma_dph) * factors).tolist())) for row in rows]


@pytest.mark.parametrize("factor", [1.0 / 3.0, 0.5, 2.0, 3.0])
@pytest.mark.parametrize("gyro", range(3))
def test_a_gyro_whose_stated_uncertainties_are_wrong_has_its_own_scale(gyro, factor):
    factors = np.where(np.arange(3) == gyro, factor, 1.0)
    campaign = campaign_of(with_sigmas_times(measure(seed=gyro).rows, factors))
    noise = estimate_campaign_noise(campaign, campaign.all_dwells)
    np.testing.assert_allclose(noise.scales * factors, 1.0, rtol=0.3)
    assert noise.scales[gyro] != 1.0
    assert noise.outliers == ()


def test_two_gyros_whose_stated_uncertainties_are_wrong_have_their_own_scales():
    campaign = campaign_of(with_sigmas_times(measure(seed=0).rows, [0.4, 1.0, 0.3]))
    noise = estimate_campaign_noise(campaign, campaign.all_dwells)
    np.testing.assert_allclose(noise.scales * [0.4, 1.0, 0.3], 1.0, rtol=0.3)


def test_a_gyro_has_its_own_scale_beside_noise_of_all_that_is_larger_than_stated():
    campaign = campaign_of(with_sigmas_times(measure(noise=1.4, seed=0).rows, [1.0, 0.4, 1.0]))
    noise = estimate_campaign_noise(campaign, campaign.all_dwells)
    np.testing.assert_allclose(noise.scales * [1.0, 0.4, 1.0], 1.4, rtol=0.12)
    assert noise.scales[0] == noise.scales[2]


def test_a_gyro_that_was_not_measured_does_not_hide_the_scale_of_another_one():
    campaign = campaign_of(with_sigmas_times(measure(seed=0).rows, [1.0, 1.0 / 3.0, 1.0]))
    campaign = campaign.with_uncertainties(campaign.sigma_dph * [1.0, 1.0, np.inf])
    noise = estimate_campaign_noise(campaign, campaign.all_dwells)
    np.testing.assert_allclose(noise.scales, [1.0, 3.0, 1.0], rtol=0.3)


@pytest.mark.parametrize("size", [0.25, 0.5, 1.0, 2.0, 4.0])
@pytest.mark.parametrize("effect", ["g_sensitivity", "time_drift", "sinusoid"])
def test_an_effect_on_one_gyro_gives_it_no_scale(effect, size):
    alone = lambda course: EFFECTS[effect](course) * [1.0, 0.0, 0.0]  # noqa: E731
    campaign = campaign_of(measure({alone: 5.0 * size}, seed=3).rows)
    noise = estimate_campaign_noise(campaign, campaign.all_dwells)
    assert noise.scales.tolist() == [1.0, 1.0, 1.0]


@pytest.mark.parametrize("factor", [1.0 / 3.0, 3.0])
@among(TEMPERATURE_RATE, THERMAL_LAG, TIME_DRIFT)
def test_an_effect_is_found_beside_a_gyro_whose_stated_uncertainties_are_wrong(factor, candidates):
    for effects in ({}, {"temperature_rate": 3.0}):
        rows = with_sigmas_times(measure(effects, seed=1).rows, [1.0, factor, 1.0])
        closure = close_loop(campaign_of(rows), effects=candidates)
        assert (closure.verdict, closure.names) == ("explained" if effects else "clean", tuple(effects))
        assert closure.noise.scales[1] == pytest.approx(1.0 / factor, rel=0.3)


@pytest.mark.parametrize("effect", ["g_sensitivity", "time_drift", "sinusoid"])
def test_an_effect_is_no_noise(effect):
    campaign = campaign_of(measure({effect: 1.5}).rows)
    noise = estimate_campaign_noise(campaign, campaign.all_dwells)
    assert noise.scale == 1.0
    assert noise.outliers == ()


def test_noise_as_stated_has_no_scale_and_no_outliers():
    noises = [estimate_campaign_noise(c, c.all_dwells)
              for c in (campaign_of(measure(seed=seed).rows) for seed in range(20))]  # fmt: skip
    assert sum(each.scale > 1.0 for each in noises) <= 2
    assert all(each.outliers == () for each in noises)


def test_an_outlier_is_off_by_more_than_five_standard_deviations_and_counts_as_one():
    rows, truth = make_unit(13, noise="outliers")
    campaign = campaign_of(rows)
    noise = estimate_campaign_noise(campaign, campaign.all_dwells)
    assert {each.dwell for each in noise.outliers} <= set(truth.outliers)
    off = [abs(each.residual_sigma) for each in noise.outliers]
    assert off == sorted(off, reverse=True)
    assert min(off) > OUTLIER_SIGMA
    np.testing.assert_allclose(sorted(noise.factors[noise.factors > 1.0]), sorted(off))
    residuals = noise.problem(campaign, campaign.all_dwells).residuals
    assert np.abs(residuals[noise.factors > 1.0]).max() < 1.3


@pytest.mark.parametrize("seed", range(3))
def test_a_fit_that_leaves_no_degrees_of_freedom_shows_no_noise(seed):
    """Twelve dwells, of which the declared model and the smooth functions fit all values."""
    campaign = campaign_of(measure(cycles=1, noise=2.0, seed=seed).rows[::3][:12])
    searched = campaign.all_dwells
    noise = estimate_campaign_noise(campaign, searched, smooth=True)
    assert (noise.scale, noise.outliers) == (1.0, ())


def with_bias_times_1000(rows, dwell, gyros):
    """The same dwells, one with the biases of some gyros 1000 times as large."""
    factors = [1000.0 if axis in gyros else 1.0 for axis in "xyz"]
    off = [tuple((np.array(row.bias_dph) * factors).tolist()) for row in rows]
    return [
        replace(row, bias_dph=bias) if row.dwell == dwell else row
        for row, bias in zip(rows, off, strict=True)
    ]


@pytest.mark.parametrize("gyros", ["x", "xyz"])
@pytest.mark.parametrize("dwell", [5, 20])
def test_a_dwell_that_is_thousands_of_sigmas_off_is_the_only_outlier_and_counts_as_one(dwell, gyros):
    campaign = campaign_of(with_bias_times_1000(measure(seed=1).rows, dwell, gyros))
    searched = campaign.all_dwells
    noise = estimate_campaign_noise(campaign, searched)
    assert {(each.dwell, each.gyro) for each in noise.outliers} == {(dwell, gyro) for gyro in gyros}
    residuals = noise.problem(campaign, searched).residuals
    assert np.abs(residuals[noise.factors > 1.0]).max() < 1.3


@pytest.mark.parametrize("dwell", [5, 20])
@among(TEMPERATURE_RATE, THERMAL_LAG, TIME_DRIFT, BIAS_JUMP)
def test_an_effect_is_found_beside_a_dwell_that_is_thousands_of_sigmas_off(dwell, candidates):
    rows = measure({"temperature_rate": 3.0}, seed=1).rows
    without = close_loop(campaign_of(rows), effects=candidates)
    closure = close_loop(campaign_of(with_bias_times_1000(rows, dwell, "x")), effects=candidates)
    assert without.names == ("temperature_rate",)
    assert (closure.verdict, closure.names) == (without.verdict, without.names)
    assert {each.dwell for each in closure.noise.outliers} == {dwell}
    assert closure.error_after_dph == pytest.approx(without.error_after_dph, rel=0.05)


@among(TEMPERATURE_RATE, TIME_DRIFT, BIAS_JUMP, SUPPLY_POWER)
def test_an_effect_that_explains_a_dwell_far_off_is_found_with_it(candidates):
    random = np.random.default_rng(0)
    rows = measure(seed=1).rows
    watts = 30.0 + random.normal(size=len(rows))
    watts[20] += 500.0
    rows = [
        replace(
            row,
            bias_dph=tuple((np.array(row.bias_dph) + 5.0 * (watt - 30.0) * np.array(row.sigma_dph)).tolist()),
            other=(("supply_w", float(watt)),),
        )
        for row, watt in zip(rows, watts, strict=True)
    ]
    campaign = campaign_of(rows)
    searched = campaign.cycle != campaign.last_cycle
    assert {each.dwell for each in outweighing_dwell(campaign, searched).outliers} == {rows[20].dwell}
    closure = close_loop(campaign, effects=candidates)
    assert closure.names == ("supply_power",)
    assert closure.noise.outliers == ()


def test_of_two_dwells_far_off_the_one_that_chi2_rests_on_most_is_the_outlier_with_its_gyro_alone():
    rows = measure(seed=1).rows

    def off(row, axis, sigmas):
        biases = list(row.bias_dph)
        biases["xyz".index(axis)] += sigmas * row.sigma_dph["xyz".index(axis)]
        return replace(row, bias_dph=tuple(biases))

    rows[6], rows[10] = off(rows[6], "x", 1000.0), off(rows[10], "y", 900.0)
    campaign = campaign_of(rows)
    (outlier,) = outweighing_dwell(campaign, campaign.all_dwells).outliers
    assert (outlier.dwell, outlier.gyro) == (rows[6].dwell, "x")


def test_no_dwell_of_a_unit_with_a_large_effect_outweighs_all_others():
    campaign = campaign_of(measure({"attitude_thermal": 100.0}, seed=1).rows)
    assert outweighing_dwell(campaign, campaign.all_dwells).outliers == ()


@among(TIME_DRIFT, AGEING, WARM_UP, BIAS_JUMP)
def test_a_bias_that_no_effect_explains_stays_unexplained_beside_a_dwell_that_is_thousands_of_sigmas_off(
    candidates,
):
    rows, _ = make_unit(0, ["random_walk"], 2.0)
    without = close_loop(campaign_of(rows), effects=candidates)
    closure = close_loop(campaign_of(with_bias_times_1000(rows, 20, "y")), effects=candidates)
    assert (without.verdict, without.names) == (closure.verdict, closure.names) == ("unexplained", ())
    assert (20, "y") in {(each.dwell, each.gyro) for each in closure.noise.outliers}
    assert closure.error_after_dph == pytest.approx(without.error_after_dph, rel=0.05)
    assert closure.noise_scale == without.noise_scale == 1.0


@pytest.mark.parametrize("share", [0.15, 0.2, 0.3])
def test_where_too_many_biases_are_off_none_is_an_outlier(share):
    random = np.random.default_rng(0)
    rows = measure(seed=0).rows
    far = set(random.choice(len(rows), round(share * len(rows)), replace=False).tolist())
    sizes = {index: 10.0 ** random.uniform(1.0, 2.5) * random.choice([-1.0, 1.0], 3) for index in far}
    rows = [
        replace(row, bias_dph=tuple((np.array(row.bias_dph) + sizes[index] * row.sigma_dph).tolist()))
        if index in far
        else row
        for index, row in enumerate(rows)
    ]
    campaign = campaign_of(rows)
    assert estimate_campaign_noise(campaign, campaign.all_dwells).outliers == ()


@pytest.mark.parametrize("options", [{}, {"power_on_each_cycle": True}], ids=["one run", "a run each cycle"])
@among(TEMPERATURE_RATE, THERMAL_LAG, TIME_DRIFT)
def test_a_held_out_dwell_that_is_far_off_is_named(options, candidates):
    rows = measure({"temperature_rate": 3.0}, seed=1, **options).rows
    last = max(row.cycle for row in rows)
    dwell = [row.dwell for row in rows if row.cycle == last][3]
    assert close_loop(campaign_of(rows), effects=candidates).held_out.outliers == ()
    closure = close_loop(campaign_of(with_bias_times_1000(rows, dwell, "y")), effects=candidates)
    assert [(each.dwell, each.gyro) for each in closure.held_out.outliers] == [(dwell, "y")]
    assert (
        f"Included in these errors, further than 5 sigma from the prediction: dwell {dwell} (y "
        in held_out_error_sentence(closure)
    )


def follows_of_wandering(kind, seed):
    """What a bias that wanders follows, with probabilities; it is no effect."""
    closure = close_loop(campaign_of(make_unit(seed, [kind], 2.0)[0]))
    assert closure.verdict == "unexplained"
    follows = closure.posterior.process_probabilities
    assert sum(share for name, share in follows.items() if name.startswith("time")) > 0.9
    return follows


@pytest.mark.long
@pytest.mark.parametrize("kind", ["random_walk", "flicker"])
def test_a_bias_that_wanders_is_noise_of_its_own_spectrum(kind):
    spectra = ("time as a random walk", "time as flicker noise")
    found = [follows_of_wandering(kind, seed) for seed in range(5)]
    assert np.mean([sum(follows[each] for each in spectra) for follows in found]) > 0.4


def test_the_stated_noise_is_that_of_dwells_without_outliers():
    rows, truth = make_unit(13, noise="outliers")
    closure = without_search(campaign_of(rows))
    assert closure.noise.outliers
    assert closure.noise_dph == pytest.approx(np.sqrt(np.mean(truth.sigma_dph**2)), rel=0.15)


def test_rows_get_the_standard_deviations_of_the_search():
    rows, _ = make_unit(13, noise="outliers")
    campaign = campaign_of(rows)
    noise = estimate_campaign_noise(campaign, campaign.all_dwells)
    assert noise.outliers
    weighted = campaign_of(noise.weighted(rows))
    np.testing.assert_allclose(weighted.sigma_dph, campaign.sigma_dph * noise.factors)
