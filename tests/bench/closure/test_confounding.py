"""What a design can't distinguish is named, and nothing of a good design."""

from dataclasses import replace

import numpy as np
import pytest

from gyrobench.bench.closure.campaign import campaign_of
from gyrobench.bench.closure.confounding import confounding
from tests.bench.closure.thermal_bench import UP, measure

DRIFT = "attitude cannot be distinguished from drift"


def named(searched=None, **options):
    campaign = campaign_of(measure(**options).rows)
    return confounding(campaign, campaign.all_dwells if searched is None else searched)


def test_of_mixed_attitudes_in_several_power_cycles_only_the_heading_is_confounded():
    [heading] = named(power_on_each_cycle=True, dwell_s=1680.0)
    assert heading.startswith("All dwells have one heading")
    rows = measure(power_on_each_cycle=True, dwell_s=1680.0).rows
    turned = campaign_of([replace(row, azimuth_deg=90.0 * (row.dwell % 4)) for row in rows])
    assert confounding(turned, turned.all_dwells) == ()


@pytest.mark.parametrize(
    ("headings_deg", "named_as"),
    [
        ([359.8, 0.1, 180.0, 179.9], "All dwells have one heading or its opposite"),
        ([0.0, 180.0, np.nan, 0.0], "All dwells have one heading or its opposite"),
        ([np.nan], "Headings were not recorded"),
        ([0.0, 90.0, np.nan, 0.0], None),
    ],
)
def test_a_heading_and_its_opposite_are_one_and_none_is_named_as_not_recorded(headings_deg, named_as):
    rows = measure(power_on_each_cycle=True, dwell_s=1680.0).rows
    rows = [replace(row, azimuth_deg=headings_deg[row.dwell % len(headings_deg)]) for row in rows]
    found = confounding(campaign_of(rows), np.ones(len(rows), dtype=bool))
    assert [each.split(":")[0].split(" (")[0] for each in found] == ([named_as] if named_as else [])
    assert all("magnetic field" in each for each in found)


def test_attitudes_measured_once_each_in_one_stretch_are_confounded_with_drift():
    count = len(measure(cycles=1).rows)
    blocks = [position for position in UP for _ in range(-(-count // 6))]
    [attitude] = [each for each in named(cycles=1, positions=blocks) if "attitude" in each]
    assert attitude.startswith("Each attitude was measured once, in one stretch of time")
    assert DRIFT in attitude
    assert not any("attitude" in each for each in named(cycles=1))


def test_one_attitude_shows_no_effect_of_attitude():
    assert "All dwells are in one attitude: no effect of attitude can be seen or excluded." in named(
        positions=["z_up"]
    )


def test_a_slow_warm_up_in_one_power_cycle_is_confounded_with_drift():
    assert any("one power cycle" in each for each in named())
    assert not any("one power cycle" in each for each in named(power_on_each_cycle=True, dwell_s=1680.0))


def test_one_cycle_searched_is_named():
    campaign = campaign_of(measure(cycles=2).rows)
    assert any("One cycle" in each for each in confounding(campaign, campaign.cycle == 1))


def test_confounding_does_not_depend_on_the_biases():
    rows = measure().rows
    other = [replace(row, bias_dph=tuple(-2.0 * each for each in row.bias_dph)) for row in rows]
    every = np.ones(len(rows), dtype=bool)
    assert confounding(campaign_of(rows), every) == confounding(campaign_of(other), every)
