"""Bias that follows the power of the supply: at once, or as what it heats becomes warm and cold.

Electronics, heaters and discharge warm what is near them within minutes, beginning at each power-on: with a
power that never changes this is a warm-up. How long the INS had been off before the first power-on is not
known, so that what it heats may still be warm then.
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
from gyrobench.bench.closure.effects.grammar import Law, driver_values, form_of
from gyrobench.bench.closure.temperature_record import lag
from gyrobench.bench.foundations.arrays import BoolArray, FloatArray

#: Time within which the power changes at a power-on or off, or between two dwells without a gap.
_SWITCH_S = 1.0
#: Smallest change of the power in a power cycle that distinguishes a lag from a warm-up.
_MIN_CHANGE = 0.02


def _lagging(campaign: Campaign, values: tuple[float, ...]) -> FloatArray:
    """Means over the dwells of the power behind a first-order lag, zero while the INS is off: (n, 3, 1)."""
    whole = campaign.whole
    seen = ~whole.held_out
    mean_w = _lagging_over(whole, np.ones_like(seen), *values)
    if seen.any():
        mean_w[seen] = _lagging_over(whole, seen, *values)
    chosen = slice(None) if campaign.part_of is None else campaign.part_of[1]
    return same_for_all_gyros(mean_w[chosen, np.newaxis])


def _lagging_over(whole: Campaign, known: BoolArray, tau_s: float, warm_share: float) -> FloatArray:
    """Means over the known dwells (n,), from these alone: the power is constant in each, linear in gaps."""
    start_s, end_s, on_s = whole.start_s[known], whole.end_s[known], whole.power_on_s
    power_w = driver_values("supply_w", whole)[known, 0]
    first = np.minimum(np.searchsorted(end_s, on_s, side="right"), len(end_s) - 1)
    before_s = np.minimum(np.where(first > 0, end_s[first - 1], np.inf), on_s - 2.0 * _SWITCH_S)
    inside_s = np.minimum(0.5 * _SWITCH_S, 0.1 * (end_s - start_s))
    edges_s = start_s + inside_s, end_s - inside_s
    times_s = np.concatenate([*edges_s, before_s + 0.5 * _SWITCH_S, on_s - _SWITCH_S, on_s])
    off_w = np.zeros(2 * len(on_s))
    off_w[:: len(on_s)] = warm_share * power_w[first[0]]  # of the first power-on
    time_s, order = np.unique(times_s, return_index=True)
    course_w = np.concatenate([power_w, power_w, off_w, power_w[first]])[order, np.newaxis]
    state_w = (course_w + lag(course_w, time_s, tau_s))[:, 0]
    rise_w = np.diff([state_w[np.searchsorted(time_s, each_s)] for each_s in edges_s], axis=0)[0]
    # The rate of the lag is what it lacks of the power, over the time constant.
    return np.asarray(power_w - tau_s * rise_w / np.maximum(edges_s[1] - edges_s[0], 1e-9))


def _missing_input(campaign: Campaign) -> str | None:
    if missing := _AT_ONCE.missing_input(campaign):
        return missing
    power_w = driver_values("supply_w", campaign)[:, 0]
    changes_w = [np.ptp(power_w[campaign.run == run]) for run in np.unique(campaign.run)]
    is_constant = max(changes_w) < _MIN_CHANGE * np.abs(power_w).max()
    return "a change of the supply's power within a power cycle" if is_constant else None


_AT_ONCE = Law("supply_w")
EFFECT = Effect(
    name="supply_power",
    label="supply power",
    statement="the bias follows the power of the supply or heater",
    experiment=(
        "hold temperature and position and step the supply voltage or heater power with a programmable "
        "supply: the bias follows within seconds or minutes, before the temperature of the optics does"
    ),
    compensation=no_ins_term("the INS has no term for what follows the supply power"),
    forms=(
        form_of(_AT_ONCE, ("supply power, W",), "at once"),
        Form(
            ("lagging supply power, W",),
            _lagging,
            (
                Parameter("tau_s", 30.0, 3600.0, fixed(120.0, 900.0)),
                Parameter("warm_at_first_power_on", 0.0, 1.0, fixed(0.0, 1.0), is_place=True),
            ),
            _missing_input,
            "lagging",
        ),
    ),
)
