"""Terms of a hypothesis as its evidence needs them."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from gyrobench.bench.closure.candidates import Candidate, stack
from gyrobench.bench.closure.problem import MIN_VISIBLE, Problem
from gyrobench.bench.foundations.arrays import BoolArray, FloatArray, IntArray


@dataclass(frozen=True)
class Terms:
    """Terms and data of a hypothesis beside the declared model, in units of the noise and each of rms 1."""

    columns: FloatArray  #: Shape (3, m, k + 1). The data are last.
    kept: BoolArray  #: Shape (3, k).
    owner: IntArray  #: Shape (k,). Index of each term's effect.
    rms: FloatArray  #: Shape (3, k). Of the terms before that.

    @classmethod
    def of(cls, problem: Problem, candidates: Sequence[Candidate]) -> Terms:
        """Terms of effects in the dwells searched."""
        if candidates:
            all_columns, kept = stack(candidates, problem.campaign)
        else:
            all_columns, kept = np.zeros((len(problem.campaign), 3, 0)), np.ones((3, 0), dtype=bool)
        visible, rms_of_terms = problem.beside(all_columns[problem.searched])
        owner = np.repeat(np.arange(len(candidates)), [each.kept.shape[1] for each in candidates])
        rms_of_terms = rms_of_terms * _share_beside_others(visible / rms_of_terms[:, None], kept, owner)
        columns = np.concatenate([visible / rms_of_terms[:, None], problem.residuals.T[..., None]], axis=2)
        return cls(columns, kept, owner.astype(np.int64), rms_of_terms)

    @cached_property
    def products(self) -> FloatArray:
        """Products of the columns, shape (3, k + 1, k + 1)."""
        return np.asarray(np.swapaxes(self.columns, 1, 2) @ self.columns)


def _share_beside_others(columns: FloatArray, kept: BoolArray, owner: IntArray) -> FloatArray:
    """Share (3, k) of columns of rms 1 (3, m, k) that is independent of the other effects' terms.

    What an effect adds to a set is its size: otherwise a set that contains correlated effects of opposite
    sign would be counted beside each of its parts.
    """
    shares = np.ones(kept.shape)
    for gyro, effect in itertools.product(range(3), range(int(owner.max(initial=0)) + 1)):
        mine, others = owner == effect, (owner != effect) & kept[gyro]
        if others.any():
            columns_of_others, _ = np.linalg.qr(columns[gyro][:, others])
            rest = columns[gyro][:, mine]
            rest = rest - columns_of_others @ (columns_of_others.T @ rest)
            shares[gyro, mine] = np.maximum(np.sqrt(np.mean(rest**2, axis=0)), MIN_VISIBLE)
    return shares
