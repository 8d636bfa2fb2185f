"""Bias that follows the Earth's magnetic field along the body axes.

The vertical part is exactly a g-sensitivity, since the field's vertical is gravity's. The horizontal part
turns with the heading; a pair of headings half a turn apart cancels it as far as both weigh the same. What
is fitted is the direction of the field that acts: its inclination is that of the Earth's field where a dwell
has one heading, and steeper where the pair cancels a part.
"""

from __future__ import annotations

import numpy as np

from gyrobench.bench.closure.campaign import Campaign
from gyrobench.bench.closure.effects.effect import (
    Effect,
    Form,
    Parameter,
    fixed,
    needs_positions,
    no_ins_term,
    same_for_all_gyros,
)
from gyrobench.bench.foundations.arrays import FloatArray
from gyrobench.bench.navigation.positions import POSITIONS

_AT_AZIMUTH_0 = {name: position.C_nb() for name, position in POSITIONS.items()}
_INCLINATION = Parameter("inclination_deg", -89.0, 89.0, fixed(-70.0, -30.0, 30.0, 70.0))


def _columns(campaign: Campaign, values: tuple[float, ...]) -> FloatArray:
    azimuth_rad = np.deg2rad(np.asarray(campaign.azimuth_deg))[:, np.newaxis]
    east, north = np.moveaxis(np.array([_AT_AZIMUTH_0[name] for name in campaign.position])[:, :2], 1, 0)
    north = np.cos(azimuth_rad) * north + np.sin(azimuth_rad) * east
    inclination_rad = np.deg2rad(values[0])
    return same_for_all_gyros(np.cos(inclination_rad) * north - np.sin(inclination_rad) * campaign.up_body)


def _missing_input(campaign: Campaign) -> str | None:
    azimuth_deg = campaign.azimuth_deg
    if azimuth_deg is None or not np.isfinite(azimuth_deg).all():
        return "the headings of the dwells (column azimuth_deg)"
    if campaign.has_one_heading:
        return "dwells at headings other than one and its opposite"
    return needs_positions(campaign)


EFFECT = Effect(
    name="magnetic_sensitivity",
    label="magnetic sensitivity",
    statement="the bias follows the Earth's magnetic field along the body axes",
    experiment=(
        "measure one position at four headings a quarter turn apart; a coil or a magnetic shield around the "
        "unit settles the vertical part, which equals a g-sensitivity at every heading"
    ),
    forms=(
        Form(
            tuple(f"magnetic field along {axis}" for axis in "xyz"), _columns, (_INCLINATION,), _missing_input
        ),
    ),
    compensation=no_ins_term("the INS has no magnetometer"),
    contains=("g_sensitivity",),
    sensors=("gyro",),  # accelerometers sense gravity far more than any magnetic field
)
