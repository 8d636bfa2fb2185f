"""Campaigns of the simulated bench and what the search makes of them, each made once."""

import pytest

from gyrobench.bench.closure.campaign import campaign_of
from gyrobench.bench.closure.loop import close_loop
from gyrobench.bench.closure.problem import declared_problem
from tests.bench.closure.thermal_bench import measure

#: What lets every effect be fitted: headings, power cycles, and all that can be logged.
EQUIPPED = {
    "headings_deg": (0.0, 90.0, 180.0, 270.0, 45.0),
    "power_on_each_cycle": True,
    "sensors": ("set", "air", "board", "supply", "room", "neighbours"),
}


@pytest.fixture(scope="session")
def closed():
    """``closed(effects, **options of measure)``: the search, of two cycles and two headings by default."""
    done = {}

    def close(effects=None, **options):
        options = {"cycles": 2, "headings_deg": (0.0, 90.0)} | options
        key = (*(effects or {}).items(), *sorted(options.items()))
        if key not in done:
            done[key] = close_loop(campaign_of(measure(effects, **options).rows))
        return done[key]

    return close


@pytest.fixture(scope="session")
def clean():
    """A campaign with no undeclared effect in it."""
    return campaign_of(measure().rows)


@pytest.fixture(scope="session")
def equipped():
    """As ``clean``, of a bench that varies and measures everything."""
    return campaign_of(measure(**EQUIPPED).rows)


@pytest.fixture(scope="session")
def problem():
    """``problem(effects, **options of measure)``: the last cycle held out, the declared model fitted."""

    def of(effects=None, **options):
        campaign = campaign_of(measure(effects, **options).rows)
        return declared_problem(campaign, campaign.cycle != campaign.cycle.max())

    return of


def among(*candidates, name="candidates"):
    """Parameter of a test: it searches for some effects, and as a long test for all."""
    long = pytest.param(None, id="all", marks=pytest.mark.long)
    return pytest.mark.parametrize(name, [pytest.param(candidates, id="some"), long])
