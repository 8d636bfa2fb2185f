"""The engine: walks a plan step by step, and leaves the bench in its safe state."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, replace

from gyrobench.bench.dwells.dwell import MeasurementSetup
from gyrobench.bench.engine.actions import Context, perform
from gyrobench.bench.engine.compensation import CompensationWatch
from gyrobench.bench.engine.dwell_book import DwellBook
from gyrobench.bench.engine.dwell_recorder import DwellRecorder
from gyrobench.bench.engine.heartbeat import Heartbeat
from gyrobench.bench.engine.holding import Holding
from gyrobench.bench.engine.interlocks import Finding, Trip, text_of
from gyrobench.bench.engine.interruptions import OrderedError, TrippedError, trip_of
from gyrobench.bench.engine.live_bench import LiveBench
from gyrobench.bench.engine.orders import GivenOrder, Order
from gyrobench.bench.engine.outcome import RunOutcome
from gyrobench.bench.engine.outputs import SafeOutputs
from gyrobench.bench.engine.people import People
from gyrobench.bench.engine.progress import RunProgress
from gyrobench.bench.foundations.clock import Deadline
from gyrobench.bench.foundations.documents import Document
from gyrobench.bench.foundations.errors import (
    FaultError,
    GyrobenchError,
    InstrumentError,
    InvalidDwellError,
    RunFolderError,
    RunStoppedError,
    StepTimeoutError,
)
from gyrobench.bench.guard.link import Guard
from gyrobench.bench.procedure.approach import RetainedState, approach, end_of_dwell, restart_of
from gyrobench.bench.procedure.plan import Plan, PlannedStep, turns_after
from gyrobench.bench.procedure.steps import Align, GoTo, PowerOn
from gyrobench.bench.runs.folder import RunFolder
from gyrobench.bench.runs.journal import Journal
from gyrobench.bench.runs.provenance import add_identity
from gyrobench.bench.station.safe_state import SafeAction
from gyrobench.drivers.ins.command_map import Compensation

#: A dwell that was given up so often is tried with the INS switched off and on.
_REPEATS_UNTIL_POWER_CYCLE = 2
#: After these the INS may have been off, whatever it says now.
_UNIT_DOUBTFUL = {"ins_silence", "ins_fault"}


class Engine:
    """Runs one plan on one bench.

    What interrupts a step - a trip, a failed instrument, an order - leads to a hold, in the safe state
    where it has to be, and back into the plan by :mod:`gyrobench.bench.procedure.approach`. Nothing of an
    interrupted dwell is used: it is done again.

    Parameters
    ----------
    document : Document
        The procedure's file, to say where a step stands.
    plan : Plan
        What to do.
    bench : LiveBench
        The opened bench.
    setup : MeasurementSetup
        What turns frames into biases.
    folder, journal
        Where the run leaves its results.
    people : People
        Who can be asked, who watches, and what they order.
    guard : Guard
        Gets a sign of life at each tick.
    done : RunProgress
        What was done before; the run goes on from there.
    outcome : RunOutcome
        Gets how the run ends, and its dwells beside those measured before.
    compensation : Compensation, optional
        What the INS is to subtract from its gyros all along; without it, nothing.
    """

    def __init__(
        self,
        document: Document,
        plan: Plan,
        bench: LiveBench,
        setup: MeasurementSetup,
        folder: RunFolder,
        journal: Journal,
        people: People,
        guard: Guard,
        done: RunProgress,
        outcome: RunOutcome,
        compensation: Compensation | None = None,
    ) -> None:
        self._document = document
        self._plan = plan
        self._bench = bench
        self._folder = folder
        self._journal = journal
        self._progress = people.progress
        self._done = done
        self._outcome = outcome
        self._heartbeat = Heartbeat(bench, journal, people, guard)
        self._note = self._heartbeat.note
        self._outputs = SafeOutputs(bench, self._heartbeat.tell_guard)
        self._holding = Holding(bench, self._heartbeat, journal, people, done.resumes)
        self._recorder = DwellRecorder(bench, setup, unit=done.unit, run=done.power_ons)
        self._dwells = DwellBook(
            plan.procedure, setup, bench, self._recorder, folder, journal, people.progress, done, outcome
        )
        self._context = Context(
            bench, people.operator, self._recorder, people.progress.estimated, self._note, self._tell_retry
        )
        self._compensation = CompensationWatch(
            bench.instruments, compensation, people.operator, journal.record, self._note, done.decided
        )
        self._is_hold_ordered = False
        self._unseen_faults: tuple[str, ...] = ()
        self._under_way: PlannedStep | None = None

    def run(self) -> None:
        """Perform what is left of the plan, then go to the safe state, whatever happened.

        A failure that gyrobench knows of is told by the outcome; any other exception is raised
        once the bench is safe.
        """
        outcome, begin_s = self._outcome, self._bench.clock.now()
        try:
            self._begin()
            self._walk()
        except RunStoppedError as error:
            outcome.ended, outcome.reason = "stopped", str(error)
        except GyrobenchError as error:
            outcome.ended, outcome.reason = "failed", str(error)
        except BaseException as error:
            outcome.ended, outcome.reason = "failed", f"unexpected {type(error).__name__}: {error}"
            raise
        finally:
            outcome.duration_s = self._bench.clock.now() - begin_s
            self._end()

    def _begin(self) -> None:
        """Ask all instruments, then give every output its safe value."""
        self._bench.start()
        self._unseen_faults = self._bench.readings.table_faults
        self._make_safe(release_table=False)

    def _walk(self) -> None:
        """Do the steps that are left; an interrupted one is approached and begun again."""
        index, standing = self._done.next_index, self._standing_at_start()
        while index < len(self._plan.steps):
            try:
                self._look_before_moving()
                self._outputs.prepare_table()
                if standing is not None:
                    index = restart_of(self._plan, index)
                    self._approach(index, standing)
                    standing = None
                planned = self._plan.steps[index]
                self._look_around_before(planned)
                self._perform(planned)
                index += 1
                if planned.dwell and self._is_last_of_dwell(planned) and not self._dwells.finish():
                    standing = self._standing_to_repeat(planned.dwell)
                    index -= 1
            except TrippedError as error:
                standing = self._recover(index, error.trips)
            except (InvalidDwellError, StepTimeoutError) as error:
                index, standing = self._after_failed_step(index, error)
            except InstrumentError as error:
                standing = self._recover(index, [trip_of(error, self._bench.station)])
            except OrderedError as error:
                index, standing = self._obey(index, error.given, standing)

    def _look_before_moving(self) -> None:
        """Nothing is commanded while anything is tripped, and no fault of before the run is cleared unseen.

        Raises
        ------
        TrippedError
            An interlock is tripped, or the table reports faults that nobody has looked at.
        """
        trips = self._bench.trips()
        faults, self._unseen_faults = self._unseen_faults, ()
        if faults:
            rule = self._bench.station.file.interlocks.table_fault
            problem = f"the table reported {', '.join(faults)} before the run began"
            found = Finding("table_fault", problem, "Find the cause.")
            trips = [*trips, Trip("table_fault", (found,), rule)]
        if trips:
            raise TrippedError(trips)

    def _standing_at_start(self) -> RetainedState | None:
        """None for a new run: its plan begins with the bench as it is."""
        if self._done.next_index == 0:
            return None
        return self._standing(is_unit_on=False, is_tempered=False)

    def _standing(self, is_unit_on: bool, is_tempered: bool) -> RetainedState:
        chamber_c = self._bench.readings.chamber.temperature_c
        return RetainedState(is_unit_on and not self._bench.has_unit_restarted, is_tempered, chamber_c)

    def _standing_to_repeat(self, dwell: int) -> RetainedState:
        """A dwell that was spoilt again may owe it to the INS: it is switched off and on, if it can be."""
        can_switch = self._bench.station.unit.power == "chamber_event"
        is_unit_on = self._done.repeats[dwell] < _REPEATS_UNTIL_POWER_CYCLE or not can_switch
        return self._standing(is_unit_on, is_tempered=True)

    # steps

    def _approach(self, index: int, standing: RetainedState) -> None:
        steps = approach(self._plan, index, standing)
        if steps:
            way = "; ".join(each.step.describe() for each in steps)
            self._note(f"going back to step {self._plan.steps[index].number}: {way}")
        for planned in steps:
            self._perform(planned, is_approach=True)

    def _perform(self, planned: PlannedStep, is_approach: bool = False) -> None:
        bench, clock = self._bench, self._bench.clock
        begin_s = clock.now()
        self._under_way = planned
        what, kind = planned.step.describe(), planned.step.name
        event = "approach" if is_approach else "step"
        self._journal.record(
            f"{event}_started", step=planned.number, kind=kind, what=what, label=planned.label
        )
        self._progress.step_started(planned, bench)
        bench.step, bench.dwell = planned.number, planned.dwell or 0
        self._recorder.dwell, self._recorder.cycle = planned.dwell or 0, planned.cycle
        self._recorder.is_verification = planned.is_verification
        self._context.retries = planned.step.retries
        if isinstance(planned.step, Align) and not self._recorder.unit:
            self._identify_unit()  # one that is always on
        if isinstance(planned.step, Align):
            self._settle_compensation(after_power_on=False)
        if isinstance(planned.step, GoTo):
            self._context.turns_to_come_deg = turns_after(self._plan, planned)
        deadline = Deadline(clock, planned.timeout_s)
        for _ in perform(planned.step, self._context):
            self._tick()
            self._progress.ticked(bench, self._plan.duration_s - planned.start_s - (clock.now() - begin_s))
            if deadline.expired():
                raise StepTimeoutError(self._late(planned))
        took_s = clock.now() - begin_s
        if isinstance(planned.step, PowerOn):
            self._journal.record("powered_on", run=self._recorder.run)
            self._identify_unit()
            self._settle_compensation(after_power_on=True)
        if not is_approach:
            self._outcome.took_s.setdefault(kind, []).append((planned.duration_s, took_s))
        self._journal.record(
            f"{event}_finished",
            step=planned.number,
            kind=kind,
            planned_s=round(planned.duration_s, 3),
            took_s=round(took_s, 3),
        )
        self._progress.ticked(bench, self._plan.duration_s - planned.end_s)

    def _tick(self) -> None:
        """Let a tick pass.

        Raises
        ------
        TrippedError
            An interlock is tripped.
        OrderedError, RunStoppedError
            Somebody ordered something that interrupts the step.
        """
        self._heartbeat.beat()
        trips = self._bench.trips()
        if trips:
            raise TrippedError(trips)
        given = self._heartbeat.ordered()
        if given is None:
            return
        match given.order:
            case Order.HOLD:
                self._is_hold_ordered = True
                self._note("holds when the dwell under way is over")
            case Order.CONTINUE:
                self._is_hold_ordered = False
            case _:
                raise OrderedError(given)

    def _tell_retry(self, error: InstrumentError) -> None:
        self._journal.record("retry", instrument=error.instrument, error=str(error))

    def _identify_unit(self) -> None:
        ins = self._bench.instruments.ins
        identity = ins.identify()
        unit = str(ins.identity().get("serial_number", "unknown"))
        if self._recorder.unit not in ("", unit):
            raise FaultError(
                "INS", f"is unit {unit}, and this run is of {self._recorder.unit}. Exchange it back."
            )
        self._recorder.unit = unit
        self._journal.record("ins_identified", unit=unit, identity=identity)
        self._progress.identified(unit)
        add_identity(self._folder, "INS", identity)

    def _settle_compensation(self, after_power_on: bool) -> None:
        deadline = Deadline(self._bench.clock, self._bench.station.file.interlocks.max_hold_s)
        for _ in self._compensation.settle(after_power_on):
            self._tick()
            if deadline.expired():
                raise RunStoppedError("nobody said what is to become of the INS's own compensation")

    def _late(self, planned: PlannedStep) -> str:
        return (
            f"{self._document.place(planned.location)}: step {planned.number} "
            f"({planned.label}: {planned.step.describe()}) was not over after {planned.timeout_s:.0f} s. "
            "Look at the instrument that it waits for, or give the step a longer timeout_s"
        )

    # dwells

    def _is_last_of_dwell(self, planned: PlannedStep) -> bool:
        later = self._plan.steps[planned.number : planned.number + 1]
        return not later or later[0].dwell != planned.dwell

    # interruptions

    def _after_failed_step(self, index: int, error: GyrobenchError) -> tuple[int, RetainedState]:
        """Repeat the dwell whose step did not reach its end, or go on without; hold outside dwells."""
        planned = self._plan.steps[index]
        if planned.dwell is None or not self._bench.capture:
            failed = self._under_way or planned
            return index, self._recover(index, [trip_of(error, self._bench.station, failed.step)])
        if self._dwells.may_repeat(planned.dwell):
            self._dwells.give_up(planned.dwell, str(error), counts=True)
        else:
            self._recorder.disturb(str(error))
            self._dwells.finish()
            index = end_of_dwell(self._plan, planned.dwell)
        return index, self._standing_to_repeat(planned.dwell)

    def _recover(self, index: int, trips: Sequence[Trip]) -> RetainedState:
        """Make the bench safe and hold until it may go on."""
        why = text_of(trips)
        names = [trip.name for trip in trips]
        actions = self._outputs.apply()  # before anything that a slow disk could hold up
        self._journal.record("tripped", interlocks=names, why=why)
        self._dwells.give_up(self._plan.steps[index].dwell, why, counts=False)
        self._tell_safe(actions)
        if _UNIT_DOUBTFUL & set(names):  # it is switched off and on before it is used again
            self._bench.expected = replace(self._bench.expected, ins_on=False)
        try:
            self._holding.hold(why, trips)
        except TrippedError as error:  # all of it has to be good, and safe values may be lost
            return self._recover(index, [*trips, *error.trips])
        return self._standing(self._bench.expected.ins_on, is_tempered=False)

    def _obey(
        self, index: int, given: GivenOrder, on_the_way: RetainedState | None
    ) -> tuple[int, RetainedState | None]:
        """Pause or skip; returns where to go on. A way back that was interrupted has to be gone anew."""
        dwell = self._plan.steps[index].dwell
        is_unit_on = on_the_way is None or on_the_way.is_unit_on
        is_tempered = on_the_way is None or on_the_way.is_tempered
        if given.order is Order.SKIP:
            return self._skip(index), self._standing(is_unit_on, is_tempered)
        self._dwells.give_up(dwell, f"paused by {given.by}", counts=False)
        is_safe = self._bench.station.safe_state.on_pause == "safe"
        if is_safe:
            self._make_safe()
        try:
            self._holding.hold(f"paused by {given.by}", ordered=Order.PAUSE)
        except TrippedError as error:
            return index, self._recover(index, error.trips)
        is_unit_on = is_unit_on and self._bench.expected.ins_on
        return index, self._standing(is_unit_on, is_tempered and not is_safe)

    def _skip(self, index: int) -> int:
        dwell = self._plan.steps[index].dwell
        if not dwell:
            self._note("no dwell is under way: nothing is skipped, and the step begins again")
            return index
        self._dwells.skip(dwell)
        return end_of_dwell(self._plan, dwell)

    def _look_around_before(self, planned: PlannedStep) -> None:
        """Between two steps, but not within a dwell: hold if that was ordered, bring a restarted INS back."""
        if planned.dwell and not isinstance(planned.step, Align):
            return
        if self._is_hold_ordered:
            self._is_hold_ordered = False
            self._holding.hold("to hold at this temperature was ordered", ordered=Order.HOLD)
        if self._bench.has_unit_restarted:
            self._note("the INS has started anew by itself")
            standing = self._standing(is_unit_on=False, is_tempered=True)
            self._bench.has_unit_restarted = False
            self._approach(planned.number - 1, standing)

    # safe state

    def _make_safe(self, release_table: bool = True) -> None:
        self._tell_safe(self._outputs.apply(release_table))

    def _tell_safe(self, actions: list[SafeAction]) -> None:
        self._journal.record("made_safe", actions=[asdict(action) for action in actions])
        for action in actions:
            if action.problem:
                self._progress.told(action.text)

    def _end(self) -> None:
        outcome = self._outcome
        outcome.safe_state = self._outputs.apply()
        if any(action.problem for action in outcome.safe_state):
            outcome.fail("the bench could not be brought to its safe state")
        try:
            self._journal.record("ticks", **self._bench.lateness.summary())
            self._journal.record(
                "run_ended",
                ended=outcome.ended,
                reason=outcome.reason,
                safe_state=[asdict(action) for action in outcome.safe_state],
            )
        except RunFolderError as error:
            outcome.fail(str(error))
        self._progress.ended(outcome)
