"""Noise model of the INS, and variances of estimates that are linear in velocity and heading.

The noise of the sensors is integrated in the output of an INS at rest: angle random walk makes the attitude
drift, the tilt accelerates the velocity, and the Earth's curvature feeds the velocity back into the tilt with
the Schuler frequency. Neighbouring epochs are therefore strongly correlated, and the textbook formula for the
scatter of a fitted slope is far too small. Here the variance of ``sum_k w_k y(t_k)`` is summed over the noise
of every interval between epochs: a unit step of gyro angle at s changes the velocity at t by
``g sin(W (t - s)) / W``, a unit step of velocity changes it by ``cos(W (t - s))``, with ``W = sqrt(g / R)``.
Earth-rate coupling, which changes a standard deviation by 3 % over two windows of 10 min, and the noise of
the alignment are neglected.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from gyrobench.bench.foundations.arrays import DEG_PER_SQRT_H_TO_SI, UG_PER_SQRT_HZ_TO_SI, FloatArray
from gyrobench.bench.foundations.errors import DocumentError
from gyrobench.bench.navigation.earth import MEAN_RADIUS

#: Share of the epochs with equal values whose rounding errors are equal. While the true value moves through
#: a step, its rounding error changes sign. With this share, the errors of all biases in simulated dwells
#: with 2 to 300 equal epochs are within 1.3 standard uncertainties, rms.
_EQUAL_ERROR_SHARE = 1.0 / 4.0


def rounding_sigma(step: float, repeats: float) -> float:
    """Standard uncertainty of an epoch's value due to rounding to steps of this size.

    ``repeats``: mean number of neighbouring epochs with the same value. Their rounding errors are alike,
    which raises the uncertainty of each.
    """
    return step / math.sqrt(12.0) * math.sqrt(max(1.0, repeats * _EQUAL_ERROR_SHARE))


@dataclass(frozen=True)
class NoiseModel:
    """Noise of the INS, equal for all axes; declared, or estimated from its output.

    Raises DocumentError if a value is out of range.
    """

    angle_random_walk: float  #: White noise of the gyro rates, rad/sqrt(s); above zero.
    velocity_random_walk: float = 0.0  #: White noise of the accelerations, m/s/sqrt(s).
    velocity_white: float = 0.0  #: Noise of each velocity output, independent from epoch to epoch, m/s.
    heading_white: float = 0.0  #: The same of the attitude outputs, rad.
    #: Degrees of freedom of these four values; infinite if declared.
    dof: tuple[float, float, float, float] = (math.inf,) * 4

    def __post_init__(self) -> None:
        for field in fields(self)[:4]:
            value = getattr(self, field.name)
            if not (np.isfinite(value) and value >= 0.0):
                raise DocumentError(f"noise of the INS: {field.name} must not be negative; found {value}")
        if self.angle_random_walk == 0.0:
            raise DocumentError("noise of the INS: the angle random walk must be above zero")

    @classmethod
    def from_datasheet(
        cls,
        arw_deg_per_sqrt_h: float,
        vrw_ug_per_sqrt_hz: float = 0.0,
        velocity_lsb_mps: float = 0.0,
        heading_lsb_rad: float = 0.0,
        velocity_output_mps: float = 0.0,
        heading_output_rad: float = 0.0,
    ) -> NoiseModel:
        """Make the model from values in the units of data sheets.

        The noise of an output is added to that of its resolution (LSB^2/12). Rounding is white only if the
        output changes by more than one LSB from epoch to epoch, or has noise of that size; with a coarser
        resolution the variance is a lower bound.
        """
        return cls(
            arw_deg_per_sqrt_h * DEG_PER_SQRT_H_TO_SI,
            vrw_ug_per_sqrt_hz * UG_PER_SQRT_HZ_TO_SI,
            float(np.hypot(velocity_lsb_mps / np.sqrt(12.0), velocity_output_mps)),
            float(np.hypot(heading_lsb_rad / np.sqrt(12.0), heading_output_rad)),
        )

    def at_least(self, velocity_white: float, heading_white: float) -> NoiseModel:
        """Model with noise of the outputs at least these values, m/s and rad, which count as declared."""
        if self.velocity_white >= velocity_white and self.heading_white >= heading_white:
            return self
        arw_dof, vrw_dof, velocity_dof, heading_dof = self.dof
        return NoiseModel(
            self.angle_random_walk,
            self.velocity_random_walk,
            max(self.velocity_white, velocity_white),
            max(self.heading_white, heading_white),
            (
                arw_dof,
                vrw_dof,
                velocity_dof if self.velocity_white > velocity_white else math.inf,
                heading_dof if self.heading_white > heading_white else math.inf,
            ),
        )

    def velocity_variance(self, time: FloatArray, weights: FloatArray, gravity: float) -> FloatArray:
        """Variance of weighted sums of one horizontal velocity, () or (m,).

        ``time`` (n,): epochs, s; there may be a gap during a turn. Noise before the first epoch is not
        included, so the weights of the first window must not respond to a constant and a slope. ``weights``
        (n,) or (n, m): of each epoch, for m sums; ``gravity`` in m/s^2.
        """
        rate = np.sqrt(gravity / MEAN_RADIUS)
        tails = _tails(time, weights, rate)
        walk = np.diff(time) @ (
            (self.angle_random_walk * gravity / rate * tails.imag) ** 2
            + (self.velocity_random_walk * tails.real) ** 2
        )
        return np.asarray(walk + self.velocity_white**2 * (weights**2).sum(axis=0))

    def heading_variance(self, time: FloatArray, weights: FloatArray) -> FloatArray:
        """Variance of weighted sums of the heading; parameters as for the velocity."""
        walk = np.diff(time) @ (self.angle_random_walk * _tails(time, weights, 0.0).real) ** 2
        return np.asarray(walk + self.heading_white**2 * (weights**2).sum(axis=0))


def _tails(time: FloatArray, weights: FloatArray, rate: float) -> NDArray[np.complex128]:
    """Compute ``sum over t_k > s of w_k exp(i rate (t_k - s))`` for the middle s of each interval.

    There, the noise of the interval is assumed to act.
    """
    middles = 0.5 * (time[:-1] + time[1:])
    column = (slice(None),) + (None,) * (weights.ndim - 1)
    weighted = weights * np.exp(1j * rate * (time - time[0]))[column]
    tails = np.cumsum(weighted[:0:-1], axis=0)[::-1]
    return np.asarray(tails * np.exp(-1j * rate * (middles - time[0]))[column])
