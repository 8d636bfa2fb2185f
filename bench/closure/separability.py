"""Which effects a planned campaign could find and distinguish, before it is measured."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property

import numpy as np
from scipy.optimize import brentq
from scipy.stats import chi2 as chi2_distribution
from scipy.stats import ncx2

from gyrobench.bench.closure.campaign import Campaign
from gyrobench.bench.closure.candidates import price, tried
from gyrobench.bench.closure.effects.effect import Effect, Form, Parameter
from gyrobench.bench.closure.problem import Problem, declared_problem
from gyrobench.bench.closure.search import SAME_SHARE, SIGNIFICANCE, TIE_MARGIN
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


#: Probability with which an effect of the smallest size told is found.
POWER = 0.9
_DIFFERENT_DWELLS = "dwells that differ more in what the effect follows"
#: Sizes between which the smallest one is looked for, deg/h.
_SIZES_DPH = np.geomspace(1e-6, 10.0, 1401)


@dataclass(frozen=True)
class Detection:
    """How large an effect has to be to be found.

    Attributes
    ----------
    effect : Effect
        Which one.
    lacks : str or None
        Why the campaign can't show it at all; then the rest is infinite.
    typical_dph, largest_dph : float
        Smallest size found with probability :data:`POWER`: in the middle of the values that its
        parameters start from, and for the worst of them.
    inflation : float
        By how much the other effects, all fitted beside it, enlarge the variance of its size.
    """

    effect: Effect
    lacks: str | None = None
    typical_dph: float = np.inf
    largest_dph: float = np.inf
    inflation: float = np.inf


@dataclass(frozen=True)
class Separability:
    """What a campaign could tell.

    Attributes
    ----------
    campaign : Campaign
        The dwells that the search sees.
    detections : tuple of Detection
        One for each effect, by name.
    told_dph : dict of (str, str) to float
        Smallest size at which the first effect, being the true one, is found and not mistaken
        for the second; for all pairs of effects that the campaign can show.
    correlation : dict of (str, str) to float
        Largest canonical correlation of the terms of two effects for any gyro, typical values.
    """

    campaign: Campaign
    detections: tuple[Detection, ...]
    told_dph: Mapping[tuple[str, str], float]
    correlation: Mapping[tuple[str, str], float]

    def hardest_rival(self, name: str) -> tuple[str, float] | None:
        """Effect that is hardest to tell from one, and the size from which it is told; None without any."""
        sizes = {rival: size for (true, rival), size in self.told_dph.items() if true == name}
        if not sizes:
            return None
        rival = max(sizes, key=lambda each: (sizes[each], self.correlation[name, each]))
        return rival, sizes[rival]

    def not_found(self, target_dph: float) -> list[str]:
        """Effects that are not found at some size."""
        return [each.effect.name for each in self.detections if each.typical_dph > target_dph]

    def not_told(self, target_dph: float) -> list[tuple[str, str]]:
        """Pairs of effects, each once, of which one is found at some size but mistaken for the other."""
        hidden = self.not_found(target_dph)
        return sorted(
            {
                (min(true, rival), max(true, rival))
                for (true, rival), size in self.told_dph.items()
                if size > target_dph and true not in hidden
            }
        )

    def is_settled(self, name: str, target_dph: float) -> bool:
        """Whether an effect is found at some size and told from all others."""
        return name not in self.not_found(target_dph) and all(
            size <= target_dph for (true, _), size in self.told_dph.items() if true == name
        )

    def told_both_ways_dph(self, pair: tuple[str, str]) -> float:
        """Smallest size at which neither effect of a pair is mistaken for the other."""
        one, other = pair
        return max(self.told_dph.get((one, other), np.inf), self.told_dph.get((other, one), np.inf))


def searched_dwells(campaign: Campaign) -> Campaign:
    """The dwells that a search sees: all but those of the last cycle, or all where there is one cycle."""
    searched = campaign.cycle < campaign.cycle.max()
    return campaign.part(searched) if searched.any() else campaign


def separability(campaign: Campaign, effects: Sequence[Effect]) -> Separability:
    """Work out what a campaign could tell.

    Parameters
    ----------
    campaign : Campaign
        All of its dwells are searched; its biases do not matter.
    effects : sequence of Effect
        Candidates of the search.
    """
    problem = declared_problem(campaign, np.ones(len(campaign), dtype=bool))
    may_be = {effect.name: truths(problem, effect) for effect in effects}
    typical = {name: each[0] for name, each in may_be.items() if each}
    detections = {each.name: _detection(problem, each, may_be[each.name], effects) for each in effects}
    fits = {effect.name: rivals(problem, effect) for effect in effects if effect.name in typical}
    told, correlation = {}, {}
    for one, true in typical.items():
        own = _score(true, true, price(problem))
        for other in typical.keys() - {one}:
            size_dph = _told_dph(problem, true, own, fits[other])
            told[one, other] = max(detections[one].typical_dph, size_dph)
            correlation[one, other] = _correlation(true, typical[other])
    return Separability(
        campaign,
        tuple(
            replace(each, inflation=_inflation(typical, name)) if name in typical else each
            for name, each in sorted(detections.items())
        ),
        told,
        correlation,
    )


def _detection(
    problem: Problem, effect: Effect, may_be: Sequence[Truth], effects: Sequence[Effect]
) -> Detection:
    campaign = problem.campaign
    if not may_be:
        lacks = [form.lacks(campaign) for form in effect.forms]
        return Detection(effect, next((each for each in lacks if each), _DIFFERENT_DWELLS))
    trials = len(effects) * tried(effect, campaign)
    sizes = [_found_dph(each, trials) for each in may_be]
    return Detection(effect, None, sizes[0], max(sizes))


def _found_dph(true: Truth, trials: int) -> float:
    """Smallest size that is beyond chance with probability :data:`POWER`."""
    return float(np.sqrt(_noncentrality(true.unknowns, trials) / true.information))


@cache
def _noncentrality(unknowns: int, trials: int) -> float:
    """Of a sum of squares that the search takes for an effect; see its p_value."""
    limit = float(chi2_distribution.isf(SIGNIFICANCE / trials, unknowns))
    highest = 4.0 * limit + 100.0
    return float(brentq(lambda value: float(ncx2.sf(limit, unknowns, value)) - POWER, 1e-3, highest))


def _inflation(typical: Mapping[str, Truth], name: str) -> float:
    own = typical[name]
    others = [each.terms for other, each in typical.items() if other != name]
    if not others:
        return 1.0
    left = own.information - own.explained_by(basis_of(np.concatenate(others, axis=2)))
    return own.information / left if left > NOTHING**2 * own.information else np.inf


def _correlation(one: Fit, other: Fit) -> float:
    cosines = np.linalg.svd(np.swapaxes(one.basis, 1, 2) @ other.basis, compute_uv=False)
    return min(1.0, float(cosines.max()))


def _told_dph(problem: Problem, true: Truth, own: FloatArray, fits: Sequence[Fit]) -> float:
    """Smallest size from which on the rival's expected score is behind by the margin of a tie.

    ``own`` is the expected score of the true effect at all sizes.
    """
    rival = max(fits, key=lambda each: true.explained_by(each.basis))
    if _is_case_of(true, rival):
        return 0.0
    behind = _score(true, rival, price(problem)) - own
    tied = np.flatnonzero(behind < TIE_MARGIN)
    first = tied[-1] + 1 if len(tied) else 0
    return float(_SIZES_DPH[first]) if first < len(_SIZES_DPH) else np.inf


def _is_case_of(special: Fit, general: Fit) -> bool:
    if special.unknowns >= general.unknowns:
        return False
    made_up = general.basis @ (np.swapaxes(general.basis, 1, 2) @ special.terms)
    left, whole = (np.linalg.norm(each, axis=1) for each in (special.terms - made_up, special.terms))
    return bool(np.all(left <= SAME_SHARE * whole))


def _score(true: Truth, fitted: Fit, price_of_unknown: float) -> FloatArray:
    """Expected score of a fit to a true effect of all sizes, terms dropped where they don't pay."""
    # What is fitted to noise alone takes away its own square, which is one.
    cost = price_of_unknown - 1.0
    score = np.full(len(_SIZES_DPH), cost * fitted.parameters)
    for mine, terms in zip(true.parts, fitted.terms, strict=True):
        lines = [left * _SIZES_DPH**2 + cost * count for count, left in _fewer_and_fewer(mine, terms)]
        score += np.min(lines, axis=0)
    return score


def _fewer_and_fewer(true: FloatArray, terms: FloatArray) -> list[tuple[int, float]]:
    """Numbers of terms, and the squares that they leave, the least one dropped each time."""
    lengths = np.linalg.norm(terms, axis=0)
    terms = terms[:, lengths > 0.0] / lengths[lengths > 0.0]
    gram, along, whole = terms.T @ terms, terms.T @ true, float(np.sum(true**2))

    def left(kept: list[int]) -> float:
        inverse = np.linalg.pinv(gram[np.ix_(kept, kept)], rcond=NOTHING**2, hermitian=True)
        return max(whole - float(np.sum(along[kept] * (inverse @ along[kept]))), 0.0)

    kept = list(range(terms.shape[1]))
    result = [(len(kept), left(kept))]
    while len(kept) > 1:
        trials = [[each for each in kept if each != dropped] for dropped in kept]
        values = [left(each) for each in trials]
        kept = trials[int(np.argmin(values))]
        result.append((len(kept), min(values)))
    return result
