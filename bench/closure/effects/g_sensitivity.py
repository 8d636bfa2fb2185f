"""Bias that follows gravity along the body axes, at every temperature."""

from __future__ import annotations

import numpy as np

from gyrobench.bench.closure.campaign import Campaign
from gyrobench.bench.closure.effects.effect import Effect, Form, needs_positions
from gyrobench.bench.foundations.arrays import FloatArray


def _columns(campaign: Campaign, _: tuple[float, ...]) -> FloatArray:
    return np.repeat(campaign.up_body[:, None, :], 3, axis=1)


EFFECT = Effect(
    name="g_sensitivity",
    statement="the bias follows gravity along the body axes, alike at every temperature",
    experiment=(
        "compare up and down at the hottest and the coldest temperature after a soak: what follows gravity "
        "is the same in both; a shield or coil tells it from the vertical magnetic field"
    ),
    forms=(Form(("Up along x", "Up along y", "Up along z"), _columns, lacks=needs_positions),),
)
