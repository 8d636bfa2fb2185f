"""What an INS subtracts from its gyros: a polynomial in temperature, and terms with a physical cause.

Each gyro's terms are taken at its own sensor: with its optics at T, its electronics (board) at B and
the unit vector Up in body axes, the bias of gyro i is::

    polynomial_i(T)
    + rate_i dT/dt
    + gradient_i (B - T)
    + (saturating_i . Up) (B - T) / (1 + exp(-c))           c = (onset_i - T) / width_i: how cold it is
    + (growing_i . Up) (B - T) ln(1 + exp(c))
    + gravity_i . Up
    + warm_up_i exp(-t / tau_i)                             t: time since power-on
    + hysteresis_i (play_i(T) - T)

Nothing is extrapolated: T is held between the fitted temperatures wherever it stands, dT/dt and
B - T between the limits of what was fitted. Up and the exponential are bounded by themselves.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterable
from dataclasses import dataclass, field, fields
from types import MappingProxyType

import numpy as np

from gyrobench.bench.foundations.arrays import BoolArray, FloatArray
from gyrobench.bench.foundations.errors import MeasurementError

#: The terms beyond the polynomial, by the effect that each describes, and the coefficients of each.
TERMS = MappingProxyType(
    {
        "temperature_rate": "rate_dph_per_c_per_h",
        "thermal_gradient": "gradient_dph_per_k",
        "attitude_thermal": "saturating_dph_per_k",
        "attitude_thermal_growing": "growing_dph_per_k",
        "g_sensitivity": "gravity_dph_per_g",
        "warm_up": "warm_up_dph",
        "thermal_hysteresis": "hysteresis_dph_per_k",
    }
)

#: What must be above zero where a term is used, by the coefficients of the term.
_SCALES = {
    "rate_dph_per_c_per_h": "rate_limit_c_per_h",
    "saturating_dph_per_k": "onset_width_c",
    "growing_dph_per_k": "onset_width_c",
    "warm_up_dph": "warm_up_s",
    "hysteresis_dph_per_k": "half_width_k",
}
_ON_DIFFERENCE = ("gradient_dph_per_k", "saturating_dph_per_k", "growing_dph_per_k")
_VECTORS = ("saturating_dph_per_k", "growing_dph_per_k", "gravity_dph_per_g")


def _zeros() -> FloatArray:
    return np.zeros(3)


def _zero_vectors() -> FloatArray:
    return np.zeros((3, 3))


@dataclass(frozen=True, eq=False)
class Compensation:
    """Numbers of a compensation, by gyro (first dimension: x, y, z); see the module.

    Attributes
    ----------
    polynomial_dph : ndarray, shape (3, k)
        Coefficients from degree 0 up, T in degrees Celsius.
    low_c, high_c : ndarray, shape (3,)
        Lowest and highest T used.
    rate_dph_per_c_per_h, rate_limit_c_per_h : ndarray, shape (3,)
        Coefficient, and the highest rate, of either sign, used.
    gradient_dph_per_k : ndarray, shape (3,)
        Coefficient of B - T.
    difference_low_k, difference_high_k : ndarray, shape (3,)
        Lowest and highest B - T used.
    saturating_dph_per_k, growing_dph_per_k : ndarray, shape (3, 3)
        Vectors in body axes of each gyro: B - T and Up act the same at all temperatures below the
        onset, and the more the colder it is.
    onset_c, onset_width_c : ndarray, shape (3,)
        Temperature below which Up acts with B - T, and the width of the onset.
    gravity_dph_per_g : ndarray, shape (3, 3)
        Vector in body axes of each gyro.
    warm_up_dph, warm_up_s : ndarray, shape (3,)
        What there is at power-on, and its time constant.
    hysteresis_dph_per_k, half_width_k : ndarray, shape (3,)
        Coefficient of what the play is off T, and its half width.

    Raises
    ------
    MeasurementError
        A number is not finite, an array has another shape, limits are in the wrong order, or a
        term that is used has no width, time constant or limits.
    """

    polynomial_dph: FloatArray
    low_c: FloatArray
    high_c: FloatArray
    rate_dph_per_c_per_h: FloatArray = field(default_factory=_zeros)
    rate_limit_c_per_h: FloatArray = field(default_factory=_zeros)
    gradient_dph_per_k: FloatArray = field(default_factory=_zeros)
    difference_low_k: FloatArray = field(default_factory=_zeros)
    difference_high_k: FloatArray = field(default_factory=_zeros)
    saturating_dph_per_k: FloatArray = field(default_factory=_zero_vectors)
    growing_dph_per_k: FloatArray = field(default_factory=_zero_vectors)
    onset_c: FloatArray = field(default_factory=_zeros)
    onset_width_c: FloatArray = field(default_factory=_zeros)
    gravity_dph_per_g: FloatArray = field(default_factory=_zero_vectors)
    warm_up_dph: FloatArray = field(default_factory=_zeros)
    warm_up_s: FloatArray = field(default_factory=_zeros)
    hysteresis_dph_per_k: FloatArray = field(default_factory=_zeros)
    half_width_k: FloatArray = field(default_factory=_zeros)

    def __post_init__(self) -> None:
        for each in fields(self):
            self._check_array(each.name)
        for low, high in (("low_c", "high_c"), ("difference_low_k", "difference_high_k")):
            if (getattr(self, low) > getattr(self, high)).any():
                raise MeasurementError(f"compensation: {low} must not be above {high}")
        for name, scale in _SCALES.items():
            if (_used(getattr(self, name)) & (getattr(self, scale) <= 0.0)).any():
                raise MeasurementError(f"compensation: {name} needs {scale} above zero")
        no_range = self.difference_low_k == self.difference_high_k
        for name in _ON_DIFFERENCE:
            if (_used(getattr(self, name)) & no_range).any():
                raise MeasurementError(f"compensation: {name} needs difference_low_k below difference_high_k")

    def terms(self) -> tuple[str, ...]:
        """Names of the :data:`TERMS` that are used."""
        return tuple(term for term, name in TERMS.items() if np.any(getattr(self, name)))

    def _check_array(self, name: str) -> None:
        value = getattr(self, name)
        shape: tuple[int, ...] = (3, 3) if name in _VECTORS else (3,)
        if name == "polynomial_dph":
            shape = (3, value.shape[-1])
        if value.shape != shape or not value.size:
            raise MeasurementError(f"compensation: {name} has the shape {value.shape}, not {shape}")
        if not np.isfinite(value).all():
            raise MeasurementError(f"compensation: {name} must hold finite numbers; found {value.tolist()}")


def checksum(numbers: Iterable[float]) -> int:
    """CRC-32 of numbers as the INS holds them: little-endian 32-bit floats."""
    return zlib.crc32(b"".join(struct.pack("<f", number) for number in numbers))


def _used(coefficients: FloatArray) -> BoolArray:
    return np.asarray(np.any(coefficients.reshape(3, -1) != 0.0, axis=1))
