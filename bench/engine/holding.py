"""Waiting until a run may go on."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import replace

from gyrobench.bench.engine.heartbeat import Heartbeat
from gyrobench.bench.engine.interlocks import Trip, text_of
from gyrobench.bench.engine.interruptions import TrippedError
from gyrobench.bench.engine.live_bench import LiveBench
from gyrobench.bench.engine.orders import Order
from gyrobench.bench.engine.people import People
from gyrobench.bench.foundations.errors import InstrumentError, RunStoppedError
from gyrobench.bench.runs.journal import Journal

#: A person who said to go on before all was good is asked again after this long.
_ASK_AGAIN_S = 60.0
#: Who goes on where nobody says so.
ITSELF = "itself"


class Holding:
    """Holds a run until a person says to go on, or the rules of what tripped do.

    Parameters
    ----------
    bench, heartbeat, journal, people
        Those of the run.
    resumes : Counter
        How often the run has gone on by itself after a trip of each interlock; counted on here.
    """

    def __init__(
        self,
        bench: LiveBench,
        heartbeat: Heartbeat,
        journal: Journal,
        people: People,
        resumes: Counter[str],
    ) -> None:
        self._bench = bench
        self._heartbeat = heartbeat
        self._journal = journal
        self._people = people
        self._resumes = resumes
        self._said = ""

    def hold(self, why: str, trips: Sequence[Trip] = (), ordered: Order | None = None) -> None:
        """Wait; ticks go on, and everything is watched.

        Parameters
        ----------
        trips : sequence of Trip
            What led here. Without any, or where a rule says so, a person is needed.
        ordered : Order, optional
            The order that led here.

        Raises
        ------
        TrippedError
            Something else trips meanwhile.
        RunStoppedError
            Somebody aborts, or it lasts longer than the station allows.
        """
        names = [trip.name for trip in trips]
        after_s = self._goes_on_after_s(trips)
        waits_for = "a person" if after_s is None else f"{after_s:g} s in which all is good"
        self._journal.record("held", why=why, after=names, waits_for=waits_for)
        self._people.progress.held(why, after_s is None, ordered)
        self._people.progress.told(f"Holding, waiting for {waits_for}: {why}")
        begin_s = self._bench.clock.now()
        try:
            by = self._wait(why, trips, after_s)
        finally:
            self._people.operator.withdraw()
            self._people.progress.continued()
        if by == ITSELF:
            self._resumes.update(names)
        held_s = self._bench.clock.now() - begin_s
        self._journal.record("continued", by=by, after=names, held_s=round(held_s, 3))
        self._people.progress.told(f"Going on, by {by}")

    def _wait(self, why: str, trips: Sequence[Trip], after_s: float | None) -> str:
        """Wait, and tell who says to go on."""
        clock, begin_s = self._bench.clock, self._bench.clock.now()
        longest_s = self._bench.station.file.interlocks.max_hold_s
        for by in self._asked_to_continue(why, needs_person=after_s is None):
            held_s = clock.now() - begin_s
            self._look_for_others(trips)
            if by and self._is_clear(trips):
                return by
            if after_s is not None and self._good_for_s(trips, held_s) >= after_s:
                return ITSELF
            if held_s > longest_s:
                break
        raise RunStoppedError(f"held for longer than {longest_s / 3600.0:g} h: {why}")

    def _look_for_others(self, trips: Sequence[Trip]) -> None:
        known = {trip.name for trip in trips}
        others = [trip for trip in self._bench.trips() if trip.name not in known]
        if others:
            raise TrippedError(others)

    def _good_for_s(self, trips: Sequence[Trip], held_s: float) -> float:
        """How long nothing of what led here has been wrong; zero while anything is."""
        return 0.0 if self._bench.trips() else min(self._bench.good_for_s(trips), held_s)

    def _asked_to_continue(self, why: str, needs_person: bool) -> Iterator[str]:
        """Let ticks pass, and yield who says to go on; an empty text while nobody does."""
        clock, operator = self._bench.clock, self._people.operator
        ask_s = clock.now() if needs_person else math.inf
        while True:
            if clock.now() >= ask_s:
                operator.ask(f"The run holds: {why}", [Order.CONTINUE, Order.ABORT])
                ask_s = math.inf
            self._heartbeat.beat()
            by = self._answer(why, needs_person)
            if by and needs_person:
                ask_s = clock.now() + _ASK_AGAIN_S  # unless it was the last word
            yield by

    def _answer(self, why: str, needs_person: bool) -> str:
        given = self._heartbeat.ordered()
        answer = self._people.operator.answer() if needs_person else None
        if answer == Order.ABORT:
            raise RunStoppedError(f"the operator answered '{answer}' to: {why}")
        if given and given.order is not Order.CONTINUE:
            self._heartbeat.note(f"the run holds: it can only continue or abort, not {given.order}")
            return ""
        return given.by if given else "the operator" if answer else ""

    def _is_clear(self, trips: Sequence[Trip]) -> bool:
        """Whether nothing is tripped any more, latched alarms cleared; says what still is."""
        if any(trip.name == "chamber_alarm" for trip in trips):
            try:
                self._bench.instruments.chamber.clear_alarms()
            except InstrumentError as error:
                self._heartbeat.note(str(error))
        if any(trip.name == "chamber_command" for trip in trips):
            # Whatever was changed at its panel, the way back commands it anew.
            self._bench.expected = replace(self._bench.expected, chamber_set_c=None, chamber_on=None)
        self._bench.read_instruments()
        still = text_of(self._bench.trips())
        if still and still != self._said:
            self._heartbeat.note(f"can't go on yet: {still}")
        self._said = still
        return not still

    def _goes_on_after_s(self, trips: Sequence[Trip]) -> float | None:
        """How long all has to be good before the run goes on by itself; None where a person is needed."""
        by_itself = all(
            trip.rule.resume == "automatic" and self._resumes[trip.name] < trip.rule.max_resumes
            for trip in trips
        )
        return max(trip.rule.resume_after_s for trip in trips) if trips and by_itself else None
