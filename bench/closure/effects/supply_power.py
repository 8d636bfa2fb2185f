"""Bias that follows the power of the unit's supply or heater."""

from __future__ import annotations

from gyrobench.bench.closure.effects.grammar import Law, effect_of

EFFECT = effect_of(
    Law("supply_w"),
    name="supply_power",
    label="supply power",
    statement="the bias follows the power of the supply or heater",
    experiment=(
        "hold temperature and position and step the supply voltage or heater power with a programmable "
        "supply: the bias follows within seconds, before any temperature does"
    ),
    terms=("supply power, W",),
)
