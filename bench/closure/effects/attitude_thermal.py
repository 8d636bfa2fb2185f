"""Bias that follows a heat flow from the electronics to the optics which depends on attitude.

Warm air rises: what convection carries from the electronics to the optics depends on the direction
of gravity. With sensors at the electronics, the flow goes with their temperature above the optics;
without, it is what warms the optics and what they lose to the case. Above an onset temperature the
bias no longer depends on attitude; below it the dependence is constant (saturating), or grows the
colder it gets (growing).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.special import expit

from bench.closure.campaign import Campaign
from bench.closure.effects.effect import Effect, FloatArray, Form, Parameter, fixed, needs_boards
from bench.closure.heat_flow import flow_depends_on_attitude, into_optics_k

_ONSET = (
    Parameter("onset_c", -20.0, 80.0, fixed(10.0, 30.0, 50.0)),
    Parameter("onset_width_c", 0.5, 20.0, fixed(2.0, 6.0)),
)
_CASE_TIME = Parameter("case_time_h", 0.05, 20.0, fixed(0.3, 0.7, 1.5, 4.0))


def _saturating(below: FloatArray) -> FloatArray:
    return np.asarray(expit(below))


def _growing(below: FloatArray) -> FloatArray:
    return np.logaddexp(0.0, below)


def _terms(
    flow_k: FloatArray,
    campaign: Campaign,
    onset: tuple[float, ...],
    shape: Callable[[FloatArray], FloatArray],
) -> FloatArray:
    """Flow alike in all positions, and its parts that follow gravity along x, y and z: (n, 3, 4)."""
    onset_c, width_c = onset
    part = flow_k * shape((onset_c - campaign.gyro_c) / width_c)
    along = part[:, :, None] * campaign.up_body[:, None, :]
    return np.concatenate([flow_k[:, :, None], along], axis=2)


def _with_boards(
    shape: Callable[[FloatArray], FloatArray],
) -> Callable[[Campaign, tuple[float, ...]], FloatArray]:
    return lambda campaign, values: _terms(campaign.board_c - campaign.gyro_c, campaign, values, shape)


def _from_balance(campaign: Campaign, values: tuple[float, ...]) -> FloatArray:
    case_time_h, *onset = values
    return _terms(into_optics_k(campaign, case_time_h), campaign, tuple(onset), _saturating)


def _lacks_for_balance(campaign: Campaign) -> str | None:
    if campaign.has_boards:
        return "nothing: sensors at the electronics tell more"
    if not np.isfinite(campaign.case_c).all():
        return "temperature sensors at the electronics or at the case"
    return None if flow_depends_on_attitude(campaign) else "a heat flow that depends on attitude"


_TERMS = (
    "heat flow",
    "heat flow by gravity along x",
    "heat flow by gravity along y",
    "heat flow by gravity along z",
)

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
        Form(_TERMS, _with_boards(_saturating), _ONSET, needs_boards, "saturating"),
        Form(_TERMS, _with_boards(_growing), _ONSET, needs_boards, "growing"),
        Form(
            _TERMS, _from_balance, (_CASE_TIME, *_ONSET), _lacks_for_balance, "from the optics' heat balance"
        ),
    ),
)
