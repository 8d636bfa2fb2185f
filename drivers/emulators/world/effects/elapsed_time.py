"""Effects of the time that has passed, on the calendar or since the unit was switched on."""

from __future__ import annotations

import math
from typing import Literal

import numpy as np
from pydantic import Field
from typing_extensions import override

from gyrobench.bench.foundations.arrays import FloatArray
from gyrobench.drivers.emulators.world.effects.effect import Conditions, Effect
from gyrobench.drivers.emulators.world.quantities import NotNegative, Positive, Vector

_HOUR_S, _DAY_S = 3600.0, 86_400.0


class WarmUp(Effect):
    """A bias that dies away after each power-on."""

    kind: Literal["warm_up"] = Field(description="name of the effect")
    bias_dph: Vector = Field(description="bias at power-on of each gyro, deg/h")
    time_constant_s: Positive = Field(description="time in which it falls to 37 %, s")

    @override
    def added_dph(self, now: Conditions) -> FloatArray:
        if now.since_power_on_s is None:
            return np.zeros(3)
        return np.array(self.bias_dph) * math.exp(-now.since_power_on_s / self.time_constant_s)


class TimeDrift(Effect):
    """Biases that drift steadily from the world's beginning, as the gyros age."""

    kind: Literal["time_drift"] = Field(description="name of the effect")
    drift_dph_per_day: Vector = Field(description="drift of each gyro, deg/h per day")

    @override
    def added_dph(self, now: Conditions) -> FloatArray:
        return np.array(self.drift_dph_per_day) * now.time_s / _DAY_S


class BiasJump(Effect):
    """Biases that change at one moment, counted from the world's beginning, and stay changed."""

    kind: Literal["bias_jump"] = Field(description="name of the effect")
    bias_dph: Vector = Field(description="jump of each gyro, deg/h")
    at_h: NotNegative = Field(description="when, from the beginning of the world, h")

    @override
    def added_dph(self, now: Conditions) -> FloatArray:
        return np.array(self.bias_dph) * (now.time_s >= self.at_h * _HOUR_S)


class SupplyRipple(Effect):
    """Biases that swing with the mains supply, which follows the load of a building over the hours."""

    kind: Literal["supply_ripple"] = Field(description="name of the effect")
    amplitude_dph: Vector = Field(description="amplitude of each gyro, deg/h")
    period_h: Positive = Field(description="period, h")
    phase_deg: float = Field(default=0.0, description="phase at the beginning, deg")

    @override
    def added_dph(self, now: Conditions) -> FloatArray:
        phase = math.tau * now.time_s / (self.period_h * _HOUR_S) + math.radians(self.phase_deg)
        return np.array(self.amplitude_dph) * math.sin(phase)
