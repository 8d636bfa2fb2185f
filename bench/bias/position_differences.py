"""Differences of a gyro's bias between the positions of a plateau, at one temperature.

The dwells of a plateau are measured one after the other, while the gyros still drift by a kelvin or more, so
a bias that depends on temperature would look like one that depends on position. Each dwell is therefore
reduced to the mean temperature of its plateau by the curve of its gyro: a polynomial through the means of all
plateaus, common to all positions, with a constant for each power-on. The plateaus determine its degree, at
most 3. The uncertainty of the curve, larger if the plateaus scatter about it by more than their noise,
contributes to that of the differences, and so do the powers that they do not determine.

Passes of the same plateau, in several cycles, are averaged if they agree. The uncertainty of their mean is
the larger one of two: with independent errors of all dwells, and with the errors of common sources, as
accelerometers that follow the temperature, the same in each pass.

References
----------
Birge, "The Calculation of Errors by the Method of Least Squares", Phys. Rev. 40 (1932) 207 (scatter).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import permutations

import numpy as np

from gyrobench.bench.bias.dwell_table import DwellRow
from gyrobench.bench.bias.error_split import NONE_SHARED, SharedErrors
from gyrobench.bench.bias.plateaus import mean_c
from gyrobench.bench.bias.statistics import chi2_p_value, indicator_columns
from gyrobench.bench.foundations.arrays import FloatArray
from gyrobench.bench.navigation.positions import POSITIONS

_Plateau = Sequence[DwellRow]

#: Prior standard deviation of the slope of a gyro's bias, (deg/h)/K, if the run does not determine it.
SLOPE_SIGMA_DPH_PER_C = 0.002
#: Prior standard deviation of the constant of a position, deg/h.
_POSITION_SIGMA_DPH = 0.1
#: Scale of temperatures in the cubic, K: of the order of the range of a campaign.
_SCALE_C = 50.0
_POWERS = np.arange(1, 4)
#: Prior standard deviation of the powers that the temperatures do not determine, relative to the highest one
#: that they do: in smooth curves no power is much larger than the one below.
_HIGHER_SIZE = 2.0
#: Temperatures count as different from this distance on, K: those of one plateau differ by less.
_MIN_DISTANCE_K = 10.0


@dataclass(frozen=True, eq=False)
class CubicBiasCurve:
    """Bias of a gyro as a function of its temperature, up to a constant."""

    reference_c: float  #: Temperature at which it is zero.
    #: coefficients, covariance: Shape (3,) and (3, 3). Of the powers 1 to 3 of the temperature above the
    #: reference, in units of 50 K; deg/h.
    coefficients: FloatArray
    covariance: FloatArray

    def responses(self, temperature_c: FloatArray) -> FloatArray:
        """Responses (n, 3) of biases at temperatures (n,) to the coefficients."""
        scaled = (temperature_c - self.reference_c) / _SCALE_C
        return np.asarray(scaled[:, np.newaxis] ** _POWERS)

    def reduce(
        self, bias_dph: FloatArray, sigma_dph: FloatArray, temperature_c: FloatArray, to_c: FloatArray | float
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Biases (n,) at temperatures (n,), reduced to others.

        Also returns the covariance (n, n) of the change, and the matrix (n, n) that whitens the result.
        """
        responses = self.responses(temperature_c) - self.responses(np.broadcast_to(to_c, temperature_c.shape))
        covariance = responses @ self.covariance @ responses.T
        white = np.linalg.inv(np.linalg.cholesky(np.diag(sigma_dph**2) + covariance))
        return bias_dph - responses @ self.coefficients, covariance, white


@dataclass(frozen=True)
class Difference:
    """Bias of a gyro in position ``high`` minus that in position ``low``, and its standard uncertainty."""

    high: str
    low: str
    value_dph: float
    sigma_dph: float
    common_dph: float  #: Part of the standard uncertainty that is the same in each pass.


@dataclass(frozen=True)
class PositionDifferences:
    """Differences between all positions of one plateau, over one or more passes."""

    temperature_c: float  #: Mean of the gyro.
    differences: tuple[Difference, ...]  #: Of every pair measured in one pass, in both orders.
    p_value: float  #: Probability of passes that disagree at least as much by chance; NaN for a single one.


def fit_bias_curve(plateaus: Sequence[_Plateau], axis: int) -> CubicBiasCurve:
    """Fit the curve of one gyro to the means of plateaus.

    ``plateaus``: of the whole run, with a result for this gyro in each dwell. ``axis``: 0, 1 or 2. Without
    plateaus, or with one temperature only, the slope is zero with an uncertainty of 0.002 (deg/h)/K.
    """
    bias_dph = np.array([np.mean([row.bias_dph[axis] for row in plateau]) for plateau in plateaus])
    sigma_dph = np.array(
        [np.linalg.norm([row.sigma_dph[axis] for row in plateau]) / len(plateau) for plateau in plateaus]
    )
    temperature_c = np.array([mean_c(plateau, axis) for plateau in plateaus])
    return fit_curve(temperature_c, bias_dph, sigma_dph, [plateau[0].run for plateau in plateaus])


def fit_curve(
    temperature_c: FloatArray,
    bias_dph: FloatArray,
    sigma_dph: FloatArray,
    runs: Sequence[object],
    positions: Sequence[str] = (),
) -> CubicBiasCurve:
    """Fit the curve of one gyro to biases (n,) with their standard uncertainties, at temperatures (n,).

    ``runs``: power cycle of each, which has a constant. ``positions``: that of each, which has one as well if
    given. The curve has no higher degree than the temperatures determine: a higher one would follow the
    positions. Higher powers are zero, uncertain by the size of the last one. Without data, or with one
    temperature only, as :func:`fit_bias_curve`.
    """
    max_size_dph = SLOPE_SIGMA_DPH_PER_C * _SCALE_C
    curve = CubicBiasCurve(
        float(temperature_c.mean()) if len(temperature_c) else 0.0,
        np.zeros(len(_POWERS)),
        max_size_dph**2 * np.eye(len(_POWERS)),
    )
    if not len(temperature_c):
        return curve
    of_runs = indicator_columns(runs)
    of_positions = indicator_columns(positions or [""] * len(temperature_c))
    powers = min(max(_different_temperatures(temperature_c) - 1, 1), len(_POWERS))
    columns = np.hstack([of_runs, of_positions, curve.responses(temperature_c)]) / sigma_dph[:, np.newaxis]
    rows, higher_rows = np.hsplit(columns, [columns.shape[1] - len(_POWERS) + powers])
    information = np.r_[
        np.zeros(of_runs.shape[1]),
        np.full(of_positions.shape[1], _POSITION_SIGMA_DPH**-2.0),
        np.full(powers, max_size_dph**-2.0),
    ]
    data = bias_dph / sigma_dph
    covariance = np.linalg.inv(rows.T @ rows + np.diag(information))
    gain = covariance @ rows.T
    parameters = gain @ data
    dof = len(data) - float(np.trace(rows @ gain))
    scatter = float(np.sum((data - rows @ parameters) ** 2)) / dof if dof > 0.5 else 1.0
    coefficients, errors = parameters[-powers:], max(1.0, scatter) * covariance[-powers:, -powers:]
    higher_dph = min(_HIGHER_SIZE * math.hypot(coefficients[-1], math.sqrt(errors[-1, -1])), max_size_dph)
    missing = len(_POWERS) - powers
    by_higher = np.vstack([(gain @ higher_rows)[-powers:], -np.eye(missing)])
    return CubicBiasCurve(
        curve.reference_c,
        np.pad(coefficients, (0, missing)),
        np.pad(errors, (0, missing)) + higher_dph**2 * by_higher @ by_higher.T,
    )


def _different_temperatures(temperature_c: FloatArray) -> int:
    """Number of temperatures that lie far enough apart to determine a curve."""
    count, last_c = 0, -np.inf
    for each_c in np.sort(temperature_c):
        if each_c >= last_c + _MIN_DISTANCE_K:
            count, last_c = count + 1, each_c
    return count


def position_differences(
    passes: Sequence[_Plateau], axis: int, curve: CubicBiasCurve, shared: SharedErrors = NONE_SHARED
) -> PositionDifferences:
    """Differences between positions over the passes of one plateau, with a constant for each pass.

    ``passes``: with a result for this gyro in each dwell, linked by common positions; two positions or more.
    ``shared``: errors that are the same in all dwells, as parts of their uncertainties.
    """
    rows = [row for each in passes for row in each]
    index = [number for number, each in enumerate(passes) for _ in each]
    plateau_c = np.array([mean_c(each, axis) for each in passes])[index]
    bias_dph, sigma_dph, gyro_c = (
        np.array([getattr(row, name)[axis] for row in rows]) for name in ("bias_dph", "sigma_dph", "gyro_c")
    )
    reduced_dph, by_curve, white = curve.reduce(bias_dph, sigma_dph, gyro_c, plateau_c)
    positions = [name for name in POSITIONS if any(row.position == name for row in rows)]
    # The first position is the reference: only differences are observable.
    columns = [[float(row.position == name) for name in positions[1:]] for row in rows]
    design = white @ np.hstack([indicator_columns(index), columns])
    data = white @ reduced_dph
    covariance = np.asarray(np.linalg.inv(design.T @ design), dtype=np.float64)
    gain = covariance @ design.T
    parameters = np.asarray(gain @ data, dtype=np.float64)
    dof = len(rows) - len(parameters)
    chi2 = float(np.sum((data - design @ parameters) ** 2))
    common = np.array([shared[row.dwell][axis] if shared else [] for row in rows])
    independent = np.diag(np.maximum(sigma_dph**2 - (common**2).sum(axis=1), 0.0))
    by_rows = gain @ white
    by_common = by_rows @ common @ common.T @ by_rows.T
    with_common = by_rows @ (independent + by_curve) @ by_rows.T + by_common
    first = len(passes)
    differences = _differences(
        positions, parameters[first:], [each[first:, first:] for each in (covariance, with_common, by_common)]
    )
    measured_pairs = {(a.position, b.position) for each in passes for a, b in permutations(each, 2)}
    return PositionDifferences(
        temperature_c=float(plateau_c.mean()),
        differences=tuple(each for each in differences if (each.high, each.low) in measured_pairs),
        p_value=chi2_p_value(dof, chi2) if len(passes) > 1 and dof else math.nan,
    )


def _differences(
    positions: Sequence[str], values: FloatArray, covariances: Sequence[FloatArray]
) -> tuple[Difference, ...]:
    """Differences of all pairs, each with the largest of its variances.

    ``values``: differences from the first position. The last one of ``covariances`` is that of the errors
    that are the same in each pass.
    """
    value = [0.0, *values.tolist()]
    padded = np.zeros((len(covariances), len(value), len(value)))
    padded[:, 1:, 1:] = covariances
    diagonal = np.diagonal(padded, axis1=1, axis2=2)
    variances = diagonal[:, :, np.newaxis] + diagonal[:, np.newaxis] - 2.0 * padded
    sigma = np.sqrt(variances.max(axis=0)).tolist()
    common = np.sqrt(np.maximum(variances[-1], 0.0)).tolist()
    return tuple(
        Difference(positions[a], positions[b], value[a] - value[b], sigma[a][b], common[a][b])
        for a, b in permutations(range(len(positions)), 2)
    )
