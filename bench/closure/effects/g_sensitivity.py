"""Bias that follows gravity along the body axes, equally at all temperatures."""

from __future__ import annotations

from gyrobench.bench.closure.campaign import Campaign
from gyrobench.bench.closure.effects.effect import (
    Effect,
    FittedForm,
    Form,
    InsTerms,
    needs_positions,
    same_for_all_gyros,
)
from gyrobench.bench.foundations.arrays import FloatArray


def _columns(campaign: Campaign, _: tuple[float, ...]) -> FloatArray:
    return same_for_all_gyros(campaign.up_body)


def _compensation(fitted: FittedForm) -> InsTerms:
    return InsTerms({"gravity_dph_per_g": fitted.sizes_dph})


EFFECT = Effect(
    name="g_sensitivity",
    label="g-sensitivity",
    statement="the bias follows gravity along the body axes, equally at all temperatures",
    experiment=(
        "compare up and down at the hottest and the coldest temperature after a soak: the difference is the "
        "same at both; a magnetic shield or coil excludes the vertical magnetic field"
    ),
    forms=(Form(("Up along x", "Up along y", "Up along z"), _columns, missing_input=needs_positions),),
    compensation=_compensation,
)
