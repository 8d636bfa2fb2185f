"""Gyro compensation inside the INS: a loaded table of coefficients, evaluated on the INS's own sensors.

The formula is that of :mod:`gyrobench.drivers.ins.compensation`. After the biases, the errors of the other
coefficients are removed: those of the gyros' matrix, and of the accelerometers' biases and matrix, with T and
dT/dt of the gyro along the sensor's axis. The separate limits of T of another coefficient do not apply if
both are zero. The play starts at the temperature at power-on.
"""

from __future__ import annotations

import math
import zlib
from array import array
from typing import NamedTuple

import numpy as np

from gyrobench.bench.foundations.arrays import FloatArray
from gyrobench.bench.foundations.kernels import compiled


class _Slot(NamedTuple):
    """Index of a coefficient in a gyro's row; the polynomial and vectors take several columns."""

    POLYNOMIAL: int = 0
    LOW_C: int = 6
    HIGH_C: int = 7
    RATE: int = 8
    RATE_LIMIT: int = 9
    GRADIENT: int = 10
    DIFFERENCE_LOW: int = 11
    DIFFERENCE_HIGH: int = 12
    SATURATING: int = 13
    GROWING: int = 16
    ONSET_C: int = 19
    ONSET_WIDTH: int = 20
    GRAVITY: int = 21
    WARM_UP: int = 24
    WARM_UP_TIME: int = 25
    HYSTERESIS: int = 26
    HALF_WIDTH: int = 27
    GYRO_MATRIX: int = 28
    FORCE_BIAS: int = 52
    FORCE_MATRIX: int = 60
    LIMITS: int = 84


#: A tuple and not an IntEnum, which only the latest numba takes as an index.
SLOT = _Slot()

#: Number of columns of the table, and of those for the gyro's bias.
COEFFICIENT_COUNT, _BIAS_COUNT = 98, 28
#: Number of columns of each other coefficient, and of those for its polynomial.
_CORRECTION_SIZE, _DEGREES = 8, 4
_PPM, _ARCSEC, _MICRO_G = 1e-6, math.radians(1.0) / 3600.0, 9.80665e-6

_MAX_DEGREE = 5
#: Limit of the subtracted bias, deg/h.
_MAX_BIAS_DPH = 3600.0
_MIN_WIDTH_C, _MIN_TIME_S = 1e-3, 1.0
_RECORD_EVERY_S = 10
#: Time constant of each of the two filters that give the rate of temperature.
_FILTER_S = 120.0


def empty_table() -> FloatArray:
    """Return a table, shape (3, 98), that subtracts nothing."""
    table = np.zeros((3, COEFFICIENT_COUNT))
    table[:, SLOT.LOW_C] = -100.0
    table[:, SLOT.HIGH_C] = 150.0
    return table


def table_checksum(table: FloatArray) -> int:
    """Compute the CRC-32 of a table as little-endian 32-bit floats, axis by axis.

    The table has three parts: the biases, the other coefficients, and their separate limits. Parts at the end
    that are all zero are left out.
    """
    for end in (_BIAS_COUNT, SLOT.LIMITS):
        if not table[:, end:].any():
            table = table[:, :end]
            break
    return zlib.crc32(table.astype("<f4").tobytes())


class TemperatureHistory:
    """The INS's readings of its gyros' temperatures since power-on."""

    def __init__(self) -> None:
        #: optics_c, electronics_c: Shape (3,). The last readings; there is one each second.
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
        """Rate of each gyro's optics temperature, shape (3,); the filters delay it by some minutes."""
        return np.asarray((self._filtered_c[0] - self._filtered_c[1]) * (3600.0 / _FILTER_S))


class InsCompensation:
    """A compensation table in use; ``bias_dph``, shape (3,), is subtracted from the gyros at present.

    ``table``, shape (3, 98), has one row for each axis, laid out by :data:`SLOT`. The play is computed from
    the readings since power-on, ``history``.
    """

    def __init__(self, table: FloatArray, history: TemperatureHistory, up_body: FloatArray) -> None:
        self.checksum = table_checksum(table)  #: Checksum of the table.
        self._table = table.copy()
        self._other_coefficients: FloatArray | None = None
        record_c = history.record_c
        first_c = record_c[0] if len(record_c) else history.optics_c
        self._play_c = np.clip(first_c, table[:, SLOT.LOW_C], table[:, SLOT.HIGH_C])
        for optics_c in record_c:
            _update_play(self._play_c, optics_c, self._table)
        self.update(history, up_body)

    def update(self, history: TemperatureHistory, up_body: FloatArray) -> None:
        """Update the subtracted bias.

        ``up_body``, shape (3,), is Up in body axes as estimated by the INS; zero before alignment.
        """
        _update_play(self._play_c, history.optics_c, self._table)
        self.bias_dph = _bias_dph(
            self._table, history.optics_c, history.electronics_c, history.rate_c_per_h, up_body,
            float(history.seconds), self._play_c,
        )  # fmt: skip
        if self._table[:, _BIAS_COUNT:].any():
            numbers = self._table[:, _BIAS_COUNT : SLOT.LIMITS].reshape(3, -1, _CORRECTION_SIZE)
            self._other_coefficients = (numbers * self._factors(history, up_body)).sum(axis=2)

    def _factors(self, history: TemperatureHistory, up_body: FloatArray) -> FloatArray:
        """Factors of the eight numbers of each coefficient, shape (3, 7, 8)."""
        low_c, high_c, limit = self._table[:, [SLOT.LOW_C, SLOT.HIGH_C, SLOT.RATE_LIMIT]].T
        at_c = np.clip(history.optics_c, low_c, high_c)[:, np.newaxis]
        limits_c = self._table[:, SLOT.LIMITS :].reshape(3, -1, 2)
        at_c = np.where(limits_c.any(axis=2), np.clip(at_c, limits_c[..., 0], limits_c[..., 1]), at_c)
        factors = np.empty((*at_c.shape, _CORRECTION_SIZE))
        factors[..., :_DEGREES] = at_c[..., np.newaxis] ** np.arange(_DEGREES)
        factors[..., _DEGREES] = np.clip(history.rate_c_per_h, -np.abs(limit), np.abs(limit))[:, np.newaxis]
        factors[..., _DEGREES + 1 :] = up_body
        return factors

    def correct_increments(
        self, rotation: FloatArray, velocity: FloatArray, interval_s: float
    ) -> tuple[FloatArray, FloatArray]:
        """Return increments (n, 3) corrected for all errors except the gyros' biases, rad and m/s."""
        if self._other_coefficients is None:
            return rotation, velocity
        units = np.where(np.eye(3, dtype=bool), _PPM, _ARCSEC)
        gyro, bias, force = (
            self._other_coefficients[:, :3] * units,
            self._other_coefficients[:, 3],
            self._other_coefficients[:, 4:] * units,
        )
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
def _clip(value: float, low: float, high: float) -> float:
    return min(max(value, low), high)


@compiled
def _update_play(play_c: FloatArray, optics_c: FloatArray, table: FloatArray) -> None:
    for i in range(3):
        row = table[i]
        at_c, slack_c = (_clip(optics_c[i], row[SLOT.LOW_C], row[SLOT.HIGH_C]), abs(row[SLOT.HALF_WIDTH]))
        play_c[i] = _clip(play_c[i], at_c - slack_c, at_c + slack_c)


@compiled
def _bias_dph(
    table: FloatArray, optics_c: FloatArray, electronics_c: FloatArray, rate_c_per_h: FloatArray,
    up_body: FloatArray, on_s: float, play_c: FloatArray,
) -> FloatArray:  # fmt: skip
    bias = np.zeros(3)
    for i in range(3):
        row = table[i]
        at_c = _clip(optics_c[i], row[SLOT.LOW_C], row[SLOT.HIGH_C])
        rate = _clip(rate_c_per_h[i], -abs(row[SLOT.RATE_LIMIT]), abs(row[SLOT.RATE_LIMIT]))
        difference_k = _clip(
            electronics_c[i] - optics_c[i], row[SLOT.DIFFERENCE_LOW], row[SLOT.DIFFERENCE_HIGH]
        )
        below_onset = _clip(
            (row[SLOT.ONSET_C] - at_c) / max(row[SLOT.ONSET_WIDTH], _MIN_WIDTH_C), -500.0, 500.0
        )
        saturation, growth = 1.0 / (1.0 + math.exp(-below_onset)), math.log1p(math.exp(below_onset))
        attitude = gravity = polynomial = 0.0
        for axis in range(3):
            attitude += row[SLOT.SATURATING + axis] * saturation * up_body[axis]
            attitude += row[SLOT.GROWING + axis] * growth * up_body[axis]
            gravity += row[SLOT.GRAVITY + axis] * up_body[axis]
        for degree in range(_MAX_DEGREE, -1, -1):
            polynomial = polynomial * at_c + row[SLOT.POLYNOMIAL + degree]
        warm_up = row[SLOT.WARM_UP] * math.exp(-on_s / max(row[SLOT.WARM_UP_TIME], _MIN_TIME_S))
        total = (
            polynomial
            + row[SLOT.RATE] * rate
            + (row[SLOT.GRADIENT] + attitude) * difference_k
            + gravity
            + warm_up
            + row[SLOT.HYSTERESIS] * (play_c[i] - at_c)
        )
        bias[i] = _clip(total, -_MAX_BIAS_DPH, _MAX_BIAS_DPH)
    return bias
