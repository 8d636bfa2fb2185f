"""The engine: walks a plan step by step, and leaves the bench in its safe state."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import Protocol

from bench.bias.state_space.bias_filter import StateSpaceEstimate
from bench.bias.tables.dwell_table import DwellRow, write_dwells
from bench.clock import Deadline
from bench.documents import Document
from bench.engine.actions import Context, perform
from bench.engine.compensation import CompensationWatch
from bench.engine.dwell_recorder import DwellRecorder
from bench.engine.live_bench import LiveBench
from bench.engine.operator import Operator
from bench.engine.safe_state import SafeAction, make_safe
from bench.errors import GyrobenchError, RunFolderError, RunStoppedError, StepTimeoutError
from bench.measurement.dwell import MeasuredDwell, MeasurementSetup, measure_dwell
from bench.measurement.marks import DwellMarks
from bench.measurement.results import RunResults
from bench.measurement.verification_dwell import VerificationDwell, measure_verification
from bench.procedure.plan import Plan, PlannedStep, turns_after
from bench.procedure.steps import Align, GoTo, PowerOn
from bench.run_store.folder import RunFolder
from bench.run_store.journal import Journal
from bench.run_store.provenance import add_identity
from drivers.ins.compensation import Compensation
from drivers.ins.epochs import EpochCounts
from drivers.ins.frames import FrameBlock


class Progress(Protocol):
    """Somebody who watches a run."""

    def told(self, text: str) -> None:
        """Something that a person should know."""
        ...

    def step_started(self, planned: PlannedStep, bench: LiveBench) -> None:
        """A step begins."""
        ...

    def ticked(self, bench: LiveBench, left_s: float) -> None:
        """Time went on; so much is left by the plan."""
        ...

    def estimated(self, estimate: StateSpaceEstimate) -> None:
        """The biases of the dwell under way, as far as they are known by now."""
        ...

    def dwell_measured(self, row: DwellRow) -> None:
        """A dwell is over and its biases are known."""
        ...


@dataclass
class RunOutcome:
    """How a run ended.

    Attributes
    ----------
    ended : str
        "finished", "stopped" (somebody asked) or "failed".
    reason : str
        Why it did not finish; empty where it did.
    dwells : list of MeasuredDwell
        What was measured.
    verifications : list of VerificationDwell
        What was taken to verify a calibration.
    results : RunResults
        What the dwells give together.
    duration_s : float
        On the run's clock.
    took_s : dict of str to list of tuple
        Planned and real duration of every step done, by kind.
    safe_state : list of SafeAction
        What was done at the end, and how it went.
    """

    ended: str = "finished"
    reason: str = ""
    dwells: list[MeasuredDwell] = field(default_factory=list)
    verifications: list[VerificationDwell] = field(default_factory=list)
    results: RunResults = field(default_factory=RunResults)
    duration_s: float = 0.0
    took_s: dict[str, list[tuple[float, float]]] = field(default_factory=dict)
    safe_state: list[SafeAction] = field(default_factory=list)

    def fail(self, reason: str) -> None:
        """Note a failure, unless there is one already."""
        if self.ended == "finished":
            self.ended, self.reason = "failed", reason


class Engine:
    """Runs one plan on one bench.

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
    operator, progress
        The person to ask, and the one who watches.
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
        operator: Operator,
        progress: Progress,
        compensation: Compensation | None = None,
    ) -> None:
        self._document = document
        self._plan = plan
        self._bench = bench
        self._setup = setup
        self._folder = folder
        self._journal = journal
        self._progress = progress
        self._recorder = DwellRecorder(bench, setup)
        self._context = Context(bench, operator, self._recorder, progress.estimated, self._note)
        self._compensation = CompensationWatch(
            bench.instruments.ins, compensation, operator, journal.record, self._note
        )
        self._outcome = RunOutcome()

    def run(self) -> RunOutcome:
        """Perform all steps, then go to the safe state, whatever happened.

        A failure that gyrobench knows of is told by the outcome; any other exception is raised
        once the bench is safe.
        """
        outcome, begin_s = self._outcome, self._bench.clock.now()
        try:
            self._bench.start()
            for planned in self._plan.steps:
                self._perform(planned)
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
        return outcome

    def _perform(self, planned: PlannedStep) -> None:
        bench, clock = self._bench, self._bench.clock
        begin_s = clock.now()
        what = planned.step.describe()
        kind = planned.step.name
        self._journal.record("step_started", step=planned.number, kind=kind, what=what, label=planned.label)
        self._progress.step_started(planned, bench)
        bench.step, bench.dwell = planned.number, planned.dwell or 0
        self._recorder.dwell, self._recorder.cycle = planned.dwell or 0, planned.cycle
        self._recorder.is_verification = planned.is_verification
        if isinstance(planned.step, Align) and not self._recorder.unit:
            self._identify_unit()  # one that is always on
        if isinstance(planned.step, Align):
            self._settle_compensation(after_power_on=False)
        if isinstance(planned.step, GoTo):
            self._context.turns_to_come_deg = turns_after(self._plan, planned)
        deadline = Deadline(clock, planned.timeout_s)
        for _ in perform(planned.step, self._context):
            bench.tick()
            self._progress.ticked(bench, self._plan.duration_s - planned.start_s - (clock.now() - begin_s))
            if deadline.expired():
                raise StepTimeoutError(self._late(planned))
        took_s = clock.now() - begin_s
        self._outcome.took_s.setdefault(kind, []).append((planned.duration_s, took_s))
        self._journal.record(
            "step_finished",
            step=planned.number,
            kind=kind,
            planned_s=round(planned.duration_s, 3),
            took_s=round(took_s, 3),
        )
        if isinstance(planned.step, PowerOn):
            self._identify_unit()
            self._settle_compensation(after_power_on=True)
        self._progress.ticked(bench, self._plan.duration_s - planned.end_s)
        if planned.dwell and self._is_last_of_dwell(planned):
            self._finish_dwell()

    def _note(self, text: str) -> None:
        self._journal.record("note", text=text)
        self._progress.told(text)

    def _identify_unit(self) -> None:
        ins = self._bench.instruments.ins
        identity = ins.identify()
        self._recorder.unit = str(ins.identity().get("serial_number", "unknown"))
        self._journal.record("ins_identified", unit=self._recorder.unit, identity=identity)
        add_identity(self._folder, "INS", identity)

    def _settle_compensation(self, after_power_on: bool) -> None:
        for _ in self._compensation.settle(after_power_on):
            self._bench.tick()

    def _late(self, planned: PlannedStep) -> str:
        return (
            f"{self._document.place(planned.location)}: step {planned.number} "
            f"({planned.label}: {planned.step.describe()}) was not over after {planned.timeout_s:.0f} s. "
            "Look at the instrument that it waits for, or give the step a longer timeout_s"
        )

    def _is_last_of_dwell(self, planned: PlannedStep) -> bool:
        later = self._plan.steps[planned.number : planned.number + 1]
        return not later or later[0].dwell != planned.dwell

    def _finish_dwell(self) -> None:
        capture = self._bench.capture
        if capture is None:
            return
        marks = self._recorder.marks()
        frames = capture.frames()
        self._bench.end_capture()
        measure = self._verify if marks.is_verification else self._measure
        flags, counts = measure(marks, frames)
        self._journal.record("dwell_finished", marks=marks.to_json(), flags=flags, epochs=asdict(counts))

    def _measure(self, marks: DwellMarks, frames: FrameBlock) -> tuple[str, EpochCounts]:
        measured = measure_dwell(marks, frames, self._setup)
        self._outcome.dwells.append(measured)
        write_dwells(self._folder.dwells, [dwell.row for dwell in self._outcome.dwells])
        self._progress.dwell_measured(measured.row)
        return measured.row.flags, measured.counts

    def _verify(self, marks: DwellMarks, frames: FrameBlock) -> tuple[str, EpochCounts]:
        verified = measure_verification(marks, frames, self._setup)
        self._outcome.verifications.append(verified)
        self._progress.told(
            f"{marks.position} at {marks.azimuth_deg:g} deg: {verified.flags or 'taken for verification'}"
        )
        return verified.flags, verified.counts

    def _end(self) -> None:
        outcome = self._outcome
        outcome.safe_state = make_safe(self._bench.station, self._bench.instruments)
        if any(action.problem for action in outcome.safe_state):
            outcome.fail("the bench could not be brought to its safe state")
        try:
            self._journal.record(
                "run_ended",
                ended=outcome.ended,
                reason=outcome.reason,
                safe_state=[
                    {"what": action.what, "problem": action.problem} for action in outcome.safe_state
                ],
            )
        except RunFolderError as error:
            outcome.fail(str(error))
