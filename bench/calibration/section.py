"""Increments from the first rest of a recording to the last one, split into epochs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from gyrobench.bench.calibration.coefficients import COUNT, SensorErrors
from gyrobench.bench.calibration.increment_recording import IncrementRecording, RecordedRotation
from gyrobench.bench.calibration.strapdown import (
    ASYMMETRIES,
    ASYMMETRY_RATE,
    ATTITUDE,
    DELAY,
    G_SENSITIVITIES,
    LEVER_ARMS,
    QUADRATIC,
    Trajectory,
    attitudes,
    integrate_increments,
)
from gyrobench.bench.foundations.arrays import BoolArray, FloatArray, IntArray
from gyrobench.bench.foundations.errors import MeasurementError
from gyrobench.bench.navigation.attitude import rotation_vectors
from gyrobench.bench.navigation.error_model import Site

#: Time between two velocities at rest, s; a shorter one would only average noise of the output.
REST_EPOCH_S = 1.0
#: Smallest share of the angle of a spin along one gyro axis.
_MIN_ALIGNED_SHARE = 0.99
#: Smallest Up component of the rotated Up vector in a rotation about Up. Rotations about other axes do not
#: determine a change of heading unless the table's axes are known relative to North.
_MIN_UP = 1.0 - 1e-6


@dataclass(frozen=True)
class SpinError:
    """Error of the angle of a gyro after whole turns, with known errors corrected."""

    epoch: int  #: Index of the epoch before the spin.
    axis: int  #: Index of the gyro.
    path: float  #: Angle, rad, with its sign.
    rate: float  #: Constant rate, rad/s, with its sign.
    duration_s: float
    error: float  #: Rad.


@dataclass(frozen=True, eq=False)
class IncrementEpochs:
    """Ends, rests and table rotations of n epochs of increments."""

    ends: IntArray  #: Shape (n,). Number of increments up to the end of each epoch.
    at_rest: BoolArray  #: Shape (n,). Whether the unit rests at the end of each epoch.
    #: Indices of epochs in the rests before and after whole turns, and the net rotation (3, 3), ENU, by the
    #: table's readings.
    spins: Sequence[tuple[int, int, FloatArray]]
    has_vertical: bool  #: Whether the vertical velocity is measured; otherwise its rows are zero.
    #: Indices of epochs before and after rotations about Up, and the rotation (3, 3), ENU, by the table.
    headings: Sequence[tuple[int, int, FloatArray]] = ()


@dataclass(frozen=True, eq=False)
class IncrementSection:
    """Increments from the first rest of a recording to the last one, in epochs."""

    interval_s: float
    angle: FloatArray  #: Shape (k, 3). Rad.
    velocity: FloatArray  #: Shape (k, 3). M/s.
    first_rest_count: int  #: Number of increments in the first rest.
    epochs: IncrementEpochs

    @classmethod
    def between_rests(
        cls, recording: IncrementRecording, rotations: Sequence[RecordedRotation]
    ) -> IncrementSection:
        """Make a section from a recording and the rotations found in it."""
        rests = recording.rests
        offset, size = rests[0].begin, max(1, round(REST_EPOCH_S / recording.interval_s))
        ends = np.arange(size, rests[-1].end - offset + 1, size, dtype=np.int64)
        at_rest = np.zeros(len(ends), bool)
        for rest in rests:
            at_rest |= (ends >= rest.begin - offset) & (ends <= rest.end - offset)
        spins, headings = [], []
        for before, after, rotation in zip(rests, rests[1:], rotations, strict=False):
            edges = (before.end - offset) // size, -(-(after.begin - offset) // size)
            table_turn = recording.table_turn(before.end - 1, after.begin)
            if rotation.is_spin:
                spins.append((*edges, np.eye(3) if table_turn is None else table_turn))
            if table_turn is not None and rotation.kind != "disturbance" and table_turn[2, 2] > _MIN_UP:
                headings.append((*edges, table_turn))
        angle, velocity = recording.angle[offset:], recording.velocity[offset:]
        epochs = IncrementEpochs(ends, at_rest, spins, recording.has_vertical, headings)
        return cls(recording.interval_s, angle, velocity, rests[0].end - offset, epochs)

    def initial_attitude(self, errors: SensorErrors) -> FloatArray:
        """Initial attitude (3, 3), determined by gravity and the Earth's rate in the first rest.

        Raises MeasurementError if the rate in the first rest has no horizontal part.
        """
        resting = self.angle[: self.first_rest_count], self.velocity[: self.first_rest_count]
        rate, force = (each.mean(axis=0) for each in errors.corrected(*resting, self.interval_s))
        up = force / np.linalg.norm(force)
        east = np.cross(rate, up)
        if not (norm := np.linalg.norm(east)) > 0.0:
            raise MeasurementError(
                "in the first rest the gyros read no rate about a horizontal axis, as where the Earth's "
                "rotation is below their resolution. Log them with a finer one, best as increments"
            )
        east /= norm
        return np.stack([east, np.cross(up, east), up])

    def _corrected_increments(
        self, errors: SensorErrors, common: FloatArray | None
    ) -> tuple[FloatArray, FloatArray]:
        """Increments (k, 3) corrected for sensor errors and the optional parameters in ``common`` (46,)."""
        interval_s = self.interval_s
        angle, velocity = errors.corrected(self.angle, self.velocity, interval_s)
        if common is None:
            return angle, velocity
        rate = angle / interval_s
        if common[LEVER_ARMS].any():
            angular_acceleration = np.gradient(rate, axis=0)
            for sensor, arm in enumerate(common[LEVER_ARMS].reshape(3, 3)):
                size_effect = (
                    np.cross(angular_acceleration, arm) + np.cross(rate, np.cross(rate, arm)) * interval_s
                )
                velocity[:, sensor] -= size_effect[:, sensor]
        if common[DELAY]:
            velocity += common[DELAY] * np.cross(velocity, rate)
        if common[QUADRATIC].any():
            velocity -= common[QUADRATIC] * velocity**2 / interval_s
        if common[G_SENSITIVITIES].any():
            angle -= velocity @ common[G_SENSITIVITIES].reshape(3, 3).T
        if common[ASYMMETRIES].any():
            is_turning = np.abs(angle) > ASYMMETRY_RATE * interval_s
            angle -= 0.5 * common[ASYMMETRIES] * np.abs(angle) * is_turning
        return angle, velocity

    def integrate(
        self, start: FloatArray, common: FloatArray, latitude: float, gravity: float, columns: Sequence[int]
    ) -> Trajectory:
        """Integrate from an initial attitude (3, 3), corrected for ``common`` (46,), with ``columns``.

        ``columns``: parameters of the responses.
        """
        errors, angle, velocity = SensorErrors.from_vector(common[:COUNT]), self.angle, self.velocity
        if are_corrected := any(COUNT <= each < ATTITUDE.start for each in columns):
            angle, velocity = self._corrected_increments(errors, common)
        site = latitude, gravity
        ends = self.epochs.ends
        return integrate_increments(
            angle, velocity, self.interval_s, ends, start, *site, columns, errors, are_corrected
        )

    @property
    def lengths_s(self) -> FloatArray:
        """Lengths of the epochs, shape (n,)."""
        return np.asarray(np.diff(self.epochs.ends, prepend=0) * self.interval_s)

    def with_interval(self, factor: float, are_rates: bool) -> IncrementSection:
        """Section with the interval multiplied by ``factor``.

        ``are_rates``: whether the increments are rates times the interval, and change with it.
        """
        scale = factor if are_rates else 1.0
        return replace(
            self,
            interval_s=self.interval_s * factor,
            angle=self.angle * scale,
            velocity=self.velocity * scale,
        )

    def spin_errors(self, start: FloatArray, common: FloatArray, site: Site) -> list[SpinError]:
        """Residual angle of each spin for these parameters; spins oblique to a gyro axis are skipped."""
        angle, _ = self._corrected_increments(SensorErrors.from_vector(common[:COUNT]), common)
        attitude = attitudes(angle, self.interval_s, self.epochs.ends, start, site.latitude)
        edges, errors = np.concatenate([[0], self.epochs.ends]), []
        for a, b, table_turn in self.epochs.spins:
            spin_angle = angle[edges[a] : edges[b]]
            travelled = spin_angle.sum(axis=0)
            axis = int(np.argmax(np.abs(travelled)))
            if abs(travelled[axis]) < _MIN_ALIGNED_SHARE * np.linalg.norm(travelled):
                continue
            error_vector = rotation_vectors((attitude[b] @ attitude[a].T @ table_turn.T)[np.newaxis])[0]
            rates = spin_angle[:, axis] / self.interval_s
            rate = float(np.median(rates[np.abs(rates) > 0.5 * np.abs(rates).max()]))
            turns = 2.0 * np.pi * round(float(travelled[axis]) / (2.0 * np.pi))
            duration_s = float(edges[b] - edges[a]) * self.interval_s
            errors.append(
                SpinError(a, axis, turns, rate, duration_s, float(attitude[a][:, axis] @ error_vector))
            )
        return errors
