"""Effect of the resolution of the INS's output on a bias measurement.

The horizontal gyros' biases come from the second slope of velocity, half the difference between
the windows after and before the turn over g; the vertical gyro's is the mean of the two slopes of
the azimuth. Both slopes are least-squares fits over a window of length T with N epochs. A step q of the
output affects them in two ways:

* If the signal moves through many steps, as white noise of q / sqrt(12): the standard deviation of the
  second slope is ``sqrt(720 / N) sigma / T^2``, that of the first slope ``sqrt(12 / N) sigma / T``.
* In the worst case the rounding error is q / 2 at every epoch, with the sign of the fit's weights; the
  errors are then ``20 q / (sqrt(3) T^2)`` and ``3 q / (2 T)``. A unit at rest drifts through a few steps
  only, so this bound applies.

References
----------
Yu et al., "The Six-Position Calibration Technique of Gyro Bias for Rotational Inertial
Navigation System Based on Ring Laser Gyroscope", equation (10).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gyrobench.bench.foundations.arrays import DPH_TO_RADPS, STANDARD_GRAVITY
from gyrobench.drivers.ins.dbc_codec import DbcCodec
from gyrobench.drivers.ins.signal_map import BoundSignal, SignalMap, bind_signals

#: Largest bias difference between positions for a rotational INS of 1 nmi in 24 h.
LIMIT_DPH = 0.001
#: Length of each of the two windows.
_WINDOW_S = 600.0

_MAX_SPEED_MPS = 10.0
_FLOAT_TYPES: dict[int, type[np.floating]] = {16: np.float16, 32: np.float32, 64: np.float64}


@dataclass(frozen=True)
class ResolutionLimit:
    """Limit that the resolution of one output quantity sets to the bias computed from it."""

    quantity: str  #: Path in the signal map.
    signal: str
    lsb: float  #: Resolution of the quantity, in ``unit``.
    unit: str
    estimate: str  #: The gyro whose bias is computed from it.
    sigma_dph: float  #: Standard deviation of the bias if the rounding errors are independent.
    worst_dph: float  #: Largest possible error of the bias caused by rounding.

    @property
    def sufficient(self) -> bool:
        """Whether rounding can't cause an error above the limit."""
        return self.worst_dph <= LIMIT_DPH

    @property
    def text(self) -> str:
        """One sentence for the operator."""
        verdict = "sufficient" if self.sufficient else "too coarse"
        return (
            f"{self.quantity} ({self.signal}) has a resolution of {self.lsb:.3g} {self.unit}: {verdict} for "
            f"the bias of the {self.estimate}, which rounding changes by up to {self.worst_dph:.2g} deg/h "
            f"({self.sigma_dph:.2g} deg/h rms if the output dithers; limit {LIMIT_DPH:g} deg/h)."
        )


def resolution_report(signal_map: SignalMap, codec: DbcCodec) -> list[ResolutionLimit]:
    """Compute the limits set by the mapped velocity and azimuth, for two windows of ten minutes.

    Raises DocumentError if the signal map does not fit the DBC.
    """
    signals = bind_signals(signal_map, codec)
    samples = _WINDOW_S / signal_map.epoch_period_s
    limits = []

    def add(path: str, step: float, unit: str, estimate: str, errors_dph: tuple[float, float]) -> None:
        signal = f"{signals[path].message}.{signals[path].signal.name}"
        limits.append(ResolutionLimit(path, signal, step, unit, estimate, *errors_dph))

    for path, estimate in (("velocity_east", "gyro along North"), ("velocity_north", "gyro along East")):
        step_mps = _step(signals[path], _MAX_SPEED_MPS)
        errors = horizontal_gyro_errors_dph(step_mps, _WINDOW_S, samples)
        add(path, step_mps, "m/s", estimate, errors)
    path, step_rad = _azimuth(signal_map, signals)
    errors = vertical_gyro_errors_dph(step_rad, _WINDOW_S, samples)
    add(path, float(np.degrees(step_rad)), "deg", "vertical gyro", errors)
    return limits


def horizontal_gyro_errors_dph(step_mps: float, window_s: float, samples: float) -> tuple[float, float]:
    """Compute standard deviation and bound of a horizontal gyro's bias for a velocity step, deg/h."""
    sigma = np.sqrt(720.0 / samples) * step_mps / np.sqrt(12.0) / window_s**2
    worst = 20.0 * step_mps / (np.sqrt(3.0) * window_s**2)
    scale = 1.0 / STANDARD_GRAVITY / DPH_TO_RADPS
    return float(sigma / np.sqrt(2.0) * scale), float(worst * scale)


def vertical_gyro_errors_dph(step_rad: float, window_s: float, samples: float) -> tuple[float, float]:
    """Compute standard deviation and bound of the vertical gyro's bias for an azimuth step, deg/h."""
    sigma = np.sqrt(12.0 / samples) * step_rad / np.sqrt(12.0) / window_s
    worst = 1.5 * step_rad / window_s
    return float(sigma / np.sqrt(2.0) / DPH_TO_RADPS), float(worst / DPH_TO_RADPS)


def _azimuth(signal_map: SignalMap, signals: dict[str, BoundSignal]) -> tuple[str, float]:
    """Path and angular step of the quantity that carries the azimuth."""
    if signal_map.attitude.euler is not None:
        return "attitude.euler.yaw", _step(signals["attitude.euler.yaw"], np.pi)
    parts = {path: _step(signals[path], 1.0) for path in signals if path.startswith("attitude.quaternion.")}
    coarsest = max(parts, key=parts.__getitem__)
    # An azimuth is twice the angle of two components; both errors can add up.
    return coarsest, 2.0 * np.sqrt(2.0) * parts[coarsest]


def _step(bound: BoundSignal, largest: float) -> float:
    """Resolution in SI; for a floating-point signal, that at its ``largest`` value in SI."""
    if not bound.signal.conversion.is_float:
        return bound.lsb
    per_bit = abs(bound.signal.scale * bound.gain)
    return float(np.spacing(_FLOAT_TYPES[bound.signal.length](largest / per_bit))) * per_bit
