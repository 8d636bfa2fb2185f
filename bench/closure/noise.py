"""Noise of the measured biases: its ratio to the stated uncertainties, and dwells far beyond it.

Noise is what follows nothing: scatter beside a model of which the residual has no structure. Outliers are
down-weighted in the fit: each gets the standard deviation by which it is off.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from gyrobench.bench.bias.dwell_table import DwellRow
from gyrobench.bench.closure.campaign import Campaign
from gyrobench.bench.closure.candidates import Candidate, stack
from gyrobench.bench.closure.problem import SCALE_C, Problem, declared_problem
from gyrobench.bench.closure.validation import LackOfFit, lack_of_fit
from gyrobench.bench.foundations.arrays import BoolArray, FloatArray
from gyrobench.bench.foundations.text import listed
from gyrobench.bench.navigation.positions import AXES

#: A measured bias further from the model than this many standard deviations is an outlier.
OUTLIER_SIGMA = 5.0
#: Median of the absolute value of a standard normal number.
MEDIAN = 0.6745
#: With a larger share the outliers are no exceptions: all count in full.
_MAX_OUTLIERS = 0.1
#: Scatter without structure is noise up to this ratio to the stated uncertainties.
_MAX_SCALE = 1.7
#: p-values: below them, scatter is larger than stated, and has structure.
_LARGER_P, _STRUCTURE_P = 1e-2, 1e-2
#: Noises are the same if their scales differ by less than this share.
_SAME = 0.03
_ROUNDS = 30
#: Where too many are off, those within this share of the farthest one become outliers first.
_FARTHEST = 0.5
#: Share of a dwell's reduction of chi2 from which on a gyro is off itself.
_OWN_SHARE = 0.1
_TIME_DEGREE = 5
#: Share of outliers, and twice the negative log likelihood of one beyond that of other dwells: ten times the
#: noise.
OUTLIER_SHARE = 0.02
_OUTLIER_COST = 2.0 * math.log(10.0 / OUTLIER_SHARE)
#: Of the variance of a residual in that of the noise, at least.
_MIN_SHARE = 1e-3


@dataclass(frozen=True)
class Outlier:
    """A measured bias far from the model."""

    dwell: int  #: Number of the dwell.
    gyro: str  #: "x", "y" or "z".
    residual_sigma: float  #: Measured minus model, in standard deviations of the noise.


def outliers_text(outliers: Sequence[Outlier]) -> str:
    """Name outliers by dwell: "dwell 20 (x +7 sigma)"."""
    off: dict[int, list[str]] = {}
    for each in outliers:
        off.setdefault(each.dwell, []).append(f"{each.gyro} {each.residual_sigma:+.0f} sigma")
    return listed([f"dwell {dwell} ({', '.join(gyros)})" for dwell, gyros in sorted(off.items())])


@dataclass(frozen=True)
class CampaignNoise:
    """Noise of the measured biases of a campaign."""

    scale: float  #: Ratio of the noise to the stated uncertainties; at least 1.
    outliers: tuple[Outlier, ...]  #: Farthest first.
    #: Shape (n, 3). Ratio of the standard deviation used for an outlier to that of its noise; 1 for others.
    factors: FloatArray

    @classmethod
    def stated(cls, campaign: Campaign) -> CampaignNoise:
        """As stated, without outliers."""
        return cls(1.0, (), np.ones_like(campaign.sigma_dph))

    def problem(self, campaign: Campaign, searched: BoolArray) -> Problem:
        """Declared model of a campaign with this noise."""
        weighted = campaign.with_uncertainties(campaign.sigma_dph * self.factors)
        return declared_problem(weighted, searched, self.scale)

    def weighted(self, rows: Sequence[DwellRow]) -> list[DwellRow]:
        """Rows of a dwell table with the standard deviations used for outliers."""
        off = {(each.dwell, each.gyro): abs(each.residual_sigma) for each in self.outliers}
        factors = [[off.get((row.dwell, axis), 1.0) for axis in AXES] for row in rows]
        return [
            replace(row, sigma_dph=tuple((np.array(row.sigma_dph) * mine).tolist()))
            for row, mine in zip(rows, factors, strict=True)
        ]

    def sentences(self, *, is_all: bool) -> list[str]:
        """The ratio to the stated uncertainties and the outliers; empty if there are none.

        ``is_all``: whether the residual has no structure.
        """
        sentences = []
        if self.scale > 1.0:
            left = "; what is left follows nothing" if is_all else ""
            sentences.append(
                f"The noise is {self.scale:.2f} times the stated uncertainties{left}. It is included in the "
                "noise stated here."
            )
        if self.outliers:
            sentences.append(
                f"Further than {OUTLIER_SIGMA:.0f} sigma from the model and down-weighted in the fit: "
                f"{outliers_text(self.outliers)}."
            )
        return sentences

    def cost(self, bic: float, dwells: int) -> float:
        """Twice the negative log likelihood of all dwells, outliers included, beside a hypothesis.

        ``bic``: of the hypothesis in this noise.
        """
        return bic + 3 * dwells * 2.0 * math.log(self.scale) + _OUTLIER_COST * len(self.outliers)

    def beside_none(self, campaign: Campaign, searched: BoolArray) -> CampaignNoise:
        """The same outliers with the scale that the dwells searched show beside the declared model alone."""
        alone = replace(self, scale=1.0)
        return replace(self, scale=_scale(lack_of_fit(alone.problem(campaign, searched), 0)))

    def is_like(self, other: CampaignNoise) -> bool:
        """Whether the scales are about equal and the outliers are the same."""
        return self.has_outliers_of(other) and abs(self.scale / other.scale - 1.0) < _SAME

    def has_outliers_of(self, other: CampaignNoise) -> bool:
        """Whether the outliers are the same."""
        return np.array_equal(self.factors > 1.0, other.factors > 1.0)


def estimate_campaign_noise(
    campaign: Campaign, searched: BoolArray, effects: Sequence[Candidate] = (), *, smooth: bool = False
) -> CampaignNoise:
    """Noise of the dwells searched, beside the declared model and effects.

    ``campaign`` has the stated uncertainties. Where the residual of the declared model alone has structure,
    the noise is as stated: effects may account for it. So it is where the fit leaves no degree of freedom.
    ``smooth`` adds functions of time, temperature rate and attitude that take up most of any effect.
    """
    extra: list[tuple[FloatArray, BoolArray | None]] = [(_smooth(campaign), None)] if smooth else []
    if effects:
        extra.append(stack(effects, campaign))
    stated = noise = CampaignNoise.stated(campaign)
    parameters = sum(len(each.values) for each in effects)
    if _fitted(stated, campaign, searched, extra).dof <= parameters:
        return stated  # a fit of as many parameters as measured values leaves no scatter
    is_settled = False
    for _ in range(_ROUNDS):
        after = _fitted(noise, campaign, searched, extra)
        updated = _with_outliers(noise, after)
        if np.mean(updated.factors[searched] > 1.0) > _MAX_OUTLIERS:
            break
        is_settled = updated.is_like(noise) and np.allclose(updated.factors, noise.factors, rtol=_SAME)
        noise = updated
        if is_settled:
            break
    if not is_settled:
        noise, after = stated, _fitted(stated, campaign, searched, extra)
    test = lack_of_fit(after, parameters)
    if test.p_any_structure < _STRUCTURE_P and not extra:
        return stated
    return replace(noise, scale=_scale(test))


def outweighing_dwell(campaign: Campaign, searched: BoolArray) -> CampaignNoise:
    """Noise as stated, with the dwell as outlier without which chi2 is less than half, if there is one.

    Where several are, the one without which it is least. A gyro with little of the reduction is none: it
    may only stand beside an outlier.
    """
    problem = CampaignNoise.stated(campaign).problem(campaign, searched)
    off = problem.residuals / np.sqrt(_shares_left(problem))
    reductions = off**2  # of chi2, without each dwell
    first = int(np.argmax(reductions.sum(axis=1)))
    is_outlier = np.zeros(off.shape, dtype=bool)
    if (total := reductions[first].sum()) > 0.5 * problem.chi2:
        is_outlier[first] = (np.abs(off[first]) > OUTLIER_SIGMA) & (reductions[first] > _OWN_SHARE * total)
    return _of_outliers(problem, off, is_outlier)


def _scale(test: LackOfFit) -> float:
    """Ratio of the noise to the stated uncertainties, where scatter without structure shows one."""
    is_larger = test.p_noise < _LARGER_P and 1.0 < test.noise_ratio < _MAX_SCALE
    return test.noise_ratio if is_larger and test.p_any_structure >= _STRUCTURE_P else 1.0


def _fitted(
    noise: CampaignNoise,
    campaign: Campaign,
    searched: BoolArray,
    extra: Sequence[tuple[FloatArray, BoolArray | None]],
) -> Problem:
    """The problem after a fit of further columns, with those of their terms that are kept."""
    after = noise.problem(campaign, searched)
    for columns, kept in extra:
        after = after.with_columns(columns, kept)
    return after


def _smooth(campaign: Campaign) -> FloatArray:
    common = np.repeat(
        np.hstack([campaign.slow_time(_TIME_DEGREE), campaign.up_body])[:, np.newaxis], 3, axis=1
    )
    by_attitude = campaign.up_body[:, np.newaxis] * campaign.gyro_c[:, :, np.newaxis] / SCALE_C
    return np.concatenate([common, by_attitude, campaign.rate_c_per_h[:, :, np.newaxis]], axis=2)


def _with_outliers(noise: CampaignNoise, after: Problem) -> CampaignNoise:
    """Same noise with the outliers of the residuals of a problem that has it."""
    searched = after.searched
    shares = _shares_left(after)
    off = after.residuals * noise.factors[searched] / np.sqrt(shares)
    off /= max(1.0, float(np.median(np.abs(off))) / MEDIAN)
    is_outlier = np.abs(off) > OUTLIER_SIGMA
    if np.mean(is_outlier) > _MAX_OUTLIERS:  # the farthest ones may pull the model away from others
        is_known = noise.factors[searched] > 1.0
        is_outlier &= is_known | (np.abs(off) > _FARTHEST * np.abs(off[~is_known]).max(initial=0.0))
    return _of_outliers(after, off, is_outlier)


def _shares_left(after: Problem) -> FloatArray:
    """Variance of the residuals of a problem (m, 3) in that of the noise: what the fit does not take up."""
    leverage = np.stack([np.sum(basis**2, axis=1) for basis in after.bases], axis=1)
    return np.maximum(1.0 - leverage, _MIN_SHARE)


def _of_outliers(problem: Problem, off: FloatArray, is_outlier: BoolArray) -> CampaignNoise:
    """Noise with outliers among the dwells searched, which are this far off (m, 3), in sigma."""
    campaign, searched = problem.campaign, problem.searched
    factors = np.ones((len(campaign), 3))
    factors[searched] = np.where(is_outlier, np.abs(off), 1.0)
    outliers = [
        Outlier(int(campaign.dwell[searched][dwell]), campaign.quantity.axes[gyro], float(off[dwell, gyro]))
        for dwell, gyro in np.argwhere(is_outlier)
    ]
    return CampaignNoise(1.0, tuple(sorted(outliers, key=lambda each: -abs(each.residual_sigma))), factors)
