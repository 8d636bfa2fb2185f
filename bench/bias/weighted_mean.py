"""Measurements of one quantity: their mean, and whether their uncertainties explain the scatter."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtrc


@dataclass(frozen=True)
class WeightedMean:
    """Mean of independent values, weighted by 1/sigma^2.

    Attributes
    ----------
    value, sigma : float
        The mean and its standard uncertainty.
    chi2, freedom : float, int
        Scatter of the values in units of their uncertainties, and its expectation.
    """

    value: float
    sigma: float
    chi2: float
    freedom: int

    @property
    def chi2_reduced(self) -> float:
        """Near 1 where the uncertainties explain the scatter; NaN for a single value."""
        return self.chi2 / self.freedom if self.freedom else math.nan

    @property
    def p_value(self) -> float:
        """Probability of at least this scatter from the uncertainties alone; NaN for a single value."""
        return float(chdtrc(self.freedom, self.chi2)) if self.freedom else math.nan


def weighted_mean(values: Sequence[float], sigmas: Sequence[float]) -> WeightedMean:
    """Average values, at least one, whose standard uncertainties are known."""
    value, weight = np.asarray(values), np.asarray(sigmas) ** -2.0
    mean = float(weight @ value / weight.sum())
    return WeightedMean(
        mean, float(weight.sum() ** -0.5), float(weight @ (value - mean) ** 2), len(value) - 1
    )
