"""Bias that depends on the direction from which a temperature was reached: play between two bounds."""

from __future__ import annotations

import numpy as np

from gyrobench.bench.closure.campaign import Campaign
from gyrobench.bench.closure.effects.effect import Effect, FittedForm, Form, InsTerms, Parameter, fixed
from gyrobench.bench.foundations.arrays import FloatArray


def _play(temperature_c: FloatArray, half_width_c: float) -> FloatArray:
    """Play over time, (m, 3): it follows the temperature at a distance of at most the half width.

    Each instant limits the state of the one before; limits of limits are limits, so that those of 2, 4, 8,
    ... instants follow from each other.
    """
    low_c, high_c = temperature_c - half_width_c, temperature_c + half_width_c
    reach = 1
    while reach < len(temperature_c):
        later = low_c[reach:], high_c[reach:]
        limited = [np.clip(each[:-reach], *later) for each in (low_c, high_c)]
        low_c[reach:], high_c[reach:] = limited
        reach *= 2
    return np.asarray(np.clip(temperature_c[0], low_c, high_c))


def _columns(campaign: Campaign, values: tuple[float, ...]) -> FloatArray:
    record = campaign.record
    behind_c = _play(record.gyro_c, values[0]) - record.gyro_c
    return record.mean_over(behind_c, campaign.start_s, campaign.end_s)[:, :, None]


def _compensation(fitted: FittedForm) -> InsTerms:
    return InsTerms(
        {"hysteresis_dph_per_k": fitted.sizes_dph[:, 0], "half_width_k": np.full(3, fitted.values[0])}
    )


EFFECT = Effect(
    name="thermal_hysteresis",
    statement="the bias depends on whether a temperature was reached from above or below, at any rate",
    experiment=(
        "reach one temperature from above and from below and soak for hours: a lag decays, hysteresis "
        "remains; small temperature loops show its width"
    ),
    compensation=_compensation,
    forms=(
        Form(
            ("play behind the temperature, K",),
            _columns,
            (Parameter("half_width_c", 0.3, 40.0, fixed(1.0, 2.0, 4.0, 7.0, 12.0, 20.0)),),
        ),
    ),
)
