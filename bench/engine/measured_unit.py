"""A unit that is measured: its dwell in progress, and what happens to a dwell at its end."""

from __future__ import annotations

from dataclasses import asdict

import numpy as np

from gyrobench.bench.bias.bias_filter import StateSpaceEstimate
from gyrobench.bench.bias.dwell import DwellPurpose
from gyrobench.bench.dwells.live_estimate import LiveEstimate
from gyrobench.bench.dwells.measure_dwell import MeasuredDwell, measure_check_dwell, measure_dwell
from gyrobench.bench.dwells.measurement_setup import MeasurementSetup
from gyrobench.bench.dwells.run_dwells import add_dwell
from gyrobench.bench.engine.live_bench import CHECK_BUS, LiveBench
from gyrobench.bench.engine.live_unit import LiveUnit
from gyrobench.bench.engine.run_context import RunContext
from gyrobench.bench.foundations.arrays import FloatArray
from gyrobench.bench.foundations.errors import SignalMapError
from gyrobench.bench.foundations.text import counted, flag_text
from gyrobench.bench.navigation.table_axes import Angles
from gyrobench.bench.procedure.rotation_steps import counted_moves
from gyrobench.bench.runs.marks import DwellMarks, WindowMark
from gyrobench.drivers.frames import FrameBlock, concatenate


class MeasuredUnit:
    """A unit that is on the bench and takes part in the run.

    ``live`` is its INS, ``run`` its part of the run, ``recorder`` the dwell in progress.
    """

    def __init__(self, context: RunContext, live: LiveUnit) -> None:
        self._context = context
        self.live = live
        self.run = context.units[live.station.number]
        self.journal = context.unit_journals[live.station.number]
        self.recorder = DwellRecorder(context.bench, live, self.run.setup)
        self.is_identified = False
        self.tripped_s: float | None = None  #: time at which its interlock tripped; None if it is not tripped
        self._contradicted = False
        live.state.number = self.run.progress.unit or self.run.number or context.job.unit

    def note(self, text: str) -> None:
        """Record a note about this unit for the operator; notify the observers."""
        self.journal.record("note", text=text)
        self._notify(text)

    def finish_dwell(self) -> bool:
        """Measure the dwell that is over; returns False if it has to be repeated.

        Raises SignalMapError if the dwell contradicts the station file and so did the one before it, or none
        of the run agrees with it, or if all dwells together contradict it: further dwells would be invalid
        too. A single contradiction after dwells that agree counts as a disturbance.
        """
        marks, outcome = self.recorder.marks(), self.run.outcome
        frames = self.live.end_capture()
        if errors := self.recorder.bus_errors:
            text = f"the CAN adapter reports {counted(errors, 'bus error')} in dwell {marks.dwell}"
            self.note(f"{text}. {CHECK_BUS}")
        if not marks.purpose.gives_bias:
            return self._finish_raw_dwell(marks, frames)
        measure = measure_check_dwell if marks.purpose is DwellPurpose.CALIBRATION_CHECK else measure_dwell
        measured = measure(marks, frames, self.run.setup)
        flags = flag_text(measured.flags)
        is_map_wrong = bool(measured.setup_fault) and (self._contradicted or not self._has_agreed())
        self._contradicted = bool(measured.setup_fault)
        if measured.is_disturbed and not is_map_wrong and self.may_repeat(marks.dwell):
            self.repeat_dwell(marks.dwell, flags)
            return False
        has_result = measured.estimate if isinstance(measured, MeasuredDwell) else measured.navigation
        self.journal.record(
            "dwell_finished",
            marks=marks.to_json(),
            flags=flags,
            epochs=asdict(measured.counts),
            **({"signs_tested": measured.are_signs_tested} if has_result else {}),
            **self._replacement(marks.dwell),
        )
        self.run.progress.finish(marks.dwell)
        if isinstance(measured, MeasuredDwell):
            dwells = outcome.dwells
            dwells[:] = [each for each in dwells if each.row.dwell != marks.dwell]
            add_dwell(dwells, measured)
            self.run.write_dwells()
            self._context.observers.dwell_measured(dwells[-1].row)
            if dwells[-1].setup_fault and not measured.setup_fault:  # by all dwells together
                raise SignalMapError(dwells[-1].setup_fault)
        else:
            earlier = [each for each in outcome.check_dwells if each.marks.dwell != marks.dwell]
            outcome.check_dwells[:] = [*earlier, measured]
            text = flags or "measured for the calibration check"
            self._notify(f"{self._dwell_label(marks)} at {marks.azimuth_deg:g} deg: {text}")
        if is_map_wrong:
            raise SignalMapError(measured.setup_fault)
        return True

    def _finish_raw_dwell(self, marks: DwellMarks, frames: FrameBlock) -> bool:
        flags = flag_text(marks.disturbances)
        if flags and self.may_repeat(marks.dwell):
            self.repeat_dwell(marks.dwell, flags)
            return False
        replacement = self._replacement(marks.dwell)
        self.journal.record("dwell_finished", marks=marks.to_json(), flags=flags, **replacement)
        self.run.progress.finish(marks.dwell)
        is_rotated = marks.purpose is DwellPurpose.ROTATIONS
        if is_rotated and not marks.disturbances:
            for finding in self.run.outcome.rotations.add(marks, frames, self.run.setup):
                self._notify(finding)
        steps = [each.step for each in self.run.plan.steps if each.dwell == marks.dwell]
        content = counted_moves(steps) if is_rotated else "noise"
        self._notify(f"{self._dwell_label(marks)}: {content} {f'flagged: {flags}' if flags else 'recorded'}")
        return True

    def _replacement(self, dwell: int) -> dict[str, bool]:
        """Key of the journal for a dwell that replaces an earlier measurement."""
        return {"replaces_earlier": True} if dwell in self.run.progress.replaced else {}

    def _dwell_label(self, marks: DwellMarks) -> str:
        """Number and position of a dwell, for messages."""
        return f"dwell {marks.dwell}/{self.run.plan.dwell_count}, {marks.position}"

    def _has_agreed(self) -> bool:
        """Whether a dwell of this run, also before a resume, agreed with the signal map."""
        outcome = self.run.outcome
        return any(each.estimate for each in outcome.dwells) or any(
            each.navigation for each in outcome.check_dwells
        )

    def may_repeat(self, dwell: int) -> bool:
        """Whether the procedure allows another repeat of a dwell with invalid data."""
        procedure, repeats = self._context.plan.procedure, self.run.progress.repeats
        return (
            procedure.disturbed_dwell == "repeat"
            and repeats[dwell] < procedure.max_repeats
            and repeats.total() < procedure.max_repeats_total
        )

    def repeat_dwell(self, dwell: int, reason: str) -> None:
        """Discard a dwell and have it repeated; the repeat counts against the procedure's limit."""
        self.run.progress.repeats[dwell] += 1
        self.journal.record("dwell_given_up", dwell=dwell, why=reason, counts=True)
        self._notify(f"dwell {dwell} is repeated: {reason}")

    def _notify(self, text: str) -> None:
        self._context.observers.noted(self.run.with_number(text))


#: Maximum difference of a table reading from the one at the start of the window, deg: one digit of a table
#: that reads thousandths.
_MAX_MOTION_DEG = 0.0015
#: Maximum creep from the first to the last third of a window's readings, deg; more causes a bias error.
_MAX_CREEP_DEG = 1e-4
#: A creep also has to exceed the scatter of the readings by this number of standard deviations.
_CREEP_SIGMAS = 5.0


class DwellRecorder:
    """Records the marks of one unit's dwell in progress."""

    def __init__(self, bench: LiveBench, unit: LiveUnit, setup: MeasurementSetup) -> None:
        self._bench = bench
        self._unit = unit
        self._setup = setup
        self._align_begin_s = 0.0
        self._start_s = 0.0
        self._start_azimuth_deg = 0.0
        self._first_frame = self._errors_before = 0
        self._angles: Angles = (0.0, 0.0)
        self._turn: tuple[int | None, int | None] = (None, None)
        self._windows: list[WindowMark] = []
        self._disturbances: list[str] = []
        self._live: LiveEstimate | None = None

    def begin(self) -> None:
        """Begin a dwell with its alignment."""
        self._unit.begin_capture()
        self._errors_before = self._unit.ins.error_frames
        self._align_begin_s = self._start_s = self._bench.clock.now()
        self._windows.clear()
        self._disturbances.clear()
        self._turn = (None, None)
        self._start_azimuth_deg = self._unit.state.azimuth_deg
        self._live = LiveEstimate(self._setup, self._frames)

    def begin_window(self) -> None:
        """Begin a window: the INS navigates at rest."""
        self._first_frame = self._unit.captured_frames()
        if not self._windows:
            self._start_s = self._bench.clock.now()
        self._angles = self._bench.table_angles()
        self._unit.begin_window(is_first=not self._windows)

    def end_window(self) -> None:
        """End the window; a table that moved disturbs the dwell."""
        readings_deg = [
            *(self._unit.capture.table_deg if self._unit.capture else ()),
            self._bench.table_angles(),
        ]
        moved_deg = float(np.abs(np.subtract(readings_deg, self._angles)).max())
        if moved_deg > _MAX_MOTION_DEG:
            self.disturb(f"the table moved by {moved_deg:.4f} deg while the INS navigated")
        elif (creep_deg := _creep_deg(np.array(readings_deg))) > _MAX_CREEP_DEG:
            self.disturb(f"the table crept by {creep_deg:.5f} deg while the INS navigated")
        self._windows.append(self._window())
        self._turn = (None, None)

    def begin_turn(self) -> None:
        """Begin a turn."""
        if self._turn[0] is None:
            self._turn = (self._unit.captured_frames(), None)

    def end_turn(self) -> None:
        """End a turn: the table is at rest."""
        self._turn = (self._turn[0], self._unit.captured_frames())

    @property
    def bus_errors(self) -> int:
        """Number of error frames since the alignment began."""
        return self._unit.ins.error_frames - self._errors_before

    @property
    def has_window(self) -> bool:
        """Whether the INS has navigated in this dwell."""
        return bool(self._windows)

    def estimate_so_far(self) -> StateSpaceEstimate | None:
        """Estimate the biases during a window; None while they are not observable."""
        if self._live is None or self._unit.capture is None:
            return None
        return self._live.update([*self._windows, self._window()])

    def _window(self) -> WindowMark:
        return WindowMark(self._first_frame, self._unit.captured_frames(), *self._angles, *self._turn)

    def _frames(self, first: int) -> FrameBlock:
        capture = self._unit.capture
        return capture.frames(first) if capture else concatenate([])

    def disturb(self, text: str) -> None:
        """Record a disturbance of the dwell in progress, which excludes it from the bins."""
        if text not in self._disturbances:
            self._disturbances.append(text)

    def marks(self) -> DwellMarks:
        """Return the marks of the dwell that is over."""
        position = self._bench.state.run_position
        capture = self._unit.capture
        chamber_c = capture.chamber_c if capture else []
        neighbours_on = capture.neighbours_on if capture else []
        return DwellMarks(
            unit=self._unit.state.number,
            run=f"{self._bench.clock.epoch:%Y%m%dT%H%M%S}-{position.power_ons}",
            dwell=position.dwell,
            cycle=position.cycle,
            position=self._unit.state.position,
            azimuth_deg=self._start_azimuth_deg,
            log_part=capture.log_part if capture else 0,
            windows=tuple(self._windows),
            start_s=round(self._start_s, 6),
            end_s=round(self._bench.clock.now(), 6),
            since_power_on_s=round(self._start_s - position.powered_s, 6),
            chamber_set_c=self._bench.state.commanded_c,
            chamber_c=float(np.mean(chamber_c)) if chamber_c else None,
            purpose=position.purpose,
            neighbours_on=float(np.mean(neighbours_on)) if neighbours_on else None,
            align_s=round(self._start_s - self._align_begin_s, 6),
            disturbances=tuple(self._disturbances),
        )


def _creep_deg(readings_deg: FloatArray) -> float:
    """Creep of readings in time order, shape (n, 2), deg; zero if it is within their scatter."""
    count = len(readings_deg) // 3
    if count == 0:
        return 0.0
    first, last = readings_deg[:count], readings_deg[-count:]
    creep_deg = np.abs(last.mean(axis=0) - first.mean(axis=0))
    scatter_deg = np.sqrt((first.var(axis=0) + last.var(axis=0)) / count)
    return float(np.where(creep_deg > _CREEP_SIGMAS * scatter_deg, creep_deg, 0.0).max())
