"""Predicts which effects a planned campaign could find and distinguish.

The search (:mod:`gyrobench.bench.closure.search`) finds an effect if its reduction of chi2 is significant,
and calls two effects tied if their BIC is nearly equal. Both follow from the times, temperatures and
positions of the dwells: significance from the length of an effect's terms, with the declared model projected
out, in standard deviations (the non-centrality of a chi-square); ties from the residual of the alternative in
its best form and with its best parameters.

All sizes are rms values over the dwells of all three gyros, without the mean of each gyro. The terms of an
effect are orthogonalized in their order and have equal sizes with any signs, so that the expected square of
the effect is the sum of their squares.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property

import numpy as np
from scipy.optimize import brentq
from scipy.special import chdtri, chndtr

from gyrobench.bench.closure.campaign import Campaign
from gyrobench.bench.closure.candidates import bic_penalty, start_count
from gyrobench.bench.closure.effects.effect import Effect, Form, Parameter
from gyrobench.bench.closure.outcome import FoundEffect
from gyrobench.bench.closure.posterior import TIE_ODDS
from gyrobench.bench.closure.problem import MIN_SHARE, Problem, declared_problem
from gyrobench.bench.closure.search import EFFECT_SIGNIFICANCE, SAME_SHARE
from gyrobench.bench.foundations.arrays import FloatArray, rms

#: Number of combinations of parameter values at which an alternative is fitted.
_ALTERNATIVE_VALUES = 80
#: Parameters whose bounds have at least this ratio are spaced geometrically.
_WIDE = 20.0


@dataclass(frozen=True)
class Fit:
    """A form of an effect with fixed nonlinear parameters, for a fit of its sizes."""

    parameters: int  #: Number of nonlinear parameters.
    #: Shape (3, n, k). Part of its terms for each gyro that is independent of the declared model; of any
    #: length.
    terms: FloatArray

    @property
    def parameter_count(self) -> int:
        """Number of sizes and nonlinear parameters."""
        return self.parameters + round(float(np.sum(self.basis**2)))

    @cached_property
    def basis(self) -> FloatArray:
        """Orthonormal basis of the terms; see :func:`basis_of`."""
        return basis_of(self.terms)


@dataclass(frozen=True)
class AssumedEffect(Fit):
    """An effect assumed to be present."""

    #: Shape (3, n, r). Components of an effect of 1 deg/h that are independent of the declared model, in
    #: standard deviations; see :func:`unit_components`.
    components: FloatArray

    @property
    def information(self) -> float:
        """Non-centrality of the effect at 1 deg/h."""
        return float(np.sum(self.components**2))

    def explained_by(self, basis: FloatArray) -> float:
        """Sum of squares of the projection of the components onto a basis (3, n, r) of each gyro."""
        return float(np.sum((np.swapaxes(basis, 1, 2) @ self.components) ** 2))


def unit_components(columns: FloatArray) -> FloatArray:
    """Orthogonal components of an effect, whose sum with any signs has an rms of 1.

    ``columns`` (n, 3, k): the effect's terms. Returns (n, 3, r): each term without its means and orthogonal
    to the previous terms, all of equal size.
    """
    count, gyros, _ = columns.shape
    centred = (columns - columns.mean(axis=0)).reshape(count * gyros, -1)
    lengths = np.linalg.norm(centred, axis=0)
    varies = lengths > MIN_SHARE * np.linalg.norm(columns)
    orthogonal, upper = np.linalg.qr(centred[:, varies] / lengths[varies])
    orthogonal = orthogonal[:, np.abs(np.diag(upper)) > MIN_SHARE]
    components = orthogonal * np.sqrt(count * gyros / max(orthogonal.shape[1], 1))
    return np.asarray(components.reshape(count, gyros, orthogonal.shape[1]))


def _independent_part(problem: Problem, columns: FloatArray) -> FloatArray:
    """Weighted columns (n, 3, k) minus their projection onto the declared model: (3, n, k).

    Zero for columns that depend on the declared model.
    """
    weighted = problem.whitened(np.moveaxis(columns, 1, 0))
    remainder = np.stack(
        [
            columns_of_gyro - basis @ (basis.T @ columns_of_gyro)
            for basis, columns_of_gyro in zip(problem.bases, weighted, strict=True)
        ]
    )
    is_independent = np.linalg.norm(remainder, axis=1) > MIN_SHARE * np.linalg.norm(weighted, axis=1)
    return np.asarray(remainder * is_independent[:, np.newaxis, :])


def basis_of(columns: FloatArray) -> FloatArray:
    """Orthonormal basis of columns (3, n, k) for each gyro; zero columns if the rank is below k."""
    lengths = np.linalg.norm(columns, axis=1, keepdims=True)
    directions, singular_values, _ = np.linalg.svd(
        columns / np.where(lengths > 0.0, lengths, 1.0), full_matrices=False
    )
    return np.asarray(directions * (singular_values > MIN_SHARE)[:, np.newaxis, :])


def assumed_effects(problem: Problem, effect: Effect) -> list[AssumedEffect]:
    """An effect at all starting values with which the dwells show it, the typical values first."""
    campaign = problem.campaign
    assumed = []
    for form in effect.forms:
        for values in () if form.missing_input(campaign) else _start_values_middle_first(form, campaign):
            columns = form.columns(campaign, values)
            components = _independent_part(problem, unit_components(columns))
            if np.any(components):
                assumed.append(AssumedEffect(len(values), _independent_part(problem, columns), components))
    return assumed


def _start_values_middle_first(form: Form, campaign: Campaign) -> Iterator[tuple[float, ...]]:
    """The middle starting value of each parameter, then all starting values."""
    grids = [np.sort(parameter.starts(campaign)).tolist() for parameter in form.parameters]
    if all(grids):
        yield tuple(grid[len(grid) // 2] for grid in grids)
        yield from itertools.product(*grids)


def alternative_fits(problem: Problem, effect: Effect) -> list[Fit]:
    """Fits of an effect at parameters spaced over their bounds."""
    campaign = problem.campaign
    fits = []
    for form in effect.forms:
        if form.missing_input(campaign) is None:
            count = round(_ALTERNATIVE_VALUES ** (1.0 / max(len(form.parameters), 1)))
            grids = [_grid(parameter, campaign, count) for parameter in form.parameters]
            fits += [
                Fit(len(values), _independent_part(problem, form.columns(campaign, values)))
                for values in itertools.product(*grids)
            ]
    return fits


def _grid(parameter: Parameter, campaign: Campaign, count: int) -> list[float]:
    low, high = parameter.low, parameter.high
    starts: list[float] = parameter.starts(campaign).tolist()
    if not np.isfinite([low, high]).all():
        return starts
    spread = np.geomspace if parameter.is_scale and high > _WIDE * low else np.linspace
    return sorted({*starts, *spread(low, high, count).tolist()})


#: Probability that an effect of the smallest size stated is found.
EFFECT_POWER = 0.9
_MORE_VARIATION = "dwells with a larger variation of what the effect follows"
#: Odds at which effects are tied, as a difference of BIC.
_TIE_MARGIN = 2.0 * math.log(TIE_ODDS)
#: Sizes evaluated, deg/h.
_SIZES_DPH = np.geomspace(1e-6, 10.0, 1401)


@dataclass(frozen=True)
class Detection:
    """Smallest size at which an effect is found."""

    effect: Effect  #: The effect.
    #: The missing input that prevents the campaign from showing it; the sizes are then infinite.
    missing_input: str | None
    #: typical_dph, largest_dph: Smallest size found with probability :data:`EFFECT_POWER`, for the middle
    #: starting values of its parameters and for the worst ones.
    typical_dph: float = np.inf
    largest_dph: float = np.inf
    #: Variance inflation factor of its size if all other effects are fitted with it.
    inflation: float = np.inf


@dataclass(frozen=True)
class Separability:
    """Which effects a campaign could find and distinguish."""

    campaign: Campaign  #: The dwells searched.
    detections: tuple[Detection, ...]  #: One for each effect, by name.
    #: Smallest size at which the first effect of a pair, if present, is found and not mistaken for the
    #: second; for all pairs of effects that the campaign can show.
    distinguished_dph: Mapping[tuple[str, str], float]
    #: Largest canonical correlation of the terms of two effects for any gyro, typical values.
    correlation: Mapping[tuple[str, str], float]
    #: Size in these dwells of the effects that a closure found, by name; others have a target size.
    expected_dph: Mapping[str, float]

    def label(self, name: str) -> str:
        """Label of an effect."""
        return next((each.effect.display_name for each in self.detections if each.effect.name == name), name)

    def nearest_alternative(self, name: str) -> tuple[str, float] | None:
        """The effect that is hardest to distinguish from one, and the size required; None without any."""
        sizes = {other: size for (present, other), size in self.distinguished_dph.items() if present == name}
        if not sizes:
            return None
        nearest = max(sizes, key=lambda each: (sizes[each], self.correlation[name, each]))
        return nearest, sizes[nearest]

    def not_found(self, target_dph: float) -> list[str]:
        """Effects that are not found at a target size, or at their expected size."""
        return [
            name
            for each in self.detections
            if each.typical_dph > self.expected_dph.get(name := each.effect.name, target_dph)
        ]

    def not_distinguished(self, target_dph: float) -> list[tuple[str, str]]:
        """Pairs of effects, each once, of which one is found at a target size but mistaken for the other."""
        not_found = self.not_found(target_dph)
        return sorted(
            {
                (min(present, other), max(present, other))
                for (present, other), size in self.distinguished_dph.items()
                if size > self.expected_dph.get(present, target_dph) and present not in not_found
            }
        )

    def is_settled(self, name: str, target_dph: float) -> bool:
        """Whether an effect of a target size is found and distinguished from all others."""
        return name not in self.not_found(target_dph) and all(
            size <= self.expected_dph.get(name, target_dph)
            for (present, _), size in self.distinguished_dph.items()
            if present == name
        )

    def distinguished_both_ways_dph(self, pair: tuple[str, str]) -> float:
        """Smallest size at which neither effect of a pair is mistaken for the other."""
        first, second = pair
        sizes = self.distinguished_dph
        return max(sizes.get((first, second), np.inf), sizes.get((second, first), np.inf))


def searched_dwells(campaign: Campaign) -> Campaign:
    """The dwells that a search uses: all except the last cycle, or all if there is only one cycle."""
    searched = campaign.cycle < campaign.cycle.max()
    return campaign.part(searched) if searched.any() else campaign


def separability(
    campaign: Campaign, effects: Sequence[Effect], found: Sequence[FoundEffect] = ()
) -> Separability:
    """Evaluate which effects a campaign could find and distinguish.

    All dwells of the campaign are searched; its biases are not used. ``found``: effects of a closure, which
    are assumed with their fitted parameters and sizes; others are assumed with any size.
    """
    problem = declared_problem(campaign, campaign.all_dwells)
    effects = [effect.bounded(campaign) for effect in effects]
    assumed = {effect.name: assumed_effects(problem, effect) for effect in effects}
    expected_dph = {}
    for each in found:
        columns = each.candidate.columns(campaign)
        bias_dph = np.einsum("ngk,gk->ng", columns, each.sizes_dph)[:, :, np.newaxis]
        components = _independent_part(problem, unit_components(bias_dph))
        expected_dph[each.effect.name] = rms(bias_dph - bias_dph.mean(axis=0))
        if np.any(components):
            terms = _independent_part(problem, columns)
            assumed[each.effect.name].insert(0, AssumedEffect(len(each.candidate.values), terms, components))
    typical = {name: each[0] for name, each in assumed.items() if each}
    detections = {each.name: _detection(problem, each, assumed[each.name], effects) for each in effects}
    fits = {effect.name: alternative_fits(problem, effect) for effect in effects if effect.name in typical}
    distinguished, correlation = {}, {}
    for name, present in typical.items():
        present_bic = _expected_bic(present, present, bic_penalty(problem))
        for other in typical.keys() - {name}:
            size_dph = _distinguished_dph(problem, present, present_bic, fits[other])
            distinguished[name, other] = max(detections[name].typical_dph, size_dph)
            correlation[name, other] = _correlation(present, typical[other])
    for effect in effects:
        for other in effect.imitated_by if effect.name in typical else ():
            if other in detections and detections[other].missing_input:
                distinguished[effect.name, other], correlation[effect.name, other] = np.inf, 1.0
    return Separability(
        campaign,
        tuple(
            replace(each, inflation=_inflation(typical, name)) if name in typical else each
            for name, each in sorted(detections.items())
        ),
        distinguished,
        correlation,
        expected_dph,
    )


def _detection(
    problem: Problem, effect: Effect, assumed: Sequence[AssumedEffect], effects: Sequence[Effect]
) -> Detection:
    campaign = problem.campaign
    if not assumed:
        return Detection(effect, effect.missing_input(campaign) or _MORE_VARIATION)
    candidate_fits = len(effects) * start_count(effect, campaign)
    sizes = [_smallest_found_dph(each, candidate_fits) for each in assumed]
    return Detection(effect, None, sizes[0], max(sizes))


def _smallest_found_dph(present: AssumedEffect, candidate_fits: int) -> float:
    """Smallest size that is significant with probability :data:`EFFECT_POWER`."""
    return float(np.sqrt(_noncentrality(present.parameter_count, candidate_fits) / present.information))


@cache
def _noncentrality(parameters: int, candidate_fits: int) -> float:
    """Non-centrality of a reduction of chi2 that is significant in a search; see :meth:`Search.p_value`."""
    limit = float(chdtri(parameters, EFFECT_SIGNIFICANCE / candidate_fits))
    highest = 4.0 * limit + 100.0
    return float(
        brentq(lambda value: 1.0 - float(chndtr(limit, parameters, value)) - EFFECT_POWER, 1e-3, highest)
    )


def _inflation(typical: Mapping[str, AssumedEffect], name: str) -> float:
    assumed = typical[name]
    others = [each.terms for other, each in typical.items() if other != name]
    if not others:
        return 1.0
    independent = assumed.information - assumed.explained_by(basis_of(np.concatenate(others, axis=2)))
    return assumed.information / independent if independent > MIN_SHARE**2 * assumed.information else np.inf


def _correlation(fit: Fit, other: Fit) -> float:
    cosines = np.linalg.svd(np.swapaxes(fit.basis, 1, 2) @ other.basis, compute_uv=False)
    return min(1.0, float(cosines.max()))


def _distinguished_dph(
    problem: Problem, present: AssumedEffect, present_bic: FloatArray, fits: Sequence[Fit]
) -> float:
    """Smallest size above which the expected BIC of the best alternative is larger by the margin of a tie.

    ``present_bic``: expected BIC of the effect present, at all sizes.
    """
    alternative = max(fits, key=lambda each: present.explained_by(each.basis))
    if _is_special_case(present, alternative):
        return 0.0
    bic_difference = _expected_bic(present, alternative, bic_penalty(problem)) - present_bic
    tied = np.flatnonzero(bic_difference < _TIE_MARGIN)
    first_untied = tied[-1] + 1 if len(tied) else 0
    return float(_SIZES_DPH[first_untied]) if first_untied < len(_SIZES_DPH) else np.inf


def _is_special_case(special: Fit, general: Fit) -> bool:
    if special.parameter_count >= general.parameter_count:
        return False
    fitted = general.basis @ (np.swapaxes(general.basis, 1, 2) @ special.terms)
    residual_lengths, lengths = (
        np.linalg.norm(each, axis=1) for each in (special.terms - fitted, special.terms)
    )
    return bool(np.all(residual_lengths <= SAME_SHARE * lengths))


def _expected_bic(present: AssumedEffect, fitted: Fit, penalty: float) -> FloatArray:
    """Expected BIC of a fit to an effect at all sizes, without the terms that do not lower it."""
    # A parameter fitted to noise alone reduces chi2 by one.
    net_penalty = penalty - 1.0
    bic = np.full(len(_SIZES_DPH), net_penalty * fitted.parameters)
    for components, terms in zip(present.components, fitted.terms, strict=True):
        bic_by_count = [
            chi2 * _SIZES_DPH**2 + net_penalty * count
            for count, chi2 in _backward_elimination(components, terms)
        ]
        bic += np.min(bic_by_count, axis=0)
    return bic


def _backward_elimination(components: FloatArray, terms: FloatArray) -> list[tuple[int, float]]:
    """Number of terms and chi2 of the fit to components, by backward elimination of terms."""
    lengths = np.linalg.norm(terms, axis=0)
    terms = terms[:, lengths > 0.0] / lengths[lengths > 0.0]
    gram, projections, total = terms.T @ terms, terms.T @ components, float(np.sum(components**2))

    def chi2(kept: list[int]) -> float:
        inverse = np.linalg.pinv(gram[np.ix_(kept, kept)], rcond=MIN_SHARE**2, hermitian=True)
        return max(total - float(np.sum(projections[kept] * (inverse @ projections[kept]))), 0.0)

    kept = list(range(terms.shape[1]))
    result = [(len(kept), chi2(kept))]
    while len(kept) > 1:
        trials = [[each for each in kept if each != dropped] for dropped in kept]
        values = [chi2(each) for each in trials]
        kept = trials[int(np.argmin(values))]
        result.append((len(kept), min(values)))
    return result
