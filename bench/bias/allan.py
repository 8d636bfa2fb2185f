"""Overlapping Allan variance of a rate from its integral, and the noise terms fitted to it.

The output of an instrument is the integral ``theta`` of the rate (an angle, or a velocity for accelerations).
Its second differences over an averaging time tau give the Allan variance,

    ``sigma^2(tau) = <(theta(t + 2 tau) - 2 theta(t + tau) + theta(t))^2> / (2 tau^2)``

in which three kinds of noise have different slopes (IEEE Std 952, annex C):

    ``sigma^2(tau) = 3 S^2 / tau^2 + N^2 / tau + K^2 tau / 3``

with S the white noise of the angle (rounding, quantisation), N the random walk of the angle (white
noise of the rate), K the random walk of the rate. On request, the bias instability B (flicker noise of the
rate) adds ``2 ln 2 / pi B^2``. Here the mean of the second differences of each segment is subtracted first,
so that a steady ramp of the rate (Earth-rate coupling, warm-up, an acceleration due to a gyro bias) has no
effect. The expected variances allow for this.

The covariance of the Allan variances at all averaging times is computed exactly, as a sum over the second
differences, for Gaussian noise of the fitted kind.

References
----------
IEEE Std 952-1997, annex C. Riley, *Handbook of Frequency Stability Analysis*, NIST SP 1065 (2008),
sections 5.2.4 and 5.4. Greenhall and Riley, "Uncertainty of Stability Variances Based on Finite
Differences", PTTI 2003: variance of such a sum from the covariance of the differences.
Matheron, "The intrinsic random functions and their applications", 1973: generalised covariance.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from gyrobench.bench.foundations.arrays import BoolArray, FloatArray, IntArray
from gyrobench.bench.foundations.errors import MeasurementError
from gyrobench.bench.foundations.kernels import compiled

#: Indices of the noise terms: S^2, N^2, K^2, and on request B^2.
WHITE_ANGLE, RANDOM_WALK, RATE_WALK, BIAS_INSTABILITY = range(4)
#: Averaging times in a decade.
_TIMES_PER_DECADE = 8
#: The longest segment is at least this number of times as long as the longest averaging time.
_MIN_REPEATS = 6
#: Fewest equivalent degrees of freedom of an averaging time that is used in a fit.
_MIN_EDF = 8.0
#: The model does not fit if the sum of squared residuals, relative to its expectation, is larger.
_MAX_CHI2_RATIO = 3.0

_TERMS = 3  # without the bias instability
_FLICKER_LAG_FACTOR = 4  # in overlaps of two second differences
_SPARE_TIMES = 1  # averaging times beyond the number of terms
_ITERATIONS = 4


@dataclass(frozen=True, eq=False)
class AllanVariance:
    """Allan variance of one channel, pooled over segments that can't be joined."""

    interval_s: float  #: Time between two samples.
    factors: IntArray  #: Shape (k,). Averaging times in samples.
    #: Shape (k,). Of the rate, (unit of the integral / s)^2, without the mean of each segment's second
    #: differences.
    variance: FloatArray
    counts: IntArray  #: Shape (k,). Number of second differences, of which only few are independent.
    lengths: tuple[int, ...]  #: Samples of each segment.

    @property
    def tau_s(self) -> FloatArray:
        """Averaging times."""
        return np.asarray(self.factors * self.interval_s, np.float64)

    @property
    def deviation(self) -> FloatArray:
        """Allan deviation, unit of the integral / s."""
        return np.asarray(np.sqrt(self.variance), np.float64)


@dataclass(frozen=True, eq=False)
class RateNoise:
    """Noise terms fitted to an Allan variance."""

    terms: FloatArray  #: Shape (3,), with B^2 (4,). Squares in the module's formula, at least zero.
    unbounded: FloatArray  #: Of the same shape. Terms of a fit that may be below zero.
    covariance: FloatArray  #: Shape (3, 3) or (4, 4). Covariance of ``unbounded``.
    #: Shape (k,). Allan variance expected from ``terms``, without the means of the segments.
    expected: FloatArray
    used: BoolArray  #: Shape (k,). Mask of the averaging times used.
    edf: FloatArray  #: Shape (k,). Equivalent degrees of freedom of each averaging time.
    #: Relative standard deviation of the variances about the model beyond their uncertainty; 0 if the model
    #: fits. The covariance includes it.
    excess: float

    @property
    def sigmas(self) -> FloatArray:
        """Standard uncertainty of each term."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    @property
    def mean_terms(self) -> FloatArray:
        """Expectation of each term, if it is at least zero: mean of the truncated normal distribution."""
        from scipy.stats import norm

        z = self.unbounded / self.sigmas
        # exp(logs) instead of the ratio, which is 0 / 0 far below zero.
        return np.asarray(self.unbounded + self.sigmas * np.exp(norm.logpdf(z) - norm.logcdf(z)))


def on_grid(time_s: FloatArray, values: FloatArray) -> tuple[float, FloatArray]:
    """Put samples on an even grid; returns its mean interval, s, and values (m, c), NaN for missing samples.

    ``time_s`` (n,): increasing; jitter that is small relative to the interval does not matter. ``values`` (n,
    c): samples.
    """
    steps = np.diff(time_s)
    indices = np.concatenate([[0], np.cumsum(np.maximum(np.rint(steps / np.median(steps)), 1))]).astype(int)
    grid = np.full((indices[-1] + 1, values.shape[1]), np.nan)
    grid[indices] = values
    return float((time_s[-1] - time_s[0]) / indices[-1]), grid


def allan_variance(segments: Sequence[FloatArray], interval_s: float) -> AllanVariance:
    """Overlapping Allan variance of a rate from its integral.

    ``segments``, each (n_i,): integral of the rate on an even grid, NaN for missing samples: a second
    difference is used if its three samples are present. Channels with the same noise may be further segments.
    ``interval_s``: time between two samples. Raises MeasurementError if no segment is long enough.
    """
    longest = max((len(each) for each in segments), default=0)
    if longest < 2 * _MIN_REPEATS:
        raise MeasurementError(
            f"the longest segment for an Allan variance has {longest} samples; it needs {2 * _MIN_REPEATS}. "
            "Record longer at rest"
        )
    max_factor = longest // _MIN_REPEATS
    spaced = np.geomspace(1, max_factor, max(2, 1 + int(np.ceil(_TIMES_PER_DECADE * np.log10(max_factor)))))
    factors = np.unique(np.rint(spaced).astype(np.int64))
    arrays = [np.ascontiguousarray(segment, np.float64) for segment in segments]
    sums = [[_sum_of_squares(segment, factor) for segment in arrays] for factor in factors.tolist()]
    squares, counts = np.array(sums).sum(axis=1).T
    present = counts > 0
    factors, squares, counts = factors[present], squares[present], counts[present]
    variance = squares / counts / (2.0 * (factors * interval_s) ** 2)
    lengths = tuple(sorted(len(each) for each in segments))
    return AllanVariance(interval_s, factors, variance, counts.astype(np.int64), lengths)


@compiled
def _sum_of_squares(angle: FloatArray, factor: int) -> tuple[float, int]:
    """Sum of squares about their mean of the second differences, and their number."""
    mean, squares, count = 0.0, 0.0, 0
    for k in range(len(angle) - 2 * factor):
        second = angle[k + 2 * factor] - 2.0 * angle[k + factor] + angle[k]
        if np.isfinite(second):
            count += 1
            deviation = second - mean
            mean += deviation / count
            squares += deviation * (second - mean)
    return (squares, count) if count > 1 else (0.0, 0)


def fit_rate_noise(allan: AllanVariance, *, with_instability: bool = False) -> RateNoise:
    """Fit the noise terms to an Allan variance, with the bias instability only on request.

    Weighted least squares of variances without negative terms. The weights are computed from the model,
    iteratively: weights from the measured variances would favour those that happen to be small. If the model
    does not explain the variances, as with the spectral lines of a dither, a common relative error that
    explains them is included in the weights and the covariance (Paule and Mandel, J. Res. NBS 87, 1982).

    Raises MeasurementError if too few averaging times have enough degrees of freedom.
    """
    information = _Information.of(allan, _TERMS + with_instability)
    candidates = allan.variance > 0.0
    used, excess = candidates, 0.0
    _check_enough(used, allan)
    relative = 2.0 * allan.factors / allan.counts
    terms, _ = _solve(information.design, allan.variance, relative * allan.variance**2, used)
    for _ in range(_ITERATIONS):
        model, covariance = information.design @ terms, information.covariance(terms)
        edf = 2.0 * model**2 / np.diag(covariance)
        used = candidates & (edf >= _MIN_EDF)
        _check_enough(used, allan)
        excess = _excess(allan.variance, model, np.diag(covariance), used, len(terms))
        errors = covariance + np.diag((excess * model) ** 2)
        terms, solve = _solve(information.design, allan.variance, np.diag(errors), used)
    return RateNoise(
        terms=terms,
        unbounded=solve @ allan.variance[used],
        covariance=solve @ errors[np.ix_(used, used)] @ solve.T,
        expected=information.design @ terms,
        used=used,
        edf=edf,
        excess=excess,
    )


def goodness_of_fit(allan: AllanVariance, noise: RateNoise) -> float:
    """p-value of the Allan variance under the fitted terms; small if they do not explain it.

    Computed from logarithms, whose distribution is closer to normal than that of the variances, with their
    covariance, since neighbouring averaging times are strongly correlated.
    """
    from scipy.stats import chi2

    used, terms = noise.used, len(noise.terms)
    information = _Information.of(allan, terms)
    model = information.design[used] @ noise.terms
    relative = information.covariance(noise.terms)[np.ix_(used, used)] / np.outer(model, model)
    root = np.linalg.cholesky(relative)
    # The mean of the logarithm of chi-squared is below the logarithm of its mean by 1 / edf.
    logs = np.log(allan.variance[used] / model) + 1.0 / noise.edf[used]
    white = np.linalg.solve(root, np.column_stack([logs, information.design[used] / model[:, np.newaxis]]))
    residual = white[:, 0] - white[:, 1:] @ np.linalg.lstsq(white[:, 1:], white[:, 0])[0]
    return float(chi2.sf(residual @ residual, np.count_nonzero(used) - terms))


def mean_ramp(segments: Sequence[FloatArray], interval_s: float, noise: RateNoise) -> tuple[float, float]:
    """Mean slope of the rate over segments without a gap, and its standard uncertainty due to the noise.

    The slope of a segment is the mean of its second differences over a third of its length.
    """
    powers = interval_s ** np.array([0.0, 1.0, 3.0, 2.0])[: len(noise.terms)]
    slopes, variances = [], []
    for angle in segments:
        factor = (len(angle) - 1) // 3
        if factor < 1:
            continue
        second = angle[2 * factor :] - 2.0 * angle[factor:-factor] + angle[: -2 * factor]
        lags = np.arange(1 - len(second), len(second))
        between = _covariance_of_differences(factor, factor, lags, len(noise.terms))
        variance = (noise.mean_terms * powers) @ between @ (len(second) - np.abs(lags)) / len(second) ** 2
        slopes.append(second.mean() / (factor * interval_s) ** 2)
        variances.append(variance / (factor * interval_s) ** 4)
    weights = 1.0 / np.array(variances)
    return float(weights @ slopes / weights.sum()), float(weights.sum() ** -0.5)


def _solve(
    design: FloatArray, variance: FloatArray, errors: FloatArray, used: BoolArray
) -> tuple[FloatArray, FloatArray]:
    """Non-negative terms, and the matrix that computes the unbounded ones from the variances."""
    weight = 1.0 / np.sqrt(errors[used])
    weighted = design[used] * weight[:, np.newaxis]
    scale = np.sqrt((weighted**2).sum(axis=0))
    terms = nonnegative_least_squares(weighted / scale, variance[used] * weight)
    return terms / scale, np.linalg.pinv(weighted / scale) * weight / scale[:, np.newaxis]


def nonnegative_least_squares(design: FloatArray, values: FloatArray) -> FloatArray:
    """Least squares without negative terms: the best of the non-negative fits of all subsets of terms."""
    count = design.shape[1]
    is_free = np.indices((2,) * count).reshape(count, -1).T == 1
    normal, products = design.T @ design, design.T @ values
    are_both_free = is_free[:, :, np.newaxis] & is_free[:, np.newaxis, :]
    systems = np.where(are_both_free, normal, np.eye(count))
    terms = np.linalg.solve(systems, np.where(is_free, products, 0.0)[:, :, np.newaxis])[:, :, 0]
    explained = np.where((terms >= 0.0).all(axis=1), terms @ products, -1.0)
    return np.asarray(terms[np.argmax(explained)])


def _excess(
    variance: FloatArray, model: FloatArray, errors: FloatArray, used: BoolArray, terms: int
) -> float:
    """Common relative error with which chi-square of the residuals equals the degrees of freedom."""
    residual = ((variance - model) / model)[used] ** 2
    relative, dof = (errors / model**2)[used], np.count_nonzero(used) - terms
    if (residual / relative).sum() <= _MAX_CHI2_RATIO * dof:
        return 0.0
    low, high = 0.0, float(residual.sum() / dof)
    for _ in range(60):
        middle = 0.5 * (low + high)
        is_above = (residual / (relative + middle)).sum() > dof
        low, high = (middle, high) if is_above else (low, middle)
    return float(np.sqrt(high))


def _check_enough(used: BoolArray, allan: AllanVariance) -> None:
    if np.count_nonzero(used) < _TERMS + _SPARE_TIMES:
        raise MeasurementError(
            f"{np.count_nonzero(used)} averaging times out of {allan.tau_s[0]:g} to {allan.tau_s[-1]:g} s "
            f"have enough degrees of freedom for a noise fit; {_TERMS + _SPARE_TIMES} are needed. "
            "Record longer at rest"
        )


@dataclass(frozen=True, eq=False)
class _Information:
    """Expectation and covariance of Allan variances as functions of the noise terms."""

    design: FloatArray  #: Shape (k, terms). Expected variance for each term of size one.
    products: FloatArray  #: Shape (k, k, terms, terms). Quadratic form of the covariance in the terms.

    @classmethod
    def of(cls, allan: AllanVariance, terms: int) -> _Information:
        factors = tuple(allan.factors.tolist())
        design, products, full = _information(factors, allan.lengths, terms)
        powers = float(allan.interval_s) ** np.array([-2.0, -1.0, 1.0, 0.0])[:terms]
        # Missing samples cost differences; the remaining ones carry as much information each.
        thinning = np.sqrt(full / allan.counts)
        products = products * np.outer(thinning, thinning)[:, :, np.newaxis, np.newaxis]
        return cls(design * powers, products * np.outer(powers, powers))

    def covariance(self, terms: FloatArray) -> FloatArray:
        """Covariance (k, k) of the variances."""
        return np.asarray(self.products @ terms @ terms)


@lru_cache(maxsize=64)
def _information(
    factors: tuple[int, ...], lengths: tuple[int, ...], terms: int
) -> tuple[FloatArray, FloatArray, IntArray]:
    """Expectation (k, t) and covariance (k, k, t, t) at interval 1 s, and number of differences (k,)."""
    size = len(factors)
    different, repeats = np.unique(lengths, return_counts=True)
    numbers = _difference_counts(different, np.array(factors)[:, np.newaxis])
    full = np.asarray(numbers @ repeats, np.int64)
    design, products = np.empty((size, terms)), np.empty((size, size, terms, terms))
    for row, factor in enumerate(factors):
        for column in range(row, size):
            other = factors[column]
            # The covariance of flicker noise falls with the square of the lag; others end with the overlap.
            reach = _FLICKER_LAG_FACTOR * 2 * other if terms > _TERMS else 0
            lags = np.arange(-2 * other - reach, 2 * factor + reach + 1)
            between = _covariance_of_differences(factor, other, lags, terms)
            pairs = _pair_counts(numbers[row], numbers[column], lags)
            scale = 2.0 / (full[row] * full[column]) / (2.0 * factor * other) ** 2
            product = scale * (between * (pairs @ repeats)) @ between.T
            products[row, column] = products[column, row] = product
            if row == column:
                mean_squares = between @ pairs / np.maximum(numbers[row], 1)
                at_zero = between[:, len(lags) // 2] * full[row]
                design[row] = (at_zero - mean_squares @ repeats) / full[row] / (2.0 * factor**2)
    return design, products, full


def _difference_counts(lengths: IntArray, factor: IntArray) -> IntArray:
    """Number of second differences in segments; 0 for a single one, which has no deviation from its mean."""
    number = lengths - 2 * factor
    return np.asarray(np.where(number > 1, number, 0))


def _pair_counts(first: IntArray, second: IntArray, lags: IntArray) -> IntArray:
    """Number of pairs (lags, s) from two series of the given lengths (s,) at each lag."""
    lag = lags[:, np.newaxis]
    return np.asarray(np.maximum(np.minimum(first, second - lag) - np.maximum(0, -lag), 0))


def _covariance_of_differences(factor: int, other: int, lags: IntArray, terms: int) -> FloatArray:
    """Covariance (terms, lags) of second differences at two averaging times, for each term.

    From the generalised covariances of white noise, random walk, integrated random walk and integrated
    flicker noise; all but the last vanish beyond the lags at which the differences overlap.
    """
    taps = np.array([1.0, -2.0, 1.0])
    steps = np.arange(3)
    distance = np.abs(lags[:, np.newaxis, np.newaxis] + other * steps - factor * steps[:, np.newaxis])
    weight = np.outer(taps, taps)
    kernels = np.stack([distance == 0, -0.5 * distance, distance.astype(float) ** 3 / 12.0])
    if terms > _TERMS:
        flicker = distance**2 * np.log(np.maximum(distance, 1)) / (2.0 * np.pi)
        kernels = np.concatenate([kernels, flicker[np.newaxis]])
    return np.asarray((kernels * weight).sum(axis=(2, 3)))
