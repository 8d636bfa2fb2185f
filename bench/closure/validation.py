"""Is a model adequate? Lack-of-fit tests, and cross-validation by cycles."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import BSpline
from scipy.stats import chi2 as chi2_distribution
from scipy.stats import f as f_distribution
from scipy.stats import norm

from gyrobench.bench.closure.campaign import Campaign
from gyrobench.bench.closure.candidates import Candidate, solve_with
from gyrobench.bench.closure.problem import SCALE_C, Problem, Solution, declared_problem
from gyrobench.bench.foundations.arrays import BoolArray, FloatArray

_DWELLS_A_TIME_KNOT = 6
_MOST_TIME_KNOTS = 40
_TEMPERATURE_KNOT_C = 4.0
_MOST_TEMPERATURE_KNOTS = 24


@dataclass(frozen=True)
class LackOfFit:
    """Outcome of the tests.

    Attributes
    ----------
    p_noise : float
        Probability of at least this sum of squares if the stated uncertainties are true.
    p_structure : dict of str to float
        Probability, for each thing that residuals might follow, of following it this much by chance.
    noise_ratio : float
        Root of the mean square of the residuals over the stated uncertainty, for the freedom left.
    """

    p_noise: float
    p_structure: dict[str, float]
    noise_ratio: float

    @property
    def p_value(self) -> float:
        """Smallest probability, over the number of tests made."""
        return min(1.0, min(self.p_noise, *self.p_structure.values()) * (1 + len(self.p_structure)))

    @property
    def p_any_structure(self) -> float:
        """The same of the tests for structure alone."""
        return min(1.0, min(self.p_structure.values()) * len(self.p_structure))

    @property
    def follows(self) -> str:
        """What the residuals follow most clearly."""
        return min(self.p_structure, key=lambda name: self.p_structure[name])


def lack_of_fit(problem: Problem, unknowns: int) -> LackOfFit:
    """Test what a problem's columns leave.

    Parameters
    ----------
    problem : Problem
        With the declared model and the terms of all effects as columns.
    unknowns : int
        Parameters of effects that were fitted beside the sizes of their terms.
    """
    freedom = problem.freedom - unknowns
    # Knots and levels come from the dwells searched alone.
    seen = problem.campaign.part(problem.searched)
    structure = {}
    for name, columns in _STRUCTURES.items():
        gain, rank = problem.gain(_in_all_dwells(columns(seen), problem))
        rest = freedom - rank
        if rank and rest > 0:
            ratio = (gain / rank) / max((problem.chi2 - gain) / rest, 1e-300)
            structure[name] = float(f_distribution.sf(ratio, rank, rest))
    structure["the dwell before"] = _serial_correlation(problem)
    return LackOfFit(
        p_noise=float(chi2_distribution.sf(problem.chi2, freedom)),
        p_structure=structure,
        noise_ratio=float(np.sqrt(problem.chi2 / freedom)),
    )


def _spline(values: FloatArray, knots: int) -> FloatArray:
    """Cubic B-splines (n, knots + 2) over the range of values."""
    low, high = float(values.min()), float(values.max())
    inner = np.linspace(low, high if high > low else low + 1.0, knots)
    all_knots = np.concatenate([[inner[0]] * 3, inner, [inner[-1]] * 3])
    return np.asarray(BSpline.design_matrix(values, all_knots, 3).toarray())


def _time(campaign: Campaign) -> FloatArray:
    knots = min(max(len(campaign) // _DWELLS_A_TIME_KNOT, 4), _MOST_TIME_KNOTS)
    return np.repeat(_spline(campaign.middle_s, knots)[:, None, :], 3, axis=1)


def _temperature(campaign: Campaign) -> FloatArray:
    span_c = float(np.ptp(campaign.gyro_c))
    knots = min(max(round(span_c / _TEMPERATURE_KNOT_C), 4), _MOST_TEMPERATURE_KNOTS)
    return np.stack([_spline(each, knots) for each in campaign.gyro_c.T], axis=1)


def _positions(campaign: Campaign) -> FloatArray:
    names = sorted(set(campaign.position))
    flags = np.array([[name == each for name in names] for each in campaign.position], dtype=np.float64)
    scaled = campaign.gyro_c[:, :, None] / SCALE_C
    return np.concatenate([np.repeat(flags[:, None, :], 3, axis=1), flags[:, None, :] * scaled], axis=2)


def _rate(campaign: Campaign) -> FloatArray:
    rate = campaign.rate_c_per_h[:, :, None] / 10.0
    return np.concatenate([rate, np.abs(rate), rate * campaign.gyro_c[:, :, None] / SCALE_C], axis=2)


def _in_all_dwells(known: FloatArray, problem: Problem) -> FloatArray:
    """Columns of the dwells searched (m, 3, k) as columns of all (n, 3, k); zero in the others."""
    every = np.zeros((len(problem.campaign), *known.shape[1:]))
    every[problem.searched] = known
    return every


def _serial_correlation(problem: Problem) -> float:
    """Probability that neighbours are this alike, or this unlike, by chance.

    A fit makes neighbours a little unlike: what it leaves has the covariance ``1 - Q Q'``.
    """
    products = np.sum(problem.residuals[1:] * problem.residuals[:-1])
    expected = -sum(float(np.sum(basis[1:] * basis[:-1])) for basis in problem.bases)
    scale = problem.chi2 / problem.freedom
    spread = scale * np.sqrt(problem.residuals.size)
    return float(2.0 * norm.sf(abs(products - scale * expected) / max(spread, 1e-300)))


_STRUCTURES: dict[str, Callable[[Campaign], FloatArray]] = {
    "time": _time,
    "temperature": _temperature,
    "position": _positions,
    "temperature rate": _rate,
}


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
