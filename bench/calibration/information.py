"""Information of recordings on the coefficients: white rows of the least-squares problem, linearised."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from gyrobench.bench.bias.statistics import compress, solve
from gyrobench.bench.calibration.coefficients import COEFFICIENTS, COUNT
from gyrobench.bench.calibration.strapdown import ASYMMETRIES, DELAY, G_SENSITIVITIES, LEVER_ARMS, QUADRATIC
from gyrobench.bench.foundations.arrays import (
    DPH_TO_RADPS,
    STANDARD_GRAVITY,
    UG_TO_MPS2,
    BoolArray,
    FloatArray,
)

#: Large drift of a gyro's bias, rad/s^2.
BIAS_DRIFT = 0.1 * DPH_TO_RADPS / 3600.0
#: Usual size of an accelerometer's quadratic term, s^2/m: 20 ug/g^2.
USUAL_QUADRATIC = 20.0 * UG_TO_MPS2 / STANDARD_GRAVITY**2
#: Large attitude error at the start, rad.
ATTITUDE_ERROR = 0.5
#: Large error of the latitude, rad.
_LATITUDE_ERROR = 0.1
#: A parameter is observed if its uncertainty grows by less than this factor when the sizes are ten times as
#: large.
_MAX_GROWTH = 1.1
#: The same condition for a direction of several parameters, as a singular value of rows scaled by the sizes.
MIN_SINGULAR_VALUE = float((_MAX_GROWTH**2 - 1.0) ** -0.5)
#: Size of the accelerometers' scale factor errors if gravity replaces the vertical specific force: their mean
#: is not observed, and affects the other coefficients only in second order.
FORCE_SCALE = 1e-4
#: Masks of the coefficients that are scale factors of accelerometers, and of gyros.
IS_FORCE_SCALE = [each.name == "accelerometer_scale_factor" for each in COEFFICIENTS]
IS_GYRO_SCALE = [each.name == "gyro_scale_factor" for each in COEFFICIENTS]
#: Number of rows that are compressed at once, relative to the number of columns.
_ROWS_PER_COLUMN = 16


@dataclass(frozen=True)
class CalibrationOptions:
    """Optional parameters to estimate, and assumptions about noise, site and table."""

    lever_arms: bool = False  #: Positions of the y and z accelerometers relative to the x accelerometer.
    delay: bool = False  #: Delay of the accelerometers relative to the gyros.
    #: Quadratic terms of the accelerometers. None: of the usual size, as a prior, so that they pass for no
    #: biases.
    quadratic: bool | None = False
    #: Sensitivities of the gyro biases to specific force; None: only if they explain what noise does not.
    g_sensitivity: bool | None = False
    #: Indices of the gyros whose scale factor asymmetry is estimated. None: those with whole turns in both
    #: directions, whose asymmetry would look like a bias.
    asymmetries: tuple[int, ...] | None = None
    #: Standard uncertainty, rad, of the table's return after whole turns; None: spins are treated as any
    #: other rotation.
    whole_turns: float | None = None
    gravity: float | None = None  #: Local gravity, m/s^2; None: normal gravity of the site.
    #: Random walks of gyros (rad/sqrt(s)) and accelerometers (m/s/sqrt(s)); None: as measured at rest.
    walks: tuple[float, float] | None = None
    gravity_sigma: float = 0.0  #: Standard uncertainty of gravity, m/s^2.
    latitude_sigma: float = 0.0  #: Standard uncertainty of the latitude, rad.
    #: Standard uncertainty, rad, of the change of heading in rotations about Up by the table's readings;
    #: None: the readings are not used.
    heading: float | None = None
    #: Standard uncertainty, rad/s^2, of a steady drift of each gyro's bias in each recording, relative to the
    #: bias at half time; 0: none is estimated.
    bias_drift: float = 0.0
    #: Change of the scale factors of all gyros and of all accelerometers for one standard uncertainty of the
    #: time between samples: for rates a longer time gives larger angles, for velocity increments smaller
    #: forces.
    scales_by_time: tuple[float, float] = (0.0, 0.0)

    @property
    def columns(self) -> list[int]:
        """Columns of the parameters common to all recordings; the x accelerometer is the origin."""
        arms = range(LEVER_ARMS.start + 3, LEVER_ARMS.stop) if self.lever_arms else ()
        squares = range(QUADRATIC.start, QUADRATIC.stop) if self.quadratic is not False else ()
        by_force = range(G_SENSITIVITIES.start, G_SENSITIVITIES.stop) if self.g_sensitivity else ()
        by_sign = [ASYMMETRIES.start + axis for axis in self.asymmetries or ()]
        return [*range(COUNT), *arms, *([DELAY] if self.delay else []), *squares, *by_force, *by_sign]


def gyros_spun_both_ways(turns: Iterable[tuple[int, float]]) -> tuple[int, ...]:
    """Indices of gyros with whole turns in both directions, from the axis and the angle of each turn."""
    directions = {(axis, angle > 0.0) for axis, angle in turns}
    return tuple(axis for axis in range(3) if {(axis, True), (axis, False)} <= directions)


@dataclass(frozen=True, eq=False)
class Information:
    """White rows of the problem, linear in the coefficients and all other parameters about assumed values."""

    #: Rows (m, 21 + k + 2) of each recording, SI: coefficients, optional parameters, initial attitudes,
    #: drifts of the biases; then an error of the latitude, and data. Solutions are values of the parameters,
    #: but corrections of the attitudes.
    blocks: list[FloatArray]
    sizes: FloatArray  #: Shape (21 + k,). Large values of the parameters, SI.
    #: Parameters whose sizes are standard uncertainties of priors, as masks (21 + k,) by source.
    priors: Mapping[str, BoolArray]

    @property
    def is_prior(self) -> BoolArray:
        """Mask (21 + k,) of the parameters with a prior."""
        return np.asarray(np.any(list(self.priors.values()), axis=0))

    @cached_property
    def root(self) -> FloatArray:
        """Fewest rows (m, 21 + k + 2) with the same normal equations; latitude and data last."""
        # In parts that fit into the processor's cache.
        size = _ROWS_PER_COLUMN * self.blocks[0].shape[1]
        parts = (part for each in self.blocks for part in np.array_split(each, len(each) // size + 1))
        return compress(np.vstack([compress(part) for part in parts]))

    def solve(self, origin: FloatArray | None = None) -> tuple[FloatArray, FloatArray, BoolArray]:
        """Values (21 + k,), their covariance, and a mask of those that the data determine.

        Values that the data do not determine stay near ``origin`` (21 + k,), or zero.
        """
        origin_values = np.zeros(len(self.sizes)) if origin is None else origin
        rows, residual = self.root[:, :-2], self.root[:, -1] - self.root[:, :-2] @ origin_values
        values, covariance = solve(rows, residual, np.diag(self.sizes))
        enlarged = np.where(self.is_prior, 1.0, 10.0) * self.sizes
        _, wide_covariance = solve(rows, residual, np.diag(enlarged))
        growth = np.sqrt(np.diag(wide_covariance) / np.diag(covariance))
        return origin_values + values, covariance, np.asarray(growth < _MAX_GROWTH)

    def chi2(self, values: FloatArray) -> float:
        """Sum of squared residuals at values of the parameters (21 + k,)."""
        return float(np.linalg.norm(self.root @ [*values, 0.0, -1.0]) ** 2)

    def project_observable(self, step: FloatArray, min_singular_value: float) -> FloatArray:
        """Part of a step of the parameters (21 + k,) along the directions that the data determine.

        Along the other directions, such as a heading with a bias East and scale factors, the sum of squares
        is a curved valley, which a step along its tangent leaves. ``min_singular_value``: smallest change of
        the residuals, in standard deviations, for one size along a direction.
        """
        _, singular, directions = np.linalg.svd(
            np.vstack([self.root[:, :-2] * self.sizes, np.diag(self.is_prior)])
        )
        observable = directions[: len(singular)][singular > min_singular_value]
        return np.asarray(self.sizes * (observable.T @ (observable @ (step / self.sizes))))

    def latitude_correction(self) -> tuple[float, float]:
        """Correction of the latitude if it was a parameter, and its uncertainty, rad."""
        sizes = np.append(self.sizes, _LATITUDE_ERROR)
        values, covariance = solve(self.root[:, :-1], self.root[:, -1], np.diag(sizes))
        return float(values[-1]), float(np.sqrt(covariance[-1, -1]))

    def latitude_shift(self) -> FloatArray:
        """Change of the values (21 + k,) for an error of the latitude, per rad."""
        return solve(self.root[:, :-2], self.root[:, -2], np.diag(self.sizes))[0]
