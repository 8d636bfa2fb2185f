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
from gyrobench.bench.bias.position_differences import SLOPE_SIGMA_DPH_PER_C
from gyrobench.bench.bias.statistics import chi2_p_value, solve
from gyrobench.bench.calibration.coefficients import COUNT, LOWER, CoefficientEstimate
from gyrobench.bench.calibration.estimator import USUAL_SENSITIVITY
from gyrobench.bench.calibration.information import BIAS_DRIFT
from gyrobench.bench.foundations.arrays import DPH_TO_RADPS, STANDARD_GRAVITY, FloatArray, block_diagonal

#: A coefficient is observed if its standard uncertainty is below this share of its size.
_MAX_RELATIVE_SIGMA = 0.2
#: Large bias or sensitivity to gravity of a gyro, rad/s.
_LARGE_RATE = 1.0 * DPH_TO_RADPS
#: Factor on the declared uncertainty of the latitude, so that a wrong one passes for no sensitivity.
_ANY_LATITUDE = 1e3
#: Indices of the coefficients after the gyro biases among the shared parameters.
_SHARED_COEFFICIENTS = np.concatenate(
    [
        np.arange(SHARED_COUNT)[part]
        for part in (SHARED_GYRO_MATRIX, SHARED_ACCELEROMETER_BIAS, SHARED_ACCELEROMETER_MATRIX)
    ]
)[np.r_[0:12, 12 + np.ravel_multi_index(LOWER, (3, 3))]]


def joint_coefficients(solution: JointSolution, prior: PriorKnowledge) -> CoefficientEstimate:
    """Coefficients of the dwells of one plateau, by their navigation output, in the accelerometers' frame.

    The matrices are determined only by the data, without prior knowledge of misalignments and gyro scale
    factors, but with that of latitude, mount and drift of the accelerometers. A gyro's bias is the mean of
    the dwells. ``prior``: as for the solution.
    """
    information = [dwell.information for dwell in solution.dwells]
    root = free_root(declared_root(prior, information[0].earth_rate))
    fit = solve_together(information, root)
    to_coefficients = np.zeros((COUNT, len(fit.values)))
    to_coefficients[:3, SHARED_COUNT:] = np.tile(np.eye(3), len(information)) / len(information)
    to_coefficients[np.arange(3, COUNT), _SHARED_COEFFICIENTS] = 1.0
    covariance = to_coefficients @ fit.covariance @ to_coefficients.T
    sizes = np.array([np.inf] * 3 + list(np.diag(root)[_SHARED_COEFFICIENTS]))
    return CoefficientEstimate(
        to_coefficients @ fit.values,
        covariance,
        np.sqrt(np.diag(covariance)) < _MAX_RELATIVE_SIGMA * sizes,
        parts=_parts(information, root, fit, to_coefficients),
    )


def attitude_p_value(
    solution: JointSolution, prior: PriorKnowledge, start_s: FloatArray, rotations: CoefficientEstimate
) -> float:
    """P-value of the dwells' gyro biases if these follow the specific force as they do in the rotations.

    In both the biases may drift, and change with the temperature; the latitude is free. ``start_s``, shape
    (m,): times of the dwells. ``rotations``: estimate of the same plateau, with sensitivities of the biases
    to the specific force if they have any; those allowed for are a part ``g_sensitivity``.
    """
    information = [dwell.information for dwell in solution.dwells]
    root = free_root(declared_root(prior, information[0].earth_rate))
    root[SHARED_NAVIGATION_RATE] *= _ANY_LATITUDE
    temperature_c = np.array([dwell.gyro_c for dwell in solution.dwells])
    from_mean_k = np.nan_to_num(temperature_c - temperature_c.mean(axis=0))
    from_mean_s = start_s - start_s.mean()
    rows = []
    for number, (each, dwell) in enumerate(zip(information, solution.dwells, strict=True)):
        # Instead of the biases of each dwell a constant, a slope over temperature, a drift, sensitivities of
        # the rotations, and their difference in the dwells.
        shared, by_bias = np.split(each.joint_rows(0, 1), [SHARED_COUNT], axis=1)
        by_gravity = np.kron(np.eye(3), dwell.position.C_nb()[2])
        inputs = np.eye(3), np.diag(from_mean_k[number]), from_mean_s[number] * np.eye(3)
        rows.append(np.hstack([shared, by_bias @ np.hstack([*inputs, by_gravity, by_gravity])]))
    sensitivities = [k for k, each in enumerate(rotations.coefficients) if each.name == "gyro_g_sensitivity"]
    allowed = USUAL_SENSITIVITY * STANDARD_GRAVITY * ("g_sensitivity" in rotations.parts)
    slope = SLOPE_SIGMA_DPH_PER_C * DPH_TO_RADPS
    known_size = _LARGE_RATE if sensitivities else allowed
    sizes = np.repeat([_LARGE_RATE, slope, BIAS_DRIFT, known_size, _LARGE_RATE], [3, 3, 3, 9, 9])
    # The rotations determine the matrices, the accelerometer biases and sensitivities.
    columns = dict(zip(range(3, COUNT), _SHARED_COEFFICIENTS, strict=True))
    columns |= dict(zip(sensitivities, range(SHARED_COUNT + 9, SHARED_COUNT + 18), strict=False))
    used = [k for k in columns if rotations.is_observed[k]]
    correlations = rotations.correlations[np.ix_(used, used)]
    white = np.linalg.inv(np.linalg.cholesky(correlations)) / rotations.sigmas[used]
    by_rotations = np.zeros((len(used), rows[0].shape[1]))
    units = [1.0 if k < COUNT else 1.0 / STANDARD_GRAVITY for k in used]
    by_rotations[:, [columns[k] for k in used]] = white * units
    rows.append(by_rotations)
    data = np.concatenate([*(each.data for each in information), white @ rotations.values[used]])
    values, covariance = solve(np.vstack(rows), data, block_diagonal(root, np.diag(sizes)))
    difference, scale = values[-9:], _LARGE_RATE**2
    chi2 = float(difference @ np.linalg.solve(covariance[-9:, -9:] / scale, difference / scale))
    return chi2_p_value(len(difference), chi2)


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
