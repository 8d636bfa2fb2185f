"""Run folders: what is in them, and going on with a run that was cut short."""

from __future__ import annotations

import json
import math
import os
import shutil
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, TextIO

import numpy as np

from gyrobench.bench.bias.bins import BIAS_BINS_TABLE
from gyrobench.bench.bias.dwell_table import read_dwells
from gyrobench.bench.closure.files import read_held_out_cycles
from gyrobench.bench.closure.inputs import read_campaign
from gyrobench.bench.dwells.run_results import recompute_run
from gyrobench.bench.engine.job import prepare_job
from gyrobench.bench.engine.operator import ConsentingOperator
from gyrobench.bench.engine.resume import prepare_resumption
from gyrobench.bench.engine.run import resume_run, run_job
from gyrobench.bench.engine.verification_runs import new_emulation
from gyrobench.bench.foundations.errors import RunFolderError
from gyrobench.bench.monitor.terminal import RunConsole
from gyrobench.bench.monitor.terminal_view import LinesView
from gyrobench.bench.procedure.plan import Plan
from gyrobench.bench.report.calibration_check_section import calibration_check_section
from gyrobench.bench.report.estimator_sections import noise_section
from gyrobench.bench.report.run_content import read_run
from gyrobench.bench.runs.can_log import read_can_log
from gyrobench.bench.runs.folder import RunFolder, open_run_folder
from gyrobench.bench.runs.marks import DwellMarks
from gyrobench.bench.runs.tables.calibration_check_table import CALIBRATION_CHECK_TABLE
from gyrobench.bench.runs.tables.joint_table import JOINT_BIASES_TABLE, JOINT_PLATEAUS_TABLE
from gyrobench.bench.runs.tables.noise_file import read_noise
from gyrobench.bench.runs.telemetry import TELEMETRY_COLUMNS, read_telemetry
from gyrobench.bench.station.instruments import Emulation
from tests.fuzz.checks import WrongResultError, cells_of, check_cell, written

_RUN = Path(__file__).parent / "run.yaml"


def finished_run(shared: Path, calibration: bytes) -> Path:
    """Make a run with a verification in a folder, unless it is there."""
    path = shared / "finished"
    if not path.exists():
        shared.mkdir(parents=True, exist_ok=True)
        table = written(shared, "calibration.csv", calibration)
        job = prepare_job(str(_RUN), "quick", Emulation("quick"), table)
        with Path(os.devnull).open("w") as nowhere, _unseen(nowhere, job.plan) as view:
            run_job(job, shared / "begun", view, ConsentingOperator())
        (shared / "begun").rename(path)
    return path


def _unseen(nowhere: TextIO, plan: Plan) -> LinesView:
    return LinesView(RunConsole(file=nowhere), plan)


def _copied(run: Path, folder: Path) -> Path:
    copy = folder / "run"
    shutil.copytree(run, copy, ignore=shutil.ignore_patterns("figures", "report.html"))
    return copy


#: A part of the CAN log that holds a dwell.
PART = "can/part-00002.blf"


def use_journal(run: Path) -> Callable[[Path, bytes], None]:
    def use(folder: Path, data: bytes) -> None:
        copy = _copied(run, folder)
        (copy / "journal.jsonl").write_bytes(data)
        read_run(RunFolder(copy))
        new_emulation(open_run_folder(copy))
        recompute_run(copy)

    return use


#: A part after the last dwell, as a kill leaves one of a dwell that was under way.
_PART_OF_NO_DWELL = "can/part-00099.blf"


def use_can_log(run: Path) -> Callable[[Path, bytes], None]:
    """Measure the run again, first with a part damaged that it does not need, then with one of a dwell.

    Of either part no more is read than frames that it had, from the first on.
    """
    measured = RunFolder(run).dwells.read_bytes()
    expected = read_dwells(run / "dwells.csv")
    sound_frames = _frames(run, PART)

    def use(folder: Path, data: bytes) -> None:
        copy = _copied(run, folder)
        (copy / _PART_OF_NO_DWELL).write_bytes(data)
        frames = _frames(copy, _PART_OF_NO_DWELL)
        if frames != sound_frames[: len(frames)]:
            raise WrongResultError("the damaged part gives frames that were not in it")
        if recompute_run(copy).dwells.read_bytes() != measured:
            raise WrongResultError("a part of no dwell changed the dwells")
        (copy / _PART_OF_NO_DWELL).unlink()
        (copy / PART).write_bytes(data)
        recompute_run(copy)
        for row, sound in zip(read_dwells(copy / "dwells.csv"), expected, strict=True):
            if not row.flags and not np.allclose(
                row.bias_dph, sound.bias_dph, rtol=0.0, atol=5.0 * max(sound.sigma_dph)
            ):
                raise WrongResultError(f"bias {row.bias_dph} without a flag, not {sound.bias_dph}")

    return use


def _frames(run: Path, part: str) -> list[tuple[int, bytes]]:
    """Identifiers and bytes of the frames of one part."""
    parts = {f"can/part-{number:05}.blf": frames for number, frames in read_can_log(run / "can")}
    return [(frame.arbitration_id, bytes(frame.data)) for frame in parts[part].messages()]


def _has_marks(entry: Mapping[str, Any]) -> bool:
    try:
        DwellMarks.from_json(entry["marks"])
    except (KeyError, RunFolderError):
        return False
    return True


def use_telemetry(run: Path) -> Callable[[Path, bytes], None]:
    expected = read_telemetry(run / "telemetry")

    def use(folder: Path, data: bytes) -> None:
        copy = _copied(run, folder)
        (copy / "telemetry/part-00001.parquet").write_bytes(data)
        read_run(RunFolder(copy))
        readings = read_telemetry(copy / "telemetry")
        if any(len(readings[name]) != len(expected[name]) for name in TELEMETRY_COLUMNS):
            raise WrongResultError("the telemetry has another length")
        read_campaign(copy)

    return use


def use_provenance(run: Path) -> Callable[[Path, bytes], None]:
    def use(folder: Path, data: bytes) -> None:
        copy = RunFolder(_copied(run, folder))
        copy.provenance.write_bytes(data)
        read_run(copy)
        emulation = new_emulation(copy)
        options = json.loads(data).get("options", {})
        if "seed" in options and emulation.seed != options["seed"] + 1:
            raise WrongResultError(f"the next seed after {options['seed']!r} is {emulation.seed!r}")

    return use


def cut_journals(run: Path) -> tuple[bytes, ...]:
    """The journal as it was at some instants of the run."""
    lines = (run / "journal.jsonl").read_bytes().splitlines(keepends=True)
    return tuple(b"".join(lines[:count]) for count in range(3, len(lines), 6))


def use_cut_journal(run: Path) -> Callable[[Path, bytes], None]:
    """Resume the run to its end: each dwell is there once, none is passed over."""

    def use(folder: Path, data: bytes) -> None:
        copy = _copied(run, folder)
        (copy / "journal.jsonl").write_bytes(data)
        resumption = prepare_resumption(copy)
        resumption.describe()
        entries = _whole_entries(data)
        finished = {
            each["marks"]["dwell"]
            for each in entries
            if each.get("event") == "dwell_finished" and _has_marks(each)  # others are measured again
        }
        if resumption.progress.finished != finished:
            raise WrongResultError(
                f"dwells {resumption.progress.finished} are finished, the journal says {finished}"
            )
        plan = resumption.job.plan
        with Path(os.devnull).open("w") as nowhere, _unseen(nowhere, plan) as view:
            resumed, outcome = resume_run(resumption, view, ConsentingOperator())
        if outcome.ended == "stopped":  # another unit than that of the journal: the operator decides
            return
        if outcome.ended != "finished":
            raise WrongResultError(f"resumed, the run {outcome.ended}: {outcome.reason}")
        measured = {row.dwell for row in read_dwells(resumed.dwells)}
        verified = {each.marks.dwell for each in outcome.check_dwells}
        missing = {*range(1, plan.dwell_count + 1)} - measured - verified - resumption.progress.skipped
        if missing:
            raise WrongResultError(f"the dwells {missing} are lost")

    return use


def _whole_entries(data: bytes) -> list[dict[str, Any]]:
    """Entries of a journal, without damaged ones; a last line without its end was never finished."""
    return [_parsed(line) for line in data.split(b"\n")[:-1]]


def _parsed(line: bytes) -> dict[str, Any]:
    try:
        entry = json.loads(line)
    except (ValueError, RecursionError):
        return {}
    return entry if isinstance(entry, dict) else {}


def use_verification_table(run: Path) -> Callable[[Path, bytes], None]:
    """Read verification.csv as the report does."""

    def use(folder: Path, data: bytes) -> None:
        copy = RunFolder(_copied(run, folder))
        copy.calibration_check.write_bytes(data)
        read_run(copy)
        rows = CALIBRATION_CHECK_TABLE.read(copy.calibration_check)
        cells = cells_of(data)
        if len(rows) != len(cells):
            raise WrongResultError(f"{len(rows)} rows instead of {len(cells)}")
        for row, line in zip(rows, cells, strict=True):
            for name, cell in line.items():
                if name in CALIBRATION_CHECK_TABLE.columns:
                    check_cell(getattr(row, name), cell)
        calibration_check_section(rows)

    return use


def use_calibration_table(run: Path) -> Callable[[Path, bytes], None]:
    """Measure a verification again against a damaged calibration.csv."""

    def use(folder: Path, data: bytes) -> None:
        copy = RunFolder(_copied(run, folder))
        copy.calibration.write_bytes(data)
        recompute_run(copy.path)
        for row in CALIBRATION_CHECK_TABLE.read(copy.calibration_check):
            difference_dph = row.bias_dph - row.calibrated_dph
            if row.is_compared and not math.isclose(
                row.difference_dph, difference_dph, rel_tol=1e-6, abs_tol=1e-8
            ):
                raise WrongResultError(f"the difference is {row.difference_dph}, not {difference_dph}")

    return use


CLOSURE = '{"verdict": "explained", "held_out_cycles": [3, 4], "effects": [], "dwells_searched": 40}'


def use_closure(folder: Path, data: bytes) -> None:
    written(folder, "closure.json", data)
    cycles = read_held_out_cycles(folder)
    if cycles != json.loads(data)["held_out_cycles"]:
        raise WrongResultError(f"cycles {cycles}")


def use_noise(run: Path) -> Callable[[Path, bytes], None]:
    def use(folder: Path, data: bytes) -> None:
        copy = RunFolder(_copied(run, folder))
        copy.noise.write_bytes(data)
        for path, read in ((copy.bias_bins, BIAS_BINS_TABLE.read), (copy.joint, JOINT_PLATEAUS_TABLE.read)):
            read(path)
        list(JOINT_BIASES_TABLE.iterate(copy.joint_biases))
        noise = read_noise(copy.noise)
        noise_section(noise, {})

    return use
