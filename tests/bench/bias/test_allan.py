import numpy as np
import pytest

from gyrobench.bench.bias.allan import (
    RANDOM_WALK,
    RATE_WALK,
    WHITE_ANGLE,
    allan_variance,
    fit_rate_noise,
    on_grid,
)
from gyrobench.bench.foundations.errors import MeasurementError

STEP = 0.1


def simulated(random, count, white=0.0, walk=0.0, rate_walk=0.0):
    """Angle of a rate with three kinds of noise, stepped exactly from sample to sample."""
    rate = np.concatenate([[0.0], rate_walk * np.sqrt(STEP) * np.cumsum(random.normal(size=count - 1))])
    # An integrated random walk within a step: independent of the rate at its end but for a half.
    within = rate_walk * STEP**1.5 / np.sqrt(12.0) * random.normal(size=count - 1)
    steps = (
        0.5 * STEP * (rate[1:] + rate[:-1]) + within + walk * np.sqrt(STEP) * random.normal(size=count - 1)
    )
    return np.concatenate([[0.0], np.cumsum(steps)]) + white * random.normal(size=count)


def by_definition(angle, factor):
    """Squares of differences of neighbouring mean rates, about their mean."""
    differences = []
    for first in range(len(angle) - 2 * factor):
        one, two, three = angle[first], angle[first + factor], angle[first + 2 * factor]
        difference = (three - two) / (factor * STEP) - (two - one) / (factor * STEP)
        if np.isfinite(difference):
            differences.append(difference)
    differences = np.array(differences)
    return 0.5 * ((differences - differences.mean()) ** 2).sum(), len(differences)


def test_variance_is_half_the_mean_square_difference_of_neighbouring_mean_rates():
    angle = simulated(np.random.default_rng(1), 200, white=0.3, walk=1.0)
    angle[[20, 21, 22, 90]] = np.nan
    allan = allan_variance([angle], STEP)
    assert allan.factors[0] == 1
    assert len(allan.factors) > 8
    for factor, variance, count in zip(allan.factors, allan.variance, allan.counts, strict=True):
        total, number = by_definition(angle, factor)
        assert (variance, count) == (pytest.approx(total / number), number)


def test_stretches_are_pooled_without_being_joined():
    random = np.random.default_rng(2)
    one, other = simulated(random, 200, walk=1.0), simulated(random, 120, walk=1.0)
    allan = allan_variance([one, other + 1e6], STEP)
    for factor, variance in zip(allan.factors, allan.variance, strict=True):
        (total, number), (more, further) = by_definition(one, factor), by_definition(other, factor)
        assert variance == pytest.approx((total + more) / (number + further), rel=1e-6)


def test_a_steady_ramp_of_the_rate_does_not_count():
    angle = simulated(np.random.default_rng(3), 1000, walk=1.0)
    ramp = 5.0 * (STEP * np.arange(1000)) ** 2 - 300.0
    np.testing.assert_allclose(
        allan_variance([angle + ramp], STEP).variance, allan_variance([angle], STEP).variance, rtol=1e-6
    )


@pytest.mark.long
@pytest.mark.parametrize(
    "noise",
    [
        {"white": 1.0},
        {"walk": 1.0},
        {"white": 0.1, "walk": 1.0},
        {"white": 1.0, "walk": 0.3, "rate_walk": 0.02},
    ],
)
def test_terms_scatter_about_the_truth_as_their_uncertainty_says(noise):
    random = np.random.default_rng(4)
    truth = np.array([noise.get(name, 0.0) ** 2 for name in ("white", "walk", "rate_walk")])
    fits = [
        fit_rate_noise(allan_variance([simulated(random, n, **noise) for n in (2000, 1500)], STEP))
        for _ in range(150)
    ]
    errors = np.array([fit.unbounded for fit in fits]) - truth
    assert (np.abs(errors.mean(axis=0)) < 4.0 * errors.std(axis=0) / np.sqrt(150)).all()
    stated = np.sqrt(np.mean([fit.sigmas**2 for fit in fits], axis=0))
    np.testing.assert_allclose(errors.std(axis=0) / stated, 1.0, atol=0.25)
    assert all((fit.terms >= 0.0).all() for fit in fits)


@pytest.mark.parametrize("noise", [{"white": 1.0}, {"walk": 1.0}])
def test_variances_scatter_as_their_dof_say(noise):
    random = np.random.default_rng(5)
    variances, freedoms = [], []
    for _ in range(300):
        allan = allan_variance([simulated(random, 1000, **noise)], STEP)
        variances.append(allan.variance)
        freedoms.append(fit_rate_noise(allan).edf)
    relative = np.std(variances, axis=0) / np.mean(variances, axis=0)
    np.testing.assert_allclose(relative * np.sqrt(np.median(freedoms, axis=0) / 2.0), 1.0, atol=0.2)


def test_fit_scales_with_the_units_of_angle_and_time():
    angle = simulated(np.random.default_rng(6), 2000, white=0.5, walk=1.0, rate_walk=0.1)
    fit = fit_rate_noise(allan_variance([angle], STEP))
    other = fit_rate_noise(allan_variance([1e-7 * angle], 10.0 * STEP))
    scale = 1e-14 * np.array([1.0, 0.1, 0.001])
    np.testing.assert_allclose(other.terms, fit.terms * scale, rtol=1e-6)
    np.testing.assert_allclose(other.sigmas, fit.sigmas * scale, rtol=1e-6)


def test_missing_samples_widen_the_uncertainty_and_leave_the_terms():
    random = np.random.default_rng(7)
    angle = simulated(random, 6000, white=0.1, walk=1.0)
    whole = fit_rate_noise(allan_variance([angle], STEP))
    angle[random.random(6000) < 0.1] = np.nan
    thinned = fit_rate_noise(allan_variance([angle], STEP))
    assert 1.0 < thinned.sigmas[RANDOM_WALK] / whole.sigmas[RANDOM_WALK] < 1.5
    assert abs(thinned.terms[RANDOM_WALK] - 1.0) < 3.0 * thinned.sigmas[RANDOM_WALK]


def test_a_line_of_a_dither_is_no_noise_term_and_widens_the_uncertainty():
    angle = simulated(np.random.default_rng(8), 6000, white=0.3, walk=0.1)
    plain = fit_rate_noise(allan_variance([angle], STEP))
    shaken = fit_rate_noise(allan_variance([angle + 2.0 * np.sin(2.9 * STEP * np.arange(6000))], STEP))
    assert plain.excess == 0.0
    assert shaken.excess > 0.1
    assert shaken.sigmas[RANDOM_WALK] > 5.0 * plain.sigmas[RANDOM_WALK]


def test_each_term_is_distinguished_from_the_others():
    random = np.random.default_rng(9)
    for term, name in ((WHITE_ANGLE, "white"), (RANDOM_WALK, "walk"), (RATE_WALK, "rate_walk")):
        fit = fit_rate_noise(allan_variance([simulated(random, 6000, **{name: 2.0})], STEP))
        assert fit.terms[term] == pytest.approx(4.0, rel=0.5)
        others = [other for other in range(3) if other != term]
        assert (fit.terms[others] <= 3.0 * fit.sigmas[others]).all()


def test_too_few_samples_are_refused():
    with pytest.raises(MeasurementError, match=r"longest segment.*has 11 samples"):
        allan_variance([np.zeros(11)], STEP)
    with pytest.raises(MeasurementError, match=r"longest segment.*has 0 samples"):
        allan_variance([], STEP)
    short = simulated(np.random.default_rng(10), 20, walk=1.0)
    with pytest.raises(MeasurementError, match="have enough degrees of freedom for a noise fit"):
        fit_rate_noise(allan_variance([short], STEP))


def test_samples_take_their_place_on_a_grid_in_spite_of_gaps_and_jitter():
    random = np.random.default_rng(11)
    places = np.delete(np.arange(400), [3, 4, 5, 6, 7, 90, 200, 202])
    time = 50.0 + STEP * (places + random.uniform(-0.1, 0.1, len(places)))
    interval, grid = on_grid(time, places[:, np.newaxis].astype(float))
    assert interval == pytest.approx(STEP, rel=1e-3)
    expected = np.arange(400.0)
    expected[[3, 4, 5, 6, 7, 90, 200, 202]] = np.nan
    np.testing.assert_array_equal(grid[:, 0], expected)


def test_expected_variance_follows_the_measured_one_where_the_mean_takes_much_off():
    random = np.random.default_rng(12)
    segments = [simulated(random, 400, walk=0.1, rate_walk=1.0) for _ in range(400)]
    allan = allan_variance(segments, STEP)
    fit = fit_rate_noise(allan)
    np.testing.assert_allclose(fit.expected / allan.variance, 1.0, atol=0.08)
    tau = allan.tau_s[-1]
    assert fit.expected[-1] < 0.9 * (fit.terms[RANDOM_WALK] / tau + fit.terms[RATE_WALK] * tau / 3.0)
