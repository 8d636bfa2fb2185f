"""Bias that follows gravity along the body axes, in proportion to temperature.

The springs of block and dither soften with temperature. The part that is equal at all temperatures is the
effect ``g_sensitivity``.
"""

from __future__ import annotations

from gyrobench.bench.closure.effects.grammar import Law, effect_of

EFFECT = effect_of(
    Law("gyro_c", factor="up"),
    name="thermal_g_sensitivity",
    label="temperature-dependent g-sensitivity",
    statement="the bias follows gravity along the body axes, in proportion to the optics temperature",
    experiment=(
        "compare up and down about each axis at five temperatures after a soak: the difference changes "
        "linearly over the whole range, and not with the power of the electronics"
    ),
    terms=("temperature by Up along x, K", "temperature by Up along y, K", "temperature by Up along z, K"),
)
