"""Bias of an accelerometer that follows the square of the specific force across its input axis.

The terms ``Kpp ap^2 + Koo ao^2`` of the model equation of IEEE Std 1293. Across a level input axis the
squares of gravity add up to one, so that at rest their difference alone is distinguished from the bias.
"""

from __future__ import annotations

import numpy as np

from gyrobench.bench.closure.campaign import Campaign
from gyrobench.bench.closure.effects.effect import Effect, Form, needs_positions
from gyrobench.bench.foundations.arrays import FloatArray


def _columns(campaign: Campaign, _: tuple[float, ...]) -> FloatArray:
    squares = campaign.up_body**2
    across = np.roll(squares, -1, axis=1) - np.roll(squares, -2, axis=1)
    return across[:, list(campaign.quantity.sensors), np.newaxis]


EFFECT = Effect(
    name="cross_axis_nonlinearity",
    label="cross-axis nonlinearity",
    statement="the bias follows the square of gravity across the input axis",
    experiment=(
        "turn the unit about the level input axis by quarter turns: the bias is the same after half a turn, "
        "and differs after a quarter"
    ),
    forms=(
        Form(("square of Up along the next axis less along the one after",), _columns, (), needs_positions),
    ),
    sensors=("accelerometer",),
)
