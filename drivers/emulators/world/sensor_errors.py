"""Errors of gyros and accelerometers: the paper's equations (1) and (2), as functions of temperature."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from gyrobench.bench.foundations.arrays import DPH_TO_RADPS, FloatArray
from gyrobench.bench.foundations.kernels import compiled
from gyrobench.drivers.emulators.world.world_file import (
    AccelerometerErrors,
    GyroErrors,
    OverTemperature,
    PerAxis,
    PerPair,
    WorldFile,
)

ARCSEC = math.radians(1.0) / 3600.0
MICRO_G = 9.80665e-6
PPM = 1e-6
_DEGREES = 6
_PER_DECADE = 2


@dataclass(frozen=True)
class TriadErrors:
    """Static errors of three sensors as polynomials in temperature, and their noise, in SI."""

    #: Shape (6, 12). Row d: coefficient of degree d; columns: three biases, then the error matrix by rows.
    polynomials: FloatArray
    random_walk: float  #: Standard deviation of the integrated noise after one second.
    pulse: float  #: Size of one output pulse; 0 for none.

    def at(self, temperature_c: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Biases (3,) and error matrix (3, 3), for each sensor's temperature minus the reference, (3,)."""
        values = _evaluate(self.polynomials, temperature_c)
        return values[0], values[1:]


class BiasWander:
    """Bias instability and rate random walk of three gyros, second by second.

    Flicker noise is the sum of first-order Gauss-Markov processes with time constants from a second to 12
    days, two in each decade (van der Ziel, Physica 16, 1950).
    """

    def __init__(self, errors: GyroErrors, random: np.random.Generator) -> None:
        self.is_any = errors.bias_instability_dph > 0.0 or errors.rate_random_walk_dph_per_sqrt_h > 0.0
        self._random = random
        self._decay = np.exp(-(10.0 ** -np.arange(0.0, 6.1, 1.0 / _PER_DECADE)))
        # Standard deviation of each process, such that the two-sided spectrum of the sum is B^2 / (2 pi f).
        self._sigma = errors.bias_instability_dph * math.sqrt(math.log(10.0) / _PER_DECADE / math.pi)
        self._step = errors.rate_random_walk_dph_per_sqrt_h / 60.0
        self._flicker = self._sigma * random.standard_normal((len(self._decay), 3))
        self._walk = np.zeros(3)

    def next_dph(self, seconds: int) -> FloatArray:
        """Bias, shape (n, 3), in each of the next seconds, deg/h; for 0 seconds the present one, (1, 3)."""
        course = np.tile(self._walk + self._flicker.sum(axis=0), (max(seconds, 1), 1))
        gain = self._sigma * np.sqrt(1.0 - self._decay**2)[:, np.newaxis]
        for second in range(seconds):
            normal = self._random.standard_normal((len(self._decay) + 1, 3))
            self._flicker = self._decay[:, np.newaxis] * self._flicker + gain * normal[1:]
            self._walk = self._walk + self._step * normal[0]
            course[second] = self._walk + self._flicker.sum(axis=0)
        return course


def gyro_errors(errors: GyroErrors) -> TriadErrors:
    """Convert the gyros' errors to SI: biases in rad/s, noise in rad/sqrt(s)."""
    return TriadErrors(
        _polynomials(errors.bias_dph, DPH_TO_RADPS, errors.scale_factor_ppm, errors.misalignment_arcsec),
        math.radians(errors.angle_random_walk_deg_per_sqrt_h) / 60.0,
        errors.pulse_arcsec * ARCSEC,
    )


def accelerometer_errors(errors: AccelerometerErrors) -> TriadErrors:
    """Convert the accelerometers' errors to SI: biases in m/s2, noise in m/s/sqrt(s)."""
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


class AddedErrors(NamedTuple):
    """Errors in n seconds that are not functions of temperature alone, shapes (n, 3)."""

    gyro_dph: FloatArray  #: Biases of the gyros.
    scale_factor_ppm: FloatArray  #: Scale factors of the gyros.
    accelerometer_ug: FloatArray  #: Biases of the accelerometers.

    def last(self, seconds: int) -> AddedErrors:
        """Those of the last seconds."""
        return AddedErrors(*(each[-seconds:] for each in self))


class InertialSensors:
    """The gyros and accelerometers of a unit."""

    def __init__(self, file: WorldFile) -> None:
        self._gyros = gyro_errors(file.gyro)
        triads = self._gyros, accelerometer_errors(file.accelerometer)
        self._polynomials = np.array([triad.polynomials for triad in triads])
        self._walks = np.array([triad.random_walk for triad in triads])
        self._pulses = np.array([triad.pulse for triad in triads])
        self._remainders = np.zeros((2, 3))
        self._reference_c = file.reference_temperature_c
        rate_coefficients = file.gyro.scale_factor_asymmetry_ppm, file.gyro.scale_factor_ppm_per_dps
        self._half_asymmetry_ppm, self._ppm_per_dps = np.array(rate_coefficients) * [[0.5], [1.0]]
        self._scale_varies = bool(np.any(rate_coefficients))
        self.power_on_bias = np.zeros(3)  #: Of the gyros, rad/s, in addition to that by temperature.

    def gyro_bias(self, optics_c: FloatArray) -> FloatArray:
        """Biases (3,) of the gyros at their temperatures (3,), without added errors, rad/s."""
        return self._gyros.at(optics_c - self._reference_c)[0] + self.power_on_bias

    def measure(
        self, rotation: FloatArray, velocity: FloatArray, count: int, dt: float, temperature_c: FloatArray,
        normal: FloatArray, added: AddedErrors, compensated_dph: FloatArray,
    ) -> tuple[FloatArray, FloatArray]:  # fmt: skip
        """Increments measured in ``count`` samples of each of n seconds; parameters as of the kernel."""
        measured: tuple[FloatArray, FloatArray] = _measure(
            rotation, velocity, self._polynomials, temperature_c, self._reference_c, self.power_on_bias,
            added.gyro_dph, compensated_dph, normal, count, dt, self._walks, self._pulses, self._remainders,
        )  # fmt: skip
        if self._scale_varies or np.count_nonzero(added.scale_factor_ppm):
            true = np.resize(rotation, (len(normal) * count, 3))  # at rest, the second is repeated
            ppm = np.repeat(added.scale_factor_ppm, count, axis=0)
            ppm += (
                self._half_asymmetry_ppm * np.sign(true) + self._ppm_per_dps * np.degrees(np.abs(true)) / dt
            )
            measured = np.ascontiguousarray(measured[0] + PPM * ppm * true), measured[1]
        if np.count_nonzero(added.accelerometer_ug):
            measured = measured[0], measured[1] + np.repeat(added.accelerometer_ug * (MICRO_G * dt), count, 0)
        return measured


@compiled
def _measure(
    rotation: FloatArray, velocity: FloatArray, polynomials: FloatArray, temperature_c: FloatArray,
    reference_c: float, gyro_bias: FloatArray, added_dph: FloatArray, compensated_dph: FloatArray,
    normal: FloatArray, count: int, dt: float, walks: FloatArray, pulses: FloatArray, remainders: FloatArray,
) -> tuple[FloatArray, FloatArray]:  # fmt: skip
    """Compute the increments measured in ``count`` samples of each of n seconds, each as by :func:`sense`.

    ``rotation`` and ``velocity``, (m, 3), are the true increments of all seconds, or those of one second at
    rest, which are repeated. ``polynomials`` (2, 6, 12), ``walks`` (2,) and ``pulses`` (2,) are the errors of
    gyros and accelerometers, see :class:`TriadErrors`. ``temperature_c`` (n, 7) is that of
    :class:`~gyrobench.drivers.emulators.world.thermal.ThermalNetwork`; the accelerometers have the
    temperature of the case. ``gyro_bias`` (3,) in rad/s and ``added_dph`` (n, 3) are added to the gyros'
    biases, ``compensated_dph`` (3,) is subtracted. ``normal`` (n, k) has standard normal numbers, first six
    for each sample; others are ignored. The quantisation ``remainders`` (2, 3) are updated.
    """
    n = normal.shape[0]
    measured = np.empty((2, n * count, 3))
    root = math.sqrt(dt)
    for second in range(n):
        for k in range(count):
            for kind in range(2):
                for i in range(3):
                    noise = normal[second, 6 * k + 3 * kind + i] * root * walks[kind]
                    measured[kind, second * count + k, i] = noise
        gyros = _evaluate(polynomials[0], temperature_c[second, 1:4] - reference_c)
        for i in range(3):
            gyros[0, i] += gyro_bias[i]
            gyros[0, i] += added_dph[second, i] * DPH_TO_RADPS
            gyros[0, i] -= compensated_dph[i] * DPH_TO_RADPS
        accelerometers = _evaluate(polynomials[1], np.full(3, temperature_c[second, 0] - reference_c))
        rows = slice(second * count, (second + 1) * count)
        first = second * count % rotation.shape[0]
        true = slice(first, first + count)
        _sense(measured[0, rows], rotation[true], gyros[1:], gyros[0], dt, pulses[0], remainders[0])
        _sense(
            measured[1, rows], velocity[true], accelerometers[1:], accelerometers[0], dt, pulses[1],
            remainders[1],
        )  # fmt: skip
    return measured[0], measured[1]


@compiled
def sense(
    true: FloatArray, error_matrix: FloatArray, bias: FloatArray, noise: FloatArray, dt: float, pulse: float,
    remainder: FloatArray,
) -> FloatArray:  # fmt: skip
    """Compute the sensor output for true increments: the paper's (1) or (2), integrated over each sample.

    ``true`` and ``noise``, (n, 3), have the same unit; ``bias`` (3,) is in that unit per second.
    ``error_matrix`` has scale factor errors on its diagonal and misalignments off the diagonal. ``pulse`` is
    the size of one output pulse, 0 for no quantisation; ``remainder`` (3,) carries the remainder.
    """
    out = noise.copy()
    _sense(out, true, error_matrix, bias, dt, pulse, remainder)
    return out


@compiled
def _sense(
    out: FloatArray, true: FloatArray, error_matrix: FloatArray, bias: FloatArray, dt: float, pulse: float,
    remainder: FloatArray,
) -> None:  # fmt: skip
    """As :func:`sense`; ``out`` contains the noise on entry, and the output on return."""
    for k in range(true.shape[0]):
        for i in range(3):
            value = true[k, i] + bias[i] * dt + out[k, i]
            for j in range(3):
                value += error_matrix[i, j] * true[k, j]
            if pulse > 0.0:
                value += remainder[i]
                quantised = math.floor(value / pulse + 0.5) * pulse
                remainder[i] = value - quantised
                value = quantised
            out[k, i] = value


@compiled
def _evaluate(polynomials: FloatArray, temperature_c: FloatArray) -> FloatArray:
    values = np.zeros((4, 3))
    for column in range(12):
        row, axis = column // 3, column % 3
        sensor = axis if row == 0 else row - 1
        for degree in range(_DEGREES - 1, -1, -1):
            values[row, axis] = values[row, axis] * temperature_c[sensor] + polynomials[degree, column]
    return values
