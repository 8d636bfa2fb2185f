"""Bias that follows the temperature difference between a gyro's electronics and its optics."""

from __future__ import annotations

from gyrobench.bench.closure.effects.grammar import Law, effect_of

EFFECT = effect_of(
    Law("above_optics_k"),
    name="thermal_gradient",
    statement=(
        "the bias follows the temperature difference between electronics and optics, equally in all positions"
    ),
    experiment=(
        "soak at one temperature and change the power of the electronics: the temperature difference "
        "changes, while the temperature rate soon returns to zero"
    ),
    terms=("electronics above optics, K",),
)
