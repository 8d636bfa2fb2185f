"""Bias that depends on the state of the chamber: vibration, air flow or magnetic fields of its cooling.

The refrigeration runs while the set point falls and while it is cold, or while there is heat to remove: what
leaks in from the room, and what walls and load give off for an hour or so after a ramp. It runs below a limit
of the set point minus the temperature of the walls above it, times the ratio of the two conductances.
"""

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
from gyrobench.bench.closure.effects.grammar import course_of
from gyrobench.bench.closure.temperature_record import lag
from gyrobench.bench.foundations.arrays import FloatArray

_MIN_SLOPE_C = 1e-4
#: The refrigeration switches within this, K: without it nothing changes with the limit between two instants.
_SWITCH_C = 0.5


def _columns(campaign: Campaign, values: tuple[float, ...]) -> FloatArray:
    """Shares of each dwell with a falling set point, and with one that requires cooling: (n, 3, 2)."""
    path_c = campaign.set_point_path_c
    falling = np.mean(np.diff(path_c, axis=1) < -_MIN_SLOPE_C, axis=1)
    cold = np.mean(path_c < values[0], axis=1)
    return same_for_all_gyros(np.stack([falling, cold], axis=1))


def _heat_to_remove(campaign: Campaign, values: tuple[float, ...]) -> FloatArray:
    """Share of each dwell with heat to remove: (n, 3, 1)."""
    cold_below_c, ratio, tau_s = values
    record, set_c = campaign.record, course_of("chamber_set_c", campaign)[:, :1]
    limited_c = set_c - ratio * lag(set_c, record.time_s, tau_s)
    neighbours_c = np.concatenate([limited_c[:1], limited_c, limited_c[-1:]])
    low_c = np.minimum(np.minimum(neighbours_c[:-2], neighbours_c[2:]), limited_c) - _SWITCH_C
    high_c = np.maximum(np.maximum(neighbours_c[:-2], neighbours_c[2:]), limited_c) + _SWITCH_C
    runs = np.clip((cold_below_c - low_c) / (high_c - low_c), 0.0, 1.0)
    return same_for_all_gyros(campaign.means_over_dwells(runs))


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
            "falling or cold",
        ),
        Form(
            ("heat to remove, share of the dwell",),
            _heat_to_remove,
            (
                Parameter("cold_below_c", -40.0, 25.0, fixed(-10.0, 2.0, 14.0)),
                Parameter("walls_to_leak", 0.5, 30.0, fixed(2.0, 8.0)),
                Parameter("walls_tau_s", 900.0, 14_400.0, fixed(3600.0)),
            ),
            _missing_input,
            "heat to remove",
        ),
    ),
)
