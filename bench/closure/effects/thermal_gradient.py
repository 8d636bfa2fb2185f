"""Bias that follows the temperature difference between a gyro's electronics and its optics."""

from __future__ import annotations

from gyrobench.bench.closure.campaign import Campaign
from gyrobench.bench.closure.effects.effect import (
    Effect,
    Form,
    above_optics_c,
    heat_flow_terms,
    needs_electronics,
)
from gyrobench.bench.foundations.arrays import FloatArray


def _columns(campaign: Campaign, _: tuple[float, ...]) -> FloatArray:
    return above_optics_c(campaign)[:, :, None]


EFFECT = Effect(
    name="thermal_gradient",
    statement=(
        "the bias follows the temperature difference between electronics and optics, equally in all positions"
    ),
    experiment=(
        "soak at one temperature and change the power of the electronics: the temperature difference "
        "changes, while the temperature rate soon returns to zero"
    ),
    forms=(Form(("electronics above optics, K",), _columns, missing_input=needs_electronics),),
    compensation=heat_flow_terms,
)
