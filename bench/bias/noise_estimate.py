"""Estimates the noise of the INS from its navigation output at rest.

The attitude of an INS at rest changes by the integrated noise of its gyros, so the Allan variance of its
rotation vector, resolved in body axes, gives the angle random walk of each gyro. The horizontal velocities
change by the integrated noise of the accelerometers, and by gravity times the tilt accumulated from the noise
of the level gyros. At short averaging times the rounding of the output dominates (slope -1), then the
velocity random walk (slope -1/2), and at long ones the tilt (slope +1/2): a random walk of the acceleration
of ``g`` times the angle random walk.

Biases and Earth-rate coupling cause only slow trends: over the averaging times used, at most a sixth of a
window, they are nearly a ramp of the rate, to which the Allan variance here does not respond. The Schuler
feedback is computed from the velocities and subtracted.

Rounding errors are independent only between samples from one to the next of which the output changes by about
half a step or more, that is if the second differences have an rms of at least a step (rounding alone gives
0.7). If the output is coarser, only samples that far apart are used; if too few remain, the resolution hides
the noise, and only an upper limit is reported.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gyrobench.bench.bias.allan import (
    RANDOM_WALK,
    RATE_WALK,
    WHITE_ANGLE,
    AllanVariance,
    RateNoise,
    allan_variance,
    fit_rate_noise,
    on_grid,
)
from gyrobench.bench.bias.dwell import NavigationWindow
from gyrobench.bench.bias.noise_model import NoiseModel
from gyrobench.bench.foundations.arrays import (
    DEG_PER_SQRT_H_TO_SI,
    UG_PER_SQRT_HZ_TO_SI,
    BoolArray,
    FloatArray,
    integral,
)
from gyrobench.bench.foundations.errors import MeasurementError
from gyrobench.bench.navigation.attitude import rotation_vector_enu
from gyrobench.bench.navigation.earth import MEAN_RADIUS
from gyrobench.bench.navigation.positions import AXES

#: One-sided 95 % point of the normal distribution.
_LIMIT_SIGMAS = 1.645
#: A term below this number of sigmas is reported as an upper limit.
_SIGNIFICANT_SIGMAS = 2.0
#: A declared value that differs by more than this number of sigmas is not consistent.
_CONSISTENT_SIGMAS = 3.0
#: A declared value that the data exceed by this number of sigmas is replaced; higher, since dwells are many.
_EXCEEDING_SIGMAS = 4.0
#: Largest relative difference of intervals between epochs that count as equal.
_INTERVAL_TOLERANCE = 0.01
#: Share of the changes that may be smaller than the resolution, as by wraps or corrections.
_OUTLIER_SHARE = 0.05
#: Changes up to this are rounding of the arithmetic, m/s and rad.
_ARITHMETIC = 1e-11


@dataclass(frozen=True)
class NoiseParameter:
    """A noise parameter, estimated by its square."""

    square: float | None  #: Square of the parameter; None if the resolution hides it.
    #: Standard uncertainty of the square. The estimate of the square is unbiased, so it may be below zero.
    square_sigma: float = 0.0
    #: The parameter is below this with a confidence of 95 %; None if nothing is known.
    limit: float | None = None

    @classmethod
    def measured(cls, square: float, sigma: float) -> NoiseParameter:
        """Make a parameter that the resolution does not hide."""
        return cls(square, sigma, float(np.sqrt(max(square, 0.0) + _LIMIT_SIGMAS * sigma)))

    @property
    def value(self) -> float | None:
        """Best estimate; None if it is hidden."""
        return None if self.square is None else float(np.sqrt(max(self.square, 0.0)))

    @property
    def is_significant(self) -> bool:
        """Whether the value is significantly above zero."""
        return self.square is not None and self.square > _SIGNIFICANT_SIGMAS * self.square_sigma

    @property
    def sigma(self) -> float | None:
        """Standard uncertainty of the value; None if it is not significant."""
        return (
            self.square_sigma / (2.0 * float(np.sqrt(self.square)))
            if self.is_significant and self.square
            else None
        )

    def exceeds(self, value: float) -> bool:
        """Whether the parameter is significantly larger than this value."""
        return self.square is not None and self.square - value**2 > _EXCEEDING_SIGMAS * self.square_sigma

    def dof(self, value: float | None) -> float:
        """Degrees of freedom of a value from this estimate (JCGM 100, G.4.2); infinite if not measured."""
        return 2.0 * (value**2 / self.square_sigma) ** 2 if value and self.square_sigma > 0.0 else math.inf

    @property
    def conservative_value(self) -> float:
        """Value that the true one rarely exceeds: one sigma above in the square; the limit if hidden."""
        if self.square is None:
            return self.limit or 0.0
        return float(np.sqrt(max(self.square, 0.0) + self.square_sigma))

    def text(self, unit: str, unit_si: float) -> str:
        """Text with the value and its uncertainty, or the limit, in a unit of the given size in SI."""
        if self.value is not None and self.sigma is not None:
            value, sigma = self.value / unit_si, self.sigma / unit_si
            decimals = max(0, 1 - int(np.floor(np.log10(sigma))))
            return f"{value:.{decimals}f} ± {sigma:.{decimals}f} {unit}"
        below = "" if self.limit is None else f"below {self.limit / unit_si:.2g} {unit}"
        if self.square is not None:
            return below
        return "hidden by the resolution" + (f", {below}" if below else "")


@dataclass(frozen=True, eq=False)
class ChannelNoise:
    """Allan variance of one rate, and the noise terms fitted to it."""

    #: Of the rate (rad/s) or acceleration (m/s^2), from samples with independent rounding errors; from all
    #: samples if the resolution hides the noise.
    allan: AllanVariance
    step: float  #: Resolution of the output, estimated from the data, rad or m/s; 0 if it never changes.
    fit: RateNoise | None  #: None if the resolution hides the noise.

    @property
    def has_motion(self) -> BoolArray:
        """Mask (k,) of the averaging times at which the output changes at all."""
        return np.asarray(self.allan.deviation * self.allan.tau_s > _ARITHMETIC)

    @property
    def hiding_step(self) -> float:
        """Resolution if it hides the noise at all averaging times; otherwise 0."""
        longest = float(np.sqrt(2.0 * self.allan.variance[-1]) * self.allan.tau_s[-1])
        return self.step if self.fit is None and longest < self.step else 0.0

    def parameter(self, term: int) -> NoiseParameter:
        """Estimate of one of the terms of :mod:`gyrobench.bench.bias.allan`."""
        if self.fit is not None:
            return NoiseParameter.measured(float(self.fit.unbounded[term]), float(self.fit.sigmas[term]))
        if term != RANDOM_WALK or self.step == 0.0:
            return NoiseParameter(None)
        # A larger one would be observable: 2 N^2 tau is the mean square of a second difference.
        return NoiseParameter(None, limit=self.step / float(np.sqrt(2.0 * self.allan.tau_s[-1])))


@dataclass(frozen=True, eq=False)
class NoiseEstimate:
    """Noise of an INS from its output at rest; all in SI."""

    gyros: tuple[ChannelNoise, ChannelNoise, ChannelNoise]  #: Rates of the x, y and z gyro.
    all_gyros: ChannelNoise  #: The three pooled.
    heading: ChannelNoise  #: Rate about Up, by the attitude output.
    acceleration: ChannelNoise  #: Horizontal accelerations, both directions pooled.
    gravity: float  #: Gravity, m/s^2.
    duration_s: float  #: Length of all windows together.

    @property
    def angle_random_walks(self) -> tuple[NoiseParameter, ...]:
        """Of the x, y and z gyro, rad/sqrt(s)."""
        return tuple(gyro.parameter(RANDOM_WALK) for gyro in self.gyros)

    @property
    def angle_random_walk(self) -> NoiseParameter:
        """Of the three gyros together, rad/sqrt(s)."""
        return self.all_gyros.parameter(RANDOM_WALK)

    @property
    def angle_random_walk_of_tilt(self) -> NoiseParameter:
        """Of the level gyros, rad/sqrt(s), from the velocities; coarser, but independent."""
        walk = self.acceleration.parameter(RATE_WALK)
        if walk.square is None:
            return walk
        return NoiseParameter.measured(walk.square / self.gravity**2, walk.square_sigma / self.gravity**2)

    @property
    def velocity_random_walk(self) -> NoiseParameter:
        """Of the horizontal velocities, m/s/sqrt(s)."""
        return self.acceleration.parameter(RANDOM_WALK)

    @property
    def velocity_white(self) -> NoiseParameter:
        """Noise of each velocity output, m/s."""
        return self.acceleration.parameter(WHITE_ANGLE)

    @property
    def heading_white(self) -> NoiseParameter:
        """Noise of each heading output, rad; that of level angles may differ, but is not needed."""
        return self.heading.parameter(WHITE_ANGLE)

    def raised_model(self, declared: NoiseModel) -> NoiseModel:
        """Declared noise, with the estimates here in place of values that they significantly exceed."""

        def larger(value: float, *measured: NoiseParameter) -> tuple[float, float]:
            exceeding = [
                (each.value, each.dof(each.value))
                for each in measured
                if each.value is not None and each.exceeds(value)
            ]
            return max([(value, math.inf), *exceeding])

        values, dof = zip(
            larger(declared.angle_random_walk, self.angle_random_walk, *self.angle_random_walks),
            larger(declared.velocity_random_walk, self.velocity_random_walk),
            larger(declared.velocity_white, self.velocity_white),
            # If pulses hide the noise at all averaging times, the noise is at least their size.
            max(larger(declared.heading_white, self.heading_white), (self.heading.hiding_step, math.inf)),
            strict=True,
        )
        return NoiseModel(*values, dof)

    def noise_model(self) -> NoiseModel:
        """Make the noise model from these estimates.

        The angle random walk is that of all gyros, or of the noisiest if it significantly exceeds that. The
        velocity random walk is a conservative value: a single dwell determines it only coarsely, and with too
        small a value good dwells would fail the goodness-of-fit test. Hidden white noise is zero: add the
        resolution. Raises MeasurementError if the angle random walk is not significant.
        """
        arw = self.angle_random_walk
        if not arw.is_significant or arw.value is None:
            raise MeasurementError(
                "the angle random walk is not observable in these windows: the INS's output is too coarse "
                "or too noisy, or they are too short. Declare the noise of the data sheet"
            )
        noisier = [each for each in self.angle_random_walks if each.exceeds(arw.value)]
        arw = max([arw, *noisier], key=lambda each: each.square or 0.0)
        measured = (arw, self.velocity_random_walk, self.velocity_white, self.heading_white)
        values = (
            arw.value or 0.0,
            measured[1].conservative_value,
            measured[2].value or 0.0,
            measured[3].value or 0.0,
        )
        w, x, y, z = (each.dof(value) for each, value in zip(measured, values, strict=True))
        return NoiseModel(*values, (w, x, y, z))


@dataclass(frozen=True)
class NoiseComparison:
    """Comparison of a measured noise parameter with the declared one."""

    #: name, unit: For reports.
    name: str
    unit: str
    measured: NoiseParameter  #: In SI.
    declared: float  #: In SI.
    unit_si: float  #: Size of the unit in SI.

    @property
    def is_consistent(self) -> bool | None:
        """Whether the measurement is consistent with the declared value; None if nothing is known."""
        if self.measured.square is None:
            return None if self.measured.limit is None else self.declared <= self.measured.limit
        difference = abs(self.declared**2 - max(self.measured.square, 0.0))
        return difference <= _CONSISTENT_SIGMAS * self.measured.square_sigma

    @property
    def sentence(self) -> str:
        """One line of a report."""
        declared = f"declared {self.declared / self.unit_si:.3g} {self.unit}"
        return f"{self.name} {self.measured.text(self.unit, self.unit_si)}, {declared}: {self._verdict()}"

    def _verdict(self) -> str:
        if self.is_consistent is None:
            return "can't be compared"
        if self.is_consistent:
            return "consistent"
        return (
            "larger than declared"
            if (self.measured.value or 0.0) > self.declared
            else "smaller than declared"
        )


def compare_noise(estimate: NoiseEstimate, declared: NoiseModel) -> list[NoiseComparison]:
    """Compare measured noise with the declared one: gyro by gyro, then the other parameters."""
    per_gyro = [
        (f"angle random walk of the {axis} gyro", walk)
        for axis, walk in zip(AXES, estimate.angle_random_walks, strict=True)
    ]
    all_gyros = ("angle random walk of all gyros", estimate.angle_random_walk)
    by_tilt = ("angle random walk by the velocities", estimate.angle_random_walk_of_tilt)
    return [
        *(
            NoiseComparison(name, "deg/sqrt(h)", walk, declared.angle_random_walk, DEG_PER_SQRT_H_TO_SI)
            for name, walk in (*per_gyro, all_gyros, by_tilt)
        ),
        NoiseComparison(
            "velocity random walk",
            "ug/sqrt(Hz)",
            estimate.velocity_random_walk,
            declared.velocity_random_walk,
            UG_PER_SQRT_HZ_TO_SI,
        ),
        NoiseComparison(
            "noise of the velocity output", "m/s", estimate.velocity_white, declared.velocity_white, 1.0
        ),
        NoiseComparison(
            "noise of the attitude output", "urad", estimate.heading_white, declared.heading_white, 1e-6
        ),
    ]


@dataclass(frozen=True, eq=False)
class RestMotion:
    """Output of an INS at rest in one window, reduced to the input of the noise estimate."""

    time_s: FloatArray  #: Shape (n,). On the clock of the INS.
    velocity_mps: FloatArray  #: Shape (n, 2). East and North.
    rotation_enu: FloatArray  #: Shape (n, 3). Rotation vector since the first epoch, rad.
    rotation_steps_rad: FloatArray  #: Shape (n - 1,). Angle between neighbouring epochs.
    C_nb: FloatArray  #: Shape (3, 3). Attitude at the first epoch.

    @classmethod
    def of(cls, window: NavigationWindow) -> RestMotion:
        """Reduce a window to the input of the noise estimate, half its size."""
        C_nb, first = window.C_nb, window.C_nb[0].copy()
        steps = rotation_vector_enu(C_nb[1:] @ np.swapaxes(C_nb[:-1], 1, 2), np.eye(3))
        return cls(
            window.time_s,
            window.velocity_enu_mps[:, :2].copy(),
            rotation_vector_enu(C_nb, first),
            np.linalg.norm(steps, axis=1),
            first,
        )

    def beginning(self, duration_s: float) -> RestMotion:
        """The window up to this time after its first epoch."""
        count = int(np.searchsorted(self.time_s, self.time_s[0] + duration_s, side="right"))
        columns = (self.time_s, self.velocity_mps, self.rotation_enu)
        time_s, velocity_mps, rotation_enu = (each[:count] for each in columns)
        return RestMotion(time_s, velocity_mps, rotation_enu, self.rotation_steps_rad[: count - 1], self.C_nb)


def estimate_noise(windows: Sequence[NavigationWindow | RestMotion], gravity: float) -> NoiseEstimate:
    """Estimate the noise of an INS from its output at rest.

    ``windows``: of one or more dwells, of any attitude; epochs may be missing. ``gravity``: at the bench,
    m/s^2. Raises MeasurementError if there are no windows or too few data, or the epoch intervals differ.
    """
    if not windows:
        raise MeasurementError("no window to estimate noise from. Let the INS navigate at rest")
    motions = [each if isinstance(each, RestMotion) else RestMotion.of(each) for each in windows]
    on_grids = [on_grid(motion.time_s, _angles_and_velocities(motion, gravity)) for motion in motions]
    interval = _common_interval([interval for interval, _ in on_grids])
    values = [grid for _, grid in on_grids]
    attitude_step = _resolution([motion.rotation_steps_rad for motion in motions])
    velocity_step = _resolution([np.diff(motion.velocity_mps, axis=0) for motion in motions])

    def channel(columns: Sequence[int], step: float) -> ChannelNoise:
        return _channel_noise([grid[:, column] for column in columns for grid in values], interval, step)

    return NoiseEstimate(
        gyros=(channel([0], attitude_step), channel([1], attitude_step), channel([2], attitude_step)),
        all_gyros=channel([0, 1, 2], attitude_step),
        heading=channel([3], attitude_step),
        acceleration=channel([4, 5], velocity_step),
        gravity=gravity,
        duration_s=sum(float(motion.time_s[-1] - motion.time_s[0]) for motion in motions),
    )


def _angles_and_velocities(motion: RestMotion, gravity: float) -> FloatArray:
    """Columns (n, 6): rotation since the first epoch about x, y, z and Up; velocity E, N without feedback."""
    rotation, velocity, time_s = motion.rotation_enu, motion.velocity_mps, motion.time_s
    feedback = integral(integral(velocity, time_s), time_s) * gravity / MEAN_RADIUS
    return np.hstack([rotation @ motion.C_nb, rotation[:, 2:], velocity + feedback])


def _channel_noise(segments: list[FloatArray], interval: float, step: float) -> ChannelNoise:
    allan = allan_variance(segments, interval)
    is_coarse = np.sqrt(2.0 * allan.variance) * allan.tau_s < step
    if step == 0.0 or is_coarse[-1]:
        return ChannelNoise(allan, step, None)
    if not is_coarse.any():
        return ChannelNoise(allan, step, fit_rate_noise(allan))
    every = int(allan.factors[np.flatnonzero(is_coarse)[-1] + 1])
    try:
        sparse = allan_variance([segment[::every] for segment in segments], every * interval)
        return ChannelNoise(sparse, step, fit_rate_noise(sparse))
    except MeasurementError:  # too few samples are that far apart
        return ChannelNoise(allan, step, None)


def _common_interval(intervals: Sequence[float]) -> float:
    if max(intervals) > min(intervals) * (1.0 + _INTERVAL_TOLERANCE):
        raise MeasurementError(
            f"the windows have epochs every {min(intervals):.4g} s and every {max(intervals):.4g} s. "
            "Estimate the noise from windows of one output rate"
        )
    return float(np.mean(intervals))


def _resolution(changes: Sequence[FloatArray]) -> float:
    """Smallest change that is not zero, except a few outliers; 0 if there is none."""
    sizes = np.abs(np.concatenate([each.ravel() for each in changes]))
    sizes = sizes[sizes > _ARITHMETIC]
    return float(np.quantile(sizes, _OUTLIER_SHARE)) if len(sizes) else 0.0
