"""Is a gyro's bias the same in all positions? The question of a rotational INS, bin by bin."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from gyrobench.bench.bias.bins import BiasBin
from gyrobench.bench.bias.weighted_mean import weighted_mean


@dataclass(frozen=True)
class PositionComparison:
    """Positions compared for one gyro in one temperature bin.

    Attributes
    ----------
    gyro : str
        "x", "y" or "z".
    bin_low_c, bin_high_c : float
        Range of the gyro's temperature.
    positions : tuple of str
        Those measured in this bin, two or more.
    bias_dph : float
        Weighted mean over the positions.
    p_value : float
        Probability of differences at least as large if the positions were equal: the chi-square
        test of homogeneity with ``len(positions) - 1`` degrees of freedom.
    largest_pair : tuple of str
        The two positions that differ most, the higher bias first.
    largest_difference_dph, largest_difference_sigma_dph : float
        By how much, and its standard uncertainty.
    temperature_spread_c : float
        Largest difference of the positions' mean temperatures inside the bin. The test takes no
        account of it: the bias's own slope times this can pass for a difference of positions.
    """

    gyro: str
    bin_low_c: float
    bin_high_c: float
    positions: tuple[str, ...]
    bias_dph: float
    p_value: float
    largest_pair: tuple[str, str]
    largest_difference_dph: float
    largest_difference_sigma_dph: float
    temperature_spread_c: float


def compare_positions(bins: Iterable[BiasBin]) -> list[PositionComparison]:
    """Compare the positions of each gyro and bin; bins with fewer than two positions are left out.

    Parameters
    ----------
    bins : iterable of BiasBin
        Of one unit, in any order; :func:`gyrobench.bench.bias.bins.paper_bins` for the paper's method.

    Returns
    -------
    list of PositionComparison
        By gyro and temperature.
    """
    groups: dict[tuple[str, float], list[BiasBin]] = defaultdict(list)
    for each in bins:
        if not each.is_empty:
            groups[each.gyro, each.bin_low_c].append(each)
    return [_compared(group) for _, group in sorted(groups.items()) if len(group) > 1]


def _compared(group: Sequence[BiasBin]) -> PositionComparison:
    mean = weighted_mean([each.bias_dph for each in group], [each.sigma_dph for each in group])
    pairs = combinations(sorted(group, key=lambda each: -each.bias_dph), 2)
    high, low = max(pairs, key=lambda pair: pair[0].bias_dph - pair[1].bias_dph)
    return PositionComparison(
        gyro=group[0].gyro,
        bin_low_c=group[0].bin_low_c,
        bin_high_c=group[0].bin_high_c,
        positions=tuple(each.position for each in group),
        bias_dph=mean.value,
        p_value=mean.p_value,
        largest_pair=(high.position, low.position),
        largest_difference_dph=high.bias_dph - low.bias_dph,
        largest_difference_sigma_dph=float(np.hypot(high.sigma_dph, low.sigma_dph)),
        temperature_spread_c=float(np.ptp([each.temperature_c for each in group])),
    )
