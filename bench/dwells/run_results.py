"""Evaluates all dwells of a run together, at its end or again from its raw CAN log, and writes the tables."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain, islice
from pathlib import Path

import numpy as np

from gyrobench.bench.bias.acceptance import judge
from gyrobench.bench.bias.bins import BIAS_BINS_TABLE, BiasBin, bin_biases
from gyrobench.bench.bias.budget import BiasBudget, BudgetedDwell, bin_budgets, dwell_budgets, with_budgets
from gyrobench.bench.bias.dwell import DwellPurpose
from gyrobench.bench.bias.dwell_table import DwellRow, read_dwells, write_dwells
from gyrobench.bench.bias.error_sources import SOURCES
from gyrobench.bench.bias.error_split import ErrorPart, shared_errors, split_errors
from gyrobench.bench.bias.held_heading import held_heading_s
from gyrobench.bench.bias.joint_solution import JointDwell, JointSolution, pooled_up_rate, solve_jointly
from gyrobench.bench.bias.noise_estimate import NoiseEstimate, estimate_noise
from gyrobench.bench.bias.plateaus import PlannedDwell, group_plateaus
from gyrobench.bench.bias.removed_bias import removed_directions
from gyrobench.bench.bias.verdicts import Acceptance, AcceptanceLimits, write_acceptance
from gyrobench.bench.bias.vertical_pairs import UpRate
from gyrobench.bench.characteristics.results import TestResult, write_characteristics
from gyrobench.bench.dwells.calibration_check import calibration_check_rows
from gyrobench.bench.dwells.latitude import with_latitude_uncertainty, without_latitude_error
from gyrobench.bench.dwells.measure_dwell import CheckDwell, MeasuredDwell
from gyrobench.bench.dwells.measurement_setup import MeasurementSetup, measurement_setup
from gyrobench.bench.dwells.plateau_calibration import PlateauCalibration, calibrate_plateaus
from gyrobench.bench.dwells.run_dwells import (
    flag_rest_of_wrong_setup,
    measure_recorded,
    rate_record,
    undisturbed_dwells,
    undisturbed_marks,
)
from gyrobench.bench.dwells.run_rotations import RunRotations, spin_record
from gyrobench.bench.foundations.errors import MeasurementError
from gyrobench.bench.foundations.files import remove
from gyrobench.bench.procedure.plan import Plan, PlannedStep
from gyrobench.bench.procedure.procedure_file import load_procedure
from gyrobench.bench.runs.folder import RunFolder, open_run_folder
from gyrobench.bench.runs.seal import update_seal
from gyrobench.bench.runs.tables.budget_table import (
    BUDGET_TABLE,
    budget_rows,
    coefficient_budget_rows,
    note_estimated_latitude,
)
from gyrobench.bench.runs.tables.calibration_check_table import CALIBRATION_CHECK_TABLE, CalibrationCheckRow
from gyrobench.bench.runs.tables.coefficient_table import COEFFICIENT_TABLE, write_correlations
from gyrobench.bench.runs.tables.joint_table import (
    JOINT_BIASES_TABLE,
    JOINT_PLATEAUS_TABLE,
    joint_bias_rows,
    joint_plateau_rows,
)
from gyrobench.bench.runs.tables.noise_file import write_noise
from gyrobench.bench.station.station import Station

#: Sources of error that the dwells of all cycles share in the acceptance.
_SHARED_SOURCES = [name for name, source in SOURCES.items() if source.is_common]


@dataclass(frozen=True, eq=False)
class RunResults:
    """Results of a run."""

    #: The dwells evaluated; biases of vertical gyros are corrected for a wrong latitude, or flagged for it.
    dwells: list[MeasuredDwell] = field(default_factory=list)
    bins: list[BiasBin] = field(default_factory=list)  #: Bias per gyro, position and temperature.
    #: Generates the uncertainty budgets of dwells and bins one by one, since they are many.
    budgets: Callable[[], Iterator[BiasBudget]] = lambda: iter(())
    joint: list[JointSolution] = field(default_factory=list)  #: One for each plateau.
    #: Rate Up fixed in the navigation frame, from all plateaus whose dwells agree; None without any.
    up_rate: UpRate | None = None
    declared_latitude: float = math.nan  #: Standard uncertainty of the latitude, rad.
    noise: NoiseEstimate | None = None  #: Of the INS, from its output; None if it is not observable.
    #: Biases measured by a calibration check, compared with the calibrated ones.
    calibration_check: list[CalibrationCheckRow] = field(default_factory=list)
    #: Coefficients of the sensors at each plateau.
    coefficients: list[PlateauCalibration] = field(default_factory=list)
    #: Verdict on the unit by the limits of the procedure.
    acceptance: Acceptance = field(default_factory=Acceptance)
    #: Results of the tests in the procedure.
    characteristics: list[TestResult] = field(default_factory=list)


def evaluate(
    dwells: Sequence[MeasuredDwell],
    setup: MeasurementSetup,
    bin_width_c: float,
    limits: AcceptanceLimits | None = None,
    planned: Sequence[PlannedDwell] = (),
) -> RunResults:
    """Evaluate the dwells of one run, in the order of time, without those that have flags.

    The noise estimate is an exception: it includes dwells whose flags are all persistent. ``bin_width_c``:
    width of the temperature bins, K; ``limits``: without them the unit is not judged; ``planned``: see
    :func:`planned_dwells`.
    """
    noise = _pooled_noise([dwell for dwell in dwells if not dwell.is_disturbed], setup)
    dwells = flag_rest_of_wrong_setup(_flag_removed_bias(_flag_held_heading(dwells, setup)))
    good = [dwell for dwell in dwells if dwell.estimate and not dwell.row.flags]
    joint = [solve_jointly(plateau, setup.prior) for plateau in group_plateaus(_joint_dwells(good))]
    rate = pooled_up_rate(joint, setup.prior)
    dwells = _with_larger_gyro_errors(dwells, joint)
    evaluated = without_latitude_error(dwells, joint, rate, setup.prior)
    rows = [dwell.row for dwell in evaluated if dwell.estimate and not dwell.row.flags]
    bins = bin_biases(rows, bin_width_c)
    parts = [BudgetedDwell(each.row, each.estimate.parts) for each in evaluated if each.estimate]
    budgets_of_bins = bin_budgets(parts, bins, setup.budget_inputs)
    return RunResults(
        dwells=evaluated,
        bins=with_budgets(bins, budgets_of_bins),
        budgets=lambda: chain(dwell_budgets(parts, setup.budget_inputs), budgets_of_bins),
        joint=joint,
        up_rate=rate,
        declared_latitude=setup.prior.latitude,
        noise=noise,
        acceptance=judge(
            [dwell.row for dwell in evaluated],
            limits,
            planned,
            bin_width_c,
            shared_errors(_errors(evaluated), _SHARED_SOURCES),
        ),
    )


def _errors(dwells: Iterable[MeasuredDwell]) -> dict[int, Mapping[str, ErrorPart]]:
    """Errors of the biases by source, of each dwell that has some by its number."""
    return {each.row.dwell: each.estimate.parts for each in dwells if each.estimate}


def planned_dwells(plan: Plan) -> list[PlannedDwell]:
    """Dwells of a plan that measure biases, in order, with the temperatures estimated for their start."""
    first_steps: dict[int, PlannedStep] = {}
    for step in plan.steps:
        if step.dwell is not None and step.purpose is DwellPurpose.CALIBRATION:
            first_steps.setdefault(step.dwell, step)
    return [
        PlannedDwell(
            dwell=dwell,
            cycle=step.cycle,
            position=step.before.position,
            chamber_set_c=math.nan if step.before.set_point_c is None else step.before.set_point_c,
            gyro_c=(step.before.gyro_c, step.before.gyro_c, step.before.gyro_c),
        )
        for dwell, step in first_steps.items()
        if step.before.position is not None
    ]


def write_results(folder: RunFolder, results: RunResults) -> None:
    """Write all tables of a run except the dwell table.

    Raises RunFolderError if a file can't be written.
    """
    BIAS_BINS_TABLE.write(folder.bias_bins, results.bins)
    JOINT_BIASES_TABLE.write(folder.joint_biases, joint_bias_rows(results.joint, results.up_rate))
    JOINT_PLATEAUS_TABLE.write(folder.joint, joint_plateau_rows(results.joint, results.up_rate))
    write_acceptance(folder.acceptance, results.acceptance)
    optional = (folder.noise, folder.calibration_check, folder.coefficients, folder.correlations)
    for stale in (*optional, folder.budget, folder.characteristics):
        remove(stale)
    biases = (budget_rows([each]) for each in results.budgets())
    coefficients = (coefficient_budget_rows(each.number, each.budgets) for each in results.coefficients)
    rows = note_estimated_latitude(
        chain.from_iterable(chain(biases, coefficients)), results.declared_latitude
    )
    for first in islice(rows, 1):
        BUDGET_TABLE.write(folder.budget, chain([first], rows))
    if results.coefficients:
        COEFFICIENT_TABLE.write(
            folder.coefficients, [row for each in results.coefficients for row in each.rows()]
        )
        write_correlations(
            folder.correlations, [(each.number, each.correlations) for each in results.coefficients]
        )
    if results.noise is not None:
        write_noise(folder.noise, results.noise)
    if results.calibration_check:
        CALIBRATION_CHECK_TABLE.write(folder.calibration_check, results.calibration_check)
    if results.characteristics:
        write_characteristics(folder.characteristics, results.characteristics)


def _joint_dwells(dwells: Sequence[MeasuredDwell]) -> list[JointDwell]:
    return [
        JointDwell(
            number=dwell.row.dwell,
            position_name=dwell.row.position,
            information=dwell.joint_information,
            cycle=dwell.row.cycle,
            chamber_set_c=dwell.row.chamber_set_c,
            gyro_c=dwell.row.gyro_c,
            run=dwell.row.run,
        )
        for dwell in dwells
        if dwell.joint_information
    ]


def _pooled_noise(dwells: Sequence[MeasuredDwell], setup: MeasurementSetup) -> NoiseEstimate | None:
    try:
        return estimate_noise([window for dwell in dwells for window in dwell.windows], setup.site.gravity)
    except MeasurementError:
        return None


def _with_larger_gyro_errors(
    dwells: Sequence[MeasuredDwell], joint: Sequence[JointSolution]
) -> Sequence[MeasuredDwell]:
    """Dwells with uncertainties that allow for the errors of the gyros' matrix found on their plateau."""
    factors = {
        dwell.number: (each.gyro_error_factor, each.scale_factor_ratio)
        for each in joint
        if max(each.gyro_error_factor, each.scale_factor_ratio) > 1.0
        for dwell in each.dwells
    }
    return [
        dwell.with_larger_gyro_errors(*factors[dwell.row.dwell]) if dwell.row.dwell in factors else dwell
        for dwell in dwells
    ]


def _with_errors_found(setup: MeasurementSetup, joint: Sequence[JointSolution]) -> MeasurementSetup:
    """Setup that allows for the largest errors of the gyros' matrix found on any plateau."""
    factor = max((each.gyro_error_factor for each in joint), default=1.0)
    ratio = max((each.scale_factor_ratio for each in joint), default=1.0)
    return replace(setup, prior=setup.prior.with_larger_gyro_errors(factor, ratio))


def _flag_held_heading(dwells: Sequence[MeasuredDwell], setup: MeasurementSetup) -> Sequence[MeasuredDwell]:
    """Flag all dwells if an aid of the INS holds the heading, which hides the biases of vertical gyros."""
    accelerometers = [np.abs(each.estimate.accelerometer_bias).max() for each in dwells if each.estimate]
    windows = [dwell.windows for dwell in dwells]
    held_s = held_heading_s(
        windows, setup.heading_lsb_rad, setup.site, float(max(accelerometers, default=0.0))
    )
    if held_s is None:
        return dwells
    flag = (
        f"the INS holds its heading with a time constant of about {held_s:.3g} s, by the headings of all "
        "dwells, so that the biases of the vertical gyros are wrong. Switch that aid off, and measure again"
    )
    return [dwell.with_flag(flag) for dwell in dwells]


def _flag_removed_bias(dwells: Sequence[MeasuredDwell]) -> Sequence[MeasuredDwell]:
    """Flag all dwells if the INS removes in its alignments the biases that it finds there."""
    directions = removed_directions([dwell.row for dwell in dwells if not dwell.flags])
    if not directions:
        return dwells
    flag = (
        f"the INS seems to remove in its alignment the gyro biases along {directions}: there they are zero "
        "in all positions, and those of the same gyros in other directions are not. Switch its bias "
        "estimation off; to exclude biases that follow the position, align at other azimuths as well"
    )
    return [dwell.with_flag(flag) for dwell in dwells]


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

    ``check_dwells`` are compared with ``calibration``, or with the results of the run's own dwells if that is
    empty; a latitude error or larger gyro errors that these show count in the comparison.
    ``rotations``: as measured during the run; if they are not those of the journal, the log is read.
    Raises RunFolderError if the tables can't be written.
    """
    procedure = plan.procedure
    results = evaluate(dwells, setup, procedure.bin_width_c, procedure.acceptance, planned_dwells(plan))
    rows = [dwell.row for dwell in results.dwells]
    check = calibration_check_rows(
        check_dwells, calibration or rows, _with_errors_found(setup, results.joint)
    )
    rotations_of_run = _rotations(folder, setup, rotations or RunRotations()).calibrate(setup)
    flagged = {row.dwell for row in rows if row.flags}
    consistent = [each for each in results.joint if flagged.isdisjoint(dwell.number for dwell in each.dwells)]
    coefficients = calibrate_plateaus(
        consistent, rows, rotations_of_run, with_latitude_uncertainty(setup, results.up_rate)
    )
    with_spins = procedure.tests.scale_factor_stability is not None
    purposes = DwellPurpose.NOISE, DwellPurpose.ROTATIONS
    noise, rotated = (undisturbed_dwells(folder, each) for each in purposes)
    records = [rate_record(*each, setup) for each in noise] if procedure.tests.allan_variance else []
    spins = [spin_record(*each, setup) for each in rotated] if with_spins else []
    errors = _errors(results.dwells)
    shared = shared_errors(errors, ["accelerometer_slope"])
    characteristics = procedure.tests.evaluate(rows, records, spins, shared, split_errors(errors))
    results = replace(
        results, calibration_check=check, coefficients=coefficients, characteristics=characteristics
    )
    if results.dwells:
        write_dwells(folder.dwells, rows)
    write_results(folder, results)
    return results


def _rotations(folder: RunFolder, setup: MeasurementSetup, so_far: RunRotations) -> RunRotations:
    """Rotations of all dwells; measured again from the log if ``so_far`` lacks dwells of the journal."""
    if so_far.dwells == [marks.dwell for marks in undisturbed_marks(folder, DwellPurpose.ROTATIONS)]:
        return so_far
    remeasured = RunRotations()
    for marks, frames in undisturbed_dwells(folder, DwellPurpose.ROTATIONS):
        remeasured.add(marks, frames, setup)
    return remeasured


def recompute_run(path: Path, is_sealed: bool = True) -> RunFolder:
    """Measure a run again from its raw log, and write its tables.

    ``is_sealed``: whether to seal the tables now; otherwise they are sealed with the report written next.

    Raises RunFolderError if the folder is not a run folder, or its log can't be read. Raises DocumentError if
    the procedure, station or DBC file in it is wrong.
    """
    folder = open_run_folder(path)
    document, procedure = load_procedure(folder.procedure)
    station = Station(folder.station)
    setup = measurement_setup(station)
    dwells, check_dwells = measure_recorded(folder, setup)
    calibration = read_dwells(folder.calibration) if folder.calibration.exists() else []
    evaluate_run(folder, station.plan(document, procedure), setup, dwells, check_dwells, calibration)
    if is_sealed:
        update_seal(folder, are_tables_new=True)
    return folder
