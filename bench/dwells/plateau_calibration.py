"""All coefficients of the sensors at each plateau, from the rotations of a run.

The increments come from the INS, or where it sends none from its navigation output: the change of its
attitude and velocity from epoch to epoch is what its sensors measured, but for the vertical specific force,
which an INS of fixed altitude does not show. Gravity stands in its place, and says nothing.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from gyrobench.bench.bias.dwell_table import Triple
from gyrobench.bench.bias.plateaus import MAX_FROM_MEAN_K
from gyrobench.bench.bias.statistics import Chi2Test
from gyrobench.bench.calibration.coefficients import COEFFICIENTS, COUNT
from gyrobench.bench.calibration.estimator import CalibrationOptions, calibrate
from gyrobench.bench.calibration.recording import MIN_REST_TOTAL_S, IncrementRecording, Rest
from gyrobench.bench.calibration.results import NOT_OBSERVABLE
from gyrobench.bench.dwells.dwell import MeasurementSetup, checked_navigation
from gyrobench.bench.dwells.marks import DwellMarks
from gyrobench.bench.dwells.temperatures import dwell_temperatures
from gyrobench.bench.foundations.arrays import BoolArray, FloatArray
from gyrobench.bench.foundations.errors import MeasurementError
from gyrobench.bench.navigation.attitude import rotation_matrices, rotation_vectors
from gyrobench.bench.navigation.earth import EARTH_RATE, curvature_radii
from gyrobench.bench.navigation.error_model import Site
from gyrobench.bench.navigation.positions import AXES
from gyrobench.bench.runs.tables.coefficient_table import PlateauCoefficientRow
from gyrobench.drivers.frames import FrameBlock
from gyrobench.drivers.ins.navigation_data import Increments, NavigationData

#: Epochs further apart than this, in usual intervals, have others between them that are lost.
_MAX_STEP = 1.5


@dataclass(frozen=True, eq=False)
class PlateauCalibration:
    """Coefficients of the sensors at one plateau, in the body frame of the accelerometers."""

    plateau: int  #: Number of the plateau with rotations, from 1.
    cycle: int
    chamber_set_c: float  #: NaN where the chamber is not controlled.
    #: gyro_c, case_c: Mean temperatures of the gyros and of the case, degC; NaN where not measured.
    gyro_c: Triple
    case_c: float
    #: values, covariance, is_observed: Shapes (21,), (21, 21), (21,). Of
    #: :data:`~gyrobench.bench.calibration.coefficients.COEFFICIENTS`, SI; without meaning where not observed.
    values: FloatArray
    covariance: FloatArray
    is_observed: BoolArray
    has_force: bool = True  #: Whether the INS sent specific forces.
    fit: Chi2Test | None = None  #: Whether the noise explains what the coefficients leave.
    finding: str = ""  #: Why there is no coefficient.

    @property
    def correlations(self) -> FloatArray:
        """Correlation coefficients (21, 21); NaN where not observed."""
        sigmas = np.sqrt(np.diag(self.covariance))
        seen = np.outer(self.is_observed, self.is_observed)
        return np.where(seen, self.covariance / np.outer(sigmas, sigmas), np.nan)

    def rows(self) -> list[PlateauCoefficientRow]:
        """Rows of ``coefficients.csv``."""
        values = np.where(self.is_observed, self.values, np.nan)
        sigmas = np.where(self.is_observed, np.sqrt(np.diag(self.covariance)), np.nan)
        return [
            PlateauCoefficientRow(
                self.plateau,
                self.cycle,
                self.chamber_set_c,
                self.gyro_c[AXES.index(each.axis[0])] if each.sensor == "gyro" else self.case_c,
                each.name,
                each.axis,
                float(value * each.per_si),
                float(sigma * each.per_si),
                each.unit,
                self.finding or ("" if np.isfinite(value) else NOT_OBSERVABLE),
            )
            for each, value, sigma in zip(COEFFICIENTS, values, sigmas, strict=True)
        ]


@dataclass(frozen=True, eq=False)
class RotatedDwell:
    """Increments of one dwell with rotations, in pieces without a gap, and its temperatures."""

    pieces: list[tuple[IncrementRecording, list[Rest]]]
    gyro_c: Triple
    case_c: float


def measure_rotations(marks: DwellMarks, frames: FrameBlock, setup: MeasurementSetup) -> RotatedDwell:
    """Increments between the first and the last rest of a dwell.

    Raises MeasurementError if what the INS sent can't be used.
    """
    navigation = checked_navigation(marks, frames, setup, [])
    first, end = marks.windows[0].first_frame, marks.windows[-1].end_frame
    temperatures = dwell_temperatures(navigation, first, end)
    increments = setup.decode_increments(frames)
    has_force = increments is not None and len(increments.row) > 0
    if increments is None or not has_force:
        increments = navigated_increments(navigation, setup.site)
    inside = (increments.row >= first) & (increments.row < end)
    edges = np.flatnonzero(inside & ~increments.follows)
    places = np.flatnonzero(inside)
    bounds = np.unique([places[0], *edges, places[-1] + 1]) if len(places) else np.zeros(1, np.int64)
    pieces = []
    for begin, stop in itertools.pairwise(bounds.tolist()):
        part = slice(begin, stop)
        rests = [
            Rest(*np.searchsorted(increments.row[part], [mark.first_frame, mark.end_frame]).tolist())
            for mark in marks.windows
        ]
        rests = [rest for rest in rests if rest.end > rest.begin]
        if sum(rest.end - rest.begin for rest in rests) * increments.interval_s < MIN_REST_TOTAL_S:
            continue
        recording = IncrementRecording(
            increments.interval_s, increments.angle[part], increments.velocity[part], has_vertical=has_force
        )
        pieces.append((recording, rests))
    return RotatedDwell(pieces, temperatures.gyro_c, temperatures.case_c)


def navigated_increments(navigation: NavigationData, site: Site) -> Increments:
    """What the sensors of an INS measured from epoch to epoch, by its attitude and velocity.

    The navigation frame turns with the Earth and with the velocity that the INS computes; to that belong the
    Coriolis acceleration and, in place of the vertical specific force, gravity.
    """
    time_s, C_nb = navigation.ins_time_s, navigation.attitude
    velocity = navigation.velocity_enu_mps[:, :2]
    interval_s = float(np.median(np.diff(time_s)))
    east, north = (0.5 * (velocity[1:] + velocity[:-1])).T
    meridian, across = curvature_radii(site.latitude, site.height)
    transport = np.stack([-north / meridian, east / across, east * np.tan(site.latitude) / across], axis=-1)
    # Where the INS takes itself to be: in hours its drift changes the Earth's rate that it subtracts.
    latitude = site.latitude + np.cumsum(north) * interval_s / meridian
    earth = EARTH_RATE * np.stack([np.zeros_like(latitude), np.cos(latitude), np.sin(latitude)], axis=-1)
    turned, half = (rotation_matrices(part * (earth + transport) * interval_s) for part in (1.0, 0.5))
    angle = rotation_vectors(C_nb[:-1].transpose(0, 2, 1) @ turned @ C_nb[1:])
    force = np.zeros((len(angle), 3))
    force[:, :2] = np.diff(velocity, axis=0) / interval_s
    moving = np.stack([east, north, np.zeros_like(east)], axis=-1)
    force += np.cross(2.0 * earth + transport, moving)
    force[:, 2] = site.gravity
    in_body = np.einsum("nji,njk,nk->ni", C_nb[:-1], half, force * interval_s)
    turning = np.cross(angle, in_body)
    total = in_body - 0.5 * turning + np.cross(angle, turning) / 6.0
    steady = np.abs(np.diff(time_s) / interval_s - 1.0) < _MAX_STEP - 1.0
    follows = steady & np.concatenate([[False], steady[:-1]])
    return Increments(navigation.row[1:], angle, total, follows, interval_s)


def calibrate_plateau(
    plateau: int, dwells: Sequence[tuple[DwellMarks, FrameBlock]], setup: MeasurementSetup
) -> PlateauCalibration:
    """Coefficients from all dwells with rotations at one plateau."""
    marks = dwells[0][0]
    measured: list[RotatedDwell] = []
    nothing = math.nan
    gyro_c, case_c, finding = (nothing, nothing, nothing), nothing, ""
    values, covariance = np.zeros(COUNT), np.eye(COUNT)
    is_observed, fit, has_force = np.zeros(COUNT, bool), None, False
    try:
        measured = [measure_rotations(*each, setup) for each in dwells]
        temperatures = np.array([(*each.gyro_c, each.case_c) for each in measured])
        *gyro, case_c = temperatures.mean(axis=0).tolist()
        gyro_c = (gyro[0], gyro[1], gyro[2])
        if np.ptp(temperatures, axis=0).max() > 2.0 * MAX_FROM_MEAN_K:
            raise MeasurementError("the temperature of the unit changed by more than 10 K between dwells")
        recordings = [recording for each in measured for recording, _ in each.pieces]
        rests = [stretches for each in measured for _, stretches in each.pieces]
        if not recordings:
            raise MeasurementError("too many increments are missing. Check the CAN bus")
        has_force = all(recording.has_vertical for recording in recordings)
        found = calibrate(recordings, setup.site, _options(setup), rests)
        values, covariance, is_observed, fit = found.values, found.covariance, found.is_observed, found.fit
    except MeasurementError as error:
        finding = str(error)
    return PlateauCalibration(
        plateau,
        marks.cycle,
        nothing if marks.chamber_set_c is None else marks.chamber_set_c,
        gyro_c,
        case_c,
        values,
        covariance,
        is_observed,
        has_force,
        fit,
        finding,
    )


def calibrate_plateaus(
    dwells: Iterator[tuple[DwellMarks, FrameBlock]], setup: MeasurementSetup
) -> list[PlateauCalibration]:
    """Coefficients plateau by plateau; ``dwells``: those with rotations, in the order of time."""
    groups = itertools.groupby(dwells, lambda each: (each[0].run, each[0].cycle, each[0].chamber_set_c))
    return [calibrate_plateau(number, list(group), setup) for number, (_, group) in enumerate(groups, 1)]


def _options(setup: MeasurementSetup) -> CalibrationOptions:
    noise = setup.noise
    walks = None if noise is None else (noise.angle_random_walk, noise.velocity_random_walk)
    return CalibrationOptions(whole_turns=setup.table_repeatability, walks=walks)
