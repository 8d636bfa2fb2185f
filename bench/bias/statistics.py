"""Least squares, weighted means, excess scatter and statistical tests for all estimates.

* :func:`solve` solves white rows with prior knowledge of the parameters; :func:`chi2_test` tests the
  residuals, :func:`chi2_p_value` any sum of squares.
* :func:`weighted_mean` averages independent values and tests whether their uncertainties explain the scatter.
* :func:`excess_variance` estimates the scatter of values beyond their uncertainties: values are modelled as
  ``y = X b + c + e``, with noise e of known variance in each value and c of one normal distribution for all.
  The variance of c is estimated by restricted maximum likelihood, which allows for the degrees of freedom of
  b.
* :func:`holm` corrects p-values for multiple comparisons; :func:`uniformity_p_value` tests whether
  p-values are uniform (Kolmogorov-Smirnov).

Functions that every run needs do without scipy, whose modules take 0.3 s and 50 MB to import.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from gyrobench.bench.foundations.arrays import FloatArray

#: A polynomial gets one more degree if the p-value of its residuals is smaller.
_MIN_P_VALUE = 0.01

#: Terms of the continued fraction: enough for some ten thousand degrees of freedom.
_BETA_TERMS = 100
#: Combinations of residuals with a smaller share of the variance of the data are left out of a test.
_MIN_VARIANCE = 1e-3


def solve(rows: FloatArray, data: FloatArray, prior_root: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Solve white rows for the parameters (p,) and their covariance (p, p).

    ``rows`` (n, p), ``data`` (n,): response of each datum to the parameters, and the data, both in standard
    deviations; ``prior_root`` (p, k): root ``L`` of the prior covariance ``L @ L.T``. The problem is solved
    for its k independent components, so parameters may depend on one another or be known exactly.
    """
    count, root = prior_root.shape[1], _triangular_root(rows, data, prior_root)
    spread = prior_root @ np.linalg.inv(root[:count, :count])
    return spread @ root[:count, count], spread @ spread.T


def least_chi2(rows: FloatArray, data: FloatArray, prior_root: FloatArray) -> float:
    """Sum of squares of residuals and of parameters about their prior, at the solution of :func:`solve`."""
    count = prior_root.shape[1]
    return float((_triangular_root(rows, data, prior_root)[count:, count] ** 2).sum())


def _triangular_root(rows: FloatArray, data: FloatArray, prior_root: FloatArray) -> FloatArray:
    number, count = len(rows), prior_root.shape[1]
    stacked = np.zeros((number + count, count + 1))
    stacked[:number, :count], stacked[:number, count] = rows @ prior_root, data
    stacked[number:].flat[:: count + 2] = 1.0
    return compress(stacked)


def compress(rows: FloatArray) -> FloatArray:
    """Fewest rows with the same normal equations as these (n, c); at most c of them."""
    return np.asarray(np.linalg.qr(rows, mode="r")) if len(rows) > rows.shape[1] else rows


@dataclass(frozen=True)
class Chi2Test:
    """Sum of squares of residuals weighted by their covariance, its expectation, and its probability."""

    chi2: float
    dof: int
    p_value: float

    @property
    def ratio(self) -> float:
        """Root mean square of the residuals, relative to the expected one."""
        return math.sqrt(self.chi2 / self.dof) if self.dof else math.nan


def chi2_test(residuals: FloatArray, rows: FloatArray, covariance: FloatArray) -> Chi2Test:
    """Test the residuals of white data.

    ``residuals`` (n,): data minus the prediction of the estimate; ``rows`` (n, p): response of the data to
    the parameters; ``covariance`` (p, p): of the estimate, from these data or from the data of which these
    are sums.
    """
    variances, directions = np.linalg.eigh(np.eye(len(residuals)) - rows @ covariance @ rows.T)
    free = variances > _MIN_VARIANCE
    chi2 = float(((residuals @ directions[:, free]) ** 2 / variances[free]).sum())
    dof = int(free.sum())
    return Chi2Test(chi2, dof, chi2_p_value(dof, chi2))


def chi2_p_value(dof: int, chi2: float) -> float:
    """Probability of at least this sum of ``dof`` squares (Abramowitz and Stegun, 26.4.4 and 26.4.5)."""
    if chi2 <= 0.0:
        return 1.0  # also without degrees of freedom
    half = float(np.clip(0.5 * chi2, 1e-300, 1e300))
    odd = dof % 2
    # Each term is the one before it times half / power.
    logs = np.log(half / np.arange(1.0 + 0.5 * odd, max(0.5 * dof, 1.0)))
    first = odd * (0.5 * math.log(half) - math.lgamma(1.5)) - half
    terms = np.exp(first + np.concatenate([[0.0], np.cumsum(logs)])[: dof // 2])
    return min(odd * math.erfc(math.sqrt(half)) + float(terms.sum()), 1.0)


def f_p_value(dof: float, residual_dof: float, ratio: float) -> float:
    """Probability of at least this ratio of the mean of ``dof`` squares to that of ``residual_dof``."""
    a, b = 0.5 * residual_dof, 0.5 * dof
    x, y = residual_dof / (residual_dof + dof * ratio), dof * ratio / (residual_dof + dof * ratio)
    if x <= (a + 1.0) / (a + b + 2.0):  # where the fraction converges fast
        return _incomplete_beta(x, y, a, b)
    return 1.0 - _incomplete_beta(y, x, b, a)


def _incomplete_beta(x: float, y: float, a: float, b: float) -> float:
    """Regularised incomplete beta function by its continued fraction (DLMF 8.17.22); y is 1 - x."""
    if x <= 0.0:
        return 0.0
    fraction = 1.0
    for m in range(_BETA_TERMS, -1, -1):
        even = (m + 1) * (b - m - 1) * x / ((a + 2 * m + 1) * (a + 2 * m + 2))
        odd = -(a + m) * (a + b + m) * x / ((a + 2 * m) * (a + 2 * m + 1))
        fraction = 1.0 + odd / (1.0 + even / fraction)
    log_front = a * math.log(x) + b * math.log(y) + math.lgamma(a + b) - math.lgamma(a) - math.lgamma(b)
    return math.exp(log_front) / (a * fraction)


def lowest_polynomial(
    x: FloatArray, values: FloatArray, sigmas: FloatArray, max_degree: int
) -> np.polynomial.Polynomial:
    """Polynomial of the lowest degree, up to ``max_degree``, whose residuals have a p-value above 1 %."""
    for degree in range(max_degree + 1):
        fitted = np.polynomial.Polynomial.fit(x, values, degree, w=1.0 / sigmas)
        chi2 = float(np.sum(((values - fitted(x)) / sigmas) ** 2))
        if degree == max_degree or chi2_p_value(len(values) - degree - 1, chi2) >= _MIN_P_VALUE:
            break
    return fitted


@dataclass(frozen=True)
class WeightedMean:
    """Mean of independent values, weighted by 1/sigma^2."""

    #: value, sigma: The mean and its standard uncertainty.
    value: float
    sigma: float
    #: chi2, dof: Scatter of the values in units of their uncertainties, and its degrees of freedom.
    chi2: float
    dof: int

    @property
    def chi2_reduced(self) -> float:
        """Reduced chi-square: near 1 if the uncertainties explain the scatter; NaN for a single value."""
        return self.chi2 / self.dof if self.dof else math.nan

    @property
    def p_value(self) -> float:
        """Probability of at least this scatter if due only to the uncertainties; NaN for a single value."""
        return chi2_p_value(self.dof, self.chi2) if self.dof else math.nan


def weighted_mean(values: Sequence[float], sigmas: Sequence[float]) -> WeightedMean:
    """Average values, at least one, whose standard uncertainties are known."""
    value, weight = np.asarray(values), np.asarray(sigmas) ** -2.0
    mean = float(weight @ value / weight.sum())
    return WeightedMean(
        mean, float(weight.sum() ** -0.5), float(weight @ (value - mean) ** 2), len(value) - 1
    )


def indicator_columns(groups: Sequence[object]) -> FloatArray:
    """Columns (n, g) of ones and zeros, one for each distinct group in the order of appearance."""
    numbers = {group: number for number, group in enumerate(dict.fromkeys(groups))}
    return np.asarray(np.eye(len(numbers))[np.array([numbers[each] for each in groups], dtype=int)])


#: Rise of the deviance at the ends of a 95 % interval of one number.
_DEVIANCE_95 = 3.841
#: Variances are searched up to this multiple of those of the values.
_MAX_VARIANCE_RATIO = 1e3


@dataclass(frozen=True, eq=False)
class WeightedFit:
    """Least squares with weights."""

    values: FloatArray  #: Shape (k,). The parameters.
    covariance: FloatArray  #: Shape (k, k). Covariance of the parameters, if the variances are correct.
    #: chi2, dof: Weighted sum of squared residuals, and its degrees of freedom.
    chi2: float
    dof: int


@dataclass(frozen=True)
class ExcessSigma:
    """Scatter beyond the stated uncertainties: standard deviation with its 95 % interval."""

    value: float
    low: float
    high: float


def weighted_fit(values: FloatArray, variances: FloatArray, design: FloatArray) -> WeightedFit:
    """Fit values (n,) with known variances (n,) by the columns of a design (n, k) of full rank."""
    weighted = design / variances[:, np.newaxis]
    covariance = np.linalg.inv(design.T @ weighted)
    parameters = covariance @ (weighted.T @ values)
    residuals = values - design @ parameters
    chi2 = float(np.sum(residuals**2 / variances))
    return WeightedFit(parameters, np.asarray(covariance), chi2, len(values) - design.shape[1])


def excess_variance(values: FloatArray, variances: FloatArray, design: FloatArray) -> float:
    """Variance of the scatter of values beyond their own variances; zero if these explain the scatter.

    ``values``, ``variances`` (n,): values and the known parts of their variances, above zero. ``design`` (n,
    k): columns of the parameters b, of full rank.
    """
    from scipy.optimize import minimize_scalar

    if len(values) <= design.shape[1]:
        return 0.0
    deviance = _deviance_function(values, variances, design)
    max_variance = _max_variance(values, variances, design)
    # Over the logarithm, in which the likelihood is equally wide for small and large variances.
    minimum = minimize_scalar(
        lambda log: deviance(np.exp(log)),
        bounds=(np.log(1e-4 * variances.min()), np.log(max_variance)),
        method="bounded",
        options={"xatol": 1e-2},
    )
    best = float(np.exp(minimum.x))
    return best if deviance(best) < deviance(0.0) else 0.0


def excess_sigma(values: FloatArray, variances: FloatArray, design: FloatArray) -> ExcessSigma:
    """Estimate :func:`excess_variance` as a standard deviation, with the interval of its likelihood.

    The interval contains the true value in about 95 % of cases; with few values its upper end is high.
    """
    from scipy.optimize import brentq

    best = excess_variance(values, variances, design)
    if len(values) <= design.shape[1]:
        return ExcessSigma(0.0, 0.0, float("inf"))
    deviance = _deviance_function(values, variances, design)
    limit = deviance(best) + _DEVIANCE_95
    max_variance = _max_variance(values, variances, design)

    def above_limit(variance: float) -> float:
        return deviance(variance) - limit

    low = 0.0 if above_limit(0.0) <= 0.0 else float(brentq(above_limit, 0.0, best))
    high = float(brentq(above_limit, best, max_variance)) if above_limit(max_variance) > 0.0 else float("inf")
    return ExcessSigma(best**0.5, low**0.5, high**0.5)


def excess_information(variances: FloatArray, design: FloatArray) -> float:
    """Fisher information on a variance that all values have in common, given their total variances."""
    weights = 1.0 / variances
    order_1, order_2, order_3 = (design.T @ (design * weights[:, np.newaxis] ** power) for power in (1, 2, 3))
    covariance = np.linalg.inv(order_1)
    mixed = covariance @ order_2
    return 0.5 * float(np.sum(weights**2) - 2.0 * np.trace(covariance @ order_3) + np.trace(mixed @ mixed))


def restricted_deviance(values: FloatArray, variances: FloatArray, design: FloatArray) -> float:
    """Minus twice the restricted log-likelihood of known variances, up to a constant.

    Its differences compare variances for the same values and design.
    """
    fit = weighted_fit(values, variances, design)
    _, log_determinant = np.linalg.slogdet(fit.covariance)
    return float(np.sum(np.log(variances)) - log_determinant + fit.chi2)


def _deviance_function(
    values: FloatArray, variances: FloatArray, design: FloatArray
) -> Callable[[float], float]:
    """Deviance as a function of a variance that is added to all variances."""
    return lambda added: restricted_deviance(values, variances + added, design)


def _max_variance(values: FloatArray, variances: FloatArray, design: FloatArray) -> float:
    residuals = values - design @ np.linalg.lstsq(design, values, rcond=None)[0]
    return _MAX_VARIANCE_RATIO * float(np.mean(residuals**2) + variances.max())


def holm(p_values: Sequence[float]) -> FloatArray:
    """Correct p-values for multiple comparisons (Holm): the family-wise error stays below the level.

    It holds whether or not the comparisons depend on one another. NaN stays and is not counted.
    """
    given = np.asarray(p_values, dtype=np.float64)
    finite = np.flatnonzero(~np.isnan(given))
    order = finite[np.argsort(given[finite], kind="stable")]
    counts = np.arange(len(order), 0, -1)
    adjusted = np.full(len(given), np.nan)
    adjusted[order] = np.minimum(np.maximum.accumulate(counts * given[order]), 1.0)
    return adjusted


def uniformity_p_value(p_values: Sequence[float]) -> float:
    """Probability that uniform p-values, at least one, deviate at least as much from a uniform distribution.

    Twice the exact one-sided probability, which is accurate if it is small, and else an upper limit.
    """
    count, ordered = len(p_values), np.sort(p_values)
    steps = np.arange(count + 1) / count
    distance = max(np.max(steps[1:] - ordered), np.max(ordered - steps[:-1]))
    return min(1.0, 2.0 * _smirnov(count, float(distance)))


def uniformity_band(count: int, probability: float = 0.95) -> float:
    """Largest deviation of the distribution of ``count`` p-values from uniform, with this probability."""
    low, high = 0.0, 1.0
    while (middle := 0.5 * (low + high)) not in (low, high):
        if _smirnov(count, middle) > 0.5 * (1.0 - probability):
            low = middle
        else:
            high = middle
    return high


def _smirnov(count: int, distance: float) -> float:
    """Probability of a one-sided Smirnov distance of ``count`` values (Birnbaum and Tingey, 1951)."""
    if not 0.0 < distance < 1.0:
        return float(distance <= 0.0)
    counts_above = np.arange(math.floor(count * (1.0 - distance)) + 1)
    share = distance + counts_above / count
    complement = np.maximum(1.0 - share, np.finfo(float).tiny)
    log_binomials = np.concatenate([[0.0], np.cumsum(np.log((count - counts_above[:-1]) / counts_above[1:]))])
    logs = log_binomials + (counts_above - 1) * np.log(share) + (count - counts_above) * np.log(complement)
    return distance * float(np.exp(logs).sum())
