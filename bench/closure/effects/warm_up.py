"""Bias that decays after power-on."""

from __future__ import annotations

import numpy as np

from gyrobench.bench.closure.campaign import Campaign
from gyrobench.bench.closure.effects.effect import (
    Effect,
    FittedForm,
    Form,
    InsTerms,
    same_for_all_gyros,
    time_constant,
)
from gyrobench.bench.foundations.arrays import FloatArray


def _decay_integral(time_s: FloatArray, on_s: float, off_s: float, tau_s: float) -> FloatArray:
    """Integral, up to a time, of the decay between one power-on and the next."""
    inside = np.clip(time_s, on_s, off_s) - on_s
    return np.asarray(tau_s * -np.expm1(-inside / tau_s))


def _columns(campaign: Campaign, values: tuple[float, ...]) -> FloatArray:
    """Mean over each dwell: a dwell that contains a power-on contains parts of two decays."""
    tau_s = values[0]
    on_s = campaign.power_on_s
    off_s = np.append(on_s[1:], np.inf)
    area = sum(
        _decay_integral(campaign.end_s, on, off, tau_s) - _decay_integral(campaign.start_s, on, off, tau_s)
        for on, off in zip(on_s, off_s, strict=True)
    )
    mean = area / np.maximum(campaign.end_s - campaign.start_s, 1e-9)
    return same_for_all_gyros(mean[:, None])


def _compensation(fitted: FittedForm) -> InsTerms:
    return InsTerms({"warm_up_dph": fitted.sizes_dph[:, 0], "warm_up_s": np.full(3, fitted.values[0])})


EFFECT = Effect(
    name="warm_up",
    label="warm-up",
    statement="the bias decays exponentially after power-on",
    experiment="reach the same temperature soon after power-on and again hours later, in two power cycles",
    compensation=_compensation,
    forms=(
        Form(
            ("decay since power-on",),
            _columns,
            (time_constant(300.0, 900.0, 2700.0, 7200.0, 21_600.0, 64_800.0),),
        ),
    ),
)
