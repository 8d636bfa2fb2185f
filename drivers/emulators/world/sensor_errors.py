"""Errors of gyros and accelerometers: the paper's equations (1) and (2) over temperature."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numba
import numpy as np

from gyrobench.bench.foundations.arrays import DPH_TO_RADPS, FloatArray
from gyrobench.drivers.emulators.world.world_file import (
    AccelerometerErrors,
    GyroErrors,
    OverTemperature,
    PerAxis,
    PerPair,
)

ARCSEC = math.radians(1.0) / 3600.0
MICRO_G = 9.80665e-6
PPM = 1e-6
_DEGREES = 6


@dataclass(frozen=True)
class TriadErrors:
    """Static errors of three sensors as polynomials in temperature, and their noise, in SI."""

    #: Shape (6, 12). Row d: coefficient of degree d; columns: three biases, then the error matrix by rows.
    polynomials: FloatArray
    random_walk: float  #: Standard deviation of the integrated noise after one second.
    pulse: float  #: Size of one output pulse; 0 for none.

    def at(self, temperature_c: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Biases (3,) and error matrix (3, 3), each sensor at its own temperature minus reference."""
        values = _evaluated(self.polynomials, temperature_c)
        return values[0], values[1:]


def gyro_errors(errors: GyroErrors) -> TriadErrors:
    """The gyros' errors: biases in rad/s, noise in rad/sqrt(s)."""
    return TriadErrors(
        _polynomials(errors.bias_dph, DPH_TO_RADPS, errors.scale_factor_ppm, errors.misalignment_arcsec),
        math.radians(errors.angle_random_walk_deg_per_sqrt_h) / 60.0,
        errors.pulse_arcsec * ARCSEC,
    )


def accelerometer_errors(errors: AccelerometerErrors) -> TriadErrors:
    """The accelerometers' errors: biases in m/s2, noise in m/s/sqrt(s)."""
    return TriadErrors(
        _polynomials(errors.bias_ug, MICRO_G, errors.scale_factor_ppm, errors.misalignment_arcsec),
        errors.velocity_random_walk_ug_per_sqrt_hz * MICRO_G,
        errors.pulse_um_per_s * 1e-6,
    )


def _polynomials(bias: PerAxis, unit: float, scale_ppm: PerAxis, misalignment_arcsec: PerPair) -> FloatArray:
    columns = np.zeros((_DEGREES, 12))
    for i, axis in enumerate("xyz"):
        _fill(columns[:, i], getattr(bias, axis), unit)
        for j, other in enumerate("xyz"):
            column = columns[:, 3 + 3 * i + j]
            if i == j:
                _fill(column, getattr(scale_ppm, axis), PPM)
            else:
                _fill(column, getattr(misalignment_arcsec, axis + other), ARCSEC)
    return columns


def _fill(column: FloatArray, value: OverTemperature, unit: float) -> None:
    coefficients = value if isinstance(value, list) else [value]
    column[: len(coefficients)] = np.array(coefficients) * unit


@numba.njit(cache=True)
def _evaluated(polynomials: FloatArray, temperature_c: FloatArray) -> FloatArray:
    values = np.zeros((4, 3))
    for column in range(12):
        row, place = column // 3, column % 3
        sensor = place if row == 0 else row - 1
        for degree in range(_DEGREES - 1, -1, -1):
            values[row, place] = values[row, place] * temperature_c[sensor] + polynomials[degree, column]
    return values
