"""Test whether the model explains the data of a dwell.

A wrong model leaves residuals that are slow, so the innovations are summed minute by minute: what
is white stays at one standard deviation, what is slow grows with the number of epochs summed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from gyrobench.bench.bias.least_squares import misfit
from gyrobench.bench.foundations.arrays import FloatArray


@dataclass(frozen=True, eq=False)
class FitTest:
    """Chi-square test of the innovations.

    Attributes
    ----------
    time_s : ndarray, shape (m,)
        Middle of each minute on the clock of the INS.
    residuals : ndarray, shape (m, 3)
        Innovations of velocity East and North and of the heading summed over the minute, in
        standard deviations of the sum; what the estimate explains is taken away.
    chi2, freedom : float, int
        Their sum of squares weighted by their covariance, and its expectation.
    p_value : float
        Probability of at least this misfit if model and noise are true.
    """

    time_s: FloatArray
    residuals: FloatArray
    chi2: float
    freedom: int
    p_value: float

    @property
    def ratio(self) -> float:
        """Size of the residuals over the expected one."""
        return math.sqrt(self.chi2 / self.freedom) if self.freedom else math.nan


def fit_test(
    time_s: FloatArray,
    sums: FloatArray,
    responses: FloatArray,
    unknowns: FloatArray,
    covariance: FloatArray,
) -> FitTest:
    """Test the sums of innovations against an estimate made from the same data.

    Parameters
    ----------
    time_s : ndarray, shape (m,)
        Middle of each minute.
    sums : ndarray, shape (m, 3)
        White, with unit variance.
    responses : ndarray, shape (m, 3, p)
        Of the sums to the unknowns.
    unknowns, covariance : ndarray, shape (p,), (p, p)
        The estimate.
    """
    response = responses.reshape(-1, len(unknowns))
    residuals = sums.ravel() - response @ unknowns
    left = misfit(residuals, response, covariance)
    return FitTest(time_s, residuals.reshape(-1, 3), left.chi2, left.freedom, left.p_value)
