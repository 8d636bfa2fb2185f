"""Records the picture of a run while it goes on, and leaves it in the run folder."""

from __future__ import annotations

import contextlib
import math
from collections import deque
from collections.abc import Sequence

from gyrobench.bench.bias.dwell_table import DwellRow
from gyrobench.bench.bias.state_space.bias_filter import StateSpaceEstimate
from gyrobench.bench.engine.live_bench import LiveBench
from gyrobench.bench.engine.operator import RunCommand
from gyrobench.bench.engine.observers import RunOutcome
from gyrobench.bench.engine.observers import RunObserver
from gyrobench.bench.foundations.clock import WallClock
from gyrobench.bench.foundations.errors import RunFolderError
from gyrobench.bench.foundations.files import write_whole
from gyrobench.bench.live.bench_now import alarms_now, attitude_now, bench_now
from gyrobench.bench.live.dwell_trace import DwellTrace
from gyrobench.bench.live.picture import MOST_MEASURED, MOST_MESSAGES, Picture, RunState
from gyrobench.bench.live.picture_parts import DwellDone, FillingBin, Note, Question, StepNow
from gyrobench.bench.live.profiles import measured_profile, planned_profile
from gyrobench.bench.live.tables import dwells_done, filling_bins
from gyrobench.bench.live.thinned import Thinned
from gyrobench.bench.procedure.plan import Phase, Plan, PlannedStep
from gyrobench.bench.procedure.steps import GoTo, Turn
from gyrobench.bench.runs.folder import RunFolder

#: Of real time, whatever the run's clock does.
_WRITE_EVERY_S = 2.0


class PictureRecorder(RunObserver):
    """Watches a run and has its picture at every moment.

    The picture is written now and then. A disk that is full, or a file that can't be written, costs
    pictures and nothing else.

    Parameters
    ----------
    plan : Plan
        What is being run.
    """

    def __init__(self, plan: Plan) -> None:
        self._plan = plan
        self._real = WallClock()
        self._next_write_s = 0.0
        self._folder: RunFolder | None = None
        self._bench: LiveBench | None = None
        self._outcome = RunOutcome()
        self._planned = planned_profile(plan)
        self._readings: Thinned[tuple[float, ...]] = Thinned(MOST_MEASURED)
        self._last_reading_s = -math.inf
        self._state, self._reason = RunState.STARTING, ""
        self._question: Question | None = None
        self._unit = ""
        self._left_s = plan.duration_s
        self._step: StepNow | None = None
        self._dwell: DwellTrace | None = None
        self._position, self._azimuth_deg = "", math.nan
        self._dwells: tuple[DwellDone, ...] = ()
        self._bins: tuple[FillingBin, ...] = ()
        self._messages: deque[Note] = deque(maxlen=MOST_MESSAGES)

    def picture(self) -> Picture | None:
        """The run now; None before it has begun."""
        folder, bench = self._folder, self._bench
        if folder is None or bench is None:
            return None
        is_read = self._last_reading_s > -math.inf
        return Picture(
            name=folder.path.resolve().name,
            folder=str(folder.path),
            procedure=self._plan.procedure.procedure,
            station=bench.station.file.station,
            unit=self._unit,
            started_utc=bench.clock.epoch.isoformat(timespec="seconds"),
            updated_utc=self._real.utc().isoformat(timespec="seconds"),
            state=self._state,
            now_s=bench.clock.now(),
            left_s=self._left_s,
            planned_s=self._plan.duration_s,
            dwell_count=self._plan.dwell_count,
            reason=self._reason,
            question=self._question,
            planned=self._planned,
            measured=measured_profile(self._readings.rows()),
            bench=bench_now(bench) if is_read else None,
            attitude=attitude_now(bench, self._position, self._azimuth_deg) if is_read else None,
            step=self._step,
            dwell=self._dwell.now() if self._dwell else None,
            dwells=self._dwells,
            bins=self._bins,
            alarms=alarms_now(bench) if is_read else (),
            messages=tuple(self._messages),
        )

    # what the run tells

    def begun(self, folder: RunFolder, bench: LiveBench, outcome: RunOutcome) -> None:
        """Take what was measured before the run was resumed."""
        self._folder, self._bench, self._outcome = folder, bench, outcome
        self._take_dwells()
        self._write()

    def told(self, text: str) -> None:
        """Keep a message."""
        self._messages.append(Note(self._bench.clock.now() if self._bench else 0.0, text))

    def identified(self, unit: str) -> None:
        """Keep the serial number."""
        self._unit = unit

    def step_started(self, planned: PlannedStep, bench: LiveBench) -> None:
        """Follow the run to its next step."""
        now_s, step = bench.clock.now(), planned.step
        self._state, self._reason = RunState.RUNNING, ""
        self._step = StepNow(
            planned.number,
            len(self._plan.steps),
            planned.label,
            step.describe(),
            now_s,
            planned.duration_s,
        )
        if isinstance(step, GoTo):
            self._position, self._azimuth_deg = step.position, step.azimuth_deg
        elif isinstance(step, Turn):
            self._azimuth_deg += step.angle_deg
        self._follow_dwell(planned, now_s)

    def _follow_dwell(self, planned: PlannedStep, now_s: float) -> None:
        if planned.dwell is None:
            self._dwell = None
        elif planned.phase is Phase.ALIGN:
            self._dwell = DwellTrace(planned, self._plan.dwell_count)
        elif self._dwell:
            self._dwell.end_window()
            if planned.phase is Phase.NAVIGATE:
                self._dwell.begin_window(planned.duration_s, now_s)

    def beat(self, bench: LiveBench) -> None:
        """Take a reading that is new, and write the picture if it is time."""
        readings = bench.readings
        if readings.asked_s > self._last_reading_s:
            self._last_reading_s = readings.asked_s
            set_c = bench.commanded_c
            set_or_nan_c = math.nan if set_c is None else set_c
            air_c, gyro_c = readings.chamber.temperature_c, readings.ins.optics_c.tolist()
            self._readings.add((readings.asked_s, set_or_nan_c, air_c, *gyro_c))
            if self._dwell and self._step and readings.asked_s >= self._step.started_s:
                self._dwell.add(readings.asked_s, readings.ins)
        if self._real.now() >= self._next_write_s:
            self._write()

    def ticked(self, bench: LiveBench, left_s: float) -> None:  # noqa: ARG002
        """Keep how much is left by the plan."""
        self._left_s = left_s

    def estimated(self, estimate: StateSpaceEstimate) -> None:
        """Keep the newest estimate."""
        if self._dwell and self._bench:
            self._dwell.estimated(self._bench.clock.now(), estimate)

    def dwell_measured(self, row: DwellRow) -> None:  # noqa: ARG002
        """Take all dwells anew: the last one may have flagged earlier ones."""
        self._take_dwells()

    def held(self, why: str, needs_person: bool, ordered: RunCommand | None) -> None:
        """The run holds; a dwell that was under way is done again."""
        if ordered is RunCommand.PAUSE:
            self._state = RunState.PAUSED
        elif needs_person and ordered is None:
            self._state = RunState.WAITING
        else:
            self._state = RunState.HOLDING
        self._reason = why
        self._step = self._dwell = None

    def continued(self) -> None:
        """The hold is over."""
        self._state, self._reason = RunState.RUNNING, ""

    def asked(self, question: str, answers: Sequence[str]) -> None:
        """A person is asked."""
        self._question = Question(question, tuple(answers))
        if self._state is RunState.RUNNING:
            self._state, self._reason = RunState.WAITING, question

    def answered(self) -> None:
        """The question is closed."""
        if self._question and self._reason == self._question.text:
            self._state, self._reason = RunState.RUNNING, ""
        self._question = None

    def ended(self, outcome: RunOutcome) -> None:
        """Write the last picture."""
        self._state, self._reason = RunState(outcome.ended), outcome.reason
        self._step = self._dwell = None
        self._write()

    def _take_dwells(self) -> None:
        rows = [dwell.row for dwell in self._outcome.dwells]
        self._dwells = dwells_done(rows)
        self._bins = filling_bins(rows, self._plan.procedure.bin_width_c)
        self._unit = rows[-1].unit if rows else self._unit

    def _write(self) -> None:
        picture = self.picture()
        if picture is not None and self._folder is not None:
            with contextlib.suppress(RunFolderError):
                write_whole(self._folder.live, picture.to_json(), is_synced=False)
        self._next_write_s = self._real.now() + _WRITE_EVERY_S
