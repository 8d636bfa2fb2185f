"""Bias that dies away after power-on."""

from __future__ import annotations

import numpy as np

from gyrobench.bench.closure.campaign import Campaign
from gyrobench.bench.closure.effects.effect import Effect, Form, Parameter, fixed
from gyrobench.bench.foundations.arrays import FloatArray


def _decay_integral(time_s: FloatArray, on_s: float, off_s: float, tau_s: float) -> FloatArray:
    """Integral up to a time of what decays from one power-on until the next."""
    inside = np.clip(time_s, on_s, off_s) - on_s
    return np.asarray(tau_s * -np.expm1(-inside / tau_s))


def _columns(campaign: Campaign, values: tuple[float, ...]) -> FloatArray:
    """Mean over the dwell: a dwell in which the unit was switched on holds the ends of two decays."""
    tau_s = values[0]
    on_s = campaign.power_on_s
    off_s = np.append(on_s[1:], np.inf)
    area = sum(
        _decay_integral(campaign.end_s, on, off, tau_s) - _decay_integral(campaign.start_s, on, off, tau_s)
        for on, off in zip(on_s, off_s, strict=True)
    )
    mean = area / np.maximum(campaign.end_s - campaign.start_s, 1e-9)
    return np.repeat(mean[:, None, None], 3, axis=1)


EFFECT = Effect(
    name="warm_up",
    statement="the bias dies away after power-on",
    experiment="reach the same temperature soon after a power-on and again hours after it, in two power-ons",
    forms=(
        Form(
            ("decay since power-on",),
            _columns,
            (
                Parameter(
                    "tau_s",
                    300.0,
                    43_200.0,
                    fixed(900.0, 2700.0, 7200.0, 14_400.0, 28_800.0),
                    is_open_end=True,
                ),
            ),
        ),
    ),
)
