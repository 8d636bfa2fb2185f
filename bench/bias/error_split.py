"""Splits the error of a dwell's biases by its independent sources, with the gains of the estimator fixed.

The estimate is linear: the error of a bias is the sum of the contributions of each noise source and each part
of the prior knowledge through the estimator's gains, so the covariances of the parts add up to that of the
estimate (Joseph's form). The contribution of the prior knowledge follows from the normal equations. For that
of the noise, one backward pass of the whitening filter propagates the weights of all innovations to the noise
of each interval and each output.

An error that is the same in several dwells changes their biases by the same amount. If it is the same in all
power cycles, it does not add to their scatter; subtracting it from the scatter as noise would hide changes of
the gyros from one power cycle to the next. There, the drift of accelerometers counts as a common error,
although it is independent from dwell to dwell otherwise: power cycles are measured at the same time after
power-on, when accelerometers that warm up drift by the same amount.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from types import MappingProxyType

import numpy as np

from gyrobench.bench.bias import parameters
from gyrobench.bench.bias.bias_steps import WindowChange
from gyrobench.bench.bias.error_sources import SOURCES
from gyrobench.bench.bias.parameters import ErrorModel, PriorKnowledge
from gyrobench.bench.bias.window_filter import DATA, MEASURED_STATES, WindowFilter
from gyrobench.bench.foundations.arrays import RADPS_TO_DPH, FloatArray, IntArray
from gyrobench.bench.foundations.kernels import compiled
from gyrobench.bench.navigation.error_model import STATES, unit_walks


@dataclass(frozen=True, eq=False)
class ErrorPart:
    """Error of the biases of the x, y and z gyro due to one source."""

    #: Shape (3, m). Error for one standard deviation of each of m independent components, rad/s.
    columns: FloatArray
    sigma: float  #: Standard uncertainty of each component, SI.
    dof: float = math.inf  #: Its degrees of freedom; infinite if it is declared.

    def scaled(self, factors: FloatArray) -> ErrorPart:
        """Part with the error of each gyro multiplied by a factor (3,)."""
        return replace(self, columns=self.columns * factors[:, np.newaxis])


#: By number of the dwell: errors (3, s) of the biases of its x, y and z gyro due to each of s independent
#: sources that act in all dwells, deg/h.
SharedErrors = Mapping[int, FloatArray]
NONE_SHARED: SharedErrors = MappingProxyType({})


def shared_errors(dwells: Mapping[int, Mapping[str, ErrorPart]], sources: Iterable[str]) -> SharedErrors:
    """Errors due to these sources, from the parts of each dwell by its number."""
    columns: dict[int, list[FloatArray]] = {number: [] for number in dwells}
    for source in sources:
        by_dwell = {number: parts[source].columns for number, parts in dwells.items() if source in parts}
        width = max((each.shape[1] for each in by_dwell.values()), default=0)
        for number, blocks in columns.items():
            dwell_columns = by_dwell.get(number, np.zeros((3, 0)))
            blocks.append(np.pad(dwell_columns, ((0, 0), (0, width - dwell_columns.shape[1]))))
    return {number: RADPS_TO_DPH * np.hstack(each) for number, each in columns.items()}


class ErrorParts(Mapping[str, ErrorPart]):
    """Mapping of source to part, stored in two arrays, since a run keeps the parts of all its dwells."""

    __slots__ = ("_columns", "_scalars", "_slices")

    def __init__(self, parts: Mapping[str, ErrorPart]) -> None:
        self._slices = _slices(tuple((name, part.columns.shape[1]) for name, part in parts.items()))
        self._columns = np.hstack([part.columns for part in parts.values()])
        self._scalars = np.array([(part.sigma, part.dof) for part in parts.values()])

    def __getitem__(self, name: str) -> ErrorPart:
        index, columns = self._slices[name]
        sigma, dof = self._scalars[index].tolist()
        return ErrorPart(self._columns[:, columns], sigma, dof)

    def __iter__(self) -> Iterator[str]:
        return iter(self._slices)

    def __len__(self) -> int:
        return len(self._slices)


@lru_cache(maxsize=16)
def _slices(sizes: tuple[tuple[str, int], ...]) -> Mapping[str, tuple[int, slice]]:
    """Index and columns of each part, given their sizes; all dwells with the same parts share the result."""
    ends = itertools.accumulate(size for _, size in sizes)
    return {
        name: (number, slice(end - size, end))
        for number, ((name, size), end) in enumerate(zip(sizes, ends, strict=True))
    }


def prior_parts(
    response: FloatArray, prior: PriorKnowledge, parameter_mask: FloatArray, windows: int
) -> dict[str, ErrorPart]:
    """Errors due to prior knowledge.

    ``response`` (3, p): error of the biases for one standard deviation of each independent part of the prior
    knowledge; ``parameter_mask`` (p,): 1 for each parameter that is estimated, 0 for those that are taken as
    zero; ``windows``: their number.
    """
    matrix = np.arange(parameters.GYRO_MATRIX.start, parameters.GYRO_MATRIX.stop)
    scale_factors = matrix[:: 3 + 1]
    window_starts = parameters.COMMON_COUNT + parameters.PER_WINDOW * np.arange(windows)
    per_window = np.arange(parameters.PER_WINDOW)
    transient_indices = parameters.transients(windows)
    indices: dict[str, tuple[slice | IntArray, float]] = {
        "accelerometer_bias": (parameters.ACCELEROMETER_BIAS, prior.accelerometer_bias),
        "accelerometer_drift": (parameters.ACCELEROMETER_DRIFT, prior.accelerometer_drift),
        "accelerometer_slope": (parameters.ACCELEROMETER_SLOPE, prior.accelerometer_slope),
        "gyro_scale_factor": (scale_factors, prior.gyro_scale_factor),
        "gyro_misalignment": (np.setdiff1d(matrix, scale_factors), prior.gyro_misalignment),
        "tilt_step": (
            np.add.outer(window_starts[1:], per_window[parameters.ATTITUDE]).ravel(),
            prior.tilt_step,
        ),
        "latitude": (parameters.NAVIGATION_RATE, prior.latitude),
        "bias_slope": (parameters.GYRO_SLOPE, prior.bias_slope),
    }
    if len(transient_indices) and parameter_mask[transient_indices].any():
        indices["accelerometer_settling"] = transient_indices, prior.accelerometer_transient
    is_named = np.zeros(response.shape[1], dtype=bool)
    for index, _ in indices.values():
        is_named[index] = True
    parts = {name: ErrorPart(response[:, index], sigma) for name, (index, sigma) in indices.items()}
    others = response[:, ~is_named]
    return parts | {"initial_state": ErrorPart(_root(others @ others.T), math.nan)}


def noise_parts(
    windows: Sequence[WindowFilter],
    changes: Sequence[WindowChange],
    expansions: Sequence[FloatArray],
    gain: FloatArray,
    model: ErrorModel,
) -> dict[str, ErrorPart]:
    """Errors due to the noise of gyros, accelerometers and outputs.

    ``changes``: from each window to the next; ``expansions`` (c, p): each column of a window for a unit of
    each parameter; ``gain`` (p, 3): covariance of the parameters with the biases.
    """
    walks, outputs, costate = np.zeros((2, 3, 3)), np.zeros((3, 3, 3)), np.zeros((STATES, 3))
    for number in reversed(range(len(windows))):
        epochs = windows[number].filtered_epochs
        durations = np.diff(epochs.time_s, prepend=epochs.time_s[0])
        walk_covariance = unit_walks(model.site, durations)
        # Weights of the white innovations in the biases.
        weights = epochs.rows[:, :, :DATA] @ (expansions[number] @ gain[: expansions[number].shape[1]])
        _backward(
            weights, epochs.gains, epochs.scales, epochs.transition, walk_covariance,
            costate, walks, outputs,
        )  # fmt: skip
        if number:
            walks += costate.T @ changes[number - 1].walk_covariance @ costate
            costate = np.ascontiguousarray(changes[number - 1].transition.T @ costate)
    variances, noise = windows[0].output_variances, model.noise
    covariances = {
        "angle_random_walk": noise.angle_random_walk**2 * walks[0],
        "velocity_random_walk": noise.velocity_random_walk**2 * walks[1],
        "velocity_output": variances[0] * (outputs[0] + outputs[1]),
        "heading_output": variances[2] * outputs[2],
    }
    sigmas = noise.angle_random_walk, noise.velocity_random_walk, *np.sqrt(variances[1:]).tolist()
    return {
        name: ErrorPart(_root(covariance), sigma, dof)
        for (name, covariance), sigma, dof in zip(covariances.items(), sigmas, noise.dof, strict=True)
    }


def _root(covariance: FloatArray) -> FloatArray:
    variances, directions = np.linalg.eigh(covariance)
    return np.asarray(directions * np.sqrt(np.maximum(variances, 0.0)))


@compiled
def _backward(
    weights: FloatArray, gains: FloatArray, scales: FloatArray, transitions: FloatArray,
    walk_covariance: FloatArray, costate: FloatArray, walks: FloatArray, outputs: FloatArray,
) -> None:  # fmt: skip
    """Propagate the weights of a window's innovations back to the noise; changes the last three in place.

    ``weights`` (n, 3, 3), ``gains`` (n, 3, 6), ``scales`` (n, 3), ``transitions`` (n, 6, 6): see
    :class:`gyrobench.bench.bias.window_filter.FilteredEpochs`; ``walk_covariance`` (2, n, 6, 6): covariance
    that unit angle and velocity random walk add in the interval that ends at each epoch; ``costate`` (6, 3):
    error of the biases for a unit error of the state; ``walks`` (2, 3, 3), ``outputs`` (3, 3, 3): covariance
    of the biases for unit walks and for unit variance of each output.
    """
    by_datum = np.empty(3)
    carried = np.empty((STATES, 3))
    for k in range(len(weights) - 1, -1, -1):
        for m in range(2, -1, -1):
            h = MEASURED_STATES[m]
            for b in range(3):
                by_datum[b] = scales[k, m] * weights[k, m, b]
                for i in range(STATES):
                    by_datum[b] -= gains[k, m, i] * costate[i, b]
            for b in range(3):
                costate[h, b] += by_datum[b]
                for c in range(3):
                    outputs[m, b, c] += by_datum[b] * by_datum[c]
        for s in range(2):
            for i in range(STATES):
                for b in range(3):
                    carried[i, b] = 0.0
                    for j in range(STATES):
                        carried[i, b] += walk_covariance[s, k, i, j] * costate[j, b]
            for b in range(3):
                for c in range(3):
                    for i in range(STATES):
                        walks[s, b, c] += costate[i, b] * carried[i, c]
        for i in range(STATES):
            for b in range(3):
                carried[i, b] = 0.0
                for j in range(STATES):
                    carried[i, b] += transitions[k, j, i] * costate[j, b]
        for i in range(STATES):
            for b in range(3):
                costate[i, b] = carried[i, b]


_COMMON = [name for name, source in SOURCES.items() if source.is_common or name == "accelerometer_drift"]


@dataclass(frozen=True, eq=False)
class SplitError:
    """Error of the biases of the three gyros in a dwell, or of a mean of dwells."""

    #: Shape (3,). Variance due to sources independent from dwell to dwell, (deg/h)^2.
    own_variance: FloatArray
    #: Shape (3, s). Error for one standard uncertainty of each source that acts in all dwells, deg/h.
    common: FloatArray

    @classmethod
    def independent(cls, sigma_dph: Sequence[float]) -> SplitError:
        """Error without a common part."""
        return cls(np.array(sigma_dph) ** 2, np.zeros((3, 0)))


#: Errors by number of the dwell.
SplitErrors = Mapping[int, SplitError]


def split_errors(dwells: Mapping[int, Mapping[str, ErrorPart]]) -> dict[int, SplitError]:
    """Errors of dwells from their parts, both by number of the dwell."""
    common = shared_errors(dwells, _COMMON)
    independent = shared_errors(dwells, [name for name in SOURCES if name not in _COMMON])
    return {number: SplitError((independent[number] ** 2).sum(axis=1), common[number]) for number in dwells}


def mean_error(errors: Sequence[SplitError], weights: FloatArray) -> SplitError:
    """Error of a mean of m dwells with weights (m, 3) for each dwell and gyro, which add up to 1."""
    variance = sum(weight**2 * each.own_variance for weight, each in zip(weights, errors, strict=True))
    common = sum(weight[:, None] * each.common for weight, each in zip(weights, errors, strict=True))
    return SplitError(np.asarray(variance), np.asarray(common))


def scatter_variances(errors: Sequence[SplitError]) -> FloatArray:
    """Variances (c, 3) that errors add to the scatter of power cycles about their mean, (deg/h)^2.

    Common errors add only as far as they differ between the power cycles, two or more.
    """
    common = np.array([each.common for each in errors])
    differing = ((common - common.mean(axis=0)) ** 2).sum(axis=2) * len(errors) / (len(errors) - 1)
    return np.asarray(np.array([each.own_variance for each in errors]) + differing)
