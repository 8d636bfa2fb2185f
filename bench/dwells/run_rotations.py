"""Coefficients of the sensors by the rotations of each plateau, and the spins of a run."""

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
from gyrobench.bench.calibration.information import BIAS_DRIFT, CalibrationOptions, Information
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

#: Slopes of a gyro's temperature by which dwells with rotations of one plateau may differ: after the soaks of
#: the shipped procedures they are up to 4 K/h.
_MAX_RATE_APART_C_PER_H = 5.0
_NO_COEFFICIENTS = "the rotations give no coefficients: {}"
#: Mean temperatures of the gyros and their slopes, of dwells and rotations alike.
OF_GYROS = ("gyro_c", "gyro_rate_c_per_h")


@dataclass(frozen=True, eq=False)
class PlateauRotations:
    """What the rotations of one plateau show."""

    marks: DwellMarks  #: Of the first dwell with rotations.
    #: gyro_c, case_c: Mean temperatures of the gyros and of the case, degC; NaN where not measured.
    gyro_c: Triple = NOT_MEASURED
    case_c: float = math.nan
    gyro_rate_c_per_h: Triple = NOT_MEASURED  #: Their slopes.
    #: Lowest and highest temperatures (2, 4) of gyros and case.
    range_c: FloatArray = field(default_factory=lambda: np.full((2, 4), np.nan))
    calibration: Calibration | None = None  #: None where there is a ``finding``, which says why.
    finding: str = ""
    #: As uncertain as if the INS sent specific forces; None where it does.
    with_force: CoefficientEstimate | None = None

    @property
    def findings(self) -> tuple[str, ...]:
        """Why they give nothing, or what they contradict; empty where nothing is wrong."""
        if self.calibration is None:
            return (self.finding,) if self.finding else ()
        return tuple(f"rotations: {each}" for each in self.calibration.findings)

    @property
    def notes(self) -> tuple[str, ...]:
        """What they show beside the coefficients."""
        return () if self.calibration is None else self.calibration.notes


class RunRotations:
    """Dwells with rotations, measured one by one in the order of time; increments of one plateau are held."""

    def __init__(self) -> None:
        self.dwells: list[int] = []  #: Numbers of those added.
        self._before: list[PlateauRotations] = []
        self._last: list[DwellMarks] = []  # of the last set point
        self._groups: list[list[RotatedDwell]] = []
        self._finding = ""

    def add(self, marks: DwellMarks, frames: FrameBlock, setup: MeasurementSetup) -> tuple[str, ...]:
        """Add the next dwell; with the first one of another set point those before are calibrated.

        Returns what turned out to be wrong with it, or with those before, and what these show beside the
        coefficients.
        """
        found: tuple[str, ...] = ()
        if self._last and plateau_key(self._last[0]) != plateau_key(marks):
            is_known, known = bool(self._finding), len(self._before)
            self._before, self._last, self._groups, self._finding = self.calibrated(setup), [], [], ""
            if not is_known:
                found = tuple(text for each in self._before[known:] for text in (*each.findings, *each.notes))
        self._last.append(marks)
        self.dwells.append(marks.dwell)
        if self._finding:
            return found
        try:
            dwell = measure_rotations(marks, frames, setup)
        except MeasurementError as error:
            self._groups, self._finding = [], _NO_COEFFICIENTS.format(error)
            return (*found, self._finding)
        if not (self._groups and _is_alike(self._groups[-1], dwell)):
            self._groups.append([])
        self._groups[-1].append(dwell)
        return found

    def calibrated(self, setup: MeasurementSetup) -> list[PlateauRotations]:
        """Coefficients of all set points; of one those on a ramp to it are kept apart."""
        found = [_calibrated_rotations(group, setup) for group in self._groups]
        if self._finding:
            found = [PlateauRotations(self._last[0], finding=self._finding)]
        return [*self._before, *found]


def _is_alike(group: Sequence[RotatedDwell], dwell: RotatedDwell) -> bool:
    """Whether a dwell has the temperatures of a group and their slopes; those not measured count as alike."""
    gyro_c, rates = (np.mean([getattr(each, name) for each in group], axis=0) for name in OF_GYROS)
    is_apart = np.abs(gyro_c - dwell.gyro_c) > MAX_FROM_MEAN_K
    return not (is_apart | (np.abs(rates - dwell.gyro_rate_c_per_h) > _MAX_RATE_APART_C_PER_H)).any()


def _calibrated_rotations(dwells: Sequence[RotatedDwell], setup: MeasurementSetup) -> PlateauRotations:
    options = _options(setup)
    gyro_c, gyro_rate_c_per_h = (
        triple(np.mean([getattr(each, name) for each in dwells], axis=0)) for name in OF_GYROS
    )
    case_c = float(np.mean([each.case_c for each in dwells]))
    range_c = enclosing([each.range_c for each in dwells])
    rotations = PlateauRotations(dwells[0].marks, gyro_c, case_c, gyro_rate_c_per_h, range_c)
    try:
        found = _calibrated([piece for each in dwells for piece in each.pieces], setup.site, options)
        with_force = None
        if not all(each.has_vertical for each in found.recordings):
            with_force = _with_force(found, setup.site)
    except MeasurementError as error:
        return replace(rotations, finding=_NO_COEFFICIENTS.format(error))
    parts = covariances_by_source(found, setup.site)
    # The increments themselves are no longer needed, nor what was estimated beside the coefficients.
    found = replace(
        found,
        values=found.values[:COUNT],
        covariance=found.covariance[:COUNT, :COUNT],
        is_observed=found.is_observed[:COUNT],
        coefficients=COEFFICIENTS,
        recordings=(),
        sections=(),
        trajectories=(),
        parts=parts,
    )
    return replace(rotations, calibration=found, with_force=with_force)


def compile_calibration(setup: MeasurementSetup) -> None:
    """Compile what a calibration by rotations needs, or load it from numba's cache."""
    angle_rad = np.interp(
        np.arange(1801), *np.array([(0, 800, 1000, 1800), (0, 0, 0.5 * np.pi, 0.5 * np.pi)])
    )
    attitude = rotation_matrices(np.outer(angle_rad, [1.0, 0.0, 0.0]))
    noise = np.random.default_rng(0).normal(0.0, 1e-7, (2, 1800, 3))
    angle, velocity = noise + ideal_increments(attitude, setup.site)
    _calibrated(
        [IncrementRecording(STEP_S, angle, velocity, known_rests=(Rest(0, 800), Rest(1000, 1800)))],
        setup.site,
        _options(setup),
    )


def spin_record(marks: DwellMarks, frames: FrameBlock, setup: MeasurementSetup) -> SpinRecord:
    """Scale factors of the gyros by the whole turns of one dwell alone.

    Their biases are those of the rests: a bias that followed whole turns would take in an asymmetry.
    """
    at_s = 0.5 * (marks.start_s + marks.end_s)
    try:
        dwell = measure_rotations(marks, frames, setup)
        options = replace(_options(setup), whole_turns=None, g_sensitivity=False)
        found = _calibrated(dwell.pieces, setup.site, options)
        spun = spin_scale_factors(found, setup.site, setup.table_repeatability)
        if contradiction := gravity_contradiction(found, spun):
            raise MeasurementError(contradiction)
    except MeasurementError as error:
        return SpinRecord(marks.run, at_s, NOT_MEASURED, (), str(error).rstrip("."))
    return SpinRecord(marks.run, at_s, dwell.gyro_c, tuple(spun))


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
        latitude_sigma=setup.prior.latitude,
        bias_drift=BIAS_DRIFT,
        are_explained=False,
    )


def _calibrated(pieces: Sequence[IncrementRecording], site: Site, options: CalibrationOptions) -> Calibration:
    if not pieces:
        raise MeasurementError("too many increments are missing in the rotations. Check the CAN bus")
    return calibrate(pieces, site, options)


def _with_force(found: Calibration, site: Site) -> CoefficientEstimate:
    """The same estimate as uncertain as it would be if the vertical specific force were measured."""
    sections = [replace(each, epochs=replace(each.epochs, has_vertical=True)) for each in found.sections]
    known = found.trajectories, found.common, found.noise, site, found.options
    information = Information.of(sections, *known)
    _, covariance, is_observed = information.solve()
    by_site = sum(part[:COUNT, :COUNT] for part in found.by_site.values())
    values = found.values[:COUNT]
    return CoefficientEstimate(values, covariance[:COUNT, :COUNT] + by_site, is_observed[:COUNT])


def enclosing(ranges_c: Sequence[FloatArray]) -> FloatArray:
    """Lowest and highest temperatures (2, 4) of several such ranges, those not measured left out."""
    low_c, high_c = np.moveaxis(np.array(ranges_c), 1, 0)
    return np.array([np.fmin.reduce(low_c), np.fmax.reduce(high_c)])
