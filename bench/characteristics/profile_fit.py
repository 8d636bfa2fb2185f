"""Least squares with one nonlinear parameter on a grid.

For each value of the nonlinear parameter (a time constant, a width) the other coefficients are linear. Each
value has the weight of its likelihood with the best coefficients. Draws select a value by its weight, and
coefficients from the normal distribution of its fit. Intervals of derived quantities are quantiles over the
draws, so these may be nonlinear functions of the coefficients. The grid is refined at points with much
weight, since intervals from few points would be too narrow.
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
#: Largest weight of a grid point without refinement next to it, and largest number of refinements.
_MAX_WEIGHT, MAX_REFINEMENTS = 0.05, 16


@dataclass(frozen=True, eq=False)
class ProfileFit:
    """The best of several linear fits to the same values, and draws over all of them."""

    best: int  #: Index of the best design.
    coefficients: FloatArray  #: Shape (k,). Coefficients of the best design.
    fitted: FloatArray  #: Shape (n,). Values of the best fit.
    weights: FloatArray  #: Shape (d,). Of each design; they add up to 1.
    #: Shape (d,). chi2 of each design with its penalty, relative to the best, over scale^2.
    deviance: FloatArray
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

    A column of zeros means that a design does not have the coefficient. ``penalties`` (d,) are added to each
    design's chi2 in comparisons. ``shared`` (n, s): errors of all values for one standard uncertainty of each
    of s sources, included in ``sigmas``. ``shares`` (d,): part of the nonlinear parameter's range that each
    design represents; default: equal. Raises MeasurementError if there are too few values, or no design
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
    white, white_values = designs / sigmas[:, np.newaxis], values / sigmas
    inverse, inverse_sizes, separable = _inverse_normal(white)
    covariance = inverse * inverse_sizes[:, :, None] * inverse_sizes[:, None]
    solutions = (covariance @ (np.swapaxes(white, 1, 2) @ white_values)[:, :, None])[:, :, 0]
    chi2 = ((white_values - (white @ solutions[:, :, None])[:, :, 0]) ** 2).sum(axis=1)
    deviance = np.where(separable, chi2 if penalties is None else chi2 + penalties, np.inf)
    best = int(np.argmin(deviance))
    scale = float(np.sqrt(max(1.0, chi2[best] / dof)))
    relative = (deviance - deviance[best]) / scale**2
    weights = np.exp(-0.5 * relative) * (1.0 if shares is None else shares)
    weights /= weights.sum()
    random = np.random.default_rng(0)  # so that the same data give the same intervals
    drawn_designs = np.sort(random.choice(len(designs), _DRAWS, p=weights))
    normal = scale * random.standard_normal((_DRAWS, designs.shape[2], 1))
    distinct, distinct_index = np.unique(drawn_designs, return_inverse=True)
    roots = inverse_sizes[distinct][:, :, None] * np.linalg.cholesky(inverse[distinct])
    draws = solutions[drawn_designs] + (roots[distinct_index] @ normal)[:, :, 0]
    coefficients = solutions[best, :size]
    return ProfileFit(
        best,
        coefficients,
        designs[best, :count, :size] @ coefficients,
        weights,
        relative,
        scale,
        drawn_designs,
        *np.split(draws, [size], 1),
    )


def _with_shared(
    values: FloatArray, sigmas: FloatArray, designs: FloatArray, shared: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Add shared errors as parameters, each with a prior of 0 ± 1.

    Returns values (n + s,), uncertainties (n + s,) and designs (d, n + s, k + s).
    """
    size, sources = designs.shape[2], shared.shape[1]
    extended = np.zeros((len(designs), len(values) + sources, size + sources))
    extended[:, : len(values), :size] = designs
    extended[:, : len(values), size:] = shared
    extended[:, len(values) :, size:] = np.eye(sources)
    own_sigmas = np.sqrt(np.maximum(sigmas**2 - (shared**2).sum(axis=1), _TINY))
    return np.append(values, np.zeros(sources)), np.append(own_sigmas, np.ones(sources)), extended


def _inverse_normal(white: FloatArray) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Inverse (d, k, k) of the normal matrices of designs (d, n, k) with columns scaled to unit size.

    Also returns the inverse sizes of the columns (d, k), and a mask (d,) of the designs that separate their
    coefficients; the inverse of others is zero. Raises MeasurementError if none does.
    """
    sizes = np.sqrt((white**2).sum(axis=1))
    # A coefficient that a design does not have is exactly zero: 1 on the diagonal, and inverse size 0.
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


def cell_widths(grid: FloatArray) -> FloatArray:
    """Widths (g,) of the cells of an increasing grid, which extend half way to the neighbouring points."""
    edges = np.concatenate([grid[:1], 0.5 * (grid[1:] + grid[:-1]), grid[-1:]])
    return np.diff(edges)


def refine(grid: FloatArray, weights: FloatArray) -> FloatArray:
    """Grid (g,) with additional points half way to the neighbours of points with large weights (g,)."""
    is_heavy = weights > _MAX_WEIGHT
    is_refined = is_heavy[1:] | is_heavy[:-1]
    return np.sort(np.append(grid, 0.5 * (grid[1:] + grid[:-1])[is_refined]))


def shared_error_columns(shared: SharedErrors, rows: Sequence[DwellRow], axis: int) -> FloatArray | None:
    """Errors (n, s) of a gyro in these dwells due to each shared source; None without any."""
    return np.array([shared[row.dwell][axis] for row in rows]) if shared else None
