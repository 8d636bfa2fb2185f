"""Going on with a run that was cut short: from its folder to results, or to words on what is left."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

from gyrobench.bench.bias.dwell_table import write_dwells
from gyrobench.bench.dwells.dwell import measurement_setup
from gyrobench.bench.dwells.run_dwells import replay
from gyrobench.bench.engine.operator import Operator
from gyrobench.bench.engine.outcome import RunOutcome
from gyrobench.bench.engine.people import Progress
from gyrobench.bench.engine.progress import WITHOUT_A_WORD, RunProgress, progress_of
from gyrobench.bench.engine.session import Job, carry_out, emulation_of, prepare_job
from gyrobench.bench.foundations.clock import RESUME_STEP_S, Clock, VirtualClock, WallClock
from gyrobench.bench.foundations.errors import RunFolderError
from gyrobench.bench.procedure.timeline import hours_minutes
from gyrobench.bench.runs.compensation_file import read_compensation
from gyrobench.bench.runs.folder import RunFolder, open_run_folder
from gyrobench.bench.runs.journal import read_journal
from gyrobench.bench.runs.provenance import started_utc
from gyrobench.bench.runs.telemetry import last_reading_s
from gyrobench.bench.station.instruments import Instruments

#: So many times in a row a run is resumed without finishing anything before somebody has to look at it.
MOST_RESUMED_IN_VAIN = 5


@dataclass(frozen=True)
class Resumption:
    """A run that was cut short, and what is left of it."""

    job: Job
    folder: RunFolder
    done: RunProgress


def prepare_resumption(path: Path, anyway: bool = False) -> Resumption:
    """Look at the folder of a run that was cut short: what is done, and what is left.

    Parameters
    ----------
    anyway : bool
        Whether to go on with a run that was resumed again and again without finishing anything.

    Raises
    ------
    RunFolderError
        There is no run, it is finished, or it was resumed too often in vain.
    DocumentError
        Its procedure, station or DBC file is wrong.
    """
    folder = open_run_folder(path)
    job = _job_of(folder)
    done = _progress_in(folder, job)
    if done.is_over(job.plan) and done.ended == "finished":
        raise RunFolderError(
            f"{path}: this run is finished, so there is nothing to resume. If tables or report are missing, "
            f"write them with: gyrobench bins {path}"
        )
    if done.resumed_in_vain >= MOST_RESUMED_IN_VAIN and not anyway:
        raise RunFolderError(
            f"{path}: was resumed {done.resumed_in_vain} times without finishing a single step. "
            "Find out why (the end of journal.jsonl tells), then resume it with --anyway"
        )
    return Resumption(job, folder, done)


def resume_run(
    resumption: Resumption, progress: Progress, operator: Operator
) -> tuple[RunFolder, RunOutcome]:
    """Resume an interrupted run; raises what :func:`~gyrobench.bench.engine.session.run_job` does."""
    job, folder, done = resumption.job, resumption.folder, resumption.done
    last_s = max(done.last_s, last_reading_s(folder.telemetry))
    clock: Clock
    if job.is_virtual:
        clock = VirtualClock(last_s + RESUME_STEP_S)
    else:
        clock = WallClock.resumed(started_utc(folder), last_s, job.station.file.speed)
    dwells, verifications = replay(folder, measurement_setup(job.station))
    outcome = RunOutcome(dwells=dwells, verifications=verifications)

    def begin(folder: RunFolder, instruments: Instruments) -> None:  # noqa: ARG001
        _check_unchanged(resumption)
        write_dwells(folder.dwells, [dwell.row for dwell in dwells])  # the journal may be ahead of it

    return carry_out(job, clock, lambda: folder, begin, done, outcome, progress, operator)


def describe_resumption(resumption: Resumption) -> str:
    """Say what a run folder holds and what resuming it will do."""
    done, plan = resumption.done, resumption.job.plan
    how = f"{done.ended}: {done.reason}" if done.ended else WITHOUT_A_WORD
    lines = [
        f"{resumption.folder.path}: {plan.procedure.procedure}"
        f"{f', unit {done.unit}' if done.unit else ''}; the run {how}.",
        f"{len(done.finished)} of {plan.dwell_count} dwells are finished and stay"
        f"{f', {len(done.skipped)} were left out' if done.skipped else ''}.",
    ]
    if done.under_way:
        lines.append(f"Under way was: {done.under_way}.")
    if done.is_over(plan):
        return "\n".join([*lines, "All steps are done; what is left is to evaluate them."])
    planned = plan.steps[done.next_index]
    what = f"dwell {planned.dwell} ({planned.label}), whole" if planned.dwell else planned.step.describe()
    left = hours_minutes(plan.duration_s - planned.start_s)
    lines.append(
        f"It goes on with step {planned.number} of {len(plan.steps)}, {what}; some {left} h are left."
    )
    if done.next_index:
        lines.append(
            "Before that the INS is switched off and on, and temperature and position are approached again."
        )
    return "\n".join(lines)


def _job_of(folder: RunFolder) -> Job:
    """Make the job of a run again from what its folder holds."""
    compensation = read_compensation(folder.compensation) if folder.compensation.exists() else None
    calibration = folder.calibration if folder.calibration.exists() else None
    return prepare_job(
        str(folder.procedure), str(folder.station), emulation_of(folder), calibration, compensation
    )


def _check_unchanged(resumption: Resumption) -> None:
    """Refuse to go on with what another process has gone on with before this one held the run."""
    done = resumption.done
    now = _progress_in(resumption.folder, resumption.job)
    if replace(now, last_s=done.last_s) != done:
        raise RunFolderError(
            f"{resumption.folder.path}: another process went on with this run meanwhile. Resume it again"
        )


def _progress_in(folder: RunFolder, job: Job) -> RunProgress:
    """How far a run is; what is wrong with its journal is told with the journal's path."""
    entries = list(read_journal(folder.journal))
    try:
        return progress_of(entries, job.plan)
    except RunFolderError as error:
        raise RunFolderError(f"{folder.journal}: {error}") from error
