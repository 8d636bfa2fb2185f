"""All dwells of one temperature solved together.

What the positions share is one set of unknowns: accelerometer biases and misalignments, gyro error
matrix, error of the latitude. The gyro biases of each dwell stay its own; that they may differ is
what the bench is for, and nothing here draws them to one another.

There are three solutions: each dwell by itself; all together, with the latitude as well known as
declared; and all together with any rate North, in which a rate Up stays in the biases of the
vertical gyros. From the last one that rate can be taken away: see
:mod:`gyrobench.bench.bias.joint.vertical_pairs`.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import block_diag

from gyrobench.bench.bias.dwell import BiasEstimate
from gyrobench.bench.bias.joint.problem import (
    ACCELEROMETER_BIAS,
    ACCELEROMETER_MATRIX,
    GYRO_MATRIX,
    NAVIGATION_RATE,
    SHARED,
    DwellRows,
    JointFit,
    declared_root,
    north_free_root,
    solve_alone,
    solve_together,
)
from gyrobench.bench.bias.joint.vertical_pairs import UpRate, VerticalPairs, up_rate
from gyrobench.bench.bias.prior import PriorKnowledge
from gyrobench.bench.bias.state_space.bias_filter import DwellInformation
from gyrobench.bench.foundations.arrays import FloatArray, IntArray
from gyrobench.bench.foundations.errors import MeasurementError
from gyrobench.bench.navigation.positions import POSITIONS, Position

_NORTH = NAVIGATION_RATE.start
#: Largest difference of a dwell's temperature from the mean of those that it is solved with, K.
_SAME_TEMPERATURE_K = 5.0
#: Dwells agree no more where chance alone makes them differ as much less often than this.
_LEAST_P = 1e-3


@dataclass(frozen=True, eq=False)
class JointDwell:
    """One dwell for a joint solution.

    Attributes
    ----------
    number : int
        Of the dwell; no two dwells of a run have the same.
    position_name : str
        Key of :data:`gyrobench.bench.navigation.positions.POSITIONS`.
    information : DwellInformation
        From its own estimate.
    cycle : int
        Which pass of the temperature profile.
    chamber_set_c : float
        Set point of the chamber; NaN where there is none.
    gyro_c : tuple of float
        Mean temperature of each gyro; NaN where not measured.
    run : str
        Which power-on of the INS.
    """

    number: int
    position_name: str
    information: DwellInformation
    cycle: int = 1
    chamber_set_c: float = math.nan
    gyro_c: tuple[float, float, float] = (math.nan, math.nan, math.nan)
    run: str = ""

    @property
    def position(self) -> Position:
        """The position that the name stands for."""
        return POSITIONS[self.position_name]

    @property
    def mean_c(self) -> float:
        """Mean temperature of the gyros that have one; NaN without any."""
        known = [each for each in self.gyro_c if math.isfinite(each)]
        return sum(known) / len(known) if known else math.nan


@dataclass(frozen=True, eq=False)
class JointBiases:
    """Gyro biases of m dwells.

    Attributes
    ----------
    bias_radps : ndarray, shape (m, 3)
        Bias of the x, y and z gyro in each dwell.
    covariance : ndarray, shape (3 m, 3 m)
        Dwell by dwell, (rad/s)^2.
    """

    bias_radps: FloatArray
    covariance: FloatArray

    @property
    def sigma_radps(self) -> FloatArray:
        """Standard uncertainties, shape (m, 3)."""
        return np.sqrt(np.diagonal(self.covariance)).reshape(-1, 3)

    def of_dwell(self, index: int) -> BiasEstimate:
        """Biases of one dwell, by its place among the m."""
        own = slice(3 * index, 3 * index + 3)
        return BiasEstimate(self.bias_radps[index], self.covariance[own, own])


@dataclass(frozen=True, eq=False)
class JointSolution:
    """What all dwells of one temperature say together, SI.

    What the data do not tell of a shared quantity keeps its prior uncertainty.

    Attributes
    ----------
    dwells : tuple of JointDwell
        The m dwells.
    single, together, north_free : JointBiases
        Each dwell by itself; with the latitude as declared; with any rate North, where uncertainties
        of vertical gyros leave a rate Up out.
    fit, north_free_fit : JointFit
        Of the last two. If the dwells agree (``p_value``) in the second alone, the latitude is wrong
        by more than declared; if in neither, they do not share what they are meant to.
    pairs : VerticalPairs
        Half-differences of the vertical gyros.
    up_rate : UpRate
        The rate Up by these dwells alone.
    """

    dwells: tuple[JointDwell, ...]
    single: JointBiases
    together: JointBiases
    north_free: JointBiases
    fit: JointFit
    north_free_fit: JointFit
    pairs: VerticalPairs
    up_rate: UpRate

    @property
    def agrees(self) -> bool:
        """Whether the dwells share what they are meant to, be it with another latitude than declared."""
        return not (self.fit.p_value < _LEAST_P and self.north_free_fit.p_value < _LEAST_P)

    @property
    def gain(self) -> FloatArray:
        """Uncertainty dwell by dwell over the joint one, shape (m, 3)."""
        return self.single.sigma_radps / self.together.sigma_radps

    @property
    def accelerometer_bias(self) -> tuple[FloatArray, FloatArray]:
        """Biases (3,) and their standard uncertainties, m/s^2, body axes."""
        return self._shared(ACCELEROMETER_BIAS)

    @property
    def accelerometer_misalignment(self) -> tuple[FloatArray, FloatArray]:
        """Matrix (3, 3) and its standard uncertainties, rad; the diagonal is not seen and stays 0."""
        matrix, sigma = self._shared(ACCELEROMETER_MATRIX)
        return matrix.reshape(3, 3), sigma.reshape(3, 3)

    @property
    def gyro_matrix(self) -> tuple[FloatArray, FloatArray]:
        """Scale factor errors and misalignments (3, 3), and their standard uncertainties."""
        matrix, sigma = self._shared(GYRO_MATRIX)
        return matrix.reshape(3, 3), sigma.reshape(3, 3)

    @property
    def north_rate(self) -> tuple[float, float]:
        """Rate North fixed in the navigation frame, free of prior knowledge, and its uncertainty, rad/s."""
        fit = self.north_free_fit
        return float(fit.unknowns[_NORTH]), float(np.sqrt(fit.covariance[_NORTH, _NORTH]))

    def corrected(self, rate: UpRate | None = None) -> JointBiases:
        """Biases with a rate Up, if there is one, taken away from the vertical gyros.

        Meant for a rate that ``applies``. One of several temperatures is much the safer: three biases
        that differ up and down by little more than the noise often pass for a rate.

        Parameters
        ----------
        rate : UpRate, optional
            Of several temperatures together, these dwells among them; otherwise that of these dwells.
        """
        rate = rate or self.up_rate
        if not rate.weights:
            return self.north_free
        biases, vertical = self.north_free, _vertical(self.dwells)
        response, weights = np.zeros((2, 3 * len(self.dwells)))
        response[vertical] = [dwell.position.up_sign for dwell in self.dwells]
        weights[vertical] = [rate.weights.get(dwell.number, 0.0) for dwell in self.dwells]
        left = np.eye(len(response)) - np.outer(response, weights)
        # What the rate's variance holds beyond these biases: other dwells, and temperatures up and down.
        beyond = max(0.0, rate.sigma**2 - float(weights @ biases.covariance @ weights))
        return JointBiases(
            biases.bias_radps - rate.rate * response.reshape(-1, 3),
            left @ biases.covariance @ left.T + beyond * np.outer(response, response),
        )

    def _shared(self, part: slice) -> tuple[FloatArray, FloatArray]:
        return self.fit.unknowns[part], np.sqrt(np.diagonal(self.fit.covariance)[part])


def group_stops(dwells: Iterable[JointDwell]) -> list[tuple[JointDwell, ...]]:
    """Dwells, in the order of time, by stop of the chamber.

    A stop is one power-on, cycle and set point in a row, with gyros as warm in each dwell as in those
    before it within 5 K.
    """
    keys = itertools.groupby(dwells, lambda dwell: (dwell.run, dwell.cycle, repr(dwell.chamber_set_c)))
    return [part for _, group in keys for part in _equally_warm(group)]


def solve_jointly(dwells: Sequence[JointDwell], prior: PriorKnowledge) -> JointSolution:
    """Solve the dwells of one temperature together.

    Parameters
    ----------
    dwells : sequence of JointDwell
        In one run of the INS at one temperature, in any positions.
    prior : PriorKnowledge
        What is known beforehand, as for each dwell by itself.

    Raises
    ------
    MeasurementError
        There is no dwell.
    """
    if not dwells:
        raise MeasurementError("there is no dwell to solve; a joint solution needs at least one")
    earth_rate = dwells[0].information.earth_rate
    rows = [DwellRows.of(dwell.information, dwell.position, prior) for dwell in dwells]
    root, free_root = declared_root(prior, earth_rate), north_free_root(prior, earth_rate)
    fit, north_free_fit = solve_together(rows, root), solve_together(rows, free_root)
    pairs = _pairs(dwells, north_free_fit, prior.bias_slope)
    return JointSolution(
        dwells=tuple(dwells),
        single=_side_by_side([solve_alone(each, root) for each in rows]),
        together=_biases(fit),
        north_free=_biases(north_free_fit),
        fit=fit,
        north_free_fit=north_free_fit,
        pairs=pairs,
        up_rate=up_rate([pairs], earth_rate),
    )


def pooled_up_rate(solutions: Sequence[JointSolution]) -> UpRate | None:
    """Rate Up from several temperatures together; the latitude is the same at all of them.

    Dwells that do not share what they are meant to, whatever the latitude, are left out; None if
    there are no others.
    """
    agreeing = [each for each in solutions if each.agrees]
    if not agreeing:
        return None
    return up_rate([each.pairs for each in agreeing], agreeing[0].dwells[0].information.earth_rate)


def _equally_warm(dwells: Iterable[JointDwell]) -> list[tuple[JointDwell, ...]]:
    """Split where the temperature leaves the mean so far; one that is not known counts as equal."""
    groups: list[list[JointDwell]] = []
    for dwell in dwells:
        known = [each.mean_c for each in groups[-1] if math.isfinite(each.mean_c)] if groups else []
        if not groups or (known and abs(dwell.mean_c - sum(known) / len(known)) > _SAME_TEMPERATURE_K):
            groups.append([])
        groups[-1].append(dwell)
    return [tuple(group) for group in groups]


def _biases(fit: JointFit) -> JointBiases:
    return JointBiases(fit.unknowns[SHARED:].reshape(-1, 3), fit.covariance[SHARED:, SHARED:])


def _side_by_side(singles: Sequence[tuple[FloatArray, FloatArray]]) -> JointBiases:
    biases, covariances = zip(*singles, strict=True)
    return JointBiases(np.vstack(biases), np.asarray(block_diag(*covariances)))


def _vertical(dwells: Sequence[JointDwell]) -> IntArray:
    """Index of each dwell's vertical gyro among all biases."""
    return np.array([3 * index + dwell.position.up_axis for index, dwell in enumerate(dwells)])


def _pairs(dwells: Sequence[JointDwell], fit: JointFit, bias_slope: float) -> VerticalPairs:
    halves = {axis: half for axis in range(3) if (half := _half_difference(dwells, axis))}
    numbers = {dwell.number: index for index, dwell in enumerate(dwells)}
    weights = np.zeros((len(halves), len(dwells)))
    shift_c = np.zeros(len(halves))
    for row, (axis, half) in enumerate(halves.items()):
        for number, weight in half.items():
            weights[row, numbers[number]] = weight
            shift_c[row] += weight * dwells[numbers[number]].gyro_c[axis]
    taken = SHARED + _vertical(dwells)
    covariance = weights @ fit.covariance[np.ix_(taken, taken)] @ weights.T
    return VerticalPairs(
        gyros=tuple(halves),
        half_difference=weights @ fit.unknowns[taken],
        covariance=covariance + np.diag(np.nan_to_num(bias_slope * shift_c) ** 2),
        weights=tuple(halves.values()),
        north_rate=float(fit.unknowns[_NORTH]),
        north_variance=float(fit.covariance[_NORTH, _NORTH]),
        north_covariance=weights @ fit.covariance[taken, _NORTH],
    )


def _half_difference(dwells: Sequence[JointDwell], axis: int) -> dict[int, float]:
    """Weight of each dwell in half the difference up less down of one gyro; empty without both."""
    ways = [
        [
            dwell.number
            for dwell in dwells
            if dwell.position.up_axis == axis and dwell.position.up_sign == sign
        ]
        for sign in (1, -1)
    ]
    up, down = ways
    if not (up and down):
        return {}
    return {number: 0.5 / len(up) for number in up} | {number: -0.5 / len(down) for number in down}
