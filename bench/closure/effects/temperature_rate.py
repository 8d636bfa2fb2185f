"""Bias that follows the rate of change of a gyro's temperature."""

from __future__ import annotations

from gyrobench.bench.closure.effects.grammar import Law, effect_of

EFFECT = effect_of(
    Law("gyro_rate_c_per_h"),
    name="temperature_rate",
    statement="the bias follows the rate of change of the optics temperature",
    experiment=(
        "pass the same temperature at two ramp rates, upward and downward, then soak there: the effect is "
        "proportional to the rate, changes sign with it and vanishes in the soak"
    ),
    terms=("temperature rate, K/h",),
    imitated_by=("thermal_gradient",),
)
