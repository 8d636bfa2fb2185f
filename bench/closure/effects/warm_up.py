"""Bias that decays after power-on."""

from __future__ import annotations

from gyrobench.bench.closure.effects.effect import Parameter, fixed
from gyrobench.bench.closure.effects.grammar import Law, effect_of

_TAU = Parameter("tau_s", 300.0, 43_200.0, fixed(900.0, 2700.0, 7200.0, 14_400.0, 28_800.0), is_open_end=True)

EFFECT = effect_of(
    Law("power_on", memory="decay", parameters=(_TAU,)),
    name="warm_up",
    label="warm-up",
    statement="the bias decays exponentially after power-on",
    experiment="reach the same temperature soon after power-on and again hours later, in two power cycles",
    terms=("decay since power-on",),
)
