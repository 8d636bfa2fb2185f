"""The dwells of a run: collected as they are measured, measured again from the raw log, evaluated together.

A run of a thousand hours has thousands of dwells. Their rows and what the joint solution needs are small; the
navigation for the noise estimate is kept of some dwells only, evenly spread over the run.

An INS takes the Earth's rotation for the latitude that was entered. An error of it, or a deflection of the
vertical to the north, is a rate Up that adds to the bias of the vertical gyro, and a rate North that the
level gyros measure independently of their biases, since it does not turn with the unit. It is corrected where
confirmed, and flagged otherwise.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain, islice
from typing import Any

import numpy as np

from gyrobench.bench.bias.acceptance import judge
from gyrobench.bench.bias.bias_filter import Damping
from gyrobench.bench.bias.bins import BiasBin, bin_biases, write_bins
from gyrobench.bench.bias.budget import BiasBudget, BudgetedDwell, bin_budgets, dwell_budgets, with_budgets
from gyrobench.bench.bias.dwell_table import Triple
from gyrobench.bench.bias.joint_solution import JointDwell, JointSolution, pooled_up_rate, solve_jointly
from gyrobench.bench.bias.noise_estimate import NoiseEstimate, estimate_noise
from gyrobench.bench.bias.parameters import PriorKnowledge
from gyrobench.bench.bias.plateaus import PlannedDwell, group_plateaus
from gyrobench.bench.bias.verdicts import Acceptance, AcceptanceLimits, write_acceptance
from gyrobench.bench.bias.vertical_pairs import Finding, UpRate, exceeds_declared
from gyrobench.bench.characteristics.allan_test import RateRecord
from gyrobench.bench.characteristics.results import TestResult, write_characteristics
from gyrobench.bench.dwells.check_dwell import CheckDwell, measure_check_dwell
from gyrobench.bench.dwells.dwell import MeasuredDwell, MeasurementSetup, measure_dwell
from gyrobench.bench.dwells.marks import DwellMarks
from gyrobench.bench.dwells.plateau_calibration import PlateauCalibration
from gyrobench.bench.dwells.rotated_dwell import navigated_increments
from gyrobench.bench.dwells.setup_check import setup_fault
from gyrobench.bench.dwells.temperatures import stuck_sensors
from gyrobench.bench.foundations.arrays import RAD_TO_ARCMIN, RADPS_TO_DPH
from gyrobench.bench.foundations.errors import MeasurementError, RunFolderError
from gyrobench.bench.foundations.files import remove
from gyrobench.bench.navigation.positions import POSITIONS
from gyrobench.bench.procedure.plan import Plan, PlannedStep
from gyrobench.bench.runs.can_log import read_can_log
from gyrobench.bench.runs.folder import RunFolder
from gyrobench.bench.runs.journal import read_journal
from gyrobench.bench.runs.tables.budget_table import budget_rows, coefficient_budget_rows, write_budget
from gyrobench.bench.runs.tables.calibration_check_table import CalibrationCheckRow, write_calibration_check
from gyrobench.bench.runs.tables.coefficient_table import write_coefficients, write_correlations
from gyrobench.bench.runs.tables.joint_table import (
    JointBiasRow,
    JointPlateauRow,
    joint_bias_rows,
    joint_plateau_rows,
    write_joint,
)
from gyrobench.bench.runs.tables.noise_file import write_noise
from gyrobench.drivers.frames import FrameBlock, concatenate


def replay(folder: RunFolder, setup: MeasurementSetup) -> tuple[list[MeasuredDwell], list[CheckDwell]]:
    """Measure every finished dwell of a run again; check dwells are returned separately.

    The journal lists the frames of each dwell; the frames themselves come from the raw log, one part of it at
    a time. Of a dwell that was finished twice, the last time counts; parts of the log that belong to no
    finished dwell, as a kill leaves them, are passed over. Raises RunFolderError if the journal or the log
    can't be read, or the log lacks the frames of a dwell.
    """
    dwells: list[MeasuredDwell] = []
    check_dwells: list[CheckDwell] = []
    for marks, frames in _recorded(folder):
        if marks.is_calibration_check:
            check_dwells.append(measure_check_dwell(marks, frames, setup))
        else:
            add_dwell(dwells, measure_dwell(marks, frames, setup))
    return dwells, check_dwells


def _recorded(folder: RunFolder) -> Iterator[tuple[DwellMarks, FrameBlock]]:
    finished = [marks for marks in finished_marks(folder) if marks.gives_bias]
    parts = [marks.log_part for marks in finished if marks.windows]
    if len(set(parts)) < len(parts):
        raise RunFolderError(f"{folder.journal}: damaged: it places two dwells in one part of the log")
    for marks in finished:
        yield marks, read_frames(folder, marks)


def rotated(folder: RunFolder) -> Iterator[tuple[DwellMarks, FrameBlock]]:
    """Finished dwells with rotations that nothing disturbed, in order; raises as :func:`replay`."""
    for marks in rotated_marks(folder):
        yield marks, read_frames(folder, marks)


def rotated_marks(folder: RunFolder) -> list[DwellMarks]:
    """Marks of :func:`rotated`."""
    return [marks for marks in finished_marks(folder) if marks.is_rotated and not marks.disturbances]


def noise_records(folder: RunFolder, setup: MeasurementSetup) -> list[RateRecord]:
    """Gyro rates of the finished noise records that nothing disturbed; raises as :func:`replay`."""
    return [
        _rate_record(marks, read_frames(folder, marks), setup)
        for marks in finished_marks(folder)
        if marks.is_noise_record and not marks.disturbances
    ]


def _rate_record(marks: DwellMarks, frames: FrameBlock, setup: MeasurementSetup) -> RateRecord:
    """Integrated rates of the gyros over the window of a noise record, in pieces where epochs are missing."""
    increments = navigated_increments(setup.decode(frames), setup.site)
    first, end = marks.windows[0].first_frame, marks.windows[-1].end_frame
    inside = (increments.row > first) & (increments.row < end)
    angle, follows = increments.angle[inside], increments.follows[inside]
    every = int(np.ceil(max(len(angle), 1) / _MAX_NOISE_SAMPLES))
    pieces = np.split(angle, np.flatnonzero(~follows[1:]) + 1)
    segments = [np.vstack([np.zeros(3), np.cumsum(piece, axis=0)])[::every] for piece in pieces]
    return RateRecord(increments.interval_s * every, segments)


def finished_marks(folder: RunFolder) -> list[DwellMarks]:
    """Marks of the finished dwells in the journal, each number once, in the order of time.

    Raises RunFolderError if the journal is damaged.
    """
    return marks_in(read_journal(folder.journal), folder)


def marks_in(entries: Iterable[Mapping[str, Any]], folder: RunFolder) -> list[DwellMarks]:
    """:func:`finished_marks` of entries that were read already."""
    found: dict[int, DwellMarks] = {}
    for entry in entries:
        if entry.get("event") == "data_given_up":
            given_up = entry.get("dwells")
            if not isinstance(given_up, list):
                raise RunFolderError(f"{folder.journal}: damaged: data_given_up lacks its list of dwells")
            found = {dwell: marks for dwell, marks in found.items() if dwell not in given_up}
        elif entry.get("event") == "dwell_finished":
            try:
                marks = DwellMarks.from_json(entry.get("marks", {}))
            except RunFolderError as error:
                raise RunFolderError(f"{folder.journal}: {error}") from error
            found[marks.dwell] = marks
    return sorted(found.values(), key=lambda marks: marks.start_s)


def read_dwell_frames(folder: RunFolder, dwell: int) -> FrameBlock:
    """Frames of one finished dwell.

    Raises RunFolderError if the run has no finished dwell of that number, or the log lacks its frames.
    """
    marks = {each.dwell: each for each in finished_marks(folder)}.get(dwell)
    if marks is None:
        raise RunFolderError(f"{folder.path}: has no finished dwell {dwell}")
    return read_frames(folder, marks)


def read_frames(folder: RunFolder, marks: DwellMarks) -> FrameBlock:
    """Frames of a dwell by its marks, none if the INS never navigated in it.

    Raises RunFolderError if the log lacks them.
    """
    if not marks.windows:
        return concatenate([])
    for _, frames in read_can_log(folder.can, {marks.log_part}):
        return _frames(folder, marks, frames)
    raise RunFolderError(
        f"{folder.can}: lacks part {marks.log_part}, which dwell {marks.dwell} needs. Restore it"
    )


def _frames(folder: RunFolder, marks: DwellMarks, logged: FrameBlock) -> FrameBlock:
    frames, needed = logged.data_frames(), marks.frame_count
    if len(frames) < needed:
        raise RunFolderError(
            f"{folder.can}: part {marks.log_part} holds {len(frames)} frames, where dwell {marks.dwell} "
            f"needs {needed}: it is cut off or damaged. Restore the part"
        )
    return frames.take(slice(0, needed))


#: The noise estimate does not improve with more dwells than this.
_MAX_WITH_NAVIGATION = 128
#: Longest segments of a noise record are thinned to so many samples: the integral of the rate loses nothing
#: between them.
_MAX_NOISE_SAMPLES = 50_000


def add_dwell(dwells: list[MeasuredDwell], measured: MeasuredDwell) -> None:
    """Add the next dwell of a run.

    A temperature sensor that turns out to be stuck flags the dwells since it is, earlier ones too.
    """
    dwells.append(replace(measured, paper=None))  # the row has its results
    for index, flag in stuck_sensors([each.row for each in dwells]):
        row = dwells[index].row
        if flag not in row.flags:
            flags = "; ".join(text for text in (row.flags, flag) if text)
            dwells[index] = replace(dwells[index], row=replace(row, flags=flags))
    _flag_damping(dwells)
    _flag_setup(dwells)
    _keep_navigation_of_some(dwells)


#: The velocity of an INS is damped where chance gives the rate of all dwells together so rarely.
_MIN_DAMPING_P_VALUE = 1e-5


def _flag_damping(dwells: list[MeasuredDwell]) -> None:
    """Flag all dwells of an INS that damps its velocity: few dwells show it by themselves."""
    known = [each.estimate.damping for each in dwells if each.estimate and not each.is_disturbed]
    damping = Damping.mean(known) if known else None
    if damping is None or not damping.shows(_MIN_DAMPING_P_VALUE):
        return
    for index, dwell in enumerate(dwells):
        if dwell.estimate and "damps its velocity" not in dwell.row.flags:
            flags = "; ".join(text for text in (dwell.row.flags, damping.text) if text)
            dwells[index] = replace(
                dwell, row=replace(dwell.row, flags=flags), doubts=(*dwell.doubts, damping.text)
            )


def _flag_setup(dwells: list[MeasuredDwell]) -> None:
    """Flag all dwells of a set-up that they contradict together."""
    fault = setup_fault([each.evidence for each in dwells if each.evidence])
    if not fault:
        return
    for index, dwell in enumerate(dwells):
        if not dwell.setup_fault:
            flags = "; ".join(text for text in (dwell.row.flags, fault) if text)
            dwells[index] = replace(dwell, row=replace(dwell.row, flags=flags), setup_fault=fault)


def _keep_navigation_of_some(dwells: list[MeasuredDwell]) -> None:
    spacing, last = _spacing(len(dwells)), len(dwells) - 1
    first = 0 if spacing != _spacing(last) else last
    for index in range(first, len(dwells)):
        if index % spacing and dwells[index].windows:
            dwells[index] = replace(dwells[index], windows=())


def _spacing(count: int) -> int:
    """Smallest power of two that leaves few enough."""
    return 1 << max(0, (max(count, 1) - 1) // _MAX_WITH_NAVIGATION).bit_length()


@dataclass(frozen=True, eq=False)
class RunResults:
    """Results of a run."""

    #: As given; biases of vertical gyros without the effect of a wrong latitude, or flagged with it.
    dwells: list[MeasuredDwell] = field(default_factory=list)
    bins: list[BiasBin] = field(default_factory=list)  #: Bias per gyro, position and temperature.
    #: Gives the uncertainty budgets of dwells and bins; they are many, and made one by one.
    budgets: Callable[[], Iterator[BiasBudget]] = lambda: iter(())
    joint: list[JointSolution] = field(default_factory=list)  #: One for each plateau.
    #: Rate Up fixed in the navigation frame, from all plateaus whose dwells agree; None without any.
    up_rate: UpRate | None = None
    noise: NoiseEstimate | None = None  #: Of the INS, from its output; None where it is not observable.
    #: Biases that a calibration check measured, beside the calibrated ones.
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
    rate = pooled_up_rate(joint, setup.prior)
    evaluated = with_latitude(dwells, joint, rate, setup.prior)
    rows = [dwell.row for dwell in evaluated if dwell.estimate and not dwell.row.flags]
    bins = bin_biases(rows, bin_width_c)
    parts = [BudgetedDwell(each.row, each.estimate.parts) for each in evaluated if each.estimate]
    of_bins = bin_budgets(parts, bins, setup.budget_inputs)
    return RunResults(
        dwells=evaluated,
        bins=with_budgets(bins, of_bins),
        budgets=lambda: chain(dwell_budgets(parts, setup.budget_inputs), of_bins),
        joint=joint,
        up_rate=rate,
        noise=_noise([dwell for dwell in dwells if not dwell.is_disturbed], setup),
        calibration_check=list(calibration_check),
        acceptance=judge([dwell.row for dwell in evaluated], limits, planned, bin_width_c),
    )


def planned_dwells(plan: Plan) -> list[PlannedDwell]:
    """Dwells of a plan that measure biases, in order, at the temperatures estimated for their beginning."""
    first: dict[int, PlannedStep] = {}
    for step in plan.steps:
        if step.dwell is not None and step.gives_bias and not step.is_calibration_check:
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

    Raises RunFolderError if a file can't be written.
    """
    write_bins(folder.bias_bins, results.bins)
    write_joint(folder.joint_biases, joint_bias_rows(results.joint, results.up_rate), JointBiasRow)
    write_joint(folder.joint, joint_plateau_rows(results.joint, results.up_rate), JointPlateauRow)
    write_acceptance(folder.acceptance, results.acceptance)
    optional = (folder.noise, folder.calibration_check, folder.coefficients, folder.correlations)
    for stale in (*optional, folder.budget, folder.characteristics):
        remove(stale)
    biases = (budget_rows([each]) for each in results.budgets())
    coefficients = (coefficient_budget_rows(each.number, each.budgets) for each in results.coefficients)
    rows = chain.from_iterable(chain(biases, coefficients))
    for first in islice(rows, 1):
        write_budget(folder.budget, chain([first], rows))
    if results.coefficients:
        write_coefficients(folder.coefficients, [row for each in results.coefficients for row in each.rows()])
        write_correlations(
            folder.correlations, [(each.number, each.correlations) for each in results.coefficients]
        )
    if results.noise is not None:
        write_noise(folder.noise, results.noise)
    if results.calibration_check:
        write_calibration_check(folder.calibration_check, results.calibration_check)
    if results.characteristics:
        write_characteristics(folder.characteristics, results.characteristics)


def _joint_dwells(dwells: Sequence[MeasuredDwell]) -> list[JointDwell]:
    return [
        JointDwell(
            number=dwell.row.dwell,
            position_name=dwell.row.position,
            rows=dwell.shared,
            cycle=dwell.row.cycle,
            chamber_set_c=dwell.row.chamber_set_c,
            gyro_c=dwell.row.gyro_c,
            run=dwell.row.run,
        )
        for dwell in dwells
        if dwell.shared
    ]


def _noise(dwells: Sequence[MeasuredDwell], setup: MeasurementSetup) -> NoiseEstimate | None:
    try:
        return estimate_noise([window for dwell in dwells for window in dwell.windows], setup.site.gravity)
    except MeasurementError:
        return None


def with_latitude(
    dwells: Sequence[MeasuredDwell],
    solutions: Sequence[JointSolution],
    rate: UpRate | None,
    prior: PriorKnowledge,
) -> list[MeasuredDwell]:
    """The dwells of a run, the biases of vertical gyros without the effect of a wrong latitude.

    Where rates North and Up together confirm that the latitude is off by more than declared, biases and
    uncertainties of the vertical gyros are those of the joint solution without that rate. Where the rate
    North leads to that, and no rate Up that agrees with it contradicts, the dwells are flagged.

    Parameters
    ----------
    dwells : sequence of MeasuredDwell
        Of the run, in order.
    solutions : sequence of JointSolution
        Of its plateaus.
    rate : UpRate or None
        Rate Up of all plateaus.
    prior : PriorKnowledge
        With the declared uncertainty of the latitude.
    """
    if rate is not None and rate.finding is Finding.LATITUDE_OFF:
        corrected = {
            dwell.number: biases
            for solution in solutions
            for right in [solution.corrected(rate)]
            for dwell, *biases in zip(
                solution.dwells,
                RADPS_TO_DPH * right.bias_radps,
                RADPS_TO_DPH * right.sigma_radps,
                strict=True,
            )
        }
        return [_corrected(dwell, *corrected.get(dwell.row.dwell, ())) for dwell in dwells]
    if rate is not None and rate.applies and not rate.exceeds(prior.latitude):
        return list(dwells)
    flag = _north_flag(solutions, prior)
    numbers = {dwell.number for solution in solutions for dwell in solution.dwells}
    if not flag:
        return list(dwells)
    return [
        replace(each, row=replace(each.row, flags=flag)) if each.row.dwell in numbers else each
        for each in dwells
    ]


def _corrected(dwell: MeasuredDwell, *biases: np.ndarray) -> MeasuredDwell:
    if not biases:
        return dwell
    row, axis = dwell.row, POSITIONS[dwell.row.position].up_axis
    bias_dph, sigma_dph = (
        _with(values, axis, float(joint[axis]))
        for values, joint in zip((row.bias_dph, row.sigma_dph), biases, strict=True)
    )
    return replace(dwell, row=replace(row, bias_dph=bias_dph, sigma_dph=sigma_dph))


def _with(values: Triple, axis: int, value: float) -> Triple:
    x, y, z = (value if index == axis else each for index, each in enumerate(values))
    return x, y, z


def _north_flag(solutions: Sequence[JointSolution], prior: PriorKnowledge) -> str:
    """Flag for a rate North that leads to a wrong latitude; empty without one."""
    agreeing = [each for each in solutions if each.agrees]
    if not agreeing:
        return ""
    rates, sigmas = np.array([each.north_rate for each in agreeing]).T
    _, _, earth_up = agreeing[0].dwells[0].rows.earth_rate
    error = float((rates / sigmas**2).sum() / (1.0 / sigmas**2).sum() / earth_up)
    # What the misalignments of the gyros do is common to all plateaus.
    sigma = float(np.hypot((1.0 / sigmas**2).sum() ** -0.5, sigmas.min() / 2.0) / abs(earth_up))
    if not exceeds_declared(error, sigma, prior.latitude):
        return ""
    return (
        f"a rate North fixed in the navigation frame, as of a latitude {RAD_TO_ARCMIN * error:+.2f} ± "
        f"{RAD_TO_ARCMIN * sigma:.2f} arcmin off ({RAD_TO_ARCMIN * prior.latitude:.2g} arcmin declared): the "
        "bias of the vertical gyro is off too. Check the latitude in station file and INS"
    )
