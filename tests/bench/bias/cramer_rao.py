"""The least uncertainty that the data of a dwell allow, from the simulated INS itself.

Nothing here comes from the estimator or its error model. The strapdown INS is run again and again
through the same dwell, each time with one thing changed: an unknown, or a unit of noise of one sensor
in one interval. The changes of its output are the columns of a linear model with a dense covariance,
whose Fisher information is taken as it stands.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from gyrobench.bench.bias.noise_model import NoiseModel
from gyrobench.bench.foundations.arrays import BoolArray, FloatArray
from gyrobench.drivers.emulators.world.sensor_errors import sense
from gyrobench.drivers.emulators.world.strapdown import STATE_SIZE, gyrocompass, navigate, true_increments

_EAST, _UP = np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0])
# Sizes of the changes: far above rounding, far below what would not be linear.
_RAD, _MPS, _RADPS, _MPS2 = 1e-6, 1e-4, 1e-8, 1e-4
_TURN_STEP_S = 0.25
_NOTHING = np.zeros((3, 3))


@dataclass(frozen=True)
class _Segment:
    """Rest or turn: true increments (n, 3) in body axes, and their step in s."""

    rotation: FloatArray
    velocity: FloatArray
    step_s: float


@dataclass
class CramerRao:
    """One dwell at rest, turn, rest with Z up: responses of the INS's output to all that can change it."""

    latitude_deg: float = 36.4
    window_s: float = 600.0
    turn_s: float = 25.0
    epoch_s: float = 1.0
    #: Shape (m, m). Covariance of the m outputs for unit random walks of each gyro and accelerometer.
    by_gyro_noise: FloatArray = field(init=False)
    by_accelerometer_noise: FloatArray = field(init=False)

    def __post_init__(self) -> None:
        self._latitude = np.radians(self.latitude_deg)
        self._segments = list(self._path())
        self._edges = [0]
        for segment in self._segments:
            self._edges.append(self._edges[-1] + len(segment.rotation))
        self._nominal_states = self._run(self._start(), 0)
        self._nominal = self._output(self._nominal_states)
        gyro, accelerometer = (self._noise_responses(sensor) for sensor in (0, 1))
        self.by_gyro_noise, self.by_accelerometer_noise = gyro.T @ gyro, accelerometer.T @ accelerometer
        self._responses = self._unknown_responses()

    def bias_sigma(
        self, noise: NoiseModel, *, velocity_jump: bool, accelerometer_bias: float = 1e-2
    ) -> FloatArray:
        """Bound (6,) of the standard uncertainty of the biases of gyros, rad/s, and accelerometers, m/s^2.

        With ``velocity_jump`` the velocity may change in the turn by an unknown amount; else it goes on.
        ``accelerometer_bias``: prior standard uncertainty, m/s^2: the vertical one acts on nothing.
        """
        columns = self._responses if velocity_jump else self._responses[:, :-2]
        covariance = noise.angle_random_walk**2 * self.by_gyro_noise
        covariance += noise.velocity_random_walk**2 * self.by_accelerometer_noise
        epochs = len(covariance) // 3
        variances = np.array([noise.velocity_white, noise.velocity_white, noise.heading_white]) ** 2
        covariance[np.diag_indices_from(covariance)] += np.tile(variances, epochs)
        information = columns.T @ cho_solve(cho_factor(covariance, lower=True), columns)
        information[np.diag_indices(6)] += np.concatenate([np.zeros(3), np.full(3, accelerometer_bias**-2)])
        scale = np.sqrt(np.diag(information))
        inverse = np.linalg.inv(information / np.outer(scale, scale))
        return np.asarray(np.sqrt(np.diag(inverse)) / scale)[:6]

    def _path(self) -> Iterator[_Segment]:
        turn = round(self.turn_s / _TURN_STEP_S)
        share = 0.5 * (1.0 - np.cos(np.linspace(0.0, np.pi, turn + 1)))
        still = np.zeros(round(self.window_s / self.epoch_s) + 1)
        for angles, step_s in (
            (still, self.epoch_s),
            (np.pi * share, _TURN_STEP_S),
            (still + np.pi, self.epoch_s),
        ):
            rotation, velocity = true_increments(
                _UP, _EAST, np.eye(3), angles, np.zeros_like(angles), self._latitude, 0.0, step_s
            )
            yield _Segment(rotation, velocity, step_s)

    def _start(self) -> FloatArray:
        first = self._segments[0]
        state = np.zeros(STATE_SIZE)
        state[:4] = gyrocompass(first.rotation.sum(axis=0), first.velocity.sum(axis=0))
        state[6] = self._latitude
        return state

    def _run(
        self, state: FloatArray, first: int, bias: FloatArray | None = None, jump: FloatArray | None = None,
        impulse: tuple[int, int, float] | None = None,
    ) -> FloatArray:  # fmt: skip
        """States (n - first + 1, 8) from sample ``first`` on.

        ``bias`` (6,) acts all the time, ``jump`` (2,) on the velocity at the end of the turn, and
        ``impulse`` (sensor, axis, size) in the first sample alone.
        """
        state = state.copy()
        states = [state[None].copy()]
        for number, segment in enumerate(self._segments):
            skip = max(0, first - self._edges[number])
            if skip >= len(segment.rotation):
                continue
            if number == 2 and jump is not None and skip == 0:
                state[4:6] += jump
                states[-1][-1, 4:6] += jump
            increments = [segment.rotation[skip:], segment.velocity[skip:]]
            if bias is not None:
                increments = [
                    sense(each, _NOTHING, part, np.zeros_like(each), segment.step_s, 0.0, np.zeros(3))
                    for each, part in zip(increments, bias.reshape(2, 3), strict=True)
                ]
            if impulse is not None and self._edges[number] + skip == first:
                sensor, axis, size = impulse
                increments[sensor] = increments[sensor].copy()
                increments[sensor][0, axis] += size
            states.append(navigate(state, *increments, segment.step_s, 0.0, 0, 1))
        return np.vstack(states)

    def _output(self, states: FloatArray) -> FloatArray:
        """Velocity East and North, sine and cosine of the heading, at the epochs among the last states."""
        total = self._edges[-1] + 1
        kept = np.flatnonzero(self._is_epoch()[total - len(states) :])
        w, x, y, z, east, north = states[kept, :6].T
        return np.column_stack([east, north, 2.0 * (x * y + w * z), w * w + x * x - y * y - z * z])

    def _is_epoch(self) -> BoolArray:
        result = np.zeros(self._edges[-1] + 1, dtype=bool)
        result[: self._edges[1] + 1] = True
        result[self._edges[2] :] = True
        return result

    def _change(self, states: FloatArray) -> FloatArray:
        """What the output (m,) differs from the nominal one; nothing before the states begin."""
        output = self._output(states)
        nominal = self._nominal[-len(output) :]
        # The nominal heading's sine is 0 and its cosine +-1.
        heading = (output[:, 2] - nominal[:, 2]) * np.sign(nominal[:, 3])
        change = np.zeros((len(self._nominal), 3))
        change[-len(output) :] = np.column_stack([output[:, :2] - nominal[:, :2], heading])
        return change.ravel()

    def _noise_responses(self, sensor: int) -> FloatArray:
        size = (_RAD, _MPS)[sensor]
        rows = []
        for number, segment in enumerate(self._segments):
            for k in range(self._edges[number], self._edges[number + 1]):
                for axis in range(3 if sensor == 0 else 2):
                    states = self._run(self._nominal_states[k], k, impulse=(sensor, axis, size))
                    rows.append(self._change(states) * (np.sqrt(segment.step_s) / size))
        return np.array(rows)

    def _unknown_responses(self) -> FloatArray:
        """Columns of gyro biases, accelerometer biases, initial errors, headings, velocity jump."""
        start, pair = self._start(), np.eye(2)
        runs = [(self._run(start, 0, _RADPS * unit), _RADPS) for unit in np.eye(6)[:3]]
        runs += [(self._run(start, 0, _MPS2 * unit), _MPS2) for unit in np.eye(6)[3:]]
        runs += [(self._run(_tilted(start, unit), 0), _RAD) for unit in np.eye(3)]
        runs += [(self._run(_moving(start, unit), 0), _MPS) for unit in pair]
        runs += [(self._run(start, 0, jump=_MPS * unit), _MPS) for unit in pair]
        columns = [self._change(states) / size for states, size in runs]
        heading = np.multiply.outer(np.repeat(pair, len(self._nominal) // 2, axis=1), np.eye(3)[2])
        return np.array([*columns[:-2], *heading.reshape(2, -1), *columns[-2:]]).T


def _moving(state: FloatArray, direction: FloatArray) -> FloatArray:
    """The state with some velocity East or North."""
    moving = state.copy()
    moving[4:6] += _MPS * direction
    return moving


def _tilted(state: FloatArray, axis: FloatArray) -> FloatArray:
    """The state after a small turn about East, North or Up."""
    half = 0.5 * _RAD * axis
    w, vector = state[0], state[1:4]
    return np.concatenate([[w - half @ vector], vector + w * half + np.cross(half, vector), state[4:]])
