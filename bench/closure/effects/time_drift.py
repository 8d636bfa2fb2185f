"""Bias that drifts with time, whatever else happens."""

from __future__ import annotations

import numpy as np

from gyrobench.bench.closure.campaign import Campaign
from gyrobench.bench.closure.effects.effect import Effect, Form
from gyrobench.bench.foundations.arrays import FloatArray

_S_PER_DAY = 86_400.0


def _columns(campaign: Campaign, _: tuple[float, ...]) -> FloatArray:
    days = (campaign.middle_s - campaign.middle_s[0]) / _S_PER_DAY
    return np.repeat(days[:, None, None], 3, axis=1)


EFFECT = Effect(
    name="time_drift",
    statement="the bias drifts steadily with time",
    experiment=(
        "return to one position and temperature at the beginning, in the middle and at the end of a power-on"
    ),
    forms=(Form(("time, days",), _columns),),
)
