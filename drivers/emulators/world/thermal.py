"""Temperatures of the world: the chamber's air with its control loop, and the thermal network of the unit.

The network has lumped nodes: the case, and the electronics and optics of each gyro. Heat flows by conduction
and by convection, which depends on gravity: its conductance is ``g (1 + s u)``, where ``u`` is the upward
component of the direction from electronics to optics.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from gyrobench.bench.foundations.arrays import FloatArray
from gyrobench.bench.foundations.kernels import compiled
from gyrobench.drivers.emulators.world.world_file import GyroThermal, Thermal

#: Share of full cooling power above which the compressor runs continuously.
_MIN_STEADY_COOLING = 0.3
#: Time constant of the air while the door is open.
_DOOR_TIME_CONSTANT_S = 300.0
#: Error of the controlled air that no chamber can reach, so that it heats or cools at full power.
_FULL_POWER_C = 1000.0


@dataclass(frozen=True)
class ChamberParameters:
    """Limits of the chamber, and the room around it."""

    #: heating_limit_c_per_min, cooling_limit_c_per_min: Rate of change of the air at full power, above zero.
    heating_limit_c_per_min: float = 5.0
    cooling_limit_c_per_min: float = 3.0
    control_time_constant_s: float = 90.0  #: Lag of the air behind the working set point.
    #: ambient_c, ambient_time_constant_s: Room temperature, and time constant with which the uncontrolled air
    #: drifts to it.
    ambient_c: float = 23.0
    ambient_time_constant_s: float = 5400.0
    #: low_c, high_c: Temperatures that the chamber can reach.
    low_c: float = -60.0
    high_c: float = 100.0


@dataclass
class AirFaults:
    """Active faults of the chamber."""

    #: stopped, blind: Heater and compressor are off although the controller runs; the controller has no
    #: temperature reading.
    stopped: bool = False
    blind: bool = False
    error_c: float = 0.0  #: Offset of the controlled air from its set point.
    door_open: bool = False  #: The door is open to the room.
    stuck_c: float | None = None  #: Constant reading of a stuck sensor; None if it works.


class ChamberAir:
    """Air temperature of a chamber, controlled or drifting."""

    def __init__(self, parameters: ChamberParameters | None = None) -> None:
        self.parameters = parameters or ChamberParameters()
        #: air_c, set_point_c, working_set_point_c: Air temperature, final set point, ramped set point.
        self.air_c = self.parameters.ambient_c
        self.set_point_c = self.air_c
        self.ramp_rate_c_per_min: float | None = None  #: Rate of the ramped set point; None for a step.
        #: Whether the air is controlled; otherwise it drifts to the room's temperature.
        self.running = False
        self.working_set_point_c = self.air_c
        self.power = 0.0  #: Share of full power: 1 heating, -1 cooling.
        self.faults = AirFaults()  #: Active faults.

    @property
    def read_c(self) -> float:
        """Temperature that the controller's sensor reads."""
        return self.air_c if self.faults.stuck_c is None else self.faults.stuck_c

    @property
    def compressor_duty(self) -> float:
        """Share of the time that the compressor runs; it cycles if little cooling is needed."""
        return _clip(-self.power / _MIN_STEADY_COOLING, 0.0, 1.0)

    def step(self, dt_s: float, count: int = 1) -> FloatArray:
        """Advance ``count`` times by ``dt_s``; returns air temperature and compressor duty, (2, count)."""
        limits, faults = self.parameters, self.faults
        is_controlled = self.running and not (faults.stopped or faults.blind or faults.door_open)
        constant_s = limits.control_time_constant_s if is_controlled else limits.ambient_time_constant_s
        if faults.door_open:
            constant_s = _DOOR_TIME_CONSTANT_S
        bounds = np.array(
            [limits.heating_limit_c_per_min, limits.cooling_limit_c_per_min, limits.ambient_c,
             limits.ambient_time_constant_s, limits.low_c, limits.high_c]
        )  # fmt: skip
        error_c = faults.error_c
        if faults.stuck_c is not None:
            error_c = math.copysign(_FULL_POWER_C, self.set_point_c - faults.stuck_c)
        course = np.empty((2, count))
        self.air_c, self.working_set_point_c, self.power = _air_steps(
            course, dt_s, is_controlled, -math.expm1(-dt_s / constant_s), bounds, self.air_c,
            self.working_set_point_c, self.set_point_c,
            math.inf if self.ramp_rate_c_per_min is None else self.ramp_rate_c_per_min, error_c,
        )  # fmt: skip
        return course


@compiled
def _clip(value: float, low: float, high: float) -> float:
    return low if value < low else high if value > high else value


@compiled
def _air_steps(
    course: FloatArray, dt: float, is_controlled: bool, share: float, limits: FloatArray, air_c: float,
    working_c: float, set_point_c: float, ramp_c_per_min: float, error_c: float,
) -> tuple[float, float, float]:  # fmt: skip
    """Make a step for each column of ``course``; returns air temperature, working set point and power.

    ``share``: share of the distance to the target temperature that the air covers in one step.
    """
    heating, cooling, ambient_c, ambient_time_constant_s, low_c, high_c = limits
    power = 0.0
    for k in range(course.shape[1]):
        if is_controlled:
            span_c = ramp_c_per_min * dt / 60.0
            working_c = _clip(set_point_c, working_c - span_c, working_c + span_c)
            gap_c = _clip(working_c + error_c, low_c, high_c) - air_c
            rate = _clip(gap_c * share * 60.0 / dt, -cooling, heating)
            air_c += rate * dt / 60.0
            demand = rate + (air_c - ambient_c) * 60.0 / ambient_time_constant_s
            power = _clip(demand / (heating if demand > 0.0 else cooling), -1.0, 1.0)
        else:
            air_c += (ambient_c - air_c) * share
            working_c = air_c  # so that a later ramp starts at the air temperature
        course[0, k], course[1, k] = air_c, _clip(-power / _MIN_STEADY_COOLING, 0.0, 1.0)
    return air_c, working_c, power


class ThermalCourse(NamedTuple):
    """Results of n steps of a thermal network."""

    nodes_c: FloatArray  #: Shape (n, 7). Temperatures: case, three optics, three electronics.
    optics_rate_c_per_h: FloatArray  #: Shape (n, 3). Change of each gyro's optics in the step.
    #: Shape (n, 3). Attitude-dependent part of the heat flow from electronics to optics.
    convected_w: FloatArray

    @property
    def optics_c(self) -> FloatArray:
        """Temperatures of the optics, shape (n, 3)."""
        return self.nodes_c[:, 1:4]

    @property
    def electronics_c(self) -> FloatArray:
        """Temperatures of the electronics, shape (n, 3)."""
        return self.nodes_c[:, 4:]


class ThermalNetwork:
    """Thermal network of the unit."""

    def __init__(self, thermal: Thermal, start_c: float) -> None:
        gyros = (thermal.x, thermal.y, thermal.z)
        self.powered = False  #: Whether the unit's electronics dissipate.
        #: Heat dissipation while powered, W.
        self.power_w = sum(gyro.optics_power_w + gyro.electronics_power_w for gyro in gyros)
        self._case = np.array([thermal.case_j_per_k, thermal.case_to_air_w_per_k])
        self._gyro = np.array([_row(gyro) for gyro in gyros])
        paths = np.array([gyro.heat_path for gyro in gyros])
        self._sensor_noise_c = thermal.sensor_noise_c
        self._paths = paths / np.linalg.norm(paths, axis=1, keepdims=True)
        #: Shape (7,). Temperatures: case, optics of the x, y, z gyro, electronics of the x, y, z gyro.
        self.nodes_c = np.full(7, float(start_c))
        #: optics_c, electronics_c: Shape (3,). Views of ``nodes_c``.
        self.optics_c, self.electronics_c = self.nodes_c[1:4], self.nodes_c[4:7]
        #: Results of the last :meth:`step`.
        self.course = ThermalCourse(self.nodes_c[np.newaxis].copy(), np.zeros((1, 3)), np.zeros((1, 3)))

    def step(self, dt_s: float, air_c: float | FloatArray, up_body: FloatArray) -> None:
        """Make n steps of ``dt_s`` (about a second), one for each air temperature, shape (n,).

        ``up_body`` is Up in body axes in each step, shape (n, 3), or in all, (3,).
        """
        up = np.ascontiguousarray(up_body).reshape(-1, 3)
        self.course = ThermalCourse(
            *_steps(self.nodes_c, self._case, self._gyro, self._paths, up, np.atleast_1d(air_c),
                    1.0 if self.powered else 0.0, dt_s)
        )  # fmt: skip

    def read_c(self, nodes_c: FloatArray, normal: FloatArray) -> FloatArray:
        """Add sensor noise to the temperatures of all nodes, shape (n, 7).

        ``normal``: standard normal numbers, shape (n, 7), or (n, 6) for no noise of the case.
        """
        read_c = nodes_c.copy()
        read_c[:, 7 - normal.shape[1] :] += self._sensor_noise_c * normal
        return read_c


def _row(gyro: GyroThermal) -> list[float]:
    return [
        gyro.optics_j_per_k, gyro.electronics_j_per_k, gyro.optics_power_w, gyro.electronics_power_w,
        gyro.optics_to_case_w_per_k, gyro.electronics_to_case_w_per_k, gyro.electronics_to_optics_w_per_k,
        gyro.convection_w_per_k, gyro.convection_gravity_share,
    ]  # fmt: skip


@compiled
def _steps(
    nodes: FloatArray, case: FloatArray, gyro: FloatArray, paths: FloatArray, up: FloatArray,
    air_c: FloatArray, power: float, dt: float,
) -> tuple[FloatArray, FloatArray, FloatArray]:  # fmt: skip
    """Make a step for each ``air_c``; updates ``nodes``, returns the fields of a :class:`ThermalCourse`."""
    n = air_c.size
    course, rate, convected = np.empty((n, 7)), np.empty((n, 3)), np.empty((n, 3))
    for k in range(n):
        case_c, row = nodes[0], min(k, len(up) - 1)
        into_case = case[1] * (air_c[k] - case_c)
        for i in range(3):
            optics, electronics = nodes[1 + i], nodes[4 + i]
            c_optics, c_electronics, p_optics, p_electronics = gyro[i, 0], gyro[i, 1], gyro[i, 2], gyro[i, 3]
            g_oc, g_ec, g_eo, g_conv, share = gyro[i, 4], gyro[i, 5], gyro[i, 6], gyro[i, 7], gyro[i, 8]
            upward = paths[i, 0] * up[row, 0] + paths[i, 1] * up[row, 1] + paths[i, 2] * up[row, 2]
            convected[k, i] = g_conv * share * upward * (electronics - optics)
            to_optics = (g_eo + g_conv) * (electronics - optics) + convected[k, i]
            optics_loss, electronics_loss = g_oc * (optics - case_c), g_ec * (electronics - case_c)
            nodes[1 + i] += dt / c_optics * (power * p_optics + to_optics - optics_loss)
            nodes[4 + i] += dt / c_electronics * (power * p_electronics - to_optics - electronics_loss)
            rate[k, i] = (nodes[1 + i] - optics) * 3600.0 / dt
            into_case += optics_loss + electronics_loss
        nodes[0] += dt / case[0] * into_case
        for i in range(7):  # numba takes seconds to compile the assignment of a whole array
            course[k, i] = nodes[i]
    return course, rate, convected
