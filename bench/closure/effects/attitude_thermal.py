"""Bias that follows an attitude-dependent heat flow from the electronics to the optics.

The heat that convection carries from the electronics to the optics depends on the direction of gravity. The
flow is proportional to the electronics' temperature above the optics. Above an onset temperature the bias
does not depend on attitude; below it the dependence is constant (saturating), or grows with falling
temperature (growing). An unknown flow is assumed to be constant.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from gyrobench.bench.closure.campaign import Campaign
from gyrobench.bench.closure.effects.effect import (
    Effect,
    FittedForm,
    Form,
    InsTerms,
    Parameter,
    above_optics_c,
    fixed,
    heat_flow_terms,
    needs_electronics,
    needs_positions,
)
from gyrobench.bench.foundations.arrays import FloatArray

_ONSET = (
    Parameter("onset_c", -20.0, 80.0, fixed(10.0, 30.0, 50.0)),
    Parameter("onset_width_c", 0.5, 20.0, fixed(2.0, 6.0)),
)

_SCALE = "direction cosine of gravity and by the course below the onset, which is 1 at the coldest gyro"
_NOTE_IN_KELVIN = (
    f"Heat flow in K is the temperature of the electronics above the optics, multiplied by the {_SCALE}. "
    "Only the product of heat flow and sensitivity shows in the bias: watts are not identifiable."
)
_NOTE_WITHOUT_UNIT = f"The heat flow is not known: shown is the {_SCALE}."


def _saturating(below: FloatArray) -> FloatArray:
    return np.asarray(np.exp(-np.logaddexp(0.0, -below)))


def _growing(below: FloatArray) -> FloatArray:
    return np.logaddexp(0.0, below)


def _form_with_flow(name: str, shape: Callable[[FloatArray], FloatArray]) -> Form:
    def columns(campaign: Campaign, values: tuple[float, ...]) -> FloatArray:
        flow_k = above_optics_c(campaign)
        return np.concatenate([flow_k[:, :, None], _along_gravity(campaign, flow_k, values, shape)], axis=2)

    def missing_input(campaign: Campaign) -> str | None:
        return needs_positions(campaign) or needs_electronics(campaign)

    terms = ("heat flow, K", *(f"heat flow by gravity along {axis}, K" for axis in "xyz"))
    return Form(terms, columns, _ONSET, missing_input, name, _weights(shape, 1), _NOTE_IN_KELVIN)


def _form_without_flow(name: str, shape: Callable[[FloatArray], FloatArray]) -> Form:
    def columns(campaign: Campaign, values: tuple[float, ...]) -> FloatArray:
        return _along_gravity(campaign, np.ones_like(campaign.gyro_c), values, shape)

    def missing_input(campaign: Campaign) -> str | None:
        not_applicable = "nothing: the heat flow is known" if needs_electronics(campaign) is None else None
        return needs_positions(campaign) or not_applicable

    terms = tuple(f"gravity along {axis} below the onset" for axis in "xyz")
    return Form(terms, columns, _ONSET, missing_input, name, _weights(shape, 0), _NOTE_WITHOUT_UNIT)


def _weights(
    shape: Callable[[FloatArray], FloatArray], unweighted: int
) -> Callable[[Campaign, tuple[float, ...]], FloatArray]:
    """Weights: 1 for ``unweighted`` terms, then the shape at the coldest gyro for three terms."""

    def weights(campaign: Campaign, onset: tuple[float, ...]) -> FloatArray:
        onset_c, width_c = onset
        coldest = shape((onset_c - campaign.gyro_c.min(keepdims=True)) / width_c).item()
        return np.array([1.0] * unweighted + [coldest] * 3)

    return weights


def _along_gravity(
    campaign: Campaign, flow: FloatArray, onset: tuple[float, ...], shape: Callable[[FloatArray], FloatArray]
) -> FloatArray:
    """Flow (n, 3) below the onset, multiplied by Up along each body axis: (n, 3, 3)."""
    onset_c, width_c = onset
    flow_below_onset = flow * shape((onset_c - campaign.gyro_c) / width_c)
    return flow_below_onset[:, :, None] * campaign.up_body[:, None, :]


def _compensation(fitted: FittedForm) -> InsTerms:
    """INS terms of the attitude-independent part of the heat flow, and of the part that follows gravity."""
    flow = heat_flow_terms(fitted)
    if flow.left_out:
        return flow
    onset_c, width_c = fitted.values
    return InsTerms(
        {
            **flow.coefficients,
            f"{fitted.form.name}_dph_per_k": fitted.sizes_dph[:, 1:],
            "onset_c": np.full(3, onset_c),
            "onset_width_c": np.full(3, width_c),
        }
    )


EFFECT = Effect(
    name="attitude_thermal",
    label="attitude-dependent heat flow",
    statement=(
        "the bias follows a heat flow from the electronics to the optics that depends on the direction of "
        "gravity below an onset temperature, increasingly with falling temperature (growing) or equally "
        "(saturating)"
    ),
    experiment=(
        "turn the unit upside down about each axis at one cold and one hot temperature, after a soak: "
        "the difference between up and down appears in the cold and vanishes in the heat, and it changes "
        "with the power of the electronics"
    ),
    compensation=_compensation,
    contains=("thermal_gradient", "g_sensitivity"),
    forms=(
        _form_with_flow("saturating", _saturating),
        _form_with_flow("growing", _growing),
        _form_without_flow("saturating, flow unknown", _saturating),
        _form_without_flow("growing, flow unknown", _growing),
    ),
)
