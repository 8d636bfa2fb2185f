"""The smallest change of a procedure with which effects could be told apart that now could not be."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

from gyrobench.bench.closure.planned_campaign import PlannedUnit, planned_campaign
from gyrobench.bench.closure.procedure_changes import CHANGES
from gyrobench.bench.closure.separability import Separability, searched_dwells, separability
from gyrobench.bench.foundations.documents import Document
from gyrobench.bench.foundations.errors import DocumentError
from gyrobench.bench.procedure.plan import Plan

#: Checks and plans a changed procedure on the same station.
Planner = Callable[[Document], Plan]

_S_PER_H = 3600.0
_SENSORS = ("measure the temperature of each gyro's electronics",)


@dataclass(frozen=True)
class Advice:
    """A change, and what it helps against.

    Attributes
    ----------
    what : tuple of str
        What to do, for a person, each a clause; empty where no change known is enough.
    added_h : float
        How much longer the procedure takes.
    found : tuple of str
        Effects that with it are found at the target size and told from all others; without it
        they were not found.
    pairs : tuple of (str, str)
        Pairs that are told apart with it at the target size and were not without it.
    lost : tuple of (str, str)
        Pairs that are told apart without it and are not with it.
    """

    what: tuple[str, ...]
    added_h: float
    found: tuple[str, ...]
    pairs: tuple[tuple[str, str], ...]
    lost: tuple[tuple[str, str], ...] = ()


def advise(
    document: Document,
    plan: Plan,
    planner: Planner,
    unit: PlannedUnit,
    now: Separability,
    target_dph: float,
) -> list[Advice]:
    """Find, for each effect and pair that a plan can't tell at some size, the smallest change that helps.

    Parameters
    ----------
    document, plan : Document, Plan
        The procedure.
    planner : callable
        Gives the plan of a changed procedure; a DocumentError says that it can't be run.
    unit : PlannedUnit
        The unit under test.
    now : Separability
        Of the plan as it is.
    target_dph : float
        Size of effect that matters, deg/h rms.

    Returns
    -------
    list of Advice
        The least added time first; what no change known helps against is last.
    """
    effects = [each.effect for each in now.detections]
    hidden = set(now.not_found(target_dph))
    pairs = set(now.not_told(target_dph))
    advice = []
    for what, added_h, changed_plan, changed_unit in _changed(document, plan, planner, unit):
        if not (hidden or pairs):
            break
        campaign = planned_campaign(changed_plan, changed_unit)
        if campaign.cycle.min() == campaign.cycle.max():  # a search holds one cycle out
            continue
        then = separability(searched_dwells(campaign), effects)
        found = {name for name in hidden if then.is_settled(name, target_dph)}
        told = {pair for pair in pairs if then.told_both_ways_dph(pair) <= target_dph}
        if found or told:
            lost = [pair for pair in then.not_told(target_dph) if now.told_both_ways_dph(pair) <= target_dph]
            advice.append(Advice(what, added_h, tuple(sorted(found)), tuple(sorted(told)), tuple(lost)))
            hidden -= found
            pairs -= told
    if hidden or pairs:
        advice.append(Advice((), 0.0, tuple(sorted(hidden)), tuple(sorted(pairs))))
    return advice


def _changed(
    document: Document, plan: Plan, planner: Planner, unit: PlannedUnit
) -> list[tuple[tuple[str, ...], float, Plan, PlannedUnit]]:
    """What each change makes of a procedure, the least added time first."""
    result = []
    for change in CHANGES:
        steps = change.apply(document.data["steps"])
        if steps is None:
            continue
        try:
            changed = planner(replace(document, data=document.data | {"steps": steps}))
        except DocumentError:  # this station can't do it
            continue
        result.append((change.what, (changed.duration_s - plan.duration_s) / _S_PER_H, changed, unit))
    if not unit.has_boards:
        result.append((_SENSORS, 0.0, plan, replace(unit, has_boards=True)))
    return sorted(result, key=lambda each: each[1])
