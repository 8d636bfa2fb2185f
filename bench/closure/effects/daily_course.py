"""Bias that follows the daily course of the room: its temperature acts on cables, supply and pier."""

from __future__ import annotations

from gyrobench.bench.closure.effects.grammar import Law, effect_of

_TWO_DAYS_S = 2.0 * 86_400.0

EFFECT = effect_of(
    Law("room_c"),
    name="daily_course",
    label="daily course of the room",
    statement="the bias follows the temperature of the room",
    experiment=(
        "log the temperature of the room beside one position and temperature held for two days: a daily "
        "course returns"
    ),
    terms=("room temperature, K",),
    imitated_by=("supply_power",),
    # Over two days and more a daily course returns: no drift looks like it.
    may_imitate=lambda campaign: float(campaign.end_s.max() - campaign.start_s.min()) < _TWO_DAYS_S,
)
