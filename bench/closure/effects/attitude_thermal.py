"""Bias that follows a heat flow from the electronics to the optics which depends on attitude.

Warm air rises: what convection carries from the electronics to the optics depends on the direction
of gravity. The flow goes with the electronics' temperature above the optics. Above an onset
temperature the bias no longer depends on attitude; below it the dependence is constant
(saturating), or grows the colder it gets (growing). Where nothing tells the flow it is taken to be
constant.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.special import expit

from gyrobench.bench.closure.campaign import Campaign
from gyrobench.bench.closure.effects.effect import (
    Effect,
    Form,
    Parameter,
    above_optics_c,
    fixed,
    needs_electronics,
    needs_positions,
)
from gyrobench.bench.foundations.arrays import FloatArray

_ONSET = (
    Parameter("onset_c", -20.0, 80.0, fixed(10.0, 30.0, 50.0)),
    Parameter("onset_width_c", 0.5, 20.0, fixed(2.0, 6.0)),
)


def _saturating(below: FloatArray) -> FloatArray:
    return np.asarray(expit(below))


def _growing(below: FloatArray) -> FloatArray:
    return np.logaddexp(0.0, below)


def _form(name: str, shape: Callable[[FloatArray], FloatArray]) -> Form:
    def columns(campaign: Campaign, values: tuple[float, ...]) -> FloatArray:
        flow_k = above_optics_c(campaign)
        return np.concatenate([flow_k[:, :, None], _along(campaign, flow_k, values, shape)], axis=2)

    def lacks(campaign: Campaign) -> str | None:
        return needs_positions(campaign) or needs_electronics(campaign)

    terms = ("heat flow, K", *(f"heat flow by gravity along {axis}, K" for axis in "xyz"))
    return Form(terms, columns, _ONSET, lacks, name)


def _form_without_flow(name: str, shape: Callable[[FloatArray], FloatArray]) -> Form:
    def columns(campaign: Campaign, values: tuple[float, ...]) -> FloatArray:
        return _along(campaign, np.ones_like(campaign.gyro_c), values, shape)

    def lacks(campaign: Campaign) -> str | None:
        known = "nothing: the heat flow is known" if needs_electronics(campaign) is None else None
        return needs_positions(campaign) or known

    terms = tuple(f"gravity along {axis} in the cold" for axis in "xyz")
    return Form(terms, columns, _ONSET, lacks, name)


def _along(
    campaign: Campaign,
    flow: FloatArray,
    onset: tuple[float, ...],
    shape: Callable[[FloatArray], FloatArray],
) -> FloatArray:
    """Parts of a flow (n, 3) that follow gravity along the body axes below the onset: (n, 3, 3)."""
    onset_c, width_c = onset
    part = flow * shape((onset_c - campaign.gyro_c) / width_c)
    return part[:, :, None] * campaign.up_body[:, None, :]


EFFECT = Effect(
    name="attitude_thermal",
    statement=(
        "heat from the electronics reaches the optics by a flow that depends on the direction of gravity, "
        "and the bias follows it"
    ),
    experiment=(
        "turn the unit upside down about each axis at one cold and one hot temperature, after a soak: "
        "the difference between up and down is there in the cold and gone in the heat; a change of the "
        "electronics' power changes it"
    ),
    forms=(
        _form("saturating", _saturating),
        _form("growing", _growing),
        _form_without_flow("saturating, flow unknown", _saturating),
        _form_without_flow("growing, flow unknown", _growing),
    ),
)
