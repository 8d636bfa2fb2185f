"""Records the snapshot of a run in progress, and writes it to the run folder."""

from __future__ import annotations

import contextlib
import math
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import astuple, fields
from typing import Generic, TypeVar

import numpy as np

from gyrobench.bench.bias.bias_filter import StateSpaceEstimate
from gyrobench.bench.bias.dwell_table import DwellRow
from gyrobench.bench.engine.live_bench import LiveBench
from gyrobench.bench.engine.observers import RunObserver
from gyrobench.bench.engine.operator import RunCommand
from gyrobench.bench.engine.run_outcome import RunOutcome
from gyrobench.bench.foundations.arrays import FloatArray
from gyrobench.bench.foundations.clock import WallClock
from gyrobench.bench.foundations.errors import RunFolderError
from gyrobench.bench.foundations.files import write_whole
from gyrobench.bench.foundations.text import flag_text
from gyrobench.bench.monitor.snapshot import (
    MAX_ESTIMATES,
    MAX_MEASURED,
    MAX_MESSAGES,
    MAX_WINDOW_SAMPLES,
    UNKNOWN,
    Alarm,
    Attitude,
    BenchReadings,
    CurrentDwell,
    CurrentStep,
    LiveBias,
    LiveBin,
    MeasuredProfile,
    Note,
    Question,
    RunSnapshot,
    RunState,
    SnapshotDwell,
    UnitStatus,
    WindowTrace,
    live_bins,
    planned_profile,
    read_snapshot,
    snapshot_dwells,
)
from gyrobench.bench.procedure.plan import Plan, PlannedStep
from gyrobench.bench.procedure.rotation_steps import RotatingStep
from gyrobench.bench.procedure.steps import Align, GoTo, Navigate, Turn
from gyrobench.bench.runs.folder import RunFolder
from gyrobench.drivers.ins.ins_status import InsStatus

_T = TypeVar("_T")


class ThinnedRows(Generic[_T]):
    """Keeps at most ``max_rows`` rows: every n-th and the newest; n doubles when there are too many."""

    def __init__(self, max_rows: int) -> None:
        self._max_rows = max_rows
        self._thinned: list[_T] = []
        self._newest: _T | None = None
        self._count = 0
        self._interval = 1

    def add(self, row: _T) -> None:
        """Add the next row."""
        if self._count % self._interval == 0:
            self._thinned.append(row)
        self._count += 1
        self._newest = row
        if len(self._thinned) >= self._max_rows:
            self._thinned = self._thinned[::2]
            self._interval *= 2

    def rows(self) -> list[_T]:
        """Rows in order."""
        if self._newest is None or self._thinned[-1] is self._newest:
            return list(self._thinned)
        return [*self._thinned, self._newest]


def _bench_readings(bench: LiveBench) -> BenchReadings:
    """Last readings of the instruments, and their ages."""
    readings, now_s = bench.readings, bench.clock.now()
    outer_deg, inner_deg = bench.table_angles()
    outer_dps, inner_dps = bench.station.table_axes_of(readings.table.rate_dps)
    ins_age_s = readings.ins.age_s + now_s - readings.polled_s
    return BenchReadings(
        chamber_set_c=_set_point_c(bench),
        chamber_c=readings.chamber.temperature_c,
        gyro_c=readings.ins.optics_c,
        electronics_c=readings.ins.electronics_c,
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


def _set_point_c(bench: LiveBench) -> float:
    """Commanded temperature of the chamber; NaN if there is none."""
    set_c = bench.state.commanded_c
    return math.nan if set_c is None else set_c


def _alarms_of(bench: LiveBench) -> tuple[Alarm, ...]:
    """Alarms of tripped interlocks, and of instruments that do not reply."""
    tripped = (Alarm(trip.name, trip.text) for trip in bench.present_trips())
    silent = (Alarm(name, f"the {name} does not reply; retrying") for name in bench.silent)
    return (*tripped, *silent)


def _unit_status(bench: LiveBench, number: str, outcome: RunOutcome, bins: tuple[LiveBin, ...]) -> UnitStatus:
    """Status of one of several units."""
    read_units = [
        unit.readings for unit in bench.units if unit.station.number == number and unit.has_readings
    ]
    readings = [each.ins for each in read_units]
    now_s = bench.clock.now()
    ages_s = [each.ins.age_s + now_s - each.polled_s for each in read_units if math.isfinite(each.ins.age_s)]
    newest = [dwell.row for dwell in outcome.dwells[-1:]]
    return UnitStatus(
        number=number,
        ins_mode=readings[0].mode.name.lower() if readings else "",
        gyro_c=readings[0].optics_c if readings else UNKNOWN,
        dwells=len(outcome.finished),
        bias_dph=newest[0].bias_dph if newest else UNKNOWN,
        sigma_dph=newest[0].sigma_dph if newest else UNKNOWN,
        flags=flag_text(newest[0].flags) if newest else "",
        dropped=outcome.reason if outcome.ended == "failed" else "",
        position=newest[0].position if newest else "",
        flagged=sum(bool(dwell.row.flags) for dwell in outcome.dwells),
        ins_age_s=ages_s[0] if ages_s else math.nan,
        bins=bins,
    )


class _WindowRecorder:
    """Records one window; its heading is relative to the first known attitude."""

    def __init__(self, planned_s: float, start_s: float) -> None:
        self._planned_s = planned_s
        self._start_s = start_s
        self._rows: ThinnedRows[tuple[float, float, float, InsStatus]] = ThinnedRows(MAX_WINDOW_SAMPLES)

    def add(self, time_s: float, ins: InsStatus) -> None:
        east, north, _ = ins.velocity_enu_mps
        self._rows.add((time_s - self._start_s, east, north, ins))

    def trace(self) -> WindowTrace:
        rows = self._rows.rows()
        if not rows:
            return WindowTrace(self._planned_s)
        time_s, east, north, statuses = zip(*rows, strict=True)
        attitudes = (each.attitude for each in statuses if not np.isnan(each.attitude).any())
        first = next(attitudes, np.full((3, 3), np.nan))
        heading_deg = tuple(_heading_deg(each.attitude @ first.T) for each in statuses)
        return WindowTrace(self._planned_s, time_s, east, north, heading_deg)


class _DwellTrace:
    """Records the current dwell; ``planned``: step of its alignment, ``count``: number of planned dwells."""

    def __init__(self, planned: PlannedStep, count: int) -> None:
        self._planned = planned
        self._count = count
        self._windows: list[_WindowRecorder] = []
        self._is_in_window = False
        self._estimates: ThinnedRows[LiveBias] = ThinnedRows(MAX_ESTIMATES)

    def begin_window(self, planned_s: float, now_s: float) -> None:
        """Begin a window of navigation."""
        self._windows.append(_WindowRecorder(planned_s, now_s))
        self._is_in_window = True

    def end_window(self) -> None:
        """End the window: data of the INS during a turn belong to no window."""
        self._is_in_window = False

    def add(self, time_s: float, ins: InsStatus) -> None:
        """Add data of the INS; ignored outside a window."""
        if self._is_in_window:
            self._windows[-1].add(time_s, ins)

    def add_estimate(self, time_s: float, estimate: StateSpaceEstimate) -> None:
        """Add the newest estimate."""
        bias, sigma = estimate.bias_dph.tolist(), estimate.sigma_dph.tolist()
        self._estimates.add(LiveBias(time_s, tuple(bias), tuple(sigma)))

    def current(self) -> CurrentDwell:
        """The dwell so far."""
        planned = self._planned
        return CurrentDwell(
            number=planned.dwell or 0,
            count=self._count,
            cycle=planned.cycle,
            position=planned.after.position or "",
            windows=tuple(window.trace() for window in self._windows),
            estimates=tuple(self._estimates.rows()),
        )


def _heading_deg(rotation: FloatArray) -> float:
    """Angle about Up of a small rotation (3, 3); NaN if unknown."""
    return float(np.rad2deg(np.arctan2(rotation[1, 0] - rotation[0, 1], rotation[0, 0] + rotation[1, 1])))


#: Interval of real time, independent of the run's clock.
_WRITE_INTERVAL_S = 2.0


class SnapshotRecorder(RunObserver):
    """Observes a run and keeps its snapshot, which it writes to the run folder every two seconds.

    If the file can't be written, as on a full disk, the run continues without it.
    """

    def __init__(self, plan: Plan) -> None:
        self._plan = plan
        self._wall_clock = WallClock()
        self._next_write_s = 0.0
        self._folder: RunFolder | None = None
        self._bench: LiveBench | None = None
        self._outcome = RunOutcome()
        self._planned = planned_profile(plan)
        self._readings: ThinnedRows[tuple[float, ...]] = ThinnedRows(MAX_MEASURED)
        self._last_reading_s = -math.inf
        self._state, self._reason = RunState.STARTING, ""
        self._has_ended = False
        self._alarms_at_end: tuple[Alarm, ...] = ()
        self._question: Question | None = None
        self._unit = ""
        self._left_s = plan.duration_s
        self._step: CurrentStep | None = None
        self._dwell: _DwellTrace | None = None
        self._position, self._azimuth_deg = "", math.nan
        self._has_new_dwell = True
        self._dwells: tuple[SnapshotDwell, ...] = ()
        self._bins: tuple[LiveBin, ...] = ()
        self._bins_by_unit: dict[str, tuple[LiveBin, ...]] = {}
        self._messages: deque[Note] = deque(maxlen=MAX_MESSAGES)
        self._estimate: Callable[[], StateSpaceEstimate | None] | None = None

    def snapshot(self) -> RunSnapshot | None:
        """Snapshot of the run now; None before it starts."""
        folder, bench = self._folder, self._bench
        if folder is None or bench is None:
            return None
        is_read = self._last_reading_s > -math.inf
        compute, self._estimate = self._estimate, None
        if compute and self._dwell and (estimate := compute()):
            self._dwell.add_estimate(bench.clock.now(), estimate)
        if self._has_new_dwell:
            self._update_dwells()
        return RunSnapshot(
            name=folder.path.resolve().name,
            folder=str(folder.path),
            procedure=self._plan.procedure.procedure,
            station=bench.station.file.station,
            unit=self._unit,
            started_utc=bench.clock.epoch.isoformat(timespec="seconds"),
            updated_utc=self._wall_clock.utc().isoformat(timespec="seconds"),
            state=self._state,
            now_s=bench.clock.now(),
            left_s=self._left_s,
            planned_s=self._plan.duration_s,
            dwell_count=self._plan.dwell_count,
            finished_dwells=len(self._shown_outcome.finished),
            skipped=tuple(sorted(self._shown_outcome.skipped - self._shown_outcome.finished)),
            reason=self._reason,
            question=self._question,
            planned=self._planned,
            measured=MeasuredProfile(*zip(*self._readings.rows(), strict=True)),
            bench=_bench_readings(bench) if is_read else None,
            attitude=self._attitude(bench) if is_read else None,
            step=self._step,
            dwell=self._dwell.current() if self._dwell else None,
            dwells=self._dwells,
            bins=self._bins,
            alarms=self._alarms_at_end if self._has_ended else _alarms_of(bench) if is_read else (),
            messages=tuple(self._messages),
            units=tuple(
                _unit_status(bench, number, outcome, self._bins_by_unit.get(number, ()))
                for number, outcome in self._outcome.units.items()
            ),
        )

    def _attitude(self, bench: LiveBench) -> Attitude:
        C_nb = bench.station.table.attitude(*bench.table_angles())
        return Attitude.of(C_nb, self._position, self._azimuth_deg % 360.0)

    def begun(self, folder: RunFolder, bench: LiveBench, outcome: RunOutcome) -> None:
        """Begin with the dwells, readings and messages from before a resumption."""
        self._folder, self._bench, self._outcome = folder, bench, outcome
        # Messages from before the clock started.
        messages = [Note(bench.clock.now(), note.text) for note in self._messages]
        with contextlib.suppress(RunFolderError):  # a new run has none
            previous = read_snapshot(folder.live)
            for row in zip(*astuple(previous.measured), strict=True):
                self._readings.add(row)
            self._readings.add((bench.clock.now(), *[math.nan] * (len(fields(MeasuredProfile)) - 1)))
            messages = [*previous.messages, *messages]
        self._messages = deque(messages, maxlen=MAX_MESSAGES)
        self._write()

    def noted(self, text: str) -> None:
        """Add a message."""
        self._messages.append(Note(self._bench.clock.now() if self._bench else 0.0, text))

    def identified(self, unit: str) -> None:
        """Record the serial number; that of the first unit if there are several."""
        self._unit = next(iter(self._outcome.units), unit)

    def dropped(self, unit: str, why: str) -> None:
        """Record why a unit is dropped; the snapshot then shows another unit if it showed this one."""
        self.noted(f"unit {unit} is dropped: {why}")
        self._has_new_dwell = True

    def step_started(self, planned: PlannedStep, bench: LiveBench) -> None:
        """Record the step in progress."""
        now_s, step = bench.clock.now(), planned.step
        self._estimate = None
        self._state, self._reason = RunState.RUNNING, ""
        self._step = CurrentStep(
            planned.returns_to or planned.number,
            len(self._plan.steps),
            planned.label,
            step.describe(),
            now_s,
            planned.duration_s,
            is_return=planned.returns_to is not None,
        )
        if isinstance(step, GoTo):
            self._position, self._azimuth_deg = step.position, step.azimuth_deg
        elif isinstance(step, Turn):
            self._azimuth_deg += step.angle_deg
        elif isinstance(step, RotatingStep):
            self._position, self._azimuth_deg = "", math.nan
        self._update_dwell(planned, now_s)

    def _update_dwell(self, planned: PlannedStep, now_s: float) -> None:
        """Begin or end the current dwell, or its window, with a step."""
        if planned.dwell is None:
            self._dwell = None
        elif isinstance(planned.step, Align):
            self._dwell = _DwellTrace(planned, self._plan.dwell_count)
        elif self._dwell:
            self._dwell.end_window()
            if isinstance(planned.step, Navigate):
                self._dwell.begin_window(planned.duration_s, now_s)

    def beat(self, bench: LiveBench) -> None:
        """Add a new reading, and write the snapshot if it is due."""
        readings = bench.readings
        if readings.polled_s > self._last_reading_s:
            self._last_reading_s = readings.polled_s
            air_c, gyro_c = readings.chamber.temperature_c, readings.ins.optics_c
            self._readings.add((readings.polled_s, _set_point_c(bench), air_c, *gyro_c))
            if self._dwell and self._step and readings.polled_s >= self._step.started_s:
                self._dwell.add(readings.polled_s, readings.ins)
        if self._wall_clock.now() >= self._next_write_s:
            self._write()

    def ticked(self, bench: LiveBench, left_s: float) -> None:  # noqa: ARG002
        """Record the planned time remaining."""
        self._left_s = left_s

    def estimable(self, estimate: Callable[[], StateSpaceEstimate | None]) -> None:
        """Compute the estimate with the next snapshot."""
        self._estimate = estimate

    def dwell_measured(self, row: DwellRow) -> None:  # noqa: ARG002
        """Update all dwells with the next snapshot, since a dwell may flag earlier ones."""
        self._has_new_dwell = True

    def held(self, why: str, needs_person: bool, command: RunCommand | None) -> None:
        """Record that the run holds; an interrupted dwell will be repeated."""
        if command is RunCommand.PAUSE:
            self._state = RunState.PAUSED
        elif needs_person and command is None:
            self._state = RunState.WAITING
        else:
            self._state = RunState.HOLDING
        self._reason = why
        self._step = self._dwell = None
        self._estimate = None

    def continued(self) -> None:
        """Record that the hold is over."""
        self._state, self._reason = RunState.RUNNING, ""

    def asked(self, question: str, answers: Sequence[str]) -> None:
        """Record an open question."""
        self._question = Question(question, tuple(answers))
        if self._state is RunState.RUNNING:
            self._state, self._reason = RunState.WAITING, question

    def answered(self) -> None:
        """Record that the question is closed."""
        if self._question and self._reason == self._question.text:
            self._state, self._reason = RunState.RUNNING, ""
        self._question = None

    def ended(self, outcome: RunOutcome) -> None:
        """Write the last snapshot; again with its failure if the evaluation fails, the bench being closed."""
        if not self._has_ended and self._bench is not None and self._last_reading_s > -math.inf:
            self._alarms_at_end = _alarms_of(self._bench)
        self._has_ended = True
        self._state, self._reason = RunState(outcome.ended), outcome.reason
        self._step = self._dwell = None
        self._write()

    @property
    def _shown_outcome(self) -> RunOutcome:
        """Outcome whose dwells are shown; with several units, that of the first one that is measured."""
        outcomes = self._outcome.units.values()
        return next(
            (each for each in outcomes if each.ended == "finished"), next(iter(outcomes), self._outcome)
        )

    def _update_dwells(self) -> None:
        self._has_new_dwell = False
        rows = [dwell.row for dwell in self._shown_outcome.dwells]
        self._dwells = snapshot_dwells(rows)
        width_c = self._plan.procedure.bin_width_c
        self._bins = live_bins(rows, width_c)
        self._bins_by_unit = {
            number: live_bins([dwell.row for dwell in each.dwells], width_c)
            for number, each in self._outcome.units.items()
        }
        self._unit = rows[-1].unit if rows else self._unit

    def _write(self) -> None:
        snapshot = self.snapshot()
        if snapshot is not None and self._folder is not None:
            with contextlib.suppress(RunFolderError):
                write_whole(self._folder.live, snapshot.to_json(), is_synced=False)
        self._next_write_s = self._wall_clock.now() + _WRITE_INTERVAL_S
