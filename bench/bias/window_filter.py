"""Whitens one window of navigation at rest, epoch by epoch, with a Kalman filter.

The effect of the sensors' noise on velocity and heading is strongly correlated from epoch to epoch. A filter
whose model contains only the noise turns the data into innovations that are white with unit variance. The
response to each parameter, passed through the same filter, becomes a column of an ordinary least-squares
problem. This is generalised least squares without the large covariance matrix.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from gyrobench.bench.bias.dwell import interval_indices
from gyrobench.bench.bias.parameters import ErrorModel
from gyrobench.bench.bias.statistics import compress
from gyrobench.bench.foundations.arrays import FloatArray, IntArray
from gyrobench.bench.foundations.kernels import compiled, copy_matrix
from gyrobench.bench.navigation.attitude import rotation_vector_enu
from gyrobench.bench.navigation.error_model import INPUTS, STATES, integrate

#: Interval of the epochs used, s. Velocity and heading are integrals, so more epochs would only average the
#: noise of the output.
EPOCH_S = 1.0
#: Time, s, over which innovations are summed for the goodness-of-fit test.
_MINUTE_S = 60.0
#: Time constant, s, with which accelerometers settle after a turn.
TRANSIENT_S = 120.0

# Smallest noise of velocity East and North, m/s, and heading, rad: far below the resolution of an INS.
_MIN_WHITE = np.array([1e-7, 1e-7, 1e-10])


@dataclass(frozen=True, eq=False)
class FilteredEpochs:
    """Rows, gains and transitions of the filter at the n epochs of a window."""

    time_s: FloatArray  #: Shape (n,).
    #: rows, gains, scales: Shapes (n, 3, c), (n, 3, 6), (n, 3). White rows with unit variance for columns in
    #: SI; gain of the state for each datum in m/s or rad; inverse standard deviation of each innovation, s/m
    #: or 1/rad. See :func:`whiten`.
    rows: FloatArray
    gains: FloatArray
    scales: FloatArray
    #: transition, response: Shapes (n, 6, 6), (n, 6, 5). Over the interval that ends at each epoch, SI.
    transition: FloatArray
    response: FloatArray


class WindowFilter:
    """Filters one window: the data, and the responses to the inputs that may act in it.

    ``time_s``, ``C_nb`` (3, 3): first epoch on the clock of the INS, and the attitude that it computes then;
    ``negated_state`` (6,): estimate of the state from earlier windows, with opposite sign; ``covariance``
    (6, 6): of that estimate due to the noise, changed as epochs are added.

    Attributes
    ----------
    columns : ndarray, shape (6, c)
        Part of the state at the last epoch that the filter does not estimate, for the columns of
        :mod:`gyrobench.bench.bias.window_filter`.
    root : ndarray, shape (k, c)
        Rows with the same normal equations as the white rows of all epochs.
    first_s, last_s : float
        Time of the first epoch, and of the last one used; NaN if there is none.
    output_variances : ndarray, shape (3,)
        Of the noise of velocity East and North and of the heading.
    temperature_sum, epochs : ndarray of shape (4,), int
        Sum of the temperatures over the epochs used, and their number.
    """

    def __init__(
        self,
        model: ErrorModel,
        time_s: float,
        C_nb: FloatArray,
        negated_state: FloatArray,
        covariance: FloatArray,
    ) -> None:
        self._model = model
        self.first_s = time_s
        white = np.array([model.noise.velocity_white] * 2 + [model.noise.heading_white])
        self.output_variances = np.maximum(white, _MIN_WHITE) ** 2
        self.C_nb = np.ascontiguousarray(C_nb)
        self.covariance = covariance
        self.columns = np.zeros((STATES, COLUMN_COUNT))
        self.columns[:, :INPUT] = np.eye(STATES)
        self.columns[:, DATA] = negated_state
        self.root = np.zeros((0, COLUMN_COUNT))
        self.last_s = math.nan
        self.temperature_sum = np.zeros(4)
        self.epochs = 0
        self._last_velocity = np.zeros(2)
        self._filtered: list[tuple[FloatArray, ...]] = []

    def new_epochs(self, time_s: FloatArray) -> IntArray:
        """Indices of the epochs to use: the first one of each second that has none yet."""
        indices = interval_indices(time_s, self.first_s, EPOCH_S)
        used = interval_indices(np.array([self.last_s]), self.first_s, EPOCH_S) if self.epochs else [-1]
        return np.flatnonzero(indices > np.maximum.accumulate(np.append(used, indices[:-1])))

    def add(
        self, time_s: FloatArray, velocity_en_mps: FloatArray, C_nb: FloatArray, temperatures: FloatArray
    ) -> None:
        """Filter the next epochs (n,).

        ``temperatures`` (n, 4): of the gyros and of the accelerometers, relative to the reference
        temperatures of the bias slopes, K.
        """
        steps = integrate(
            self._model.site,
            np.diff(time_s, prepend=time_s[0] if math.isnan(self.last_s) else self.last_s),
            self._model.noise.angle_random_walk,
            self._model.noise.velocity_random_walk,
        )
        heading = -rotation_vector_enu(C_nb, self.C_nb)[:, 2]
        varying_inputs = np.zeros((len(time_s), INPUTS, DATA - SLOPE))
        varying_inputs[:, :3, :3] = self.C_nb * temperatures[:, np.newaxis, :3]
        varying_inputs[:, 3:, 3:5] = np.multiply.outer(temperatures[:, 3], np.eye(2))
        varying_inputs[:, 3:, 5:7] = np.multiply.outer(
            np.exp((self.first_s - time_s) / TRANSIENT_S), np.eye(2)
        )
        # Velocity of the epoch before: its noise is not in this innovation.
        varying_inputs[:, 3:, 7] = -np.vstack([self._last_velocity, velocity_en_mps[:-1]])
        rows, gains, scales = whiten(
            self.columns,
            self.covariance,
            np.column_stack([velocity_en_mps, heading]),
            self.output_variances,
            steps.transition,
            steps.response,
            steps.covariance,
            varying_inputs,
        )
        self.root = compress(np.vstack([self.root, rows.reshape(-1, COLUMN_COUNT)]))
        self._filtered.append((time_s, rows, gains, scales, steps.transition, steps.response))
        self.last_s, self._last_velocity = float(time_s[-1]), velocity_en_mps[-1]
        self.temperature_sum += temperatures.sum(axis=0)
        self.epochs += len(time_s)

    @property
    def filtered_epochs(self) -> FilteredEpochs:
        """Rows, gains and transitions of the filter at all epochs."""
        return FilteredEpochs(*(np.concatenate(each) for each in zip(*self._filtered, strict=True)))

    def minute_sums(self) -> FloatArray:
        """Sums (n, c) of the rows over each minute, one for each measured component, with unit variance."""
        if not self._filtered:
            return np.zeros((0, COLUMN_COUNT))
        epochs = self.filtered_epochs
        indices = interval_indices(epochs.time_s, self.first_s, _MINUTE_S)
        starts = np.flatnonzero(np.diff(indices, prepend=-1))
        counts = np.diff(starts, append=len(indices))
        sums = np.add.reduceat(epochs.rows, starts) / np.sqrt(counts)[:, np.newaxis, np.newaxis]
        return np.asarray(sums).reshape(-1, COLUMN_COUNT)


#: First columns of a window's blocks: state at its start; constant inputs; constant of the heading; inputs
#: proportional to the temperature of each gyro; accelerations East and North proportional to the temperature
#: of the accelerometers; decaying accelerations East and North; damping of the velocity; the data.
STATE, INPUT, HEADING, SLOPE, ACCELEROMETER_SLOPE, TRANSIENT, DAMPING, DATA = 0, 6, 11, 12, 15, 17, 19, 20
COLUMN_COUNT = 21


#: Components of the state that the data of an epoch measure: velocity East and North, attitude about Up.
MEASURED_STATES = (3, 4, 2)


@compiled
def whiten(
    columns: FloatArray,
    covariance: FloatArray,
    measured: FloatArray,
    variances: FloatArray,
    transitions: FloatArray,
    responses: FloatArray,
    covariances: FloatArray,
    varying_inputs: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Filter the next n epochs of one window; ``columns`` and ``covariance`` are changed in place.

    ``columns`` (6, c): the part of the state that the filter does not estimate, for each column;
    ``covariance`` (6, 6): of the filter's estimate, due to the noise; ``measured`` (n, 3): velocity error
    East and North, attitude error about Up; ``variances`` (3,): of the noise of each of them; ``transitions``
    (n, 6, 6), ``responses`` (n, 6, 5), ``covariances`` (n, 6, 6): the interval that ends at each epoch, see
    :class:`gyrobench.bench.navigation.error_model.Intervals`; ``varying_inputs`` (n, 5, 8): input in that
    interval, for each column from the slopes on. Returns white rows (n, 3, c) with unit variance, and for
    each datum the gain (n, 3, 6) of the filter and the inverse standard deviation (n, 3) of its innovation.
    """
    rows = np.empty((measured.shape[0], 3, COLUMN_COUNT))
    gains, scales = np.empty((measured.shape[0], 3, 6)), np.empty((measured.shape[0], 3))
    propagated, before = np.empty((6, COLUMN_COUNT)), np.empty((6, 6))
    for k in range(measured.shape[0]):
        _propagate_columns(columns, transitions, responses, varying_inputs, k, propagated)
        _propagate_covariance(covariance, transitions, covariances, k, before)
        for m in range(3):
            h = MEASURED_STATES[m]
            variance = covariance[h, h] + variances[m]
            gain, row, scale = gains[k, m], rows[k, m], 1.0 / np.sqrt(variance)
            for i in range(6):
                gain[i] = covariance[h, i] / variance
            for c in range(COLUMN_COUNT):
                row[c] = columns[h, c]
            row[DATA] += measured[k, m]
            if m == 2:
                row[HEADING] += 1.0
            for i in range(6):
                for c in range(COLUMN_COUNT):
                    columns[i, c] -= gain[i] * row[c]
                for j in range(6):
                    covariance[i, j] -= gain[i] * gain[j] * variance
            scales[k, m] = scale
            for c in range(COLUMN_COUNT):
                row[c] *= scale
    return rows, gains, scales


@compiled
def _propagate_columns(
    columns: FloatArray, transitions: FloatArray, responses: FloatArray, varying_inputs: FloatArray, k: int,
    propagated: FloatArray,
) -> None:  # fmt: skip
    """Propagate the columns (6, c) over interval k; ``propagated`` (6, c): for the calculation."""
    for i in range(6):
        for c in range(COLUMN_COUNT):
            propagated[i, c] = 0.0
        for j in range(6):
            factor = transitions[k, i, j]
            for c in range(COLUMN_COUNT):
                propagated[i, c] += factor * columns[j, c]
        for j in range(INPUTS):
            response = responses[k, i, j]
            propagated[i, INPUT + j] += response
            for c in range(DATA - SLOPE):
                propagated[i, SLOPE + c] += response * varying_inputs[k, j, c]
    copy_matrix(columns, propagated)


@compiled
def _propagate_covariance(
    covariance: FloatArray, transitions: FloatArray, covariances: FloatArray, k: int, before: FloatArray
) -> None:
    """Propagate the covariance (6, 6) over interval k; ``before`` (6, 6): for the calculation."""
    # Numba's matrix product would import scipy.linalg.
    for i in range(6):
        for j in range(6):
            before[i, j] = 0.0
            for m in range(6):
                before[i, j] += transitions[k, i, m] * covariance[m, j]
    for i in range(6):
        for j in range(6):
            covariance[i, j] = covariances[k, i, j]
            for m in range(6):
                covariance[i, j] += before[i, m] * transitions[k, j, m]
