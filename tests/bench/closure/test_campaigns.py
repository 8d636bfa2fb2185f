"""The campaigns that an analysis is tried on: what their dwells see, and how well they are measured."""

import numpy as np
import pytest

from gyrobench.bench.bias.dwell_table import read_dwells
from gyrobench.bench.cli.plan import declared_properties
from gyrobench.bench.closure.planned_campaign import planned_campaign
from gyrobench.bench.engine.job import prepare_job
from gyrobench.bench.foundations.documents import read_document
from gyrobench.bench.foundations.shipped import find_document
from gyrobench.bench.navigation.positions import POSITIONS
from gyrobench.drivers.emulators.world.world_file import load_world
from tests.bench.closure.campaigns import (
    EFFECTS,
    PROCEDURE,
    STATION,
    watched_campaign,
    write_procedure,
    write_world,
)
from tests.bench.closure.plans import shipped, station

pytestmark = pytest.mark.long

CYCLES, SOAKS, DWELLS, RESTING = 3, 4, 6, 4
HYSTERESIS = ("half_width_c", "sensitivity_dph_per_c")


@pytest.fixture(scope="module")
def campaign(tmp_path_factory):
    """A campaign with two effects that do not touch each other: its dwells and its truth."""
    effects = [EFFECTS["chamber_state"], EFFECTS["thermal_hysteresis"]]
    run, truth = watched_campaign(tmp_path_factory.mktemp("campaign"), effects, power_on_each_cycle=True)
    return read_dwells(run.dwells), truth


@pytest.fixture(scope="module")
def dwells(campaign):
    return campaign[0]


def settled(dwells):
    """The dwells of each temperature that follow its soak, in the order of time."""
    stops = [dwells[start : start + DWELLS] for start in range(0, len(dwells), DWELLS)]
    return [stop[-RESTING:] for stop in stops]


def test_all_dwells_are_measured_in_three_cycles(dwells):
    assert [row.dwell for row in dwells] == [*range(1, CYCLES * SOAKS * DWELLS + 1)]
    assert [row.cycle for row in dwells] == sorted([1, 2, 3] * SOAKS * DWELLS)
    assert not any(row.flags for row in dwells)


def test_each_power_on_is_a_separate_run(dwells):
    assert [row.run[-1] for row in dwells] == [str(row.cycle) for row in dwells]
    for cycle in (1, 2, 3):
        since_s = [row.since_power_on_s for row in dwells if row.cycle == cycle]
        assert since_s == sorted(since_s)
        assert since_s[0] < 0.05 * since_s[-1], "the time begins again with each"


def test_without_power_on_in_each_cycle_there_is_one_for_all(tmp_path):
    plan = prepare_job(str(write_procedure(tmp_path)), STATION).plan
    assert [planned.step.name for planned in plan.steps].count("power_on") == 1


def test_biases_are_as_far_from_the_truth_as_their_uncertainties_say(campaign):
    dwells, truth = campaign
    sigma_dph = np.array([row.sigma_dph for row in dwells])
    errors = (np.array([row.bias_dph for row in dwells]) - truth.bias_dph) / sigma_dph
    assert 0.0008 < sigma_dph.min() < sigma_dph.max() < 0.002
    # 216 errors, those of a dwell nearly independent.
    assert np.std(errors) == pytest.approx(1.0, abs=0.14)
    assert np.abs(errors.mean(axis=0)).max() < 4.0 / np.sqrt(len(errors))


def test_the_plan_predicts_the_uncertainty_of_the_vertical_gyro_without_accelerometers(dwells):
    """They increase the uncertainty of the level gyros, most in windows of a minute."""
    _, plan = shipped(PROCEDURE, STATION)
    planned_dph = planned_campaign(plan, declared_properties(station(STATION))).sigma_dph
    ratios = np.array([row.sigma_dph for row in dwells]) / planned_dph
    vertical = np.array([np.abs(POSITIONS[row.position].C_nb()[2]) > 0.5 for row in dwells])
    assert np.median(ratios[vertical]) == pytest.approx(1.0, abs=0.01)
    assert 1.0 < np.median(ratios[~vertical]) < 1.7


def test_two_cycles_have_all_positions_at_every_temperature_in_changing_order(dwells):
    orders = [tuple(row.position for row in stop) for stop in settled(dwells)]
    for stop in range(SOAKS):
        first, second, third = orders[stop::SOAKS]
        assert {*first, *second} == {*second, *third} == {*first, *third} == set(POSITIONS)
    assert len(set(orders)) == 3


def test_dwells_see_both_rates_up_and_down_and_temperatures_that_rest(dwells):
    fastest_c_per_h = {
        (rate, sign): max(sign * row.gyro_rate_c_per_h[0] for row in ramp)
        for rate, sign, ramp in [
            ("slow", 1, dwells[0:2]),
            ("fast", -1, dwells[6:8]),
            ("slow", -1, dwells[12:14]),
            ("fast", 1, dwells[18:20]),
        ]
    }
    assert fastest_c_per_h["slow", 1] == pytest.approx(215.0, abs=30.0)
    assert fastest_c_per_h["slow", -1] == pytest.approx(170.0, abs=30.0)
    assert min(fastest_c_per_h["fast", 1], fastest_c_per_h["fast", -1]) > 280.0
    resting = [row.gyro_rate_c_per_h for stop in settled(dwells) for row in stop[2:]]
    assert np.sqrt(np.mean(np.square(resting))) < 20.0


def test_the_temperatures_keep_the_proportions_of_a_real_unit(dwells):
    # On a ramp of 10 degC/min the difference changes within a dwell; soaked it is that of the heat flow.
    soaked = [row for stop in settled(dwells) for row in stop]
    warmer_c = np.array([np.subtract(row.board_c, row.gyro_c) for row in soaked])
    assert 8.0 < warmer_c.min() < warmer_c.max() < 18.0
    # On a ramp the optics are behind the chamber, which at rest they are not.
    behind_c = dwells[6].gyro_c[0] - np.mean([row.gyro_c[0] for row in settled(dwells)[1]])
    assert behind_c - (dwells[6].chamber_c - 20.0) > 7.0


def test_hysteresis_shows_at_the_same_temperature_from_above_and_from_below(campaign):
    dwells, truth = campaign
    added_dph = dict(zip([row.dwell for row in dwells], truth.undeclared_dph, strict=True))
    above, below = (settled(dwells)[stop][2:] for stop in (1, 3))
    gyro_c, loop_dph = (
        np.mean([of(row) for row in above], axis=0) - np.mean([of(row) for row in below], axis=0)
        for of in (lambda row: row.gyro_c, lambda row: added_dph[row.dwell])
    )
    assert np.abs(gyro_c).max() < 2.0
    half_width_c, sensitivity = (EFFECTS["thermal_hysteresis"][key] for key in HYSTERESIS)
    np.testing.assert_allclose(loop_dph, 2.0 * half_width_c * np.array(sensitivity), rtol=0.1)


@pytest.mark.parametrize("kind", EFFECTS)
def test_every_effect_is_one_that_a_world_file_takes(kind, tmp_path):
    [effect] = load_world(write_world(tmp_path, [EFFECTS[kind]])).undeclared_effects
    assert effect.kind == kind


def test_the_station_is_the_emulated_one_except_for_its_unit():
    def changed(one, other, at=""):
        if isinstance(one, dict) and isinstance(other, dict):
            keys = {*one, *other}
            return {path for key in keys for path in changed(one.get(key), other.get(key), f"{at}.{key}")}
        return set() if one == other else {at.lstrip(".")}

    quick, emulated = (read_document(find_document("stations", name)).data for name in (STATION, "emulated"))
    assert changed(quick, emulated) == {
        "station",
        "description",
        "tick_s",
        "poll_period_s",
        "instruments_period_s",
        "chamber.limits.ramp_c_per_min",
        "ins.signals.epoch_period_s",
        *("ins.signals.increments", "ins.commands.send_increments"),
        *("rate_table.repeatability_arcsec", "location.gravity_uncertainty_mps2"),
        "ins.noise.angle_random_walk_deg_per_sqrt_h",
        "ins.noise.velocity_random_walk_ug_per_sqrt_hz",
        "ins.uncertainty",
        "unit.thermal.time_constant_s",
        "unit.thermal.self_heating_c",
    }
