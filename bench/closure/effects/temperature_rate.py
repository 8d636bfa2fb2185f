"""Bias that follows the rate of change of a gyro's temperature."""

from __future__ import annotations

import numpy as np

from gyrobench.bench.closure.campaign import Campaign
from gyrobench.bench.closure.effects.effect import Effect, FittedForm, Form, InsTerms
from gyrobench.bench.foundations.arrays import FloatArray


def _columns(campaign: Campaign, _: tuple[float, ...]) -> FloatArray:
    return campaign.rate_c_per_h[:, :, None]


def _compensation(fitted: FittedForm) -> InsTerms:
    rate_c_per_h = fitted.campaign.rate_c_per_h[fitted.searched]
    return InsTerms(
        {
            "rate_dph_per_c_per_h": fitted.sizes_dph[:, 0],
            "rate_limit_c_per_h": np.abs(rate_c_per_h).max(axis=0),
        }
    )


EFFECT = Effect(
    name="temperature_rate",
    statement="the bias follows the rate of change of the optics temperature",
    experiment=(
        "pass the same temperature at two ramp rates, upward and downward, then soak there: the effect is "
        "proportional to the rate, changes sign with it and vanishes in the soak"
    ),
    compensation=_compensation,
    forms=(Form(("temperature rate, K/h",), _columns),),
    imitated_by=("thermal_gradient",),
)
