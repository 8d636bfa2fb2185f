"""Why effects are not found."""

from dataclasses import replace

from gyrobench.bench.closure.campaign import campaign_of
from gyrobench.bench.closure.effects import all_effects
from gyrobench.bench.closure.posterior import HypothesisProbability
from gyrobench.bench.closure.search import NOT_SIGNIFICANT
from gyrobench.bench.closure.selection import select
from tests.bench.closure.thermal_bench import measure


def test_an_effect_that_is_not_improbable_has_a_reason_though_alone_it_is_not_significant():
    campaign = campaign_of(measure({"bias_jump": 5.0}, cycles=2).rows)
    selected = select(campaign, campaign.cycle < 2, all_effects())
    weak = next(
        each
        for each in selected.search.effects
        if not each.missing_input(campaign) and not selected.search.add(selected.search.declared, each)
    )
    assert selected.rejection(weak) == ""
    beside = HypothesisProbability(selected.accepted.names | {weak.name}, False, 0.2, ())
    hypotheses = (*selected.posterior.hypotheses, beside)
    probable = replace(selected, posterior=replace(selected.posterior, hypotheses=hypotheses))
    assert probable.rejection(weak).startswith(f"{NOT_SIGNIFICANT} beside bias jump")
