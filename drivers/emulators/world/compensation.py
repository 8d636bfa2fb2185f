"""How the INS compensates its gyros: from its own sensors, by a table of numbers that is loaded.

What is subtracted from gyro i, with its optics at T, its electronics at B and Up in body axes::

    polynomial(T) + rate dT/dt + gradient (B - T)
    + ((saturating . Up) / (1 + exp(-c)) + (growing . Up) ln(1 + exp(c))) (B - T),  c = (onset - T) / width
    + gravity . Up + warm_up exp(-t / tau) + hysteresis (play(T) - T)

with T, B - T and dT/dt held between the limits in the table. ``play`` is what follows T with
a slack of the half width on either side, from the temperature at power-on.
"""

from __future__ import annotations

import math
import zlib
from enum import IntEnum

import numba
import numpy as np

from gyrobench.bench.foundations.arrays import FloatArray


class Number(IntEnum):
    """Where a number stands in a gyro's row; vectors and the polynomial take several places."""

    POLYNOMIAL = 0
    LOW_C = 6
    HIGH_C = 7
    RATE = 8
    RATE_LIMIT = 9
    GRADIENT = 10
    DIFFERENCE_LOW = 11
    DIFFERENCE_HIGH = 12
    SATURATING = 13
    GROWING = 16
    ONSET_C = 19
    ONSET_WIDTH = 20
    GRAVITY = 21
    WARM_UP = 24
    WARM_UP_TIME = 25
    HYSTERESIS = 26
    HALF_WIDTH = 27


#: Numbers for each gyro.
NUMBERS = 28
#: What the table holds before anything is loaded: nothing is subtracted.
_UNLOADED = {Number.LOW_C: -100.0, Number.HIGH_C: 150.0}

_LAST_COEFFICIENT = 5
#: Most that a compensation can subtract, deg/h.
_LIMIT_DPH = 3600.0
_LEAST_WIDTH_C, _LEAST_TIME_S = 1e-3, 1.0
_RECORD_EVERY_S = 10
#: Time constant of each of the two filters that the rate of temperature comes from.
_FILTER_S = 120.0


def unloaded_numbers() -> FloatArray:
    """A table (3, 28) that subtracts nothing."""
    numbers = np.zeros((3, NUMBERS))
    for number, value in _UNLOADED.items():
        numbers[:, number] = value
    return numbers


def checksum(numbers: FloatArray) -> int:
    """CRC-32 of a table as little-endian 32-bit floats, gyro by gyro."""
    return zlib.crc32(numbers.astype("<f4").tobytes())


class ThermalSense:
    """What the INS has sensed of its gyros' temperatures since it was switched on.

    Attributes
    ----------
    optics_c, electronics_c : ndarray, shape (3,)
        The last readings.
    record_c : list of ndarray, each of shape (3,)
        Optics every ten seconds.
    seconds : int
        Readings since power-on, one a second.
    """

    def __init__(self) -> None:
        self.optics_c = np.zeros(3)
        self.electronics_c = np.zeros(3)
        self.record_c: list[FloatArray] = []
        self.seconds = 0
        self._filtered_c = np.zeros((2, 3))

    def read(self, optics_c: FloatArray, electronics_c: FloatArray) -> None:
        """Take the readings of one more second."""
        self.optics_c, self.electronics_c = optics_c, electronics_c
        if self.seconds == 0:
            self._filtered_c[:] = optics_c
        if self.seconds % _RECORD_EVERY_S == 0:
            self.record_c.append(optics_c)
        self.seconds += 1
        _filter(self._filtered_c, optics_c)

    @property
    def rate_c_per_h(self) -> FloatArray:
        """Rate of each gyro's optics, some minutes late, shape (3,)."""
        return np.asarray((self._filtered_c[0] - self._filtered_c[1]) * (3600.0 / _FILTER_S))


class Compensation:
    """A table in use.

    Parameters
    ----------
    numbers : ndarray, shape (3, 28)
        One row for each gyro; :class:`Number` says what stands where.
    sense : ThermalSense
        Temperatures since power-on: the record lets the play begin there.

    Attributes
    ----------
    bias_dph : ndarray, shape (3,)
        What is subtracted from each gyro at present.
    checksum : int
        Of the table.
    """

    def __init__(self, numbers: FloatArray, sense: ThermalSense, up_body: FloatArray) -> None:
        self.checksum = checksum(numbers)
        self._numbers = numbers.copy()
        first_c = sense.record_c[0] if sense.record_c else sense.optics_c
        self._play_c = np.clip(first_c, numbers[:, Number.LOW_C], numbers[:, Number.HIGH_C])
        for optics_c in sense.record_c:
            _follow(self._play_c, optics_c, self._numbers)
        self.update(sense, up_body)

    def update(self, sense: ThermalSense, up_body: FloatArray) -> None:
        """Work out what is subtracted from now on.

        Parameters
        ----------
        up_body : ndarray, shape (3,)
            Up in body axes as the INS knows it; zero while it does not.
        """
        _follow(self._play_c, sense.optics_c, self._numbers)
        self.bias_dph = _bias_dph(
            self._numbers, sense.optics_c, sense.electronics_c, sense.rate_c_per_h, up_body,
            float(sense.seconds), self._play_c,
        )  # fmt: skip


@numba.njit(cache=True)
def _filter(filtered_c: FloatArray, optics_c: FloatArray) -> None:
    for i in range(3):
        filtered_c[1, i] += (filtered_c[0, i] - filtered_c[1, i]) / _FILTER_S
        filtered_c[0, i] += (optics_c[i] - filtered_c[0, i]) / _FILTER_S


@numba.njit(cache=True)
def _held(value: float, low: float, high: float) -> float:
    return min(max(value, low), high)


@numba.njit(cache=True)
def _follow(play_c: FloatArray, optics_c: FloatArray, numbers: FloatArray) -> None:
    for i in range(3):
        row = numbers[i]
        at_c, slack_c = _held(optics_c[i], row[Number.LOW_C], row[Number.HIGH_C]), abs(row[Number.HALF_WIDTH])
        play_c[i] = _held(play_c[i], at_c - slack_c, at_c + slack_c)


@numba.njit(cache=True)
def _bias_dph(
    numbers: FloatArray, optics_c: FloatArray, electronics_c: FloatArray, rate_c_per_h: FloatArray,
    up_body: FloatArray,
    on_s: float, play_c: FloatArray,
) -> FloatArray:  # fmt: skip
    bias = np.zeros(3)
    for i in range(3):
        row = numbers[i]
        at_c = _held(optics_c[i], row[Number.LOW_C], row[Number.HIGH_C])
        rate = _held(rate_c_per_h[i], -abs(row[Number.RATE_LIMIT]), abs(row[Number.RATE_LIMIT]))
        hotter_k = _held(
            electronics_c[i] - optics_c[i], row[Number.DIFFERENCE_LOW], row[Number.DIFFERENCE_HIGH]
        )
        cold = _held(
            (row[Number.ONSET_C] - at_c) / max(row[Number.ONSET_WIDTH], _LEAST_WIDTH_C), -500.0, 500.0
        )
        saturated, grown = 1.0 / (1.0 + math.exp(-cold)), math.log1p(math.exp(cold))
        attitude = gravity = polynomial = 0.0
        for axis in range(3):
            attitude += row[Number.SATURATING + axis] * saturated * up_body[axis]
            attitude += row[Number.GROWING + axis] * grown * up_body[axis]
            gravity += row[Number.GRAVITY + axis] * up_body[axis]
        for degree in range(_LAST_COEFFICIENT, -1, -1):
            polynomial = polynomial * at_c + row[Number.POLYNOMIAL + degree]
        warm_up = row[Number.WARM_UP] * math.exp(-on_s / max(row[Number.WARM_UP_TIME], _LEAST_TIME_S))
        total = (
            polynomial
            + row[Number.RATE] * rate
            + (row[Number.GRADIENT] + attitude) * hotter_k
            + gravity
            + warm_up
            + row[Number.HYSTERESIS] * (play_c[i] - at_c)
        )
        bias[i] = _held(total, -_LIMIT_DPH, _LIMIT_DPH)
    return bias
