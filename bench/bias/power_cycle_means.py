"""Positions compared in a temperature bin whose dwells come from several power cycles.

Each power-on gives a gyro another bias. Where the positions of a bin were measured in different power
cycles, as after a resume in the middle of a plateau, that change would pass for a difference of positions. A
constant for each power cycle takes it out: positions are compared within power cycles, and across them only
as far as positions that were measured in several connect them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import permutations

import numpy as np

from gyrobench.bench.bias.statistics import chi2_p_value
from gyrobench.bench.foundations.arrays import FloatArray

_ZERO = 1e-9


@dataclass(frozen=True)
class PowerCycleMean:
    """Mean bias of the dwells of one position, bin and power cycle, deg/h."""

    number: int  #: Of the power cycle in the table, from 1.
    bias_dph: float
    sigma_dph: float
    #: paper_bias_dph, paper_sigma_dph: By the paper's method; NaN where there is none.
    paper_bias_dph: float = math.nan
    paper_sigma_dph: float = math.nan

    @property
    def by_paper(self) -> PowerCycleMean:
        """The paper's in the place of the other."""
        return PowerCycleMean(self.number, self.paper_bias_dph, self.paper_sigma_dph)


@dataclass(frozen=True)
class ConnectedComparison:
    """Comparison of the positions of a bin with a constant for each power cycle."""

    #: dof, p_value: Of the chi-square test of equal positions; none compared is dof 0 and NaN.
    dof: int
    p_value: float
    #: pair, difference_dph, sigma_dph: The largest difference of two positions that are connected.
    pair: tuple[str, str]
    difference_dph: float
    sigma_dph: float
    are_all_connected: bool  #: Whether every position is compared with every other.


def compare_over_power_cycles(means: Sequence[tuple[str, PowerCycleMean]]) -> ConnectedComparison:
    """Compare positions by their means in each power cycle."""
    positions = list(dict.fromkeys(position for position, _ in means))
    cycles = list(dict.fromkeys(each.number for _, each in means))
    constants = np.array([[each.number == cycle for cycle in cycles] for _, each in means], dtype=np.float64)
    of_positions = np.array([[name == each for each in positions] for name, _ in means], dtype=np.float64)
    design = np.hstack([of_positions, constants])
    sigma_dph = np.array([each.sigma_dph for _, each in means])
    data = np.array([each.bias_dph for _, each in means]) / sigma_dph

    def solved(columns: FloatArray) -> tuple[FloatArray, float]:
        rows = columns / sigma_dph[:, np.newaxis]
        values = np.linalg.lstsq(rows, data)[0]
        return values, float(((data - rows @ values) ** 2).sum())

    values, chi2 = solved(design)
    dof = int(np.linalg.matrix_rank(design)) - len(cycles)
    p_value = chi2_p_value(dof, solved(constants)[1] - chi2) if dof else math.nan
    rows = design / sigma_dph[:, np.newaxis]
    covariance = np.linalg.pinv(rows.T @ rows)
    reachable = np.linalg.pinv(design) @ design  # projects on what the data determine
    found = ("", ""), -math.inf, math.nan
    are_all_connected = True
    for a, b in permutations(range(len(positions)), 2):
        contrast = np.zeros(design.shape[1])
        contrast[[a, b]] = 1.0, -1.0
        if np.abs(reachable @ contrast - contrast).max() > _ZERO:
            are_all_connected = False
        elif (difference := float(contrast @ values)) > found[1]:
            found = (positions[a], positions[b]), difference, math.sqrt(contrast @ covariance @ contrast)
    return ConnectedComparison(dof, p_value, *found, are_all_connected)
