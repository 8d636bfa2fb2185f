"""Is anything left? Tests of a model's residuals against the noise and for structure.

Chance alone decides nothing about the size of the noise, so two kinds of test stand side by side:
the sum of squares against the stated uncertainties, and F-tests that ask whether residuals follow
anything, against what is left after they have followed it (the repeat error). All are made within
runs: each run's constant is in the model.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import BSpline
from scipy.stats import chi2 as chi2_distribution
from scipy.stats import f as f_distribution
from scipy.stats import norm

from gyrobench.bench.closure.campaign import Campaign
from gyrobench.bench.closure.problem import SCALE_C, Problem
from gyrobench.bench.foundations.arrays import FloatArray

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
