"""What effects look like in the dwells of a campaign, beside the declared model.

All sizes are rms values over the dwells of all three gyros, without the mean of each gyro. An
effect with several terms is taken to have them, each without what the ones before it say, in equal
size with any signs, so that on average its squares are the sums of theirs.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from gyrobench.bench.closure.campaign import Campaign
from gyrobench.bench.closure.effects.effect import Effect, Form, Parameter
from gyrobench.bench.closure.problem import Problem
from gyrobench.bench.foundations.arrays import FloatArray

#: Terms below this share of their own length, or of an effect's whole, say nothing.
NOTHING = 1e-5
#: Values tried for a rival's parameters, all combinations together.
_RIVAL_VALUES = 80
#: From this ratio of its bounds on a parameter is tried at equal ratios.
_WIDE = 20.0


@dataclass(frozen=True)
class Fit:
    """What can be fitted with certain parameters of an effect's form.

    Attributes
    ----------
    parameters : int
        How many parameters the form has.
    terms : ndarray, shape (3, n, k)
        What the declared model leaves of its terms for each gyro, each of any length.
    """

    parameters: int
    terms: FloatArray

    @property
    def unknowns(self) -> int:
        """Sizes and parameters."""
        return self.parameters + round(float(np.sum(self.basis**2)))

    @cached_property
    def basis(self) -> FloatArray:
        """See :func:`basis_of`."""
        return basis_of(self.terms)


@dataclass(frozen=True)
class Truth(Fit):
    """An effect as it may be.

    Attributes
    ----------
    parts : ndarray, shape (3, n, r)
        What the declared model leaves of the parts of an effect of 1 deg/h, in standard deviations
        of the noise; see :func:`unit_parts`.
    """

    parts: FloatArray

    @property
    def information(self) -> float:
        """Non-centrality of the effect at 1 deg/h."""
        return float(np.sum(self.parts**2))

    def explained_by(self, basis: FloatArray) -> float:
        """Sum of squares of the parts that lies along directions (3, n, r) of each gyro."""
        return float(np.sum((np.swapaxes(basis, 1, 2) @ self.parts) ** 2))


def unit_parts(columns: FloatArray) -> FloatArray:
    """Parts of an effect that together are 1 rms for any signs of theirs.

    Parameters
    ----------
    columns : ndarray, shape (n, 3, k)
        The effect's terms.

    Returns
    -------
    ndarray, shape (n, 3, r)
        Each term without its means and without what the terms before it say, all of one size.
    """
    count, gyros, _ = columns.shape
    centred = (columns - columns.mean(axis=0)).reshape(count * gyros, -1)
    lengths = np.linalg.norm(centred, axis=0)
    varies = lengths > NOTHING * np.linalg.norm(columns)
    freed, rest = np.linalg.qr(centred[:, varies] / lengths[varies])
    freed = freed[:, np.abs(np.diag(rest)) > NOTHING]
    parts = freed * np.sqrt(count * gyros / max(freed.shape[1], 1))
    return np.asarray(parts.reshape(count, gyros, freed.shape[1]))


def _beside(problem: Problem, columns: FloatArray) -> FloatArray:
    """What the declared model leaves of columns (n, 3, k), weighted; zero for next to nothing: (3, n, k)."""
    weighted = np.moveaxis(columns / problem.sigma_dph[:, :, np.newaxis], 1, 0)
    left = np.stack(
        [mine - basis @ (basis.T @ mine) for basis, mine in zip(problem.bases, weighted, strict=True)]
    )
    says = np.linalg.norm(left, axis=1) > NOTHING * np.linalg.norm(weighted, axis=1)
    return np.asarray(left * says[:, np.newaxis, :])


def basis_of(columns: FloatArray) -> FloatArray:
    """For each gyro, orthonormal directions of columns (3, n, k); zero where there are fewer than k."""
    lengths = np.linalg.norm(columns, axis=1, keepdims=True)
    left, values, _ = np.linalg.svd(columns / np.where(lengths > 0.0, lengths, 1.0), full_matrices=False)
    return np.asarray(left * (values > NOTHING)[:, np.newaxis, :])


def truths(problem: Problem, effect: Effect) -> list[Truth]:
    """An effect with all values that the search starts from, as far as the dwells show it; typical first."""
    campaign = problem.campaign
    found = []
    for form in effect.forms:
        for values in () if form.lacks(campaign) else _from_the_middle(form, campaign):
            columns = form.columns(campaign, values)
            parts = _beside(problem, unit_parts(columns))
            if np.any(parts):
                found.append(Truth(len(values), _beside(problem, columns), parts))
    return found


def _from_the_middle(form: Form, campaign: Campaign) -> Iterator[tuple[float, ...]]:
    """Values that a form starts from, after the middle one of each parameter."""
    grids = [np.sort(parameter.starts(campaign)).tolist() for parameter in form.parameters]
    if all(grids):
        yield tuple(grid[len(grid) // 2] for grid in grids)
        yield from itertools.product(*grids)


def rivals(problem: Problem, effect: Effect) -> list[Fit]:
    """Fits by which an effect could look like another one: its parameters all over their bounds."""
    campaign = problem.campaign
    fits = []
    for form in effect.forms:
        if form.lacks(campaign) is None:
            count = round(_RIVAL_VALUES ** (1.0 / max(len(form.parameters), 1)))
            grids = [_grid(parameter, campaign, count) for parameter in form.parameters]
            fits += [
                Fit(len(values), _beside(problem, form.columns(campaign, values)))
                for values in itertools.product(*grids)
            ]
    return fits


def _grid(parameter: Parameter, campaign: Campaign, count: int) -> list[float]:
    low, high = parameter.low, parameter.high
    begun: list[float] = parameter.starts(campaign).tolist()
    if not np.isfinite([low, high]).all():
        return begun
    spread = np.geomspace if low > 0.0 and high > _WIDE * low else np.linspace
    return sorted({*begun, *spread(low, high, count).tolist()})
