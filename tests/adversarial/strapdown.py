"""An INS on a two-axis table, mechanised in full in Earth-fixed axes.

Shares no code with the package: constants, kinematics, sensors, alignment and mechanisation are separate
from those of the bench and of its emulators. Attitude and velocity are integrated in the ECEF frame; only
what the INS puts out is resolved in East-North-Up. Times count from the begin of navigation.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation

from gyrobench.bench.foundations.kernels import compiled

Floats = NDArray[np.float64]
Triple = tuple[float, float, float]
Angles = tuple[float, float]

DPH = math.pi / 180.0 / 3600.0
ARCSEC = math.pi / 180.0 / 3600.0
UG = 9.80665e-6

_SPIN = 7.292115e-5
_A, _E2 = 6378137.0, 0.00669437999014
_REST_STEP_S, _TURN_STEP_S = 0.1, 0.01
EPOCH_S = 0.1


@dataclass(frozen=True)
class Unit:
    """An INS and its errors, in body axes and the units of data sheets."""

    gyro_bias_dph: Triple = (0.0, 0.0, 0.0)
    accelerometer_bias_ug: Triple = (0.0, 0.0, 0.0)
    gyro_scale_ppm: Triple = (0.0, 0.0, 0.0)
    #: Off-diagonal elements xy, xz, yx, yz, zx, zy.
    gyro_misalignment_arcsec: Sequence[float] = (0.0,) * 6
    accelerometer_misalignment_arcsec: Sequence[float] = (0.0,) * 6
    angle_random_walk: float = 0.0006  #: deg/sqrt(h)
    velocity_random_walk: float = 5.0  #: ug/sqrt(Hz)
    accelerometer_drift_ug_per_h: Triple = (0.0, 0.0, 0.0)
    #: After each turn, and how fast it decays.
    accelerometer_transient_ug: Triple = (0.0, 0.0, 0.0)
    transient_s: float = 120.0
    #: Added to the gyro biases from ``bias_step_s`` on.
    bias_step_dph: Triple = (0.0, 0.0, 0.0)
    bias_step_s: float = 300.0
    #: Undithered pulses; 0 for none.
    gyro_pulse_arcsec: float = 0.0
    accelerometer_pulse_mps: float = 0.0
    velocity_damping_s: float = math.inf  #: Time constant with which the INS damps its velocity.
    velocity_scale: Triple = (1.0, 1.0, 1.0)  #: What it sends over what it navigates, ENU.
    velocity_turned_deg: float = 0.0  #: By how much the velocity that it sends is turned about Up.
    lever_arm_m: Triple = (0.0, 0.0, 0.0)  #: From the intersection of the table's axes.
    heading_aid_s: float = math.inf  #: Time constant with which an aid holds the heading.
    aligns_again: bool = False  #: After each turn, although it states that it navigates.
    #: Share of the gyro biases East, North and Up that the first alignment finds and removes.
    removed_bias: Triple = (0.0, 0.0, 0.0)
    velocity_output_mps: float = 0.0
    attitude_output_arcsec: float = 0.0


@dataclass(frozen=True)
class Place:
    """Where the bench truly is, and what the INS takes for its latitude."""

    latitude_deg: float = 36.4
    height_m: float = 60.0
    #: Entered less true; a deflection of the vertical to the north acts the same.
    latitude_error_arcmin: float = 0.0
    #: Rotation of the table's base from its nominal axes, about East, North and Up.
    table_turned_deg: Triple = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Schedule:
    """Durations of a dwell, s."""

    align_s: float = 300.0
    window_s: float = 600.0
    turn_s: float = 25.0
    settle_s: float = 3.0


@dataclass(frozen=True)
class Output:
    """What the INS puts out from the begin of navigation to the end of the last window."""

    time_s: Floats  #: (n,)
    velocity_enu_mps: Floats  #: (n, 3)
    C_nb: Floats  #: (n, 3, 3)
    #: First epoch and the one after the last of each window; between them are a turn and the time to
    #: settle.
    windows: list[tuple[int, int]]
    turns: list[tuple[int, int]]  #: The same of the turns without settling.


@dataclass(frozen=True)
class Table:
    """Outer axis East, inner axis Up, body x East and y North at zero angles; the base may be turned."""

    turned_deg: Triple = (0.0, 0.0, 0.0)

    def attitude(self, outer_rad: Floats, inner_rad: Floats) -> Floats:
        """Attitudes (n, 3, 3) at axis angles (n,)."""
        outer, inner = np.zeros((2, len(outer_rad), 3))
        outer[:, 0], inner[:, 2] = outer_rad, inner_rad
        turned = Rotation.from_rotvec(outer) * Rotation.from_rotvec(inner)
        if any(self.turned_deg):
            turned = Rotation.from_rotvec(self.turned_deg, degrees=True) * turned
        return np.asarray(turned.as_matrix())


def simulate(
    unit: Unit, place: Place, schedule: Schedule, angles_deg: Sequence[Angles], random: np.random.Generator
) -> Output:
    """Align at the first angles, navigate there, then turn to each of the others and navigate."""
    segments, windows, turns, first = [], [], [], 0
    for number, angles in enumerate(angles_deg):
        if number:
            segments.append(_turning(unit, place, schedule, angles_deg[number - 1], angles))
            epochs = round(schedule.turn_s / EPOCH_S)
            turns.append((first, first + epochs))
            settling = round(schedule.settle_s / EPOCH_S)
            segments.append(_resting(place, angles, settling))
            first += epochs + settling
        epochs = round(schedule.window_s / EPOCH_S)
        segments.append(_resting(place, angles, epochs))
        windows.append((first, first + epochs))
        first += epochs
    windows[-1] = (windows[-1][0], first + 1)
    if any(unit.removed_bias):
        unit = _without_removed_bias(unit, place, schedule, angles_deg[0], random)
    errors = _SensorErrors(unit, random)
    state = _aligned(unit, place, schedule, angles_deg[0], random)
    parts = [state[np.newaxis].copy()]
    last_turn_s, time_s, turned = -math.inf, 0.0, 0
    for step_s, rotation, velocity in segments:
        duration_s = step_s * len(rotation)
        measured = errors.measured(time_s, last_turn_s, step_s, rotation, velocity)
        time_s += duration_s
        every = round(EPOCH_S / step_s)
        parts.append(_navigate(state, *measured, step_s, every, place.height_m, unit.velocity_damping_s))
        if step_s == _TURN_STEP_S:
            last_turn_s = time_s
            turned += 1
            if unit.aligns_again:
                state[:] = _aligned(unit, place, schedule, angles_deg[turned], random)
    states = np.vstack(parts)
    C_en = _enu_axes(states[:, 12], states[:, 13])
    velocity = np.einsum("nji,nj->ni", C_en, states[:, 9:12])
    turned = Rotation.from_euler("z", unit.velocity_turned_deg, degrees=True)
    velocity = unit.velocity_scale * turned.apply(
        velocity
    ) + unit.velocity_output_mps * random.standard_normal(velocity.shape)
    C_nb = np.einsum("nji,njk->nik", C_en, states[:, :9].reshape(-1, 3, 3))
    if math.isfinite(unit.heading_aid_s):
        C_nb = _with_heading_held(C_nb, windows, math.exp(-EPOCH_S / unit.heading_aid_s))
    if unit.attitude_output_arcsec:
        away = unit.attitude_output_arcsec * ARCSEC * random.standard_normal((len(C_nb), 3))
        C_nb = Rotation.from_rotvec(away).as_matrix() @ C_nb
    return Output(EPOCH_S * np.arange(len(states)), velocity, C_nb, windows, turns)


def _with_heading_held(C_nb: Floats, windows: Sequence[tuple[int, int]], keep: float) -> Floats:
    """Attitudes (n, 3, 3) whose heading returns, in each window, to that at its begin."""
    correction = np.zeros((len(C_nb), 3))
    for begin, end in windows:
        free = Rotation.from_matrix(C_nb[begin:end] @ C_nb[begin].T).as_rotvec()[:, 2]
        held = lfilter([keep], [1.0, -keep], np.diff(free, prepend=0.0))
        correction[begin:end, 2] = held - free
        correction[end:, 2] = correction[end - 1, 2]
    return np.asarray(Rotation.from_rotvec(correction).as_matrix() @ C_nb)


def _without_removed_bias(
    unit: Unit, place: Place, schedule: Schedule, angles_deg: Angles, random: np.random.Generator
) -> Unit:
    """The unit after an alignment that removes what it finds of the biases, with its noise."""
    C_nb = Table(place.table_turned_deg).attitude(*np.radians(angles_deg)[:, np.newaxis])[0]
    noise_dph = unit.angle_random_walk / math.sqrt(schedule.align_s / 3600.0)
    found_dph = C_nb @ unit.gyro_bias_dph + noise_dph * random.standard_normal(3)
    left_dph = np.array(unit.gyro_bias_dph) - C_nb.T @ (unit.removed_bias * found_dph)
    return replace(unit, gyro_bias_dph=tuple(left_dph))


_Increments = tuple[float, Floats, Floats]


def _earth(latitude: float) -> Floats:
    return _SPIN * np.array([0.0, math.cos(latitude), math.sin(latitude)])


@compiled
def _gravity(latitude: float, height: float) -> float:
    s2 = math.sin(latitude) ** 2
    return 9.7803253359 * (1.0 + 0.00193185265241 * s2) / math.sqrt(1.0 - _E2 * s2) - 3.0877e-6 * height


def _resting(place: Place, angles_deg: Angles, epochs: int) -> _Increments:
    """Increments at rest over a number of epochs."""
    latitude = math.radians(place.latitude_deg)
    C_nb = Table(place.table_turned_deg).attitude(*np.radians(angles_deg)[:, np.newaxis])[0]
    rate, force = C_nb.T @ _earth(latitude), C_nb.T @ [0.0, 0.0, _gravity(latitude, place.height_m)]
    count = round(epochs * EPOCH_S / _REST_STEP_S)
    return _REST_STEP_S, np.tile(rate * _REST_STEP_S, (count, 1)), np.tile(force * _REST_STEP_S, (count, 1))


def _turning(unit: Unit, place: Place, schedule: Schedule, start: Angles, end: Angles) -> _Increments:
    """Increments on the way of the table, both axes moving at once with a smooth rate."""
    latitude, step_s = math.radians(place.latitude_deg), _TURN_STEP_S
    count = round(schedule.turn_s / step_s)
    # Half steps: the middles resolve the specific force.
    share = np.linspace(0.0, 1.0, 2 * count + 1)
    share = share - np.sin(2.0 * math.pi * share) / (2.0 * math.pi)
    outer, inner = (math.radians(a) + math.radians(b - a) * share for a, b in zip(start, end, strict=True))
    C_nb = Table(place.table_turned_deg).attitude(outer, inner)
    lever = C_nb @ np.array(unit.lever_arm_m)
    moving = np.gradient(lever, 0.5 * step_s, axis=0, edge_order=2)
    moving[[0, -1]] = 0.0
    spin = _earth(latitude)
    spun = Rotation.from_rotvec(np.multiply.outer(step_s * np.arange(count + 1), spin)).as_matrix()
    C_ib = spun @ C_nb[::2]
    rotation = Rotation.from_matrix(C_ib[:-1].transpose(0, 2, 1) @ C_ib[1:]).as_rotvec()
    gained = np.diff(moving[::2], axis=0) + 2.0 * step_s * np.cross(spin, moving[1::2])
    gained[:, 2] += step_s * _gravity(latitude, place.height_m)
    return step_s, rotation, np.einsum("nji,nj->ni", C_nb[1::2], gained)


class _SensorErrors:
    """What gyros and accelerometers measure of increments, in order of time."""

    def __init__(self, unit: Unit, random: np.random.Generator) -> None:
        self._unit, self._random = unit, random
        self._gyro_matrix = _matrix(np.array(unit.gyro_scale_ppm) * 1e-6, unit.gyro_misalignment_arcsec)
        self._accelerometer_matrix = _matrix(np.zeros(3), unit.accelerometer_misalignment_arcsec)
        self._sums = np.zeros((2, 3))

    def measured(
        self, time_s: float, last_turn_s: float, step_s: float, rotation: Floats, velocity: Floats
    ) -> tuple[Floats, Floats]:
        unit = self._unit
        middle_s = time_s + step_s * (np.arange(len(rotation)) + 0.5)
        bias = np.array(unit.gyro_bias_dph) * DPH + np.where(
            middle_s[:, np.newaxis] > unit.bias_step_s, np.array(unit.bias_step_dph) * DPH, 0.0
        )
        away = np.array(unit.accelerometer_bias_ug) + np.multiply.outer(
            middle_s / 3600.0, unit.accelerometer_drift_ug_per_h
        )
        if math.isfinite(last_turn_s):
            left = np.exp(-(middle_s - last_turn_s) / unit.transient_s)
            away = away + np.multiply.outer(left, unit.accelerometer_transient_ug)
        walks = (unit.angle_random_walk * math.pi / 180.0 / 60.0, unit.velocity_random_walk * UG)
        noise = self._random.standard_normal((2, len(rotation), 3)) * math.sqrt(step_s)
        return (
            self._pulses(
                0, rotation @ self._gyro_matrix.T + bias * step_s + walks[0] * noise[0],
                unit.gyro_pulse_arcsec * ARCSEC,
            ),
            self._pulses(
                1, velocity @ self._accelerometer_matrix.T + away * UG * step_s + walks[1] * noise[1],
                unit.accelerometer_pulse_mps,
            ),
        )  # fmt: skip

    def _pulses(self, sensor: int, increments: Floats, pulse: float) -> Floats:
        if not pulse:
            return np.ascontiguousarray(increments)
        sums = self._sums[sensor] + np.cumsum(increments, axis=0)
        counted = np.floor(np.vstack([self._sums[sensor], sums]) / pulse)
        self._sums[sensor] = sums[-1]
        return np.diff(counted, axis=0) * pulse


def _matrix(diagonal: Floats, others_arcsec: Sequence[float]) -> Floats:
    matrix = np.eye(3) + np.diag(diagonal)
    matrix[~np.eye(3, dtype=bool)] = np.array(others_arcsec) * ARCSEC
    return matrix


def _aligned(
    unit: Unit, place: Place, schedule: Schedule, angles_deg: Angles, random: np.random.Generator
) -> Floats:
    """State after levelling and gyrocompassing: C_eb by rows, velocity, entered latitude, longitude."""
    _, rotation, velocity = _resting(place, angles_deg, 1)
    rotation, velocity = (np.tile(each[:1], (1, 1)) for each in (rotation, velocity))
    quiet = _SensorErrors(
        Unit(
            gyro_bias_dph=unit.gyro_bias_dph,
            accelerometer_bias_ug=unit.accelerometer_bias_ug,
            gyro_scale_ppm=unit.gyro_scale_ppm,
            gyro_misalignment_arcsec=unit.gyro_misalignment_arcsec,
            accelerometer_misalignment_arcsec=unit.accelerometer_misalignment_arcsec,
            angle_random_walk=unit.angle_random_walk,
            velocity_random_walk=unit.velocity_random_walk,
        ),
        random,
    )
    scale = schedule.align_s / _REST_STEP_S
    theta, dv = quiet.measured(
        -schedule.align_s, -math.inf, schedule.align_s, rotation * scale, velocity * scale
    )
    up = dv[0] / np.linalg.norm(dv[0])
    east = np.cross(theta[0], up)
    east /= np.linalg.norm(east)
    C_nb = np.stack([east, np.cross(up, east), up])
    latitude = math.radians(place.latitude_deg + place.latitude_error_arcmin / 60.0)
    C_en = _enu_axes(np.array([latitude]), np.zeros(1))[0]
    return np.concatenate([(C_en @ C_nb).ravel(), np.zeros(3), [latitude, 0.0]])


def _enu_axes(latitude: Floats, longitude: Floats) -> Floats:
    """East, North and Up in Earth-fixed axes as columns, (n, 3, 3)."""
    sl, cl, so, co = np.sin(latitude), np.cos(latitude), np.sin(longitude), np.cos(longitude)
    zero = np.zeros_like(sl)
    return np.stack(
        [
            np.stack([-so, -sl * co, cl * co], axis=-1),
            np.stack([co, -sl * so, cl * so], axis=-1),
            np.stack([zero, cl, sl], axis=-1),
        ],
        axis=1,
    )


@compiled
def _turned(matrix: Floats, rx: float, ry: float, rz: float, out: Floats) -> None:
    """``out = matrix @ exp([r x])``."""
    angle2 = rx * rx + ry * ry + rz * rz
    if angle2 > 1e-12:
        angle = math.sqrt(angle2)
        s, c = math.sin(angle) / angle, (1.0 - math.cos(angle)) / angle2
    else:
        s, c = 1.0 - angle2 / 6.0, 0.5 - angle2 / 24.0
    for i in range(3):
        x, y, z = matrix[i, 0], matrix[i, 1], matrix[i, 2]
        # The row times (1 + s [r x] + c [r x]^2).
        ax, ay, az = y * rz - z * ry, z * rx - x * rz, x * ry - y * rx
        bx, by, bz = ay * rz - az * ry, az * rx - ax * rz, ax * ry - ay * rx
        out[i, 0], out[i, 1], out[i, 2] = x + s * ax + c * bx, y + s * ay + c * by, z + s * az + c * bz


@compiled
def _navigate(
    state: Floats,
    rotation: Floats,
    velocity: Floats,
    step_s: float,
    every: int,
    height: float,
    damping_s: float,
) -> Floats:
    """States (m, 14) after each ``every`` steps; ``state`` is changed in place."""
    count = rotation.shape[0]
    result = np.empty((count // every, 14))
    C, middle, after = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    for i in range(9):
        C[i // 3, i % 3] = state[i]
    vx, vy, vz, latitude, longitude = state[9], state[10], state[11], state[12], state[13]
    keep = math.exp(-step_s / damping_s)
    cos_whole, sin_whole = math.cos(_SPIN * step_s), math.sin(_SPIN * step_s)
    cos_half, sin_half = math.cos(0.5 * _SPIN * step_s), math.sin(0.5 * _SPIN * step_s)
    for k in range(count):
        rx, ry, rz = rotation[k, 0], rotation[k, 1], rotation[k, 2]
        _turned(C, 0.5 * rx, 0.5 * ry, 0.5 * rz, middle)
        _turned(C, rx, ry, rz, after)
        fx = middle[0, 0] * velocity[k, 0] + middle[0, 1] * velocity[k, 1] + middle[0, 2] * velocity[k, 2]
        fy = middle[1, 0] * velocity[k, 0] + middle[1, 1] * velocity[k, 1] + middle[1, 2] * velocity[k, 2]
        fz = middle[2, 0] * velocity[k, 0] + middle[2, 1] * velocity[k, 1] + middle[2, 2] * velocity[k, 2]
        fx, fy = cos_half * fx + sin_half * fy, cos_half * fy - sin_half * fx
        for j in range(3):
            x, y = after[0, j], after[1, j]
            C[0, j], C[1, j], C[2, j] = (
                cos_whole * x + sin_whole * y,
                cos_whole * y - sin_whole * x,
                after[2, j],
            )
        sl, cl, so, co = math.sin(latitude), math.cos(latitude), math.sin(longitude), math.cos(longitude)
        ux, uy, uz = cl * co, cl * so, sl
        g = _gravity(latitude, height) * step_s
        gx, gy = 2.0 * _SPIN * vy * step_s, -2.0 * _SPIN * vx * step_s
        vx, vy, vz = vx + fx - g * ux + gx, vy + fy - g * uy + gy, vz + fz - g * uz
        vu = vx * ux + vy * uy + vz * uz
        vx, vy, vz = (vx - vu * ux) * keep, (vy - vu * uy) * keep, (vz - vu * uz) * keep
        root = math.sqrt(1.0 - _E2 * sl * sl)
        across, meridian = _A / root, _A * (1.0 - _E2) / (root * root * root)
        v_east = -so * vx + co * vy
        v_north = -sl * co * vx - sl * so * vy + cl * vz
        latitude += v_north / (meridian + height) * step_s
        longitude += v_east / ((across + height) * cl) * step_s
        if (k + 1) % every == 0:
            row = result[k // every]
            for i in range(9):
                row[i] = C[i // 3, i % 3]
            row[9], row[10], row[11], row[12], row[13] = vx, vy, vz, latitude, longitude
    state[:] = result[-1]
    return result
