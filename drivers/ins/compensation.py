"""Compensation that the INS subtracts from its gyros: a polynomial in temperature, and physical terms.

With the temperature T of a gyro's optics, B of its electronics (board), and the unit vector Up in body
axes, the bias of gyro i is::

    polynomial_i(T)
    + rate_i dT/dt
    + gradient_i (B - T)
    + (saturating_i . Up) (B - T) / (1 + exp(-c))           c = (onset_i - T) / width_i
    + (growing_i . Up) (B - T) ln(1 + exp(c))
    + gravity_i . Up
    + warm_up_i exp(-t / tau_i)                             t: time since power-on
    + hysteresis_i (play_i(T) - T)                      play_i: play operator of half width half_width_i

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

#: Scale that must be above zero if a term is used, by the name of the term's coefficients.
_SCALES = {
    "rate_dph_per_c_per_h": "rate_limit_c_per_h",
    "saturating_dph_per_k": "onset_width_c",
    "growing_dph_per_k": "onset_width_c",
    "warm_up_dph": "warm_up_s",
    "hysteresis_dph_per_k": "half_width_k",
}
_DIFFERENCE_TERMS = ("gradient_dph_per_k", "saturating_dph_per_k", "growing_dph_per_k")
_VECTOR_TERMS = ("saturating_dph_per_k", "growing_dph_per_k", "gravity_dph_per_g")


#: Highest degree of the polynomial of a :class:`Correction`, and how many numbers an INS stores for one.
CORRECTION_DEGREE = 3
CORRECTION_SIZE = CORRECTION_DEGREE + 5
#: Largest distance of a dwell's temperature from the mean of its plateau, K.
_PLATEAU_HALF_WIDTH_K = 5.0


def _zeros() -> FloatArray:
    return np.zeros(3)


def _zero_vectors() -> FloatArray:
    return np.zeros((3, 3))


@dataclass(frozen=True, eq=False)
class Correction:
    """One other coefficient of a sensor as a function of temperature, in its unit: ppm, arcsec or ug.

    Raises MeasurementError if a number is not finite, or there are too many or too few.
    """

    polynomial: FloatArray  #: Shape (k,), k at most 4. Coefficients from degree 0 up, T in degC.
    rate_per_c_per_h: float = 0.0  #: Coefficient of dT/dt.
    gravity_per_g: FloatArray = field(default_factory=_zeros)  #: Shape (3,). Vector in body axes.
    #: Lowest and highest T at which it was measured, within that of the gyro's bias; None for that range.
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
        """Whether ``low_c`` to ``high_c`` goes clearly beyond ``range_c``; False if constant over T."""
        if self.range_c is None or not self.polynomial[1:].any():
            return False
        return (
            low_c < self.range_c[0] - _PLATEAU_HALF_WIDTH_K
            or high_c > self.range_c[1] + _PLATEAU_HALF_WIDTH_K
        )

    def numbers(self) -> FloatArray:
        """Numbers (8,) in the order of an INS: polynomial, rate, gravity along x, y, z; without the range."""
        polynomial = np.pad(self.polynomial, (0, CORRECTION_DEGREE + 1 - self.polynomial.size))
        return np.concatenate([polynomial, [self.rate_per_c_per_h], self.gravity_per_g])


@dataclass(frozen=True, eq=False)
class Compensation:
    """Parameters of the formula above; the first dimension of each array is the gyro: x, y, z.

    Raises MeasurementError if a number is not finite, an array has the wrong shape, limits are in the wrong
    order, or a term is used without its width, time constant or limits.
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
    #: saturating_dph_per_k, growing_dph_per_k: Shape (3, 3). For each gyro a vector in body axes: of the term
    #: that is constant below the onset, and of the one that grows with falling T.
    saturating_dph_per_k: FloatArray = field(default_factory=_zero_vectors)
    growing_dph_per_k: FloatArray = field(default_factory=_zero_vectors)
    #: onset_c, onset_width_c: Shape (3,). Temperature below which the terms in (Up, B - T) act, and the
    #: width of the transition.
    onset_c: FloatArray = field(default_factory=_zeros)
    onset_width_c: FloatArray = field(default_factory=_zeros)
    #: Shape (3, 3). For each gyro a vector in body axes.
    gravity_dph_per_g: FloatArray = field(default_factory=_zero_vectors)
    #: warm_up_dph, warm_up_s: Shape (3,). Value at power-on, and time constant.
    warm_up_dph: FloatArray = field(default_factory=_zeros)
    warm_up_s: FloatArray = field(default_factory=_zeros)
    #: hysteresis_dph_per_k, half_width_k: Shape (3,). Coefficient of play(T) - T, and half width of the play.
    hysteresis_dph_per_k: FloatArray = field(default_factory=_zeros)
    half_width_k: FloatArray = field(default_factory=_zeros)
    #: Standard uncertainties by parameter name, in the shapes of the parameters; those of one gyro are
    #: correlated. They are not sent to an INS.
    sigma: Mapping[str, FloatArray] = field(default_factory=dict)
    #: Other coefficients by name: ``gyro_scale_factor_x``, ``gyro_misalignment_xy``,
    #: ``accelerometer_bias_x``, ``accelerometer_scale_factor_x``, ``accelerometer_misalignment_yx``. T and
    #: dT/dt are those of the gyro along the sensor's axis and clipped as for its bias; T is also clipped to
    #: the coefficient's ``range_c``.
    coefficients: Mapping[str, Correction] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name in PARAMETER_NAMES:
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
            if (_nonzero_gyros(getattr(self, name)) & (getattr(self, scale) <= 0.0)).any():
                raise MeasurementError(f"compensation: {name} needs {scale} above zero")
        for name, each in self.coefficients.items():
            axis = correction_axes(name)[1]
            if each.rate_per_c_per_h and not self.rate_limit_c_per_h[axis] > 0.0:
                raise MeasurementError(
                    f"compensation: the rate of {name} needs rate_limit_c_per_h above zero"
                )
        has_no_range = self.difference_low_k == self.difference_high_k
        for name in _DIFFERENCE_TERMS:
            if (_nonzero_gyros(getattr(self, name)) & has_no_range).any():
                raise MeasurementError(f"compensation: {name} needs difference_low_k below difference_high_k")

    def terms(self) -> tuple[str, ...]:
        """Names of the :data:`TERMS` and of the other coefficients that are not zero."""
        used = (term for term, name in TERMS.items() if np.any(getattr(self, name)))
        return (*used, *self.corrections_in_use())

    def corrections_in_use(self) -> tuple[str, ...]:
        """Names of the other coefficients that are not zero."""
        return tuple(name for name, each in self.coefficients.items() if each.numbers().any())

    def is_equivalent_to(self, other: Compensation) -> bool:
        """Whether an INS would get the same numbers from both."""
        names = self.corrections_in_use()
        return (
            all(np.array_equal(getattr(self, name), getattr(other, name)) for name in PARAMETER_NAMES)
            and set(names) == set(other.corrections_in_use())
            and all(
                np.array_equal(self.coefficients[name].numbers(), other.coefficients[name].numbers())
                and self.coefficients[name].range_c == other.coefficients[name].range_c
                for name in names
            )
        )

    def _check_array(self, name: str, value: FloatArray, prefix: str = "") -> None:
        shape: tuple[int, ...] = (3, 3) if name in _VECTOR_TERMS else (3,)
        if name == "polynomial_dph":
            shape = (3, value.shape[-1])
        if value.shape != shape or not value.size:
            raise MeasurementError(f"compensation: {prefix}{name} has the shape {value.shape}, not {shape}")
        if not np.isfinite(value).all():
            raise MeasurementError(
                f"compensation: {prefix}{name} must hold finite numbers; found {value.tolist()}"
            )


#: Names of the arrays of :class:`Compensation`.
PARAMETER_NAMES = tuple(
    each.name for each in fields(Compensation) if each.name not in {"sigma", "coefficients"}
)
_SENSORS = {
    "gyro": ("scale_factor", "misalignment"),
    "accelerometer": ("bias", "scale_factor", "misalignment"),
}


def correction_axes(name: str) -> tuple[str, int, int | None]:
    """Sensor of a coefficient, the sensor's axis (0 for x), and the sensed axis; that is None for a bias.

    Raises MeasurementError if there is no coefficient of that name.
    """
    sensor, _, kind_and_axes = name.partition("_")
    kind, _, axes = kind_and_axes.rpartition("_")
    axis_indices = ["xyz".find(axis) for axis in axes]
    is_pair = kind == "misalignment"
    if (
        kind not in _SENSORS.get(sensor, ())
        or -1 in axis_indices
        or len(axis_indices) != 1 + is_pair
        or (is_pair and axis_indices[0] == axis_indices[1])
    ):
        raise MeasurementError(f"compensation: {name} is not a coefficient")
    return sensor, axis_indices[0], None if kind == "bias" else axis_indices[-1]


def checksum(numbers: Iterable[float]) -> int:
    """Compute the CRC-32 of numbers as the INS stores them: little-endian 32-bit floats."""
    return zlib.crc32(b"".join(struct.pack("<f", number) for number in numbers))


def _nonzero_gyros(coefficients: FloatArray) -> BoolArray:
    return np.asarray(np.any(coefficients.reshape(3, -1) != 0.0, axis=1))
