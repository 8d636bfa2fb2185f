"""Bias that follows gravity along the body axes, equally at all temperatures."""

from __future__ import annotations

from gyrobench.bench.closure.effects.grammar import Law, effect_of

EFFECT = effect_of(
    Law("constant", factor="up"),
    name="g_sensitivity",
    label="g-sensitivity",
    statement="the bias follows gravity along the body axes, equally at all temperatures",
    experiment=(
        "compare up and down at the hottest and the coldest temperature after a soak: the difference is the "
        "same at both; a magnetic shield or coil excludes the vertical magnetic field"
    ),
    terms=("Up along x", "Up along y", "Up along z"),
    imitated_by=("magnetic_sensitivity",),
)
