"""Calibrates the sensors by the rotations of each plateau, and evaluates the spins of a run."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from gyrobench.bench.bias.dwell_table import NOT_MEASURED
from gyrobench.bench.bias.plateaus import MAX_FROM_MEAN_K, plateau_key
from gyrobench.bench.calibration.coefficients import COEFFICIENTS, COUNT, CoefficientEstimate
from gyrobench.bench.calibration.estimator import Calibration, calibrate, covariances_by_source
from gyrobench.bench.calibration.increment_recording import IncrementRecording, Rest
from gyrobench.bench.calibration.information import BIAS_DRIFT, CalibrationOptions
from gyrobench.bench.calibration.rotation_list import STEP_S, ideal_increments
from gyrobench.bench.calibration.spins import gravity_contradiction, spin_scale_factors
from gyrobench.bench.characteristics.scale_factor import SpinRecord
from gyrobench.bench.dwells.measurement_setup import MeasurementSetup
from gyrobench.bench.dwells.rotated_dwell import RotatedDwell, measure_rotations
from gyrobench.bench.foundations.arrays import FloatArray, Triple, triple
from gyrobench.bench.foundations.errors import MeasurementError
from gyrobench.bench.navigation.attitude import rotation_matrices
from gyrobench.bench.navigation.error_model import Site
from gyrobench.bench.runs.marks import DwellMarks
from gyrobench.drivers.frames import FrameBlock

#: Largest difference of the temperature slopes of a gyro between dwells with rotations of one plateau: after
#: the soaks of the shipped procedures slopes are up to 4 K/h.
_MAX_RATE_DIFFERENCE_C_PER_H = 5.0
_NO_COEFFICIENTS = "the rotations give no coefficients: {}"
#: Fields of dwells and of rotations with the mean temperatures of the gyros and their slopes.
GYRO_TEMPERATURE_FIELDS = ("gyro_c", "gyro_rate_c_per_h")


@dataclass(frozen=True, eq=False)
class PlateauRotations:
    """Result of the rotations measured on one plateau."""

    marks: DwellMarks  #: Of the first dwell with rotations.
    #: gyro_c, case_c: Mean temperatures of the gyros and of the case, degC; NaN if not measured.
    gyro_c: Triple = NOT_MEASURED
    case_c: float = math.nan
    gyro_rate_c_per_h: Triple = NOT_MEASURED  #: Slopes of the gyro temperatures.
    #: Lowest and highest temperatures (2, 4) of gyros and case.
    range_c: FloatArray = field(default_factory=lambda: np.full((2, 4), np.nan))
    calibration: Calibration | None = None  #: None if there is none; ``finding`` has the reason.
    finding: str = ""
    #: Estimate with the covariance it would have if the INS sent specific force; None if it does.
    with_force: CoefficientEstimate | None = None
    #: Estimate with its optional parameters; None without a calibration.
    with_options: CoefficientEstimate | None = None

    @property
    def findings(self) -> tuple[str, ...]:
        """Reason why there is no calibration, or contradictions in the data; empty if nothing is wrong."""
        if self.calibration is None:
            return (self.finding,) if self.finding else ()
        return tuple(f"rotations: {each}" for each in self.calibration.findings)

    @property
    def notes(self) -> tuple[str, ...]:
        """Results of the rotations in addition to the coefficients."""
        return () if self.calibration is None else self.calibration.notes

    @property
    def has_g_sensitivity(self) -> bool:
        """Whether gyro biases that follow the specific force are estimated or part of the uncertainties."""
        if self.calibration is None:
            return False
        is_hidden = "g_sensitivity" in self.calibration.site_covariances
        return is_hidden or bool(self.calibration.problem.options.g_sensitivity)


class RunRotations:
    """Measures dwells with rotations one by one in the order of time.

    Only the increments of the present plateau are kept in memory.
    """

    def __init__(self) -> None:
        self.dwells: list[int] = []  #: Numbers of the dwells added.
        self._earlier_plateaus: list[PlateauRotations] = []
        self._plateau_marks: list[DwellMarks] = []  # of the present set point
        self._groups: list[list[RotatedDwell]] = []
        self._finding = ""

    def add(self, marks: DwellMarks, frames: FrameBlock, setup: MeasurementSetup) -> tuple[str, ...]:
        """Add the next dwell; if it is at another set point, the dwells before are calibrated.

        Returns the findings about this dwell and about the plateaus just calibrated, and notes about these.
        """
        texts: tuple[str, ...] = ()
        if self._plateau_marks and plateau_key(self._plateau_marks[0]) != plateau_key(marks):
            had_finding, earlier_count = bool(self._finding), len(self._earlier_plateaus)
            self._earlier_plateaus = self.calibrate(setup)
            self._plateau_marks, self._groups, self._finding = [], [], ""
            if not had_finding:
                texts = tuple(
                    text
                    for each in self._earlier_plateaus[earlier_count:]
                    for text in (*each.findings, *each.notes)
                )
        self._plateau_marks.append(marks)
        self.dwells.append(marks.dwell)
        if self._finding:
            return texts
        try:
            dwell = measure_rotations(marks, frames, setup)
        except MeasurementError as error:
            self._groups, self._finding = [], _NO_COEFFICIENTS.format(error)
            return (*texts, self._finding)
        if not (self._groups and _belongs_to(self._groups[-1], dwell)):
            self._groups.append([])
        self._groups[-1].append(dwell)
        return texts

    def calibrate(self, setup: MeasurementSetup) -> list[PlateauRotations]:
        """Calibrate all plateaus; rotations on a ramp to a set point form a separate plateau."""
        present = [_calibrate_group(group, setup) for group in self._groups]
        if self._finding:
            present = [PlateauRotations(self._plateau_marks[0], finding=self._finding)]
        return [*self._earlier_plateaus, *present]


def _belongs_to(group: Sequence[RotatedDwell], dwell: RotatedDwell) -> bool:
    """Whether a dwell has the temperatures and slopes of a group; those not measured count as equal."""
    gyro_c, rates = (
        np.mean([getattr(each, name) for each in group], axis=0) for name in GYRO_TEMPERATURE_FIELDS
    )
    is_different = np.abs(gyro_c - dwell.gyro_c) > MAX_FROM_MEAN_K
    return not (is_different | (np.abs(rates - dwell.gyro_rate_c_per_h) > _MAX_RATE_DIFFERENCE_C_PER_H)).any()


def _calibrate_group(dwells: Sequence[RotatedDwell], setup: MeasurementSetup) -> PlateauRotations:
    options = _options(setup)
    gyro_c, gyro_rate_c_per_h = (
        triple(np.mean([getattr(each, name) for each in dwells], axis=0)) for name in GYRO_TEMPERATURE_FIELDS
    )
    case_c = float(np.mean([each.case_c for each in dwells]))
    range_c = combined_range([each.range_c for each in dwells])
    rotations = PlateauRotations(dwells[0].marks, gyro_c, case_c, gyro_rate_c_per_h, range_c)
    try:
        calibration = _calibrate([piece for each in dwells for piece in each.pieces], setup.site, options)
        with_force = None
        if not all(each.has_vertical for each in calibration.recordings):
            with_force = _with_force(calibration)
    except MeasurementError as error:
        return replace(rotations, finding=_NO_COEFFICIENTS.format(error))
    parts = covariances_by_source(calibration)
    with_options = CoefficientEstimate(
        calibration.values,
        calibration.covariance,
        calibration.is_observed,
        coefficients=calibration.coefficients,
        parts=calibration.site_covariances,
    )
    # Drop the increments and the parameters other than the coefficients, which are no longer needed.
    calibration = replace(
        calibration,
        values=calibration.values[:COUNT],
        covariance=calibration.covariance[:COUNT, :COUNT],
        is_observed=calibration.is_observed[:COUNT],
        coefficients=COEFFICIENTS,
        problem=replace(calibration.problem, sections=()),
        recordings=(),
        trajectories=(),
        parts=parts,
    )
    return replace(rotations, calibration=calibration, with_force=with_force, with_options=with_options)


def compile_calibration(setup: MeasurementSetup) -> None:
    """Compile the kernels of a calibration by rotations, or load them from numba's cache."""
    angle_rad = np.interp(
        np.arange(1801), *np.array([(0, 800, 1000, 1800), (0, 0, 0.5 * np.pi, 0.5 * np.pi)])
    )
    attitude = rotation_matrices(np.outer(angle_rad, [1.0, 0.0, 0.0]))
    noise = np.random.default_rng(0).normal(0.0, 1e-7, (2, 1800, 3))
    angle, velocity = noise + ideal_increments(attitude, setup.site)
    _calibrate(
        [IncrementRecording(STEP_S, angle, velocity, given_rests=(Rest(0, 800), Rest(1000, 1800)))],
        setup.site,
        _options(setup),
    )


def spin_record(marks: DwellMarks, frames: FrameBlock, setup: MeasurementSetup) -> SpinRecord:
    """Scale factors of the gyros from the whole turns of a single dwell.

    The gyro biases are estimated from the rests only: estimated from whole turns they would absorb an
    asymmetry of the scale factor.
    """
    at_s = 0.5 * (marks.start_s + marks.end_s)
    try:
        dwell = measure_rotations(marks, frames, setup)
        options = replace(_options(setup), whole_turns=None, g_sensitivity=False)
        calibration = _calibrate(dwell.pieces, setup.site, options)
        scale_factors = spin_scale_factors(calibration, setup.table_repeatability)
        if contradiction := gravity_contradiction(calibration, scale_factors):
            raise MeasurementError(contradiction)
    except MeasurementError as error:
        return SpinRecord(marks.run, at_s, NOT_MEASURED, (), str(error).rstrip("."))
    return SpinRecord(marks.run, at_s, dwell.gyro_c, tuple(scale_factors))


def _options(setup: MeasurementSetup) -> CalibrationOptions:
    noise = setup.noise
    walks = None if noise is None else (noise.angle_random_walk, noise.velocity_random_walk)
    gravity, gravity_sigma = setup.gravity_and_sigma
    return CalibrationOptions(
        whole_turns=setup.table_repeatability,
        gravity=gravity,
        walks=walks,
        gravity_sigma=gravity_sigma,
        g_sensitivity=None,
        quadratic=None,
        latitude_sigma=setup.prior.latitude,
        bias_drift=BIAS_DRIFT,
    )


def _calibrate(pieces: Sequence[IncrementRecording], site: Site, options: CalibrationOptions) -> Calibration:
    if not pieces:
        raise MeasurementError("too many increments are missing in the rotations. Check the CAN bus")
    return calibrate(pieces, site, options)


def _with_force(calibration: Calibration) -> CoefficientEstimate:
    """Estimate with the covariance it would have if the vertical specific force were measured."""
    problem = calibration.problem
    sections = [replace(each, epochs=replace(each.epochs, has_vertical=True)) for each in problem.sections]
    with_vertical = replace(problem, sections=sections)
    information = with_vertical.information(calibration.trajectories, calibration.common)
    _, covariance, is_observed = information.solve()
    site_covariances = sum(part[:COUNT, :COUNT] for part in calibration.site_covariances.values())
    values = calibration.values[:COUNT]
    return CoefficientEstimate(values, covariance[:COUNT, :COUNT] + site_covariances, is_observed[:COUNT])


def combined_range(ranges_c: Sequence[FloatArray]) -> FloatArray:
    """Lowest and highest temperatures (2, 4) of several such ranges; NaN is ignored."""
    low_c, high_c = np.moveaxis(np.array(ranges_c), 1, 0)
    return np.array([np.fmin.reduce(low_c), np.fmax.reduce(high_c)])
