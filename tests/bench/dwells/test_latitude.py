"""Runs whose INS uses a wrong latitude, on a strapdown that shares no code with the bench."""

import re
from functools import cache

import numpy as np
import pytest

from gyrobench.bench.bias.vertical_pairs import Finding
from gyrobench.bench.dwells.run_results import evaluate
from gyrobench.bench.foundations.arrays import RAD_TO_ARCMIN
from gyrobench.bench.navigation.positions import POSITIONS
from tests.adversarial.harness import ALL, Case, any_unit, measured_dwells, setup_of
from tests.adversarial.strapdown import Place

LONG = pytest.mark.long
UNIT = any_unit(np.random.default_rng(3))


@cache
def evaluated(error_arcmin, positions=ALL, declared_arcmin=0.33):
    case = Case(
        UNIT,
        Place(latitude_deg=52.0, latitude_error_arcmin=error_arcmin),
        station={"location.latitude_uncertainty_arcmin": declared_arcmin},
        positions=positions,
    )
    dwells = measured_dwells(case, np.random.default_rng(4))
    return dwells, evaluate(dwells, setup_of(case), 5.0)


def vertical(dwells, values="bias_dph"):
    rows = [dwell.row for dwell in dwells]
    return np.array([getattr(row, values)[POSITIONS[row.position].up_axis] for row in rows])


def test_a_wrong_latitude_is_corrected_in_the_vertical_biases_and_in_the_bins():
    dwells, results = evaluated(1.0)
    truth = np.array([UNIT.gyro_bias_dph[POSITIONS[name].up_axis] for name in ALL])
    signs = np.array([POSITIONS[name].up_sign for name in ALL])
    assert abs(np.median(signs * (vertical(dwells) - truth))) > 0.001  # most dwells alone do not show it
    assert results.up_rate.finding is Finding.LATITUDE_OFF
    error = vertical(results.dwells) - truth
    assert abs(np.mean(signs * error)) < 0.0005
    assert np.abs(error / vertical(results.dwells, "sigma_dph")).max() < 3.0
    assert vertical(dwells, "common_sigma_dph").min() > 0.0  # of the latitude
    assert not vertical(results.dwells, "common_sigma_dph").any()
    binned = {(each.position, each.gyro): each.bias_dph for each in results.bins}
    assert binned["z_up", "z"] == pytest.approx(vertical(results.dwells)[ALL.index("z_up")])
    assert [dwell.row.flags for dwell in results.dwells] == [()] * len(ALL)


def test_level_biases_stay_as_measured():
    dwells, results = evaluated(1.0)
    for before, after in zip(dwells, results.dwells, strict=True):
        level = np.arange(3) != POSITIONS[before.row.position].up_axis
        assert np.array_equal(np.array(before.row.bias_dph)[level], np.array(after.row.bias_dph)[level])


def test_without_a_gyro_up_and_down_a_wrong_latitude_flags_the_dwells():
    _, results = evaluated(1.6, positions=("z_up",) * 6, declared_arcmin=0.6)
    assert results.up_rate.finding is Finding.NO_PAIR
    for dwell in results.dwells:
        assert dwell.row.flags[0].startswith(
            "a rate North fixed in the navigation frame indicates a latitude error"
        )
    assert results.bins == []


@pytest.mark.parametrize(
    ("error_arcmin", "declared_arcmin", "positions"),
    [
        (0.33, 0.33, ALL[:2]),
        *(pytest.param(*each, ALL, marks=LONG) for each in ((0.0, 0.33), (0.33, 0.33), (1.0, 0.6))),
    ],
)
def test_an_error_within_the_declared_uncertainty_changes_nothing(error_arcmin, declared_arcmin, positions):
    dwells, results = evaluated(error_arcmin, positions, declared_arcmin)
    assert [each.row for each in results.dwells] == [each.row for each in dwells]


@pytest.mark.parametrize(
    "error_arcmin", [5.0, pytest.param(-3.0, marks=LONG), pytest.param(20.0, marks=LONG)]
)
def test_a_latitude_far_off_is_named_and_corrected_and_passes_for_nothing_else(error_arcmin):
    dwells, results = evaluated(error_arcmin)
    assert [dwell.row.flags for dwell in results.dwells] == [()] * len(ALL)
    assert results.up_rate.finding is Finding.LATITUDE_OFF
    assert results.up_rate.latitude_error * RAD_TO_ARCMIN == pytest.approx(error_arcmin, abs=0.5)
    bias_dph = np.array([dwell.row.bias_dph for dwell in results.dwells])
    sigma_dph = np.array([dwell.row.sigma_dph for dwell in results.dwells])
    assert np.abs((bias_dph - UNIT.gyro_bias_dph) / sigma_dph).max() < 3.5
    assert np.abs(np.array([dwell.estimate.latitude_error for dwell in dwells])).min() > 0.0005


@pytest.mark.parametrize("positions", [ALL[:2], pytest.param(ALL, marks=LONG)], ids=["pair", "all"])
def test_a_degree_off_flags_every_dwell(positions):
    _, results = evaluated(60.0, positions)
    for dwell in results.dwells:
        assert re.search(r"latitude error of \+(59|60)", str(dwell.row.flags))
    assert results.bins == []
