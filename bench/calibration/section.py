"""Increments from a first rest to a last one, in epochs, freed of errors known so far."""

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
    IncrementEpochs,
    Trajectory,
    attitudes,
    integrated,
)
from gyrobench.bench.foundations.arrays import FloatArray
from gyrobench.bench.navigation.attitude import rotation_vectors
from gyrobench.bench.navigation.error_model import Site

#: Time between two velocities at rest, s: closer ones would average noise of the output alone.
REST_EPOCH_S = 1.0
#: Least share of a spin along one gyro.
_MIN_ALONG = 0.99
#: Least share of Up along which a rotation leaves it. Those about other axes show no heading unless the
#: table's axes are known relative to North.
_MIN_UP = 1.0 - 1e-6


@dataclass(frozen=True)
class SpinError:
    """What a gyro free of known errors is wrong by after whole turns."""

    epoch: int  #: Number of the epoch before it.
    axis: int  #: Index of the gyro.
    path: float  #: Angle, rad, with its sign.
    rate: float  #: Constant rate, rad/s, with its sign.
    duration_s: float
    error: float  #: Rad.


@dataclass(frozen=True, eq=False)
class IncrementSection:
    """Increments from a first rest to a last one, in epochs."""

    interval_s: float
    angle: FloatArray  #: Shape (k, 3). Rad.
    velocity: FloatArray  #: Shape (k, 3). M/s.
    first: int  #: Increments of the first rest.
    epochs: IncrementEpochs

    @classmethod
    def between_rests(
        cls, recording: IncrementRecording, rotations: Sequence[RecordedRotation]
    ) -> IncrementSection:
        """From a recording, with the rotations that were found in it."""
        rests = recording.rests
        offset, size = rests[0].begin, max(1, round(REST_EPOCH_S / recording.interval_s))
        ends = np.arange(size, rests[-1].end - offset + 1, size, dtype=np.int64)
        at_rest = np.zeros(len(ends), bool)
        for rest in rests:
            at_rest |= (ends >= rest.begin - offset) & (ends <= rest.end - offset)
        spins, headings = [], []
        for before, after, rotation in zip(rests, rests[1:], rotations, strict=False):
            edges = (before.end - offset) // size, -(-(after.begin - offset) // size)
            turned = recording.table_turn(before.end - 1, after.begin)
            if rotation.is_spin:
                spins.append((*edges, np.eye(3) if turned is None else turned))
            if turned is not None and rotation.kind != "disturbance" and turned[2, 2] > _MIN_UP:
                headings.append((*edges, turned))
        angle, velocity = recording.angle[offset:], recording.velocity[offset:]
        epochs = IncrementEpochs(ends, at_rest, spins, recording.has_vertical, headings)
        return cls(recording.interval_s, angle, velocity, rests[0].end - offset, epochs)

    def aligned(self, errors: SensorErrors) -> FloatArray:
        """Attitude (3, 3) at the start by gravity and the Earth's rate in the first rest."""
        resting = self.angle[: self.first], self.velocity[: self.first]
        rate, force = (each.mean(axis=0) for each in errors.removed(*resting, self.interval_s))
        up = force / np.linalg.norm(force)
        east = np.cross(rate, up)
        east /= np.linalg.norm(east)
        return np.stack([east, np.cross(up, east), up])

    def freed(self, errors: SensorErrors, common: FloatArray | None) -> tuple[FloatArray, FloatArray]:
        """Increments (k, 3) without errors of the sensors and what is beside them: ``common`` (46,), SI."""
        interval_s = self.interval_s
        angle, velocity = errors.removed(self.angle, self.velocity, interval_s)
        if common is None:
            return angle, velocity
        if common[LEVER_ARMS].any() or common[DELAY] or common[QUADRATIC].any():
            rate = angle / interval_s
            turning = np.gradient(rate, axis=0)
            for sensor, arm in enumerate(common[LEVER_ARMS].reshape(3, 3)):
                moved = np.cross(turning, arm) + np.cross(rate, np.cross(rate, arm)) * interval_s
                velocity[:, sensor] -= moved[:, sensor]
            velocity += common[DELAY] * np.cross(velocity, rate)
            velocity -= common[QUADRATIC] * velocity**2 / interval_s
        if common[G_SENSITIVITIES].any():
            angle -= velocity @ common[G_SENSITIVITIES].reshape(3, 3).T
        if common[ASYMMETRIES].any():
            is_turning = np.abs(angle) > ASYMMETRY_RATE * interval_s
            angle -= 0.5 * common[ASYMMETRIES] * np.abs(angle) * is_turning
        return angle, velocity

    def integrated(
        self, start: FloatArray, common: FloatArray, latitude: float, gravity: float, columns: Sequence[int]
    ) -> Trajectory:
        """From an attitude (3, 3) at the start, freed of ``common`` (46,), with responses to ``columns``."""
        errors, angle, velocity = SensorErrors.from_vector(common[:COUNT]), self.angle, self.velocity
        if are_freed := any(COUNT <= each < ATTITUDE.start for each in columns):
            angle, velocity = self.freed(errors, common)
        site = latitude, gravity
        ends = self.epochs.ends
        return integrated(angle, velocity, self.interval_s, ends, start, *site, columns, errors, are_freed)

    @property
    def lengths_s(self) -> FloatArray:
        """Of the epochs, shape (n,)."""
        return np.asarray(np.diff(self.epochs.ends, prepend=0) * self.interval_s)

    def retimed(self, factor: float, of_rates: bool) -> IncrementSection:
        """The same with another interval; ``of_rates``: increments are rates times the interval."""
        scale = factor if of_rates else 1.0
        return replace(
            self,
            interval_s=self.interval_s * factor,
            angle=self.angle * scale,
            velocity=self.velocity * scale,
        )

    def spin_errors(self, start: FloatArray, common: FloatArray, site: Site) -> list[SpinError]:
        """What is left of whole turns with these values; not of spins oblique to the gyros."""
        angle, _ = self.freed(SensorErrors.from_vector(common[:COUNT]), common)
        attitude = attitudes(angle, self.interval_s, self.epochs.ends, start, site.latitude)
        edges, errors = np.concatenate([[0], self.epochs.ends]), []
        for a, b, turned in self.epochs.spins:
            moved = angle[edges[a] : edges[b]]
            travelled = moved.sum(axis=0)
            axis = int(np.argmax(np.abs(travelled)))
            if abs(travelled[axis]) < _MIN_ALONG * np.linalg.norm(travelled):
                continue
            away = rotation_vectors((attitude[b] @ attitude[a].T @ turned.T)[np.newaxis])[0]
            rates = moved[:, axis] / self.interval_s
            rate = float(np.median(rates[np.abs(rates) > 0.5 * np.abs(rates).max()]))
            turns = 2.0 * np.pi * round(float(travelled[axis]) / (2.0 * np.pi))
            duration_s = float(edges[b] - edges[a]) * self.interval_s
            errors.append(SpinError(a, axis, turns, rate, duration_s, float(attitude[a][:, axis] @ away)))
        return errors
