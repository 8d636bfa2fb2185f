"""Bias that follows how fast a gyro's temperature changes."""

from __future__ import annotations

from gyrobench.bench.closure.campaign import Campaign
from gyrobench.bench.closure.effects.effect import Effect, Form
from gyrobench.bench.foundations.arrays import FloatArray


def _columns(campaign: Campaign, _: tuple[float, ...]) -> FloatArray:
    return campaign.rate_c_per_h[:, :, None]


EFFECT = Effect(
    name="temperature_rate",
    statement="the bias follows how fast the temperature of the gyro's optics changes",
    experiment=(
        "pass the same temperature at two ramp rates, upward and downward, and soak there: "
        "what follows the rate doubles with it, changes sign and is gone after the soak"
    ),
    forms=(Form(("temperature rate, K/h",), _columns),),
    imitated_by=("thermal_gradient",),
)
