"""Effects of the unit's temperatures, as they are at the moment and as they change."""

from __future__ import annotations

from typing import Literal

import numpy as np
from pydantic import Field
from typing_extensions import override

from gyrobench.bench.foundations.arrays import FloatArray
from gyrobench.drivers.emulators.world.effects.effect import Conditions, Effect
from gyrobench.drivers.emulators.world.quantities import Positive, Vector


class TemperatureRate(Effect):
    """The bias follows how fast the optics of each gyro change their temperature."""

    kind: Literal["temperature_rate"] = Field(description="name of the effect")
    sensitivity_dph_per_c_per_h: Vector = Field(
        description="bias of each gyro per rate of its optics, deg/h per K/h"
    )

    @override
    def added_dph(self, now: Conditions) -> FloatArray:
        return np.array(self.sensitivity_dph_per_c_per_h) * now.optics_rate_c_per_h


class ThermalGradient(Effect):
    """The bias follows how much hotter the electronics of each gyro are than its optics."""

    kind: Literal["thermal_gradient"] = Field(description="name of the effect")
    sensitivity_dph_per_c: Vector = Field(
        description="bias of each gyro per kelvin of electronics above optics, deg/h/K"
    )

    @override
    def added_dph(self, now: Conditions) -> FloatArray:
        return np.array(self.sensitivity_dph_per_c) * (now.electronics_c - now.optics_c)


class AttitudeThermal(Effect):
    """Heat that convection carries from the electronics to one side of the optics.

    The bias follows that part of the heat flow that depends on the direction of gravity, the
    more the colder the optics are below the onset.
    """

    kind: Literal["attitude_thermal"] = Field(description="name of the effect")
    sensitivity_dph_per_w: Vector = Field(
        description="bias of each gyro per watt of heat that depends on attitude, deg/h/W"
    )
    onset_c: Positive = Field(default=50.0, description="below this the effect grows, degC")
    onset_width_c: Positive = Field(default=2.0, description="width of the onset, K")

    @override
    def added_dph(self, now: Conditions) -> FloatArray:
        below = (self.onset_c - now.optics_c) / self.onset_width_c
        onset = np.logaddexp(0.0, below) * self.onset_width_c / self.onset_c
        return np.asarray(np.array(self.sensitivity_dph_per_w) * now.convected_w * onset)
