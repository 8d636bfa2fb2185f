"""The dwells of a run: measured when they are over, repeated where a fault touched them."""

from __future__ import annotations

from dataclasses import asdict

from gyrobench.bench.bias.dwell_table import write_dwells
from gyrobench.bench.dwells.check_dwell import measure_check_dwell
from gyrobench.bench.dwells.dwell import MeasuredDwell, MeasurementSetup, measure_dwell
from gyrobench.bench.dwells.run_dwells import add_dwell
from gyrobench.bench.engine.dwell_recorder import DwellRecorder
from gyrobench.bench.engine.live_bench import LiveBench
from gyrobench.bench.engine.outcome import RunOutcome
from gyrobench.bench.engine.people import Progress
from gyrobench.bench.engine.progress import RunProgress
from gyrobench.bench.procedure.procedure_file import Procedure
from gyrobench.bench.runs.folder import RunFolder
from gyrobench.bench.runs.journal import Journal


class DwellBook:
    """Decides what becomes of each dwell, and keeps journal and dwell table.

    Parameters
    ----------
    procedure : Procedure
        Says whether and how often a disturbed dwell is repeated.
    setup : MeasurementSetup
        What turns frames into biases.
    bench, recorder, folder, journal, progress, done, outcome
        Those of the run.
    """

    def __init__(
        self,
        procedure: Procedure,
        setup: MeasurementSetup,
        bench: LiveBench,
        recorder: DwellRecorder,
        folder: RunFolder,
        journal: Journal,
        progress: Progress,
        done: RunProgress,
        outcome: RunOutcome,
    ) -> None:
        self._procedure = procedure
        self._setup = setup
        self._bench = bench
        self._recorder = recorder
        self._folder = folder
        self._journal = journal
        self._progress = progress
        self._done = done
        self._outcome = outcome

    def finish(self) -> bool:
        """Measure the dwell that is over; tells whether it stays, or has to be repeated."""
        marks = self._recorder.marks()
        frames = self._bench.end_capture()
        measure = measure_check_dwell if marks.is_verification else measure_dwell
        measured = measure(marks, frames, self._setup)
        if measured.is_disturbed and self.may_repeat(marks.dwell):
            self._drop(marks.dwell, measured.flags, counts=True)
            return False
        self._journal.record(
            "dwell_finished", marks=marks.to_json(), flags=measured.flags, epochs=asdict(measured.counts)
        )
        self._done.finished.add(marks.dwell)
        if isinstance(measured, MeasuredDwell):
            add_dwell(self._outcome.dwells, measured)
            write_dwells(self._folder.dwells, [each.row for each in self._outcome.dwells])
            self._progress.dwell_measured(self._outcome.dwells[-1].row)
        else:
            self._outcome.verifications.append(measured)
            text = measured.flags or "taken for verification"
            self._progress.told(f"{marks.position} at {marks.azimuth_deg:g} deg: {text}")
        return True

    def may_repeat(self, dwell: int) -> bool:
        """Whether a dwell that was spoilt is done again, by the procedure's rule."""
        procedure, repeats = self._procedure, self._done.repeats
        return (
            procedure.disturbed_dwell == "repeat"
            and repeats[dwell] < procedure.max_repeats
            and repeats.total() < procedure.max_repeats_total
        )

    def give_up(self, dwell: int | None, why: str, counts: bool) -> None:
        """Drop what there is of a dwell under way; it is repeated.

        Parameters
        ----------
        counts : bool
            Whether the repeat is one of those that the procedure limits.
        """
        if dwell and self._bench.capture:
            self._bench.end_capture()
            self._drop(dwell, why, counts)

    def skip(self, dwell: int) -> None:
        """Leave a dwell out."""
        if self._bench.capture:
            self._bench.end_capture()
        self._journal.record("dwell_skipped", dwell=dwell)
        self._done.skipped.add(dwell)
        self._progress.told(f"dwell {dwell} is left out")

    def _drop(self, dwell: int, why: str, counts: bool) -> None:
        self._done.repeats[dwell] += counts
        self._journal.record("dwell_given_up", dwell=dwell, why=why, counts=counts)
        self._progress.told(f"dwell {dwell} is repeated: {why}")
