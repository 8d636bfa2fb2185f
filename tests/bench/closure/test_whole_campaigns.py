"""Whole campaigns over bytes and frames, each with an effect that nobody declared, and the search on them."""

import numpy as np
import pytest

from bench.closure.closure import close_loop
from bench.measurement.campaign import read_campaign
from tests.bench.closure.campaigns import EFFECTS, run_campaign

OUTSIDE = ("supply_ripple", "mode_hop", "dither_crossing")
KNOWN = tuple(kind for kind in EFFECTS if kind not in OUTSIDE)


def closed(folder, *kinds):
    """Measure a unit with effects, and search what was measured; the world file stays unseen."""
    return close_loop(read_campaign(run_campaign(folder, [EFFECTS[kind] for kind in kinds]).path))


def noise_of_held_out(closure):
    return np.sqrt(np.mean(closure.campaign.sigma_dph[~closure.searched] ** 2))


def test_nothing_is_found_where_nothing_is_undeclared(tmp_path):
    closure = closed(tmp_path)
    assert closure.verdict == "clean"
    assert not closure.effects


@pytest.mark.parametrize("kind", KNOWN)
def test_an_undeclared_effect_is_named_and_its_error_falls_to_the_noise(tmp_path, kind):
    closure = closed(tmp_path, kind)
    [found] = closure.effects
    assert found.candidate.effect.name == kind
    assert found.axes == ("x", "y", "z")
    assert closure.verdict == ("ambiguous" if found.tied_with else "explained")
    assert closure.error_before_dph > 1.5 * noise_of_held_out(closure)
    assert closure.error_after_dph < 1.25 * noise_of_held_out(closure)


@pytest.mark.parametrize("kind", OUTSIDE)
def test_an_effect_that_no_candidate_describes_is_left_unexplained(tmp_path, kind):
    closure = closed(tmp_path, kind)
    assert closure.verdict == "unexplained"
    assert closure.error_after_dph <= 1.1 * closure.error_before_dph
