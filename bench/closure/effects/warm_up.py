"""Bias that decays after power-on."""

from __future__ import annotations

from gyrobench.bench.closure.effects.effect import time_constant
from gyrobench.bench.closure.effects.grammar import Law, effect_of

_TAU = time_constant(300.0, 900.0, 2700.0, 7200.0, 21_600.0, 64_800.0)

EFFECT = effect_of(
    Law("power_on", memory="decay", parameters=(_TAU,)),
    name="warm_up",
    label="warm-up",
    statement="the bias decays exponentially after power-on",
    experiment="reach the same temperature soon after power-on and again hours later, in two power cycles",
    terms=("decay since power-on",),
)
