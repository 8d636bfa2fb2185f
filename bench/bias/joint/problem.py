"""The least-squares problem of several dwells with what they share."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import block_diag

from gyrobench.bench.bias.least_squares import compress, misfit, solve
from gyrobench.bench.bias.prior import PriorKnowledge
from gyrobench.bench.bias.state_space import causes
from gyrobench.bench.bias.state_space.bias_filter import DwellInformation
from gyrobench.bench.foundations.arrays import STANDARD_GRAVITY, FloatArray
from gyrobench.bench.navigation.positions import Position

#: Shared unknowns: accelerometer biases, accelerometer error matrix by rows (its diagonal, the
#: scale factors, acts on Up alone and is not seen), rate North and Up fixed in the navigation
#: frame, gyro error matrix by rows. The gyro biases of each dwell follow.
ACCELEROMETER_BIAS, ACCELEROMETER_MATRIX = slice(0, 3), slice(3, 12)
NAVIGATION_RATE, GYRO_MATRIX = slice(12, 14), slice(14, 23)
SHARED = 23

# A rate of which nothing is known beforehand, rad/s.
_ANY_RATE = 0.01
# What data say less of than this, in units of prior knowledge, is noise; 1 would equal it.
_LEAST_INFORMATION = 0.3

# What a dwell shows of its unknowns beyond its own: its gyro biases, the accelerometer biases as
# they seem in its position, rates and gyro error matrix.
_SHOWN = np.r_[causes.GYRO_BIAS, causes.ACCELEROMETER_BIAS, causes.NAVIGATION_RATE, causes.GYRO_MATRIX]
_BIAS, _ACCELERATION, _RATE, _MATRIX = slice(0, 3), slice(3, 6), slice(6, 8), slice(8, 17)


@dataclass(frozen=True, eq=False)
class DwellRows:
    """What one dwell says of the joint problem.

    Attributes
    ----------
    rows, data : ndarray, shape (n, 17), (n,)
        White rows for biases at mean temperatures, accelerometer biases as they seem in this
        position, rates North and Up, and gyro error matrix.
    position : Position
        Which body axis was vertical.
    """

    rows: FloatArray
    data: FloatArray
    position: Position

    @classmethod
    def of(cls, information: DwellInformation, position: Position, prior: PriorKnowledge) -> DwellRows:
        """Eliminate what no other dwell shares: slopes, initial errors, headings, steps in the turns."""
        rows, slope = information.rows.copy(), causes.GYRO_SLOPE
        # Biases at the mean temperatures become unknowns; the slopes turn about those temperatures.
        rows[:, slope] -= rows[:, causes.GYRO_BIAS] @ information.bias_at_mean[:, slope]
        own = np.r_[slope, causes.ACCELEROMETER_DRIFT, causes.COMMON : rows.shape[1]]
        root = causes.prior_root(prior, information.windows, information.earth_rate)
        stacked = np.block(
            [
                [rows[:, own] @ root[np.ix_(own, own)], rows[:, _SHOWN], information.data[:, np.newaxis]],
                [np.eye(len(own)), np.zeros((len(own), len(_SHOWN) + 1))],
            ]
        )
        left = compress(stacked)[len(own) :, len(own) :]
        sizes = np.diagonal(root)[_SHOWN].copy()
        sizes[_BIAS] = sizes[_RATE] = _ANY_RATE
        return cls(*_informative(left[:, :-1], left[:, -1], sizes), position)

    def for_joint_unknowns(self, number: int, dwells: int) -> FloatArray:
        """Rows (n, 23 + 3 m) of dwell ``number`` out of m."""
        vertical = self.position.up_sign * STANDARD_GRAVITY * np.eye(3)[self.position.up_axis]
        result = np.zeros((len(self.rows), SHARED + 3 * dwells))
        result[:, ACCELEROMETER_BIAS] = self.rows[:, _ACCELERATION]
        result[:, ACCELEROMETER_MATRIX] = self.rows[:, _ACCELERATION] @ np.kron(np.eye(3), vertical)
        result[:, NAVIGATION_RATE] = self.rows[:, _RATE]
        result[:, GYRO_MATRIX] = self.rows[:, _MATRIX]
        result[:, SHARED + 3 * number :][:, :3] = self.rows[:, _BIAS]
        return result


@dataclass(frozen=True, eq=False)
class JointFit:
    """Solution of the joint problem.

    Attributes
    ----------
    unknowns, covariance : ndarray, shape (23 + 3 m,), (23 + 3 m, 23 + 3 m)
        Shared unknowns, then the biases of each of the m dwells.
    chi2, freedom, p_value : float, int, float
        Test that the dwells agree on what they share.
    """

    unknowns: FloatArray
    covariance: FloatArray
    chi2: float
    freedom: int
    p_value: float


def declared_root(prior: PriorKnowledge, earth_rate: FloatArray) -> FloatArray:
    """Prior root (23, 23) of what is shared, with the latitude as well known as declared."""
    single = causes.prior_root(prior, 0, earth_rate)
    matrix = prior.accelerometer_misalignment * (1.0 - np.eye(3))
    parts = (causes.ACCELEROMETER_BIAS, None, causes.NAVIGATION_RATE, causes.GYRO_MATRIX)
    return np.asarray(
        block_diag(*(np.diag(matrix.ravel()) if part is None else single[part, part] for part in parts))
    )


def north_free_root(prior: PriorKnowledge, earth_rate: FloatArray) -> FloatArray:
    """The same with any rate North; a rate Up stays in the biases of the vertical gyros."""
    root = declared_root(prior, earth_rate)
    root[NAVIGATION_RATE, NAVIGATION_RATE] = np.diag([_ANY_RATE, 0.0])
    return root


def solve_alone(dwell: DwellRows, shared_root: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Solve one dwell by itself; its biases (3,) and their covariance (3, 3)."""
    unknowns, covariance = solve(*_system([dwell], shared_root))
    return unknowns[SHARED:], covariance[SHARED:, SHARED:]


def solve_together(dwells: Sequence[DwellRows], shared_root: FloatArray) -> JointFit:
    """Solve for what the dwells share and for the biases of each."""
    rows, data, prior_root = _system(dwells, shared_root)
    unknowns, covariance = solve(rows, data, prior_root)
    left = misfit(data - rows @ unknowns, rows, covariance)
    return JointFit(unknowns, covariance, left.chi2, left.freedom, left.p_value)


def _system(
    dwells: Sequence[DwellRows], shared_root: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Rows, data and prior root of the joint problem."""
    rows = np.vstack([each.for_joint_unknowns(number, len(dwells)) for number, each in enumerate(dwells)])
    data = np.concatenate([each.data for each in dwells])
    return rows, data, np.asarray(block_diag(shared_root, _ANY_RATE * np.eye(3 * len(dwells))))


def _informative(rows: FloatArray, data: FloatArray, sizes: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Rows turned so that those go which tell nothing of unknowns of these sizes: they dilute a test."""
    directions, information, _ = np.linalg.svd(rows * sizes, full_matrices=False)
    turned = directions[:, information > _LEAST_INFORMATION].T
    return turned @ rows, turned @ data
