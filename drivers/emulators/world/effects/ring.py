"""Effects inside the laser gyros that are narrow in temperature."""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from pydantic import AfterValidator, Field
from typing_extensions import override

from gyrobench.bench.foundations.arrays import FloatArray
from gyrobench.drivers.emulators.world.effects.effect import Conditions, Effect
from gyrobench.drivers.emulators.world.quantities import Positive, Vector


class ModeHop(Effect):
    """The path length control moves its mirrors back by one mode at every so many kelvin.

    Modes of even and odd number see the mirrors differently: the bias is there in every second one,
    first from the first reset up.
    """

    kind: Literal["mode_hop"] = Field(description="name of the effect")
    bias_dph: Vector = Field(description="bias of each gyro in every second mode, deg/h")
    first_reset_c: float = Field(description="temperature of the first change of mode, degC")
    reset_every_c: Positive = Field(description="kelvin between changes of mode")

    @override
    def added_dph(self, now: Conditions) -> FloatArray:
        mode = np.floor((now.optics_c - self.first_reset_c) / self.reset_every_c)
        return np.asarray(np.array(self.bias_dph) * (mode % 2.0 == 0.0))


def _two_gyros(names: list[str]) -> list[str]:
    if len(set(names)) != 2:
        raise ValueError("two different gyros are needed, as in [x, y]")
    return names


class DitherCrossing(Effect):
    """At one temperature two gyros dither at the same frequency and drive each other.

    The frequencies part in proportion to the mean temperature of both gyros' optics, so the biases
    are a resonance line over it.
    """

    kind: Literal["dither_crossing"] = Field(description="name of the effect")
    gyros: Annotated[
        list[Literal["x", "y", "z"]], Field(min_length=2, max_length=2), AfterValidator(_two_gyros)
    ] = Field(description="the two")
    crossing_c: float = Field(description="mean temperature at which both dither alike, degC")
    half_width_c: Positive = Field(description="half width of the resonance, K")
    bias_dph: Annotated[list[float], Field(min_length=2, max_length=2)] = Field(
        description="bias of each of the two at the crossing, deg/h"
    )

    @override
    def added_dph(self, now: Conditions) -> FloatArray:
        pair = ["xyz".index(gyro) for gyro in self.gyros]
        detuning = (now.optics_c[pair].mean() - self.crossing_c) / self.half_width_c
        added_dph = np.zeros(3)
        added_dph[pair] = np.array(self.bias_dph) / (1.0 + detuning**2)
        return added_dph
