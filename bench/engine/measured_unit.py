"""A unit that is measured: its dwells are measured at their end, and repeated where data are invalid."""

from __future__ import annotations

from dataclasses import asdict

from gyrobench.bench.bias.dwell_table import write_dwells
from gyrobench.bench.dwells.check_dwell import measure_check_dwell
from gyrobench.bench.dwells.measure_dwell import MeasuredDwell, measure_dwell
from gyrobench.bench.dwells.run_dwells import add_dwell
from gyrobench.bench.engine.dwell_recorder import DwellRecorder
from gyrobench.bench.engine.live_unit import LiveUnit
from gyrobench.bench.engine.run_context import RunContext
from gyrobench.bench.foundations.errors import SignalMapError
from gyrobench.bench.foundations.text import flag_text
from gyrobench.bench.procedure.plan import DwellPurpose
from gyrobench.bench.procedure.rotation_steps import counted_moves
from gyrobench.bench.runs.marks import DwellMarks
from gyrobench.drivers.frames import FrameBlock


class MeasuredUnit:
    """A unit that is on the bench and takes part in the run.

    ``live`` is its INS, ``run`` its own part of the run, ``recorder`` the dwell in progress.
    """

    def __init__(self, context: RunContext, live: LiveUnit) -> None:
        self._context = context
        self.live = live
        self.run = context.units[live.station.number]
        self.journal = context.unit_journals[live.station.number]
        self.recorder = DwellRecorder(context.bench, live, self.run.setup)
        self.is_identified = bool(self.run.state.unit)
        self.tripped_s: float | None = None  #: since when its interlock is tripped
        self._contradicted = False
        live.state.number = self.run.state.unit or self.run.number or context.job.unit

    def note(self, text: str) -> None:
        """Record something that the operator should know of this unit; notify the observers."""
        self.journal.record("note", text=text)
        self._noted(text)

    def finish_dwell(self) -> bool:
        """Measure the dwell that is over; returns False where it has to be repeated.

        Raises SignalMapError if it contradicts the station file, and the dwell before did too or none of the
        run agreed, or if all dwells together do: each further dwell would be invalid too. One alone after
        dwells that agreed is a disturbance.
        """
        marks, outcome, state = self.recorder.marks(), self.run.outcome, self.run.state
        frames = self.live.end_capture()
        if not marks.purpose.gives_bias:
            return self._finish_recorded(marks, frames)
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
        )
        state.finished.add(marks.dwell)
        if isinstance(measured, MeasuredDwell):
            dwells = outcome.dwells
            add_dwell(dwells, measured)
            write_dwells(self.run.folder.dwells, [each.row for each in dwells])
            self._context.observers.dwell_measured(dwells[-1].row)
            if dwells[-1].setup_fault and not measured.setup_fault:  # by all dwells together
                raise SignalMapError(dwells[-1].setup_fault)
        else:
            outcome.check_dwells.append(measured)
            text = flags or "measured for the calibration check"
            self._noted(f"{self._named(marks)} at {marks.azimuth_deg:g} deg: {text}")
        if is_map_wrong:
            raise SignalMapError(measured.setup_fault)
        return True

    def _finish_recorded(self, marks: DwellMarks, frames: FrameBlock) -> bool:
        flags = flag_text(marks.disturbances)
        if flags and self.may_repeat(marks.dwell):
            self.repeat_dwell(marks.dwell, flags)
            return False
        self.journal.record("dwell_finished", marks=marks.to_json(), flags=flags)
        self.run.state.finished.add(marks.dwell)
        is_rotated = marks.purpose is DwellPurpose.ROTATIONS
        if is_rotated and not marks.disturbances:
            for finding in self.run.outcome.rotations.add(marks, frames, self.run.setup):
                self._noted(finding)
        steps = [each.step for each in self.run.plan.steps if each.dwell == marks.dwell]
        what = counted_moves(steps) if is_rotated else "noise"
        self._noted(f"{self._named(marks)}: {what} {f'flagged: {flags}' if flags else 'recorded'}")
        return True

    def _named(self, marks: DwellMarks) -> str:
        """A dwell that has no row in the terminal, by its number and position."""
        return f"dwell {marks.dwell}/{self.run.plan.dwell_count}, {marks.position}"

    def _has_agreed(self) -> bool:
        """Whether a dwell of this run, also before a resume, agreed with the signal map."""
        outcome = self.run.outcome
        return any(each.estimate for each in outcome.dwells) or any(
            each.navigation for each in outcome.check_dwells
        )

    def may_repeat(self, dwell: int) -> bool:
        """Whether the procedure allows that a dwell with invalid data is repeated."""
        procedure, repeats = self._context.plan.procedure, self.run.state.repeats
        return (
            procedure.disturbed_dwell == "repeat"
            and repeats[dwell] < procedure.max_repeats
            and repeats.total() < procedure.max_repeats_total
        )

    def repeat_dwell(self, dwell: int, why: str) -> None:
        """Discard a dwell, which is repeated; it counts against the procedure's limit."""
        self.run.state.repeats[dwell] += 1
        self.journal.record("dwell_given_up", dwell=dwell, why=why, counts=True)
        self._noted(f"dwell {dwell} is repeated: {why}")

    def _noted(self, text: str) -> None:
        self._context.observers.noted(self.run.named(text))
