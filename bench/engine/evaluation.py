"""The results of a run: computed at its end, or recomputed from its raw CAN log."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from gyrobench.bench.bias.dwell_table import DwellRow, read_dwells, write_dwells
from gyrobench.bench.dwells.check_dwell import CheckDwell
from gyrobench.bench.dwells.dwell import MeasuredDwell, MeasurementSetup, measurement_setup
from gyrobench.bench.dwells.plateau_calibration import RunRotations, calibrate_plateaus, spin_record
from gyrobench.bench.dwells.run_dwells import (
    RunResults,
    evaluate,
    noise_records,
    planned_dwells,
    replay,
    rotated,
    rotated_marks,
    write_results,
)
from gyrobench.bench.procedure.plan import Plan
from gyrobench.bench.procedure.procedure_file import load_procedure
from gyrobench.bench.runs.folder import RunFolder, open_run_folder
from gyrobench.bench.station.station import Station
from gyrobench.bench.verification.calibration_check import calibration_check_rows


def evaluate_run(
    folder: RunFolder,
    plan: Plan,
    setup: MeasurementSetup,
    dwells: Sequence[MeasuredDwell],
    check_dwells: Sequence[CheckDwell],
    calibration: Sequence[DwellRow],
    rotations: RunRotations | None = None,
) -> RunResults:
    """Compute the results of all dwells of a run, and write them into its folder.

    ``check_dwells`` are compared with ``calibration``, or where that is empty with the run's own dwells.
    ``rotations``: as measured during the run; where they are not those of the journal, the log is read.
    Raises RunFolderError if the tables can't be written.
    """
    check = calibration_check_rows(check_dwells, calibration or [dwell.row for dwell in dwells], setup)
    procedure = plan.procedure
    results = evaluate(
        dwells, setup, procedure.bin_width_c, procedure.acceptance, planned_dwells(plan), check
    )
    rows = [dwell.row for dwell in results.dwells]
    turned = _rotations(folder, setup, rotations or RunRotations()).calibrated(setup)
    coefficients = calibrate_plateaus(results.joint, rows, turned, setup)
    with_spins = procedure.tests.scale_factor_stability is not None
    records = noise_records(folder, setup) if procedure.tests.allan_variance else []
    spins = [spin_record(*each, setup) for each in rotated(folder)] if with_spins else []
    characteristics = procedure.tests.evaluate(rows, records, spins)
    results = replace(results, coefficients=coefficients, characteristics=characteristics)
    if results.dwells:
        write_dwells(folder.dwells, rows)
    write_results(folder, results)
    return results


def _rotations(folder: RunFolder, setup: MeasurementSetup, known: RunRotations) -> RunRotations:
    """Those of all dwells with rotations, read from the log where others are known."""
    if known.dwells == [marks.dwell for marks in rotated_marks(folder)]:
        return known
    found = RunRotations()
    for marks, frames in rotated(folder):
        found.add(marks, frames, setup)
    return found


def recompute_run(path: Path) -> RunFolder:
    """Measure a run again from its raw log, and write its tables.

    Raises RunFolderError if the folder is not a run folder, or its log can't be read. Raises DocumentError if
    the procedure, station or DBC file in it is wrong.
    """
    folder = open_run_folder(path)
    document, procedure = load_procedure(folder.procedure)
    station = Station(folder.station)
    setup = measurement_setup(station)
    dwells, check_dwells = replay(folder, setup)
    calibration = read_dwells(folder.calibration) if folder.calibration.exists() else []
    evaluate_run(folder, station.plan(document, procedure), setup, dwells, check_dwells, calibration)
    return folder
