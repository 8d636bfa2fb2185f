"""Lumped thermal network of the unit: case, and for each gyro its electronics and optics.

Heat flows by conduction and by convection that depends on gravity: a conductance ``g (1 + s u)``,
where ``u`` is the upward part of the direction from electronics to optics.
"""

from __future__ import annotations

import numpy as np

from gyrobench.bench.foundations.arrays import FloatArray
from gyrobench.bench.foundations.kernels import compiled
from gyrobench.drivers.emulators.world.world_file import GyroThermal, Thermal


class ThermalNetwork:
    """Temperatures of the unit over time."""

    def __init__(self, thermal: Thermal, start_c: float) -> None:
        gyros = (thermal.x, thermal.y, thermal.z)
        self.powered = False  #: Whether the unit's electronics dissipate.
        self._case = np.array([thermal.case_j_per_k, thermal.case_to_air_w_per_k])
        self._gyro = np.array([_row(gyro) for gyro in gyros])
        paths = np.array([gyro.heat_path for gyro in gyros])
        self._sensor_noise_c = thermal.sensor_noise_c
        self._paths = paths / np.linalg.norm(paths, axis=1, keepdims=True)
        #: Shape (7,). All temperatures: case, then optics and electronics of the x, y and z gyro.
        self.nodes_c = np.full(7, float(start_c))
        #: optics_c, electronics_c: Shape (3,). Of each gyro; views of ``nodes_c``.
        self.optics_c, self.electronics_c = self.nodes_c[1:4], self.nodes_c[4:7]
        self.optics_rate_c_per_h = np.zeros(3)  #: Shape (3,). Change of each gyro's optics in the last step.
        #: Shape (3,). The part of the heat flow from electronics to optics that depends on attitude.
        self.convected_w = np.zeros(3)

    def step(self, dt_s: float, air_c: float, up_body: FloatArray) -> None:
        """Advance by ``dt_s`` (about a second) in air of that temperature; ``up_body`` (3,) is Up."""
        _step(self.nodes_c, self.optics_rate_c_per_h, self.convected_w, self._case, self._gyro, self._paths,
              up_body, air_c, 1.0 if self.powered else 0.0, dt_s)  # fmt: skip

    def read_c(self, normal: FloatArray) -> FloatArray:
        """Readings of all nodes, shape (7,), with noise; of six normal numbers, none is for the case."""
        return np.asarray(_read(self.nodes_c, self._sensor_noise_c, normal))


def _row(gyro: GyroThermal) -> list[float]:
    return [
        gyro.optics_j_per_k, gyro.electronics_j_per_k, gyro.optics_power_w, gyro.electronics_power_w,
        gyro.optics_to_case_w_per_k, gyro.electronics_to_case_w_per_k, gyro.electronics_to_optics_w_per_k,
        gyro.convection_w_per_k, gyro.convection_gravity_share,
    ]  # fmt: skip


@compiled
def _step(
    nodes: FloatArray, rate: FloatArray, convected: FloatArray, case: FloatArray, gyro: FloatArray,
    paths: FloatArray, up: FloatArray, air_c: float, power: float, dt: float,
) -> None:  # fmt: skip
    case_c = nodes[0]
    into_case = case[1] * (air_c - case_c)
    for i in range(3):
        optics, electronics = nodes[1 + i], nodes[4 + i]
        c_optics, c_electronics, p_optics, p_electronics = gyro[i, 0], gyro[i, 1], gyro[i, 2], gyro[i, 3]
        g_oc, g_ec, g_eo, g_conv, share = gyro[i, 4], gyro[i, 5], gyro[i, 6], gyro[i, 7], gyro[i, 8]
        upward = paths[i, 0] * up[0] + paths[i, 1] * up[1] + paths[i, 2] * up[2]
        convected[i] = g_conv * share * upward * (electronics - optics)
        to_optics = (g_eo + g_conv) * (electronics - optics) + convected[i]
        optics_loss, electronics_loss = g_oc * (optics - case_c), g_ec * (electronics - case_c)
        nodes[1 + i] += dt / c_optics * (power * p_optics + to_optics - optics_loss)
        nodes[4 + i] += dt / c_electronics * (power * p_electronics - to_optics - electronics_loss)
        rate[i] = (nodes[1 + i] - optics) * 3600.0 / dt
        into_case += optics_loss + electronics_loss
    nodes[0] += dt / case[0] * into_case


@compiled
def _read(nodes: FloatArray, noise_c: float, normal: FloatArray) -> FloatArray:
    read_c = nodes.copy()
    first = nodes.size - normal.size
    for k in range(normal.size):
        read_c[first + k] += noise_c * normal[k]
    return read_c
