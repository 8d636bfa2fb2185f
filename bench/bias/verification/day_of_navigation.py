"""What the biases measured in six positions would do to a rotational INS in a day."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from gyrobench.bench.bias.dwell_table import DwellRow
from gyrobench.bench.bias.weighted_mean import weighted_mean
from gyrobench.bench.foundations.arrays import FloatArray
from gyrobench.bench.foundations.errors import MeasurementError
from gyrobench.bench.navigation.error_model import Site
from gyrobench.bench.navigation.positions import AXES, POSITIONS
from gyrobench.bench.navigation.rotational_ins import (
    DAY_S,
    NAUTICAL_MILE_M,
    SIX_POSITIONS,
    PositionError,
    RotationScheme,
    bias_by_position,
    rotate_for,
)

_UNIT_DPH = 0.001


@dataclass(frozen=True, eq=False)
class DayOfNavigation:
    """Errors of a day, and how much of them the uncertainty of the biases explains.

    Attributes
    ----------
    error : PositionError
        With the biases as measured; those that are the same in all positions average out.
    noise_nmi : float
        What biases that are the same in all positions would show in its place: the largest rms
        distance that the uncertainties of the measured ones alone give.
    """

    error: PositionError
    noise_nmi: float


def day_of_navigation(
    rows: Iterable[DwellRow], site: Site, scheme: RotationScheme = SIX_POSITIONS
) -> DayOfNavigation:
    """Turn the biases of one temperature by a scheme for a day.

    Parameters
    ----------
    rows : iterable of DwellRow
        Dwells in all six positions; several in one position are averaged, those with flags are
        left out.

    Raises
    ------
    MeasurementError
        A position was not measured.
    """
    good = [row for row in rows if not row.flags]
    missing = POSITIONS.keys() - {row.position for row in good}
    if missing:
        raise MeasurementError(
            f"a day of navigation needs all six positions; no bias in {', '.join(sorted(missing))}"
        )
    means = {name: _mean([row for row in good if row.position == name]) for name in POSITIONS}
    error = rotate_for(
        DAY_S, scheme, bias_by_position({name: mean for name, (mean, _) in means.items()}), site
    )
    sigmas = np.array([means[name][1] for name in POSITIONS]).ravel()
    distances_m = np.hypot(*np.einsum("k,kct->ct", sigmas**2, _responses(site, scheme) ** 2) ** 0.5)
    return DayOfNavigation(error, float(distances_m.max()) / NAUTICAL_MILE_M)


def _mean(rows: list[DwellRow]) -> tuple[FloatArray, FloatArray]:
    """Bias of each gyro in one position and its standard uncertainty, deg/h."""
    means = [
        weighted_mean([row.bias_dph[axis] for row in rows], [row.sigma_dph[axis] for row in rows])
        for axis in range(len(AXES))
    ]
    return np.array([mean.value for mean in means]), np.array([mean.sigma for mean in means])


@lru_cache(maxsize=4)
def _responses(site: Site, scheme: RotationScheme) -> FloatArray:
    """Way East and North, m per deg/h, for each gyro in each position: shape (18, 2, n)."""
    responses = []
    for name in POSITIONS:
        for unit in _UNIT_DPH * np.eye(3):
            alone = dict.fromkeys(POSITIONS, np.zeros(3)) | {name: unit}
            error = rotate_for(DAY_S, scheme, bias_by_position(alone), site)
            responses.append([error.east_m / _UNIT_DPH, error.north_m / _UNIT_DPH])
    return np.array(responses)
