"""Bias that depends on the state of the chamber: vibration, air flow or magnetic fields of its cooling."""

from __future__ import annotations

import numpy as np

from gyrobench.bench.closure.campaign import Campaign
from gyrobench.bench.closure.effects.effect import (
    Effect,
    Form,
    Parameter,
    fixed,
    no_ins_term,
    same_for_all_gyros,
)
from gyrobench.bench.foundations.arrays import FloatArray

_MIN_SLOPE_C = 1e-4


def _columns(campaign: Campaign, values: tuple[float, ...]) -> FloatArray:
    """Shares of each dwell with a falling set point, and with one that requires cooling: (n, 3, 2)."""
    path_c = campaign.set_point_path_c
    falling = np.mean(np.diff(path_c, axis=1) < -_MIN_SLOPE_C, axis=1)
    cold = np.mean(path_c < values[0], axis=1)
    return same_for_all_gyros(np.stack([falling, cold], axis=1))


def _missing_input(campaign: Campaign) -> str | None:
    return None if np.isfinite(campaign.set_c).all() else "the chamber's set point"


EFFECT = Effect(
    name="chamber_state",
    statement="the bias changes while the chamber's refrigeration runs",
    experiment="hold a temperature and switch the chamber's compressor and fan off for several dwells",
    compensation=no_ins_term("it belongs to the chamber, not to the INS"),
    forms=(
        Form(
            ("cooling, share of the dwell", "holding cold, share of the dwell"),
            _columns,
            (Parameter("cold_below_c", -15.0, 25.0, fixed(-12.0, -5.0, 5.0, 15.0)),),
            _missing_input,
        ),
    ),
)
