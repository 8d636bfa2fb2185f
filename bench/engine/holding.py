"""Ticks and holds: what happens at every tick, and how a run waits until it may continue."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import asdict, replace

from gyrobench.bench.engine.interlocks.watch import Trip, TrippedError, text_of_trips
from gyrobench.bench.engine.operator import GivenCommand, RunCommand, take_sender
from gyrobench.bench.engine.resume import ITSELF
from gyrobench.bench.engine.run_context import RunContext
from gyrobench.bench.engine.units import Units
from gyrobench.bench.foundations.errors import InstrumentError, RunStoppedError
from gyrobench.bench.foundations.operator_name import TERMINAL, describe_source, operator_name
from gyrobench.bench.foundations.text import listed

#: A calendar that differs by this much more than before, s, was set, or corrected over a long time.
_CALENDAR_STEP_S = 1.0
#: The operator who continued before everything was good is asked again after this time.
_ASK_AGAIN_S = 60.0


class Heartbeat:
    """Lets ticks pass: polls the bench, sends a sign of life to the guard, reads commands."""

    def __init__(self, run: RunContext, units: Units) -> None:
        self._run = run
        self._units = units
        # A fast clock is ahead of the calendar when a run resumes.
        clock = run.bench.clock
        self._calendar_offset_s = 0.0 if clock.speed == 1.0 else clock.calendar_offset_s()

    def beat(self) -> None:
        """Let one tick pass."""
        run = self._run
        run.bench.tick()
        self._units.drop_tripped()
        self.signal_guard()
        run.observers.beat(run.bench)
        self._check_calendar()

    def signal_guard(self) -> None:
        """Send a sign of life to the guard."""
        note = self._run.guard.beat()
        if note:
            self._run.note(note)

    def command(self) -> GivenCommand | None:
        """Return the next command; it is in the journal when this returns.

        Raises RunStoppedError if the command is to abort.
        """
        run = self._run
        typed = run.operator.command()
        if typed:
            run.commands.give(typed, TERMINAL)
        given = run.commands.take()
        if given is None:
            return None
        if given.by == TERMINAL:
            name = operator_name()
        elif name := take_sender(run.folder.path, given.command):
            given = replace(given, by=f"{name} ({given.by})")
        run.journal.record("ordered", order=given.command, by=given.by, operator=name)
        if given.command is RunCommand.ABORT:
            raise RunStoppedError(f"stopped by {describe_source(given.by)}")
        return given

    def _check_calendar(self) -> None:
        """Note a calendar that was set: it does not affect the run's time, but other logs of this machine."""
        offset_s = self._run.bench.clock.calendar_offset_s()
        if abs(offset_s - self._calendar_offset_s) > _CALENDAR_STEP_S:
            self._calendar_offset_s = offset_s
            self._run.note(
                f"this machine's calendar was set and is {offset_s:+.1f} s from the run's time, "
                "which is unaffected"
            )


class Holding:
    """Holds a run until the operator continues it, or the rules of the tripped interlocks allow it."""

    def __init__(self, run: RunContext, heartbeat: Heartbeat) -> None:
        self._run = run
        self._bench = run.bench
        self._heartbeat = heartbeat
        self._noted = ""

    def hold(self, why: str, trips: Sequence[Trip] = (), command: RunCommand | None = None) -> None:
        """Wait because of trips, or of a command; ticks and interlocks continue.

        Without trips, or where a rule requires it, the operator has to continue the run. Raises TrippedError
        if another interlock trips meanwhile. Raises RunStoppedError if the operator aborts, or the hold lasts
        longer than the station allows.
        """
        run, names = self._run, [trip.name for trip in trips]
        after_s = self._continues_after_s(trips)
        waits_for = "the operator" if after_s is None else f"{after_s:g} s without a trip"
        run.journal.record("held", why=why, after=names, waits_for=waits_for)
        run.observers.held(why, after_s is None, command)
        run.observers.noted(f"Holding, waiting for {waits_for}: {why}")
        begin_s = self._bench.clock.now()
        try:
            by = self._wait(why, trips, after_s)
        finally:
            run.operator.withdraw()
            run.observers.continued()
        if by == ITSELF:
            run.state.resumes.update(names)
        held_s = self._bench.clock.now() - begin_s
        who = {} if by == ITSELF else {"operator": operator_name()}
        run.journal.record("continued", by=by, after=names, held_s=round(held_s, 3), **who)
        run.observers.noted(f"Continued by {by}")

    def _wait(self, why: str, trips: Sequence[Trip], after_s: float | None) -> str:
        """Wait, and return who continued the run."""
        clock, begin_s = self._bench.clock, self._bench.clock.now()
        max_hold_s = self._bench.station.file.interlocks.max_hold_s
        for by in self._continuations(why, needs_operator=after_s is None):
            held_s = clock.now() - begin_s
            self._raise_other_trips(trips)
            if by and self._is_clear(trips):
                return by
            if after_s is not None and self._good_for_s(trips, held_s) >= after_s:
                return ITSELF
            if held_s > max_hold_s:
                break
        raise RunStoppedError(f"held for longer than {max_hold_s / 3600.0:g} h: {why}")

    def _raise_other_trips(self, trips: Sequence[Trip]) -> None:
        known = {trip.name for trip in trips}
        others = [trip for trip in self._bench.trips() if trip.name not in known]
        if others:
            raise TrippedError(others)

    def _good_for_s(self, trips: Sequence[Trip], held_s: float) -> float:
        """For how long nothing that led to the hold has been wrong; zero while anything is."""
        return (
            0.0
            if self._bench.failed_safe_actions or self._bench.trips()
            else min(self._bench.good_for_s(trips), held_s)
        )

    def _continuations(self, why: str, needs_operator: bool) -> Iterator[str]:
        """Let ticks pass, and yield at each who continues the run; an empty text for no one."""
        clock, operator = self._bench.clock, self._run.operator
        ask_s = clock.now() if needs_operator else math.inf
        while True:
            if clock.now() >= ask_s:
                operator.ask(f"The run holds: {why}", [RunCommand.CONTINUE, RunCommand.ABORT])
                ask_s = math.inf
            self._heartbeat.beat()
            self._repeat_safe_actions()
            by = self._answer(why, needs_operator)
            if by and needs_operator:
                ask_s = clock.now() + _ASK_AGAIN_S  # in case something is still tripped
            yield by

    def _repeat_safe_actions(self) -> None:
        """Repeat safe actions that failed until they are done; each that is done is in the journal."""
        actions = self._bench.repeat_safe_actions(self._heartbeat.signal_guard)
        if any(not action.problem for action in actions):
            self._run.journal.record("made_safe", actions=[asdict(action) for action in actions])
            done = [action.what for action in actions if not action.problem]
            self._run.observers.noted(f"Safe state, repeated: {listed(done)}")

    def _answer(self, why: str, needs_operator: bool) -> str:
        given = self._heartbeat.command()
        answer = self._run.operator.answer() if needs_operator else None
        if answer == RunCommand.ABORT:
            raise RunStoppedError(f"the operator answered '{answer}' to: {why}")
        if given and given.command is not RunCommand.CONTINUE:
            self._run.note(f"the run holds: it accepts continue or abort, not {given.command}")
            return ""
        return describe_source(given.by) if given else "the operator" if answer else ""

    def _is_clear(self, trips: Sequence[Trip]) -> bool:
        """Clear latched alarms, and return whether nothing is tripped; notes what still is."""
        if any(trip.name == "chamber_alarm" for trip in trips):
            try:
                self._bench.instruments.chamber.clear_alarms()
            except InstrumentError as error:
                self._run.note(str(error))
        if any(trip.name == "chamber_command" for trip in trips):
            self._bench.state.chamber_state_unknown()
        self._bench.read_instruments()
        unsafe = [action.text for action in self._bench.failed_safe_actions.values()]
        still = " ".join([*unsafe, text_of_trips(self._bench.trips())]).strip()
        if still and still != self._noted:
            self._run.note(f"can't continue yet: {still}")
        self._noted = still
        return not still

    def _continues_after_s(self, trips: Sequence[Trip]) -> float | None:
        """Time without a trip after which the run continues without an operator; None where it does not."""
        unattended = all(
            trip.rule.resume == "automatic" and self._run.state.resumes[trip.name] < trip.rule.max_resumes
            for trip in trips
        )
        return max(trip.rule.resume_after_s for trip in trips) if trips and unattended else None
