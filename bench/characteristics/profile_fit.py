"""Least squares with one nonlinear parameter on a grid.

For each value of the nonlinear parameter (a time constant, a width) the other coefficients are linear. The
likelihood of the values, each with its best coefficients, weighs them; draws take a value by its weight and
coefficients from the normal distribution of its fit. Quantities that follow from all of these get their
intervals from the draws, also where they are no linear function of the coefficients. The grid is refined
where the weight is: intervals from a few points that carry all of it would be too narrow.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gyrobench.bench.bias.dwell_table import DwellRow
from gyrobench.bench.bias.error_split import SharedErrors
from gyrobench.bench.foundations.arrays import BoolArray, FloatArray, IntArray
from gyrobench.bench.foundations.errors import MeasurementError

_DRAWS = 2000
#: Normal equations with a larger condition number do not separate their coefficients.
_MAX_CONDITION = 1e12
_TINY = 1e-300
#: A point of a grid with a larger share of the weight gets closer neighbours, in at most so many rounds.
_MAX_SHARE, MAX_REFINEMENTS = 0.05, 16


@dataclass(frozen=True, eq=False)
class ProfileFit:
    """The best of several linear fits to the same values, and draws over all of them."""

    best: int  #: Index of the best design.
    coefficients: FloatArray  #: Shape (k,). Its coefficients.
    fitted: FloatArray  #: Shape (n,). Values of the best fit.
    weights: FloatArray  #: Shape (d,). Of each design; they add up to 1.
    deviance: (
        FloatArray  #: Shape (d,). chi2 of each design with its penalty, relative to the best, over scale^2.
    )
    scale: float  #: Factor on the standard uncertainties that explains the scatter; 1 or more.
    designs: IntArray  #: Shape (m,). Index of the design of each draw.
    draws: FloatArray  #: Shape (m, k). Coefficients of each draw.
    shared: FloatArray  #: Shape (m, s). Shared errors of each draw, in standard uncertainties.


def profile_fit(
    values: FloatArray,
    sigmas: FloatArray,
    designs: FloatArray,
    penalties: FloatArray | None = None,
    shared: FloatArray | None = None,
    shares: FloatArray | None = None,
) -> ProfileFit:
    """Fit values (n,) with standard uncertainties (n,) by each of the designs (d, n, k).

    A design lacks a coefficient whose column is zero. ``penalties`` (d,) are added to each design's chi2 in
    comparisons. ``shared`` (n, s): errors of all values by one standard uncertainty of each of s sources,
    part of ``sigmas``. ``shares`` (d,): part of the nonlinear parameter's range that each design stands for;
    by default all stand for the same. Raises MeasurementError if there are too few values, or no design
    separates its coefficients.
    """
    count, size = designs.shape[1:]
    dof = count - size - 1
    if dof < 1:
        raise MeasurementError(
            f"{count} dwells without flags are too few for {count - dof} parameters. Measure more dwells"
        )
    if shared is not None:
        values, sigmas, designs = _with_shared(values, sigmas, designs, shared)
    white, target = designs / sigmas[:, np.newaxis], values / sigmas
    inverse, shrink, separable = _inverse_normal(white)
    covariance = inverse * shrink[:, :, None] * shrink[:, None]
    solved = (covariance @ (np.swapaxes(white, 1, 2) @ target)[:, :, None])[:, :, 0]
    chi2 = ((target - (white @ solved[:, :, None])[:, :, 0]) ** 2).sum(axis=1)
    deviance = np.where(separable, chi2 if penalties is None else chi2 + penalties, np.inf)
    best = int(np.argmin(deviance))
    scale = float(np.sqrt(max(1.0, chi2[best] / dof)))
    relative = (deviance - deviance[best]) / scale**2
    weights = np.exp(-0.5 * relative) * (1.0 if shares is None else shares)
    weights /= weights.sum()
    random = np.random.default_rng(0)  # the same data give the same intervals
    chosen = np.sort(random.choice(len(designs), _DRAWS, p=weights))
    normal = scale * random.standard_normal((_DRAWS, designs.shape[2], 1))
    places, of_place = np.unique(chosen, return_inverse=True)
    roots = shrink[places][:, :, None] * np.linalg.cholesky(inverse[places])
    draws = solved[chosen] + (roots[of_place] @ normal)[:, :, 0]
    coefficients = solved[best, :size]
    return ProfileFit(
        best,
        coefficients,
        designs[best, :count, :size] @ coefficients,
        weights,
        relative,
        scale,
        chosen,
        *np.split(draws, [size], 1),
    )


def _with_shared(
    values: FloatArray, sigmas: FloatArray, designs: FloatArray, shared: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Values (n + s,), uncertainties (n + s,) and designs (d, n + s, k + s).

    Shared errors are further parameters, each known to be 0 ± 1.
    """
    size, sources = designs.shape[2], shared.shape[1]
    extended = np.zeros((len(designs), len(values) + sources, size + sources))
    extended[:, : len(values), :size] = designs
    extended[:, : len(values), size:] = shared
    extended[:, len(values) :, size:] = np.eye(sources)
    own = np.sqrt(np.maximum(sigmas**2 - (shared**2).sum(axis=1), _TINY))
    return np.append(values, np.zeros(sources)), np.append(own, np.ones(sources)), extended


def _inverse_normal(white: FloatArray) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Inverse (d, k, k) of the normal matrices of designs (d, n, k) with columns of unit size.

    And the inverse sizes of the columns (d, k), and which designs (d,) separate their coefficients; the
    inverse of others is zero. Raises MeasurementError if none does.
    """
    sizes = np.sqrt((white**2).sum(axis=1))
    # A coefficient that is lacking is zero for sure: one on the diagonal, and no size.
    normal = np.swapaxes(white, 1, 2) @ white / np.maximum(sizes[:, :, None] * sizes[:, None], _TINY)
    normal = np.where(sizes[:, :, None] > 0.0, normal, np.eye(white.shape[2]))
    spread = np.linalg.eigvalsh(normal)
    separable = spread[:, 0] * _MAX_CONDITION > spread[:, -1]
    if not separable.any():
        raise MeasurementError(
            "the dwells do not separate the coefficients of this test. Vary what they depend on: "
            "temperature, its rate and direction, time since power-on"
        )
    inverse = np.zeros_like(normal)
    inverse[separable] = np.linalg.inv(normal[separable])
    return inverse, np.where(sizes > 0.0, 1.0 / np.maximum(sizes, _TINY), 0.0), separable


def cells(grid: FloatArray) -> FloatArray:
    """Part of the range (g,) that each point of an increasing grid stands for: half way to its neighbours."""
    edges = np.concatenate([grid[:1], 0.5 * (grid[1:] + grid[:-1]), grid[-1:]])
    return np.diff(edges)


def refined(grid: FloatArray, weights: FloatArray) -> FloatArray:
    """The grid (g,) with points half way to the neighbours of those whose weights (g,) are large."""
    is_heavy = weights > _MAX_SHARE
    between = is_heavy[1:] | is_heavy[:-1]
    return np.sort(np.append(grid, 0.5 * (grid[1:] + grid[:-1])[between]))


def indicators(groups: Sequence[object]) -> FloatArray:
    """Columns (n, g) of ones and zeros, one for each different group in the order of appearance."""
    names = list(dict.fromkeys(groups))
    return np.array([[float(group == name) for name in names] for group in groups])


def shared_by(shared: SharedErrors, rows: Sequence[DwellRow], axis: int) -> FloatArray | None:
    """Errors (n, s) of a gyro in these dwells by each source that they share; None without any."""
    return np.array([shared[row.dwell][axis] for row in rows]) if shared else None
