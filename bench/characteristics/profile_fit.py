"""Least squares with one nonlinear parameter on a grid: the best fit, and draws for intervals.

For each value of the nonlinear parameter (a time constant, a width) the other coefficients are linear. The
likelihood of the values, each with its best coefficients, weighs them; draws take a value by its weight and
coefficients from the normal distribution of its fit. Quantities that follow from all of these get their
intervals from the draws, also where they are no linear function of the coefficients.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gyrobench.bench.foundations.arrays import FloatArray, IntArray
from gyrobench.bench.foundations.errors import MeasurementError

_DRAWS = 2000
#: Normal equations with a larger condition number do not separate their coefficients.
_MAX_CONDITION = 1e12
_TINY = 1e-300


@dataclass(frozen=True, eq=False)
class ProfileFit:
    """The best of several linear fits to the same values, and draws over all of them."""

    best: int  #: Index of the best design.
    coefficients: FloatArray  #: Shape (k,). Its coefficients.
    fitted: FloatArray  #: Shape (n,). Values of the best fit.
    scale: float  #: Factor on the standard uncertainties that explains the scatter; 1 or more.
    designs: IntArray  #: Shape (m,). Index of the design of each draw.
    draws: FloatArray  #: Shape (m, k). Coefficients of each draw.


def profile_fit(
    values: FloatArray, sigmas: FloatArray, designs: FloatArray, penalties: FloatArray | None = None
) -> ProfileFit:
    """Fit values (n,) with standard uncertainties (n,) by each of the designs (d, n, k).

    A design lacks a coefficient whose column is zero. ``penalties`` (d,) are added to each design's chi2 in
    comparisons. Raises MeasurementError if there are too few values, or no design separates its coefficients.
    """
    dof = len(values) - designs.shape[2] - 1
    if dof < 1:
        raise MeasurementError(
            f"{len(values)} dwells without flags are too few for {len(values) - dof} unknowns. "
            "Measure more dwells"
        )
    white, target = designs / sigmas[:, np.newaxis], values / sigmas
    sizes = np.sqrt((white**2).sum(axis=1))
    unit = np.eye(designs.shape[2])
    # A coefficient that is lacking is zero for sure: one on the diagonal, and no size.
    normal = np.swapaxes(white, 1, 2) @ white / np.maximum(sizes[:, :, None] * sizes[:, None], _TINY)
    normal = np.where(sizes[:, :, None] > 0.0, normal, unit)
    spread = np.linalg.eigvalsh(normal)
    separable = spread[:, 0] * _MAX_CONDITION > spread[:, -1]
    if not separable.any():
        raise MeasurementError(
            "the dwells do not separate the coefficients of this test. Vary what they depend on: "
            "temperature, its rate and direction, time since power-on"
        )
    inverse = np.zeros_like(normal)
    inverse[separable] = np.linalg.inv(normal[separable])
    shrink = np.where(sizes > 0.0, 1.0 / np.maximum(sizes, _TINY), 0.0)
    covariance = inverse * shrink[:, :, None] * shrink[:, None]
    solved = (covariance @ (np.swapaxes(white, 1, 2) @ target)[:, :, None])[:, :, 0]
    chi2 = ((target - (white @ solved[:, :, None])[:, :, 0]) ** 2).sum(axis=1)
    deviance = np.where(separable, chi2 if penalties is None else chi2 + penalties, np.inf)
    best = int(np.argmin(deviance))
    scale = float(np.sqrt(max(1.0, chi2[best] / dof)))
    weights = np.exp(-0.5 * (deviance - deviance[best]) / scale**2)
    random = np.random.default_rng(0)  # the same data give the same intervals
    chosen = np.sort(random.choice(len(designs), _DRAWS, p=weights / weights.sum()))
    draws = scale * random.standard_normal((_DRAWS, len(unit)))
    for index in np.unique(chosen):
        rows = chosen == index
        root = np.linalg.cholesky(inverse[index]) * shrink[index][:, None]
        draws[rows] = solved[index] + draws[rows] @ root.T
    return ProfileFit(best, solved[best], designs[best] @ solved[best], scale, chosen, draws)


def indicators(groups: Sequence[object]) -> FloatArray:
    """Columns (n, g) of ones and zeros, one for each different group in the order of appearance."""
    names = list(dict.fromkeys(groups))
    return np.array([[float(group == name) for name in names] for group in groups])
