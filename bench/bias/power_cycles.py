"""Errors that biases of several power cycles have in common, and those that make them scatter.

An error that acts alike in all power cycles, such as a latitude that is off, moves their biases together:
their scatter does not contain it. To subtract it from the scatter as noise would hide what the gyros do from
one power cycle to the next. The drift of accelerometers counts as such an error here, although it is
independent from dwell to dwell otherwise: power cycles are measured as long after power-on, where
accelerometers that warm up drift alike.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from gyrobench.bench.bias.error_sources import SOURCES
from gyrobench.bench.bias.error_split import ErrorPart, shared_errors
from gyrobench.bench.foundations.arrays import FloatArray

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
