"""Bias that depends on the direction from which a temperature was reached: play between two bounds."""

from __future__ import annotations

from gyrobench.bench.closure.effects.effect import Parameter, fixed
from gyrobench.bench.closure.effects.grammar import Law, effect_of

_HALF_WIDTH = Parameter("half_width_c", 0.3, 40.0, fixed(1.0, 2.0, 4.0, 7.0, 12.0, 20.0))

EFFECT = effect_of(
    Law("gyro_c", memory="play", parameters=(_HALF_WIDTH,)),
    name="thermal_hysteresis",
    statement="the bias depends on whether a temperature was reached from above or below, at any rate",
    experiment=(
        "reach one temperature from above and from below and soak for hours: a lag decays, hysteresis "
        "remains; small temperature loops show its width"
    ),
    terms=("play behind the temperature, K",),
)
