"""Finds the smallest change of a procedure after which effects can be found and distinguished.

A change takes the steps of a procedure as loaded from its YAML file and returns the changed steps, or None if
it does not apply. The result is checked and planned like any other file.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

from gyrobench.bench.closure.outcome import Closure
from gyrobench.bench.closure.planned_campaign import UnitProperties, planned_campaign
from gyrobench.bench.closure.separability import Separability, searched_dwells, separability
from gyrobench.bench.closure.tie_forecast import TieForecast, tie_forecasts
from gyrobench.bench.foundations.arrays import S_PER_H
from gyrobench.bench.foundations.documents import Document
from gyrobench.bench.foundations.errors import DocumentError
from gyrobench.bench.navigation.positions import POSITIONS
from gyrobench.bench.procedure.plan import Plan
from gyrobench.bench.procedure.procedure_file import variable_in
from gyrobench.bench.procedure.steps import (
    Align,
    GoTo,
    Navigate,
    PowerOff,
    PowerOn,
    SetChamber,
    Soak,
    Turn,
    Wait,
)

#: A step or loop: its name alone, or ``{name: {key: value}}``.
_Entry = Any
Steps = list[_Entry]

_REPEAT = "repeat"
_POWER_OFF_S, _POWER_ON_WAIT_S = 3600, 43_200
#: Tolerance with which a step ends while the temperature still changes.
_ANY_TEMPERATURE_C = 50.0
_DWELL_STEPS = {kind.name for kind in (GoTo, Align, Navigate, Turn, Wait)}


@dataclass(frozen=True)
class ProcedureChange:
    """A change of a procedure."""

    instructions: tuple[str, ...]  #: Clauses in the imperative: "switch the unit off ...".
    apply: Callable[[Steps], Steps | None]  #: Returns the changed steps, or None.


def _combined(*changes: ProcedureChange) -> ProcedureChange:
    """Several changes in sequence; None if one of them does not apply."""

    def apply(steps: Steps) -> Steps | None:
        changed: Steps | None = steps
        for change in changes:
            changed = None if changed is None else change.apply(changed)
        return changed

    instructions = tuple(each for change in changes for each in change.instructions)
    return ProcedureChange(instructions, apply)


def _another_cycle(steps: Steps) -> Steps | None:
    """Repeat the last cycle; without cycles, all measuring steps twice."""
    steps = list(_by_cycle(steps))
    cycles = [cycle for entry in steps if (cycle := _cycle(entry)) is not None]
    if cycles:
        last_cycle = [index for index, entry in enumerate(steps) if _cycle(entry) == max(cycles)]
        repeated = copy.deepcopy([steps[index] for index in last_cycle])
        for entry in repeated:
            entry[_REPEAT]["over"]["cycle"] = [max(cycles) + 1]
        return [*steps[: last_cycle[-1] + 1], *repeated, *steps[last_cycle[-1] + 1 :]]
    measuring = [index for index, entry in enumerate(steps) if _has_navigation(entry)]
    if not measuring:
        return None
    first = measuring[0]
    while first > 0 and _step_name(steps[first - 1]) in _DWELL_STEPS:
        first -= 1
    measured_part, remaining = steps[first : measuring[-1] + 1], steps[measuring[-1] + 1 :]
    if any("cycle" in loop["over"] for loop in _loops(measured_part)):
        return None
    return [*steps[:first], {_REPEAT: {"over": {"cycle": [1, 2]}, "steps": measured_part}}, *remaining]


def _power_cycle(steps: Steps) -> Steps | None:
    """Switch the unit off and on again before each cycle except the first."""
    steps = list(_by_cycle(steps))
    power_on = next((entry for entry in steps if _step_name(entry) == PowerOn.name), None)
    changed: Steps = []
    previous_cycle: int | None = None
    for entry in steps:
        cycle = _cycle(entry)
        if power_on and previous_cycle is not None and cycle is not None and cycle != previous_cycle:
            changed += [PowerOff.name, {Wait.name: {"duration_s": _POWER_OFF_S}}, copy.deepcopy(power_on)]
        previous_cycle = previous_cycle if cycle is None else cycle
        changed.append(entry)
    powered_ons = sum(_step_name(entry) == PowerOn.name for entry in steps)
    return changed if powered_ons == 1 and len(changed) > len(steps) else None


def _leave_on(steps: Steps) -> Steps | None:
    """Wait for a long time with the unit on: a warm-up ends, a drift continues."""
    steps = list(_by_cycle(steps))
    cycles = [_cycle(entry) for entry in steps]
    distinct = sorted({cycle for cycle in cycles if cycle is not None})
    if len(distinct) < 2:
        return None
    second = cycles.index(distinct[1])
    return [*steps[:second], {Wait.name: {"duration_s": _POWER_ON_WAIT_S}}, *steps[second:]]


def _measure_on_ramps(steps: Steps) -> Steps | None:
    """Measure two positions between each ramp and its soak, while the temperature changes."""
    changed = copy.deepcopy(steps)
    for entries in [changed, *(loop["steps"] for loop in _loops(changed))]:
        for index in range(len(entries) - 3, -1, -1):
            ramp, soak, measurement = entries[index : index + 3]
            positions = _positions(measurement)
            if _step_name(ramp) == SetChamber.name and _step_name(soak) == Soak.name and len(positions) > 1:
                ramp[SetChamber.name]["within_c"] = _ANY_TEMPERATURE_C
                moving = copy.deepcopy(measurement)
                moving[_REPEAT]["over"]["position"] = positions[:2]
                entries.insert(index + 1, moving)
    return None if changed == steps else changed


def _return_to_first_position(steps: Steps) -> Steps | None:
    """Repeat the first position of each plateau at its end."""
    return _change_positions(steps, lambda names: [*names, *(names[:1] if names[-1] != names[0] else [])])


def _all_positions(steps: Steps) -> Steps | None:
    """Add those of the six positions that a plateau lacks."""
    return _change_positions(
        steps, lambda names: [*names, *(name for name in POSITIONS if name not in names)]
    )


def _change_positions(steps: Steps, lengthen: Callable[[list[str]], list[str]]) -> Steps | None:
    changed = copy.deepcopy(steps)
    for loop in _loops(changed):
        if loop["over"].get("position"):
            loop["over"]["position"] = lengthen(loop["over"]["position"])
    return None if changed == steps else changed


def _middle_temperature_again(steps: Steps) -> Steps | None:
    """Repeat the middle temperature of each cycle at its end, approached from the other side."""
    unchanged = list(_by_cycle(steps))
    changed = copy.deepcopy(unchanged)
    loops_by_cycle: dict[int, list[tuple[dict[str, Any], str]]] = {}
    for entry in changed:
        cycle = _cycle(entry)
        variable = _temperature_variable(entry) if cycle is not None else None
        if cycle is not None and variable is not None:
            loops_by_cycle.setdefault(cycle, []).append((entry[_REPEAT]["over"], variable))
    for loops in loops_by_cycle.values():
        temperatures_c = [value for over, variable in loops for value in over[variable]]
        over, variable = loops[-1]
        others_c = sorted(set(temperatures_c) - {temperatures_c[-1]})
        if others_c and all(len(values) == 1 for name, values in over.items() if name != variable):
            over[variable] = [*over[variable], others_c[len(others_c) // 2 if len(others_c) > 2 else 0]]
    return None if changed == unchanged else changed


def _half_the_ramp_rate(steps: Steps) -> Steps | None:
    """Run every second cycle at half the ramp rate."""
    unchanged = list(_by_cycle(steps))
    changed = copy.deepcopy(unchanged)
    cycles = sorted({cycle for entry in changed if (cycle := _cycle(entry)) is not None})
    for entry in changed:
        if _cycle(entry) not in cycles[1::2]:
            continue
        for loop in _loops([entry]):
            for name in _ramp_variables(loop["steps"]) & set(loop["over"]):
                loop["over"][name] = [0.5 * value for value in loop["over"][name]]
            for inner in loop["steps"]:
                rate = (
                    inner[SetChamber.name]["ramp_c_per_min"] if _step_name(inner) == SetChamber.name else None
                )
                if isinstance(rate, int | float):
                    inner[SetChamber.name]["ramp_c_per_min"] = 0.5 * rate
    return None if changed == unchanged else changed


_RETURN_TO_FIRST = ProcedureChange(
    ("return to the first position at the end of each plateau",), _return_to_first_position
)
_MEASURE_ON_RAMPS = ProcedureChange(("measure two positions on each ramp",), _measure_on_ramps)
_ALL_POSITIONS = ProcedureChange(("measure all six positions at each temperature",), _all_positions)
_POWER_CYCLE = ProcedureChange(("switch the unit off for an hour between cycles",), _power_cycle)
_MIDDLE_TEMPERATURE = ProcedureChange(
    ("return to the middle temperature at the end of each cycle",), _middle_temperature_again
)
_HALF_RAMP_RATE = ProcedureChange(("run every second cycle at half the ramp rate",), _half_the_ramp_rate)
_ANOTHER_CYCLE = ProcedureChange(("add a cycle",), _another_cycle)
_LEAVE_ON = ProcedureChange(("leave the unit on for 12 h before the second cycle",), _leave_on)

#: All known changes, alone and combined.
CHANGES: tuple[ProcedureChange, ...] = (
    _RETURN_TO_FIRST,
    _MEASURE_ON_RAMPS,
    _ALL_POSITIONS,
    _POWER_CYCLE,
    _MIDDLE_TEMPERATURE,
    _HALF_RAMP_RATE,
    _ANOTHER_CYCLE,
    _combined(_MEASURE_ON_RAMPS, _MIDDLE_TEMPERATURE),
    _combined(_MEASURE_ON_RAMPS, _RETURN_TO_FIRST),
    _combined(_MEASURE_ON_RAMPS, _POWER_CYCLE),
    _combined(_ANOTHER_CYCLE, _POWER_CYCLE),
    _combined(_ANOTHER_CYCLE, _MEASURE_ON_RAMPS),
    _combined(_ANOTHER_CYCLE, _MEASURE_ON_RAMPS, _MIDDLE_TEMPERATURE),
    _combined(_ANOTHER_CYCLE, _POWER_CYCLE, _MEASURE_ON_RAMPS),
    _combined(_ANOTHER_CYCLE, _POWER_CYCLE, _MEASURE_ON_RAMPS, _MIDDLE_TEMPERATURE),
    _LEAVE_ON,
    _combined(_ANOTHER_CYCLE, _LEAVE_ON),
    _combined(_ANOTHER_CYCLE, _LEAVE_ON, _MEASURE_ON_RAMPS),
)


def _step_name(entry: _Entry) -> str:
    return entry if isinstance(entry, str) else str(next(iter(entry)))


def _loops(entries: Steps) -> Iterator[dict[str, Any]]:
    """All loops, outer ones first."""
    for entry in entries:
        if _step_name(entry) == _REPEAT:
            yield entry[_REPEAT]
            yield from _loops(entry[_REPEAT]["steps"])


def _has_navigation(entry: _Entry) -> bool:
    steps = [entry, *(step for loop in _loops([entry]) for step in loop["steps"])]
    return any(_step_name(step) == Navigate.name for step in steps)


def _cycle(entry: _Entry) -> int | None:
    """Cycle of a loop over a single cycle."""
    cycles = entry[_REPEAT]["over"].get("cycle", []) if _step_name(entry) == _REPEAT else []
    return int(cycles[0]) if len(cycles) == 1 else None


def _by_cycle(steps: Steps) -> Iterator[_Entry]:
    """Steps with one loop per cycle in place of each loop whose outermost variable is the cycle."""
    for entry in steps:
        over = entry[_REPEAT]["over"] if _step_name(entry) == _REPEAT else {}
        if next(iter(over), None) == "cycle":
            for cycle in over["cycle"]:
                single_cycle = copy.deepcopy(entry)
                single_cycle[_REPEAT]["over"]["cycle"] = [cycle]
                yield single_cycle
        else:
            yield entry


def _positions(entry: _Entry) -> list[str]:
    over = entry[_REPEAT]["over"] if _step_name(entry) == _REPEAT else {}
    return over.get("position", []) if _has_navigation(entry) else []


def _temperature_variable(entry: _Entry) -> str | None:
    """Variable of a loop that sets the chamber temperature."""
    for step in entry[_REPEAT]["steps"]:
        if _step_name(step) == SetChamber.name:
            name = variable_in(step[SetChamber.name]["temperature_c"])
            return name if name in entry[_REPEAT]["over"] else None
    return None


def _ramp_variables(entries: Steps) -> set[str]:
    ramps = [
        entry[SetChamber.name]["ramp_c_per_min"] for entry in entries if _step_name(entry) == SetChamber.name
    ]
    return {name for ramp in ramps if (name := variable_in(ramp)) is not None}


_ADD_SENSORS = ("measure the temperature of each gyro's electronics",)


@dataclass(frozen=True)
class ChangeablePlan:
    """A planned procedure of a unit."""

    document: Document
    plan: Plan
    #: Plans a changed procedure for the same station; raises a DocumentError if it can't be run.
    planner: Callable[[Document], Plan]
    unit: UnitProperties

    def changed(self) -> list[tuple[tuple[str, ...], float, Plan, UnitProperties]]:
        """Instructions, added hours, plan and unit of each change, shortest added time first."""
        result = []
        for change in CHANGES:
            steps = change.apply(self.document.data["steps"])
            if steps is None:
                continue
            try:
                plan = self.planner(replace(self.document, data=self.document.data | {"steps": steps}))
            except DocumentError:  # the station can't run it
                continue
            added_h = (plan.duration_s - self.plan.duration_s) / S_PER_H
            result.append((change.instructions, added_h, plan, self.unit))
        if not self.unit.has_boards:
            result.append((_ADD_SENSORS, 0.0, self.plan, replace(self.unit, has_boards=True)))
        return sorted(result, key=lambda each: each[1])


@dataclass(frozen=True)
class Advice:
    """A change of a procedure and its benefit."""

    #: Clauses in the imperative; empty if no known change is sufficient.
    instructions: tuple[str, ...]
    added_h: float  #: Additional duration.
    #: Effects that are found at the target size and distinguished from all others only with the change.
    found: tuple[str, ...]
    pairs: tuple[
        tuple[str, str], ...
    ]  #: Pairs that are distinguished at the target size only with the change.
    lost: tuple[tuple[str, str], ...] = ()  #: Pairs that are distinguished only without the change.


def advise(unchanged: ChangeablePlan, present: Separability, target_dph: float) -> list[Advice]:
    """Find the smallest change for each effect not found and each pair not distinguished at a target size.

    Returns the changes with the shortest added time first; effects and pairs that no known change resolves
    are in the last item. ``present``: separability of the unchanged plan. ``target_dph``: target size,
    deg/h rms.
    """
    effects = [each.effect for each in present.detections]
    not_found = set(present.not_found(target_dph))
    pairs = set(present.not_distinguished(target_dph))
    advice = []
    for instructions, added_h, plan, unit in unchanged.changed():
        if not (not_found or pairs):
            break
        campaign = planned_campaign(plan, unit)
        if campaign.cycle.min() == campaign.cycle.max():  # a search holds out one cycle
            continue
        with_change = separability(searched_dwells(campaign), effects)
        found = {name for name in not_found if with_change.is_settled(name, target_dph)}
        resolved = {pair for pair in pairs if with_change.distinguished_both_ways_dph(pair) <= target_dph}
        if found or resolved:
            lost = [
                pair
                for pair in with_change.not_distinguished(target_dph)
                if present.distinguished_both_ways_dph(pair) <= target_dph
            ]
            advice.append(
                Advice(instructions, added_h, tuple(sorted(found)), tuple(sorted(resolved)), tuple(lost))
            )
            not_found -= found
            pairs -= resolved
    if not_found or pairs:
        advice.append(Advice((), 0.0, tuple(sorted(not_found)), tuple(sorted(pairs))))
    return advice


def advise_ties(unchanged: ChangeablePlan, closure: Closure, present: Sequence[TieForecast]) -> list[Advice]:
    """Find the smallest change after which each tie of a closure is expected to be resolved.

    Like :func:`advise`, with the dwells of the closure included. ``present``: ties after the unchanged plan.
    """
    open_ties = {(each.found, each.other) for each in present if not each.is_settled}
    advice = []
    for instructions, added_h, plan, unit in unchanged.changed():
        if not open_ties:
            break
        forecasts = tie_forecasts(closure, planned_campaign(plan, unit))
        resolved = {(each.found, each.other) for each in forecasts if each.is_settled} & open_ties
        if resolved:
            advice.append(Advice(instructions, added_h, (), tuple(sorted(resolved))))
            open_ties -= resolved
    return [*advice, Advice((), 0.0, (), tuple(sorted(open_ties)))] if open_ties else advice
