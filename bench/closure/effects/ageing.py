"""Bias that settles over days or weeks, through all power cycles."""

from __future__ import annotations

from gyrobench.bench.closure.campaign import Campaign
from gyrobench.bench.closure.effects.effect import searched_length_s, time_constant
from gyrobench.bench.closure.effects.grammar import Law, effect_of

_S_PER_DAY = 86_400.0


class _Ageing(Law):
    """A decay through all power cycles; in a single one it can't be distinguished from a slow warm-up."""

    def missing_input(self, campaign: Campaign) -> str | None:
        """Two power cycles and two days."""
        if len(campaign.power_on_s) > 1 and searched_length_s(campaign) > 2.0 * _S_PER_DAY:
            return None
        return "two power cycles and two days: in one, ageing looks like a slow warm-up"


EFFECT = effect_of(
    _Ageing("start", memory="decay", parameters=(time_constant(_S_PER_DAY, _S_PER_DAY, 3.0 * _S_PER_DAY),)),
    name="ageing",
    statement="the bias settles exponentially over days, through power-off and power-on",
    experiment=(
        "return to one position and temperature every day for twice the time constant, with a power-off in "
        "between: ageing continues where it was, a warm-up begins again"
    ),
    terms=("decay since the first dwell",),
)
