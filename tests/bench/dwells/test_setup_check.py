"""Wrong scale of the velocities and wrong hemisphere, in dwells of an independent strapdown."""

import re
from dataclasses import replace

import numpy as np
import pytest

from gyrobench.bench.dwells.setup_check import measured_scale, setup_fault
from tests.adversarial.harness import LATITUDES_DEG, Case, any_unit, measured_dwells
from tests.adversarial.strapdown import Place

KNOT_MPS = 0.514444


def dwells_of(*, station=None, latitude_deg=36.4, seed=3, **unit):
    """One dwell in each position."""
    random = np.random.default_rng(seed)
    case = Case(replace(any_unit(random), **unit), Place(latitude_deg), station=station or {})
    return measured_dwells(case, random)


@pytest.mark.parametrize(
    ("scale", "cause"),
    [
        ((0.5,) * 3, "velocity_east and ins.signals.velocity_north have a wrong scale.*half the scale"),
        ((1.0 / KNOT_MPS,) * 3, "have a wrong scale.*knots taken for m/s"),
        ((3.6,) * 3, "have a wrong scale.*km/h taken for m/s"),
        ((1.0, 0.5, 1.0), "^ins.signals.velocity_north has a wrong scale"),
        ((2.0, 1.0, 1.0), "^ins.signals.velocity_east has a wrong scale"),
    ],
)
def test_a_wrong_scale_of_the_velocities_is_named_in_every_dwell(scale, cause):
    dwells = dwells_of(velocity_scale=scale)
    assert all("a wrong scale" in dwell.row.flags for dwell in dwells)
    assert re.search(cause, dwells[-1].setup_fault), dwells[-1].setup_fault


def test_a_scale_that_each_dwell_leaves_open_is_found_by_all_together():
    dwells = dwells_of(velocity_scale=(0.85,) * 3)
    assert not any(setup_fault([dwell.evidence]) for dwell in dwells)
    assert all("a wrong scale" in dwell.row.flags for dwell in dwells)


@pytest.mark.parametrize("latitude_deg", [each for each in LATITUDES_DEG if abs(each) > 30.0])
def test_a_latitude_of_the_wrong_hemisphere_is_named_in_nearly_every_dwell(latitude_deg):
    """The Coriolis acceleration needs a velocity, which is small by chance where biases cancel."""
    station = {"location.latitude_deg": -latitude_deg}
    dwells = dwells_of(station=station, latitude_deg=latitude_deg)
    named = ["location.latitude_deg has the wrong sign" in dwell.row.flags for dwell in dwells]
    assert sum(named) >= 5


UNITS = (
    {},
    {"accelerometer_bias_ug": (-1000.0, 1000.0, 1000.0)},
    {"accelerometer_drift_ug_per_h": (30.0, -30.0, 30.0)},
    {"accelerometer_transient_ug": (20.0, -20.0, 20.0)},
    {"angle_random_walk": 0.0012},
    {"velocity_damping_s": 600.0},
    {"gyro_pulse_arcsec": 5.0},
    {"bias_step_dph": (0.0, 0.02, 0.0)},
    {"velocity_output_mps": 1e-3, "attitude_output_arcsec": 5.0},
)


def each_unit_at_one_latitude(*latitudes_deg):
    """Every unit at every latitude, each unit at one of them among the quick tests."""
    return [
        pytest.param(
            latitude_deg,
            unit,
            id=f"{latitude_deg}-{'-'.join(unit) or 'no error'}",
            marks=[] if number % len(latitudes_deg) == place else [pytest.mark.long],
        )
        for number, unit in enumerate(UNITS)
        for place, latitude_deg in enumerate(latitudes_deg)
    ]


@pytest.mark.parametrize(("latitude_deg", "unit"), each_unit_at_one_latitude(36.4, -52.0))
def test_no_error_of_the_unit_passes_for_a_wrong_set_up(latitude_deg, unit):
    dwells = dwells_of(latitude_deg=latitude_deg, **unit)
    assert [dwell.setup_fault for dwell in dwells] == [""] * 6
    if evidence := [dwell.evidence for dwell in dwells if dwell.evidence]:
        scale, sigma = measured_scale(evidence)
        assert abs(scale - 1.0) < 4.0 * sigma
