"""Lists of faults of an emulated bench: the file, and the injector that executes it.

The injector schedules the faults, observes the phases of the bench, injects the faults and logs them.
"""

from __future__ import annotations

import functools
import json
import math
import operator
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NamedTuple

import numpy as np
from pydantic import Field

from gyrobench.bench.foundations.documents import DocumentProblem, StrictModel, read_document, validate
from gyrobench.bench.foundations.errors import DocumentError
from gyrobench.drivers.emulators.faults import (
    can_faults,
    chamber_faults,
    ins_faults,
    serial_faults,
    table_faults,
)
from gyrobench.drivers.emulators.faults.fault import (
    BenchParts,
    BenchPhase,
    End,
    Fault,
    Occurrence,
    Timing,
    UnsupportedFaultError,
)
from gyrobench.drivers.emulators.world.inertial_unit import Mode
from gyrobench.drivers.emulators.world.world import World

_MODULES = (serial_faults, can_faults, ins_faults, table_faults, chamber_faults)
#: All kinds of faults: the classes of these modules that have a key ``fault``.
_KINDS = [
    kind
    for module in _MODULES
    for kind in vars(module).values()
    if isinstance(kind, type) and issubclass(kind, Fault) and "fault" in kind.model_fields
]
if TYPE_CHECKING:
    AnyFault = Fault
else:
    AnyFault = Annotated[functools.reduce(operator.or_, _KINDS), Field(discriminator="fault")]


class FaultList(StrictModel):
    """A list of faults."""

    description: str = Field("", description="purpose of the list")
    log: Annotated[str, Field(pattern=r"^[A-Za-z0-9_][A-Za-z0-9_.-]*$")] | None = Field(
        None, description="name of a file beside this one; each injection appends a line of JSON to it"
    )
    faults: list[AnyFault] = Field(description="what fails, and when")


def load_faults(path: Path) -> FaultList:
    """Read a list of faults.

    Raises DocumentError if the file can't be read, or is wrong; the message lists all problems.
    """
    return validate(read_document(path), FaultList)


def check_faults(path: Path, fault_list: FaultList, benches: Sequence[BenchParts]) -> None:
    """Check that the bench has the units of all faults, and that its dialects support them.

    ``benches``: the parts of the bench for each of its units. Raises DocumentError, which lists the faults
    that are not supported, each with its place in the file.
    """
    problems = []
    for index, fault in enumerate(fault_list.faults):
        try:
            if fault.unit > len(benches):
                raise UnsupportedFaultError(f"unit {fault.unit} is not on the bench; it has {len(benches)}")
            fault.check(benches[fault.unit - 1])
        except UnsupportedFaultError as error:
            problems.append(DocumentProblem(("faults", index), f"the fault {fault.kind!r}: {error}"))
    if problems:
        raise read_document(path).error(problems)


#: Distance of the air from its set point above which it counts as ramping.
_RAMPING_C = 1.0


class Injection(NamedTuple):
    """An injected fault: time on the bench's clock, and kind."""

    time_s: float
    kind: str


class InjectionLog(list[Injection]):
    """List of the injections; if a path is given, each is also appended to that file as a line of JSON.

    Raises DocumentError if the file can't be written.
    """

    def __init__(self, path: Path | None) -> None:
        self._path = path
        self._write("")

    def add(self, time_s: float, kind: str) -> None:
        """Add one injection."""
        self.append(Injection(time_s, kind))
        self._write(json.dumps({"time_s": round(time_s, 3), "fault": kind}) + "\n")

    def _write(self, line: str) -> None:
        if self._path is None:
            return
        try:
            with self._path.open("a", encoding="utf-8") as file:
                file.write(line)
        except OSError as error:
            raise DocumentError(f"{self._path}: can't write the log of faults: {error.strerror}") from error


class Schedule:
    """Starts and ends of the occurrences of one fault, computed from its timing.

    With ``every_s`` the gaps are exponentially distributed (constant rate). Occurrences that ended before
    ``start_s``, the start of the bench, are skipped; one that lasts beyond it starts there.
    """

    def __init__(self, timing: Timing, random: np.random.Generator, start_s: float = 0.0) -> None:
        self._timing = timing
        self._random = random
        self._remaining = timing.max_times
        self._phases = 0
        self._in_phase = False
        self._begin_s = self._first_begin_s(start_s)
        self._end_s: float | None = None

    @property
    def next_s(self) -> float:
        """Time of the next start or end; infinite if there is none."""
        return self._begin_s if self._end_s is None else self._end_s

    def observe(self, in_phase: bool, now_s: float) -> None:
        """Record whether the bench is in the phase of ``during``."""
        if in_phase == self._in_phase:
            return
        self._in_phase = in_phase
        if not in_phase:
            self._begin_s = math.inf  # the phase was shorter than after_s
            return
        self._phases += 1
        if self._phases >= self._timing.nth and self._remaining > 0 and self._end_s is None:
            self._begin_s = now_s + self._timing.after_s

    def begins(self, now_s: float) -> bool:
        """Whether the next occurrence is due; it then counts as started."""
        if self._end_s is not None or now_s < self._begin_s:
            return False
        begin_s, duration_s = self._begin_s, self._timing.duration_s
        self._remaining -= 1
        self._end_s = begin_s + duration_s if duration_s > 0.0 else None
        self._begin_s = math.inf
        if self._remaining > 0 and self._timing.every_s is not None:
            self._begin_s = begin_s + max(duration_s, self._gap_s(self._timing.every_s))
        return True

    def ends(self, now_s: float) -> bool:
        """Whether the present occurrence is over; it then counts as ended."""
        if self._end_s is None or now_s < self._end_s:
            return False
        self._end_s = None
        return True

    def _first_begin_s(self, start_s: float) -> float:
        timing = self._timing
        if timing.at_s is not None:
            is_over = timing.at_s < start_s and timing.at_s + timing.duration_s <= start_s
            return math.inf if is_over else timing.at_s
        if timing.every_s is not None:
            return max(start_s, timing.from_s) + self._gap_s(timing.every_s)
        return math.inf

    def _gap_s(self, mean_s: float) -> float:
        return float(self._random.exponential(mean_s))


class Injector:
    """Advances the world in steps that end where a fault starts or ends.

    The phases of the bench are evaluated at each step, and at least once a second. Each fault has a separate
    stream of random numbers, which also depends on ``start_s``, so its times do not depend on the other
    faults. ``benches`` are the parts of the bench for each of its units; every fault that takes effect is
    added to ``log``.
    """

    def __init__(
        self,
        faults: Sequence[Fault],
        benches: Sequence[BenchParts],
        seed: int,
        start_s: float,
        log: InjectionLog,
    ) -> None:
        self._benches = benches
        self._now_s = start_s
        self._planned = [
            _PlannedFault(fault, np.random.default_rng((seed, int(start_s), number)), start_s)
            for number, fault in enumerate(faults)
        ]
        self._by_phase = [planned for planned in self._planned if planned.fault.during is not None]
        self._log = log

    def advance(self, now_s: float) -> None:
        """Advance the world to ``now_s``; starts and ends the faults on the way."""
        self._update()
        while self._now_s < now_s:
            next_s = min((planned.schedule.next_s for planned in self._planned), default=math.inf)
            whole_s = math.floor(self._now_s) + 1.0 if self._by_phase else math.inf
            self._now_s = min(now_s, next_s, whole_s)
            for bench in self._benches:
                bench.world.advance(self._now_s)
            self._update()

    def _update(self) -> None:
        if self._by_phase:
            units = {planned.fault.unit for planned in self._by_phase}
            phases = {unit: _active_phases(self._benches[unit - 1].world, self._now_s) for unit in units}
            for planned in self._by_phase:
                planned.schedule.observe(planned.fault.during in phases[planned.fault.unit], self._now_s)
        for planned in self._planned:
            while planned.schedule.next_s <= self._now_s:
                if planned.schedule.ends(self._now_s):
                    if planned.end is not None:
                        planned.end()
                elif planned.schedule.begins(self._now_s):
                    planned.end = planned.fault.begin(
                        self._benches[planned.fault.unit - 1], self._occurrence(planned)
                    )

    def _occurrence(self, planned: _PlannedFault) -> Occurrence:
        recorded = False

        def record() -> None:
            nonlocal recorded
            if not recorded:
                recorded = True
                self._log.add(self._now_s, planned.fault.kind)

        return Occurrence(lambda: self._now_s, planned.random, record)


class _PlannedFault:
    """A fault with its schedule, and the function that ends its present occurrence."""

    def __init__(self, fault: Fault, random: np.random.Generator, start_s: float) -> None:
        self.fault = fault
        self.random = random
        self.schedule = Schedule(fault, random, start_s)
        self.end: End = None


def _active_phases(world: World, now_s: float) -> set[BenchPhase]:
    """All phases of the bench at ``now_s``, the time of the world."""
    unit, air = world.unit, world.air
    active: dict[BenchPhase, bool] = {
        "power_on": unit.powered,
        "align": unit.mode is Mode.ALIGN,
        "navigate": unit.mode is Mode.NAVIGATE,
        "turn": any(axis.is_moving(now_s) for axis in world.axes.values()),
        "ramp": air.running and abs(air.set_point_c - air.air_c) > _RAMPING_C,
    }
    return {phase for phase, is_active in active.items() if is_active}
