"""Increments of a unit that rests between rotations: finds rests and rotations, and measures the noise."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from gyrobench.bench.bias.allan import RANDOM_WALK, WHITE_ANGLE, allan_variance, fit_rate_noise
from gyrobench.bench.calibration.turns import net_turn
from gyrobench.bench.foundations.arrays import BoolArray, FloatArray, IntArray, true_spans
from gyrobench.bench.foundations.errors import MeasurementError
from gyrobench.bench.navigation.attitude import rotation_vectors
from gyrobench.bench.navigation.positions import AXES

#: Time, s, over which increments are averaged to detect motion.
_BLOCK_S = 0.5
#: Shortest rest, s; and shortest total time of the rests of a recording, s.
_MIN_REST_S, MIN_REST_TOTAL_S = 5.0, 60.0
#: Smallest net angle, rad, of a rotation between two rests; a smaller motion is a disturbance.
_MIN_ROTATION = np.deg2rad(1.0)
#: Smallest angle of a spin, rad, which returns to within :data:`_MIN_ROTATION` of its start.
_MIN_SPIN = np.deg2rad(350.0)

#: Largest differences of rate, rad/s, and specific force, m/s^2, between resting blocks beyond their noise.
_RATE_TOLERANCE, _FORCE_TOLERANCE = np.deg2rad(0.005), 2e-3
#: Rate, rad/s, above the lowest rate from which a unit counts as rotating.
_MAX_RATE_SPREAD = np.deg2rad(0.1)
_SIGMAS = 6.0
#: Time, s, in which a table that has stopped settles by some arcsec, slower than the tolerance of the rate.
_SETTLING_S = 10.0
#: Lower quartile of absolute differences of normal values, in standard deviations of one value.
_QUARTILE_PER_SIGMA = 0.3186 * np.sqrt(2.0)
#: Noise variance of level axes relative to the mean of all axes, if gravity replaces the vertical force.
_LEVEL_NOISE_RATIO = 1.5
#: Time between the samples of an Allan variance, s.
_ALLAN_S = 0.2


@dataclass(frozen=True)
class Rest:
    """A rest of the unit, as a range of samples."""

    begin: int  #: Index of the first sample.
    end: int  #: Index after the last sample.


@dataclass(frozen=True, eq=False)
class IncrementRecording:
    """Increments of angle and velocity, evenly sampled and without a gap.

    Raises MeasurementError if there are NaN values, or too few increments.
    """

    interval_s: float  #: Time between two samples.
    angle: FloatArray  #: Shape (n, 3). Rotation since the sample before, body axes, rad.
    velocity: FloatArray  #: Shape (n, 3). Integral of the specific force since the sample before, m/s.
    start_s: float = 0.0  #: Start of the first increment on the log's clock.
    #: Whether the vertical component of the velocity is measured, and not replaced by gravity.
    has_vertical: bool = True
    #: Shape (m, 3, 3). Attitudes of the table, ENU, up to a constant rotation between table and unit; None if
    #: not known.
    table: FloatArray | None = None
    #: Shape (m,). Increment from whose end each attitude applies; None if each increment has an attitude.
    table_from: IntArray | None = None
    #: Standard uncertainties, rad and m/s, by rounding of the attitude and velocity of which increments are
    #: differences. They can't be measured if a coarse output is constant at rest.
    rounding: tuple[float, float] = (0.0, 0.0)
    given_rests: tuple[Rest, ...] | None = None  #: Rests of the unit; None to find them.

    def __post_init__(self) -> None:
        for name, values in (("angle", self.angle), ("velocity", self.velocity)):
            if not np.isfinite(values).all():
                raise MeasurementError(f"an increment of {name} is not a number. Cut the recording there")
        if self.interval_s > _BLOCK_S:
            raise MeasurementError(
                f"samples are {self.interval_s:.3g} s apart; at most {_BLOCK_S:g} s is allowed. Check "
                "'time' in the import map; of a run, ins.signals.increments.period_s"
            )
        if self.duration_s < MIN_REST_TOTAL_S:
            raise MeasurementError(
                f"{self.duration_s:.3g} s of increments; at least {MIN_REST_TOTAL_S:g} s are needed"
            )

    @property
    def duration_s(self) -> float:
        """Time from the start of the first increment to the end of the last one."""
        return len(self.angle) * self.interval_s

    @cached_property
    def rests(self) -> tuple[Rest, ...]:
        """Rests of the unit, in order. Raises MeasurementError if they last less than a minute in total."""
        return _find_rests(self) if self.given_rests is None else self.given_rests

    def rest_means(self) -> tuple[FloatArray, FloatArray]:
        """Mean rate, rad/s, and specific force, m/s^2, of each rest, shapes (m, 3)."""
        rate, force = (
            np.array([values[rest.begin : rest.end].mean(axis=0) for rest in self.rests]) / self.interval_s
            for values in (self.angle, self.velocity)
        )
        return rate, force

    def table_turn(self, first: int, last: int) -> FloatArray | None:
        """Rotation (3, 3) of the table from the end of one increment to that of another; None if unknown."""
        if self.table is None:
            return None
        indices = np.array([first, last])
        if self.table_from is not None:
            indices = np.searchsorted(self.table_from, indices, side="right") - 1
        before, after = self.table[indices]
        return np.asarray(after @ before.T)


@dataclass(frozen=True, eq=False)
class RecordedRotation:
    """Motion between two rests."""

    start_s: float  #: From the start of the recording.
    duration_s: float
    vector: FloatArray  #: Shape (3,). Net rotation, body axes, rad, up to half a turn.
    path: float  #: Angle travelled about the axis that turned most, rad, with its sign.
    axis: int  #: Index of that body axis.

    @property
    def is_spin(self) -> bool:
        """Whether the rotation consists of whole turns."""
        return self.is_long and bool(np.linalg.norm(self.vector) < _MIN_ROTATION)

    @property
    def is_long(self) -> bool:
        """Whether the angle is large enough for a whole turn."""
        return bool(abs(self.path) > _MIN_SPIN)

    @property
    def kind(self) -> str:
        """``spin``, ``rotation`` or ``disturbance``, which moved the unit without turning it."""
        if self.is_spin:
            return "spin"
        return "disturbance" if float(np.linalg.norm(self.vector)) < _MIN_ROTATION else "rotation"


def _find_rests(recording: IncrementRecording) -> tuple[Rest, ...]:
    """Find the rests of the unit, in order; disturbed parts are left out.

    The unit rests if neither mean rate nor mean specific force of a block of half a second differs from
    those of its neighbours by more than their noise, and the rate equals that of the other resting blocks,
    which excludes a steady spin.
    """
    size = max(1, round(_BLOCK_S / recording.interval_s))
    count = len(recording.angle) // size
    rate, force = (
        values[: count * size].reshape(count, size, 3).mean(axis=1) / recording.interval_s
        for values in (recording.angle, recording.velocity)
    )
    noise = _noise(rate)
    is_quiet = _agrees_with_neighbours(rate, _RATE_TOLERANCE) & _agrees_with_neighbours(
        force, _FORCE_TOLERANCE
    )
    if is_quiet.any():
        speed = np.linalg.norm(rate, axis=1)
        slow = is_quiet & (speed < speed[is_quiet].min() + _MAX_RATE_SPREAD)
        rest_mean = np.median(rate[slow], axis=0)
        deviation = np.abs(rate - rest_mean).max(axis=1)
        # The direction of the Earth's rate in body axes changes with attitude: at most twice 15 deg/h.
        is_quiet &= deviation < 2.0 * _RATE_TOLERANCE + _SIGMAS * noise.max()
    quiet_spans = true_spans(is_quiet)
    min_samples = round(_MIN_REST_S / recording.interval_s)
    # The blocks at the ends may contain a part of the motion.
    spans = [
        ((first + 1 + _settling_blocks(rate[first + 1 : last - 1], noise)) * size, (last - 1) * size)
        for first, last in quiet_spans
    ]
    if quiet_spans.size and quiet_spans[0, 0] == 0:
        spans[0] = (0, spans[0][1])
    if quiet_spans.size and quiet_spans[-1, 1] == count:
        spans[-1] = (spans[-1][0], count * size)
    rests = tuple(Rest(int(begin), int(end)) for begin, end in spans if end - begin >= min_samples)
    total_s = sum(rest.end - rest.begin for rest in rests) * recording.interval_s
    if total_s < MIN_REST_TOTAL_S:
        raise MeasurementError(
            f"the unit rests for {total_s:.3g} s of {recording.duration_s:.4g} s; at least "
            f"{MIN_REST_TOTAL_S:g} s are needed. Record longer dwells between the rotations, or check units "
            "and 'time' in the import map"
        )
    return rests


def _settling_blocks(rate: FloatArray, noise: FloatArray) -> int:
    """Number of blocks (n, 3) at the start of a rest in which the unit still turns to its final attitude.

    Otherwise whole turns would seem to end before the unit has settled, and scale factors would be wrong by
    the remaining angle. The remaining angle is compared with its noise; ``noise`` (3,) is that of a block.
    """
    max_blocks = min(round(_SETTLING_S / _BLOCK_S), len(rate) // 2)
    if not max_blocks:
        return 0
    after = rate[max_blocks : 3 * max_blocks]
    remaining = np.cumsum((rate[:max_blocks] - after.mean(axis=0))[::-1], axis=0)[::-1]
    blocks = max_blocks - np.arange(max_blocks)
    sigmas = np.sqrt(blocks + blocks**2 / len(after))[:, np.newaxis] * noise
    moving = np.flatnonzero((np.abs(remaining) > _SIGMAS * sigmas).any(axis=1))
    return int(moving[-1]) + 1 if len(moving) else 0


def find_rotations(recording: IncrementRecording, angle: FloatArray | None = None) -> list[RecordedRotation]:
    """Motion between each rest and the next.

    ``angle`` (n, 3): increments corrected for known errors, so that whole turns are recognised; default: as
    recorded.
    """
    angle = recording.angle if angle is None else angle
    rest_mean = np.mean([angle[rest.begin : rest.end].mean(axis=0) for rest in recording.rests], axis=0)
    rotations = []
    for before, after in itertools.pairwise(recording.rests):
        steps = angle[before.end : after.begin] - rest_mean
        travelled = steps.sum(axis=0)
        axis = int(np.argmax(np.abs(travelled)))
        rotations.append(
            RecordedRotation(
                before.end * recording.interval_s,
                len(steps) * recording.interval_s,
                rotation_vectors(net_turn(steps)[np.newaxis])[0],
                float(travelled[axis]),
                axis,
            )
        )
    return rotations


@dataclass(frozen=True, eq=False)
class SensorNoise:
    """Noise of the increments of each axis, shapes (3,), SI."""

    angle_random_walk: FloatArray  #: rad/sqrt(s).
    white_angle: FloatArray  #: rad; quantisation, dither.
    velocity_random_walk: FloatArray  #: m/s/sqrt(s).
    white_velocity: FloatArray  #: m/s; quantisation, vibration.


def measure_noise(recordings: Sequence[IncrementRecording]) -> SensorNoise:
    """Noise of the resting unit, from the Allan variance over all rests of recordings at one sample rate.

    Raises MeasurementError if the rests are too short for it, or a sensor's output never changes.
    """
    interval_s = recordings[0].interval_s
    size = max(1, round(_ALLAN_S / interval_s))
    terms = []
    for name, rounding in zip(("angle", "velocity"), recordings[0].rounding, strict=True):
        for axis, label in enumerate(AXES):
            segments = []
            for recording in recordings:
                values = getattr(recording, name)[:, axis]
                if np.ptp(values) == 0.0:
                    sensor = {"angle": "gyro", "velocity": "accelerometer"}[name]
                    raise MeasurementError(
                        f"the output of the {label} {sensor} never changes. Check its column in the import "
                        "map; of a run, ins.signals"
                    )
                segments += [
                    np.concatenate([[0.0], np.cumsum(values[rest.begin : rest.end])])[::size]
                    for rest in recording.rests
                ]
            fitted = fit_rate_noise(allan_variance(segments, size * interval_s))
            # A term that is not significant may be as large as twice its uncertainty.
            min_samples = np.where(fitted.terms > 2.0 * fitted.sigmas, 0.0, 2.0 * fitted.sigmas)
            variances = np.maximum(fitted.terms, min_samples)[[RANDOM_WALK, WHITE_ANGLE]]
            if name == "velocity" and not recordings[0].has_vertical:
                variances = _LEVEL_NOISE_RATIO * variances
            terms.append(np.sqrt(np.maximum(variances, [0.0, rounding**2])))
    gyro, force = np.array(terms[:3]).T, np.array(terms[3:]).T
    return SensorNoise(gyro[0], gyro[1], force[0], force[1])


def _noise(means: FloatArray) -> FloatArray:
    """Standard deviation (3,) of the means of blocks at rest, if at least a quarter of the blocks rest."""
    if len(means) < 2:
        return np.zeros(3)
    return np.asarray(np.quantile(np.abs(np.diff(means, axis=0)), 0.25, axis=0) / _QUARTILE_PER_SIGMA)


def _agrees_with_neighbours(means: FloatArray, tolerance: float) -> BoolArray:
    steps = np.abs(np.diff(means, axis=0)) <= tolerance + _SIGMAS * np.sqrt(2.0) * _noise(means)
    same = np.concatenate([[True], steps.all(axis=1), [True]])
    return np.asarray(same[1:] & same[:-1])
