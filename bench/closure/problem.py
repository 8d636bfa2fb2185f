"""Weighted least squares of the bias model: the declared part, and terms of effects added to it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from gyrobench.bench.closure.campaign import Campaign
from gyrobench.bench.foundations.arrays import BoolArray, FloatArray, IntArray

#: The declared model: a cubic in each gyro's temperature divided by this, and one constant per power cycle.
DEGREE = 3
SCALE_C = 50.0
#: Smallest share of a column, after projecting out the declared model, that counts as observable.
MIN_VISIBLE = 0.05
#: A direction is independent of the others if it keeps at least this share of its length.
MIN_SHARE = 1e-5
#: Smaller shares of a column are rounding; smallest rms whose square is not zero.
_ROUNDING, _MIN_RMS = 1e-9, 1e-150


@dataclass(frozen=True)
class Problem:
    """The dwells searched, and their residuals after a fit of the columns added so far."""

    campaign: Campaign  #: All n dwells.
    searched: BoolArray  #: Shape (n,). The m dwells that may influence the fit.
    noise_scale: FloatArray | float  #: Ratio of the noise to the stated uncertainties; shape (3,) by gyro.
    #: Shape (m, r) for each gyro. Orthonormal basis of the columns added so far, weighted by the noise.
    bases: tuple[FloatArray, ...]
    residuals: FloatArray  #: Shape (m, 3). Residuals of the measured biases, in standard deviations.
    #: Number of values that count as one in tests of all gyros, whose noise is correlated; 1 if it is not.
    correlation_factor: float = 1.0

    @cached_property
    def sigma_dph(self) -> FloatArray:
        """Standard deviation of the noise in the dwells searched, shape (m, 3)."""
        return self.campaign.sigma_dph[self.searched] * self.noise_scale

    @cached_property
    def _searched_indices(self) -> IntArray:
        """Indices of the dwells searched, shape (m,)."""
        return np.flatnonzero(self.searched)

    @cached_property
    def _inverse_sigma(self) -> FloatArray:
        """Reciprocal of the noise in the dwells searched, shape (3, m, 1)."""
        return np.ascontiguousarray(1.0 / self.sigma_dph.T)[..., np.newaxis]

    @cached_property
    def _common(self) -> tuple[FloatArray, FloatArray] | None:
        """Directions ``Q`` (3, m, c) of errors that dwells have in common, and how much these shrink, ``D``.

        None without such errors. ``1 - Q D Q'`` whitens noise and common errors, in units of the noise.
        """
        if not self.campaign.common_sigma_dph[self.searched].any():
            return None
        errors = self.campaign.common_errors_dph[:, self.searched] * self._inverse_sigma
        lengths = np.linalg.norm(errors, axis=1)
        return (errors / np.maximum(lengths, 1e-300)[:, np.newaxis], 1.0 - 1.0 / np.sqrt(1.0 + lengths**2))

    def whitened(self, values: FloatArray) -> FloatArray:
        """Values of the dwells searched (3, m, k), deg/h, in units of the noise and with white errors."""
        return self._whitened(values, slice(None))

    def whitened_of(self, gyro: int, values: FloatArray) -> FloatArray:
        """The same for one gyro, (m, k)."""
        return self._whitened(values, gyro)

    def _whitened(self, values: FloatArray, gyros: int | slice) -> FloatArray:
        values = values * self._inverse_sigma[gyros]
        if self._common is not None:
            directions, shrinkage = (each[gyros] for each in self._common)
            values -= directions @ (shrinkage[..., np.newaxis] * (directions.mT @ values))
        return values

    @cached_property
    def _stacked_bases(self) -> FloatArray:
        """Bases of the three gyros, padded with zero columns, shape (3, m, r)."""
        widest = max(basis.shape[1] for basis in self.bases)
        return np.stack([np.pad(basis, ((0, 0), (0, widest - basis.shape[1]))) for basis in self.bases])

    @property
    def min_residual_variance(self) -> float:
        """Smallest variance of the residuals, in units of the noise, that the tests assume.

        1 for coefficients other than gyro biases: their stated uncertainties include what all dwells have in
        common, so the scatter between dwells may be smaller.
        """
        return 1e-300 if self.campaign.quantity.is_gyro_bias else 1.0

    @property
    def chi2(self) -> float:
        """Sum of squared residuals, in units of sigma."""
        return float(np.sum(self.residuals**2))

    @property
    def dof(self) -> int:
        """Degrees of freedom: measured values minus fitted parameters."""
        fitted: int = sum(basis.shape[1] for basis in self.bases)
        return int(self.campaign.is_measured[self.searched].sum()) - fitted

    def with_columns(self, columns: FloatArray, kept: BoolArray | None = None) -> Problem:
        """Problem after a fit of additional terms.

        ``columns`` (n, 3, k): terms in all dwells. ``kept`` (3, k): which of them each gyro has.
        """
        added = [_basis(self.independent_part(columns, gyro, kept)) for gyro in range(3)]
        bases = tuple(np.concatenate(pair, axis=1) for pair in zip(self.bases, added, strict=True))
        residuals = [_residual(basis, self.residuals[:, gyro]) for gyro, basis in enumerate(added)]
        return replace(self, bases=bases, residuals=np.stack(residuals, axis=1))

    def project_out(self, columns: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Columns (3, m, k) minus their projection onto the columns so far, in units of the noise; their rms.

        ``columns`` (m, 3, k): terms in the dwells searched. The rms (3, k) is at least ``MIN_VISIBLE`` times
        the standard deviation of the whole column: if nearly all of a column is fitted, its remainder does
        not measure its size.
        """
        weighted = self.whitened(np.moveaxis(columns, 1, 0))
        residual = np.stack(
            [_residual(basis, each) for basis, each in zip(self.bases, weighted, strict=True)]
        )
        rms = np.sqrt(np.mean(residual**2, axis=1))
        lower_limits = MIN_VISIBLE * np.std(weighted, axis=1), _ROUNDING * np.max(np.abs(weighted), axis=1)
        return residual, np.maximum.reduce([rms, *lower_limits, np.full_like(rms, _MIN_RMS)])

    def chi2_reduction(self, columns: FloatArray, kept: BoolArray | None = None) -> tuple[float, int]:
        """Reduction of chi2 by a fit of terms, and the number of independent terms."""
        return explained_by(*self.inner_products(columns, kept))

    def inner_products(self, columns: FloatArray, kept: BoolArray | None) -> tuple[FloatArray, FloatArray]:
        """Inner products of the :meth:`independent_parts` (3, k, k), and theirs with the residuals (3, k)."""
        terms = self.independent_parts(columns, kept)
        return terms.mT @ terms, (terms.mT @ self.residuals.T[..., np.newaxis])[..., 0]

    def independent_lengths(self, columns: FloatArray, kept: BoolArray) -> FloatArray:
        """Length of the part of each kept term that is independent of the columns so far, in sigma."""
        weighted = self.whitened(np.moveaxis(columns[self.searched], 1, 0))
        lengths = [
            np.linalg.norm(_residual(basis, gyro_columns[:, gyro_kept]), axis=0)
            for basis, gyro_columns, gyro_kept in zip(self.bases, weighted, kept, strict=True)
        ]
        return np.concatenate(lengths)

    def independent_share(self, columns: FloatArray, kept: BoolArray | None = None) -> float:
        """Largest share of any term that is independent of the columns so far.

        Relative to its part that is independent of the declared model.
        """
        declared = declared_problem(self.campaign, self.searched, self.noise_scale)
        shares = [0.0]
        for gyro in range(3):
            independent, unfitted = (
                np.linalg.norm(each.independent_part(columns, gyro, kept), axis=0)
                for each in (self, declared)
            )
            shares += (independent[unfitted > MIN_SHARE] / unfitted[unfitted > MIN_SHARE]).tolist()
        return max(shares)

    def independent_part(self, columns: FloatArray, gyro: int, kept: BoolArray | None) -> FloatArray:
        """Terms of one gyro scaled to length one, minus their projection onto the columns so far."""
        weighted = self.whitened_of(gyro, columns[self.searched, gyro])
        if kept is not None:
            weighted = weighted[:, kept[gyro]]
        lengths = np.linalg.norm(weighted, axis=0)
        return _residual(self.bases[gyro], weighted[:, lengths > 0.0] / lengths[lengths > 0.0])

    def independent_parts(self, columns: FloatArray, kept: BoolArray | None) -> FloatArray:
        """:meth:`independent_part` of all three gyros, shape (3, m, k); zero if not kept."""
        terms = self.whitened(columns.take(self._searched_indices, axis=0).transpose(1, 0, 2))
        if kept is not None:
            terms *= kept[:, np.newaxis]
        lengths = np.sqrt(np.einsum("gmk,gmk->gk", terms, terms))[:, np.newaxis]
        terms /= np.where(lengths > 0.0, lengths, 1.0)
        # One projection suffices: rounding leaves less than MIN_SHARE along the columns so far.
        terms -= self._stacked_bases @ (self._stacked_bases.mT @ terms)
        return np.asarray(terms)


def explained_by(products: FloatArray, residual_products: FloatArray) -> tuple[float, int]:
    """Reduction of chi2 by terms with inner products (..., k, k), and the number of independent terms."""
    if products.shape[-1] == 1:
        eigenvalues, projections = products[..., 0], residual_products
    else:
        eigenvalues, directions = np.linalg.eigh(products)
        projections = (directions.mT @ residual_products[..., np.newaxis])[..., 0]
    independent = eigenvalues > MIN_SHARE**2
    reduction = np.add.reduce(projections[independent] ** 2 / eigenvalues[independent])
    return float(reduction), int(np.count_nonzero(independent))


def declared_problem(
    campaign: Campaign,
    searched: BoolArray,
    noise_scale: FloatArray | float = 1.0,
    correlation_factor: float = 1.0,
) -> Problem:
    """Problem with the declared model's columns."""
    empty = Problem(campaign, searched, noise_scale, (), np.zeros((0, 3)), correlation_factor)
    bases, residuals = [], []
    for gyro in range(3):
        weighted = empty.whitened_of(gyro, declared_columns(campaign, gyro)[searched])
        bases.append(_basis(weighted / np.maximum(np.linalg.norm(weighted, axis=0), 1e-300)))
        data = empty.whitened_of(gyro, campaign.bias_dph[searched, gyro, np.newaxis])[:, 0]
        residuals.append(_residual(bases[gyro], data))
    return replace(empty, bases=tuple(bases), residuals=np.stack(residuals, axis=1))


def declared_columns(campaign: Campaign, gyro: int) -> FloatArray:
    """Columns (n, DEGREE + runs) of the declared model of one gyro."""
    powers = (campaign.gyro_c[:, gyro, np.newaxis] / SCALE_C) ** np.arange(1, DEGREE + 1)
    return np.concatenate([powers, campaign.run_shares], axis=1)


@dataclass(frozen=True)
class Solution:
    """A fitted bias model."""

    #: Shape (3, DEGREE + runs). Coefficients of :func:`declared_columns`, deg/h; NaN for runs that were not
    #: searched.
    declared: FloatArray
    #: Shape (3, k). Sizes of the terms of each set of columns, deg/h; zero if not kept.
    sizes: list[FloatArray]
    bias_dph: FloatArray  #: Shape (n, 3). The model in all dwells of the campaign.


def solve_terms(problem: Problem, terms: Sequence[tuple[FloatArray, BoolArray]]) -> Solution:
    """Fit the declared model with terms: pairs of columns (n, 3, k) and terms kept per gyro (3, k)."""
    campaign, searched = problem.campaign, problem.searched
    declared = np.full((3, DEGREE + len(campaign.run_names)), np.nan)
    sizes = [np.zeros(kept.shape) for _, kept in terms]
    for gyro in range(3):
        declared_terms = declared_columns(campaign, gyro)
        is_used = np.any(declared_terms[searched] != 0.0, axis=0)
        blocks = [declared_terms[:, is_used], *(columns[:, gyro, kept[gyro]] for columns, kept in terms)]
        weighted = problem.whitened_of(gyro, np.concatenate(blocks, axis=1)[searched])
        lengths = np.maximum(np.linalg.norm(weighted, axis=0), 1e-300)
        data = problem.whitened_of(gyro, campaign.bias_dph[searched, gyro, np.newaxis])[:, 0]
        values = np.linalg.lstsq(weighted / lengths, data, rcond=MIN_SHARE)[0] / lengths
        split_values = np.split(values, np.cumsum([block.shape[1] for block in blocks])[:-1])
        declared[gyro, is_used] = split_values[0]
        for size, gyro_sizes, (_, kept) in zip(sizes, split_values[1:], terms, strict=True):
            size[gyro, kept[gyro]] = gyro_sizes
    return Solution(declared, sizes, predict(campaign, declared, sizes, [columns for columns, _ in terms]))


def predict(
    campaign: Campaign, declared: FloatArray, sizes: Sequence[FloatArray], columns: Sequence[FloatArray]
) -> FloatArray:
    """Bias (n, 3) by a fitted model in a campaign's dwells, deg/h.

    Parameters
    ----------
    campaign : Campaign
        A power cycle that was not fitted gets the mean constant of those fitted.
    declared, sizes : ndarray, shape (3, DEGREE + runs), and sequence of ndarray, shape (3, k)
        As in :class:`Solution`.
    columns : sequence of ndarray, shape (n, 3, k)
        Terms of the effects.
    """
    coefficients = with_mean_constants(declared)
    bias_dph = np.stack([declared_columns(campaign, gyro) @ coefficients[gyro] for gyro in range(3)], axis=1)
    for size, terms in zip(sizes, columns, strict=True):
        bias_dph += np.einsum("ngk,gk->ng", terms, size)
    return bias_dph


def with_mean_constants(declared: FloatArray) -> FloatArray:
    """Coefficients (..., DEGREE + runs) with the mean constant for the runs that were not fitted."""
    constants = declared[..., DEGREE:]
    filled = np.where(np.isnan(constants), np.nanmean(constants, axis=-1, keepdims=True), constants)
    return np.concatenate([declared[..., :DEGREE], filled], axis=-1)


def _basis(columns: FloatArray) -> FloatArray:
    """Orthonormal basis (m, r) of columns of length at most one."""
    if columns.shape[1] == 0:
        return columns
    directions, lengths, _ = np.linalg.svd(columns, full_matrices=False)
    return np.asarray(directions[:, lengths > MIN_SHARE])


def _residual(basis: FloatArray, data: FloatArray) -> FloatArray:
    """Data minus their projection onto a basis; projected twice, against rounding."""
    once = data - basis @ (basis.mT @ data)
    return np.asarray(once - basis @ (basis.mT @ once))
