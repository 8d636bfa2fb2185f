"""Lumped thermal network of the unit: case, and for each gyro its electronics and optics.

Heat flows by conduction and by convection that depends on gravity: a conductance ``g (1 + s u)``,
where ``u`` is the upward part of the direction from electronics to optics.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from gyrobench.bench.foundations.arrays import FloatArray
from gyrobench.bench.foundations.kernels import compiled
from gyrobench.drivers.emulators.world.world_file import GyroThermal, Thermal


class ThermalCourse(NamedTuple):
    """Results of n steps of a thermal network."""

    nodes_c: FloatArray  #: Shape (n, 7). All temperatures: case, then optics and electronics of each gyro.
    optics_rate_c_per_h: FloatArray  #: Shape (n, 3). Change of each gyro's optics in the step.
    #: Shape (n, 3). The part of the heat flow from electronics to optics that depends on attitude.
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
    """Temperatures of the unit over time."""

    def __init__(self, thermal: Thermal, start_c: float) -> None:
        gyros = (thermal.x, thermal.y, thermal.z)
        self.powered = False  #: Whether the unit's electronics dissipate.
        #: Heat that it dissipates while it is powered, W.
        self.power_w = sum(gyro.optics_power_w + gyro.electronics_power_w for gyro in gyros)
        self._case = np.array([thermal.case_j_per_k, thermal.case_to_air_w_per_k])
        self._gyro = np.array([_row(gyro) for gyro in gyros])
        paths = np.array([gyro.heat_path for gyro in gyros])
        self._sensor_noise_c = thermal.sensor_noise_c
        self._paths = paths / np.linalg.norm(paths, axis=1, keepdims=True)
        #: Shape (7,). All temperatures: case, then optics and electronics of the x, y and z gyro.
        self.nodes_c = np.full(7, float(start_c))
        #: optics_c, electronics_c: Shape (3,). Of each gyro; views of ``nodes_c``.
        self.optics_c, self.electronics_c = self.nodes_c[1:4], self.nodes_c[4:7]
        #: The last steps.
        self.course = ThermalCourse(self.nodes_c[np.newaxis].copy(), np.zeros((1, 3)), np.zeros((1, 3)))

    def step(self, dt_s: float, air_c: float | FloatArray, up_body: FloatArray) -> None:
        """Advance by ``dt_s`` (about a second) in air of each temperature in turn.

        ``up_body`` is Up in body axes in each step, shape (n, 3), or in all, (3,).
        """
        air_c = np.atleast_1d(air_c)
        up = np.broadcast_to(up_body, (len(air_c), 3))
        self.course = ThermalCourse(
            *_steps(self.nodes_c, self._case, self._gyro, self._paths, np.ascontiguousarray(up), air_c,
                    1.0 if self.powered else 0.0, dt_s)
        )  # fmt: skip

    def read_c(self, nodes_c: FloatArray, normal: FloatArray) -> FloatArray:
        """Readings of all nodes, shape (n, 7), with noise.

        ``normal``: normal numbers, shape (n, 7), or (n, 6) with none for the case.
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
    """Make a step for each ``air_c``; returns a :class:`ThermalCourse`, and changes ``nodes``."""
    n = air_c.size
    course, rate, convected = np.empty((n, 7)), np.empty((n, 3)), np.empty((n, 3))
    for k in range(n):
        case_c = nodes[0]
        into_case = case[1] * (air_c[k] - case_c)
        for i in range(3):
            optics, electronics = nodes[1 + i], nodes[4 + i]
            c_optics, c_electronics, p_optics, p_electronics = gyro[i, 0], gyro[i, 1], gyro[i, 2], gyro[i, 3]
            g_oc, g_ec, g_eo, g_conv, share = gyro[i, 4], gyro[i, 5], gyro[i, 6], gyro[i, 7], gyro[i, 8]
            upward = paths[i, 0] * up[k, 0] + paths[i, 1] * up[k, 1] + paths[i, 2] * up[k, 2]
            convected[k, i] = g_conv * share * upward * (electronics - optics)
            to_optics = (g_eo + g_conv) * (electronics - optics) + convected[k, i]
            optics_loss, electronics_loss = g_oc * (optics - case_c), g_ec * (electronics - case_c)
            nodes[1 + i] += dt / c_optics * (power * p_optics + to_optics - optics_loss)
            nodes[4 + i] += dt / c_electronics * (power * p_electronics - to_optics - electronics_loss)
            rate[k, i] = (nodes[1 + i] - optics) * 3600.0 / dt
            into_case += optics_loss + electronics_loss
        nodes[0] += dt / case[0] * into_case
        course[k] = nodes
    return course, rate, convected
