"""The smallest change of a procedure after which effects can be distinguished."""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any

from gyrobench.bench.closure.planned_campaign import PlannedUnit, planned_campaign
from gyrobench.bench.closure.separability import Separability, searched_dwells, separability
from gyrobench.bench.foundations.documents import Document
from gyrobench.bench.foundations.errors import DocumentError
from gyrobench.bench.navigation.positions import POSITIONS
from gyrobench.bench.procedure.plan import Plan
from gyrobench.bench.procedure.procedure_file import variable_in
from gyrobench.bench.procedure.steps import (
    Align,
    Chamber,
    GoTo,
    Navigate,
    PowerOff,
    PowerOn,
    Soak,
    Turn,
    Wait,
)

#: A step or loop: its name alone, or ``{name: {key: value}}``.
Entry = Any
Steps = list[Entry]

_REPEAT = "repeat"
_OFF_S, _LEFT_ON_S = 3600, 43_200
#: So wide that the step ends while the temperature still moves.
_ANYWHERE_C = 50.0
_OF_A_DWELL = {kind.name for kind in (GoTo, Align, Navigate, Turn, Wait)}


@dataclass(frozen=True)
class ProcedureChange:
    """A change.

    Attributes
    ----------
    what : tuple of str
        What to do, for a person, each a clause: "switch the unit off ...".
    apply : callable
        Changed steps, or None.
    """

    what: tuple[str, ...]
    apply: Callable[[Steps], Steps | None]


def _together(*changes: ProcedureChange) -> ProcedureChange:
    """Several changes, one after the other; None if one of them can't be made."""

    def apply(steps: Steps) -> Steps | None:
        changed: Steps | None = steps
        for change in changes:
            changed = None if changed is None else change.apply(changed)
        return changed

    return ProcedureChange(tuple(what for change in changes for what in change.what), apply)


def _another_cycle(steps: Steps) -> Steps | None:
    """The last cycle once more; where there are no cycles, everything after power-on twice."""
    steps = list(_by_cycle(steps))
    cycles = [cycle for entry in steps if (cycle := _cycle(entry)) is not None]
    if cycles:
        mine = [index for index, entry in enumerate(steps) if _cycle(entry) == max(cycles)]
        again = copy.deepcopy([steps[index] for index in mine])
        for entry in again:
            entry[_REPEAT]["over"]["cycle"] = [max(cycles) + 1]
        return [*steps[: mine[-1] + 1], *again, *steps[mine[-1] + 1 :]]
    measuring = [index for index, entry in enumerate(steps) if _measures(entry)]
    if not measuring:
        return None
    first = measuring[0]
    while first > 0 and _name(steps[first - 1]) in _OF_A_DWELL:
        first -= 1
    inside, after = steps[first : measuring[-1] + 1], steps[measuring[-1] + 1 :]
    if any("cycle" in loop["over"] for loop in _loops(inside)):
        return None
    return [*steps[:first], {_REPEAT: {"over": {"cycle": [1, 2]}, "steps": inside}}, *after]


def _power_cycle(steps: Steps) -> Steps | None:
    """The unit off for a while and on again before each cycle but the first."""
    steps = list(_by_cycle(steps))
    power_on = next((entry for entry in steps if _name(entry) == PowerOn.name), None)
    changed: Steps = []
    before: int | None = None
    for entry in steps:
        cycle = _cycle(entry)
        if power_on and before is not None and cycle is not None and cycle != before:
            changed += [PowerOff.name, {Wait.name: {"duration_s": _OFF_S}}, copy.deepcopy(power_on)]
        before = before if cycle is None else cycle
        changed.append(entry)
    powered_ons = sum(_name(entry) == PowerOn.name for entry in steps)
    return changed if powered_ons == 1 and len(changed) > len(steps) else None


def _leave_on(steps: Steps) -> Steps | None:
    """A long wait with the unit on: a warm-up is over after it, a drift goes on."""
    steps = list(_by_cycle(steps))
    cycles = [_cycle(entry) for entry in steps]
    known = sorted({cycle for cycle in cycles if cycle is not None})
    if len(known) < 2:
        return None
    second = cycles.index(known[1])
    return [*steps[:second], {Wait.name: {"duration_s": _LEFT_ON_S}}, *steps[second:]]


def _measure_on_ramps(steps: Steps) -> Steps | None:
    """Two positions more between each ramp and its soak, while the temperature moves."""
    changed = copy.deepcopy(steps)
    found = False
    for entries in [changed, *(loop["steps"] for loop in _loops(changed))]:
        for index in range(len(entries) - 3, -1, -1):
            ramp, soak, stay = entries[index : index + 3]
            positions = _positions(stay)
            if _name(ramp) == Chamber.name and _name(soak) == Soak.name and len(positions) > 1:
                ramp[Chamber.name]["within_c"] = _ANYWHERE_C
                moving = copy.deepcopy(stay)
                moving[_REPEAT]["over"]["position"] = positions[:2]
                entries.insert(index + 1, moving)
                found = True
    return changed if found else None


def _return_to_first_position(steps: Steps) -> Steps | None:
    """The first position of each stop once more at its end."""
    return _with_positions(steps, lambda names: [*names, *(names[:1] if names[-1] != names[0] else [])])


def _all_positions(steps: Steps) -> Steps | None:
    """Those of the six positions that a stop lacks."""
    return _with_positions(steps, lambda names: [*names, *(name for name in POSITIONS if name not in names)])


def _with_positions(steps: Steps, lengthened: Callable[[list[str]], list[str]]) -> Steps | None:
    changed = copy.deepcopy(steps)
    for loop in _loops(changed):
        if loop["over"].get("position"):
            loop["over"]["position"] = lengthened(loop["over"]["position"])
    return None if changed == steps else changed


def _middle_temperature_again(steps: Steps) -> Steps | None:
    """The middle temperature of each cycle once more at the cycle's end, from the other side."""
    changed = list(_by_cycle(copy.deepcopy(steps)))
    stops: dict[int, list[tuple[dict[str, Any], str]]] = {}
    for entry in changed:
        cycle = _cycle(entry)
        variable = _temperature_variable(entry) if cycle is not None else None
        if cycle is not None and variable is not None:
            stops.setdefault(cycle, []).append((entry[_REPEAT]["over"], variable))
    found = False
    for loops in stops.values():
        temperatures_c = [value for over, variable in loops for value in over[variable]]
        over, variable = loops[-1]
        others_c = sorted(set(temperatures_c) - {temperatures_c[-1]})
        if others_c and all(len(values) == 1 for name, values in over.items() if name != variable):
            over[variable] = [*over[variable], others_c[len(others_c) // 2 if len(others_c) > 2 else 0]]
            found = True
    return changed if found else None


def _half_the_ramp_rate(steps: Steps) -> Steps | None:
    """Every second cycle at half the ramp rate."""
    changed = list(_by_cycle(copy.deepcopy(steps)))
    cycles = sorted({cycle for entry in changed if (cycle := _cycle(entry)) is not None})
    found = False
    for entry in changed:
        if _cycle(entry) not in cycles[1::2]:
            continue
        for loop in _loops([entry]):
            for name in _ramp_variables(loop["steps"]) & set(loop["over"]):
                loop["over"][name] = [0.5 * value for value in loop["over"][name]]
                found = True
            for inner in loop["steps"]:
                rate = inner[Chamber.name]["ramp_c_per_min"] if _name(inner) == Chamber.name else None
                if isinstance(rate, int | float):
                    inner[Chamber.name]["ramp_c_per_min"] = 0.5 * rate
                    found = True
    return changed if found else None


_RETURN = ProcedureChange(
    ("return to the first position at the end of each temperature",), _return_to_first_position
)
_ON_RAMPS = ProcedureChange(("measure two positions on each ramp",), _measure_on_ramps)
_ALL = ProcedureChange(("take all six positions at each temperature",), _all_positions)
_POWER = ProcedureChange(("switch the unit off for an hour between cycles",), _power_cycle)
_MIDDLE = ProcedureChange(
    ("come back to the middle temperature at the end of each cycle",), _middle_temperature_again
)
_SLOWER = ProcedureChange(("run every second cycle at half the ramp rate",), _half_the_ramp_rate)
_CYCLE = ProcedureChange(("add a cycle",), _another_cycle)
_LEFT_ON = ProcedureChange(("leave the unit on for 12 h before the second cycle",), _leave_on)

#: All changes known, alone and together.
CHANGES: tuple[ProcedureChange, ...] = (
    _RETURN,
    _ON_RAMPS,
    _ALL,
    _POWER,
    _MIDDLE,
    _SLOWER,
    _CYCLE,
    _together(_ON_RAMPS, _MIDDLE),
    _together(_ON_RAMPS, _RETURN),
    _together(_ON_RAMPS, _POWER),
    _together(_CYCLE, _POWER),
    _together(_CYCLE, _ON_RAMPS),
    _together(_CYCLE, _ON_RAMPS, _MIDDLE),
    _together(_CYCLE, _POWER, _ON_RAMPS),
    _together(_CYCLE, _POWER, _ON_RAMPS, _MIDDLE),
    _LEFT_ON,
    _together(_CYCLE, _LEFT_ON),
    _together(_CYCLE, _LEFT_ON, _ON_RAMPS),
)


def _name(entry: Entry) -> str:
    return entry if isinstance(entry, str) else str(next(iter(entry)))


def _loops(entries: Steps) -> Iterator[dict[str, Any]]:
    """All loops, outer ones first."""
    for entry in entries:
        if _name(entry) == _REPEAT:
            yield entry[_REPEAT]
            yield from _loops(entry[_REPEAT]["steps"])


def _measures(entry: Entry) -> bool:
    inside = [entry, *(step for loop in _loops([entry]) for step in loop["steps"])]
    return any(_name(step) == Navigate.name for step in inside)


def _cycle(entry: Entry) -> int | None:
    """Cycle of a loop that is in one cycle alone."""
    cycles = entry[_REPEAT]["over"].get("cycle", []) if _name(entry) == _REPEAT else []
    return int(cycles[0]) if len(cycles) == 1 else None


def _by_cycle(steps: Steps) -> Iterator[Entry]:
    """Steps with one loop for each cycle where the outermost variable of a loop is the cycle."""
    for entry in steps:
        over = entry[_REPEAT]["over"] if _name(entry) == _REPEAT else {}
        if next(iter(over), None) == "cycle":
            for cycle in over["cycle"]:
                one = copy.deepcopy(entry)
                one[_REPEAT]["over"]["cycle"] = [cycle]
                yield one
        else:
            yield entry


def _positions(entry: Entry) -> list[str]:
    over = entry[_REPEAT]["over"] if _name(entry) == _REPEAT else {}
    return over.get("position", []) if _measures(entry) else []


def _temperature_variable(entry: Entry) -> str | None:
    """Variable of a loop that sets the chamber in it."""
    for step in entry[_REPEAT]["steps"]:
        if _name(step) == Chamber.name:
            name = variable_in(step[Chamber.name]["temperature_c"])
            return name if name in entry[_REPEAT]["over"] else None
    return None


def _ramp_variables(entries: Steps) -> set[str]:
    ramps = [entry[Chamber.name]["ramp_c_per_min"] for entry in entries if _name(entry) == Chamber.name]
    return {name for ramp in ramps if (name := variable_in(ramp)) is not None}


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
