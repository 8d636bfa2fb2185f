"""Increments of a dwell with rotations: as the INS sent them, or from its navigation output.

The change of attitude and velocity from epoch to epoch is what its sensors measured, but for the vertical
specific force, which an INS of fixed altitude does not show. Gravity stands in its place, and shows nothing.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from gyrobench.bench.calibration.increment_recording import MIN_REST_TOTAL_S, IncrementRecording, Rest
from gyrobench.bench.dwells.clock_check import increments_fault
from gyrobench.bench.dwells.dwell_output import check_signal_map, decoded_navigation, rest_output
from gyrobench.bench.dwells.measurement_setup import MeasurementSetup
from gyrobench.bench.dwells.temperatures import dwell_temperatures
from gyrobench.bench.foundations.arrays import FloatArray, Triple
from gyrobench.bench.foundations.errors import MeasurementError, SignalMapError
from gyrobench.bench.navigation.attitude import rotation_matrices, rotation_vectors
from gyrobench.bench.navigation.earth import EARTH_RATE, curvature_radii
from gyrobench.bench.navigation.error_model import Site
from gyrobench.bench.runs.marks import DwellMarks
from gyrobench.drivers.frames import FrameBlock
from gyrobench.drivers.ins.navigation_data import Increments, NavigationData

#: Epochs whose matrices are in memory at once.
_BLOCK = 4096
#: Part of the usual interval by which the time between two epochs may differ from it.
_MAX_STEP_ERROR = 0.5
#: Sum, rad or m/s, from which increments are compared with attitude and velocity, by how much of it they may
#: differ, as by gaps, and largest angle between two attitudes, rad.
_MIN_TURN, _MAX_AWAY, _MAX_STEP = 0.5, 0.5, 2.0
#: Time between the epochs of that comparison, s, where the INS has no fewer.
_CHECKED_S = 0.2


@dataclass(frozen=True, eq=False)
class RotatedDwell:
    """What the INS measured in a dwell with rotations."""

    marks: DwellMarks
    pieces: list[IncrementRecording]  #: Increments without a gap.
    gyro_c: Triple  #: Mean temperatures of the gyros; NaN where not measured.
    gyro_rate_c_per_h: Triple  #: Their slopes.
    case_c: float  #: Mean temperature of the case; NaN where not measured.

    @property
    def range_c(self) -> FloatArray:
        """Lowest and highest temperatures (2, 4) of gyros and case."""
        change_c = np.abs(self.gyro_rate_c_per_h) * (self.marks.end_s - self.marks.start_s) / 3600.0
        half = 0.5 * np.array([*change_c, 0.0])
        middle_c = np.array([*self.gyro_c, self.case_c])
        return np.array([middle_c - half, middle_c + half])


def measure_rotations(marks: DwellMarks, frames: FrameBlock, setup: MeasurementSetup) -> RotatedDwell:
    """Increments and temperatures of a dwell.

    Raises MeasurementError if what the INS sent can't be used.
    """
    navigation, _ = decoded_navigation(marks, frames, setup)
    check_signal_map(marks, frames, navigation, setup)
    first, end = marks.span
    temperatures = dwell_temperatures(navigation, first, end)
    increments, is_sent = _increments(marks, frames, navigation, setup)
    at_rest = [] if is_sent else [rest_output(navigation, mark) for mark in marks.windows]
    velocity_rounding, angle_rounding = setup.rounding(at_rest)
    begin, stop = np.searchsorted(increments.row, [first, end])
    gaps = begin + 1 + np.flatnonzero(~increments.is_consecutive[begin + 1 : stop])
    table = np.array([setup.table.attitude(each.outer_deg, each.inner_deg) for each in marks.windows])
    pieces = []
    for part in itertools.starmap(slice, itertools.pairwise([begin, *gaps.tolist(), stop])):
        ends = [
            np.searchsorted(increments.row[part], [each.first_frame, each.end_frame])
            for each in marks.windows
        ]
        rests = tuple(Rest(int(a), int(b)) for a, b in ends if b > a)
        if sum(rest.end - rest.begin for rest in rests) * increments.interval_s >= MIN_REST_TOTAL_S:
            angle, velocity = increments.angle[part], increments.velocity[part]
            recording = IncrementRecording(
                increments.interval_s,
                angle,
                velocity,
                has_vertical=is_sent,
                table=table,
                # Up to the end of a rest the table stands as it was read there.
                table_from=np.array([0, *(end for _, end in ends[:-1])]),
                rounding=(0.0, 0.0) if is_sent else (angle_rounding, velocity_rounding),
                known_rests=rests,
            )
            pieces.append(recording)
    return RotatedDwell(
        marks, pieces, temperatures.gyro_c, temperatures.gyro_rate_c_per_h, temperatures.case_c
    )


def _increments(
    marks: DwellMarks, frames: FrameBlock, navigation: NavigationData, setup: MeasurementSetup
) -> tuple[Increments, bool]:
    """Increments as the INS sent them, else by its navigation output; and whether it sent them.

    Raises MeasurementError if they do not fit the signal map.
    """
    sent = setup.decode_increments(frames)
    if sent is None or not len(sent.row):
        return navigated_increments(navigation, setup.site), False
    inside = slice(*np.searchsorted(sent.row, marks.span))
    arrival_s = frames.timestamp_s[sent.row[inside]]
    if fault := increments_fault(sent.sent[:, inside], arrival_s, sent.interval_s):
        raise SignalMapError(fault)
    _check_axes(sent, navigated_increments(navigation, setup.site, _CHECKED_S), marks)
    return sent, True


def _check_axes(sent: Increments, navigated: Increments, marks: DwellMarks) -> None:
    """Raise MeasurementError if increments have other axes, signs or units than attitude and velocity.

    Coefficients of axes that are exchanged in angle and velocity alike fit the increments as well.
    """
    rests = [(each.first_frame, each.end_frame) for each in marks.windows]
    between = [(before[1], after[0]) for before, after in itertools.pairwise(rests)]
    for name, spans in (("velocity", rests), ("angle", between)):
        for span in spans:
            found, expected = (
                getattr(each, name)[slice(*np.searchsorted(each.row, span))].sum(axis=0)
                for each in (sent, navigated)
            )
            if name == "angle" and _fastest(sent, span) * navigated.interval_s > _MAX_STEP:
                continue  # further between two epochs than attitudes show
            away = np.linalg.norm(found - expected)
            if np.linalg.norm(expected) > _MIN_TURN and away > _MAX_AWAY * np.linalg.norm(expected):
                raise MeasurementError(
                    f"the {name} increments add up to {_triple_text(found)}, by attitude and velocity "
                    f"{_triple_text(expected)}. Check axes, signs and units of ins.signals.increments"
                )


def _fastest(sent: Increments, span: tuple[int, int]) -> float:
    """Largest rate, rad/s."""
    angle = sent.angle[slice(*np.searchsorted(sent.row, span))]
    return float(np.linalg.norm(angle, axis=1).max(initial=0.0)) / sent.interval_s


def _triple_text(values: FloatArray) -> str:
    return "({:.4g}, {:.4g}, {:.4g})".format(*values)


def navigated_increments(navigation: NavigationData, site: Site, least_s: float = 0.0) -> Increments:
    """What the sensors of an INS measured from epoch to epoch, by its attitude and velocity.

    With ``least_s`` epochs up to this time apart, s, count as one. The navigation frame turns with the Earth
    and with the velocity that the INS computes; to that belong the Coriolis acceleration and, in place of the
    vertical specific force, gravity.
    """
    some = slice(None, None, max(1, int(least_s / np.median(np.diff(navigation.ins_time_s)) + 1e-6)))
    time_s, velocity = navigation.ins_time_s[some], navigation.velocity_enu_mps[some, :2]
    row, attitude = navigation.row[some], navigation.attitude[some]
    interval_s = float(np.median(np.diff(time_s)))
    north = 0.5 * (velocity[1:, 1] + velocity[:-1, 1])
    # Where the INS takes itself to be: in hours its drift changes the Earth's rate that it subtracts.
    latitude = site.latitude + np.cumsum(north) * interval_s / curvature_radii(site.latitude, site.height)[0]
    parts = [
        _sums(attitude[begin:end], velocity[begin:end], latitude[begin : end - 1], interval_s, site)
        for begin in range(0, max(len(latitude), 1), _BLOCK)
        for end in [begin + _BLOCK + 1]
    ]
    angle, sums = (np.concatenate(each) for each in zip(*parts, strict=True))
    # Rotation vectors and velocities hold coning and sculling, which increments of sensors do not.
    last = np.maximum(np.arange(len(angle)) - 1, 0)
    coning = np.cross(angle[last], angle) / 12.0
    sculling = (np.cross(angle[last], sums) + np.cross(sums[last], angle)) / 12.0
    steady = np.abs(np.diff(time_s) / interval_s - 1.0) < _MAX_STEP_ERROR
    return Increments(
        row=row[1:],
        angle=angle - coning,
        velocity=sums - sculling,
        is_consecutive=steady,
        interval_s=interval_s,
        sent=np.tile(np.arange(len(angle), dtype=float), (2, 1)),
    )


def _sums(
    C_nb: FloatArray, velocity: FloatArray, latitude: FloatArray, interval_s: float, site: Site
) -> tuple[FloatArray, FloatArray]:
    """Turn and change of velocity (n, 3) in body axes between n + 1 epochs, latitude (n,)."""
    east, north = (0.5 * (velocity[1:] + velocity[:-1])).T
    meridian, across = curvature_radii(site.latitude, site.height)
    transport = np.stack([-north / meridian, east / across, east * np.tan(site.latitude) / across], axis=-1)
    earth = EARTH_RATE * np.stack([np.zeros_like(latitude), np.cos(latitude), np.sin(latitude)], axis=-1)
    turned, half = (rotation_matrices(part * (earth + transport) * interval_s) for part in (1.0, 0.5))
    angle = rotation_vectors(C_nb[:-1].transpose(0, 2, 1) @ turned @ C_nb[1:])
    force = np.cross(2.0 * earth + transport, np.stack([east, north, np.zeros_like(east)], axis=-1))
    force[:, :2] += np.diff(velocity, axis=0) / interval_s
    force[:, 2] = site.gravity
    in_body = (C_nb[:-1].transpose(0, 2, 1) @ (half @ (force * interval_s)[:, :, np.newaxis]))[:, :, 0]
    turning = np.cross(angle, in_body)
    return angle, in_body - 0.5 * turning + np.cross(angle, turning) / 12.0
