"""Coefficients determined by a joint solution of several positions, in the accelerometers' body frame."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gyrobench.bench.bias.joint_solution import (
    SHARED_ACCELEROMETER_BIAS,
    SHARED_ACCELEROMETER_MATRIX,
    SHARED_COUNT,
    SHARED_GYRO_MATRIX,
    SHARED_NAVIGATION_RATE,
    JointFit,
    JointInformation,
    JointSolution,
    declared_root,
    free_root,
    solve_together,
)
from gyrobench.bench.bias.parameters import PriorKnowledge
from gyrobench.bench.calibration.coefficients import COUNT, LOWER, CoefficientEstimate
from gyrobench.bench.foundations.arrays import FloatArray

#: A coefficient is observed if its standard uncertainty is below this share of its size.
_MAX_RELATIVE_SIGMA = 0.2


def joint_coefficients(solution: JointSolution, prior: PriorKnowledge) -> CoefficientEstimate:
    """Coefficients of the dwells of one plateau, by their navigation output, in the accelerometers' frame.

    The matrices are determined only by the data, without prior knowledge of misalignments and gyro scale
    factors, but with that of latitude, mount and drift of the accelerometers. A gyro's bias is the mean of
    the dwells. ``prior``: as for the solution.
    """
    information = [dwell.information for dwell in solution.dwells]
    root = free_root(declared_root(prior, information[0].earth_rate))
    fit = solve_together(information, root)
    shared = np.arange(SHARED_COUNT)
    lower = np.ravel_multi_index(LOWER, (3, 3))
    chosen = [
        *shared[SHARED_GYRO_MATRIX],
        *shared[SHARED_ACCELEROMETER_BIAS],
        *shared[SHARED_ACCELEROMETER_MATRIX][lower],
    ]
    to_coefficients = np.zeros((COUNT, len(fit.values)))
    to_coefficients[:3, SHARED_COUNT:] = np.tile(np.eye(3), len(information)) / len(information)
    to_coefficients[np.arange(3, COUNT), chosen] = 1.0
    covariance = to_coefficients @ fit.covariance @ to_coefficients.T
    sizes = np.array([np.inf] * 3 + list(np.diag(root)[chosen]))
    return CoefficientEstimate(
        to_coefficients @ fit.values,
        covariance,
        np.sqrt(np.diag(covariance)) < _MAX_RELATIVE_SIGMA * sizes,
        parts=_parts(information, root, fit, to_coefficients),
    )


def _parts(
    information: Sequence[JointInformation], root: FloatArray, fit: JointFit, to_coefficients: FloatArray
) -> dict[str, FloatArray]:
    """Covariances (21, 21) due to the data of the dwells, the latitude, and the assumed sizes."""
    rows = np.vstack([each.joint_rows(number, len(information)) for number, each in enumerate(information)])
    gain = to_coefficients @ fit.covariance @ rows.T
    latitude_response = np.zeros(len(fit.values))
    latitude_response[:SHARED_COUNT] = root[:, SHARED_NAVIGATION_RATE].sum(axis=1)
    latitude = to_coefficients @ latitude_response - gain @ (rows @ latitude_response)
    parts = {"dwells": gain @ gain.T, "latitude": np.outer(latitude, latitude)}
    total = to_coefficients @ fit.covariance @ to_coefficients.T
    return parts | {"assumed_size": total - parts["dwells"] - parts["latitude"]}
