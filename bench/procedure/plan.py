"""From a procedure to its plan: the loops unrolled into one flat list of timed steps."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from types import MappingProxyType

from gyrobench.bench.foundations.documents import Document, Location
from gyrobench.bench.procedure.estimate import BenchEstimate
from gyrobench.bench.procedure.procedure_file import Procedure, ResolvedStep, resolve
from gyrobench.bench.procedure.steps import Align, GoTo, Navigate, Step, Turn, Wait


class Phase(StrEnum):
    """What a step is to the dwell that it belongs to."""

    ALIGN = "align"
    NAVIGATE = "navigate"
    TURN = "turn"
    PAUSE = "pause"


#: What can stand in a dwell.
_PHASES: Mapping[type[Step], Phase] = MappingProxyType(
    {Align: Phase.ALIGN, Navigate: Phase.NAVIGATE, Turn: Phase.TURN, Wait: Phase.PAUSE}
)


@dataclass(frozen=True)
class PlannedStep:
    """A step with its place in time.

    Attributes
    ----------
    number : int
        From 1, in the order of the plan.
    location : Location
        Where the keys of the step stand in the procedure file.
    step : Step
        What to do, variables resolved.
    cycle : int
        Pass of the temperature profile: the loop variable ``cycle``, or 1.
    stop : str
        Which part of the procedure this is, for people: "cycle 1, 60 degC".
    start_s, duration_s : float
        Expected start and duration; time zero is the start of the plan.
    timeout_s : float
        Time after which the step has failed.
    before : BenchEstimate
        Expected state of the bench when the step starts.
    dwell : int or None
        Number of the dwell that the step belongs to, from 1. A dwell is an alignment with the
        navigations before, between and after the turns that follow it.
    phase : Phase or None
        Role in the dwell.
    window : int or None
        Index of a navigation in its dwell: 0 before the first turn, 1 after it, and so on.
    is_calibration_check : bool
        Whether its dwell verifies a calibration: one navigation straight from the alignment.
    value_places : mapping
        Where the values stand that came from loop variables, by the keys that lead to them.
    """

    number: int
    location: Location
    step: Step
    cycle: int
    stop: str
    start_s: float
    duration_s: float
    timeout_s: float
    before: BenchEstimate
    dwell: int | None = None
    phase: Phase | None = None
    window: int | None = None
    is_calibration_check: bool = False
    value_places: Mapping[Location, Location] = field(default_factory=dict, repr=False)

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
        """Where the run is, for people: "cycle 1, 60 degC, z_up"."""
        position = self.after.position if self.in_position else None
        return ", ".join(part for part in (self.stop, position) if part)

    @property
    def in_position(self) -> bool:
        """Whether the step belongs to one position rather than to the temperature as a whole."""
        return self.step.at_position or self.dwell is not None

    def place_of(self, *keys: str) -> Location:
        """Where the value at some keys stands: in the step, or in the list that its loop goes over."""
        return self.value_places.get(keys, (*self.location, *keys))


@dataclass(frozen=True)
class Plan:
    """All steps of a procedure in order, with their times."""

    procedure: Procedure
    steps: tuple[PlannedStep, ...]

    @property
    def duration_s(self) -> float:
        """Expected duration of the whole."""
        return self.steps[-1].end_s

    @property
    def dwell_count(self) -> int:
        """How many dwells it measures."""
        return max((step.dwell or 0 for step in self.steps), default=0)

    def later(self, planned: PlannedStep) -> Iterator[PlannedStep]:
        """Steps that come after one of them, in order."""
        return (self.steps[index] for index in range(planned.number, len(self.steps)))


def expand(document: Document, procedure: Procedure, bench: BenchEstimate | None = None) -> Plan:
    """Unroll a procedure.

    Parameters
    ----------
    document : Document
        The file that the procedure was read from; it tells the places of mistakes.
    procedure : Procedure
        What :func:`gyrobench.bench.procedure.procedure_file.load_procedure` made of it.
    bench : BenchEstimate, optional
        Bench at the start; at rest at room temperature if not given.

    Raises
    ------
    DocumentError
        The loops give too many steps, or a variable has a value that its step can't take.
    """
    timed = list(_timed(resolve(document, procedure), bench or BenchEstimate.at_rest()))
    return Plan(procedure, tuple(_with_dwells(timed)))


def _timed(steps: Sequence[ResolvedStep], bench: BenchEstimate) -> Iterator[PlannedStep]:
    start_s = 0.0
    for number, resolved in enumerate(steps, start=1):
        step = resolved.step
        duration_s = step.expected_s(bench)
        after = step.after(bench, duration_s)
        yield PlannedStep(
            number=number,
            location=resolved.location,
            step=step,
            cycle=resolved.cycle or 1,
            stop=_stop(resolved.cycle, after),
            start_s=start_s,
            duration_s=duration_s,
            timeout_s=step.time_limit_s(duration_s),
            before=bench,
            value_places=resolved.value_places,
        )
        start_s += duration_s
        bench = after


def _stop(cycle: int | None, bench: BenchEstimate) -> str:
    of_cycle = None if cycle is None else f"cycle {cycle}"
    of_chamber = None if bench.set_point_c is None else f"{bench.set_point_c:g} degC"
    return ", ".join(part for part in (of_cycle, of_chamber) if part)


def _with_dwells(steps: Sequence[PlannedStep]) -> Iterator[PlannedStep]:
    """Give a number to each dwell: what runs from an alignment over turns to the last navigation."""
    dwells = itertools.count(1)
    for group in _groups(steps):
        end = max((index for index, step in enumerate(group) if isinstance(step.step, Navigate)), default=0)
        if end:
            yield from _as_dwell(group[: end + 1], next(dwells))
            yield from group[end + 1 :]
        else:
            yield from group


def _groups(steps: Sequence[PlannedStep]) -> Iterator[list[PlannedStep]]:
    """Cut before each alignment and around everything that can't belong to a dwell."""
    group: list[PlannedStep] = []
    for step in steps:
        if group and not (isinstance(group[0].step, Align) and isinstance(step.step, Navigate | Turn | Wait)):
            yield group
            group = []
        group.append(step)
    if group:
        yield group


def _as_dwell(group: Sequence[PlannedStep], dwell: int) -> Iterator[PlannedStep]:
    windows = itertools.count()
    steps = [planned.step for planned in group]
    verifies = any(isinstance(step, Navigate) and step.purpose == "calibration_check" for step in steps)
    for planned in group:
        yield replace(
            planned,
            dwell=dwell,
            phase=_PHASES[type(planned.step)],
            window=next(windows) if isinstance(planned.step, Navigate) else None,
            is_calibration_check=verifies,
        )


def turns_after(plan: Plan, position: PlannedStep) -> tuple[float, ...]:
    """Angles of the turns, in deg, between one step and the next that goes to a position."""
    turns = (planned.step for planned in turn_steps_after(plan, position))
    return tuple(turn.angle_deg for turn in turns if isinstance(turn, Turn))


def turn_steps_after(plan: Plan, position: PlannedStep) -> list[PlannedStep]:
    """Find the turns themselves; see :func:`turns_after`."""
    stay = itertools.takewhile(lambda each: not isinstance(each.step, GoTo), plan.later(position))
    return [planned for planned in stay if isinstance(planned.step, Turn)]
