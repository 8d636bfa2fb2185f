"""Ticks and holds: actions at every tick, and waiting until a held run may continue."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, replace

from gyrobench.bench.engine.interlocks.watch import Trip, TrippedError, text_of_trips
from gyrobench.bench.engine.operator import ReceivedCommand, RunCommand, take_sender
from gyrobench.bench.engine.resume_state import ITSELF
from gyrobench.bench.engine.run_context import RunContext
from gyrobench.bench.engine.units import Units
from gyrobench.bench.foundations.errors import InstrumentError, RunStoppedError
from gyrobench.bench.foundations.operator_name import TERMINAL, describe_source, operator_name
from gyrobench.bench.foundations.text import listed
from gyrobench.bench.procedure.steps import span

#: A change of the calendar's offset above this, s, means that it was set, or corrected over a long time.
_CALENDAR_STEP_S = 1.0
#: Without a tick for this time, s of real time, the process did not run, or an exchange blocked it.
_MAX_GAP_S = 30.0
#: An operator who continued while an interlock was tripped is asked again after this time.
_ASK_AGAIN_S = 60.0


class Ticker:
    """Performs the ticks of a run: polls the bench, sends a heartbeat to the guard, reads commands."""

    def __init__(self, run: RunContext, units: Units) -> None:
        self._run = run
        self._units = units
        # A fast clock is ahead of the calendar when a run resumes.
        clock = run.bench.clock
        self._calendar_offset_s = 0.0 if clock.speed == 1.0 else clock.calendar_offset_s()
        self._last_tick_s = math.inf

    def tick(self) -> None:
        """Wait for the next tick and perform it."""
        run = self._run
        run.bench.tick()
        self._units.drop_tripped()
        self.signal_guard()
        run.observers.beat(run.bench)
        self._check_calendar()
        self._check_gap()

    def signal_guard(self) -> None:
        """Send a heartbeat to the guard."""
        note = self._run.guard.beat()
        if note:
            self._run.note(note)

    def command(self, refusal: Callable[[RunCommand], str]) -> ReceivedCommand | None:
        """Return the next command that the run accepts, after recording it in the journal.

        ``refusal``: returns why the run does not accept a command now; empty if it does. Raises
        RunStoppedError if the command is to abort, which is always accepted.
        """
        run = self._run
        typed_command = run.operator.command()
        if typed_command:
            run.commands.add(typed_command, TERMINAL)
        received = run.commands.take()
        if received is None:
            return None
        if received.source == TERMINAL:
            received = replace(received, operator=operator_name())
        elif name := take_sender(run.folder.path, received.command):
            received = replace(received, source=f"{name} ({received.source})", operator=name)
        is_abort = received.command is RunCommand.ABORT
        refused = "" if is_abort else refusal(received.command)
        details = {"refused": refused} if refused else {}
        run.journal.record(
            "ordered", order=received.command, by=received.source, operator=received.operator, **details
        )
        if is_abort:
            raise RunStoppedError(f"stopped by {describe_source(received.source)}")
        if refused:
            run.note(refused)
        return None if refused else received

    def _check_gap(self) -> None:
        """Note that nothing was polled for a long time: what follows is no fault of an instrument."""
        clock, last_s = self._run.bench.clock, self._last_tick_s
        self._last_tick_s = now_s = clock.now()
        if now_s - last_s > _MAX_GAP_S * clock.speed:
            self._run.note(
                f"no tick for {now_s - last_s:.0f} s: this process was stopped, the computer suspended, or "
                "an exchange with an instrument took that long"
            )

    def _check_calendar(self) -> None:
        """Note that the calendar was set: it affects other logs of this machine, not the run's time."""
        offset_s = self._run.bench.clock.calendar_offset_s()
        if abs(offset_s - self._calendar_offset_s) > _CALENDAR_STEP_S:
            self._calendar_offset_s = offset_s
            self._run.note(
                f"this machine's calendar was set and is {offset_s:+.1f} s from the run's time, "
                "which is unaffected"
            )


def _refusal_in_hold(command: RunCommand) -> str:
    if command is RunCommand.CONTINUE:
        return ""
    return f"the run holds: it accepts continue or abort, not {command}"


#: What continues a run, and the operator if one did.
_Continuation = tuple[str, str]


class Holding:
    """Holds a run until the operator continues it, or the rules of the tripped interlocks allow it."""

    def __init__(self, run: RunContext, ticker: Ticker) -> None:
        self._run = run
        self._bench = run.bench
        self._ticker = ticker
        self._noted_problems = ""

    def hold(self, reason: str, trips: Sequence[Trip] = (), command: RunCommand | None = None) -> None:
        """Hold because of trips or a command; ticks and interlocks continue.

        Without trips, or if a rule requires it, the operator has to continue the run. Raises TrippedError
        if another interlock trips meanwhile. Raises RunStoppedError if the operator aborts, or the hold lasts
        longer than the station allows.
        """
        run, trip_names = self._run, [trip.name for trip in trips]
        after_s = self._continues_after_s(trips)
        waits_for = "the operator" if after_s is None else f"{after_s:g} s without a trip"
        run.journal.record("held", why=reason, after=trip_names, waits_for=waits_for)
        run.observers.held(reason, after_s is None, command)
        run.observers.noted(f"Holding, waiting for {waits_for}: {reason}")
        begin_s = self._bench.clock.now()
        try:
            source, operator = self._wait(reason, trips, after_s)
        finally:
            run.operator.withdraw()
            run.observers.continued()
        if source == ITSELF:
            run.progress.resumes.update(trip_names)
        held_s = self._bench.clock.now() - begin_s
        operator_entry = {"operator": operator} if operator else {}
        run.journal.record(
            "continued", by=source, after=trip_names, held_s=round(held_s, 3), **operator_entry
        )
        run.observers.noted(f"Continued by {source}")

    def _wait(self, reason: str, trips: Sequence[Trip], after_s: float | None) -> _Continuation:
        """Wait until the run may continue."""
        clock, operator, begin_s = self._bench.clock, self._run.operator, self._bench.clock.now()
        max_hold_s = self._bench.station.file.interlocks.max_hold_s
        held_for = {trip.name for trip in trips}
        needs_operator = after_s is None
        ask_s = begin_s if needs_operator else math.inf
        while True:
            if clock.now() >= ask_s:
                operator.ask(f"The run holds: {reason}", [RunCommand.CONTINUE, RunCommand.ABORT])
                ask_s = math.inf
            self._ticker.tick()
            self._repeat_safe_actions()
            continuation = self._answer(reason, needs_operator)
            if continuation and needs_operator:
                ask_s = clock.now() + _ASK_AGAIN_S  # in case something is still tripped
            held_s = clock.now() - begin_s
            others = [trip for trip in self._bench.trips() if trip.name not in held_for]
            if others:
                raise TrippedError(others)
            if continuation and self._is_clear(trips):
                return continuation
            if after_s is not None and self._untripped_for_s(trips, held_s) >= after_s:
                return ITSELF, ""
            if held_s > max_hold_s:
                raise RunStoppedError(f"held for longer than {span(max_hold_s)}: {reason}")

    def _untripped_for_s(self, trips: Sequence[Trip], held_s: float) -> float:
        """Time since the causes of the hold have cleared, s; zero while anything is tripped or unsafe."""
        if self._bench.failed_safe_actions or self._bench.trips():
            return 0.0
        return min(self._bench.untripped_for_s(trips), held_s)

    def _repeat_safe_actions(self) -> None:
        """Repeat safe actions that failed until they succeed; each success is recorded in the journal."""
        actions = self._bench.repeat_safe_actions(self._ticker.signal_guard)
        if any(not action.problem for action in actions):
            self._run.journal.record("made_safe", actions=[asdict(action) for action in actions])
            done = [action.what for action in actions if not action.problem]
            self._run.observers.noted(f"Safe state, repeated: {listed(done)}")

    def _answer(self, reason: str, needs_operator: bool) -> _Continuation | None:
        received = self._ticker.command(_refusal_in_hold)
        answer = self._run.operator.answer() if needs_operator else None
        if answer == RunCommand.ABORT:
            raise RunStoppedError(f"the operator answered '{answer}' to: {reason}")
        if received:
            return describe_source(received.source), received.operator
        return ("the operator", operator_name()) if answer else None

    def _is_clear(self, trips: Sequence[Trip]) -> bool:
        """Clear latched alarms, and return whether nothing is tripped; notes remaining trips."""
        if any(trip.name == "chamber_alarm" for trip in trips):
            try:
                self._bench.instruments.chamber.clear_alarms()
            except InstrumentError as error:
                self._run.note(str(error))
        if any(trip.name == "chamber_command" for trip in trips):
            self._bench.state.chamber_state_unknown()
        self._bench.read_instruments()
        unsafe = [action.text for action in self._bench.failed_safe_actions.values()]
        remaining = " ".join([*unsafe, text_of_trips(self._bench.trips())]).strip()
        if remaining and remaining != self._noted_problems:
            self._run.note(f"can't continue yet: {remaining}")
        self._noted_problems = remaining
        return not remaining

    def _continues_after_s(self, trips: Sequence[Trip]) -> float | None:
        """Time without a trip after which the run continues without an operator, s; None if it does not."""
        is_automatic = all(
            trip.rule.resume == "automatic" and self._run.progress.resumes[trip.name] < trip.rule.max_resumes
            for trip in trips
        )
        return max(trip.rule.resume_after_s for trip in trips) if trips and is_automatic else None
