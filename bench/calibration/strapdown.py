"""Strapdown integration of increments, and how its result depends on each coefficient of the sensors.

The unit stays at one place. So the integral of the specific force and gravity in the navigation frame,

    ``u(t) = integral of (C_nb f + g) dt``,

is zero whenever the unit rests, whichever way it was turned in between; what it is instead is error.
Attitude errors psi turn vectors of the true attitude to the computed one, ENU:

    ``psi' = -w_ie x psi + C_nb dw``,   ``u' = psi x C_nb f + C_nb df``.

References
----------
Savage, "Strapdown Inertial Navigation Integration Algorithm Design", J. Guidance, Control, and Dynamics 21
(1998): coning and sculling from the increment before.
Titterton and Weston, *Strapdown Inertial Navigation Technology*, 2nd ed., chapters 11 and 12.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gyrobench.bench.calibration.coefficients import COUNT, LOWER
from gyrobench.bench.foundations.arrays import FloatArray, IntArray
from gyrobench.bench.foundations.kernels import compiled
from gyrobench.bench.navigation.attitude import rotation_matrices
from gyrobench.bench.navigation.earth import earth_rate_enu

#: Columns of the responses: the coefficients; inner lever arms of the accelerometers by rows, m; delay of the
#: accelerometers, s; initial attitude error, rad.
LEVER_ARMS, DELAY, ATTITUDE = slice(COUNT, COUNT + 9), COUNT + 9, slice(COUNT + 10, COUNT + 13)
COLUMNS = COUNT + 13
_ROWS, _COLUMNS = LOWER


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Integrated increments at the ends of n epochs, and at the start."""

    attitude: FloatArray  #: Shape (n + 1, 3, 3). C_nb.
    integral: FloatArray  #: Shape (n + 1, 3). u, m/s, ENU; zero at rest if the sensors have no error.
    force: FloatArray  #: Shape (n, 3). Integral of the specific force over each epoch, m/s, ENU.
    #: Shape (n + 1, 6, 34). Attitude (rad) and u (m/s) for each coefficient and the rest of the columns, SI.
    response: FloatArray


def integrate(
    angle: FloatArray,
    velocity: FloatArray,
    interval_s: float,
    ends: IntArray,
    C_nb: FloatArray,
    latitude: float,
    gravity: float,
) -> Trajectory:
    """Integrate increments from rest.

    Parameters
    ----------
    angle, velocity : ndarray, shape (m, 3)
        Increments, body axes, rad and m/s, freed of the errors known so far.
    ends : ndarray, shape (n,)
        Number of increments up to the end of each epoch.
    C_nb : ndarray, shape (3, 3)
        Attitude at the start.
    """
    rate = earth_rate_enu(latitude)
    earth = rotation_matrices(-rate * interval_s)
    half = rotation_matrices(-0.5 * rate * interval_s)
    attitude = np.empty((len(ends) + 1, 3, 3))
    integral, force = np.zeros((len(ends) + 1, 3)), np.empty((len(ends), 3))
    response = np.zeros((len(ends) + 1, 6, COLUMNS))
    attitude[0] = C_nb
    response[0, :3, ATTITUDE] = np.eye(3)
    _integrate(angle, velocity, interval_s, ends, earth, half, gravity, attitude, integral, force, response)
    return Trajectory(attitude, integral, force, response)


@compiled
def _turn(attitude: FloatArray, x: float, y: float, z: float) -> FloatArray:
    """Attitude after a rotation by a vector in body axes."""
    square = x * x + y * y + z * z
    if square > 1e-8:
        angle = np.sqrt(square)
        sine, cosine = np.sin(angle) / angle, (1.0 - np.cos(angle)) / square
    else:
        sine, cosine = 1.0 - square / 6.0, 0.5 - square / 24.0
    turn = np.empty((3, 3))
    turn[0, 0] = 1.0 - cosine * (y * y + z * z)
    turn[1, 1] = 1.0 - cosine * (x * x + z * z)
    turn[2, 2] = 1.0 - cosine * (x * x + y * y)
    turn[0, 1], turn[1, 0] = cosine * x * y - sine * z, cosine * x * y + sine * z
    turn[0, 2], turn[2, 0] = cosine * x * z + sine * y, cosine * x * z - sine * y
    turn[1, 2], turn[2, 1] = cosine * y * z - sine * x, cosine * y * z + sine * x
    return attitude @ turn


@compiled
def _cross(a: FloatArray, b: FloatArray) -> FloatArray:
    product = np.empty(3)
    product[0] = a[1] * b[2] - a[2] * b[1]
    product[1] = a[2] * b[0] - a[0] * b[2]
    product[2] = a[0] * b[1] - a[1] * b[0]
    return product


@compiled
def _integrate(
    angle: FloatArray, velocity: FloatArray, interval_s: float, ends: IntArray, earth: FloatArray,
    half: FloatArray, gravity: float, attitudes: FloatArray, integrals: FloatArray, forces: FloatArray,
    responses: FloatArray,
) -> None:  # fmt: skip
    C = attitudes[0].copy()
    u, force = np.zeros(3), np.zeros(3)
    response = responses[0].copy()
    tilt = np.empty(3)
    epoch, count = 0, len(angle)
    for k in range(ends[-1]):
        before, after = max(k - 1, 0), min(k + 1, count - 1)
        theta, dv = angle[k], velocity[k]
        coning = _cross(angle[before], theta) / 12.0
        turned = _cross(theta, dv)
        sculling = 0.5 * turned + _cross(theta, turned) / 6.0
        sculling += (_cross(angle[before], dv) + _cross(velocity[before], theta)) / 12.0
        new = earth @ _turn(C, theta[0] + coning[0], theta[1] + coning[1], theta[2] + coning[2])
        middle = 0.5 * (C + new)
        lift = half @ (C @ (dv + sculling))
        # Derivatives of the velocity increment by lever arms and delay.
        delayed = _cross(dv, theta) / interval_s
        rate = theta / interval_s
        turning = (angle[after] - angle[before]) / (after - before) / interval_s
        square = rate[0] ** 2 + rate[1] ** 2 + rate[2] ** 2
        for c in range(COLUMNS):
            for i in range(3):
                tilt[i] = response[i, c]
            # Response of the true increments: those measured less the errors.
            if c < 3:
                for i in range(3):
                    response[i, c] -= middle[i, c] * interval_s
            elif c < 12:
                for i in range(3):
                    response[i, c] -= middle[i, (c - 3) // 3] * theta[(c - 3) % 3]
            elif c < 15:
                for i in range(3):
                    response[3 + i, c] -= middle[i, c - 12] * interval_s
            elif c < COUNT:
                for i in range(3):
                    response[3 + i, c] -= middle[i, _ROWS[c - 15]] * dv[_COLUMNS[c - 15]]
            elif c < DELAY:
                sensor, arm = (c - COUNT) // 3, (c - COUNT) % 3
                change = rate[sensor] * rate[arm] * interval_s
                if sensor == arm:
                    change -= square * interval_s
                elif (arm - sensor) % 3 == 1:
                    change -= turning[3 - sensor - arm]
                else:
                    change += turning[3 - sensor - arm]
                for i in range(3):
                    response[3 + i, c] -= middle[i, sensor] * change
            elif c == DELAY:
                for i in range(3):
                    response[3 + i, c] += (
                        middle[i, 0] * delayed[0] + middle[i, 1] * delayed[1] + middle[i, 2] * delayed[2]
                    )
            a, b, d = response[0, c], response[1, c], response[2, c]
            for i in range(3):
                response[i, c] = earth[i, 0] * a + earth[i, 1] * b + earth[i, 2] * d
                tilt[i] = 0.5 * (tilt[i] + response[i, c])
            response[3, c] += tilt[1] * lift[2] - tilt[2] * lift[1]
            response[4, c] += tilt[2] * lift[0] - tilt[0] * lift[2]
            response[5, c] += tilt[0] * lift[1] - tilt[1] * lift[0]
        C = new
        u += lift
        u[2] -= gravity * interval_s
        force += lift
        if k + 1 == ends[epoch]:
            attitudes[epoch + 1], integrals[epoch + 1], forces[epoch] = C, u, force
            responses[epoch + 1] = response
            force[:] = 0.0
            epoch += 1
