"""The engine: executes a plan step by step, and leaves the bench in its safe state."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict

from gyrobench.bench.engine.actions import perform
from gyrobench.bench.engine.holding import Holding, Ticker
from gyrobench.bench.engine.interlocks.checks import InterlockFinding
from gyrobench.bench.engine.interlocks.watch import Trip, TrippedError, text_of_trips, trip_of_error
from gyrobench.bench.engine.operator import CommandReceivedError, ReceivedCommand, RunCommand
from gyrobench.bench.engine.run_context import RunContext
from gyrobench.bench.engine.step_context import StepContext
from gyrobench.bench.engine.units import Units
from gyrobench.bench.foundations.clock import Deadline
from gyrobench.bench.foundations.errors import (
    GyrobenchError,
    InstrumentError,
    InvalidDwellError,
    RunFolderError,
    RunStoppedError,
    SignalMapError,
    StepTimeoutError,
)
from gyrobench.bench.foundations.operator_name import describe_source
from gyrobench.bench.procedure.approach import (
    RetainedState,
    approach,
    index_after_dwell,
    remaining_steps,
    restart_index,
    retained_between,
)
from gyrobench.bench.procedure.plan import PlannedStep, turns_after
from gyrobench.bench.procedure.steps import Align, AskOperator, GoTo, PowerOn
from gyrobench.bench.station.interlocks import INS_MAY_BE_OFF, PassingRule
from gyrobench.bench.station.safe_state import RAMP_PERIOD_S, SafeAction, SafePart, finish_ramp

#: After this number of repeats of a dwell, the INS is switched off and on before the next.
_REPEATS_UNTIL_POWER_CYCLE = 2
_RAMP_NOTE = "The chamber's set point is being ramped to its safe value; abort ends the ramp."


class Engine:
    """Executes the plan of one run.

    An interruption of a step (a trip, a failed instrument, a command) leads to a hold, in the safe state if
    necessary, and then back to the plan by :mod:`gyrobench.bench.procedure.approach`. An interrupted dwell is
    discarded and repeated.
    """

    def __init__(self, run: RunContext) -> None:
        self._run = run
        self._bench = run.bench
        self._state = run.bench.state
        self._plan = run.plan
        self._units = Units(run)
        self._ticker = Ticker(run, self._units)
        self._holding = Holding(run, self._ticker)
        self._step_context = StepContext(run, self._units)
        self._hold_commanded_by = ""  # empty if no hold is commanded
        self._plateau = ""  # in progress, or the one that the run approaches
        #: Plateau after which the run ends, and the source of that command; None if none is commanded.
        self._finish: tuple[str, str] | None = None
        self._unseen_faults: tuple[str, ...] = ()
        self._current: PlannedStep | None = None
        self._dwell: int | None = None  # the dwell in progress, or the one that the run returns to
        self._state.run_resumed(run.progress.power_ons)

    def run(self) -> None:
        """Execute the remaining steps of the plan, then go to the safe state in any case.

        The outcome describes an expected failure; any other exception is raised once the bench is safe.
        """
        outcome, begin_s = self._run.outcome, self._bench.clock.now()
        try:
            self._begin()
            self._execute_plan()
        except RunStoppedError as error:
            outcome.ended, outcome.reason = "stopped", str(error)
        except GyrobenchError as error:
            outcome.ended, outcome.reason = "failed", str(error)
            outcome.is_station_wrong = isinstance(error, SignalMapError)
        except BaseException as error:
            outcome.ended, outcome.reason = "failed", f"unexpected {type(error).__name__}: {error}"
            raise
        finally:
            outcome.duration_s = self._bench.clock.now() - begin_s
            self._end()

    def _begin(self) -> None:
        """Read all instruments, then bring every output to its safe value."""
        self._bench.start()
        self._unseen_faults = self._bench.readings.table.faults
        self._make_safe(release_table=False)

    def _execute_plan(self) -> None:
        """Execute the remaining steps; an interrupted one is re-approached and started again."""
        index = self._run.progress.resume_index(self._plan)
        # A new run begins with the bench as it is.
        retained = self._retained_state(is_ins_on=False, is_at_temperature=False) if index else None
        while index < len(self._plan.steps):
            try:
                self._dwell = self._plan.steps[index].dwell
                self._end_after_plateau(index)
                self._check_interlocks_before_motion()
                self._bench.prepare_table()
                if retained is not None:
                    index = restart_index(self._plan, index)
                    self._dwell = self._plan.steps[index].dwell
                    self._approach(index, retained)
                    retained = None
                planned = self._plan.steps[index]
                self._handle_pending_events(planned)
                self._perform(planned, self._left_s(index))
                index += 1
                is_last = index == len(self._plan.steps) or self._plan.steps[index].dwell != planned.dwell
                if planned.dwell and is_last:
                    if self._units.finish_dwell(planned.dwell):
                        index, retained = self._after_dwell(planned.dwell, None)
                    else:
                        retained = self._retained_for_repeat(planned.dwell)
                        index -= 1
            except TrippedError as error:
                retained = self._recover(index, error.trips)
            except (InvalidDwellError, StepTimeoutError) as error:
                index, retained = self._after_failed_step(index, error)
            except InstrumentError as error:
                retained = self._recover(index, [trip_of_error(error, self._bench.station)])
            except CommandReceivedError as error:
                index, retained = self._execute_command(index, error.received, retained)

    def _end_after_plateau(self, index: int) -> None:
        """Raise RunStoppedError at the first step after a plateau with which the run is to end.

        After the last dwell the run finishes.
        """
        self._plateau = self._plan.steps[index].plateau
        plateau, source = self._finish or (self._plateau, "")
        if plateau != self._plateau and any(planned.dwell for planned in self._plan.steps[index:]):
            raise RunStoppedError(f"ended after the plateau {plateau}, as commanded by {source}")

    def _check_interlocks_before_motion(self) -> None:
        """Raise TrippedError if an interlock is tripped or a safe action has failed.

        Also raises it for faults that the table reported before the run or hold: enabling the servos would
        clear them before the operator has seen them.
        """
        self._units.drop_tripped()
        trips = self._bench.trips()
        failed = self._bench.failed_safe_actions.values()
        if failed:
            problems = "; ".join(f"{action.what}: {action.problem}" for action in failed)
            finding = InterlockFinding("safe_state", f"the bench is not in its safe state: {problems}", "")
            trips = [*trips, Trip("safe_state", (finding,), PassingRule())]
        faults, self._unseen_faults = self._unseen_faults, ()
        if faults:
            rule = self._bench.station.file.interlocks.table_fault
            problem = f"the rate table reported {', '.join(faults)} before its servos were switched on"
            finding = InterlockFinding("table_fault", problem, "Find the cause.")
            trips = [*trips, Trip("table_fault", (finding,), rule)]
        if trips:
            raise TrippedError(trips)

    def _retained_state(self, is_ins_on: bool, is_at_temperature: bool) -> RetainedState:
        chamber_c = self._bench.readings.chamber.temperature_c
        return RetainedState(is_ins_on and not self._units.have_restarted, is_at_temperature, chamber_c)

    def _retained_for_repeat(self, dwell: int) -> RetainedState:
        """State retained for a repeat; after some repeats the INS is switched off and on, if possible.

        The INS may cause the invalid data. With several units, none is switched while the data of one are
        good: switching on changes its biases.
        """
        can_switch = self._bench.station.file.unit.power == "chamber_event"
        is_ins_on = self._units.repeats(dwell) < _REPEATS_UNTIL_POWER_CYCLE or not can_switch
        return self._retained_state(is_ins_on, is_at_temperature=True)

    # steps

    def _approach(self, index: int, retained: RetainedState) -> None:
        steps = approach(self._plan, index, retained)
        if steps:
            description = "; ".join(each.step.describe() for each in steps)
            self._run.note(f"returning to step {self._plan.steps[index].number}: {description}")
        left_s = self._left_s(index) + sum(planned.duration_s for planned in steps)
        for planned in steps:
            self._perform(planned, left_s, is_approach=True)
            left_s -= planned.duration_s

    def _left_s(self, index: int) -> float:
        """Expected time from the start of a step to the end of the run."""
        plan, progress = self._plan, self._run.progress
        if not progress.lost:
            return plan.duration_s - plan.steps[index].start_s
        remaining = remaining_steps(plan, progress.next_index, progress.lost, None)
        begun_s = plan.steps[index].start_s - plan.steps[restart_index(plan, index)].start_s
        return remaining[-1].end_s - begun_s

    def _perform(self, planned: PlannedStep, left_s: float, is_approach: bool = False) -> None:
        """Perform a step; ``left_s``: expected time from its start to the end of the run."""
        begin_s = self._bench.clock.now()
        self._start_step(planned, "approach" if is_approach else "step")
        self._tick_through(planned, begin_s + left_s)
        elapsed_s = self._bench.clock.now() - begin_s
        self._finish_step(planned, elapsed_s, is_approach)
        self._run.observers.ticked(self._bench, left_s - planned.duration_s)

    def _start_step(self, planned: PlannedStep, event: str) -> None:
        run, step = self._run, planned.step
        self._current = planned
        run.journal.record(
            f"{event}_started", step=planned.number, kind=step.name, what=step.describe(), label=planned.label
        )
        run.observers.step_started(planned, self._bench)
        self._state.step_started(planned)
        self._step_context.retries = step.retries
        if isinstance(step, Align):
            self._units.identify(again=False)  # those that are always on
            self._settle_compensation(after_power_on=False)
        if isinstance(step, GoTo):
            self._step_context.next_turns_deg = [turn for _, turn in turns_after(self._plan, planned)]

    def _tick_through(self, planned: PlannedStep, plan_end_s: float) -> None:
        clock, observers = self._bench.clock, self._run.observers
        timeout_s = clock.now() + planned.timeout_s
        for _ in perform(planned.step, self._step_context):
            self._tick()
            now_s = clock.now()
            observers.ticked(self._bench, plan_end_s - now_s)
            if now_s >= timeout_s:
                self._after_timeout(planned)

    def _after_timeout(self, planned: PlannedStep) -> None:
        """Drop the units that are not done with the step; raises StepTimeoutError if none may be dropped."""
        problem = f"did not end within {planned.timeout_s:.0f} s"
        if not self._units.drop_late(f"step {planned.number}: {planned.step.describe()} {problem}"):
            place = self._run.job.document.place(planned.location)
            description = ": ".join(filter(None, (planned.label, planned.step.describe())))
            is_question = isinstance(planned.step, AskOperator)
            advice = "Answer it" if is_question else "Check the instrument that it waits for"
            found = ": ".join(filter(None, (problem, self._units.describe_waiting())))
            raise StepTimeoutError(
                f"{place}: step {planned.number} ({description}) {found}. {advice}, or increase the "
                "step's timeout_s"
            )

    def _finish_step(self, planned: PlannedStep, elapsed_s: float, is_approach: bool) -> None:
        run, kind = self._run, planned.step.name
        if isinstance(planned.step, PowerOn):
            run.journal.record("powered_on", run=self._state.run_position.power_ons)
            self._units.identify(again=True)
            self._settle_compensation(after_power_on=True)
        run.journal.record(
            "approach_finished" if is_approach else "step_finished",
            step=planned.number,
            kind=kind,
            planned_s=round(planned.duration_s, 3),
            took_s=round(elapsed_s, 3),
        )

    def _tick(self) -> None:
        """Wait for the next tick.

        Raises TrippedError if an interlock is tripped. Raises CommandReceivedError or RunStoppedError if a
        command interrupts the step.
        """
        self._ticker.tick()
        trips = self._bench.trips()
        if trips:
            raise TrippedError(trips)
        received = self._ticker.command(self._refusal)
        if received is None:
            return
        match received.command:
            case RunCommand.HOLD:
                self._hold_commanded_by = describe_source(received.source)
                self._run.note("holds at the end of the present step or dwell")
            case RunCommand.FINISH:
                self._finish = (self._plateau, describe_source(received.source))
                self._run.note(f"ends after the plateau {self._plateau}".rstrip())
            case RunCommand.CONTINUE if answer := self._step_context.continuing_answer:
                self._step_context.answer_by_command = answer
                self._run.note(f"answered '{answer}' by {describe_source(received.source)}")
            case RunCommand.CONTINUE:
                self._hold_commanded_by, self._finish = "", None
                self._run.note("the commanded hold or end is cancelled")
            case _:
                raise CommandReceivedError(received)

    def _refusal(self, command: RunCommand) -> str:
        """Why a step does not accept a command; empty if it does."""
        if command is RunCommand.SKIP and not self._dwell:
            return "no dwell is in progress: nothing is skipped"
        waits = self._hold_commanded_by or self._finish or self._step_context.continuing_answer
        if command is RunCommand.CONTINUE and not waits:
            return "the run does not hold: there is nothing to continue"
        return ""

    def _settle_compensation(self, after_power_on: bool) -> None:
        max_hold_s = self._bench.station.file.interlocks.max_hold_s
        deadline = Deadline(self._bench.clock, max_hold_s)
        for _ in self._units.settle_compensation(after_power_on):
            self._tick()
            if deadline.expired():
                raise RunStoppedError(
                    f"no answer within {max_hold_s / 3600.0:g} h on the compensation stored in the INS. "
                    "Resume the run and choose: clear, keep or stop"
                )

    # interruptions

    def _after_failed_step(self, index: int, error: GyrobenchError) -> tuple[int, RetainedState | None]:
        """Repeat the dwell whose step failed, or continue without it; hold outside of dwells."""
        planned = self._plan.steps[index]
        if planned.dwell is None or not self._units.is_recording:
            failed = self._current or planned
            return index, self._recover(index, [trip_of_error(error, self._bench.station, failed.step)])
        if self._units.may_repeat(planned.dwell):
            self._units.discard(planned.dwell, str(error), counts=True)
        else:
            for unit in self._units.measuring:
                unit.recorder.disturb(str(error))
            self._units.finish_dwell(planned.dwell)
            return self._after_dwell(planned.dwell, self._retained_for_repeat(planned.dwell))
        return index, self._retained_for_repeat(planned.dwell)

    def _after_dwell(self, dwell: int, retained: RetainedState | None) -> tuple[int, RetainedState | None]:
        """Index and retained state to continue with; after a lost dwell, those where the run had stopped."""
        progress = self._run.progress
        if dwell not in progress.lost:
            return index_after_dwell(self._plan, dwell), retained
        progress.lost.discard(dwell)
        begin, end = index_after_dwell(self._plan, dwell), progress.resume_index(self._plan)
        retained = retained or self._retained_state(is_ins_on=True, is_at_temperature=True)
        return end, retained_between(self._plan, begin, end, retained)

    def _recover(self, index: int, trips: Sequence[Trip]) -> RetainedState:
        """Make the bench safe and hold until the run may continue."""
        reason = text_of_trips(trips)
        names = [trip.name for trip in trips]
        # Before the journal entry, which a slow disk can delay.
        actions = self._bench.make_safe(meanwhile=self._ticker.signal_guard)
        self._run.journal.record("tripped", interlocks=names, why=reason)
        self._units.discard(self._plan.steps[index].dwell, reason, counts=False)
        self._report_safe(actions)
        if INS_MAY_BE_OFF & set(names):
            for unit in self._units.running:
                unit.live.state.state_unknown()
        try:
            self._holding.hold(reason, trips)
        except TrippedError as error:  # the hold starts again: safe values may be lost
            return self._recover(index, [*trips, *error.trips])
        if "table_fault" not in names:
            self._unseen_faults = self._bench.readings.table.faults
        return self._retained_state(self._units.are_on, is_at_temperature=False)

    def _execute_command(
        self, index: int, received: ReceivedCommand, retained: RetainedState | None
    ) -> tuple[int, RetainedState | None]:
        """Pause or skip; returns index and retained state to continue with. An approach starts again."""
        dwell = self._plan.steps[index].dwell
        is_ins_on = retained is None or retained.is_ins_on
        is_at_temperature = retained is None or retained.is_at_temperature
        if received.command is RunCommand.SKIP and dwell:
            self._units.skip(dwell)
            return self._after_dwell(dwell, self._retained_state(is_ins_on, is_at_temperature))
        reason = f"paused by {describe_source(received.source)}"
        self._units.discard(dwell, reason, counts=False)
        is_safe = self._bench.station.file.safe_state.on_pause == "safe"
        if is_safe:
            self._make_safe()
        try:
            self._holding.hold(reason, command=RunCommand.PAUSE)
        except TrippedError as error:
            return index, self._recover(index, error.trips)
        is_ins_on = is_ins_on and self._units.are_on
        return index, self._retained_state(is_ins_on, is_at_temperature and not is_safe)

    def _handle_pending_events(self, planned: PlannedStep) -> None:
        """Between dwells: hold if commanded, and switch a restarted INS off and on."""
        if planned.dwell and not isinstance(planned.step, Align):
            return
        if source := self._hold_commanded_by:
            self._hold_commanded_by = ""
            self._holding.hold(f"hold at this temperature commanded by {source}", command=RunCommand.HOLD)
        if restarted := [unit for unit in self._units.running if unit.live.state.has_restarted]:
            retained = self._retained_state(is_ins_on=False, is_at_temperature=True)
            for unit in restarted:
                problem = unit.live.ins.describe_second_node()
                unit.note(problem or "the INS has restarted without a command")
                unit.live.state.has_restarted = False
            self._approach(planned.number - 1, retained)

    # safe state

    def _make_safe(self, release_table: bool = True) -> None:
        self._report_safe(self._bench.make_safe(release_table, self._ticker.signal_guard))

    def _report_safe(self, actions: list[SafeAction]) -> None:
        self._run.journal.record("made_safe", actions=[asdict(action) for action in actions])
        for action in actions:
            if action.problem:
                self._run.observers.noted(action.text)

    def _end(self) -> None:
        outcome = self._run.outcome
        self._leave_safe({trip.name for trip in self._bench.trips()})
        if not outcome.is_safe:
            outcome.fail("the bench could not be brought to its safe state")
        # Each on its own: a full disk may have room for a line of the journal, but not for the last frames.
        record, actions = self._run.journal.record, [asdict(action) for action in outcome.safe_state]
        for write in (
            self._bench.poll_units,
            lambda: record("ticks", **self._bench.lateness.summary()),
            lambda: record("run_ended", ended=outcome.ended, reason=outcome.reason, safe_state=actions),
        ):
            try:
                write()
            except RunFolderError as error:
                outcome.fail(str(error))
        self._run.observers.ended(outcome)

    def _leave_safe(self, reported: set[str]) -> None:
        """Make the bench safe, and again for each trip not in ``reported``; ticks continue during a ramp."""
        bench, outcome, signal_guard = self._bench, self._run.outcome, self._ticker.signal_guard
        outcome.safe_state = bench.make_safe(meanwhile=signal_guard)
        ramp = finish_ramp(bench.station, bench.instruments, outcome.safe_state, signal_guard)
        for index, actions in enumerate(ramp):
            if not index:
                self._report_safe(outcome.safe_state)
                self._run.observers.noted(_RAMP_NOTE)
                for unit in bench.units:
                    unit.capture = None
            latest = {action.what: action for action in (*outcome.safe_state, *actions)}
            outcome.safe_state = list(latest.values())
            bench.state.made_safe(each for each in actions if each.part is not SafePart.CHAMBER)
            if reason := self._tick_in_ramp():
                self._run.observers.noted(reason)
                return
            new_trips = [trip for trip in bench.trips() if trip.name not in reported]
            if new_trips:
                names, reason = [trip.name for trip in new_trips], text_of_trips(new_trips)
                self._run.journal.record("tripped", interlocks=names, why=reason)
                self._run.observers.noted(reason)
                self._leave_safe({*reported, *names})
                return

    def _tick_in_ramp(self) -> str:
        """Let a tick pass; returns the reason to end the ramp, empty to continue. Failures do not end it."""
        try:
            self._ticker.tick()
            self._ticker.command(lambda command: f"the run ends: it accepts abort, not {command}")
        except RunStoppedError as error:
            return str(error)
        except Exception as error:  # noqa: BLE001 - such as a full disk
            self._run.outcome.fail(f"in the safe state's ramp: {error}")
            self._ticker.signal_guard()
            self._bench.clock.sleep(RAMP_PERIOD_S)
        return ""
