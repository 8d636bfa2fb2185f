"""Bias that follows the power of the other units in the chamber: their heat warms one side of the unit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gyrobench.bench.bias.dwell_table import NEIGHBOURS_ON
from gyrobench.bench.closure.campaign import Campaign
from gyrobench.bench.closure.effects.effect import Effect, no_ins_term, same_for_all_gyros, time_constant
from gyrobench.bench.closure.effects.grammar import Law, form_of, mean_decay
from gyrobench.bench.foundations.arrays import FloatArray

_LAW = Law(NEIGHBOURS_ON, memory="lag", parameters=(time_constant(60.0, 300.0, 1800.0),))


def _columns(campaign: Campaign, values: tuple[float, ...]) -> FloatArray:
    """Heat of the other units: their number, lagging; none before the first power-on."""
    at_first = campaign.whole.columns[NEIGHBOURS_ON][0]
    missing = at_first * mean_decay(campaign, campaign.power_on_s[:1], values[0])
    return _LAW.columns(campaign, values) - same_for_all_gyros(missing[:, np.newaxis])


def _missing_input(campaign: Campaign) -> str | None:
    if NEIGHBOURS_ON not in campaign.columns:
        return "another unit in the chamber"
    if np.ptp(campaign.columns[NEIGHBOURS_ON]) == 0.0:
        return "dwells with the unit beside it on, and others with it off"
    return _LAW.missing_input(campaign)


EFFECT = Effect(
    name="neighbouring_unit",
    statement="the bias changes while another unit in the chamber is on, and follows its heat",
    experiment="leave this unit on and switch the one beside it off and on again, for several dwells each",
    forms=(replace(form_of(_LAW, ("other units on",)), columns=_columns, missing_input=_missing_input),),
    compensation=no_ins_term("it belongs to the unit beside it"),
)
