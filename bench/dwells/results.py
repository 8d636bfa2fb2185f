"""What the dwells of a run give together."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

from gyrobench.bench.bias.acceptance import judge
from gyrobench.bench.bias.bins import BiasBin, bin_biases, write_bins
from gyrobench.bench.bias.joint_solution import (
    JointDwell,
    JointSolution,
    pooled_up_rate,
    solve_jointly,
)
from gyrobench.bench.bias.noise_estimate import NoiseEstimate, estimate_noise
from gyrobench.bench.bias.plateaus import PlannedDwell, group_plateaus
from gyrobench.bench.bias.verdicts import Acceptance, AcceptanceLimits, write_acceptance
from gyrobench.bench.bias.vertical_pairs import UpRate
from gyrobench.bench.dwells.dwell import MeasuredDwell, MeasurementSetup
from gyrobench.bench.foundations.errors import MeasurementError
from gyrobench.bench.foundations.files import remove
from gyrobench.bench.procedure.plan import Plan, PlannedStep
from gyrobench.bench.runs.folder import RunFolder
from gyrobench.bench.runs.tables.calibration_check_table import CalibrationCheckRow, write_calibration_check
from gyrobench.bench.runs.tables.joint_table import (
    JointBiasRow,
    JointPlateauRow,
    joint_bias_rows,
    joint_plateau_rows,
    write_joint,
)
from gyrobench.bench.runs.tables.noise_file import write_noise


@dataclass(frozen=True, eq=False)
class RunResults:
    """Results of a run beyond its dwells.

    Attributes
    ----------
    bins : list of BiasBin
        Bias per gyro, position and temperature.
    joint : list of JointSolution
        One for each plateau.
    up_rate : UpRate or None
        Rate Up fixed in the navigation frame, from all plateaus whose dwells agree; None without any.
    noise : NoiseEstimate or None
        Of the INS, from its output; None where it is not observable.
    calibration_check : list of CalibrationCheckRow
        Biases that a calibration check measured, beside the calibrated ones.
    acceptance : Acceptance
        Verdict on the unit by the limits of the procedure.
    """

    bins: list[BiasBin] = field(default_factory=list)
    joint: list[JointSolution] = field(default_factory=list)
    up_rate: UpRate | None = None
    noise: NoiseEstimate | None = None
    calibration_check: list[CalibrationCheckRow] = field(default_factory=list)
    acceptance: Acceptance = field(default_factory=Acceptance)


def evaluate(
    dwells: Sequence[MeasuredDwell],
    setup: MeasurementSetup,
    bin_width_c: float,
    limits: AcceptanceLimits | None = None,
    planned: Sequence[PlannedDwell] = (),
    calibration_check: Sequence[CalibrationCheckRow] = (),
) -> RunResults:
    """Evaluate the dwells of one run; those with flags are left out.

    The noise is an exception: dwells whose flags larger noise would explain count for it.

    Parameters
    ----------
    dwells : sequence of MeasuredDwell
        In the order of time.
    bin_width_c : float
        Width of the temperature bins, K.
    limits : AcceptanceLimits, optional
        Limits of acceptance; without them the unit is not judged.
    planned : sequence of PlannedDwell
        What was to be measured; see :func:`planned_dwells`.
    calibration_check : sequence of CalibrationCheckRow
        Of the run's check dwells.
    """
    good = [dwell for dwell in dwells if dwell.estimate and not dwell.row.flags]
    joint = [solve_jointly(plateau, setup.prior) for plateau in group_plateaus(_joint_dwells(good))]
    rows = [dwell.row for dwell in good]
    bins = bin_biases(rows, bin_width_c)
    return RunResults(
        bins=bins,
        joint=joint,
        up_rate=pooled_up_rate(joint),
        noise=_noise([dwell for dwell in dwells if not dwell.is_disturbed], setup),
        calibration_check=list(calibration_check),
        acceptance=judge([dwell.row for dwell in dwells], limits, planned, bin_width_c),
    )


def planned_dwells(plan: Plan) -> list[PlannedDwell]:
    """Dwells of a plan that measure biases, in order, at the temperatures estimated for their beginning."""
    first: dict[int, PlannedStep] = {}
    for step in plan.steps:
        if step.dwell is not None and not step.is_verification:
            first.setdefault(step.dwell, step)
    return [
        PlannedDwell(
            dwell=dwell,
            cycle=step.cycle,
            position=step.before.position,
            chamber_set_c=math.nan if step.before.set_point_c is None else step.before.set_point_c,
            gyro_c=(step.before.gyro_c, step.before.gyro_c, step.before.gyro_c),
        )
        for dwell, step in first.items()
        if step.before.position is not None
    ]


def write_results(folder: RunFolder, results: RunResults) -> None:
    """Write the tables of a run beyond that of its dwells.

    Raises
    ------
    RunFolderError
        A file can't be written.
    """
    write_bins(folder.bias_bins, results.bins)
    write_joint(folder.joint_biases, joint_bias_rows(results.joint, results.up_rate), JointBiasRow)
    write_joint(folder.joint, joint_plateau_rows(results.joint, results.up_rate), JointPlateauRow)
    write_acceptance(folder.acceptance, results.acceptance)
    for stale in (folder.noise, folder.verification):
        remove(stale)
    if results.noise is not None:
        write_noise(folder.noise, results.noise)
    if results.calibration_check:
        write_calibration_check(folder.verification, results.calibration_check)


def _joint_dwells(dwells: Sequence[MeasuredDwell]) -> list[JointDwell]:
    return [
        JointDwell(
            number=dwell.row.dwell,
            position_name=dwell.row.position,
            information=dwell.estimate.information,
            cycle=dwell.row.cycle,
            chamber_set_c=dwell.row.chamber_set_c,
            gyro_c=dwell.row.gyro_c,
            run=dwell.row.run,
        )
        for dwell in dwells
        if dwell.estimate
    ]


def _noise(dwells: Sequence[MeasuredDwell], setup: MeasurementSetup) -> NoiseEstimate | None:
    try:
        return estimate_noise([window for dwell in dwells for window in dwell.windows], setup.site.gravity)
    except MeasurementError:
        return None
