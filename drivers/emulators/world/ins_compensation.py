"""Gyro compensation inside the INS: a loaded table of coefficients, evaluated on the INS's own sensors.

Bias subtracted from gyro i, with its optics at T, its electronics at B and Up in body axes::

    polynomial(T) + rate dT/dt + gradient (B - T)
    + ((saturating . Up) / (1 + exp(-c)) + (growing . Up) ln(1 + exp(c))) (B - T),  c = (onset - T) / width
    + gravity . Up + warm_up exp(-t / tau) + hysteresis (play(T) - T)

After the biases the errors of the other coefficients are taken out: those of the gyros' matrix, of the
accelerometers' biases and matrix, each ``polynomial(T) + rate dT/dt + gravity . Up`` with T and dT/dt of the
gyro along the sensor's axis. T, B - T and dT/dt are clamped to the limits in the table, T for each of these
to separate limits where they are not both zero. ``play`` follows T
with a slack of the half width on either side, from the temperature at power-on.
"""

from __future__ import annotations

import math
import zlib
from array import array
from enum import IntEnum

import numpy as np

from gyrobench.bench.foundations.arrays import FloatArray
from gyrobench.bench.foundations.kernels import compiled


class Slot(IntEnum):
    """Slot of a coefficient in a gyro's row; vectors and the polynomial take several places."""

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
    GYRO_MATRIX = 28
    FORCE_BIAS = 52
    FORCE_MATRIX = 60
    LIMITS = 84


#: Number of coefficients of each gyro and accelerometer; of these for the gyro's bias.
COEFFICIENT_COUNT, _OF_BIAS = 98, 28
#: Numbers of each coefficient beyond the gyros' biases, and those of its polynomial.
_EACH, _DEGREES = 8, 4
_PPM, _ARCSEC, _MICRO_G = 1e-6, math.radians(1.0) / 3600.0, 9.80665e-6

_LAST_COEFFICIENT = 5
#: Bound of the subtracted bias, deg/h.
_MAX_BIAS_DPH = 3600.0
_MIN_WIDTH_C, _MIN_TIME_S = 1e-3, 1.0
_RECORD_EVERY_S = 10
#: Time constant of each of the two filters behind the rate of temperature.
_FILTER_S = 120.0


def empty_table() -> FloatArray:
    """A table (3, 98) that subtracts nothing."""
    table = np.zeros((3, COEFFICIENT_COUNT))
    table[:, Slot.LOW_C] = -100.0
    table[:, Slot.HIGH_C] = 150.0
    return table


def table_checksum(table: FloatArray) -> int:
    """CRC-32 of a table as little-endian 32-bit floats, by axis; without a last part that is all 0.

    The parts are the biases, the other coefficients, and their separate limits.
    """
    for end in (_OF_BIAS, Slot.LIMITS):
        if not table[:, end:].any():
            table = table[:, :end]
            break
    return zlib.crc32(table.astype("<f4").tobytes())


class TemperatureHistory:
    """The INS's readings of its gyros' temperatures since power-on."""

    def __init__(self) -> None:
        #: optics_c, electronics_c: Shape (3,). The last readings, one a second.
        self.optics_c = np.zeros(3)
        self.electronics_c = np.zeros(3)
        self._record_c = array("d")
        self.seconds = 0
        self._filtered_c = np.zeros((2, 3))

    def read(self, optics_c: FloatArray, electronics_c: FloatArray) -> None:
        """Add the readings of the next n seconds, each of shape (n, 3)."""
        self.optics_c, self.electronics_c = optics_c[-1], electronics_c[-1]
        if self.seconds == 0:
            self._filtered_c[:] = optics_c[0]
        self._record_c.frombytes(optics_c[-self.seconds % _RECORD_EVERY_S :: _RECORD_EVERY_S].tobytes())
        self.seconds += len(optics_c)
        _filter(self._filtered_c, optics_c)

    @property
    def record_c(self) -> FloatArray:
        """Optics every ten seconds, shape (n, 3)."""
        return np.array(self._record_c).reshape(-1, 3)

    @property
    def rate_c_per_h(self) -> FloatArray:
        """Rate of each gyro's optics, some minutes late, shape (3,)."""
        return np.asarray((self._filtered_c[0] - self._filtered_c[1]) * (3600.0 / _FILTER_S))


class InsCompensation:
    """An applied table.

    Parameters
    ----------
    table : ndarray, shape (3, 98)
        One row for each axis, laid out by :class:`Slot`.
    history : TemperatureHistory
        Readings since power-on; the play starts there.

    Attributes
    ----------
    bias_dph : ndarray, shape (3,)
        Bias subtracted from each gyro at present.
    """

    def __init__(self, table: FloatArray, history: TemperatureHistory, up_body: FloatArray) -> None:
        self.checksum = table_checksum(table)  #: Checksum of the table.
        self._table = table.copy()
        self._others: FloatArray | None = None
        record_c = history.record_c
        first_c = record_c[0] if len(record_c) else history.optics_c
        self._play_c = np.clip(first_c, table[:, Slot.LOW_C], table[:, Slot.HIGH_C])
        for optics_c in record_c:
            _follow(self._play_c, optics_c, self._table)
        self.update(history, up_body)

    def update(self, history: TemperatureHistory, up_body: FloatArray) -> None:
        """Update the subtracted bias.

        ``up_body`` (3,) is Up in body axes as estimated by the INS; zero before alignment.
        """
        _follow(self._play_c, history.optics_c, self._table)
        self.bias_dph = _bias_dph(
            self._table, history.optics_c, history.electronics_c, history.rate_c_per_h, up_body,
            float(history.seconds), self._play_c,
        )  # fmt: skip
        if self._table[:, _OF_BIAS:].any():
            numbers = self._table[:, _OF_BIAS : Slot.LIMITS].reshape(3, -1, _EACH)
            self._others = (numbers * self._inputs(history, up_body)).sum(axis=2)

    def _inputs(self, history: TemperatureHistory, up_body: FloatArray) -> FloatArray:
        """What the eight numbers of each coefficient are multiplied by, shape (3, 7, 8)."""
        low_c, high_c, limit = self._table[:, [Slot.LOW_C, Slot.HIGH_C, Slot.RATE_LIMIT]].T
        at_c = np.clip(history.optics_c, low_c, high_c)[:, np.newaxis]
        limits_c = self._table[:, Slot.LIMITS :].reshape(3, -1, 2)
        at_c = np.where(limits_c.any(axis=2), np.clip(at_c, limits_c[..., 0], limits_c[..., 1]), at_c)
        inputs = np.empty((*at_c.shape, _EACH))
        inputs[..., :_DEGREES] = at_c[..., np.newaxis] ** np.arange(_DEGREES)
        inputs[..., _DEGREES] = np.clip(history.rate_c_per_h, -np.abs(limit), np.abs(limit))[:, np.newaxis]
        inputs[..., _DEGREES + 1 :] = up_body
        return inputs

    def corrected(
        self, rotation: FloatArray, velocity: FloatArray, interval_s: float
    ) -> tuple[FloatArray, FloatArray]:
        """Increments (n, 3) without the errors beyond the gyros' biases, rad and m/s."""
        if self._others is None:
            return rotation, velocity
        units = np.where(np.eye(3, dtype=bool), _PPM, _ARCSEC)
        gyro, bias, force = self._others[:, :3] * units, self._others[:, 3], self._others[:, 4:] * units
        return (
            np.ascontiguousarray(np.linalg.solve(np.eye(3) + gyro, rotation.T).T),
            np.ascontiguousarray(
                np.linalg.solve(np.eye(3) + force, (velocity - bias * (_MICRO_G * interval_s)).T).T
            ),
        )


@compiled
def _filter(filtered_c: FloatArray, optics_c: FloatArray) -> None:
    for k in range(optics_c.shape[0]):
        for i in range(3):
            filtered_c[1, i] += (filtered_c[0, i] - filtered_c[1, i]) / _FILTER_S
            filtered_c[0, i] += (optics_c[k, i] - filtered_c[0, i]) / _FILTER_S


@compiled
def _clamped(value: float, low: float, high: float) -> float:
    return min(max(value, low), high)


@compiled
def _follow(play_c: FloatArray, optics_c: FloatArray, table: FloatArray) -> None:
    for i in range(3):
        row = table[i]
        at_c, slack_c = (_clamped(optics_c[i], row[Slot.LOW_C], row[Slot.HIGH_C]), abs(row[Slot.HALF_WIDTH]))
        play_c[i] = _clamped(play_c[i], at_c - slack_c, at_c + slack_c)


@compiled
def _bias_dph(
    table: FloatArray, optics_c: FloatArray, electronics_c: FloatArray, rate_c_per_h: FloatArray,
    up_body: FloatArray, on_s: float, play_c: FloatArray,
) -> FloatArray:  # fmt: skip
    bias = np.zeros(3)
    for i in range(3):
        row = table[i]
        at_c = _clamped(optics_c[i], row[Slot.LOW_C], row[Slot.HIGH_C])
        rate = _clamped(rate_c_per_h[i], -abs(row[Slot.RATE_LIMIT]), abs(row[Slot.RATE_LIMIT]))
        hotter_k = _clamped(
            electronics_c[i] - optics_c[i], row[Slot.DIFFERENCE_LOW], row[Slot.DIFFERENCE_HIGH]
        )
        cold = _clamped((row[Slot.ONSET_C] - at_c) / max(row[Slot.ONSET_WIDTH], _MIN_WIDTH_C), -500.0, 500.0)
        saturated, grown = 1.0 / (1.0 + math.exp(-cold)), math.log1p(math.exp(cold))
        attitude = gravity = polynomial = 0.0
        for axis in range(3):
            attitude += row[Slot.SATURATING + axis] * saturated * up_body[axis]
            attitude += row[Slot.GROWING + axis] * grown * up_body[axis]
            gravity += row[Slot.GRAVITY + axis] * up_body[axis]
        for degree in range(_LAST_COEFFICIENT, -1, -1):
            polynomial = polynomial * at_c + row[Slot.POLYNOMIAL + degree]
        warm_up = row[Slot.WARM_UP] * math.exp(-on_s / max(row[Slot.WARM_UP_TIME], _MIN_TIME_S))
        total = (
            polynomial
            + row[Slot.RATE] * rate
            + (row[Slot.GRADIENT] + attitude) * hotter_k
            + gravity
            + warm_up
            + row[Slot.HYSTERESIS] * (play_c[i] - at_c)
        )
        bias[i] = _clamped(total, -_MAX_BIAS_DPH, _MAX_BIAS_DPH)
    return bias
