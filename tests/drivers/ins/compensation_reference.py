"""What an INS subtracts by a compensation, from the equation of gyrobench.drivers.ins.compensation."""

import itertools
from dataclasses import dataclass

import numpy as np
from scipy.special import expit

from gyrobench.bench.foundations.arrays import FloatArray
from gyrobench.drivers.ins.compensation import Compensation

_DIFFERENCE = {"difference_low_k": np.full(3, 2.0), "difference_high_k": np.full(3, 60.0)}
_ONSET = {"onset_c": np.array([30.0, 25.0, 20.0]), "onset_width_c": np.array([4.0, 5.0, 6.0]), **_DIFFERENCE}
_VECTORS = np.array([[0.1, -0.2, 0.3], [-0.4, 0.5, -0.6], [0.7, -0.8, 0.9]])

#: Numbers of each term, all different from zero.
TERM_NUMBERS = {
    "polynomial": {
        "polynomial_dph": np.array([[0.5, -0.02, 3e-4, 1e-6], [-0.5, 0, 0, 1e-6], [0, 0.01, 0, 0]])
    },
    "temperature_rate": {
        "rate_dph_per_c_per_h": np.array([0.02, -0.01, 0.03]),
        "rate_limit_c_per_h": np.full(3, 90.0),
    },
    "thermal_gradient": {"gradient_dph_per_k": np.array([0.02, -0.01, 0.03]), **_DIFFERENCE},
    "attitude_thermal": {"saturating_dph_per_k": 0.1 * _VECTORS, **_ONSET},
    "attitude_thermal_growing": {"growing_dph_per_k": 0.01 * _VECTORS, **_ONSET},
    "g_sensitivity": {"gravity_dph_per_g": _VECTORS},
    "warm_up": {"warm_up_dph": np.array([0.5, -0.4, 0.3]), "warm_up_s": np.array([1800.0, 3600.0, 900.0])},
    "thermal_hysteresis": {
        "hysteresis_dph_per_k": np.array([0.1, -0.2, 0.3]),
        "half_width_k": np.array([3.0, 4.0, 100.0]),
    },
}


@dataclass(frozen=True, eq=False)
class Conditions:
    """What a unit goes through from power-on, in the order of time."""

    optics_c: FloatArray  #: Shape (n, 3), as the next two. Temperature of each gyro's optics.
    board_c: FloatArray  #: Temperature of each gyro's electronics.
    rate_c_per_h: FloatArray  #: Rate of the optics' temperatures.
    up_body: FloatArray  #: Shape (n, 3). Unit vector Up in body axes.
    since_power_on_s: FloatArray  #: Shape (n,).


def compensated_dph(compensation: Compensation, conditions: Conditions) -> FloatArray:
    """Bias that is subtracted, shape (n, 3); the play begins with the first row."""
    T = np.clip(conditions.optics_c, compensation.low_c, compensation.high_c)
    hotter_k = np.clip(
        conditions.board_c - conditions.optics_c,
        compensation.difference_low_k,
        compensation.difference_high_k,
    )
    rate = np.clip(conditions.rate_c_per_h, -compensation.rate_limit_c_per_h, compensation.rate_limit_c_per_h)
    t = conditions.since_power_on_s[:, np.newaxis]
    polynomial = sum(c * T**degree for degree, c in enumerate(compensation.polynomial_dph.T))
    # Where a width or a time constant is zero its term is not used.
    width_c = np.where(compensation.onset_width_c > 0.0, compensation.onset_width_c, 1.0)
    tau_s = np.where(compensation.warm_up_s > 0.0, compensation.warm_up_s, 1.0)
    cold = (compensation.onset_c - T) / width_c
    attitude = expit(cold) * (conditions.up_body @ compensation.saturating_dph_per_k.T)
    attitude += np.logaddexp(0.0, cold) * (conditions.up_body @ compensation.growing_dph_per_k.T)
    return np.asarray(
        polynomial
        + compensation.rate_dph_per_c_per_h * rate
        + (compensation.gradient_dph_per_k + attitude) * hotter_k
        + conditions.up_body @ compensation.gravity_dph_per_g.T
        + compensation.warm_up_dph * np.exp(-t / tau_s)
        + compensation.hysteresis_dph_per_k * (play(T, compensation.half_width_k) - T)
    )


def play(values: FloatArray, half_width: FloatArray) -> FloatArray:
    """Follow a course with slack on either side: what a pointer does that has play.

    ``values`` (n, 3): in the order of time; the pointer begins at the first one; ``half_width`` (3,). Returns
    the pointer (n, 3), never farther than the half width from the value.
    """
    pointer = np.array(values, dtype=np.float64)
    for before, now in itertools.pairwise(pointer):
        np.clip(before, now - half_width, now + half_width, out=now)
    return pointer
