"""Records the snapshot of a run while it is under way, and writes it into the run folder."""

from __future__ import annotations

import contextlib
import math
from collections import deque
from collections.abc import Mapping, Sequence
from typing import Generic, TypeVar

import numpy as np

from gyrobench.bench.bias.bins import bin_biases
from gyrobench.bench.bias.dwell_table import DwellRow
from gyrobench.bench.bias.state_space.bias_filter import StateSpaceEstimate
from gyrobench.bench.engine.live_bench import LiveBench
from gyrobench.bench.engine.observers import RunObserver, RunOutcome
from gyrobench.bench.engine.operator import RunCommand
from gyrobench.bench.foundations.arrays import FloatArray
from gyrobench.bench.foundations.clock import WallClock
from gyrobench.bench.foundations.errors import RunFolderError
from gyrobench.bench.foundations.files import write_whole
from gyrobench.bench.monitor.snapshot import (
    MOST_ESTIMATES,
    MOST_IN_WINDOW,
    MOST_MEASURED,
    MOST_MESSAGES,
    MOST_PLANNED,
    Alarm,
    Attitude,
    BenchNow,
    DwellDone,
    DwellNow,
    FillingBin,
    LiveBias,
    MeasuredProfile,
    Note,
    Picture,
    PlannedProfile,
    PositionSpan,
    Question,
    RunState,
    StepNow,
    WindowTrace,
)
from gyrobench.bench.procedure.plan import Phase, Plan, PlannedStep
from gyrobench.bench.procedure.steps import GoTo, Turn
from gyrobench.bench.procedure.timeline import position_spans, temperature_profile
from gyrobench.bench.runs.folder import RunFolder
from gyrobench.drivers.ins.ins_status import InsStatus

T = TypeVar("T")


class Thinned(Generic[T]):
    """Keeps every n-th row, evenly over all that came; n doubles whenever there are too many.

    Parameters
    ----------
    most : int
        So many rows are given at most, the newest always among them.
    """

    def __init__(self, most: int) -> None:
        self._most = most
        self._kept: list[T] = []
        self._newest: T | None = None
        self._count = 0
        self._every = 1

    def add(self, row: T) -> None:
        """Add the next row."""
        if self._count % self._every == 0:
            self._kept.append(row)
        self._count += 1
        self._newest = row
        if len(self._kept) >= self._most:
            self._kept = self._kept[::2]
            self._every *= 2

    def rows(self) -> list[T]:
        """Rows in order."""
        if self._newest is None or self._kept[-1] is self._newest:
            return list(self._kept)
        return [*self._kept, self._newest]


#: Columns of the telemetry that make a measured profile, in its order.
COLUMNS = ("time_s", "chamber_set_c", "chamber_c", "gyro_x_c", "gyro_y_c", "gyro_z_c")


def planned_profile(plan: Plan) -> PlannedProfile:
    """Temperatures and positions that a plan expects."""
    time_s, chamber_c, gyro_c = (_evenly_thinned(each, MOST_PLANNED) for each in temperature_profile(plan))
    spans = tuple(PositionSpan(float(start), float(end), name) for start, end, name in position_spans(plan))
    return PlannedProfile(time_s, chamber_c, gyro_c, spans)


def measured_profile(rows: Sequence[tuple[float, ...]]) -> MeasuredProfile:
    """Profile from rows in the order of its series."""
    return (
        MeasuredProfile(*(tuple(series) for series in zip(*rows, strict=True))) if rows else MeasuredProfile()
    )


def profile_of_telemetry(telemetry: Mapping[str, FloatArray]) -> MeasuredProfile:
    """Profile of a run that has been recorded."""
    return MeasuredProfile(*(_evenly_thinned(telemetry[name], MOST_MEASURED) for name in COLUMNS))


def _evenly_thinned(values: FloatArray, most: int) -> tuple[float, ...]:
    """So many values at most, evenly chosen, with the first and the last."""
    if len(values) > most:
        values = values[np.linspace(0, len(values) - 1, most).round().astype(int)]
    return tuple(map(float, values))


def dwells_done(rows: Sequence[DwellRow]) -> tuple[DwellDone, ...]:
    """Each dwell in short."""
    return tuple(
        DwellDone(row.dwell, row.cycle, row.position, row.gyro_c, row.bias_dph, row.sigma_dph, row.flags)
        for row in rows
    )


def filling_bins(rows: Sequence[DwellRow], width_c: float) -> tuple[FillingBin, ...]:
    """Bins of the dwells without flags, empty ones between them included."""
    return tuple(
        FillingBin(
            each.gyro,
            each.position,
            each.bin_low_c,
            each.bin_high_c,
            each.bias_dph,
            each.sigma_dph,
            each.count,
        )
        for each in bin_biases([row for row in rows if not row.flags], width_c)
    )


def bench_now(bench: LiveBench) -> BenchNow:
    """What the instruments said last, and how old that is."""
    readings, now_s = bench.readings, bench.clock.now()
    outer_deg, inner_deg = bench.table_angles()
    outer_dps, inner_dps = bench.station.table_axes_of(readings.table.rate_dps)
    set_c = bench.state.commanded_c
    ins_age_s = readings.ins.age_s + now_s - readings.asked_s
    return BenchNow(
        chamber_set_c=math.nan if set_c is None else set_c,
        chamber_c=readings.chamber.temperature_c,
        gyro_c=tuple(readings.ins.optics_c.tolist()),
        electronics_c=tuple(readings.ins.electronics_c.tolist()),
        case_c=readings.ins.case_c,
        outer_deg=outer_deg,
        inner_deg=inner_deg,
        outer_rate_dps=outer_dps,
        inner_rate_dps=inner_dps,
        ins_mode=readings.ins.mode.name.lower(),
        table_age_s=now_s - readings.table_s,
        chamber_age_s=now_s - readings.chamber_s,
        ins_age_s=ins_age_s if math.isfinite(ins_age_s) else math.nan,
    )


def attitude_now(bench: LiveBench, position: str, azimuth_deg: float) -> Attitude:
    """How the unit stands by the table's angles, and where it was sent."""
    east, north, up = bench.station.table.attitude(*bench.table_angles()).tolist()
    return Attitude(position, azimuth_deg % 360.0, (tuple(east), tuple(north), tuple(up)))


def alarms_now(bench: LiveBench) -> tuple[Alarm, ...]:
    """Interlocks that are tripped, and instruments that do not answer."""
    tripped = (Alarm(trip.name, trip.text) for trip in bench.trips())
    silent = (Alarm(name, f"the {name} does not answer; it is asked again") for name in bench.silent)
    return (*tripped, *silent)


class _Window:
    """One window; its heading counts from the first attitude that is known."""

    def __init__(self, planned_s: float, begun_s: float) -> None:
        self._planned_s = planned_s
        self._begun_s = begun_s
        self._first: FloatArray | None = None
        self._rows: Thinned[tuple[float, float, float, float]] = Thinned(MOST_IN_WINDOW)

    def add(self, time_s: float, ins: InsStatus) -> None:
        if self._first is None and not np.isnan(ins.attitude).any():
            self._first = ins.attitude
        heading_deg = float("nan") if self._first is None else _heading_deg(ins.attitude @ self._first.T)
        east, north, _ = ins.velocity_enu_mps.tolist()
        self._rows.add((time_s - self._begun_s, east, north, heading_deg))

    def trace(self) -> WindowTrace:
        rows = self._rows.rows()
        return (
            WindowTrace(self._planned_s, *map(tuple, zip(*rows, strict=True)))
            if rows
            else WindowTrace(self._planned_s)
        )


class DwellTrace:
    """Collects the dwell under way.

    Parameters
    ----------
    planned : PlannedStep
        Its alignment.
    count : int
        Number of dwells of the plan.
    """

    def __init__(self, planned: PlannedStep, count: int) -> None:
        self._planned = planned
        self._count = count
        self._windows: list[_Window] = []
        self._is_open = False
        self._estimates: Thinned[LiveBias] = Thinned(MOST_ESTIMATES)

    def begin_window(self, planned_s: float, now_s: float) -> None:
        """A stretch of navigation begins."""
        self._windows.append(_Window(planned_s, now_s))
        self._is_open = True

    def end_window(self) -> None:
        """It is over: what the INS says in a turn belongs to no window."""
        self._is_open = False

    def add(self, time_s: float, ins: InsStatus) -> None:
        """Take what the INS says; kept while a window goes on."""
        if self._is_open:
            self._windows[-1].add(time_s, ins)

    def estimated(self, time_s: float, estimate: StateSpaceEstimate) -> None:
        """Take the newest estimate."""
        bias, sigma = estimate.bias_dph.tolist(), estimate.sigma_dph.tolist()
        self._estimates.add(LiveBias(time_s, tuple(bias), tuple(sigma)))

    def now(self) -> DwellNow:
        """What there is by now."""
        planned = self._planned
        return DwellNow(
            number=planned.dwell or 0,
            count=self._count,
            cycle=planned.cycle,
            position=planned.after.position or "",
            windows=tuple(window.trace() for window in self._windows),
            estimates=tuple(self._estimates.rows()),
        )


def _heading_deg(turned: FloatArray) -> float:
    """Angle about Up of a small rotation (3, 3), NaN if that is not known."""
    return float(np.rad2deg(np.arctan2(turned[1, 0] - turned[0, 1], turned[0, 0] + turned[1, 1])))


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

    def noted(self, text: str) -> None:
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
            set_c = bench.state.commanded_c
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

    def held(self, why: str, needs_person: bool, command: RunCommand | None) -> None:
        """The run holds; a dwell that was under way is done again."""
        if command is RunCommand.PAUSE:
            self._state = RunState.PAUSED
        elif needs_person and command is None:
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
