"""Values that scatter by more than their uncertainties say: how much more, and fits that allow for it.

Values are of ``y = X b + c + e``: known noise e of its own size in each value, and c, the same normal
distribution for all, whose variance is to be found. Its estimate is that of restricted maximum
likelihood, so that the degrees of freedom that b takes are allowed for.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq, minimize_scalar

from gyrobench.bench.foundations.arrays import FloatArray

#: Twice the likelihood that a 95 % interval of one number leaves on either side.
_DROP = 3.841
#: Variances are searched up to so many times the values' own.
_LARGEST_SHARE = 1e3


@dataclass(frozen=True, eq=False)
class WeightedFit:
    """Least squares with weights.

    Attributes
    ----------
    values : ndarray, shape (k,)
        The unknowns.
    covariance : ndarray, shape (k, k)
        Theirs, if the variances are right.
    chi2, freedom : float, int
        Sum of squares left, in units of the variances, and its expectation.
    """

    values: FloatArray
    covariance: FloatArray
    chi2: float
    freedom: int


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
    unknowns = covariance @ (weighted.T @ values)
    residuals = values - design @ unknowns
    chi2 = float(np.sum(residuals**2 / variances))
    return WeightedFit(unknowns, np.asarray(covariance), chi2, len(values) - design.shape[1])


def excess_variance(values: FloatArray, variances: FloatArray, design: FloatArray) -> float:
    """Variance by which values scatter beyond their own; zero where their own explain them.

    Parameters
    ----------
    values, variances : ndarray, shape (n,)
        Values and the known parts of their variances, above zero.
    design : ndarray, shape (n, k)
        Columns of what is fitted beside, of full rank.
    """
    if len(values) <= design.shape[1]:
        return 0.0
    criterion = _criterion(values, variances, design)
    largest = _largest(values, variances, design)
    # Over the logarithm: the likelihood is as wide there for small variances as for large ones.
    found = minimize_scalar(
        lambda log: criterion(np.exp(log)),
        bounds=(np.log(1e-4 * variances.min()), np.log(largest)),
        method="bounded",
        options={"xatol": 1e-2},
    )
    best = float(np.exp(found.x))
    return best if criterion(best) < criterion(0.0) else 0.0


def excess_sigma(values: FloatArray, variances: FloatArray, design: FloatArray) -> ExcessSigma:
    """Give :func:`excess_variance` as a standard deviation, with the interval of its likelihood.

    The interval holds the truth in about 95 % of cases; with few values it reaches far up.
    """
    best = excess_variance(values, variances, design)
    if len(values) <= design.shape[1]:
        return ExcessSigma(0.0, 0.0, float("inf"))
    criterion = _criterion(values, variances, design)
    limit = criterion(best) + _DROP
    largest = _largest(values, variances, design)

    def beyond(variance: float) -> float:
        return criterion(variance) - limit

    low = 0.0 if beyond(0.0) <= 0.0 else float(brentq(beyond, 0.0, best))
    high = float(brentq(beyond, best, largest)) if beyond(largest) > 0.0 else float("inf")
    return ExcessSigma(best**0.5, low**0.5, high**0.5)


def excess_information(variances: FloatArray, design: FloatArray) -> float:
    """How well values with these whole variances tell the part that all have: 1 over its variance."""
    weights = 1.0 / variances
    once, twice, thrice = (design.T @ (design * weights[:, np.newaxis] ** power) for power in (1, 2, 3))
    covariance = np.linalg.inv(once)
    mixed = covariance @ twice
    return 0.5 * float(np.sum(weights**2) - 2.0 * np.trace(covariance @ thrice) + np.trace(mixed @ mixed))


def restricted_deviance(values: FloatArray, variances: FloatArray, design: FloatArray) -> float:
    """Minus twice the restricted log-likelihood of known variances, but for a constant.

    Differences between variances for the same values and design compare these.
    """
    fit = weighted_fit(values, variances, design)
    _, log_determinant = np.linalg.slogdet(fit.covariance)
    return float(np.sum(np.log(variances)) - log_determinant + fit.chi2)


def _criterion(values: FloatArray, variances: FloatArray, design: FloatArray) -> Callable[[float], float]:
    """Deviance as a function of a variance added to all."""
    return lambda added: restricted_deviance(values, variances + added, design)


def _largest(values: FloatArray, variances: FloatArray, design: FloatArray) -> float:
    residuals = values - design @ np.linalg.lstsq(design, values, rcond=None)[0]
    return _LARGEST_SHARE * float(np.mean(residuals**2) + variances.max())
