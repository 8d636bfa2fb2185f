"""Bias that follows the temperature difference between a gyro's electronics and its optics."""

from __future__ import annotations

from gyrobench.bench.closure.campaign import Campaign
from gyrobench.bench.closure.effects.effect import Effect, Form, above_optics_c, needs_electronics
from gyrobench.bench.foundations.arrays import FloatArray


def _columns(campaign: Campaign, _: tuple[float, ...]) -> FloatArray:
    return above_optics_c(campaign)[:, :, None]


EFFECT = Effect(
    name="thermal_gradient",
    statement=(
        "the bias follows the temperature of the electronics above that of the optics, alike in all positions"
    ),
    experiment=(
        "soak at one temperature and change the electronics' power: the difference between electronics and "
        "optics changes while the temperature rate soon returns to zero"
    ),
    forms=(Form(("electronics above optics, K",), _columns, lacks=needs_electronics),),
)
