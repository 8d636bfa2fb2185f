"""What the INS subtracts from its gyros: a polynomial in temperature, and physical terms.

With the temperature T of a gyro's optics, B of its electronics (board), and the unit vector Up in body
axes, the bias of gyro i is::

    polynomial_i(T)
    + rate_i dT/dt
    + gradient_i (B - T)
    + (saturating_i . Up) (B - T) / (1 + exp(-c))           c = (onset_i - T) / width_i
    + (growing_i . Up) (B - T) ln(1 + exp(c))
    + gravity_i . Up
    + warm_up_i exp(-t / tau_i)                             t: time since power-on
    + hysteresis_i (play_i(T) - T)

Any other coefficient of gyro and accelerometer i is::

    polynomial(T) + rate dT/dt + gravity . Up

Nothing is extrapolated: T, dT/dt and B - T are clipped to the fitted ranges. Other coefficients may have been
measured over fewer temperatures than the biases, and clip T to separate limits.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, fields
from types import MappingProxyType

import numpy as np

from gyrobench.bench.foundations.arrays import BoolArray, FloatArray
from gyrobench.bench.foundations.errors import MeasurementError

#: Terms beyond the polynomial: name of the effect, and name of its coefficients.
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

#: Scale that must be above zero where a term is used, by the coefficients of the term.
_SCALES = {
    "rate_dph_per_c_per_h": "rate_limit_c_per_h",
    "saturating_dph_per_k": "onset_width_c",
    "growing_dph_per_k": "onset_width_c",
    "warm_up_dph": "warm_up_s",
    "hysteresis_dph_per_k": "half_width_k",
}
_ON_DIFFERENCE = ("gradient_dph_per_k", "saturating_dph_per_k", "growing_dph_per_k")
_VECTORS = ("saturating_dph_per_k", "growing_dph_per_k", "gravity_dph_per_g")


#: Highest degree of the polynomials of :class:`Correction`, and their numbers in an INS.
CORRECTION_DEGREE = 3
CORRECTION_NUMBERS = CORRECTION_DEGREE + 5
#: Temperatures of the dwells of one plateau may be this far from their mean, K.
_NEARLY_K = 5.0


def _zeros() -> FloatArray:
    return np.zeros(3)


def _zero_vectors() -> FloatArray:
    return np.zeros((3, 3))


@dataclass(frozen=True, eq=False)
class Correction:
    """What an INS takes as one coefficient, in the unit of its kind: ppm, arcsec or ug.

    Raises MeasurementError if a number is not finite, or there are too many or too few.
    """

    polynomial: FloatArray  #: Shape (k,), k at most 4. From degree 0 up, T in degC.
    rate_per_c_per_h: float = 0.0  #: Per dT/dt.
    gravity_per_g: FloatArray = field(default_factory=_zeros)  #: Shape (3,). Vector in body axes.
    #: Lowest and highest T at which it was measured, within those of the gyro's bias; None for those.
    range_c: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        if self.range_c is not None:
            low_c, high_c = self.range_c
            if not -np.inf < low_c <= high_c < np.inf:
                raise MeasurementError("compensation: low_c of a coefficient must not be above its high_c")
        is_shaped = 1 <= self.polynomial.size <= CORRECTION_DEGREE + 1 and self.gravity_per_g.shape == (3,)
        if not is_shaped or not np.isfinite(self.numbers()).all():
            raise MeasurementError(
                f"compensation: a coefficient takes finite numbers, 1 to {CORRECTION_DEGREE + 1} of the "
                "polynomial and 3 along gravity"
            )

    def exceeds(self, low_c: float, high_c: float) -> bool:
        """Whether the range from ``low_c`` to ``high_c`` goes clearly beyond that of a curve over T."""
        if self.range_c is None or not self.polynomial[1:].any():
            return False
        return low_c < self.range_c[0] - _NEARLY_K or high_c > self.range_c[1] + _NEARLY_K

    def numbers(self) -> FloatArray:
        """All numbers (8,) but the range in the order of an INS: polynomial, rate, gravity along x, y, z."""
        polynomial = np.pad(self.polynomial, (0, CORRECTION_DEGREE + 1 - self.polynomial.size))
        return np.concatenate([polynomial, [self.rate_per_c_per_h], self.gravity_per_g])


@dataclass(frozen=True, eq=False)
class Compensation:
    """Numbers of a compensation, by gyro (first dimension: x, y, z), in the formula of this module.

    Raises MeasurementError if a number is not finite, an array has another shape, limits are in the wrong
    order, or a term that is used has no width, time constant or limits.
    """

    polynomial_dph: FloatArray  #: Shape (3, k). Coefficients from degree 0 up, T in degrees Celsius.
    #: low_c, high_c: Shape (3,). Range of T.
    low_c: FloatArray
    high_c: FloatArray
    #: rate_dph_per_c_per_h, rate_limit_c_per_h: Shape (3,). Coefficient of dT/dt, and the largest absolute
    #: dT/dt.
    rate_dph_per_c_per_h: FloatArray = field(default_factory=_zeros)
    rate_limit_c_per_h: FloatArray = field(default_factory=_zeros)
    gradient_dph_per_k: FloatArray = field(default_factory=_zeros)  #: Shape (3,). Coefficient of B - T.
    #: difference_low_k, difference_high_k: Shape (3,). Range of B - T.
    difference_low_k: FloatArray = field(default_factory=_zeros)
    difference_high_k: FloatArray = field(default_factory=_zeros)
    #: saturating_dph_per_k, growing_dph_per_k: Shape (3, 3). Vectors in body axes of each gyro: constant
    #: below the onset, and growing with falling T.
    saturating_dph_per_k: FloatArray = field(default_factory=_zero_vectors)
    growing_dph_per_k: FloatArray = field(default_factory=_zero_vectors)
    #: onset_c, onset_width_c: Shape (3,). Temperature below which Up acts with B - T, and the width of the
    #: onset.
    onset_c: FloatArray = field(default_factory=_zeros)
    onset_width_c: FloatArray = field(default_factory=_zeros)
    #: Shape (3, 3). Vector in body axes of each gyro.
    gravity_dph_per_g: FloatArray = field(default_factory=_zero_vectors)
    #: warm_up_dph, warm_up_s: Shape (3,). Value at power-on, and time constant.
    warm_up_dph: FloatArray = field(default_factory=_zeros)
    warm_up_s: FloatArray = field(default_factory=_zeros)
    #: hysteresis_dph_per_k, half_width_k: Shape (3,). Coefficient of the play's distance from T, and its half
    #: width.
    hysteresis_dph_per_k: FloatArray = field(default_factory=_zeros)
    half_width_k: FloatArray = field(default_factory=_zeros)
    #: Standard uncertainties of the numbers by name, in the shapes of these; those of a gyro are
    #: correlated. An INS does not get them.
    sigma: Mapping[str, FloatArray] = field(default_factory=dict)
    #: Other coefficients by name: ``gyro_scale_factor_x``, ``gyro_misalignment_xy``,
    #: ``accelerometer_bias_x``, ``accelerometer_scale_factor_x``, ``accelerometer_misalignment_yx``. T and
    #: dT/dt are those of the gyro along the sensor's axis, and clipped as for its bias; T also to the
    #: coefficient's ``range_c``.
    coefficients: Mapping[str, Correction] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name in NUMBERS:
            self._check_array(name, getattr(self, name))
        for name, value in self.sigma.items():
            self._check_array(name, value, "sigma of ")
            if value.shape != getattr(self, name).shape or (value < 0.0).any():
                raise MeasurementError(
                    f"compensation: sigma of {name} must have as many numbers as {name}, none below zero"
                )
        for low, high in (("low_c", "high_c"), ("difference_low_k", "difference_high_k")):
            if (getattr(self, low) > getattr(self, high)).any():
                raise MeasurementError(f"compensation: {low} must not be above {high}")
        for name, scale in _SCALES.items():
            if (_used(getattr(self, name)) & (getattr(self, scale) <= 0.0)).any():
                raise MeasurementError(f"compensation: {name} needs {scale} above zero")
        for name, each in self.coefficients.items():
            axis = correction_place(name)[1]
            if each.rate_per_c_per_h and not self.rate_limit_c_per_h[axis] > 0.0:
                raise MeasurementError(
                    f"compensation: the rate of {name} needs rate_limit_c_per_h above zero"
                )
        no_range = self.difference_low_k == self.difference_high_k
        for name in _ON_DIFFERENCE:
            if (_used(getattr(self, name)) & no_range).any():
                raise MeasurementError(f"compensation: {name} needs difference_low_k below difference_high_k")

    def terms(self) -> tuple[str, ...]:
        """Names of the :data:`TERMS` that are used, and of the other coefficients."""
        used = (term for term, name in TERMS.items() if np.any(getattr(self, name)))
        return (*used, *self.corrected())

    def corrected(self) -> tuple[str, ...]:
        """Names of the other coefficients that are not zero."""
        return tuple(name for name, each in self.coefficients.items() if each.numbers().any())

    def is_like(self, other: Compensation) -> bool:
        """Whether an INS gets the same numbers."""
        names = self.corrected()
        return (
            all(np.array_equal(getattr(self, name), getattr(other, name)) for name in NUMBERS)
            and set(names) == set(other.corrected())
            and all(
                np.array_equal(self.coefficients[name].numbers(), other.coefficients[name].numbers())
                and self.coefficients[name].range_c == other.coefficients[name].range_c
                for name in names
            )
        )

    def _check_array(self, name: str, value: FloatArray, of: str = "") -> None:
        shape: tuple[int, ...] = (3, 3) if name in _VECTORS else (3,)
        if name == "polynomial_dph":
            shape = (3, value.shape[-1])
        if value.shape != shape or not value.size:
            raise MeasurementError(f"compensation: {of}{name} has the shape {value.shape}, not {shape}")
        if not np.isfinite(value).all():
            raise MeasurementError(
                f"compensation: {of}{name} must hold finite numbers; found {value.tolist()}"
            )


#: Names of the numbers of a compensation.
NUMBERS = tuple(each.name for each in fields(Compensation) if each.name not in {"sigma", "coefficients"})
_SENSORS = {
    "gyro": ("scale_factor", "misalignment"),
    "accelerometer": ("bias", "scale_factor", "misalignment"),
}


def correction_place(name: str) -> tuple[str, int, int | None]:
    """Sensor, its axis (0 for x), and the axis that a coefficient makes it sense; None for a bias.

    Raises MeasurementError if the name is not that of a coefficient.
    """
    sensor, _, rest = name.partition("_")
    kind, _, axes = rest.rpartition("_")
    places = ["xyz".find(axis) for axis in axes]
    is_pair = kind == "misalignment"
    if (
        kind not in _SENSORS.get(sensor, ())
        or -1 in places
        or len(places) != 1 + is_pair
        or (is_pair and places[0] == places[1])
    ):
        raise MeasurementError(f"compensation: {name} is not a coefficient")
    return sensor, places[0], None if kind == "bias" else places[-1]


def checksum(numbers: Iterable[float]) -> int:
    """CRC-32 of numbers as the INS stores them: little-endian 32-bit floats."""
    return zlib.crc32(b"".join(struct.pack("<f", number) for number in numbers))


def _used(coefficients: FloatArray) -> BoolArray:
    return np.asarray(np.any(coefficients.reshape(3, -1) != 0.0, axis=1))
