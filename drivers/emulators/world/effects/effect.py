"""What all undeclared effects have in common."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from gyrobench.bench.foundations.arrays import FloatArray
from gyrobench.bench.foundations.documents import StrictModel


@dataclass(frozen=True, eq=False)
class Conditions:
    """What the gyros are exposed to at one moment.

    Attributes
    ----------
    time_s : float
        Since the world began.
    since_power_on_s : float or None
        Time that the unit has been on; None while it is off.
    optics_c, electronics_c : ndarray, shape (3,)
        Temperatures of each gyro.
    optics_rate_c_per_h : ndarray, shape (3,)
        Change of each gyro's optics in the last second.
    convected_w : ndarray, shape (3,)
        The part of the heat flow from electronics to optics that depends on attitude.
    up_body : ndarray, shape (3,)
        Up in body axes.
    compressor_duty : float
        Share of the time that the chamber's compressor runs.
    """

    time_s: float
    since_power_on_s: float | None
    optics_c: FloatArray
    electronics_c: FloatArray
    optics_rate_c_per_h: FloatArray
    convected_w: FloatArray
    up_body: FloatArray
    compressor_duty: float


#: Called once a second in the order of time: what an effect adds to the biases, deg/h, shape (3,).
BiasOverTime = Callable[[Conditions], FloatArray]


class Effect(StrictModel):
    """An effect as the world file describes it."""

    def begin(self) -> BiasOverTime:
        """Let the effect begin, with whatever it remembers; one without a memory just adds its bias."""
        return self.added_dph

    def added_dph(self, now: Conditions) -> FloatArray:
        """What the effect adds to the biases under such conditions, shape (3,)."""
        raise NotImplementedError(f"{type(self).__name__} has neither a bias to add nor a beginning")
