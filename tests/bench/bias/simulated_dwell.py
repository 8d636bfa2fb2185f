"""One dwell of the simulated INS by itself: align, navigate, turn, navigate, without instruments.

For experiments with thousands of dwells: the sensors, the self-alignment and the full strapdown
mechanisation are those of the emulated bench, the table and the wires are left out.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from gyrobench.bench.foundations.arrays import FloatArray
from gyrobench.drivers.emulators.world.sensor_errors import sense
from gyrobench.drivers.emulators.world.strapdown import (
    STATE_SIZE,
    gyrocompass,
    matrix_of,
    navigate,
    table_attitude,
    true_increments,
)

_REST_STEP_S = 0.1
_TURN_STEP_S = 0.01
_DAMPING_STEP_S = 1.0


@dataclass(frozen=True, eq=False)
class Sensors:
    """Three gyros and three accelerometers, in body axes and SI."""

    gyro_bias: FloatArray = field(default_factory=lambda: np.zeros(3))
    accelerometer_bias: FloatArray = field(default_factory=lambda: np.zeros(3))
    #: Scale factor errors on the diagonal, misalignments beside it: the paper's (1) and (2).
    gyro_matrix: FloatArray = field(default_factory=lambda: np.zeros((3, 3)))
    accelerometer_matrix: FloatArray = field(default_factory=lambda: np.zeros((3, 3)))
    angle_random_walk: float = 0.0
    velocity_random_walk: float = 0.0
    #: Time since the first navigation began (n,) to what is added to the bias then (n, 3).
    gyro_bias_change: Callable[[FloatArray], FloatArray] | None = None
    accelerometer_bias_change: Callable[[FloatArray], FloatArray] | None = None
    #: Size of one output pulse without dither; 0 for none.
    gyro_pulse: float = 0.0
    accelerometer_pulse: float = 0.0
    velocity_damping_s: float = math.inf  #: Time constant of the velocity; infinite: free inertial.


@dataclass(frozen=True, eq=False)
class Table:
    """A two-axis table that carries the unit; unit vectors in ENU and attitude at zero angles."""

    outer_axis: FloatArray
    inner_axis: FloatArray
    mounting: FloatArray

    def attitude(self, outer: float, inner: float) -> FloatArray:
        """True ``C_nb`` (3, 3) at axis angles in rad."""
        return np.asarray(table_attitude(self.outer_axis, self.inner_axis, self.mounting, outer, inner))


@dataclass(frozen=True, eq=False)
class Rest:
    """What the INS puts out in one navigation at rest."""

    time_s: FloatArray  #: Shape (n,), since the end of the alignment.
    velocity_en_mps: FloatArray  #: Shape (n, 2), East and North.
    C_nb: FloatArray  #: Shape (n, 3, 3), the attitude that it computes.


@dataclass(frozen=True, eq=False)
class DwellScenario:
    """Where the INS rests and for how long; angles in rad, lengths in m."""

    table: Table
    angles_rad: Sequence[tuple[float, float]]  #: Outer and inner angle of each navigation at rest.
    latitude: float
    height: float = 0.0
    window_s: float = 600.0
    turn_s: float = 25.0
    settle_s: float = 0.0
    align_s: float = 300.0
    epoch_s: float = 1.0
    latitude_error: float = 0.0  #: Of the latitude entered into the INS.


def simulate_dwell(
    scenario: DwellScenario, sensors: Sensors, random: np.random.Generator | None = None
) -> list[Rest]:
    """Simulate one dwell, a rest for each pair of angles; without ``random`` the sensors have no noise."""
    ins = _Ins(scenario, sensors, random)
    angles = scenario.angles_rad
    ins.align(angles[0])
    rests = [ins.rest(angles[0])]
    for start, end in itertools.pairwise(angles):
        ins.turn(start, end)
        rests.append(ins.rest(end))
    return rests


class _Ins:
    def __init__(self, scenario: DwellScenario, sensors: Sensors, random: np.random.Generator | None) -> None:
        self._scenario = scenario
        self._sensors = sensors
        self._random = random
        self._time_s = 0.0
        self._state = np.zeros(STATE_SIZE)
        self._state[6] = scenario.latitude + scenario.latitude_error
        self._remainders = np.zeros((2, 3))

    def align(self, angles: tuple[float, float]) -> None:
        count = round(self._scenario.align_s / _REST_STEP_S)
        self._time_s = -count * _REST_STEP_S
        rotation, velocity = self._sensed(*_resting(angles, count), _REST_STEP_S)
        self._state[:4] = gyrocompass(rotation.sum(axis=0), velocity.sum(axis=0))

    def rest(self, angles: tuple[float, float]) -> Rest:
        every = round(self._scenario.epoch_s / _REST_STEP_S)
        count = round(self._scenario.window_s / _REST_STEP_S)
        start, begin_s = self._state.copy(), self._time_s
        states = np.vstack([start, self._navigated(*_resting(angles, count), _REST_STEP_S, every)])
        time_s = begin_s + self._scenario.epoch_s * np.arange(len(states), dtype=np.float64)
        return Rest(time_s, states[:, 4:6], np.array([matrix_of(state[:4]) for state in states]))

    def turn(self, start: tuple[float, float], end: tuple[float, float]) -> None:
        count = round(self._scenario.turn_s / _TURN_STEP_S)
        share = 0.5 * (1.0 - np.cos(np.linspace(0.0, math.pi, count + 1)))
        outer, inner = (np.asarray(a + (b - a) * share) for a, b in zip(start, end, strict=True))
        self._navigated(outer, inner, _TURN_STEP_S, count)
        settling = round(self._scenario.settle_s / _REST_STEP_S)
        if settling:
            self._navigated(*_resting(end, settling), _REST_STEP_S, settling)

    def _navigated(self, outer: FloatArray, inner: FloatArray, step_s: float, every: int) -> FloatArray:
        rotation, velocity = self._sensed(outer, inner, step_s)
        height, damping_s = self._scenario.height, self._sensors.velocity_damping_s
        if math.isinf(damping_s):
            return np.asarray(navigate(self._state, rotation, velocity, step_s, height, every - 1, every))
        states, part = [], min(every, round(_DAMPING_STEP_S / step_s))
        for first in range(0, len(rotation), part):
            some = slice(first, first + part)
            navigate(self._state, rotation[some], velocity[some], step_s, height, part, part)
            self._state[4:6] *= math.exp(-len(rotation[some]) * step_s / damping_s)
            if (first + part) % every == 0:
                states.append(self._state.copy())
        return np.array(states)

    def _sensed(self, outer: FloatArray, inner: FloatArray, step_s: float) -> tuple[FloatArray, FloatArray]:
        table, sensors, count = self._scenario.table, self._sensors, len(outer) - 1
        rotation, velocity = true_increments(
            table.outer_axis, table.inner_axis, table.mounting, outer, inner,
            self._scenario.latitude, self._scenario.height, step_s,
        )  # fmt: skip
        noise = np.zeros((2, count, 3))
        if self._random is not None:
            walks = np.array([sensors.angle_random_walk, sensors.velocity_random_walk])
            noise = self._random.standard_normal((2, count, 3)) * walks[:, None, None] * math.sqrt(step_s)
        middle_s = self._time_s + step_s * (np.arange(count, dtype=np.float64) + 0.5)
        for number, change in enumerate((sensors.gyro_bias_change, sensors.accelerometer_bias_change)):
            if change is not None:
                noise[number] += change(middle_s) * step_s
        self._time_s += count * step_s
        return (
            sense(
                rotation, sensors.gyro_matrix, sensors.gyro_bias, noise[0], step_s, sensors.gyro_pulse,
                self._remainders[0],
            ),
            sense(
                velocity, sensors.accelerometer_matrix, sensors.accelerometer_bias, noise[1], step_s,
                sensors.accelerometer_pulse, self._remainders[1],
            ),
        )  # fmt: skip


def _resting(angles: tuple[float, float], count: int) -> tuple[FloatArray, FloatArray]:
    outer, inner = angles
    return np.full(count + 1, outer), np.full(count + 1, inner)
