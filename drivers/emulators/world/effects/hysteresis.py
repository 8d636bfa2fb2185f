"""Thermal hysteresis: the bias remembers from where a temperature was reached."""

from __future__ import annotations

from typing import Literal

import numpy as np
from pydantic import Field
from typing_extensions import override

from gyrobench.bench.foundations.arrays import FloatArray
from gyrobench.drivers.emulators.world.effects.effect import BiasOverTime, Conditions, Effect
from gyrobench.drivers.emulators.world.quantities import Positive, Vector


class ThermalHysteresis(Effect):
    """A part with friction follows the temperature of each gyro's optics with play.

    The bias follows how far that part is ahead of the temperature: the half width after enough
    cooling, minus the half width after enough heating, whatever the rate, and at rest too.
    """

    kind: Literal["thermal_hysteresis"] = Field(description="name of the effect")
    half_width_c: Positive = Field(description="half of the play, K")
    sensitivity_dph_per_c: Vector = Field(description="bias of each gyro per kelvin of play used, deg/h/K")

    @override
    def begin(self) -> BiasOverTime:
        return _Play(self.half_width_c, np.array(self.sensitivity_dph_per_c))


class _Play:
    """The play operator, without stress at the first temperature that it sees."""

    def __init__(self, half_width_c: float, sensitivity_dph_per_c: FloatArray) -> None:
        self._half_width_c = half_width_c
        self._sensitivity_dph_per_c = sensitivity_dph_per_c
        self._follower_c: FloatArray | None = None

    def __call__(self, now: Conditions) -> FloatArray:
        before_c = now.optics_c if self._follower_c is None else self._follower_c
        low_c, high_c = now.optics_c - self._half_width_c, now.optics_c + self._half_width_c
        self._follower_c = np.minimum(np.maximum(before_c, low_c), high_c)
        return np.asarray(self._sensitivity_dph_per_c * (self._follower_c - now.optics_c))
