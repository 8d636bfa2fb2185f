"""Bias that follows a temperature which lags behind the measured one: the sensor is elsewhere."""

from __future__ import annotations

from gyrobench.bench.closure.effects.effect import time_constant
from gyrobench.bench.closure.effects.grammar import Law, effect_of

_TAU = time_constant(1.0, 300.0, 900.0, 2700.0, 7200.0)

EFFECT = effect_of(
    Law("gyro_c", memory="decay", parameters=(_TAU,)),
    name="thermal_lag",
    statement="the bias follows a temperature that lags behind the measured one",
    experiment=(
        "step the temperature once and soak: the bias settles a time constant later than the sensor; a "
        "second sensor closer to the cavity shows the lag directly"
    ),
    terms=("sensor ahead of the lagging temperature, K",),
    imitated_by=("thermal_gradient",),
)
