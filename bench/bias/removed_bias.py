"""Detects an INS that removes in each alignment the gyro biases that it finds there.

At rest an alignment shows the bias of the gyro along North by the tilt, and that along Up if the rates are
compared with the Earth's. An INS that subtracts them navigates with those of the other directions alone: a
gyro seems to have its bias where it points East in the alignment, and none where it points North. Every dwell
fits well, and the differences look like biases that depend on the position.

The mean biases of each attitude, resolved in the directions of the alignment, are compared with two models.
In both a gyro has one bias in all attitudes; what a position adds scatters, by one amount in the removed
directions and by another in the rest. In the second model the biases are zero in the removed directions, but
for the noise of the alignment.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Sequence

import numpy as np

from gyrobench.bench.bias.dwell_table import DwellRow, noise_and_common
from gyrobench.bench.foundations.arrays import BoolArray, FloatArray
from gyrobench.bench.navigation.positions import POSITIONS

#: Directions that an INS may remove together, each by its name: those of which it knows the rate.
_DIRECTIONS = {
    "North": [False, True, False],
    "Up": [False, False, True],
    "North and Up": [False, True, True],
    "East and North": [True, True, False],
}
#: Biases are removed if twice the log-likelihood is larger by this much.
_MIN_GAIN = 16.0
#: Largest standard deviation of what an alignment leaves of a bias, in those of a dwell.
_MAX_LEFT = 3.0
#: Standard deviations of what positions add to a bias, relative to that of a dwell's bias; prior size of a
#: bias, which keeps the problem regular where no direction shows a gyro.
_SCATTERS, _BIAS_SIZE = np.concatenate([[0.0], np.geomspace(0.3, 100.0, 24)]), 1e3
#: Two azimuths are one attitude if they agree to this, deg.
_AZIMUTH_STEP_DEG = 5.0


def removed_directions(rows: Sequence[DwellRow]) -> str:
    """Directions in which the INS removes the biases; empty if it seems to remove none.

    ``rows``: dwells of one unit, each after an alignment at its azimuth; those without one do not count.
    """
    rows = [row for row in rows if math.isfinite(sum(row.bias_dph) + row.azimuth_deg)]
    if not rows:
        return ""
    values, variances, C_nb = _attitudes(rows)
    unit = float(np.sqrt(np.median(variances)))
    data = values / unit, variances / unit**2, C_nb
    gains = {
        name: 2.0 * (_log_likelihood(*data, removed, True) - _log_likelihood(*data, removed, False))
        for name, removed in ((name, np.array(mask)) for name, mask in _DIRECTIONS.items())
    }
    best = max(gains, key=lambda name: gains[name])
    return best if gains[best] > _MIN_GAIN else ""


def _attitudes(rows: Sequence[DwellRow]) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Mean biases and their variances, both (k, 3) in ENU, and attitudes (k, 3, 3) in the alignment."""
    groups: dict[tuple[str, int], list[DwellRow]] = defaultdict(list)
    for row in rows:
        groups[row.position, round(row.azimuth_deg % 360.0 / _AZIMUTH_STEP_DEG)].append(row)
    values, variances, attitudes = [], [], []
    for (position, _), group in groups.items():
        noise, common = noise_and_common(group)
        weights = noise**-2.0
        biases = np.array([row.bias_dph for row in group])
        C_nb = POSITIONS[position].C_nb(math.radians(group[0].azimuth_deg))
        values.append(C_nb @ ((weights * biases).sum(axis=0) / weights.sum(axis=0)))
        variances.append(C_nb**2 @ (1.0 / weights.sum(axis=0) + (common**2).mean(axis=0)))
        attitudes.append(C_nb)
    return np.array(values), np.array(variances), np.array(attitudes)


def _log_likelihood(
    values: FloatArray, variances: FloatArray, C_nb: FloatArray, removed: BoolArray, are_zero: bool
) -> float:
    """Largest log-likelihood over the biases of the gyros and both scatters, in units of a dwell's bias.

    ``removed`` (3,): which directions; ``are_zero``: whether the biases there are zero.
    """
    rest, elsewhere = np.meshgrid(
        _SCATTERS[_SCATTERS <= _MAX_LEFT] if are_zero else _SCATTERS, _SCATTERS, indexing="ij"
    )
    scatter = np.where(removed, rest.reshape(-1, 1, 1), elsewhere.reshape(-1, 1, 1))
    weights = (1.0 / (variances + scatter**2)).reshape(len(scatter), -1)
    design = (C_nb * ~removed[:, np.newaxis] if are_zero else C_nb).reshape(-1, 3)
    data = values.ravel()
    normal = np.einsum("gn,ni,nj->gij", weights, design, design) + np.eye(3) / _BIAS_SIZE**2
    biases = np.linalg.solve(normal, ((weights * data) @ design)[..., np.newaxis])[..., 0]
    squares = (data - biases @ design.T) ** 2
    return float(0.5 * np.max(np.log(weights).sum(axis=1) - (weights * squares).sum(axis=1)))
