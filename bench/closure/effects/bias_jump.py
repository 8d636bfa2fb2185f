"""Bias that jumps at one time and stays."""

from __future__ import annotations

import numpy as np

from gyrobench.bench.closure.campaign import Campaign
from gyrobench.bench.closure.effects.effect import Effect, Form, Parameter
from gyrobench.bench.foundations.arrays import FloatArray


def _columns(campaign: Campaign, values: tuple[float, ...]) -> FloatArray:
    length_s = np.maximum(campaign.end_s - campaign.start_s, 1e-9)
    after = np.clip((campaign.end_s - values[0]) / length_s, 0.0, 1.0)
    return np.repeat(after[:, None, None], 3, axis=1)


def _starts(campaign: Campaign) -> FloatArray:
    return campaign.start_s[~campaign.held_out][1:]


EFFECT = Effect(
    name="bias_jump",
    statement="the bias jumped at one time and stayed there",
    experiment="repeat the positions and temperatures of before the jump in the same power-on: a jump stays",
    forms=(Form(("after the jump",), _columns, (Parameter("jump_s", -np.inf, np.inf, _starts),)),),
)
