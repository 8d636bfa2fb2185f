"""Re-approach after an interruption: steps that restore the bench state that the plan expects before a step.

After a power cut, a trip or a pause the INS may be off or cold, the chamber at another temperature or on the
other side of it, the table anywhere. The re-approach consists of steps of the plan.
"""

from __future__ import annotations

import itertools
from collections.abc import Collection, Iterator
from dataclasses import dataclass, replace

from gyrobench.bench.procedure.plan import Plan, PlannedStep
from gyrobench.bench.procedure.steps import ChamberOff, GoTo, PowerOff, PowerOn, SetChamber, Soak, Step, Wait

#: A soak begins when the air is this close to the set point, even if the chamber's step ends earlier.
_NEAR_C = 1.0


@dataclass(frozen=True)
class RetainedState:
    """State of the bench that remains valid after an interruption."""

    is_ins_on: bool  #: the INS has stayed on
    is_at_temperature: bool  #: the chamber has held its set point
    chamber_c: float  #: present air temperature


def restart_index(plan: Plan, index: int) -> int:
    """Index of the step to restart from: for a step of a dwell, the alignment of that dwell."""
    dwell = plan.steps[index].dwell
    if dwell is None:
        return index
    return next(i for i, planned in enumerate(plan.steps) if planned.dwell == dwell)


def index_after_dwell(plan: Plan, dwell: int) -> int:
    """Index of the first step after a dwell."""
    return 1 + max(i for i, planned in enumerate(plan.steps) if planned.dwell == dwell)


def approach(plan: Plan, index: int, retained: RetainedState) -> list[PlannedStep]:
    """Steps that bring the bench to the state that the plan expects before the step at ``index``.

    The INS is power-cycled, so that the time since power-on is known. Its temperature is reached from the
    same side as in the plan, with the same soaks. A ramp with a dwell on it is repeated from the temperature
    before it. Steps keep their number in the plan; durations and time limits start from the present state.
    Empty if no dwells remain.
    """
    target = plan.steps[index]
    if plan.dwell_count and not any(planned.dwell for planned in plan.steps[index:]):
        return []
    must_power_on = target.before.powered and not retained.is_ins_on
    steps = _latest(plan, index, PowerOn) if must_power_on else []
    if must_power_on or not retained.is_at_temperature or _is_on_ramp(plan, index):
        steps += _temperature_steps(plan, index, retained.chamber_c)
    # In the order of the plan: soaks with the INS off are repeated with the INS off.
    steps.sort(key=lambda planned: planned.number)
    if _needs_power_off(plan, index, steps):
        steps.insert(0, replace(target, step=PowerOff()))
    if target.before.position is not None and _needs_position(plan, index):
        steps += _position_steps(plan, index)
    return list(_schedule(steps, target, retained.chamber_c))


def retained_between(plan: Plan, begin: int, end: int, retained: RetainedState) -> RetainedState:
    """State that remains valid where the run continues with the step ``end`` instead of ``begin``."""
    steps = [planned.step for planned in plan.steps[begin:end]]
    has_power = any(isinstance(step, PowerOn | PowerOff) for step in steps)
    has_temperature = any(isinstance(step, SetChamber | ChamberOff | Soak) for step in steps)
    return replace(
        retained,
        is_ins_on=retained.is_ins_on and not has_power,
        is_at_temperature=retained.is_at_temperature and not has_temperature,
    )


def remaining_steps(
    plan: Plan, index: int, lost: Collection[int], retained: RetainedState | None
) -> list[PlannedStep]:
    """Steps of a run from the one at ``index`` on, with the re-approaches to them; times start at zero.

    The dwells ``lost`` are measured before the steps at ``index``. ``retained``: at the start; None if
    nothing has to be approached.
    """
    ends = sorted(index_after_dwell(plan, dwell) for dwell in lost)
    spans = [(restart_index(plan, end - 1), end) for end in ends]
    steps: list[PlannedStep] = []
    for (begin, end), (next_begin, _) in itertools.pairwise([*spans, (index, len(plan.steps)), (0, 0)]):
        if begin >= end:
            break
        if retained is not None:
            steps += approach(plan, begin, retained)
        steps += plan.steps[begin:end]
        present = RetainedState(plan.steps[end - 1].after.powered, True, steps[-1].after.chamber_c)
        retained = retained_between(plan, end, next_begin, present)
    ends_s = itertools.accumulate(planned.duration_s for planned in steps)
    return [
        replace(planned, start_s=end_s - planned.duration_s)
        for planned, end_s in zip(steps, ends_s, strict=True)
    ]


def _is_on_ramp(plan: Plan, index: int) -> bool:
    """Whether the step belongs to a dwell that follows the chamber's command without a soak."""
    command = _latest(plan, index, SetChamber, ChamberOff)
    if plan.steps[index].dwell is None or not command or isinstance(command[0].step, ChamberOff):
        return False
    return not _soaks_between(plan, command[0], index)


def _needs_power_off(plan: Plan, index: int, steps: list[PlannedStep]) -> bool:
    """Whether the INS has to be switched off first, as the plan has switched it on before."""
    if not _latest(plan, index, PowerOn):
        return False
    if not plan.steps[index].before.powered:
        return True
    return bool(steps) and any(isinstance(each.step, PowerOn) for each in steps[1:])


def _needs_position(plan: Plan, index: int) -> bool:
    """Whether a step from ``index`` on uses the position before the table goes to another one."""
    for planned in plan.steps[index:]:
        if isinstance(planned.step, GoTo):
            return False
        if planned.in_position:
            return True
    return False


def _latest(plan: Plan, index: int, *kinds: type[Step]) -> list[PlannedStep]:
    """The last step of these kinds before ``index``, in a list; empty if there is none."""
    earlier = (planned for planned in reversed(plan.steps[:index]) if isinstance(planned.step, kinds))
    return [planned for planned in (next(earlier, None),) if planned is not None]


def _temperature_steps(plan: Plan, index: int, chamber_c: float) -> list[PlannedStep]:
    """Steps that restore the temperatures at which the step at ``index`` begins."""
    target = plan.steps[index]
    if isinstance(target.step, ChamberOff):
        return []
    if isinstance(target.step, SetChamber) and _is_on_planned_side(target, chamber_c):
        return [] if _soaks_before_dwells(plan, index) else _thermal_history(plan, index, chamber_c)
    return _thermal_history(plan, index, chamber_c)


def _thermal_history(plan: Plan, index: int, chamber_c: float) -> list[PlannedStep]:
    """The chamber's last command before ``index`` with its soaks, and the commands that must precede it."""
    command = _latest(plan, index, SetChamber, ChamberOff)
    if not command or isinstance(command[0].step, ChamberOff):
        return command
    (chamber,) = command
    chamber_index, soaks = chamber.number - 1, _soaks_between(plan, chamber, index)
    if plan.steps[index].in_position and not soaks:
        return [
            *_thermal_history(plan, chamber_index, chamber_c),
            chamber,
            *_wait_on_ramp(plan, index, chamber),
        ]
    if _is_on_planned_side(chamber, chamber_c):
        return [_with_air_tolerance(chamber), *soaks]
    return [*_thermal_history(plan, chamber_index, chamber_c), _with_air_tolerance(chamber), *soaks]


def _wait_on_ramp(plan: Plan, index: int, chamber: PlannedStep) -> list[PlannedStep]:
    """Wait on a ramp until the point at which the dwell begins in the plan."""
    arrivals = [each for each in _latest(plan, index + 1, GoTo) if each.number > chamber.number]
    wait_s = (arrivals[0] if arrivals else plan.steps[index]).start_s - chamber.end_s
    return [replace(chamber, step=Wait(duration_s=wait_s))] if wait_s > 0.0 else []


def _soaks_between(plan: Plan, chamber: PlannedStep, index: int) -> list[PlannedStep]:
    """Soaks between a command of the chamber and the step at ``index``."""
    return [each for each in plan.steps[chamber.number : index] if _is_soak(each)]


def _is_soak(planned: PlannedStep) -> bool:
    return planned.dwell is None and isinstance(planned.step, Soak | Wait)


def _soaks_before_dwells(plan: Plan, index: int) -> bool:
    """Whether a soak or another command follows the chamber's step at ``index`` before a measurement."""
    for planned in plan.steps[index + 1 :]:
        if _is_soak(planned) or isinstance(planned.step, SetChamber | ChamberOff):
            return True
        if planned.in_position:
            return False
    return True


def _is_on_planned_side(chamber: PlannedStep, chamber_c: float) -> bool:
    """Whether the air is still on the side of the set point from which the plan approaches it."""
    assert isinstance(chamber.step, SetChamber)  # noqa: S101 - callers check
    remaining_c = chamber.step.temperature_c - chamber_c
    planned_c = chamber.step.temperature_c - chamber.before.chamber_c
    return abs(remaining_c) <= chamber.step.within_c or remaining_c * planned_c >= 0.0


def _with_air_tolerance(chamber: PlannedStep) -> PlannedStep:
    assert isinstance(chamber.step, SetChamber)  # noqa: S101 - callers check
    near_c = min(chamber.step.within_c, _NEAR_C)
    return replace(chamber, step=chamber.step.model_copy(update={"within_c": near_c}))


def _position_steps(plan: Plan, index: int) -> list[PlannedStep]:
    """Go to the planned position and azimuth at ``index``, including the turns since its go_to."""
    before = plan.steps[index].before
    return [
        replace(planned, step=planned.step.model_copy(update={"azimuth_deg": before.azimuth_deg}))
        for planned in _latest(plan, index, GoTo)
    ]


def _schedule(steps: list[PlannedStep], target: PlannedStep, chamber_c: float) -> Iterator[PlannedStep]:
    """Steps with durations and time limits computed from the present temperature."""
    thermal = target.before.thermal
    bench = replace(
        target.before, chamber_c=chamber_c, gyro_c=chamber_c, set_point_c=None, powered=False, angles_deg=None
    )
    if not any(isinstance(each.step, PowerOn | PowerOff) for each in steps):
        bench = replace(bench, powered=target.before.powered, gyro_c=chamber_c + thermal.self_heating_c)
    for planned in steps:
        duration_s = planned.step.expected_s(bench)
        limit_s = max(planned.timeout_s, planned.step.usual_time_limit_s(duration_s))
        scheduled = replace(planned, duration_s=duration_s, timeout_s=limit_s, before=bench)
        yield replace(scheduled, dwell=None, returns_to=target.number)
        bench = planned.step.after(bench, duration_s)
