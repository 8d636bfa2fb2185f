"""Increments of a dwell with rotations: as the INS sent them, or from its navigation output.

The change of attitude and velocity from epoch to epoch gives the increments of the sensors, except the
vertical specific force, which an INS of fixed altitude does not output. Gravity replaces it, which adds no
information.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from gyrobench.bench.calibration.increment_recording import MIN_REST_TOTAL_S, IncrementRecording, Rest
from gyrobench.bench.dwells.clock_check import increments_fault
from gyrobench.bench.dwells.dwell_output import check_signal_map, decode_dwell, rest_output
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
#: Largest deviation of the time between two epochs from the median, as a share of it.
_MAX_STEP_ERROR = 0.5
#: Smallest sum of increments, rad or m/s, that is compared with attitude and velocity; largest deviation as a
#: share of the sum, with and without missing samples; and largest rotation between two epochs, rad. Sensors
#: of an INS have errors far below a hundredth before their calibration, and wrong units are larger.
_MIN_SUM, _MAX_DEVIATION_IN_GAPS, _MAX_DEVIATION, _MAX_ROTATION = 0.5, 0.5, 0.015, 2.0
#: Shortest time between the epochs of that comparison, s.
_CHECK_INTERVAL_S = 0.2


@dataclass(frozen=True, eq=False)
class RotatedDwell:
    """Increments and temperatures measured in a dwell with rotations."""

    marks: DwellMarks
    pieces: list[IncrementRecording]  #: Recordings without a gap.
    gyro_c: Triple  #: Mean temperatures of the gyros; NaN if not measured.
    gyro_rate_c_per_h: Triple  #: Slopes of the gyro temperatures.
    case_c: float  #: Mean temperature of the case; NaN if not measured.

    @property
    def range_c(self) -> FloatArray:
        """Lowest and highest temperatures (2, 4) of gyros and case."""
        change_c = np.abs(self.gyro_rate_c_per_h) * (self.marks.end_s - self.marks.start_s) / 3600.0
        half = 0.5 * np.array([*change_c, 0.0])
        middle_c = np.array([*self.gyro_c, self.case_c])
        return np.array([middle_c - half, middle_c + half])


def measure_rotations(marks: DwellMarks, frames: FrameBlock, setup: MeasurementSetup) -> RotatedDwell:
    """Increments and temperatures of a dwell with rotations.

    Raises MeasurementError if the output of the INS can't be used.
    """
    navigation, _ = decode_dwell(marks, frames, setup)
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
                # The attitude of the table read at a rest applies until the end of the rest.
                table_from=np.array([0, *(end for _, end in ends[:-1])]),
                rounding=(0.0, 0.0) if is_sent else (angle_rounding, velocity_rounding),
                given_rests=rests,
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
        return increments_from_navigation(navigation, setup.site), False
    inside = slice(*np.searchsorted(sent.row, marks.span))
    arrival_s = frames.timestamp_s[sent.row[inside]]
    if fault := increments_fault(sent.sent[:, inside], arrival_s, sent.interval_s):
        raise SignalMapError(fault)
    _check_axes(sent, increments_from_navigation(navigation, setup.site, _CHECK_INTERVAL_S), marks)
    return sent, True


def _check_axes(sent: Increments, navigated: Increments, marks: DwellMarks) -> None:
    """Raise MeasurementError if increments have other axes, signs or units than attitude and velocity.

    Without this test, coefficients would fit increments whose axes are exchanged in angle and velocity alike.
    """
    rests = [(each.first_frame, each.end_frame) for each in marks.windows]
    turns = [(before[1], after[0]) for before, after in itertools.pairwise(rests)]
    for name, spans in (("velocity", rests), ("angle", turns)):
        for span in spans:
            parts = [slice(*np.searchsorted(each.row, span)) for each in (sent, navigated)]
            sent_sum, navigated_sum = (
                getattr(each, name)[part].sum(axis=0)
                for each, part in zip((sent, navigated), parts, strict=True)
            )
            if name == "velocity":  # constant at rest, so that missing samples and the ends do not matter
                sent_s, navigated_s = (
                    (part.stop - part.start) * each.interval_s
                    for each, part in zip((sent, navigated), parts, strict=True)
                )
                navigated_sum *= sent_s / max(navigated_s, navigated.interval_s)
            is_complete = name == "velocity" or sent.is_consecutive[parts[0]].all()
            limit = _MAX_DEVIATION if is_complete else _MAX_DEVIATION_IN_GAPS
            max_rate = np.linalg.norm(sent.angle[parts[0]], axis=1).max(initial=0.0) / sent.interval_s
            if name == "angle" and max_rate * navigated.interval_s > _MAX_ROTATION:
                continue  # attitudes do not determine so large a rotation between two epochs
            size = np.linalg.norm(navigated_sum)
            if size > _MIN_SUM and np.linalg.norm(sent_sum - navigated_sum) > limit * size:
                raise MeasurementError(
                    f"the {name} increments add up to {_triple_text(sent_sum)}, by attitude and velocity "
                    f"{_triple_text(navigated_sum)}. Check axes, signs and units of ins.signals.increments"
                )


def _triple_text(values: FloatArray) -> str:
    return "({:.4g}, {:.4g}, {:.4g})".format(*values)


def increments_from_navigation(
    navigation: NavigationData, site: Site, min_interval_s: float = 0.0
) -> Increments:
    """Increments of the sensors of an INS from epoch to epoch, from its attitude and velocity.

    ``min_interval_s``: epochs are thinned to about this interval, s. The navigation frame rotates with the
    Earth and with the velocity that the INS computes, hence the Coriolis acceleration. Gravity replaces the
    vertical specific force.
    """
    every_nth = slice(
        None, None, max(1, int(min_interval_s / np.median(np.diff(navigation.ins_time_s)) + 1e-6))
    )
    time_s, velocity = navigation.ins_time_s[every_nth], navigation.velocity_enu_mps[every_nth, :2]
    row, attitude = navigation.row[every_nth], navigation.attitude[every_nth]
    interval_s = float(np.median(np.diff(time_s)))
    north = 0.5 * (velocity[1:, 1] + velocity[:-1, 1])
    # Latitude that the INS computes: over hours its drift changes the Earth rate that the INS subtracts.
    latitude = site.latitude + np.cumsum(north) * interval_s / curvature_radii(site.latitude, site.height)[0]
    parts = [
        _body_increments(
            attitude[begin:end], velocity[begin:end], latitude[begin : end - 1], interval_s, site
        )
        for begin in range(0, max(len(latitude), 1), _BLOCK)
        for end in [begin + _BLOCK + 1]
    ]
    angle, velocity_change = (np.concatenate(each) for each in zip(*parts, strict=True))
    # Rotation vectors and velocities contain coning and sculling; increments of sensors do not.
    before = np.maximum(np.arange(len(angle)) - 1, 0)
    coning = np.cross(angle[before], angle) / 12.0
    sculling = (np.cross(angle[before], velocity_change) + np.cross(velocity_change[before], angle)) / 12.0
    is_regular = np.abs(np.diff(time_s) / interval_s - 1.0) < _MAX_STEP_ERROR
    return Increments(
        row=row[1:],
        angle=angle - coning,
        velocity=velocity_change - sculling,
        is_consecutive=is_regular,
        interval_s=interval_s,
        sent=np.tile(np.arange(len(angle), dtype=float), (2, 1)),
    )


def _body_increments(
    C_nb: FloatArray, velocity: FloatArray, latitude: FloatArray, interval_s: float, site: Site
) -> tuple[FloatArray, FloatArray]:
    """Rotation and change of velocity (n, 3) in body axes between n + 1 epochs; ``latitude`` (n,)."""
    east, north = (0.5 * (velocity[1:] + velocity[:-1])).T
    meridian, across = curvature_radii(site.latitude, site.height)
    transport = np.stack([-north / meridian, east / across, east * np.tan(site.latitude) / across], axis=-1)
    earth = EARTH_RATE * np.stack([np.zeros_like(latitude), np.cos(latitude), np.sin(latitude)], axis=-1)
    full, half = (rotation_matrices(part * (earth + transport) * interval_s) for part in (1.0, 0.5))
    angle = rotation_vectors(C_nb[:-1].transpose(0, 2, 1) @ full @ C_nb[1:])
    force = np.cross(2.0 * earth + transport, np.stack([east, north, np.zeros_like(east)], axis=-1))
    force[:, :2] += np.diff(velocity, axis=0) / interval_s
    force[:, 2] = site.gravity
    change = (C_nb[:-1].transpose(0, 2, 1) @ (half @ (force * interval_s)[:, :, np.newaxis]))[:, :, 0]
    rotation_term = np.cross(angle, change)
    return angle, change - 0.5 * rotation_term + np.cross(angle, rotation_term) / 12.0
