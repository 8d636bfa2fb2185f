"""The coefficients that a joint solution of several positions determines, in the body frame of the others."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gyrobench.bench.bias.joint_solution import (
    SHARED,
    SHARED_ACCELEROMETER_BIAS,
    SHARED_ACCELEROMETER_MATRIX,
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

#: A coefficient is observed if the data leave less than this part of its size.
_MAX_LEFT = 0.2


def joint_coefficients(solution: JointSolution, prior: PriorKnowledge) -> CoefficientEstimate:
    """Coefficients of the dwells of one plateau, by their navigation output, in the accelerometers' frame.

    Matrices are as the data alone give them: what is known beforehand of misalignments and scale factors of
    the gyros is left out, what is known of latitude, mount and drift of the accelerometers is not. A gyro's
    bias is the mean of the dwells. ``prior``: as for the solution.
    """
    information = [dwell.information for dwell in solution.dwells]
    root = free_root(declared_root(prior, information[0].earth_rate))
    fit = solve_together(information, root)
    shared = np.arange(SHARED)
    lower = np.ravel_multi_index(LOWER, (3, 3))
    chosen = [
        *shared[SHARED_GYRO_MATRIX],
        *shared[SHARED_ACCELEROMETER_BIAS],
        *shared[SHARED_ACCELEROMETER_MATRIX][lower],
    ]
    to_coefficients = np.zeros((COUNT, len(fit.values)))
    to_coefficients[:3, SHARED:] = np.tile(np.eye(3), len(information)) / len(information)
    to_coefficients[np.arange(3, COUNT), chosen] = 1.0
    covariance = to_coefficients @ fit.covariance @ to_coefficients.T
    sizes = np.array([np.inf] * 3 + list(np.diag(root)[chosen]))
    return CoefficientEstimate(
        to_coefficients @ fit.values,
        covariance,
        np.sqrt(np.diag(covariance)) < _MAX_LEFT * sizes,
        parts=_parts(information, root, fit, to_coefficients),
    )


def _parts(
    information: Sequence[JointInformation], root: FloatArray, fit: JointFit, to_coefficients: FloatArray
) -> dict[str, FloatArray]:
    """Covariances (21, 21) by the data of the dwells, by the latitude, and by the assumed sizes."""
    placed = np.vstack(
        [each.for_joint_parameters(number, len(information)) for number, each in enumerate(information)]
    )
    gain = to_coefficients @ fit.covariance @ placed.T
    by_latitude = np.zeros(len(fit.values))
    by_latitude[:SHARED] = root[:, SHARED_NAVIGATION_RATE].sum(axis=1)
    latitude = to_coefficients @ by_latitude - gain @ (placed @ by_latitude)
    parts = {"dwells": gain @ gain.T, "latitude": np.outer(latitude, latitude)}
    whole = to_coefficients @ fit.covariance @ to_coefficients.T
    return parts | {"assumed_size": whole - parts["dwells"] - parts["latitude"]}
