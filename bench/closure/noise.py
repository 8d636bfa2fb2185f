"""Noise of the measured biases: its ratio to the stated uncertainties, and outliers.

Noise is the scatter about a model whose residual has no structure. Outliers are down-weighted in the fit:
each gets its deviation from the model as its standard deviation.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from gyrobench.bench.bias.dwell_table import DwellRow
from gyrobench.bench.bias.statistics import f_p_value
from gyrobench.bench.closure.campaign import Campaign
from gyrobench.bench.closure.candidates import Candidate, stack
from gyrobench.bench.closure.effects.effect import same_for_all_gyros
from gyrobench.bench.closure.problem import SCALE_C, Problem, declared_problem
from gyrobench.bench.closure.quantity import Quantity
from gyrobench.bench.closure.validation import LackOfFit, gyro_correlation, lack_of_fit
from gyrobench.bench.foundations.arrays import BoolArray, FloatArray, rms
from gyrobench.bench.foundations.text import listed
from gyrobench.bench.navigation.positions import AXES

#: A measured bias further from the model than this many standard deviations is an outlier.
OUTLIER_SIGMA = 5.0
#: Median of the absolute value of a standard normal variable.
MEDIAN_ABS_NORMAL = 0.6745
#: If a larger share are outliers, none is down-weighted.
_MAX_OUTLIER_SHARE = 0.1
#: Scatter without structure is noise up to this ratio to the stated uncertainties.
_MAX_SCALE = 1.7
#: The same for one gyro, and its reciprocal for less scatter, if another one scatters as stated, and the
#: p-value below which the scatter of two gyros differs.
_MAX_GYRO_SCALE, _OTHER_P = 5.0, 1e-3
#: p-values below which scatter is larger than stated, and below which it has structure.
_LARGER_P, _STRUCTURE_P = 1e-2, 1e-2
#: Two noise estimates agree if their scales, and their correlation factors, differ by less than these shares.
_SCALE_TOLERANCE, _CORRELATION_TOLERANCE = 0.03, 0.15
_ROUNDS = 30
#: If too many deviate, those beyond this share of the largest deviation become outliers first.
_FARTHEST_SHARE = 0.5
#: A gyro of an outlying dwell is an outlier itself above this share of the dwell's reduction of chi2.
_MIN_GYRO_SHARE = 0.1
_TIME_DEGREE = 5
#: Expected share of outliers; twice the negative log likelihood that an outlier adds, for a standard
#: deviation of ten times the noise.
OUTLIER_SHARE = 0.02
_OUTLIER_COST = 2.0 * math.log(10.0 / OUTLIER_SHARE)
#: Lower limit of the ratio of a residual's variance to that of the noise.
_MIN_RESIDUAL_SHARE = 1e-3


@dataclass(frozen=True)
class Outlier:
    """A measured bias far from the model."""

    dwell: int  #: Number of the dwell.
    gyro: str  #: "x", "y" or "z".
    residual_sigma: float  #: Measured minus model, in standard deviations of the noise.


def outliers_text(outliers: Sequence[Outlier]) -> str:
    """Text of outliers by dwell: "dwell 20 (x +7 sigma)"."""
    by_dwell: dict[int, list[str]] = {}
    for each in outliers:
        by_dwell.setdefault(each.dwell, []).append(f"{each.gyro} {each.residual_sigma:+.0f} sigma")
    return listed([f"dwell {dwell} ({', '.join(gyros)})" for dwell, gyros in sorted(by_dwell.items())])


@dataclass(frozen=True)
class CampaignNoise:
    """Noise of the measured biases of a campaign."""

    #: Shape (3,). Ratio of the noise of each gyro to the stated uncertainties; at least 1 if equal for all.
    scales: FloatArray
    outliers: tuple[Outlier, ...]  #: Farthest first.
    #: Shape (n, 3). Factor on the standard deviation of each bias; 1 except for outliers.
    factors: FloatArray
    correlation_factor: float = 1.0  #: See :attr:`Problem.correlation_factor`.

    @classmethod
    def stated(cls, campaign: Campaign) -> CampaignNoise:
        """The stated uncertainties, without outliers."""
        return cls(np.ones(3), (), np.ones_like(campaign.sigma_dph))

    @property
    def scale(self) -> float:
        """Ratio of the noise to the stated uncertainties, rms over the gyros."""
        return rms(self.scales)

    def problem(self, campaign: Campaign, searched: BoolArray) -> Problem:
        """Declared model of a campaign with this noise."""
        reweighted = campaign.with_uncertainties(campaign.sigma_dph * self.factors)
        return declared_problem(reweighted, searched, self.scales, self.correlation_factor)

    def weighted(self, rows: Sequence[DwellRow]) -> list[DwellRow]:
        """Rows of a dwell table with the standard deviations of outliers increased."""
        by_bias = {(each.dwell, each.gyro): abs(each.residual_sigma) for each in self.outliers}
        factors = [[by_bias.get((row.dwell, axis), 1.0) for axis in AXES] for row in rows]
        return [
            replace(row, sigma_dph=tuple((np.array(row.sigma_dph) * row_factors).tolist()))
            for row, row_factors in zip(rows, factors, strict=True)
        ]

    def sentences(self, quantity: Quantity, *, is_structureless: bool) -> list[str]:
        """Sentences about the ratio to the stated uncertainties and the outliers; empty if as stated.

        ``is_structureless``: whether the residual has no structure.
        """
        sentences = []
        other = np.flatnonzero(self.scales != 1.0)
        if other.size:
            note = "; the residual has no structure" if is_structureless else ""
            subject, ratio = "The noise", f"{self.scale:.2f}"
            if np.ptp(self.scales):
                subject = f"The noise of the {quantity.place([quantity.axes[each] for each in other])}"
                ratio = listed([f"{each:.2f}" for each in self.scales[other].tolist()])
            sentences.append(
                f"{subject} is {ratio} times the stated uncertainties{note}. It is included in the noise "
                "stated here."
            )
        if self.outliers:
            sentences.append(
                f"Further than {OUTLIER_SIGMA:.0f} sigma from the model and down-weighted in the fit: "
                f"{outliers_text(self.outliers)}."
            )
        return sentences

    def cost(self, bic: float, dwells: int) -> float:
        """Twice the negative log likelihood of all dwells, outliers included, plus the BIC penalty.

        ``bic``: of a hypothesis fitted with this noise.
        """
        log_scales = float(np.sum(np.log(self.scales)))
        return bic + 2.0 * dwells * log_scales + _OUTLIER_COST * len(self.outliers)

    def without_effects(self, campaign: Campaign, searched: BoolArray) -> CampaignNoise:
        """The same outliers, with the scales estimated from the residual of the declared model alone."""
        return _with_scales(self, _Model(campaign, searched))[0]

    def is_close_to(self, other: CampaignNoise) -> bool:
        """Whether scales and correlations are about equal and the outliers are the same."""
        is_same_correlation = (
            abs(self.correlation_factor / other.correlation_factor - 1.0) < _CORRELATION_TOLERANCE
        )
        is_same_scale = bool(np.all(np.abs(self.scales / other.scales - 1.0) < _SCALE_TOLERANCE))
        return self.has_same_outliers(other) and is_same_scale and is_same_correlation

    def has_same_outliers(self, other: CampaignNoise) -> bool:
        """Whether the outliers are the same."""
        return np.array_equal(self.factors > 1.0, other.factors > 1.0)


def estimate_campaign_noise(
    campaign: Campaign, searched: BoolArray, effects: Sequence[Candidate] = (), *, smooth: bool = False
) -> CampaignNoise:
    """Estimate the noise of the dwells searched from the residual of the declared model with ``effects``.

    ``campaign`` has the stated uncertainties. The noise is as stated if the residual of the declared model
    alone has structure, since effects may account for it, and if the fit leaves no degrees of freedom.
    ``smooth`` adds functions of time, temperature rate and attitude to the fit, which absorb most of any
    effect.
    """
    added: list[tuple[FloatArray, BoolArray | None]] = [(_smooth_columns(campaign), None)] if smooth else []
    if effects:
        added.append(stack(effects, campaign))
    model = _Model(campaign, searched, added, sum(len(each.values) for each in effects))
    stated = noise = CampaignNoise.stated(campaign)
    if model.fit(stated).dof <= model.parameters:
        return stated  # a fit of as many parameters as measured values leaves no scatter
    is_converged = False
    for _ in range(_ROUNDS):
        updated = _update_outliers(noise, model.fit(noise))
        if np.mean(updated.factors[searched] > 1.0) > _MAX_OUTLIER_SHARE:
            break
        is_converged = updated.is_close_to(noise) and np.allclose(
            updated.factors, noise.factors, rtol=_SCALE_TOLERANCE
        )
        noise = updated
        if is_converged:
            break
    if not is_converged:
        noise = stated
    noise, has_structure = _with_scales(noise, model)
    return stated if has_structure and not added else noise


def outweighing_dwell(campaign: Campaign, searched: BoolArray) -> CampaignNoise:
    """Noise as stated, with one outlier: the dwell whose removal reduces chi2 to less than half, if any.

    Of several such dwells, the one that reduces it most. A gyro with little of the reduction is not an
    outlier: only another gyro of this dwell is.
    """
    problem = CampaignNoise.stated(campaign).problem(campaign, searched)
    deviations_sigma = problem.residuals / np.sqrt(_residual_shares(problem))
    reductions = deviations_sigma**2  # of chi2, without each dwell
    dominant = int(np.argmax(reductions.sum(axis=1)))
    is_outlier = np.zeros(deviations_sigma.shape, dtype=bool)
    if (total := reductions[dominant].sum()) > 0.5 * problem.chi2:
        is_outlier[dominant] = (np.abs(deviations_sigma[dominant]) > OUTLIER_SIGMA) & (
            reductions[dominant] > _MIN_GYRO_SHARE * total
        )
    return _noise_with_outliers(problem, deviations_sigma, is_outlier)


@dataclass(frozen=True)
class _Model:
    """The model about which the measured biases scatter: the declared one with columns added to it."""

    campaign: Campaign  #: With the stated uncertainties.
    searched: BoolArray  #: Shape (n,). The dwells to which it is fitted.
    #: Columns (n, 3, k), and which of them each gyro has (3, k); None for all.
    added: Sequence[tuple[FloatArray, BoolArray | None]] = ()
    parameters: int = 0  #: Number of nonlinear parameters of these columns.

    def fit(self, noise: CampaignNoise) -> Problem:
        """Problem after a fit of all columns with this noise."""
        problem = noise.problem(self.campaign, self.searched)
        for columns, kept in self.added:
            problem = problem.with_columns(columns, kept)
        return problem


def _with_scales(noise: CampaignNoise, model: _Model) -> tuple[CampaignNoise, bool]:
    """Noise with its outliers, scales and correlation of the residual; whether the residual has structure."""
    noise = replace(noise, scales=np.ones(3))
    scales = _gyro_scales(model.fit(noise), model.parameters)
    problem = model.fit(replace(noise, scales=scales))
    problem = replace(problem, correlation_factor=gyro_correlation(problem).factor)
    test = lack_of_fit(problem, model.parameters)
    tests = [test]
    for gyro in np.flatnonzero(scales != 1.0):  # the others would hide structure of this one
        alone = replace(noise, factors=np.where(np.arange(3) == gyro, noise.factors, np.inf))
        tests.append(lack_of_fit(model.fit(alone), model.parameters))
    if min(each.p_any_structure for each in tests) < _STRUCTURE_P:  # an effect also correlates the gyros
        return noise, True
    return replace(
        noise, scales=scales * _scale_of(test), correlation_factor=problem.correlation_factor
    ), False


def _gyro_scales(problem: Problem, parameters: int) -> FloatArray:
    """Ratio (3,) of the scatter of each gyro to that of the others, as stated; 1 where it does not differ.

    It differs from that of the gyro whose scatter is closest to that stated.
    """
    measured = problem.campaign.is_measured[problem.searched].sum(axis=0)
    dof = measured - np.array([basis.shape[1] for basis in problem.bases]) - parameters / 3.0
    tested = np.flatnonzero(dof > 0.0)
    if not tested.size:
        return np.ones(3)
    variances = np.sum(problem.residuals**2, axis=0) / np.maximum(dof, 1.0)
    variances = np.maximum(variances, problem.min_residual_variance)
    reference = tested[np.argmin(np.abs(np.log(variances[tested])))]
    if variances[reference] > _MAX_SCALE**2:
        return np.ones(3)
    differs = np.zeros(3, dtype=bool)
    for gyro in tested:
        larger, smaller = sorted((gyro, reference), key=lambda each: -variances[each])
        p_value = 2.0 * f_p_value(dof[larger], dof[smaller], variances[larger] / variances[smaller])
        differs[gyro] = p_value < _OTHER_P
    common = np.average(variances[~differs], weights=np.maximum(dof[~differs], 0.0))
    scales = np.where(differs, np.sqrt(variances / common), 1.0)
    return np.where((scales > 1.0 / _MAX_GYRO_SCALE) & (scales < _MAX_GYRO_SCALE), scales, 1.0)


def _scale_of(test: LackOfFit) -> float:
    """Ratio of the noise to the stated uncertainties; 1 unless the scatter is larger."""
    is_larger = test.p_noise < _LARGER_P and 1.0 < test.noise_ratio < _MAX_SCALE
    return test.noise_ratio if is_larger else 1.0


def _smooth_columns(campaign: Campaign) -> FloatArray:
    shared = same_for_all_gyros(np.hstack([campaign.slow_time(_TIME_DEGREE), campaign.up_body]))
    by_attitude = campaign.up_body[:, np.newaxis] * campaign.gyro_c[:, :, np.newaxis] / SCALE_C
    return np.concatenate([shared, by_attitude, campaign.rate_c_per_h[:, :, np.newaxis]], axis=2)


def _update_outliers(noise: CampaignNoise, problem: Problem) -> CampaignNoise:
    """Noise with the outliers among the residuals of a ``problem`` that was fitted with ``noise``."""
    searched = problem.searched
    shares = _residual_shares(problem)
    deviations_sigma = problem.residuals * noise.factors[searched] / np.sqrt(shares)
    is_measured = problem.campaign.is_measured[searched]
    for deviations, is_known in zip(deviations_sigma.T, is_measured.T, strict=True):
        median = float(np.median(np.abs(deviations[is_known]))) if is_known.any() else 0.0
        deviations /= max(1.0, median / MEDIAN_ABS_NORMAL)
    is_outlier = np.abs(deviations_sigma) > OUTLIER_SIGMA
    if np.mean(is_outlier) > _MAX_OUTLIER_SHARE:  # the largest may pull the model from other dwells
        was_outlier = noise.factors[searched] > 1.0
        is_outlier &= was_outlier | (
            np.abs(deviations_sigma)
            > _FARTHEST_SHARE * np.abs(deviations_sigma[~was_outlier]).max(initial=0.0)
        )
    return _noise_with_outliers(problem, deviations_sigma, is_outlier)


def _residual_shares(problem: Problem) -> FloatArray:
    """Ratio (m, 3) of the variance of the residuals to that of the noise: 1 minus the leverage of the fit."""
    leverage = np.stack([np.sum(basis**2, axis=1) for basis in problem.bases], axis=1)
    return np.maximum(1.0 - leverage, _MIN_RESIDUAL_SHARE)


def _noise_with_outliers(
    problem: Problem, deviations_sigma: FloatArray, is_outlier: BoolArray
) -> CampaignNoise:
    """Noise with outliers among the dwells searched; ``deviations_sigma`` (m, 3): from the model."""
    campaign, searched = problem.campaign, problem.searched
    factors = np.ones((len(campaign), 3))
    factors[searched] = np.where(is_outlier, np.abs(deviations_sigma), 1.0)
    outliers = [
        Outlier(
            int(campaign.dwell[searched][dwell]),
            campaign.quantity.axes[gyro],
            float(deviations_sigma[dwell, gyro]),
        )
        for dwell, gyro in np.argwhere(is_outlier)
    ]
    outliers.sort(key=lambda each: -abs(each.residual_sigma))
    return CampaignNoise(np.ones(3), tuple(outliers), factors)
