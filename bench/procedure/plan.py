"""Plan of a procedure: its loops unrolled into one flat list of timed steps."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

from gyrobench.bench.bias.dwell import DwellPurpose
from gyrobench.bench.foundations.documents import Document
from gyrobench.bench.foundations.yaml_nodes import KeyPath
from gyrobench.bench.navigation.table_axes import TurnOrMove
from gyrobench.bench.procedure.estimate import BenchEstimate
from gyrobench.bench.procedure.procedure_file import Procedure, ResolvedStep, resolve
from gyrobench.bench.procedure.rotation_steps import RotatingStep
from gyrobench.bench.procedure.steps import Align, GoTo, Navigate, Step, Turn, Wait

#: Purposes of dwells with one navigation.
SINGLE_NAVIGATION = (DwellPurpose.CALIBRATION_CHECK, DwellPurpose.NOISE)

#: Steps that a dwell may have after its alignment.
_AFTER_ALIGNMENT = (Navigate, Turn, Wait, RotatingStep)


@dataclass(frozen=True, slots=True)
class PlannedStep:
    """A step of the plan with its expected times and bench states."""

    number: int  #: From 1, in the order of the plan.
    location: KeyPath  #: Place of the step's keys in the procedure file.
    step: Step
    cycle: int  #: Pass of the temperature profile: the loop variable ``cycle``, or 1.
    plateau: str  #: "cycle 1, 60 degC".
    #: start_s, duration_s: Expected start, counted from the start of the plan, and duration.
    start_s: float
    duration_s: float
    timeout_s: float
    before: BenchEstimate  #: Expected state of the bench at the start.
    #: Number of the dwell that the step belongs to, from 1. A dwell is an alignment with the navigations
    #: before, between and after the turns that follow it.
    dwell: int | None = None
    purpose: DwellPurpose = DwellPurpose.CALIBRATION  #: Of its dwell.
    returns_to: int | None = None  #: In a re-approach the number of the step to which it leads.
    #: Places of the values that came from loop variables, by key path in the step.
    value_places: Mapping[KeyPath, KeyPath] = field(default_factory=dict, repr=False)

    @property
    def end_s(self) -> float:
        """Expected end."""
        return self.start_s + self.duration_s

    @property
    def after(self) -> BenchEstimate:
        """Expected state of the bench when the step ends."""
        return self.step.after(self.before, self.duration_s)

    @property
    def label(self) -> str:
        """Plateau and position of the step: "cycle 1, 60 degC, z_up"."""
        position = self.after.position if self.in_position else None
        return ", ".join(part for part in (self.plateau, position) if part)

    @property
    def in_position(self) -> bool:
        """Whether the step belongs to one position rather than to the whole plateau."""
        return self.step.at_position or self.dwell is not None

    def place_of(self, *keys: str) -> KeyPath:
        """Place of the value under ``keys``: in the step, or in the values of its loop."""
        return self.value_places.get(keys, (*self.location, *keys))


@dataclass(frozen=True)
class Plan:
    """All steps of a procedure in order, with their times."""

    procedure: Procedure
    steps: tuple[PlannedStep, ...]

    @property
    def duration_s(self) -> float:
        """Expected duration of the whole plan."""
        return self.steps[-1].end_s

    @property
    def dwell_count(self) -> int:
        """Number of dwells."""
        return max((step.dwell or 0 for step in self.steps), default=0)

    def steps_after(self, planned: PlannedStep) -> Iterator[PlannedStep]:
        """Steps after ``planned``, in order."""
        return (self.steps[index] for index in range(planned.number, len(self.steps)))


def expand(
    document: Document,
    procedure: Procedure,
    bench: BenchEstimate | None = None,
    adapt: Callable[[Step], Step] | None = None,
) -> Plan:
    """Unroll a procedure into its plan.

    ``bench``: state at the start; by default at rest at room temperature. ``adapt`` converts each step for a
    unit with another mounting. Raises DocumentError if the loops give too many steps, or a variable has a
    value that its step can't take.
    """
    resolved = resolve(document, procedure)
    if adapt is not None:
        resolved = [replace(each, step=adapt(each.step)) for each in resolved]
    steps = list(_schedule(resolved, bench or BenchEstimate.at_rest()))
    return Plan(procedure, tuple(_number_dwells(steps)))


def _schedule(steps: Sequence[ResolvedStep], bench: BenchEstimate) -> Iterator[PlannedStep]:
    start_s = 0.0
    for number, resolved in enumerate(steps, start=1):
        step = resolved.step
        if isinstance(step, GoTo):
            following = itertools.takewhile(lambda each: not isinstance(each.step, GoTo), steps[number:])
            turns_deg = tuple(turn for each in following for turn in _turns_of(each.step))
            bench = replace(bench, next_turns_deg=turns_deg)
        duration_s = step.expected_s(bench)
        after = step.after(bench, duration_s)
        yield PlannedStep(
            number=number,
            location=resolved.location,
            step=step,
            cycle=resolved.cycle or 1,
            plateau=_plateau_label(resolved.cycle, after),
            start_s=start_s,
            duration_s=duration_s,
            timeout_s=step.time_limit_s(duration_s),
            before=bench,
            value_places=resolved.value_places,
        )
        start_s += duration_s
        bench = after


def _plateau_label(cycle: int | None, after: BenchEstimate) -> str:
    cycle_text = None if cycle is None else f"cycle {cycle}"
    chamber_text = None if after.set_point_c is None else f"{after.set_point_c:g} degC"
    return ", ".join(text for text in (cycle_text, chamber_text) if text)


#: Steps in which the INS navigates.
_NAVIGATING = (Navigate, RotatingStep)


def _number_dwells(steps: Sequence[PlannedStep]) -> Iterator[PlannedStep]:
    """Number the dwells: each from an alignment to the last navigation or rotation."""
    dwells = itertools.count(1)
    for group in _split_at_alignments(steps):
        navigating = (index for index, each in enumerate(group) if isinstance(each.step, _NAVIGATING))
        end = max(navigating, default=0)
        if end:
            dwell, purpose = next(dwells), _purpose_of([each.step for each in group[: end + 1]])
            group[: end + 1] = [replace(each, dwell=dwell, purpose=purpose) for each in group[: end + 1]]
        yield from group


def _split_at_alignments(steps: Sequence[PlannedStep]) -> Iterator[list[PlannedStep]]:
    """Split the steps before each alignment and around each step that can't belong to a dwell."""
    group: list[PlannedStep] = []
    for step in steps:
        is_in_dwell = isinstance(step.step, _AFTER_ALIGNMENT)
        if group and not (isinstance(group[0].step, Align) and is_in_dwell):
            yield group
            group = []
        group.append(step)
    if group:
        yield group


def _purpose_of(steps: Sequence[Step]) -> DwellPurpose:
    if any(isinstance(step, RotatingStep) for step in steps):
        return DwellPurpose.ROTATIONS
    purposes = {step.purpose for step in steps if isinstance(step, Navigate)}
    return next(each for each in (*SINGLE_NAVIGATION, DwellPurpose.CALIBRATION) if each in purposes)


def turns_after(plan: Plan, position: PlannedStep) -> list[tuple[PlannedStep, TurnOrMove]]:
    """Turns and moves, in deg, between ``position`` and the next step that goes to one, with their steps."""
    steps = itertools.takewhile(lambda each: not isinstance(each.step, GoTo), plan.steps_after(position))
    return [(each, turn) for each in steps for turn in _turns_of(each.step)]


def _turns_of(step: Step) -> list[TurnOrMove]:
    """Turns of a step about Up, and its moves of the axes, in order, deg."""
    match step:
        case Turn(angle_deg=angle_deg):
            return [angle_deg]
        case RotatingStep() as rotating:
            return [move for move, _ in rotating.moves()]
    return []
