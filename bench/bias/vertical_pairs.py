"""Separates the biases of vertical gyros from a rate Up fixed in the navigation frame.

A gyro with bias ``b`` measures ``b + u`` when it points up and ``b - u`` when it points down, if
the navigation frame has an undeclared rate ``u`` Up. If the bias is the same up and down, half the sum is
the bias and half the difference the rate. Three gyros give three values of one ``u``: if they agree, a common
cause is likely; if not, biases differ between up and down and nothing follows. An error of the latitude also
causes a rate North, in a fixed proportion, which the level gyros measure independently of their biases.

A bias that follows gravity by the same amount in every gyro, as by a flaw of their design, has the same
half-differences. But it causes no rate North, and hardly stays the same over temperature; hence the
comparison with the rate North and the pooling of temperatures. If the rate North is weak evidence (near the
equator, or because the rates are small), the two are not separable.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import Enum

import numpy as np

from gyrobench.bench.bias.statistics import chi2_p_value
from gyrobench.bench.foundations.arrays import FloatArray

#: Measurements contradict a hypothesis if their p-value is smaller.
_MIN_P_VALUE = 0.01

# A rate North must exceed zero by this number of sigmas to confirm a latitude error.
_MIN_SIGNIFICANCE = 3.0
# A latitude is off if its error exceeds this number of sigmas, and this multiple of the declared one.
_MIN_ERROR_SIGMAS, _MAX_DECLARED = 4.0, 2.0


class Finding(Enum):
    """Interpretation of the half-differences of the vertical gyros; the value is its text."""

    NO_PAIR = "no gyro was vertical both up and down"
    ONE_GYRO = (
        "only one gyro was vertical both up and down, so a rate is not separable from a bias that differs "
        "up and down"
    )
    DIFFERENT = (
        "the half-differences of up and down disagree: biases differ up and down, so a rate is not "
        "separable from them"
    )
    NOT_LATITUDE = (
        "the half-differences of up and down agree, but the rate North contradicts an error of the "
        "latitude: biases that follow gravity alike in all gyros would look the same"
    )
    NOT_CONTRADICTED = (
        "the half-differences of up and down agree; the rate North neither contradicts nor confirms an "
        "error of the latitude"
    )
    LATITUDE = (
        "the half-differences of up and down agree, and the rate North confirms an error of the latitude"
    )
    LATITUDE_OFF = (
        "the half-differences of up and down agree, and the rate North confirms that the latitude is off by "
        "more than its declared uncertainty. The biases of vertical gyros are corrected for it; correct the "
        "latitude in station file and INS"
    )


@dataclass(frozen=True, eq=False)
class VerticalPairs:
    """Half-differences of the vertical gyros' estimates up and down at one temperature, SI."""

    gyros: tuple[int, ...]  #: The p gyros that were vertical both up and down.
    #: half_difference, covariance: Shape (p,), (p, p). Half of up minus down; the covariance includes the
    #: effect of different temperatures up and down.
    half_difference: FloatArray
    covariance: FloatArray
    #: For each gyro, by dwell number: weight of the dwell's vertical bias in the half-difference.
    weights: tuple[Mapping[int, float], ...]
    #: north_rate, north_variance: Rate North fixed in the navigation frame, from the level gyros.
    north_rate: float
    north_variance: float
    north_covariance: FloatArray  #: Shape (p,). Of the rate North with the half-differences.


@dataclass(frozen=True, eq=False)
class UpRate:
    """Rate Up fixed in the navigation frame, if the biases are the same up and down; SI."""

    #: rate, sigma: Weighted mean of the half-differences, rad/s; NaN without any.
    rate: float
    sigma: float
    weights: Mapping[int, float]  #: By dwell number: weight of the dwell's vertical bias in the rate.
    #: Test that the half-differences are equal; NaN if there is nothing to compare. With several
    #: temperatures the smallest of three p-values times their number, against arbitrary values, one value for
    #: each gyro and one for each temperature: a small difference over many temperatures hides in the first.
    p_value: float
    #: latitude_error, latitude_sigma: Of the latitude that the INS uses, rad, from the rates Up and North
    #: together.
    latitude_error: float
    latitude_sigma: float
    finding: Finding

    @property
    def applies(self) -> bool:
        """Whether the vertical biases should be corrected for the rate."""
        return self.finding in (Finding.LATITUDE, Finding.LATITUDE_OFF, Finding.NOT_CONTRADICTED)

    def exceeds(self, declared_latitude: float) -> bool:
        """Whether the latitude error is significantly larger than this declared uncertainty, rad."""
        return exceeds_declared(self.latitude_error, self.latitude_sigma, declared_latitude)


def exceeds_declared(error: float, sigma: float, declared: float) -> bool:
    """Whether a latitude error is significant, and larger than its declared uncertainty allows."""
    return abs(error) > max(_MIN_ERROR_SIGMAS * sigma, _MAX_DECLARED * declared)


def up_rate(
    groups: Sequence[VerticalPairs], earth_rate: FloatArray, declared_latitude: float = math.inf
) -> UpRate:
    """Rate Up from the half-differences at one or several temperatures, a group each.

    Temperatures count as independent; the common effect of gyro scale factors is far below the noise.
    ``earth_rate`` (3,): rotation of the Earth in ENU, rad/s; ``declared_latitude``: standard uncertainty,
    rad.
    """
    groups = [group for group in groups if group.gyros]
    if not groups:
        return _NO_RATE
    inverses = [np.asarray(np.linalg.inv(group.covariance)) for group in groups]
    total = math.fsum(float(inverse.sum()) for inverse in inverses)
    weights_of_groups = [inverse.sum(axis=0) / total for inverse in inverses]
    chi2, dof = _scatter(groups, inverses, [np.zeros(len(group.gyros)) for group in groups])
    p_value = _p_value(chi2, dof)
    if len(groups) > 1:
        by_gyro = _scatter(groups, inverses, [np.array(group.gyros, float) for group in groups])
        alternatives = [by_gyro, _scatter_within_groups(groups, inverses)]
        p_value = _combined_p_value(
            p_value, *(_p_value(chi2 - part, dof - free) for part, free in alternatives)
        )
    gyros = {gyro for group in groups for gyro in group.gyros}
    latitude = _latitude_error(*_north_and_up(groups, weights_of_groups), earth_rate)
    return UpRate(
        rate=math.fsum(
            float(part @ group.half_difference) for part, group in zip(weights_of_groups, groups, strict=True)
        ),
        sigma=total**-0.5,
        weights={
            dwell: float(part * weight)
            for group, weights in zip(groups, weights_of_groups, strict=True)
            for part, of_pair in zip(weights, group.weights, strict=True)
            for dwell, weight in of_pair.items()
        },
        p_value=p_value,
        latitude_error=latitude.error,
        latitude_sigma=latitude.sigma,
        finding=_finding(len(gyros), p_value, latitude, declared_latitude),
    )


@dataclass(frozen=True)
class _LatitudeError:
    """``significance``: number of sigmas by which only the rate Up would contradict a latitude error."""

    error: float
    sigma: float
    p_value: float
    significance: float


def _scatter(
    groups: Sequence[VerticalPairs], inverses: Sequence[FloatArray], labels: Sequence[FloatArray]
) -> tuple[float, int]:
    """Chi-square about one mean for each label, weighted by inverse covariances, and degrees of freedom.

    ``labels``: of the half-differences of each group.
    """
    distinct = np.unique(np.concatenate(labels))
    designs = [(each[:, np.newaxis] == distinct).astype(float) for each in labels]
    normal, right_side = np.zeros((len(distinct), len(distinct))), np.zeros(len(distinct))
    for group, inverse, design in zip(groups, inverses, designs, strict=True):
        normal += design.T @ inverse @ design
        right_side += design.T @ inverse @ group.half_difference
    means = np.linalg.solve(normal, right_side)
    residuals = [group.half_difference - each @ means for group, each in zip(groups, designs, strict=True)]
    chi2 = math.fsum(float(each @ inverse @ each) for each, inverse in zip(residuals, inverses, strict=True))
    return chi2, sum(len(each) for each in residuals) - len(distinct)


def _scatter_within_groups(
    groups: Sequence[VerticalPairs], inverses: Sequence[FloatArray]
) -> tuple[float, int]:
    """Chi-square about one mean for each group, and degrees of freedom."""
    scatters = [
        _scatter([group], [inverse], [np.zeros(len(group.gyros))])
        for group, inverse in zip(groups, inverses, strict=True)
    ]
    return math.fsum(chi2 for chi2, _ in scatters), sum(dof for _, dof in scatters)


def _p_value(chi2: float, dof: int) -> float:
    return chi2_p_value(dof, chi2) if dof else math.nan


def _combined_p_value(*p_values: float) -> float:
    """Smallest p-value, corrected for the number of tests (Bonferroni); NaN is ignored."""
    distinct = [each for each in p_values if not math.isnan(each)]
    return min(1.0, len(distinct) * min(distinct)) if distinct else math.nan


def _north_and_up(
    groups: Sequence[VerticalPairs], up_weights: Sequence[FloatArray]
) -> tuple[FloatArray, FloatArray]:
    """Rates North and Up (2,), weighted means of the groups, and their covariance (2, 2)."""
    north_weights = np.array([1.0 / group.north_variance for group in groups])
    north_weights /= north_weights.sum()
    rates, covariance = np.zeros(2), np.zeros((2, 2))
    for group, north, up in zip(groups, north_weights, up_weights, strict=True):
        rates += north * group.north_rate, up @ group.half_difference
        mixed = north * (up @ group.north_covariance)
        covariance += [[north**2 * group.north_variance, mixed], [mixed, up @ group.covariance @ up]]
    return rates, covariance


def _latitude_error(rates: FloatArray, covariance: FloatArray, earth_rate: FloatArray) -> _LatitudeError:
    """Latitude error that best explains the rates North and Up."""
    response = np.array([earth_rate[2], -earth_rate[1]])
    weighted = np.linalg.solve(covariance, response)
    variance = 1.0 / float(response @ weighted)
    error = float(weighted @ rates) * variance
    # A latitude error causes no rate along the axis of the Earth.
    axis = earth_rate[1:]
    axis_sigma = float(np.sqrt(axis @ covariance @ axis))
    significance = (axis @ rates) / axis_sigma
    return _LatitudeError(
        error=error,
        sigma=math.sqrt(variance),
        p_value=_p_value(float(significance**2), 1),
        significance=float(abs(axis[1] * rates[1]) / axis_sigma),
    )


def _finding(gyros: int, p_value: float, latitude: _LatitudeError, declared: float) -> Finding:
    if gyros == 1:
        return Finding.ONE_GYRO
    if p_value < _MIN_P_VALUE:
        return Finding.DIFFERENT
    if latitude.p_value < _MIN_P_VALUE:
        return Finding.NOT_LATITUDE
    if latitude.significance <= _MIN_SIGNIFICANCE:
        return Finding.NOT_CONTRADICTED
    is_off = exceeds_declared(latitude.error, latitude.sigma, declared)
    return Finding.LATITUDE_OFF if is_off else Finding.LATITUDE


_NO_RATE = UpRate(math.nan, math.nan, {}, math.nan, math.nan, math.nan, Finding.NO_PAIR)
