"""Solves all dwells of one plateau together.

The dwells share one set of parameters: accelerometer biases and misalignments, gyro error matrix, error of
the latitude. Each dwell keeps its own gyro biases: the bench is there to measure how these differ, so nothing
here pulls them together.

There are three solutions: each dwell by itself; all together, with the declared uncertainty of the latitude;
and all together with a free rate North, in which a rate Up remains in the biases of the vertical gyros. That
rate can be subtracted from the last one: see :mod:`gyrobench.bench.bias.vertical_pairs`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gyrobench.bench.bias import parameters
from gyrobench.bench.bias.bias_filter import DwellInformation
from gyrobench.bench.bias.parameters import PriorKnowledge
from gyrobench.bench.bias.statistics import chi2_p_value, chi2_test, compress, solve
from gyrobench.bench.bias.vertical_pairs import UpRate, VerticalPairs, up_rate
from gyrobench.bench.foundations.arrays import STANDARD_GRAVITY, FloatArray, IntArray, block_diagonal
from gyrobench.bench.foundations.errors import MeasurementError
from gyrobench.bench.navigation.earth import EARTH_RATE
from gyrobench.bench.navigation.positions import POSITIONS, Position

#: Indices of the shared parameters: accelerometer biases; accelerometer error matrix by rows (its diagonal,
#: the scale factors, acts only on Up and is not observable); rate North and Up fixed in the navigation frame;
#: gyro error matrix by rows. The gyro biases of each dwell follow.
SHARED_ACCELEROMETER_BIAS, SHARED_ACCELEROMETER_MATRIX = slice(0, 3), slice(3, 12)
SHARED_NAVIGATION_RATE, SHARED_GYRO_MATRIX = slice(12, 14), slice(14, 23)
SHARED_COUNT = 23

# Prior of a rate without prior knowledge, rad/s.
_ANY_RATE = 0.01
# Rows with less information than this, relative to the prior knowledge, are left out.
_MIN_INFORMATION = 0.3

# Parameters of a dwell that enter the joint problem: its gyro biases, the apparent accelerometer biases in
# its position, rates and gyro error matrix.
_JOINT_COLUMNS = np.r_[
    parameters.GYRO_BIAS, parameters.ACCELEROMETER_BIAS, parameters.NAVIGATION_RATE, parameters.GYRO_MATRIX
]
_BIAS, _ACCELERATION, _RATE, _MATRIX = slice(0, 3), slice(3, 6), slice(6, 8), slice(8, 17)

_NORTH = SHARED_NAVIGATION_RATE.start
#: Large values, SI, of accelerometer biases and of elements of the matrices, for a unit with compensation.
_LARGE_BIAS, _LARGE_ELEMENT = 0.1, 1e-3
_LOWER, _OFF_DIAGONAL = np.tril(np.ones((3, 3))).ravel(), ~np.eye(3, dtype=bool).ravel()
#: Dwells disagree if their test has a smaller p-value.
_MIN_P_VALUE = 1e-3
#: Errors of the gyros' matrix are larger than declared if their test has a smaller p-value; and rounds of the
#: iteration to their size.
_MIN_GYRO_ERROR_P_VALUE, _FACTOR_ROUNDS = 1e-6, 50


@dataclass(frozen=True, eq=False, slots=True)
class JointInformation:
    """Information of one dwell on the joint problem."""

    #: rows, data: Shape (n, 17), (n,). White rows for biases at mean temperatures, apparent accelerometer
    #: biases in this position, rates North and Up, and gyro error matrix.
    rows: FloatArray
    data: FloatArray
    position: Position
    earth_rate: FloatArray  #: Shape (3,). ENU, rad/s.
    #: turn_rows, turn_data: Shape (k, 9), (k,). White rows for the gyro error matrix, of the angles by which
    #: the INS turned further than the table. They test its declared size and enter no solution, since an
    #: error of the table's angle looks the same.
    turn_rows: FloatArray
    turn_data: FloatArray

    @classmethod
    def of(
        cls,
        information: DwellInformation,
        position: Position,
        prior: PriorKnowledge,
        turn_angles: tuple[FloatArray, FloatArray],
    ) -> JointInformation:
        """Eliminate parameters of a single dwell: slopes, initial errors, headings, steps in the turns.

        ``turn_angles``: :attr:`turn_rows` and :attr:`turn_data`.
        """
        rows = information.rows.copy()
        # The biases at the mean temperatures become parameters; slopes then act about these temperatures.
        for bias, slope, at_mean in (
            (parameters.GYRO_BIAS, parameters.GYRO_SLOPE, information.bias_at_mean),
            (parameters.ACCELEROMETER_BIAS, parameters.ACCELEROMETER_SLOPE, information.acceleration_at_mean),
        ):
            rows[:, slope] -= rows[:, bias] @ at_mean[:, slope]
        eliminated = np.r_[
            parameters.GYRO_SLOPE,
            parameters.ACCELEROMETER_DRIFT,
            parameters.ACCELEROMETER_SLOPE,
            parameters.COMMON_COUNT : rows.shape[1],
        ]
        root = parameters.prior_root(prior, information.windows, information.earth_rate)
        stacked = np.block(
            [
                [
                    rows[:, eliminated] @ root[np.ix_(eliminated, eliminated)],
                    rows[:, _JOINT_COLUMNS],
                    information.data[:, np.newaxis],
                ],
                [np.eye(len(eliminated)), np.zeros((len(eliminated), len(_JOINT_COLUMNS) + 1))],
            ]
        )
        reduced = compress(stacked)[len(eliminated) :, len(eliminated) :]
        sizes = np.diagonal(root)[_JOINT_COLUMNS].copy()
        sizes[_BIAS] = sizes[_RATE] = _ANY_RATE
        return cls(
            *_informative_rows(reduced[:, :-1], reduced[:, -1], sizes),
            position,
            information.earth_rate,
            *turn_angles,
        )

    def joint_rows(self, index: int, dwells: int) -> FloatArray:
        """Rows (n, 23 + 3 m) for the joint parameters, of the dwell with this index out of m dwells."""
        vertical_force = self.position.up_sign * STANDARD_GRAVITY * np.eye(3)[self.position.up_axis]
        result = np.zeros((len(self.rows), SHARED_COUNT + 3 * dwells))
        result[:, SHARED_ACCELEROMETER_BIAS] = self.rows[:, _ACCELERATION]
        result[:, SHARED_ACCELEROMETER_MATRIX] = self.rows[:, _ACCELERATION] @ np.kron(
            np.eye(3), vertical_force
        )
        result[:, SHARED_NAVIGATION_RATE] = self.rows[:, _RATE]
        result[:, SHARED_GYRO_MATRIX] = self.rows[:, _MATRIX]
        result[:, SHARED_COUNT + 3 * index :][:, :3] = self.rows[:, _BIAS]
        return result


@dataclass(frozen=True, eq=False)
class JointFit:
    """Solution of the joint problem."""

    #: values, covariance: Shape (23 + 3 m,), (23 + 3 m, 23 + 3 m). Shared parameters, then the biases of each
    #: of the m dwells.
    values: FloatArray
    covariance: FloatArray
    #: Test that the dwells agree on the shared parameters, with free accelerometer biases and misalignments:
    #: if these are larger than declared, the dwells do not contradict one another.
    p_value: float

    @property
    def shared(self) -> SharedParameters:
        """The shared parameters."""
        sigmas = np.sqrt(np.diagonal(self.covariance)[:SHARED_COUNT])
        return SharedParameters(self.values[:SHARED_COUNT].copy(), sigmas, self.p_value)

    @property
    def biases(self) -> JointBiases:
        """The biases of each dwell."""
        return JointBiases(
            self.values[SHARED_COUNT:].reshape(-1, 3).copy(),
            self.covariance[SHARED_COUNT:, SHARED_COUNT:].copy(),
        )


@dataclass(frozen=True, eq=False)
class SharedParameters:
    """Parameters shared by the dwells of a plateau, as estimated."""

    #: values, sigmas: Shape (23,). With standard uncertainties, SI.
    values: FloatArray
    sigmas: FloatArray
    p_value: float  #: Test that the dwells agree on them; see :class:`JointFit`.


def declared_root(prior: PriorKnowledge, earth_rate: FloatArray) -> FloatArray:
    """Prior root (23, 23) of the shared parameters, with the declared uncertainty of the latitude."""
    single = parameters.prior_root(prior, 0, earth_rate)
    matrix = prior.accelerometer_misalignment * (1.0 - np.eye(3))
    parts = (parameters.ACCELEROMETER_BIAS, None, parameters.NAVIGATION_RATE, parameters.GYRO_MATRIX)
    return block_diagonal(
        *(np.diag(matrix.ravel()) if part is None else single[part, part] for part in parts)
    )


def _north_free_root(prior: PriorKnowledge, earth_rate: FloatArray) -> FloatArray:
    """Prior root (23, 23) with a free rate North; a rate Up remains in the biases of the vertical gyros."""
    root = declared_root(prior, earth_rate)
    root[SHARED_NAVIGATION_RATE, SHARED_NAVIGATION_RATE] = np.diag([_ANY_RATE, 0.0])
    return root


def free_root(root: FloatArray, gyro_scale_factors: bool = True) -> FloatArray:
    """Prior root (23, 23) with free accelerometer biases and matrices, in the accelerometers' body frame.

    ``gyro_scale_factors``: whether these are free too; a common one acts as an error of the latitude.
    """
    free = root.copy()
    sizes = np.diagonal(root).copy()
    sizes[SHARED_ACCELEROMETER_BIAS], sizes[SHARED_ACCELEROMETER_MATRIX] = (
        _LARGE_BIAS,
        _LARGE_ELEMENT * _LOWER,
    )
    sizes[SHARED_GYRO_MATRIX] = np.where(
        _OFF_DIAGONAL | gyro_scale_factors, _LARGE_ELEMENT, sizes[SHARED_GYRO_MATRIX]
    )
    for part in (SHARED_ACCELEROMETER_BIAS, SHARED_ACCELEROMETER_MATRIX, SHARED_GYRO_MATRIX):
        free[part, part] = np.diag(sizes[part])
    return free


def _solve_singly(dwells: Sequence[JointInformation], shared_root: FloatArray) -> JointBiases:
    """Solve each dwell by itself."""
    own = slice(SHARED_COUNT, None)
    solutions = [solve(*_system([dwell], shared_root)) for dwell in dwells]
    return JointBiases(
        np.vstack([values[own] for values, _ in solutions]),
        block_diagonal(*(covariance[own, own] for _, covariance in solutions)),
    )


def solve_together(dwells: Sequence[JointInformation], shared_root: FloatArray) -> JointFit:
    """Solve for the shared parameters and the biases of each dwell."""
    rows, data, prior_root = _system(dwells, shared_root)
    values, covariance = solve(rows, data, prior_root)
    free, free_covariance = solve(*_system(dwells, free_root(shared_root, gyro_scale_factors=False)))
    test = chi2_test(data - rows @ free, rows, free_covariance)
    return JointFit(values, covariance, test.p_value)


def _system(
    dwells: Sequence[JointInformation], shared_root: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Rows, data and prior root of the joint problem."""
    rows = np.vstack([each.joint_rows(index, len(dwells)) for index, each in enumerate(dwells)])
    data = np.concatenate([each.data for each in dwells])
    return rows, data, block_diagonal(shared_root, _ANY_RATE * np.eye(3 * len(dwells)))


def _informative_rows(rows: FloatArray, data: FloatArray, sizes: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Rotate rows and drop those without information on parameters of these sizes, which dilute a test."""
    directions, information, _ = np.linalg.svd(rows * sizes, full_matrices=False)
    rotated = directions[:, information > _MIN_INFORMATION].T
    return rotated @ rows, rotated @ data


@dataclass(frozen=True, eq=False, slots=True)
class JointDwell:
    """One dwell for a joint solution."""

    number: int  #: Number of the dwell, unique in the run.
    position_name: str  #: Key of :data:`gyrobench.bench.navigation.positions.POSITIONS`.
    information: JointInformation  #: Made with the same prior knowledge as the solution.
    cycle: int = 1  #: Cycle of the temperature profile.
    chamber_set_c: float = math.nan  #: Set point of the chamber; NaN if there is none.
    #: Mean temperature of each gyro; NaN if not measured.
    gyro_c: tuple[float, float, float] = (math.nan, math.nan, math.nan)
    run: str = ""  #: Power cycle of the INS.

    @property
    def position(self) -> Position:
        """The position by its name."""
        return POSITIONS[self.position_name]


@dataclass(frozen=True, eq=False)
class JointBiases:
    """Gyro biases of m dwells."""

    bias_radps: FloatArray  #: Shape (m, 3). Bias of the x, y and z gyro in each dwell.
    covariance: FloatArray  #: Shape (3 m, 3 m). Dwell by dwell, (rad/s)^2.

    @property
    def sigma_radps(self) -> FloatArray:
        """Standard uncertainties, shape (m, 3)."""
        return np.sqrt(np.diagonal(self.covariance)).reshape(-1, 3)


@dataclass(frozen=True, eq=False)
class JointSolution:
    """Joint solution of the dwells of one plateau, SI.

    A shared quantity that the data do not determine keeps its prior uncertainty.
    """

    dwells: tuple[JointDwell, ...]  #: The m dwells.
    #: single, together, north_free: Each dwell by itself; together with the declared latitude; together with
    #: a free rate North, with uncertainties of vertical gyros that do not include a rate Up.
    single: JointBiases
    together: JointBiases
    north_free: JointBiases
    #: fit, north_free_fit: Of the last two. If the dwells agree (``p_value``) only in the second, the
    #: latitude is wrong by more than declared; if in neither, their parameters are not the same.
    fit: SharedParameters
    north_free_fit: SharedParameters
    pairs: VerticalPairs  #: Half-differences of the vertical gyros.
    up_rate: UpRate  #: Rate Up from these dwells only.
    #: Size of the gyros' misalignments and scale factors by these data relative to the declared one; 1 if
    #: they do not contradict it. The solutions allow for errors of this size.
    gyro_error_factor: float
    #: The same, in addition, of the scale factors by the angles of the turns.
    scale_factor_ratio: float

    @property
    def agrees(self) -> bool:
        """Whether the dwells agree on the shared parameters, with the declared or another latitude."""
        return not (self.fit.p_value < _MIN_P_VALUE and self.north_free_fit.p_value < _MIN_P_VALUE)

    @property
    def accelerometer_bias(self) -> tuple[FloatArray, FloatArray]:
        """Biases (3,) and their standard uncertainties, m/s^2, body axes."""
        part = SHARED_ACCELEROMETER_BIAS
        return self.fit.values[part], self.fit.sigmas[part]

    @property
    def north_rate(self) -> tuple[float, float]:
        """Rate North fixed in the navigation frame, without prior knowledge, and its uncertainty, rad/s."""
        return float(self.north_free_fit.values[_NORTH]), float(self.north_free_fit.sigmas[_NORTH])

    def corrected(self, rate: UpRate | None = None) -> JointBiases:
        """Biases with a rate Up, if there is one, subtracted from those of the vertical gyros.

        Meant for a rate that ``applies``. A rate from several temperatures is much more reliable: three
        biases that differ up and down by little more than the noise often look like a rate.

        ``rate``: of several temperatures together, including these dwells; default: that of these dwells.
        """
        rate = rate or self.up_rate
        if not rate.weights:
            return self.north_free
        biases, indices = self.north_free, _vertical_indices(self.dwells)
        response, weights = np.zeros((2, 3 * len(self.dwells)))
        response[indices] = [dwell.position.up_sign for dwell in self.dwells]
        weights[indices] = [rate.weights.get(dwell.number, 0.0) for dwell in self.dwells]
        removal = np.eye(len(response)) - np.outer(response, weights)
        # Variance of the rate that is not due to these biases: other dwells, and temperatures up and down.
        extra_variance = max(0.0, rate.sigma**2 - float(weights @ biases.covariance @ weights))
        return JointBiases(
            biases.bias_radps - rate.rate * response.reshape(-1, 3),
            removal @ biases.covariance @ removal.T + extra_variance * np.outer(response, response),
        )


def solve_jointly(dwells: Sequence[JointDwell], prior: PriorKnowledge) -> JointSolution:
    """Solve the dwells of one plateau together.

    ``dwells``: of one plateau, in any positions. ``prior``: prior knowledge, as for each dwell by itself.
    Raises MeasurementError if there is no dwell.
    """
    if not dwells:
        raise MeasurementError("there is no dwell to solve; a joint solution needs at least one")
    earth_rate = dwells[0].information.earth_rate
    information = [dwell.information for dwell in dwells]
    factor = _gyro_error_factor(information, declared_root(prior, earth_rate))
    prior = prior.with_larger_gyro_errors(factor)
    ratio = _scale_factor_ratio(information, prior)
    prior = prior.with_larger_gyro_errors(1.0, ratio)
    root, north_free_root = declared_root(prior, earth_rate), _north_free_root(prior, earth_rate)
    fit, north_free_fit = solve_together(information, root), solve_together(information, north_free_root)
    pairs = _vertical_pairs(dwells, north_free_fit, prior.bias_slope)
    return JointSolution(
        dwells=tuple(dwells),
        single=_solve_singly(information, root),
        together=fit.biases,
        north_free=north_free_fit.biases,
        fit=fit.shared,
        north_free_fit=north_free_fit.shared,
        pairs=pairs,
        up_rate=up_rate([pairs], earth_rate, prior.latitude),
        gyro_error_factor=factor,
        scale_factor_ratio=ratio,
    )


def _gyro_error_factor(dwells: Sequence[JointInformation], root: FloatArray) -> float:
    """See :attr:`JointSolution.gyro_error_factor`; ``root`` (23, 23) as of :func:`declared_root`.

    Any error of the latitude is allowed, since a common scale factor of the gyros looks the same.
    """
    declared = np.diagonal(root)[SHARED_GYRO_MATRIX]
    if not declared.any():
        return 1.0
    free, north, up = root.copy(), *dwells[0].earth_rate[[2, 1]]
    free[SHARED_GYRO_MATRIX, SHARED_GYRO_MATRIX] = _LARGE_ELEMENT * np.diag(declared > 0.0)
    free[SHARED_NAVIGATION_RATE, _NORTH] = _ANY_RATE / EARTH_RATE * np.array([north, -up])
    values, covariance = solve(*_system(dwells, free))
    used = SHARED_GYRO_MATRIX.start + np.flatnonzero(declared)
    sizes = declared[declared > 0.0]
    # Independent combinations of the errors in declared sizes, as the data alone show them: those that these
    # leave open would count as zero.
    precision = np.linalg.inv(covariance[np.ix_(used, used)] / np.outer(sizes, sizes))
    possible = (sizes / _LARGE_ELEMENT) ** 2
    precisions, directions = np.linalg.eigh(precision - np.diag(possible))
    is_shown = precisions > possible.max()
    variances = 1.0 / precisions[is_shown]
    squares = (variances * (directions.T @ precision @ (values[used] / sizes))[is_shown]) ** 2
    if chi2_p_value(len(squares), float((squares / (1.0 + variances)).sum())) > _MIN_GYRO_ERROR_P_VALUE:
        return 1.0
    factor2 = 1.0
    for _ in range(_FACTOR_ROUNDS):
        weights = (factor2 + variances) ** -2.0
        factor2 = max(1.0, float(weights @ (squares - variances) / weights.sum()))
    return math.sqrt(factor2)


def _scale_factor_ratio(dwells: Sequence[JointInformation], prior: PriorKnowledge) -> float:
    """See :attr:`JointSolution.scale_factor_ratio`: of the largest, if they contradict the declared size."""
    rows = np.concatenate([each.turn_rows for each in dwells])
    data = np.concatenate([each.turn_data for each in dwells])
    declared = prior.gyro_scale_factor
    if not len(data) or declared == 0.0:
        return 1.0
    scale_factors, misalignments = rows[:, ~_OFF_DIAGONAL], rows[:, _OFF_DIAGONAL]
    others = np.eye(len(data)) + prior.gyro_misalignment**2 * misalignments @ misalignments.T
    weighted, free_weighted = (
        np.linalg.solve(others + size**2 * scale_factors @ scale_factors.T, data)
        for size in (declared, _LARGE_ELEMENT)
    )
    if chi2_p_value(len(data), float(data @ weighted)) > _MIN_GYRO_ERROR_P_VALUE:
        return 1.0
    values = _LARGE_ELEMENT**2 * scale_factors.T @ free_weighted
    return max(1.0, float(np.abs(values).max()) / declared)


def pooled_up_rate(solutions: Sequence[JointSolution], prior: PriorKnowledge) -> UpRate | None:
    """Rate Up from several temperatures together, since the latitude error is common to them.

    Plateaus whose dwells disagree at any latitude are left out; None if none remain.
    """
    agreeing = [each for each in solutions if each.agrees]
    if not agreeing:
        return None
    earth_rate = agreeing[0].dwells[0].information.earth_rate
    return up_rate([each.pairs for each in agreeing], earth_rate, prior.latitude)


def _vertical_indices(dwells: Sequence[JointDwell]) -> IntArray:
    """Index of each dwell's vertical gyro among all biases."""
    return np.array([3 * index + dwell.position.up_axis for index, dwell in enumerate(dwells)])


def _vertical_pairs(dwells: Sequence[JointDwell], fit: JointFit, bias_slope: float) -> VerticalPairs:
    halves = {axis: half for axis in range(3) if (half := _half_difference(dwells, axis))}
    numbers = {dwell.number: index for index, dwell in enumerate(dwells)}
    weights = np.zeros((len(halves), len(dwells)))
    shift_c = np.zeros(len(halves))
    for row, (axis, half) in enumerate(halves.items()):
        for number, weight in half.items():
            weights[row, numbers[number]] = weight
            shift_c[row] += weight * dwells[numbers[number]].gyro_c[axis]
    bias_columns = SHARED_COUNT + _vertical_indices(dwells)
    covariance = weights @ fit.covariance[np.ix_(bias_columns, bias_columns)] @ weights.T
    return VerticalPairs(
        gyros=tuple(halves),
        half_difference=weights @ fit.values[bias_columns],
        covariance=covariance + np.diag(np.nan_to_num(bias_slope * shift_c) ** 2),
        weights=tuple(halves.values()),
        north_rate=float(fit.values[_NORTH]),
        north_variance=float(fit.covariance[_NORTH, _NORTH]),
        north_covariance=weights @ fit.covariance[bias_columns, _NORTH],
    )


def _half_difference(dwells: Sequence[JointDwell], axis: int) -> dict[int, float]:
    """Weight of each dwell in half the difference of a gyro's bias, up minus down; empty without both."""
    vertical = [dwell for dwell in dwells if dwell.position.up_axis == axis]
    up, down = ([dwell.number for dwell in vertical if dwell.position.up_sign == sign] for sign in (1, -1))
    if not (up and down):
        return {}
    return {number: 0.5 / len(up) for number in up} | {number: -0.5 / len(down) for number in down}
