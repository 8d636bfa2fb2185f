"""Bias that follows what the chamber's machinery does: vibration, air flow or fields of its cooling."""

from __future__ import annotations

import numpy as np

from gyrobench.bench.closure.campaign import Campaign
from gyrobench.bench.closure.effects.effect import Effect, Form, Parameter, fixed
from gyrobench.bench.foundations.arrays import FloatArray

_LEAST_SLOPE_C = 1e-4


def _columns(campaign: Campaign, values: tuple[float, ...]) -> FloatArray:
    """Shares of each dwell with a falling set point, and with one that only cooling can hold: (n, 3, 2)."""
    path_c = campaign.set_point_path_c
    falling = np.mean(np.diff(path_c, axis=1) < -_LEAST_SLOPE_C, axis=1)
    cold = np.mean(path_c < values[0], axis=1)
    return np.repeat(np.stack([falling, cold], axis=1)[:, None, :], 3, axis=1)


def _lacks(campaign: Campaign) -> str | None:
    return None if np.isfinite(campaign.set_c).all() else "the chamber's set point"


EFFECT = Effect(
    name="chamber_state",
    statement="the bias changes while the chamber's refrigeration works",
    experiment="hold a temperature and switch the chamber's compressor and fan off for some dwells",
    forms=(
        Form(
            ("cooling, share of the dwell", "holding cold, share of the dwell"),
            _columns,
            (Parameter("cold_below_c", -15.0, 25.0, fixed(-12.0, -5.0, 5.0, 15.0)),),
            _lacks,
        ),
    ),
)
