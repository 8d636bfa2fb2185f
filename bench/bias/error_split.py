"""The error of a dwell's biases split over its independent sources, with the gains of the estimator fixed.

The estimate is linear: the bias's error is the sum of what each noise source and each part of the prior
knowledge contributes by the estimator's gains, so the covariances of the parts add up to that of the estimate
(Joseph's form). The part of the prior knowledge follows from the normal equations. For that of the noise one
backward pass of the whitening filter carries the weights of all innovations to the noise of each interval and
each output.

An error that acts alike in several dwells moves their biases together. In all power cycles it does not show
in their scatter: to subtract it from the scatter as noise would hide what the gyros do from one power cycle
to the next. The drift of accelerometers counts as such an error there, although it is independent from dwell
to dwell otherwise: power cycles are measured as long after power-on, where accelerometers that warm up drift
alike.
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
from gyrobench.bench.bias.noise_model import NoiseModel
from gyrobench.bench.bias.parameters import PriorKnowledge
from gyrobench.bench.bias.window_filter import DATA, MEASURED_STATES, WindowFilter
from gyrobench.bench.foundations.arrays import RADPS_TO_DPH, FloatArray, IntArray
from gyrobench.bench.foundations.kernels import compiled
from gyrobench.bench.navigation.error_model import STATES, Site, unit_walks


@dataclass(frozen=True, eq=False)
class ErrorPart:
    """Error of the biases of the x, y and z gyro by one source."""

    #: Shape (3, m). By one standard deviation of each of m independent components, rad/s.
    columns: FloatArray
    sigma: float  #: Standard uncertainty of each component, SI.
    dof: float = math.inf  #: Its degrees of freedom; infinite where it is declared.

    def scaled(self, factors: FloatArray) -> ErrorPart:
        """The same with the error of each gyro multiplied by a factor (3,)."""
        return replace(self, columns=self.columns * factors[:, np.newaxis])


#: Errors (3, s) of the biases of the x, y and z gyro in a dwell by each of s independent sources that act in
#: all dwells, deg/h, by number of the dwell.
SharedErrors = Mapping[int, FloatArray]
NONE_SHARED: SharedErrors = MappingProxyType({})


def shared_errors(dwells: Mapping[int, Mapping[str, ErrorPart]], sources: Iterable[str]) -> SharedErrors:
    """Errors by these sources, from the parts of each dwell by its number."""
    columns: dict[int, list[FloatArray]] = {number: [] for number in dwells}
    for source in sources:
        own = {number: parts[source].columns for number, parts in dwells.items() if source in parts}
        width = max((each.shape[1] for each in own.values()), default=0)
        for number, of_dwell in columns.items():
            found = own.get(number, np.zeros((3, 0)))
            of_dwell.append(np.pad(found, ((0, 0), (0, width - found.shape[1]))))
    return {number: RADPS_TO_DPH * np.hstack(each) for number, each in columns.items()}


class ErrorParts(Mapping[str, ErrorPart]):
    """The parts by source, in two arrays: a run keeps those of all its dwells."""

    __slots__ = ("_columns", "_places", "_scalars")

    def __init__(self, parts: Mapping[str, ErrorPart]) -> None:
        self._places = _places(tuple((name, part.columns.shape[1]) for name, part in parts.items()))
        self._columns = np.hstack([part.columns for part in parts.values()])
        self._scalars = np.array([(part.sigma, part.dof) for part in parts.values()])

    def __getitem__(self, name: str) -> ErrorPart:
        number, columns = self._places[name]
        sigma, dof = self._scalars[number].tolist()
        return ErrorPart(self._columns[:, columns], sigma, dof)

    def __iter__(self) -> Iterator[str]:
        return iter(self._places)

    def __len__(self) -> int:
        return len(self._places)


@lru_cache(maxsize=16)
def _places(sizes: tuple[tuple[str, int], ...]) -> Mapping[str, tuple[int, slice]]:
    """Number and columns of each part of some sizes; all dwells with the same parts share them."""
    ends = itertools.accumulate(size for _, size in sizes)
    return {
        name: (number, slice(end - size, end))
        for number, ((name, size), end) in enumerate(zip(sizes, ends, strict=True))
    }


def prior_parts(
    response: FloatArray, prior: PriorKnowledge, shown: FloatArray, windows: int
) -> dict[str, ErrorPart]:
    """Errors by prior knowledge.

    Parameters
    ----------
    response : ndarray, shape (3, p)
        Error of the biases for one standard deviation of each independent part of the prior knowledge.
    shown : ndarray, shape (p,)
        1 for each parameter that is estimated, 0 for those that count as zero.
    windows : int
        Number of windows.
    """
    matrix = np.arange(parameters.GYRO_MATRIX.start, parameters.GYRO_MATRIX.stop)
    scale_factors = matrix[:: 3 + 1]
    own = parameters.COMMON + parameters.PER_WINDOW * np.arange(windows)
    per_window = np.arange(parameters.PER_WINDOW)
    settling = parameters.transients(windows)
    places: dict[str, tuple[slice | IntArray, float]] = {
        "accelerometer_bias": (parameters.ACCELEROMETER_BIAS, prior.accelerometer_bias),
        "accelerometer_drift": (parameters.ACCELEROMETER_DRIFT, prior.accelerometer_drift),
        "accelerometer_slope": (parameters.ACCELEROMETER_SLOPE, prior.accelerometer_slope),
        "gyro_scale_factor": (scale_factors, prior.gyro_scale_factor),
        "gyro_misalignment": (np.setdiff1d(matrix, scale_factors), prior.gyro_misalignment),
        "tilt_step": (np.add.outer(own[1:], per_window[parameters.ATTITUDE]).ravel(), prior.tilt_step),
        "latitude": (parameters.NAVIGATION_RATE, prior.latitude),
        "bias_slope": (parameters.GYRO_SLOPE, prior.bias_slope),
    }
    if len(settling) and shown[settling].any():
        places["accelerometer_settling"] = settling, prior.accelerometer_transient
    named = np.zeros(response.shape[1], dtype=bool)
    for place, _ in places.values():
        named[place] = True
    parts = {name: ErrorPart(response[:, place], sigma) for name, (place, sigma) in places.items()}
    others = response[:, ~named]
    return parts | {"initial_state": ErrorPart(_root(others @ others.T), math.nan)}


def noise_parts(
    windows: Sequence[WindowFilter],
    changes: Sequence[WindowChange],
    expansions: Sequence[FloatArray],
    gain: FloatArray,
    site: Site,
    noise: NoiseModel,
) -> dict[str, ErrorPart]:
    """Errors by the noise of gyros, accelerometers and outputs.

    Parameters
    ----------
    windows, changes : sequences of WindowFilter and WindowChange
        All windows of the dwell, and from each to the next.
    expansions : sequence of ndarray, shape (c, p)
        Each column of a window for a unit of each parameter.
    gain : ndarray, shape (p, 3)
        Covariance of the parameters with the biases.
    """
    walks, outputs, costate = np.zeros((2, 3, 3)), np.zeros((3, 3, 3)), np.zeros((STATES, 3))
    for number in reversed(range(len(windows))):
        epochs = windows[number].epochs_filtered
        durations = np.diff(epochs.time_s, prepend=epochs.time_s[0])
        by_walk = unit_walks(site, durations)
        # What the white innovations count in the biases.
        weights = epochs.rows[:, :, :DATA] @ (expansions[number] @ gain[: expansions[number].shape[1]])
        _backward(
            weights, epochs.gains, epochs.scales, epochs.transition, by_walk,
            costate, walks, outputs,
        )  # fmt: skip
        if number:
            walks += costate.T @ changes[number - 1].by_walk @ costate
            costate = np.ascontiguousarray(changes[number - 1].transition.T @ costate)
    variances = windows[0].output_variances
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
    weights: FloatArray, gains: FloatArray, scales: FloatArray, transitions: FloatArray, by_walk: FloatArray,
    costate: FloatArray, walks: FloatArray, outputs: FloatArray,
) -> None:  # fmt: skip
    """Carry the weights of a window's innovations back to the noise; changes the last three in place.

    Parameters
    ----------
    weights, gains, scales, transitions : ndarray, shape (n, 3, 3), (n, 3, 6), (n, 3), (n, 6, 6)
        See :class:`gyrobench.bench.bias.window_filter.EpochsFiltered`.
    by_walk : ndarray, shape (2, n, 6, 6)
        Covariance that unit angle and velocity random walk add in the interval that leads to each epoch.
    costate : ndarray, shape (6, 3)
        Error of the biases for a unit error of the state.
    walks, outputs : ndarray, shape (2, 3, 3), (3, 3, 3)
        Covariance of the biases for unit walks and for unit variance of each output.
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
                        carried[i, b] += by_walk[s, k, i, j] * costate[j, b]
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

    own: FloatArray  #: Shape (3,). Variance by what is independent from dwell to dwell, (deg/h)^2.
    #: Shape (3, s). By one standard uncertainty of each of the sources that act in all dwells, deg/h.
    common: FloatArray

    @classmethod
    def independent(cls, sigma_dph: Sequence[float]) -> SplitError:
        """Error without a part in common."""
        return cls(np.array(sigma_dph) ** 2, np.zeros((3, 0)))


#: By number of the dwell.
SplitErrors = Mapping[int, SplitError]


def split_errors(dwells: Mapping[int, Mapping[str, ErrorPart]]) -> dict[int, SplitError]:
    """Errors of dwells from their parts."""
    common = shared_errors(dwells, _COMMON)
    own = shared_errors(dwells, [name for name in SOURCES if name not in _COMMON])
    return {number: SplitError((own[number] ** 2).sum(axis=1), common[number]) for number in dwells}


def mean_error(errors: Sequence[SplitError], weights: FloatArray) -> SplitError:
    """Error of a mean with weights (m, 3) for each dwell and gyro, which add up to 1."""
    own = sum(weight**2 * each.own for weight, each in zip(weights, errors, strict=True))
    common = sum(weight[:, None] * each.common for weight, each in zip(weights, errors, strict=True))
    return SplitError(np.asarray(own), np.asarray(common))


def scatter_variances(errors: Sequence[SplitError]) -> FloatArray:
    """Variances (c, 3) that errors add to the scatter of power cycles about their mean, (deg/h)^2.

    Of the errors in common it is what differs between the power cycles, two or more.
    """
    common = np.array([each.common for each in errors])
    differing = ((common - common.mean(axis=0)) ** 2).sum(axis=2) * len(errors) / (len(errors) - 1)
    return np.asarray(np.array([each.own for each in errors]) + differing)
