"""Numba kernels of the simulated INS: the Earth, ideal sensors, and strapdown navigation.

The mechanisation is fully nonlinear, in the local-level frame (attitude quaternion, transport rate and Earth
rate, Coriolis, ellipsoid, gravity as a function of latitude) at fixed altitude: Titterton and Weston,
Strapdown Inertial Navigation Technology, chapters 3 and 11. The increments are exact rotation vectors, so
there is no coning error.
"""

from __future__ import annotations

import math

import numpy as np

from gyrobench.bench.foundations.arrays import FloatArray
from gyrobench.bench.foundations.kernels import compiled, multiply_3x3

#: Rotation rate of the Earth, rad/s.
EARTH_RATE = 7.292115e-5
#: Semi-major axis of the WGS-84 ellipsoid, m.
_SEMI_MAJOR_AXIS = 6378137.0
#: First eccentricity squared of the ellipsoid.
_ECCENTRICITY_SQUARED = 6.69437999014e-3
_EQUATOR_GRAVITY = 9.7803253359
_SOMIGLIANA_K = 1.93185265241e-3
#: Layout of the navigation state: quaternion body to ENU (w, x, y, z), velocity east and north
#: in m/s, latitude and longitude in rad.
STATE_SIZE = 8
#: Reference latitudes per rad, some centimetres apart. Radii are computed at the nearest one; sine and cosine
#: are extrapolated from it by the first term of their series, in double precision.
_REFERENCES_PER_RAD = 1e8

# Tuples stay in registers; small arrays would be allocated for every sample.
_Row = tuple[float, float, float]
_Quaternion = tuple[float, float, float, float]


@compiled
def normal_gravity(latitude: float, height: float) -> float:
    """Gravity in m/s2 at geodetic latitude (rad) and height (m), Somigliana with free air term."""
    sin2 = math.sin(latitude) ** 2
    surface = _EQUATOR_GRAVITY * (1.0 + _SOMIGLIANA_K * sin2) / math.sqrt(1.0 - _ECCENTRICITY_SQUARED * sin2)
    return surface * (1.0 - 2.0 * height / _SEMI_MAJOR_AXIS)


@compiled
def _principal_radii(latitude: float) -> tuple[float, float]:
    """Radii of curvature in m at a latitude in rad: along the meridian, and across it."""
    root = 1.0 - _ECCENTRICITY_SQUARED * math.sin(latitude) ** 2
    across = _SEMI_MAJOR_AXIS / math.sqrt(root)
    return across * (1.0 - _ECCENTRICITY_SQUARED) / root, across


@compiled
def _length(vector: FloatArray) -> float:
    """Length of a vector; numpy's sums would load a large part of numba and scipy.linalg."""
    total = 0.0
    for each in vector:
        total += each * each
    return math.sqrt(total)


@compiled
def _set_rotation(C: FloatArray, axis: FloatArray, angle: float) -> None:
    """Set ``C`` (3, 3) to the rotation about a unit vector by an angle in rad."""
    c, s = math.cos(angle), math.sin(angle)
    x, y, z = axis[0], axis[1], axis[2]
    C[0, 0], C[0, 1], C[0, 2] = c + x * x * (1 - c), x * y * (1 - c) - z * s, x * z * (1 - c) + y * s
    C[1, 0], C[1, 1], C[1, 2] = y * x * (1 - c) + z * s, c + y * y * (1 - c), y * z * (1 - c) - x * s
    C[2, 0], C[2, 1], C[2, 2] = z * x * (1 - c) - y * s, z * y * (1 - c) + x * s, c + z * z * (1 - c)


@compiled
def table_attitude(
    outer_axis: FloatArray, inner_axis: FloatArray, mounting: FloatArray, outer: float, inner: float
) -> FloatArray:
    """True ``C_nb`` (3, 3) of the unit on the table at two axis angles in rad."""
    outer_turn, inner_turn, table = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    _set_rotation(outer_turn, outer_axis, outer)
    _set_rotation(inner_turn, inner_axis, inner)
    multiply_3x3(table, outer_turn, inner_turn)
    multiply_3x3(outer_turn, table, mounting)
    return outer_turn


@compiled
def _set_rotation_vector(vector: FloatArray, C: FloatArray) -> None:
    """Set ``vector`` (3,) to the rotation vector of ``C``, rad."""
    vector[0] = 0.5 * (C[2, 1] - C[1, 2])
    vector[1] = 0.5 * (C[0, 2] - C[2, 0])
    vector[2] = 0.5 * (C[1, 0] - C[0, 1])
    sine = math.sqrt(vector[0] ** 2 + vector[1] ** 2 + vector[2] ** 2)
    if sine >= 1e-12:
        scale = math.atan2(sine, 0.5 * (C[0, 0] + C[1, 1] + C[2, 2] - 1.0)) / sine
        for i in range(3):
            vector[i] *= scale


@compiled
def true_increments(
    outer_axis: FloatArray, inner_axis: FloatArray, mounting: FloatArray, outer: FloatArray,
    inner: FloatArray, latitude: float, height: float, dt: float,
) -> tuple[FloatArray, FloatArray]:  # fmt: skip
    """Compute the output of ideal sensors at the table's centre, body axes, each of shape (n, 3).

    It is the rotation vector against inertial space, rad, and the integral of the specific force, m/s, of
    each sample. ``outer`` and ``inner``, (n + 1,), are the axis angles in rad at the edges of the samples.
    """
    n = outer.size - 1
    rotation = np.empty((n, 3))
    velocity = np.empty((n, 3))
    earth = EARTH_RATE * np.array((0.0, math.cos(latitude), math.sin(latitude)))
    lift = normal_gravity(latitude, height) * dt
    step, turned, between = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    _set_rotation(step, earth / EARTH_RATE, EARTH_RATE * dt)
    before = table_attitude(outer_axis, inner_axis, mounting, outer[0], inner[0])
    for k in range(n):
        if outer[k + 1] == outer[k] and inner[k + 1] == inner[k]:
            for i in range(3):
                rotation[k, i] = (before[1, i] * earth[1] + before[2, i] * earth[2]) * dt
                velocity[k, i] = before[2, i] * lift
        else:
            after = table_attitude(outer_axis, inner_axis, mounting, outer[k + 1], inner[k + 1])
            multiply_3x3(turned, step, after)
            multiply_3x3(between, before.T, turned)
            _set_rotation_vector(rotation[k], between)
            for i in range(3):
                velocity[k, i] = 0.5 * (before[2, i] * lift + after[2, i] * lift)
            before = after
    return rotation, velocity


@compiled
def _quaternion_product(a: _Quaternion, b: _Quaternion) -> _Quaternion:
    return (
        a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3],
        a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2],
        a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1],
        a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0],
    )


@compiled
def _quaternion_from_vector(v0: float, v1: float, v2: float) -> _Quaternion:
    square = v0 * v0 + v1 * v1 + v2 * v2
    if square < 1e-6:  # series: exact to double precision for angles below 1 mrad
        scale = 0.5 - square * (1.0 / 48.0)
        return 1.0 - square * (0.125 - square * (1.0 / 384.0)), scale * v0, scale * v1, scale * v2
    angle = math.sqrt(square)
    scale = math.sin(0.5 * angle) / angle
    return math.cos(0.5 * angle), scale * v0, scale * v1, scale * v2


@compiled
def _matrix_rows(w: float, x: float, y: float, z: float) -> tuple[_Row, _Row, _Row]:
    return (
        (w * w + x * x - y * y - z * z, 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), w * w - x * x + y * y - z * z, 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), w * w - x * x - y * y + z * z),
    )


@compiled
def matrix_of(q: FloatArray) -> FloatArray:
    """``C_nb`` (3, 3) of a unit quaternion (w, x, y, z)."""
    C = np.empty((3, 3))
    _set_matrix(C, q[0], q[1], q[2], q[3])
    return C


@compiled
def _set_matrix(C: FloatArray, w: float, x: float, y: float, z: float) -> None:
    first, second, third = _matrix_rows(w, x, y, z)
    C[0, 0], C[0, 1], C[0, 2] = first
    C[1, 0], C[1, 1], C[1, 2] = second
    C[2, 0], C[2, 1], C[2, 2] = third


@compiled
def gyrocompass(rotation: FloatArray, velocity: FloatArray) -> FloatArray:
    """Compute the attitude, a unit quaternion body to ENU (w, x, y, z), from increments at rest.

    Sums of the increments, ``rotation`` and ``velocity``, each of shape (3,), give the directions of the
    Earth's rotation and of Up in body axes.
    """
    C, length = np.empty((3, 3)), _length(velocity)
    east, up = C[0], C[2]
    for i in range(3):
        up[i] = velocity[i] / length
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        east[i] = rotation[j] * up[k] - rotation[k] * up[j]
    length = _length(east)
    for i in range(3):
        east[i] /= length
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        C[1, i] = up[j] * east[k] - up[k] * east[j]
    return _quaternion_from_matrix(C)


@compiled
def _quaternion_from_matrix(C: FloatArray) -> FloatArray:
    squares, q = np.empty(4), np.empty(4)
    squares[0] = 1.0 + C[0, 0] + C[1, 1] + C[2, 2]
    squares[1] = 1.0 + C[0, 0] - C[1, 1] - C[2, 2]
    squares[2] = 1.0 - C[0, 0] + C[1, 1] - C[2, 2]
    squares[3] = 1.0 - C[0, 0] - C[1, 1] + C[2, 2]
    largest = 0  # the best conditioned component
    for i in range(1, 4):
        if squares[i] > squares[largest]:
            largest = i
    q[largest] = squares[largest]
    if largest == 0:
        q[1], q[2], q[3] = C[2, 1] - C[1, 2], C[0, 2] - C[2, 0], C[1, 0] - C[0, 1]
    else:
        i = largest - 1
        j, k = (i + 1) % 3, (i + 2) % 3
        q[0] = C[k, j] - C[j, k]
        q[1 + j], q[1 + k] = C[j, i] + C[i, j], C[k, i] + C[i, k]
    length = _length(q)
    for i in range(4):
        q[i] /= length
    return q


@compiled
def navigate(
    state: FloatArray, rotation: FloatArray, velocity: FloatArray, dt: float, height: float,
    first: int, every: int,
) -> FloatArray:  # fmt: skip
    """Navigate at fixed altitude; updates ``state``, see :data:`STATE_SIZE`, and returns copies (m, 8) of it.

    ``rotation`` and ``velocity``, (n, 3), are measured increments, body axes, rad and m/s. The state is
    copied after sample ``first`` and after each ``every``-th sample from there.
    """
    n = rotation.shape[0]
    copies = np.empty((max(0, (n - 1 - first) // every + 1) if first < n else 0, STATE_SIZE))
    row, number = 0, math.inf
    reference = reference_sine = reference_cosine = per_meridian = per_across = 0.0
    # In variables, which stay in registers.
    attitude = (state[0], state[1], state[2], state[3])
    v_east, v_north, latitude, longitude = state[4], state[5], state[6], state[7]
    for k in range(n):
        if np.rint(latitude * _REFERENCES_PER_RAD) != number:
            number = np.rint(latitude * _REFERENCES_PER_RAD)
            reference = number / _REFERENCES_PER_RAD
            reference_sine, reference_cosine = math.sin(reference), math.cos(reference)
            meridian, across = _principal_radii(reference)
            per_meridian, per_across = 1.0 / (meridian + height), 1.0 / (across + height)
        offset = latitude - reference
        sine, cosine = reference_sine + offset * reference_cosine, reference_cosine - offset * reference_sine
        per_cosine = 1.0 / cosine
        tangent = sine * per_cosine
        earth_n, earth_u = EARTH_RATE * cosine, EARTH_RATE * sine

        # Velocity increment in the body frame at the start of the sample, then in ENU.
        a0, a1, a2 = rotation[k, 0], rotation[k, 1], rotation[k, 2]
        b0, b1, b2 = velocity[k, 0], velocity[k, 1], velocity[k, 2]
        f0 = b0 + 0.5 * (a1 * b2 - a2 * b1)
        f1 = b1 + 0.5 * (a2 * b0 - a0 * b2)
        f2 = b2 + 0.5 * (a0 * b1 - a1 * b0)
        (c00, c01, c02), (c10, c11, c12), (c20, c21, c22) = _matrix_rows(*attitude)
        d0 = c00 * f0 + c01 * f1 + c02 * f2
        d1 = c10 * f0 + c11 * f1 + c12 * f2
        d2 = c20 * f0 + c21 * f1 + c22 * f2

        # Half of the navigation frame's rotation in the sample, and Coriolis. Gravity has no level component.
        transport_u = v_east * per_across * tangent
        z0 = -v_north * per_meridian * dt
        z1 = (earth_n + v_east * per_across) * dt
        z2 = (earth_u + transport_u) * dt
        coriolis = (2.0 * earth_u + transport_u) * dt
        next_east = v_east + d0 - 0.5 * (z1 * d2 - z2 * d1) + coriolis * v_north
        next_north = v_north + d1 - 0.5 * (z2 * d0 - z0 * d2) - coriolis * v_east

        # Attitude and position with the mean velocity of the sample. The body's rotation comes first: the
        # processor computes it while it waits for the velocity.
        turned = _quaternion_product(attitude, _quaternion_from_vector(a0, a1, a2))
        mean_e, mean_n = 0.5 * (v_east + next_east), 0.5 * (v_north + next_north)
        frame = _quaternion_from_vector(
            mean_n * per_meridian * dt,
            -(earth_n + mean_e * per_across) * dt,
            -(earth_u + mean_e * per_across * tangent) * dt,
        )
        q = _quaternion_product(frame, turned)
        # The length is 1 except for rounding, so the first term of the series of its inverse suffices.
        scale = 1.5 - 0.5 * (q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
        attitude = (scale * q[0], scale * q[1], scale * q[2], scale * q[3])
        v_east, v_north = next_east, next_north
        latitude += mean_n * per_meridian * dt
        longitude += mean_e * per_across * per_cosine * dt
        if k >= first and (k - first) % every == 0:
            copies[row, 0], copies[row, 1], copies[row, 2], copies[row, 3] = attitude
            copies[row, 4], copies[row, 5] = v_east, v_north
            copies[row, 6], copies[row, 7] = latitude, longitude
            row += 1
    state[0], state[1], state[2], state[3] = attitude
    state[4], state[5], state[6], state[7] = v_east, v_north, latitude, longitude
    return copies


@compiled
def euler_angles(C: FloatArray, pitch_first: bool) -> tuple[float, float, float]:
    """Roll, pitch and heading (clockwise from north) in rad of one attitude.

    Sequence RPY(321), ``C = Rz(yaw) Rx(pitch) Ry(roll)``, or with ``pitch_first`` PRY(231),
    ``C = Rz(yaw) Ry(roll) Rx(pitch)``; heading is minus yaw.
    """
    if pitch_first:
        roll = math.asin(max(-1.0, min(1.0, -C[2, 0])))
        return roll, math.atan2(C[2, 1], C[2, 2]), -math.atan2(C[1, 0], C[0, 0])
    pitch = math.asin(max(-1.0, min(1.0, C[2, 1])))
    return math.atan2(-C[2, 0], C[2, 2]), pitch, -math.atan2(-C[0, 1], C[1, 1])


@compiled
def euler_output(states: FloatArray, pitch_first: bool) -> FloatArray:
    """Velocity and :func:`euler_angles` of navigation states (n, 8), laid out as in :data:`STATE_SIZE`.

    The columns are velocity north and east in m/s; roll, pitch and heading in rad, heading in [0, 2 pi).
    """
    out, C = np.empty((states.shape[0], 5)), np.empty((3, 3))
    for k in range(states.shape[0]):
        _set_matrix(C, states[k, 0], states[k, 1], states[k, 2], states[k, 3])
        roll, pitch, heading = euler_angles(C, pitch_first)
        out[k, 0], out[k, 1] = states[k, 5], states[k, 4]
        out[k, 2], out[k, 3], out[k, 4] = roll, pitch, heading % (2.0 * math.pi)
    return out
