"""Dwells of an INS at rest on a table, mechanised in full by pyins: independent of the emulated bench."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from gyrobench.bench.bias.dwell import Dwell, NavigationWindow, TurnPath
from gyrobench.bench.foundations.arrays import DPH_TO_RADPS, FloatArray
from gyrobench.bench.navigation.attitude import UP, rotation_matrix
from gyrobench.bench.navigation.earth import earth_rate_enu, gravity
from gyrobench.bench.navigation.positions import POSITIONS

LATITUDE = np.deg2rad(36.4)
GRAVITY = gravity(LATITUDE)

# North-East-Down from East-North-Up, and back.
C_NED_ENU = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])


@dataclass(frozen=True)
class RestingIns:
    """What the simulated dwell contains; biases in body axes, the drift from first to last epoch."""

    position: str = "z_up"
    gyro_bias_dph: tuple[float, float, float] = (0.0, 0.0, 0.0)
    accelerometer_bias_mps2: tuple[float, float, float] = (0.0, 0.0, 0.0)
    accelerometer_drift_mps2: tuple[float, float, float] = (0.0, 0.0, 0.0)
    window_s: float = 600.0
    turn_s: float = 20.0
    turn_deg: float = 180.0
    step_s: float = 0.1
    latitude: float = LATITUDE


def aligned_error_enu(ins: RestingIns) -> FloatArray:
    """Misalignment phi of an INS that levelled and gyrocompassed with its sensors' biases."""
    C_nb = POSITIONS[ins.position].C_nb()
    gyro = C_nb @ np.array(ins.gyro_bias_dph) * DPH_TO_RADPS
    acceleration = C_nb @ np.array(ins.accelerometer_bias_mps2)
    _, rate_north, rate_up = earth_rate_enu(ins.latitude)
    phi_east = -acceleration[1] / gravity(ins.latitude)
    phi_north = acceleration[0] / gravity(ins.latitude)
    return np.array([phi_east, phi_north, (-gyro[0] + phi_north * rate_up) / rate_north])


def measured_increments(
    ins: RestingIns, rate_up: float, C_nb: FloatArray, drifted: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Angle and velocity increments (n, 3) of sensors that turn about Up at a steady rate (rad/s).

    ``drifted`` (n,) is the part of the accelerometers' drift that is there already.
    """
    step, count = ins.step_s, len(drifted)
    rate_enu = earth_rate_enu(ins.latitude) + rate_up * UP

    def rate_body(time: FloatArray) -> FloatArray:
        turned = Rotation.from_rotvec(rate_up * time[:, np.newaxis] * UP)
        return turned.inv().apply(rate_enu) @ C_nb

    starts = step * np.arange(count)
    middle = rate_body(starts + 0.5 * step)
    # Midpoint rule, and the coning term of a rate that changes within the interval.
    theta = middle * step + np.cross(rate_body(starts), middle) * step**2 / 6.0
    theta = theta + np.array(ins.gyro_bias_dph) * DPH_TO_RADPS * step
    force = C_nb.T @ UP * gravity(ins.latitude) + np.array(ins.accelerometer_bias_mps2)
    force = force + np.multiply.outer(drifted, ins.accelerometer_drift_mps2)
    dv = force * step + 0.5 * np.cross(theta, force) * step
    return theta, dv


def simulate(ins: RestingIns) -> Dwell:
    """Navigate through one dwell: a window, a turn, a window."""
    from pyins._numba_integrate import integrate  # the public Integrator warns with pandas 3

    integrate.enable_caching()  # compiled once for all processes
    C_before = POSITIONS[ins.position].C_nb()
    turn = np.deg2rad(ins.turn_deg)
    C_after = rotation_matrix(UP, turn) @ C_before
    counts = [round(duration / ins.step_s) for duration in (ins.window_s, ins.turn_s, ins.window_s)]
    phases = [(0.0, C_before), (turn / ins.turn_s, C_before), (0.0, C_after)]
    total = sum(counts)
    drifted = np.split((np.arange(total) + 0.5) / total, np.cumsum(counts)[:-1])
    sensed = [measured_increments(ins, *phase, part) for phase, part in zip(phases, drifted, strict=True)]
    theta, dv = (np.concatenate(parts) for parts in zip(*sensed, strict=True))

    lla, velocity_ned = np.zeros((2, total + 1, 3))
    lla[0, 0] = np.rad2deg(ins.latitude)
    C_ned_b = np.empty((total + 1, 3, 3))
    phi = aligned_error_enu(ins)
    angle = float(np.linalg.norm(phi))
    C_ned_b[0] = C_NED_ENU @ rotation_matrix(phi / angle if angle else UP, -angle) @ C_before
    integrate(np.full(total, ins.step_s), lla, velocity_ned, C_ned_b, theta, dv, 0, False)

    time = ins.step_s * np.arange(total + 1)
    velocity = velocity_ned @ C_NED_ENU
    attitude = C_NED_ENU.T @ C_ned_b
    first, last = slice(0, counts[0] + 1), slice(total - counts[2], total + 1)
    windows = tuple(NavigationWindow(time[part], velocity[part], attitude[part]) for part in (first, last))
    path = np.array([rotation_matrix(UP, angle) @ C_before for angle in np.linspace(0.0, turn, 19)])
    return Dwell(
        ins.position,
        0.0,
        windows,
        (C_before, C_after),
        (TurnPath.at_constant_rate(time[counts[0]], time[total - counts[2]], path),),
    )
