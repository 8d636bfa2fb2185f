"""Re-approach after an interruption: the steps that restore what the plan expects before one of its steps.

After a power cut, a trip or a pause the INS may be off or cold, the chamber at another temperature or on the
other side of it, the table anywhere. The re-approach consists of steps of the plan.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

from gyrobench.bench.procedure.plan import Plan, PlannedStep
from gyrobench.bench.procedure.steps import ChamberOff, GoTo, PowerOff, PowerOn, SetChamber, Soak, Step, Wait

#: A soak begins when the air is this near to the set point, even if the chamber's step ends earlier.
_NEAR_C = 1.0


@dataclass(frozen=True)
class RetainedState:
    """What remains valid: whether the INS stayed on, the chamber held its set point; air temperature now."""

    is_ins_on: bool
    is_at_temperature: bool
    chamber_c: float


def restart_of(plan: Plan, index: int) -> int:
    """Index of the step to restart from: a dwell is repeated whole, from its alignment."""
    dwell = plan.steps[index].dwell
    if dwell is None:
        return index
    return next(i for i, planned in enumerate(plan.steps) if planned.dwell == dwell)


def end_of_dwell(plan: Plan, dwell: int) -> int:
    """Index of the first step after a dwell."""
    return 1 + max(i for i, planned in enumerate(plan.steps) if planned.dwell == dwell)


def approach(plan: Plan, index: int, retained: RetainedState) -> list[PlannedStep]:
    """Steps that bring the bench to what the plan expects before one of its steps; none without dwells left.

    The INS is power-cycled, so that the time since power-on is known; its temperature is reached from the
    same side as in the plan, with the same soaks; a ramp with a dwell on it is repeated from the temperature
    before. Steps keep their number in the plan; durations and time limits are those from the present state.
    """
    target = plan.steps[index]
    if plan.dwell_count and not any(planned.dwell for planned in plan.steps[index:]):
        return []
    is_cold = target.before.powered and not retained.is_ins_on
    steps = _latest(plan, index, PowerOn) if is_cold else []
    if is_cold or not retained.is_at_temperature or _is_on_ramp(plan, index):
        steps += _tempering(plan, index, retained.chamber_c)
    # In the order of the plan: temperatures that were soaked with the INS off are again.
    steps.sort(key=lambda planned: planned.number)
    if _is_to_be_off(plan, index, steps):
        steps.insert(0, replace(target, step=PowerOff()))
    if target.before.position is not None and _stands_in_position(plan, index):
        steps += _position(plan, index)
    return list(_timed(steps, target, retained.chamber_c))


def _is_on_ramp(plan: Plan, index: int) -> bool:
    """Whether the plan comes to a dwell straight from the chamber's command, without a soak."""
    command = _latest(plan, index, SetChamber, ChamberOff)
    if plan.steps[index].dwell is None or not command or isinstance(command[0].step, ChamberOff):
        return False
    return not _soaks_between(plan, command[0], index)


def _is_to_be_off(plan: Plan, index: int, steps: list[PlannedStep]) -> bool:
    """Whether the INS has to be off first, where the plan has switched it on before."""
    if not _latest(plan, index, PowerOn):
        return False
    if not plan.steps[index].before.powered:
        return True
    return bool(steps) and any(isinstance(each.step, PowerOn) for each in steps[1:])


def _stands_in_position(plan: Plan, index: int) -> bool:
    """Whether the present position is used before the table goes to another."""
    for planned in plan.steps[index:]:
        if isinstance(planned.step, GoTo):
            return False
        if planned.in_position:
            return True
    return False


def _latest(plan: Plan, index: int, *kinds: type[Step]) -> list[PlannedStep]:
    """The last step of these kinds before one, in a list; empty where there is none."""
    earlier = (planned for planned in reversed(plan.steps[:index]) if isinstance(planned.step, kinds))
    return [planned for planned in (next(earlier, None),) if planned is not None]


def _tempering(plan: Plan, index: int, chamber_c: float) -> list[PlannedStep]:
    """Bring temperatures to what they are when the step at ``index`` begins."""
    target = plan.steps[index]
    if isinstance(target.step, ChamberOff):
        return []
    if isinstance(target.step, SetChamber) and _is_on_its_way(target, chamber_c):
        return [] if _soaks_before_dwells(plan, index) else _history(plan, index, chamber_c)
    return _history(plan, index, chamber_c)


def _history(plan: Plan, index: int, chamber_c: float) -> list[PlannedStep]:
    """The chamber's last command before a step with its soaks, and what has to come before it."""
    command = _latest(plan, index, SetChamber, ChamberOff)
    if not command or isinstance(command[0].step, ChamberOff):
        return command
    (chamber,) = command
    at, soaks = chamber.number - 1, _soaks_between(plan, chamber, index)
    if plan.steps[index].in_position and not soaks:
        return [*_history(plan, at, chamber_c), chamber, *_ride(plan, index, chamber)]
    before = [] if _is_on_its_way(chamber, chamber_c) else _history(plan, at, chamber_c)
    return [*before, _waiting_for_the_air(chamber), *soaks]


def _ride(plan: Plan, index: int, chamber: PlannedStep) -> list[PlannedStep]:
    """Wait on a ramp until the point at which the dwell begins in the plan."""
    arrivals = [each for each in _latest(plan, index + 1, GoTo) if each.number > chamber.number]
    wait_s = (arrivals[0] if arrivals else plan.steps[index]).start_s - chamber.end_s
    return [replace(chamber, step=Wait(duration_s=wait_s))] if wait_s > 0.0 else []


def _soaks_between(plan: Plan, chamber: PlannedStep, index: int) -> list[PlannedStep]:
    """The soaks after a command of the chamber and before the step at ``index``."""
    return [each for each in plan.steps[chamber.number : index] if _is_soak(each)]


def _is_soak(planned: PlannedStep) -> bool:
    return planned.dwell is None and isinstance(planned.step, Soak | Wait)


def _soaks_before_dwells(plan: Plan, index: int) -> bool:
    """Whether nothing is measured between the chamber's step at ``index`` and the soak after it."""
    for planned in plan.steps[index + 1 :]:
        if _is_soak(planned) or isinstance(planned.step, SetChamber | ChamberOff):
            return True
        if planned.in_position:
            return False
    return True


def _is_on_its_way(chamber: PlannedStep, chamber_c: float) -> bool:
    """Whether the air is still on the side of the set point from which the plan approaches it."""
    assert isinstance(chamber.step, SetChamber)  # noqa: S101 - callers check
    to_go_c = chamber.step.temperature_c - chamber_c
    planned_c = chamber.step.temperature_c - chamber.before.chamber_c
    return abs(to_go_c) <= chamber.step.within_c or to_go_c * planned_c >= 0.0


def _waiting_for_the_air(chamber: PlannedStep) -> PlannedStep:
    assert isinstance(chamber.step, SetChamber)  # noqa: S101 - callers check
    near_c = min(chamber.step.within_c, _NEAR_C)
    return replace(chamber, step=chamber.step.model_copy(update={"within_c": near_c}))


def _position(plan: Plan, index: int) -> list[PlannedStep]:
    """Go to the position and azimuth of the plan at that step, turns since its go_to included."""
    before = plan.steps[index].before
    return [
        replace(planned, step=planned.step.model_copy(update={"azimuth_deg": before.azimuth_deg}))
        for planned in _latest(plan, index, GoTo)
    ]


def _timed(steps: list[PlannedStep], target: PlannedStep, chamber_c: float) -> Iterator[PlannedStep]:
    """Steps with durations and time limits from the present temperature on."""
    thermal = target.before.thermal
    bench = replace(target.before, chamber_c=chamber_c, gyro_c=chamber_c, set_point_c=None, powered=False)
    if not any(isinstance(each.step, PowerOn | PowerOff) for each in steps):
        bench = replace(bench, powered=target.before.powered, gyro_c=chamber_c + thermal.self_heating_c)
    for planned in steps:
        duration_s = planned.step.expected_s(bench)
        limit_s = max(planned.timeout_s, planned.step.usual_time_limit_s(duration_s))
        yield replace(planned, duration_s=duration_s, timeout_s=limit_s, before=bench, dwell=None)
        bench = planned.step.after(bench, duration_s)
