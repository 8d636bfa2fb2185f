"""All undeclared effects of a world together."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated

import numpy as np
from pydantic import Field

from gyrobench.bench.foundations.arrays import FloatArray
from gyrobench.drivers.emulators.world.effects.effect import Conditions, Effect
from gyrobench.drivers.emulators.world.effects.elapsed_time import BiasJump, SupplyRipple, TimeDrift, WarmUp
from gyrobench.drivers.emulators.world.effects.hysteresis import ThermalHysteresis
from gyrobench.drivers.emulators.world.effects.ring import DitherCrossing, ModeHop
from gyrobench.drivers.emulators.world.effects.surroundings import ChamberState, GSensitivity
from gyrobench.drivers.emulators.world.effects.temperature import (
    AttitudeThermal,
    TemperatureRate,
    ThermalGradient,
)

#: One entry of a world file's ``undeclared_effects``.
UndeclaredEffect = Annotated[
    TemperatureRate
    | ThermalGradient
    | AttitudeThermal
    | ThermalHysteresis
    | WarmUp
    | TimeDrift
    | BiasJump
    | SupplyRipple
    | GSensitivity
    | ChamberState
    | ModeHop
    | DitherCrossing,
    Field(discriminator="kind"),
]


class UndeclaredBias:
    """What all effects together add to the gyro biases.

    Parameters
    ----------
    effects : sequence of Effect
        They add up, two of one kind as well.
    """

    def __init__(self, effects: Sequence[Effect]) -> None:
        self._effects = [effect.begin() for effect in effects]

    def added_dph(self, now: Conditions) -> FloatArray:
        """Sum of all effects, deg/h, shape (3,); to be called once a second in the order of time."""
        return np.sum([effect(now) for effect in self._effects], axis=0) if self._effects else np.zeros(3)
