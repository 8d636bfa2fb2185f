"""Bias that drifts linearly with time."""

from __future__ import annotations

from gyrobench.bench.closure.effects.grammar import Law, effect_of

EFFECT = effect_of(
    Law("time_days"),
    name="time_drift",
    statement="the bias drifts linearly with time",
    experiment=(
        "return to one position and temperature at the beginning, in the middle and at the end of a "
        "power cycle, over two days or more"
    ),
    terms=("time, days",),
    imitated_by=("daily_course",),
)
