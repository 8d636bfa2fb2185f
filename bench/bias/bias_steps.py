"""Test for a step of a gyro bias at an unknown time in a dwell.

A small step hides in the sums over minutes, which test for any fault. The matched test (generalised
likelihood ratio) uses the response of all later innovations, through the turns, to a step at each time. One
backward pass of the whitening filter gives the information of all later epochs on a step at any epoch, so
that no response has to be filtered for each time.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gyrobench.bench.bias.statistics import chi2_p_value
from gyrobench.bench.bias.window_filter import COLUMN_COUNT, DATA, MEASURED_STATES, WindowFilter
from gyrobench.bench.foundations.arrays import RADPS_TO_DPH, FloatArray, IntArray
from gyrobench.bench.foundations.kernels import compiled_fastmath, copy_matrix
from gyrobench.bench.navigation.error_model import STATES

#: A step with a smaller p-value is significant: one in 250 dwells with constant biases.
MIN_STEP_P_VALUE = 4e-3
#: Epochs between the times that are tested, and fewest epochs of a window before and after a step. Another
#: test compares the biases of the windows.
_TRIAL_SPACING, _MARGIN = 10, 60
#: All tested times and gyros together give as many false alarms as about this number of independent tests.
_INDEPENDENT_TESTS = 60.0
_GYROS = 3


@dataclass(frozen=True)
class BiasStep:
    """The most significant step of the gyro biases."""

    time_s: float  #: On the clock of the INS.
    gyro: int  #: Index of the gyro that changes most significantly: 0 to 2 for x, y, z.
    size_dph: float  #: Its step, deg/h.
    p_value: float  #: Probability of a step as significant at any time in any gyro of a dwell without steps.


@dataclass(frozen=True, eq=False)
class WindowChange:
    """Propagation of the state from the end of one window to the start of the next."""

    transition: FloatArray  #: Shape (6, 6).
    bias_response: FloatArray  #: Shape (6, 3). Change of the state for a unit of each gyro's bias, body axes.
    walk_covariance: FloatArray  #: Shape (2, 6, 6). Covariance for unit angle and velocity random walk.


def find_bias_step(
    windows: list[WindowFilter],
    changes: list[WindowChange],
    expansions: list[FloatArray],
    parameters: FloatArray,
    covariance: FloatArray,
) -> BiasStep | None:
    """Find the most significant step of a gyro bias in a dwell; None if its windows are too short for it.

    ``changes``: from each window to the next; ``expansions`` (c, p): each column of a window for a unit of
    each parameter; ``parameters`` (p,), ``covariance`` (p, p): the estimate without a step.
    """
    size, count = STATES + _GYROS, len(parameters)
    later, later_information = np.zeros((size, count + 1)), np.zeros((size, size))
    times, scores, variances = [], [], []
    for index in reversed(range(len(windows))):
        window, expansion = windows[index], expansions[index]
        epochs = window.filtered_epochs
        # Those at which a step is tested, last first.
        trial_epochs = np.arange(len(epochs.time_s) - 1 - _MARGIN, _MARGIN - 1, -_TRIAL_SPACING)
        information, responses = _backward(
            epochs.rows, epochs.gains, epochs.scales, epochs.transition,
            np.ascontiguousarray(epochs.response[:, :, :_GYROS] @ window.C_nb), np.append(trial_epochs, -1),
        )  # fmt: skip
        # The columns of a window, and the state and biases at its end, for the parameters and the data.
        for_parameters = np.zeros((COLUMN_COUNT + size, count + 1))
        for_parameters[:DATA, : expansion.shape[1]] = expansion
        for_parameters[DATA, -1] = 1.0
        for_parameters[COLUMN_COUNT:] = later
        response, to_end = responses[:-1, STATES:] @ for_parameters, responses[:-1, STATES:, COLUMN_COUNT:]
        times.append(epochs.time_s[trial_epochs])
        scores.append(response[:, :, -1] - response[:, :, :-1] @ parameters)
        response = response[:, :, :-1]
        variances.append(
            information[:-1, STATES:, STATES:]
            + to_end @ later_information @ to_end.transpose(0, 2, 1)
            - (response @ covariance) @ response.transpose(0, 2, 1)
        )
        if index:
            backward = np.eye(size)
            backward[:STATES] = np.hstack([changes[index - 1].transition, changes[index - 1].bias_response])
            to_end = responses[-1, :, COLUMN_COUNT:]
            later = backward.T @ responses[-1] @ for_parameters
            later_information = (
                backward.T @ (information[-1] + to_end @ later_information @ to_end.T) @ backward
            )
    return _most_significant(*(np.concatenate(each) for each in (times, scores, variances)))


def _most_significant(time_s: FloatArray, score: FloatArray, variance: FloatArray) -> BiasStep | None:
    """Step at the time and in the gyro of the largest score; None without any.

    Scores (t, 3) are those of a step at each time (t,), with their covariances (t, 3, 3).
    """
    if not len(time_s):
        return None
    significances = score**2 / np.diagonal(variance, axis1=1, axis2=2)
    joint_chi2 = np.einsum("ti,ti->t", score, np.linalg.solve(variance, score[:, :, np.newaxis])[:, :, 0])
    best, gyro = np.unravel_index(int(np.argmax(significances)), significances.shape)
    smallest = min(
        chi2_p_value(1, float(significances[best, gyro])), chi2_p_value(_GYROS, float(joint_chi2.max()))
    )
    return BiasStep(
        float(time_s[best]),
        int(gyro),
        float(score[best, gyro] / variance[best, gyro, gyro]) * RADPS_TO_DPH,
        min(1.0, _INDEPENDENT_TESTS * smallest),
    )


@compiled_fastmath
def _backward(
    rows: FloatArray, gains: FloatArray, scales: FloatArray, transitions: FloatArray,
    bias_response: FloatArray, saved: IntArray,
) -> tuple[FloatArray, FloatArray]:  # fmt: skip
    """Information of all later epochs of a window on the state and the biases from an epoch on.

    ``rows`` (n, 3, c), ``gains`` (n, 3, 6), ``scales`` (n, 3), ``transitions`` (n, 6, 6): see
    :class:`gyrobench.bench.bias.window_filter.FilteredEpochs`; ``bias_response`` (n, 6, 3): state after each
    interval for a unit of each gyro's bias; ``saved`` (m,): epochs, descending; -1 stands for the start of
    the window. Returns the Fisher information (m, 9, 9), and (m, 9, c + 9) the information shared with the
    columns of the window, and the transposed transition to its end.
    """
    columns, size = rows.shape[2], STATES + _GYROS
    width = columns + size
    # Side by side, as both are multiplied by the transposed transition.
    both, propagated = np.zeros((size, width + size)), np.empty((STATES, width + size))
    responses, info = both[:, :width], both[:, width:]
    for i in range(size):
        responses[i, columns + i] = 1.0
    infos, all_responses = np.empty((len(saved), size, size)), np.empty((len(saved), size, width))
    carried, gain_response, index = np.empty(size), np.empty(width), 0
    for k in range(len(rows) - 1, -2, -1):
        if index < len(saved) and saved[index] == k:
            copy_matrix(infos[index], info)
            copy_matrix(all_responses[index], responses)
            index += 1
        if k < 0:
            break
        for m in range(2, -1, -1):
            _use_datum(
                responses, info, MEASURED_STATES[m], rows[k, m], gains[k, m], scales[k, m], gain_response,
                carried,
            )  # fmt: skip
        _carry_back(both, info, transitions[k], bias_response[k], propagated, carried)
    return infos, all_responses


@compiled_fastmath
def _use_datum(
    responses: FloatArray, info: FloatArray, h: int, row: FloatArray, gain: FloatArray, scale: float,
    gain_response: FloatArray, carried: FloatArray,
) -> None:  # fmt: skip
    """Add a datum of state ``h`` to responses and information; the last two are for the calculation."""
    columns, width, size = len(row), responses.shape[1], len(info)
    for c in range(width):
        gain_response[c] = 0.0
    for i in range(STATES):
        for c in range(width):
            gain_response[c] += gain[i] * responses[i, c]
    for c in range(width):
        responses[h, c] -= gain_response[c]
    for c in range(columns):
        responses[h, c] += scale * row[c]
    for i in range(size):
        carried[i] = 0.0
        for j in range(STATES):
            carried[i] += info[i, j] * gain[j]
    for i in range(size):
        info[h, i] -= carried[i]
        info[i, h] -= carried[i]
    for j in range(STATES):
        info[h, h] += gain[j] * carried[j]
    info[h, h] += scale * scale


@compiled_fastmath
def _carry_back(
    both: FloatArray, info: FloatArray, transition: FloatArray, response: FloatArray, propagated: FloatArray,
    carried: FloatArray,
) -> None:  # fmt: skip
    """Carry responses and information back over an interval; the last two are for the calculation."""
    size, width = both.shape
    for i in range(STATES, size):
        for j in range(STATES):
            for c in range(width):
                both[i, c] += response[j, i - STATES] * both[j, c]
    for i in range(STATES):
        for c in range(width):
            propagated[i, c] = 0.0
        for j in range(STATES):
            for c in range(width):
                propagated[i, c] += transition[j, i] * both[j, c]
    copy_matrix(both, propagated)
    for i in range(size):  # the information, which is symmetric, is multiplied from both sides
        for j in range(STATES):
            carried[j] = info[i, j]
        for c in range(STATES):
            info[i, c] = 0.0
        for j in range(STATES):
            for c in range(STATES):
                info[i, c] += carried[j] * transition[j, c]
            for c in range(_GYROS):
                info[i, STATES + c] += carried[j] * response[j, c]
