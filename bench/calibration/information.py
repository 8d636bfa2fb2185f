"""What recordings show of the coefficients: white rows of a least-squares problem at assumed values."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from gyrobench.bench.bias.statistics import compress, solve
from gyrobench.bench.calibration.coefficients import BESIDE, COEFFICIENTS, COUNT
from gyrobench.bench.calibration.increment_recording import SensorNoise
from gyrobench.bench.calibration.section import IncrementSection
from gyrobench.bench.calibration.strapdown import (
    ASYMMETRIES,
    ATTITUDE,
    DELAY,
    DRIFT,
    G_SENSITIVITIES,
    LATITUDE,
    LEVER_ARMS,
    QUADRATIC,
    Trajectory,
    white_rows,
)
from gyrobench.bench.foundations.arrays import DPH_TO_RADPS, BoolArray, FloatArray
from gyrobench.bench.navigation.error_model import Site

#: Large drift of a gyro's bias, rad/s^2.
BIAS_DRIFT = 0.1 * DPH_TO_RADPS / 3600.0
#: Large attitude error at the start, rad.
ATTITUDE_ERROR = 0.5
#: Large error of the latitude, rad.
_LATITUDE_ERROR = 0.1
#: A parameter is observed if sizes ten times as large let its uncertainty grow by less than this.
_MAX_GROWTH = 1.1
#: The same for a direction of several parameters: by how much one size of it changes the residuals.
MIN_SINGULAR_VALUE = float((_MAX_GROWTH**2 - 1.0) ** -0.5)
#: Size of the accelerometers' scale factor errors where gravity stands in place of the vertical specific
#: force: their mean is not observed, and affects the other coefficients in second order.
FORCE_SCALE = 1e-4
#: Which coefficients are scale factors of accelerometers, and of gyros.
IS_FORCE_SCALE = [each.name == "accelerometer_scale_factor" for each in COEFFICIENTS]
IS_GYRO_SCALE = [each.name == "gyro_scale_factor" for each in COEFFICIENTS]
#: So closely the scale factors of accelerometers have the mean zero where the vertical force is not measured.
_COMMON_SCALE = 1e-9
#: Rows for each column that are compressed at once.
_ROWS_A_COLUMN = 16


@dataclass(frozen=True)
class CalibrationOptions:
    """What is estimated beside the coefficients, and what the table contributes."""

    lever_arms: bool = False  #: Places of the y and z accelerometers relative to the x accelerometer.
    delay: bool = False  #: Delay of the accelerometers against the gyros.
    quadratic: bool = False  #: Quadratic terms of the accelerometers.
    #: Biases of the gyros that follow the specific force; None: where they explain what noise does not.
    g_sensitivity: bool | None = False
    #: Gyros the asymmetry of whose scale factor is estimated: by default those with whole turns both ways,
    #: whose asymmetry would pass for a bias; none: ``()``.
    asymmetries: tuple[int, ...] | None = None
    #: Standard uncertainty, rad, with which the table returns after whole turns; None: spins count as any
    #: other rotation.
    whole_turns: float | None = None
    gravity: float | None = None  #: Local gravity, m/s^2; None: normal gravity of the site.
    #: Random walks of gyros (rad/sqrt(s)) and accelerometers (m/s/sqrt(s)); None: as measured at rest.
    walks: tuple[float, float] | None = None
    gravity_sigma: float = 0.0  #: Standard uncertainty of gravity, m/s^2.
    latitude_sigma: float = 0.0  #: Standard uncertainty of the latitude, rad.
    #: Standard uncertainty, rad, of the heading over rotations about Up that a recording's table measures;
    #: None: they do not count.
    heading: float | None = None
    #: Standard uncertainty, rad/s^2, of a steady drift of each gyro's bias in each recording, about the bias
    #: at half time; 0: none is estimated.
    bias_drift: float = 0.0
    #: By how much the standard uncertainty of the time between samples changes the scale factors of all gyros
    #: and of all accelerometers: rates times a longer time are larger angles, velocity increments over it
    #: smaller forces.
    scales_by_time: tuple[float, float] = (0.0, 0.0)
    #: Whether lever arms, delay, quadratic terms, g-sensitivities and drift are tried as explanations of a
    #: misfit, one by one: each takes as long as the estimate.
    are_explained: bool = True

    @property
    def columns(self) -> list[int]:
        """Which columns are common to all recordings; the x accelerometer's place is the origin."""
        arms = range(LEVER_ARMS.start + 3, LEVER_ARMS.stop) if self.lever_arms else ()
        squares = range(QUADRATIC.start, QUADRATIC.stop) if self.quadratic else ()
        by_force = range(G_SENSITIVITIES.start, G_SENSITIVITIES.stop) if self.g_sensitivity else ()
        by_sign = [ASYMMETRIES.start + axis for axis in self.asymmetries or ()]
        return [*range(COUNT), *arms, *([DELAY] if self.delay else []), *squares, *by_force, *by_sign]


def spun_both_ways(turns: Iterable[tuple[int, float]]) -> tuple[int, ...]:
    """Gyros with whole turns both ways, from the axis and the angle of each."""
    ways = {(axis, angle > 0.0) for axis, angle in turns}
    return tuple(axis for axis in range(3) if {(axis, True), (axis, False)} <= ways)


def integrated_sections(
    sections: Sequence[IncrementSection],
    starts: Sequence[FloatArray],
    common: FloatArray,
    site: Site,
    options: CalibrationOptions,
) -> list[Trajectory]:
    """Trajectory of each section from its attitude (3, 3) at the start, freed of ``common`` (46,)."""
    gravity, every = options.gravity or site.gravity, range(LATITUDE)
    columns = [*options.columns, *every[ATTITUDE], *(every[DRIFT] if options.bias_drift else ()), LATITUDE]
    pairs = zip(sections, starts, strict=True)
    return [section.integrated(start, common, site.latitude, gravity, columns) for section, start in pairs]


@dataclass(frozen=True, eq=False)
class Information:
    """White rows as a function of the coefficients and of all other parameters, at assumed values of them."""

    #: Rows (m, 21 + k + 2) of each recording, SI: coefficients, what is estimated beside them, attitudes at
    #: the start, drifts of the biases; then an error of the latitude, and data. They give the values, of the
    #: attitudes corrections to those assumed.
    blocks: list[FloatArray]
    sizes: FloatArray  #: Shape (21 + k,). Large values of the parameters, SI.
    drifts: int  #: How many of the parameters, the last ones, are drifts of biases.

    @classmethod
    def of(
        cls,
        sections: Sequence[IncrementSection],
        trajectories: Sequence[Trajectory],
        common: FloatArray,
        noise: SensorNoise,
        site: Site,
        options: CalibrationOptions,
    ) -> Information:
        """From what :func:`integrated_sections` gives with the values ``common`` (46,)."""
        used, blocks = options.columns, []
        for number, (section, trajectory) in enumerate(zip(sections, trajectories, strict=True)):
            table = options.whole_turns, options.heading
            rows, data = white_rows(
                trajectory, section.lengths_s, section.epochs, noise, site.latitude, *table
            )
            own = rows[:, len(used) : -1].reshape(len(rows), -1, 3)
            beside = np.zeros((len(rows), own.shape[1], len(sections), 3))
            beside[:, :, number] = own
            parts = rows[:, : len(used)], beside.reshape(len(rows), -1), rows[:, -1:]
            block = np.column_stack([*parts, data + rows[:, : len(used)] @ common[used]])
            blocks.append(block)
        if not any(section.epochs.has_vertical for section in sections):
            # Gravity in place of the vertical force does not show the mean of the scale factors.
            mean = np.zeros((1, blocks[0].shape[1]))
            mean[0, np.flatnonzero(IS_FORCE_SCALE)] = 1.0 / _COMMON_SCALE
            blocks.append(mean)
        sizes = np.array([each.size for each in (*COEFFICIENTS, *BESIDE)])
        if not all(each.epochs.has_vertical for each in sections):
            sizes[np.flatnonzero(IS_FORCE_SCALE)] = FORCE_SCALE
        count = 3 * len(sections)
        drifts = count if options.bias_drift else 0
        own_sizes = [ATTITUDE_ERROR] * count + [options.bias_drift] * drifts
        return cls(blocks, np.array([*sizes[used], *own_sizes]), drifts)

    @cached_property
    def root(self) -> FloatArray:
        """Fewest rows (m, 21 + k + 2) with the same normal equations; latitude and data last."""
        # By parts that fit a processor's cache.
        size = _ROWS_A_COLUMN * self.blocks[0].shape[1]
        parts = (part for each in self.blocks for part in np.array_split(each, len(each) // size + 1))
        return compress(np.vstack([compress(part) for part in parts]))

    def solve(self, origin: FloatArray | None = None) -> tuple[FloatArray, FloatArray, BoolArray]:
        """Values (21 + k,), their covariance, and which of them the data determine.

        What the data leave open stays near ``origin`` (21 + k,), or zero.
        """
        centre = np.zeros(len(self.sizes)) if origin is None else origin
        rows, left = self.root[:, :-2], self.root[:, -1] - self.root[:, :-2] @ centre
        values, covariance = solve(rows, left, np.diag(self.sizes))
        # Drifts are as likely as their sizes say.
        is_size = np.arange(len(self.sizes)) < len(self.sizes) - self.drifts
        _, wide = solve(rows, left, np.diag(np.where(is_size, 10.0, 1.0) * self.sizes))
        growth = np.sqrt(np.diag(wide) / np.diag(covariance))
        return centre + values, covariance, np.asarray(growth < _MAX_GROWTH)

    def chi2(self, values: FloatArray) -> float:
        """Sum of squared residuals at values of the parameters (21 + k,)."""
        return float(np.linalg.norm(self.root @ [*values, 0.0, -1.0]) ** 2)

    def shown(self, step: FloatArray, least: float) -> FloatArray:
        """Part of a step of the parameters (21 + k,) along what the data determine.

        Along what they leave open the sum of squares is a curved valley, such as a heading with a bias East
        and scale factors: a step along its tangent leaves it. ``least``: by how many standard deviations the
        residuals change along each direction over one size.
        """
        is_drift = np.arange(len(self.sizes)) >= len(self.sizes) - self.drifts
        _, singular, directions = np.linalg.svd(
            np.vstack([self.root[:, :-2] * self.sizes, np.diag(is_drift)])
        )
        known = directions[: len(singular)][singular > least]
        return np.asarray(self.sizes * (known.T @ (known @ (step / self.sizes))))

    def latitude_correction(self) -> tuple[float, float]:
        """What the data would add to the latitude if it were a parameter, and its uncertainty, rad."""
        sizes = np.append(self.sizes, _LATITUDE_ERROR)
        values, covariance = solve(self.root[:, :-1], self.root[:, -1], np.diag(sizes))
        return float(values[-1]), float(np.sqrt(covariance[-1, -1]))

    def site_parts(self, site: Site, options: CalibrationOptions) -> Mapping[str, FloatArray]:
        """Covariances (21 + k, 21 + k) by what is assumed of place and time, which the residuals hardly show.

        Of the coefficients and what is estimated beside them.
        """
        count = len(options.columns)
        # An error of gravity is one of all three scale factors.
        is_scale = np.isin(options.columns, np.flatnonzero(IS_FORCE_SCALE))
        shifts = {"gravity": is_scale * options.gravity_sigma / (options.gravity or site.gravity)}
        if options.latitude_sigma:
            shift, _ = solve(self.root[:, :-2], self.root[:, -2], np.diag(self.sizes))
            shifts["latitude"] = options.latitude_sigma * shift[:count]
        if any(options.scales_by_time):
            is_gyro_scale = np.isin(options.columns, np.flatnonzero(IS_GYRO_SCALE))
            by_gyro, by_force = options.scales_by_time
            shifts["time"] = by_gyro * is_gyro_scale + by_force * is_scale
        return {name: np.outer(shift, shift) for name, shift in shifts.items()}
