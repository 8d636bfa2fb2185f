"""Whether an effect holds in a cycle that its size was not taken from."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np

from gyrobench.bench.closure.campaign import Campaign
from gyrobench.bench.closure.candidate import Candidate, solve_with
from gyrobench.bench.closure.problem import Problem, Solution, declared_problem
from gyrobench.bench.foundations.arrays import BoolArray, FloatArray

#: The other cycles tell a term's size if they hold at least this share of its length in the one left out.
_LEAST_LENGTH = 0.1


@dataclass(frozen=True)
class LeftOut:
    """Sums of squares of one cycle, in standard deviations, by two models fitted to the others."""

    fewer: float
    more: float

    @property
    def gain(self) -> float:
        """Share of the squares that the larger model takes away: 1 is all; below 0 it makes them more."""
        return 1.0 - self.more / self.fewer


def pooled_gain(cycles: Collection[LeftOut]) -> float:
    """Share of the squares of all cycles that the larger model takes away; 0 without cycles."""
    fewer = sum(each.fewer for each in cycles)
    return 1.0 - sum(each.more for each in cycles) / fewer if cycles else 0.0


def leave_out_cycles(
    problem: Problem, fewer: Sequence[Candidate], more: Sequence[Candidate]
) -> dict[int, LeftOut]:
    """Squares of each cycle with fewer and with more effects, their sizes taken from the other cycles.

    Cycles whose others can't tell the sizes (a warm-up where the one power-on is left out) are not
    in the answer.

    Parameters
    ----------
    problem : Problem
        With the declared model alone.
    fewer, more : sequence of Candidate
        The effects of the two models.
    """
    campaign = problem.campaign
    answer = {}
    cycles = np.unique(campaign.cycle[problem.searched])
    for cycle in cycles if len(cycles) > 1 else ():
        left_out = problem.searched & (campaign.cycle == cycle)
        rest = declared_problem(campaign, problem.searched & ~left_out, problem.noise_scale)
        if all(_can_tell(rest, each, left_out) for each in more):
            errors = (
                measured_minus(campaign, rest.searched, solve_with(rest, each)) for each in (fewer, more)
            )
            squares = (np.sum((each[left_out] / campaign.sigma_dph[left_out]) ** 2) for each in errors)
            answer[int(cycle)] = LeftOut(*map(float, squares))
    return answer


def measured_minus(campaign: Campaign, searched: BoolArray, model: Solution) -> FloatArray:
    """Measured bias minus a model in all dwells (n, 3), deg/h.

    A run that was not searched has its own mean removed.
    """
    return without_unseen_constants(campaign, searched, campaign.bias_dph - model.bias_dph)


def without_unseen_constants(campaign: Campaign, searched: BoolArray, errors_dph: FloatArray) -> FloatArray:
    """Take the mean of each run that was not searched out of errors (n, 3)."""
    centred = errors_dph.copy()
    for run in np.unique(campaign.run[~searched]):
        if not np.any(campaign.run[searched] == run):
            mine = campaign.run == run
            centred[mine] -= centred[mine].mean(axis=0)
    return centred


def _can_tell(rest: Problem, candidate: Candidate, left_out: BoolArray) -> bool:
    """Whether the terms are long enough in the rest, beside the declared model, for the cycle left out."""
    campaign = rest.campaign
    columns = candidate.columns(campaign)
    asked = columns - _known_constants(campaign, columns, rest.searched, left_out)
    weighted = (asked / (campaign.sigma_dph * rest.noise_scale)[:, :, np.newaxis])[left_out]
    lengths = [np.linalg.norm(weighted[:, gyro, candidate.kept[gyro]], axis=0) for gyro in range(3)]
    told = rest.lengths_beside(columns, candidate.kept)
    return bool(np.all(told >= _LEAST_LENGTH * np.concatenate(lengths)))


def _known_constants(
    campaign: Campaign, columns: FloatArray, rest: BoolArray, left_out: BoolArray
) -> FloatArray:
    """What the constant of each run takes up of terms: their mean in the rest, or in the cycle itself."""
    constants = np.zeros_like(columns)
    for run in np.unique(campaign.run):
        mine = campaign.run == run
        known = mine & rest if np.any(mine & rest) else mine & left_out
        if known.any():
            constants[mine] = columns[known].mean(axis=0)
    return constants
