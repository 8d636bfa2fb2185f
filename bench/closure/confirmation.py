"""Whether an effect holds in a cycle that its size was not taken from."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from bench.closure.campaign import Campaign
from bench.closure.candidate import Candidate
from bench.closure.problem import Problem, declared_problem, solve

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

#: The other cycles tell a term's size if they hold at least this share of its length in the one left out.
_LEAST_LENGTH = 0.3


def gains_by_cycle(problem: Problem, candidates: Sequence[Candidate], index: int) -> dict[int, float]:
    """Share of the squares that one effect takes away in each cycle, its size taken from the others.

    1 is all, 0 nothing; below 0 the effect makes the cycle worse. Cycles whose others can't tell
    the effect's size (a warm-up where the one power-on is left out) are not in the answer.

    Parameters
    ----------
    problem : Problem
        With the declared model alone.
    candidates : sequence of Candidate
        All effects of the model.
    index : int
        Which of them is asked about.
    """
    campaign = problem.campaign
    others = [each for number, each in enumerate(candidates) if number != index]
    gains = {}
    cycles = np.unique(campaign.cycle[problem.searched])
    for cycle in cycles if len(cycles) > 1 else ():
        left_out = problem.searched & (campaign.cycle == cycle)
        rest = declared_problem(campaign, problem.searched & ~left_out, problem.noise_scale)
        if all(_can_tell(rest, each, left_out) for each in candidates):
            without, with_it = (
                np.sum((measured_minus(rest, each)[left_out] / campaign.sigma_dph[left_out]) ** 2)
                for each in (others, candidates)
            )
            gains[int(cycle)] = float(1.0 - with_it / without)
    return gains


def measured_minus(problem: Problem, candidates: Sequence[Candidate]) -> FloatArray:
    """Measured bias minus the model fitted to the dwells searched (n, 3), deg/h.

    A run that was not searched has its own mean removed.
    """
    campaign = problem.campaign
    model = solve(problem, [(each.columns(campaign), each.kept) for each in candidates])
    return without_unseen_constants(campaign, problem.searched, campaign.bias_dph - model.bias_dph)


def without_unseen_constants(campaign: Campaign, searched: BoolArray, errors_dph: FloatArray) -> FloatArray:
    """Take the mean of each run that was not searched out of errors (n, 3)."""
    centred = errors_dph.copy()
    for run in np.unique(campaign.run[~searched]):
        if not np.any(campaign.run[searched] == run):
            mine = campaign.run == run
            centred[mine] -= centred[mine].mean(axis=0)
    return centred


def _can_tell(rest: Problem, candidate: Candidate, left_out: BoolArray) -> bool:
    columns = candidate.columns(rest.campaign)
    for gyro in range(3):
        for term in np.flatnonzero(candidate.kept[gyro]):
            values = columns[:, gyro, term]
            inside, outside = values[left_out], values[rest.searched]
            if np.std(outside) < _LEAST_LENGTH * np.std(inside):
                return False
    return True
