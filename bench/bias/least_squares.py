"""Least squares of white rows with prior knowledge of the unknowns."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import chdtrc

from gyrobench.bench.foundations.arrays import FloatArray

#: Combinations of data whose variance the estimate leaves less of than this test nothing.
_LEAST_VARIANCE = 1e-3


def solve(rows: FloatArray, data: FloatArray, prior_root: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Unknowns (p,) and their covariance (p, p).

    Parameters
    ----------
    rows : ndarray, shape (n, p)
        Response of each datum to the unknowns, in standard deviations.
    data : ndarray, shape (n,)
        The data, in standard deviations.
    prior_root : ndarray, shape (p, k)
        Root ``L`` of the prior covariance ``L @ L.T``; its k independent causes are solved for, so
        unknowns may be tied to one another or known exactly.
    """
    count = prior_root.shape[1]
    stacked = np.block([[rows @ prior_root, data[:, np.newaxis]], [np.eye(count), np.zeros((count, 1))]])
    root = compress(stacked)
    spread = prior_root @ np.linalg.inv(root[:count, :count])
    return spread @ root[:count, count], spread @ spread.T


def compress(rows: FloatArray) -> FloatArray:
    """Fewest rows with the same normal equations as these (n, c); at most c of them."""
    return np.asarray(np.linalg.qr(rows, mode="r")) if len(rows) > rows.shape[1] else rows


@dataclass(frozen=True)
class Misfit:
    """Sum of squares of residuals weighted by their covariance, its expectation, and its probability."""

    chi2: float
    freedom: int
    p_value: float


def misfit(residuals: FloatArray, rows: FloatArray, covariance: FloatArray) -> Misfit:
    """Test what an estimate leaves of white data.

    Parameters
    ----------
    residuals : ndarray, shape (n,)
        Data less what the estimate explains.
    rows : ndarray, shape (n, p)
        Response of the data to the unknowns.
    covariance : ndarray, shape (p, p)
        Of the estimate, made from these data, or from data that these are sums of.
    """
    variances, directions = np.linalg.eigh(np.eye(len(residuals)) - rows @ covariance @ rows.T)
    free = variances > _LEAST_VARIANCE
    chi2 = float(((residuals @ directions[:, free]) ** 2 / variances[free]).sum())
    freedom = int(free.sum())
    return Misfit(chi2, freedom, float(chdtrc(freedom, chi2)))
