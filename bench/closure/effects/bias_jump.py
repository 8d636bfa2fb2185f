"""A step of the bias at one time."""

from __future__ import annotations

import numpy as np

from gyrobench.bench.closure.campaign import Campaign
from gyrobench.bench.closure.effects.effect import (
    Effect,
    Form,
    Parameter,
    constant_at_end,
    same_for_all_gyros,
)
from gyrobench.bench.foundations.arrays import FloatArray


def _columns(campaign: Campaign, values: tuple[float, ...]) -> FloatArray:
    length_s = np.maximum(campaign.end_s - campaign.start_s, 1e-9)
    after = np.clip((campaign.end_s - values[0]) / length_s, 0.0, 1.0)
    return same_for_all_gyros(after[:, None])


def _starts(campaign: Campaign) -> FloatArray:
    return campaign.start_s[~campaign.held_out][1:]


EFFECT = Effect(
    name="bias_jump",
    statement="the bias steps to a new value at one time and remains there",
    experiment=(
        "repeat the positions and temperatures measured before the step within the same power cycle: a step "
        "remains"
    ),
    compensation=constant_at_end,
    forms=(Form(("after the jump",), _columns, (Parameter("jump_s", -np.inf, np.inf, _starts),)),),
)
