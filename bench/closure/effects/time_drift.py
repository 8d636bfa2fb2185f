"""Bias that drifts linearly with time."""

from __future__ import annotations

from gyrobench.bench.closure.campaign import Campaign
from gyrobench.bench.closure.effects.effect import Effect, Form, constant_at_end, same_for_all_gyros
from gyrobench.bench.foundations.arrays import FloatArray

_S_PER_DAY = 86_400.0


def _columns(campaign: Campaign, _: tuple[float, ...]) -> FloatArray:
    days = (campaign.middle_s - campaign.middle_s[0]) / _S_PER_DAY
    return same_for_all_gyros(days[:, None])


EFFECT = Effect(
    name="time_drift",
    statement="the bias drifts linearly with time",
    experiment=(
        "return to one position and temperature at the beginning, in the middle and at the end of a "
        "power cycle"
    ),
    compensation=constant_at_end,
    forms=(Form(("time, days",), _columns),),
)
