"""Whole campaigns over bytes and frames, each with an undeclared effect, and the search on them."""

import numpy as np
import pytest

from gyrobench.bench.closure.inputs import read_campaign
from gyrobench.bench.closure.loop import close_loop
from gyrobench.bench.closure.posterior import EXPLAINED
from tests.bench.closure.campaigns import EFFECTS, run_campaign

pytestmark = pytest.mark.long

#: By the cycles that its campaign takes.
OUTSIDE = {"supply_ripple": 2, "mode_hop": 2, "dither_crossing": 3, "loose_clamp": 3}
#: Each effect that the search knows is in one of these.
ALL_PROCESSES = (
    ("thermal_gradient",),
    ("temperature_rate", "g_sensitivity"),
    ("thermal_hysteresis", "bias_jump"),
    ("attitude_thermal", "warm_up"),
    ("chamber_state", "time_drift"),
)


def closed(folder, *kinds, cycles=3):
    """Measure a unit with effects, and search what was measured; the world file stays unseen."""
    run = run_campaign(folder, [EFFECTS[kind] for kind in kinds], cycles=cycles)
    return close_loop(read_campaign(run.path))


def noise_of_held_out(closure):
    return np.sqrt(np.mean(closure.campaign.sigma_dph[~closure.searched] ** 2))


def test_nothing_is_found_where_nothing_is_undeclared(tmp_path):
    closure = closed(tmp_path, cycles=2)
    assert closure.verdict == "clean"
    assert not closure.effects


def test_every_effect_of_the_world_is_hidden_in_a_campaign():
    assert sorted([*OUTSIDE, *(kind for kinds in ALL_PROCESSES for kind in kinds)]) == sorted(EFFECTS)


@pytest.mark.parametrize("kinds", ALL_PROCESSES, ids="+".join)
def test_undeclared_effects_are_named_and_the_error_falls_to_the_noise(tmp_path, kinds):
    closure = closed(tmp_path, *kinds)
    assert {each.candidate.effect.name for each in closure.effects} == set(kinds)
    assert all(each.axes == ("x", "y", "z") for each in closure.effects)
    probability = closure.posterior.joint_probability(kinds)
    tied = any(each.tied_with for each in closure.effects)
    assert tied or closure.posterior.set_probability(kinds) > 0.5
    is_open = tied or closure.posterior.rivals(kinds)
    assert closure.verdict == ("explained" if probability >= EXPLAINED and not is_open else "ambiguous")
    assert closure.error_before_dph > 1.5 * noise_of_held_out(closure)
    assert closure.error_after_dph < 1.3 * noise_of_held_out(closure)


@pytest.mark.parametrize("kind", OUTSIDE)
def test_an_effect_that_no_candidate_describes_is_left_unexplained(tmp_path, kind):
    closure = closed(tmp_path, kind, cycles=OUTSIDE[kind])
    assert closure.verdict == "unexplained"
    assert closure.error_after_dph <= 1.1 * closure.error_before_dph
