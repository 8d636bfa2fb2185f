"""Increments of a unit on a two-axis table, in closed form: attitude, rate and force at any time.

Independent of the estimator: no strapdown integration and no linear model. Increments are integrals of rate
and specific force over each sample by Gauss-Legendre quadrature.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.spatial.transform import Rotation

EARTH = 7.292115e-5
NODES, WEIGHTS = np.polynomial.legendre.leggauss(4)

#: Rotations of a two-axis table, deg, by axis: outer (level, East) or inner (carried; Up at the start).
EIGHTEEN = tuple(
    (axis, 90.0)
    for axis in ("outer", "inner", "inner", "outer", "inner", "outer", "inner", "inner", "outer") * 2
)


@dataclass
class Unit:
    """A unit, what is wrong with its sensors, and how it is turned."""

    rotations: Sequence[tuple[str, float] | tuple[str, float, float]] = EIGHTEEN  # axis, deg, deg/s
    dwell_s: float = 150.0
    rate_dps: float = 10.0
    ramp_s: float = 1.0
    sample_hz: float = 50.0
    latitude_deg: float = 45.0
    gravity: float = 9.806
    start: Rotation = field(default_factory=Rotation.identity)
    gyro_bias: np.ndarray = field(default_factory=lambda: np.zeros(3))
    gyro_matrix: np.ndarray = field(default_factory=lambda: np.zeros((3, 3)))
    force_bias: np.ndarray = field(default_factory=lambda: np.zeros(3))
    force_matrix: np.ndarray = field(default_factory=lambda: np.zeros((3, 3)))
    #: Place of each accelerometer relative to the table's centre, m.
    arms: np.ndarray = field(default_factory=lambda: np.zeros((3, 3)))
    delay_s: float = 0.0

    def segments(self):
        """Start, duration, axis, angle (rad) of every dwell and rotation."""
        at, found = 0.0, [(0.0, self.dwell_s, "outer", 0.0)]
        at = self.dwell_s
        for axis, angle_deg, *rate_dps in self.rotations:
            span = abs(angle_deg) / (*rate_dps, self.rate_dps)[0] + self.ramp_s
            found += [(at, span, axis, np.deg2rad(angle_deg)), (at + span, self.dwell_s, axis, 0.0)]
            at += span + self.dwell_s
        return found

    def profile(self, time):
        """Angle, rate and acceleration of each axis (outer, inner), rad, s, at increasing times (n,)."""
        state = {axis: np.zeros((3, len(time))) for axis in ("outer", "inner")}
        for begin, span, axis, angle in self.segments():
            if angle == 0.0:
                continue
            first, end = np.searchsorted(time, [begin, begin + span])
            # Raised cosines at both ends, a constant rate between them.
            t = time[first:end] - begin
            full = angle / (span - self.ramp_s)
            w = np.pi / self.ramp_s
            up, down = np.minimum(t, self.ramp_s), np.minimum(span - t, self.ramp_s)
            rising = 0.5 * full * (up - np.sin(w * up) / w)
            left = 0.5 * full * (down - np.sin(w * down) / w)
            middle = full * (np.clip(t, self.ramp_s, span - self.ramp_s) - self.ramp_s)
            moved = np.where(t < span - self.ramp_s, rising + middle, angle - left)
            shape = np.where(t < self.ramp_s, up, np.where(t > span - self.ramp_s, down, self.ramp_s))
            sign = np.where(t < self.ramp_s, 1.0, -1.0)
            ramping = (t < self.ramp_s) | (t > span - self.ramp_s)
            state[axis][:, first:end] += [
                moved,
                0.5 * full * (1.0 - np.cos(w * shape)),
                ramping * sign * 0.5 * full * w * np.sin(w * shape),
            ]
            state[axis][0, end:] += angle
        return state["outer"], state["inner"]

    def sensed(self, time):
        """True rates and forces (n, 3) in body axes, and those of the accelerometers' places."""
        outer, inner = self.profile(time)
        east, up = np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0])
        first = Rotation.from_rotvec(outer[0][:, np.newaxis] * east)
        C_bn = (first * Rotation.from_rotvec(inner[0][:, np.newaxis] * up) * self.start).inv()
        carried = first.apply(up)
        turning = outer[1][:, np.newaxis] * east + inner[1][:, np.newaxis] * carried
        latitude = np.deg2rad(self.latitude_deg)
        earth = EARTH * np.array([0.0, np.cos(latitude), np.sin(latitude)])
        rate, force = C_bn.apply(turning + earth), self.gravity * C_bn.apply(up)
        if not self.arms.any():
            return rate, force
        acceleration = (
            outer[2][:, np.newaxis] * east
            + inner[2][:, np.newaxis] * carried
            + np.cross(outer[1][:, np.newaxis] * east, inner[1][:, np.newaxis] * carried)
        )
        w, a = C_bn.apply(turning), C_bn.apply(acceleration)
        for i, arm in enumerate(self.arms):
            force[:, i] += (np.cross(a, arm) + np.cross(w, np.cross(w, arm)))[:, i]
        return rate, force

    def increments(self):
        """Measured increments (n, 3) of angle and velocity, without noise."""
        dt = 1.0 / self.sample_hz
        motion = (self.rotations, self.dwell_s, self.rate_dps, self.ramp_s, self.sample_hz, self.latitude_deg)
        place = (self.gravity, self.start.as_quat().tolist(), self.arms.tolist(), self.delay_s)
        key = repr((motion, place))
        if key not in _TRUE:
            _TRUE[key] = self._true_increments(dt)
        angle, velocity = _TRUE[key]
        angle = angle @ (np.eye(3) + self.gyro_matrix).T + self.gyro_bias * dt
        velocity = velocity @ (np.eye(3) + self.force_matrix).T + self.force_bias * dt
        return angle, velocity

    def _true_increments(self, dt):
        begin, span, *_ = self.segments()[-1]
        starts = np.arange(round((begin + span) * self.sample_hz)) * dt
        angle, velocity = np.zeros((2, len(starts), 3))
        for node, weight in zip(NODES, WEIGHTS, strict=True):
            time = starts + 0.5 * dt * (1.0 + node)
            rate, force = self.sensed(time)
            if self.delay_s:
                _, force = self.sensed(time - self.delay_s)
            angle += 0.5 * dt * weight * rate
            velocity += 0.5 * dt * weight * force
        return angle, velocity


#: True increments by what they depend on: many units differ in their errors alone.
_TRUE = {}


@dataclass(frozen=True)
class Noise:
    """Noise of a navigation-grade unit, SI."""

    angle_random_walk: float = 0.0006 * np.pi / 180.0 / 60.0
    velocity_random_walk: float = 5e-6 * 9.80665
    white_angle: float = 0.0
    white_velocity: float = 1e-4

    def added(self, angle, velocity, dt, rng):
        """Increments with noise."""
        noisy = []
        for values, walk, white in (
            (angle, self.angle_random_walk, self.white_angle),
            (velocity, self.velocity_random_walk, self.white_velocity),
        ):
            level = white * rng.standard_normal((len(values) + 1, 3))
            noisy.append(
                values + walk * np.sqrt(dt) * rng.standard_normal(values.shape) + np.diff(level, axis=0)
            )
        return noisy
