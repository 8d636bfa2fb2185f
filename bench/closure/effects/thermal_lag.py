"""Bias that follows a temperature which lags behind the measured one: the sensor is elsewhere."""

from __future__ import annotations

from gyrobench.bench.closure.effects.effect import Parameter, fixed
from gyrobench.bench.closure.effects.grammar import Law, effect_of

_TAU = Parameter("tau_s", 1.0, 14_400.0, fixed(300.0, 900.0, 2700.0, 7200.0), is_open_end=True)

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
