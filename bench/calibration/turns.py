"""Compiled arithmetic of vectors and rotations."""

from __future__ import annotations

import numpy as np

from gyrobench.bench.foundations.arrays import FloatArray
from gyrobench.bench.foundations.kernels import compiled, multiply_3x3

#: Tuples stay in registers, while small arrays would be allocated for every sample.
Vector = tuple[float, float, float]


@compiled
def multiply(a: FloatArray, b: Vector) -> Vector:
    """Product of a matrix (3, 3) and a vector."""
    return (
        a[0, 0] * b[0] + a[0, 1] * b[1] + a[0, 2] * b[2],
        a[1, 0] * b[0] + a[1, 1] * b[1] + a[1, 2] * b[2],
        a[2, 0] * b[0] + a[2, 1] * b[1] + a[2, 2] * b[2],
    )


@compiled
def cross_product(a: Vector, b: Vector) -> Vector:
    """Cross product."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@compiled
def add_scaled(a: Vector, b: Vector, share: float) -> Vector:
    """``a + share * b``."""
    return a[0] + share * b[0], a[1] + share * b[1], a[2] + share * b[2]


@compiled
def set_turn(turn: FloatArray, vector: Vector) -> None:
    """Set ``turn`` (3, 3) to the matrix of a rotation vector."""
    x, y, z = vector
    square = x * x + y * y + z * z
    if square > 1e-8:
        angle = np.sqrt(square)
        sine, cosine = np.sin(angle) / angle, (1.0 - np.cos(angle)) / square
    else:
        sine, cosine = 1.0 - square / 6.0, 0.5 - square / 24.0
    turn[0, 0] = 1.0 - cosine * (y * y + z * z)
    turn[1, 1] = 1.0 - cosine * (x * x + z * z)
    turn[2, 2] = 1.0 - cosine * (x * x + y * y)
    turn[0, 1], turn[1, 0] = cosine * x * y - sine * z, cosine * x * y + sine * z
    turn[0, 2], turn[2, 0] = cosine * x * z + sine * y, cosine * x * z - sine * y
    turn[1, 2], turn[2, 1] = cosine * y * z - sine * x, cosine * y * z + sine * x


@compiled
def net_turn(steps: FloatArray) -> FloatArray:
    """Matrix (3, 3) of successive rotations (n, 3), rad, each in the axes turned by those before."""
    C, turn, product = np.eye(3), np.empty((3, 3)), np.empty((3, 3))
    for step in steps:
        set_turn(turn, (step[0], step[1], step[2]))
        multiply_3x3(product, C, turn)
        C, product = product, C
    return C
