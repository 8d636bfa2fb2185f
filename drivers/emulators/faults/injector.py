"""Carries a list of faults out on an emulated bench while time goes on."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from gyrobench.drivers.emulators.faults.fault import BenchParts, End, Fault, Occurrence
from gyrobench.drivers.emulators.faults.phases import phases_now
from gyrobench.drivers.emulators.faults.record import InjectionRecord
from gyrobench.drivers.emulators.faults.schedule import Schedule


class Injector:
    """Brings the world on in steps that end where a fault begins or ends.

    Phases of the bench are looked at whenever it is brought on, and at least once a second.

    Parameters
    ----------
    faults : sequence of Fault
        The list.
    bench : BenchParts
        What they act on.
    seed : int
        Seed of all that is random in them.
    start_s : float
        The time at which the bench begins.
    record : InjectionRecord
        Told of every fault that takes effect.
    """

    def __init__(
        self, faults: Sequence[Fault], bench: BenchParts, seed: int, start_s: float, record: InjectionRecord
    ) -> None:
        self._bench = bench
        self._now_s = start_s
        self._planned = [
            _Planned(fault, Schedule(fault, random, start_s), random)
            for fault, random in zip(faults, _streams(len(faults), seed, start_s), strict=True)
        ]
        self._watched = [planned for planned in self._planned if planned.fault.during is not None]
        self._record = record

    def advance(self, now_s: float) -> None:
        """Bring the world to ``now_s``, and the faults with it."""
        self._attend()
        while self._now_s < now_s:
            next_s = min((planned.schedule.next_s for planned in self._planned), default=math.inf)
            whole_s = math.floor(self._now_s) + 1.0 if self._watched else math.inf
            self._now_s = min(now_s, next_s, whole_s)
            self._bench.world.advance(self._now_s)
            self._attend()

    def _attend(self) -> None:
        if self._watched:
            phases = phases_now(self._bench.world, self._now_s)
            for planned in self._watched:
                planned.schedule.observe(planned.fault.during in phases, self._now_s)
        for planned in self._planned:
            while planned.schedule.next_s <= self._now_s:
                if planned.schedule.ends(self._now_s):
                    planned.finish()
                elif planned.schedule.begins(self._now_s):
                    planned.begin(self._bench, self._occurrence(planned))

    def _occurrence(self, planned: _Planned) -> Occurrence:
        recorded = False

        def record() -> None:
            nonlocal recorded
            if not recorded:
                recorded = True
                self._record.add(self._now_s, planned.fault.kind)

        return Occurrence(lambda: self._now_s, planned.random, record)


class _Planned:
    """One entry of the list, with what ends its present occurrence."""

    def __init__(self, fault: Fault, schedule: Schedule, random: np.random.Generator) -> None:
        self.fault = fault
        self.schedule = schedule
        self.random = random
        self._end: End = None

    def begin(self, bench: BenchParts, occurrence: Occurrence) -> None:
        self._end = self.fault.begin(bench, occurrence)

    def finish(self) -> None:
        if self._end is not None:
            self._end()


def _streams(count: int, seed: int, start_s: float) -> list[np.random.Generator]:
    """Random numbers of each entry; another start has others, an entry's do not depend on the rest."""
    return [np.random.default_rng((seed, int(start_s), number)) for number in range(count)]
