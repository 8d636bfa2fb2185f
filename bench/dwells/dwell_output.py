"""Decodes the INS's output of a dwell, checks it against the signal map, and cuts it into windows at rest."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from gyrobench.bench.bias.dwell import Dwell, NavigationWindow, RestOutput
from gyrobench.bench.bias.noise_model import NoiseModel
from gyrobench.bench.dwells.clock_check import clock_fault
from gyrobench.bench.dwells.measurement_setup import MeasurementSetup
from gyrobench.bench.dwells.setup_check import latitude_fault
from gyrobench.bench.dwells.temperatures import temperatures_at, valid_temperatures
from gyrobench.bench.foundations.arrays import ARCSEC_TO_RAD, FloatArray
from gyrobench.bench.foundations.errors import MeasurementError, SignalMapError
from gyrobench.bench.foundations.text import flag_text
from gyrobench.bench.navigation.attitude import angle_between, rotation_matrices, rotation_vectors
from gyrobench.bench.runs.marks import DwellMarks, WindowMark
from gyrobench.drivers.frames import FrameBlock
from gyrobench.drivers.ins.navigation_data import NavigationData
from gyrobench.drivers.ins.readout import InsMode

#: Difference between the turns of INS and table: angle, rad, and standard uncertainties of the scale factor.
_MAX_TURN_ERROR, _TURN_SIGMAS = math.radians(0.05), 5.0
#: Time over which the velocity at the edge of a window is fitted, s, and share of the output's noise that
#: remains; velocity at the start of navigation, m/s, and in standard uncertainties of its noise; largest
#: change in a turn as a multiple of that, and as a share of what the acceleration before makes in that time.
_EDGE_S, _EDGE_NOISE, _START_MPS, _START_SIGMAS = 30.0, 0.6, 1e-3, 5.0
_MAX_CHANGE, _MAX_CHANGE_SHARE = 2.0, 0.5
#: Smallest turn that shows the scale factors of gyros, and standard uncertainty of the table's angle beyond
#: its repeatability, rad.
_MIN_TURN, _TABLE_ACCURACY = math.radians(30.0), 5.0 * ARCSEC_TO_RAD
_LEVI_CIVITA = -np.cross(np.eye(3)[:, np.newaxis], np.eye(3))

#: In each message of :func:`turn_fault`.
ALIGNED_AGAIN = "the INS aligned again"


def decode_dwell(
    marks: DwellMarks, frames: FrameBlock, setup: MeasurementSetup
) -> tuple[NavigationData, list[str]]:
    """Decode a dwell; returns its navigation data and flags for faulty frames and temperature sensors.

    Raises MeasurementError if the dwell has no window.
    """
    if not marks.windows:
        raise MeasurementError("the INS never navigated at rest in this dwell")
    navigation, sensor_flags = valid_temperatures(setup.decode(frames), *marks.span)
    flags = list(sensor_flags)
    if navigation.counts.contradicted:
        flags.append(
            f"{navigation.counts.contradicted} frames of the INS contradict those of the same epoch: does a "
            "second node send with its identifiers? Check the bus"
        )
    return navigation, flags


def check_signal_map(
    marks: DwellMarks, frames: FrameBlock, navigation: NavigationData, setup: MeasurementSetup
) -> bool:
    """Check latitude, clock, signs and axes; returns whether signs and axes of the velocities were tested.

    Raises SignalMapError if the dwell contradicts the signal map or the latitude, MeasurementError if that
    may be due to a jump of the output.
    """
    if fault := latitude_fault(navigation.latitude, setup.site):
        raise SignalMapError(fault)
    inside = navigation.between(*marks.span)
    times = (navigation.ins_time_s[inside], navigation.timestamp_s[inside], navigation.segment[inside])
    if setup.signals and (fault := clock_fault(*times, setup.signals)):
        raise SignalMapError(fault)
    try:
        return setup.signs is not None and setup.signs.check(marks, frames, navigation)
    except SignalMapError:
        # A jump of the output separates tilt and velocity just as a wrong sign does.
        windows = _windows(marks, navigation)
        faults = setup.output_faults(windows, setup.noise_in(windows))
        if jumps := [fault.text for fault in faults if not fault.may_be_noise]:
            raise MeasurementError(flag_text(jumps)) from None
        raise


def dwell_at_rest(marks: DwellMarks, navigation: NavigationData, setup: MeasurementSetup) -> Dwell:
    """Navigation in the windows of a dwell, with the attitude of the table.

    Raises MeasurementError if the INS was not navigating all the time, restarted, or sent unusable data.
    """
    _check_navigating(navigation, navigation.between(*marks.span))
    return Dwell(
        position_name=marks.position,
        azimuth_rad=math.radians(marks.azimuth_deg),
        windows=_windows(marks, navigation),
        C_nb_table=tuple(setup.table.attitude(mark.outer_deg, mark.inner_deg) for mark in marks.windows),
        turns=tuple(setup.turn(*pair, navigation) for pair in itertools.pairwise(marks.windows)),
    )


def turn_fault(dwell: Dwell, setup: MeasurementSetup, noise: NoiseModel) -> str:
    """Message that the INS turned by another angle than the table, or aligned again; empty if it did not.

    The angle of a rotation does not depend on the axes, so mounting, azimuth and tilt of the table have no
    effect. An INS that aligns again changes its heading error by twice the bias East over the Earth rate, and
    starts at rest.
    """
    for number, turn in enumerate(_turns(dwell), 2):
        table, ins = (angle_between(rotation, np.eye(3)) for rotation in (turn.table, turn.ins))
        limit = (
            _MAX_TURN_ERROR
            + _TURN_SIGMAS * setup.prior.gyro_scale_factor * table
            + turn.drift
            + 2.0 * setup.heading_lsb_rad
        )
        if abs(ins - table) > limit:
            return (
                f"before window {number} the INS turned by {math.degrees(ins):.3f} deg, the table by "
                f"{math.degrees(table):.3f} deg: {ALIGNED_AGAIN} or corrected its heading, the unit slipped "
                f"on the table, or scale factors of gyros are {1e6 * abs(ins - table) / table:.0f} ppm off. "
                "Switch its corrections off, check its screws, and calibrate the gyros by rotations"
            )
        if lost_mps := _lost_velocity(dwell.windows[number - 2], dwell.windows[number - 1], noise):
            return (
                f"window {number} begins with a velocity of zero, after {1e3 * lost_mps:.2g} mm/s at the end "
                f"of the one before: {ALIGNED_AGAIN} or corrected its velocity. Switch its corrections off"
            )
    return ""


def turn_angles(dwell: Dwell, setup: MeasurementSetup, noise: NoiseModel) -> tuple[FloatArray, FloatArray]:
    """Evidence of the turns on the errors of the gyros' matrix: white rows (n, 9) and data (n,).

    Each is the angle by which the INS turned further than the table about the table's axis of rotation.
    """
    rows, data = [], []
    for path, turn in zip(dwell.turns, _turns(dwell), strict=False):
        if angle_between(turn.table, np.eye(3)) < _MIN_TURN:
            continue
        axis, ins_axis = _axis(turn.table), _axis(turn.ins)
        ins_axis *= math.copysign(1.0, axis @ ins_axis)
        excess = _angle_about(turn.ins, ins_axis) - _angle_about(turn.table, axis)
        steps = rotation_vectors(path.C_nb[:-1].transpose(0, 2, 1) @ path.C_nb[1:])
        middle = path.C_nb[:-1] @ rotation_matrices(0.5 * steps)
        sigma = math.hypot(
            _TABLE_ACCURACY,
            math.sqrt(2.0) * setup.table_repeatability,
            setup.prior.tilt_step,
            noise.angle_random_walk * math.sqrt(turn.gap_s),
            math.sqrt(2.0) * noise.heading_white,
            turn.drift,
        )
        rows.append(np.einsum("kij,i,kl->jl", middle, axis, steps).ravel() / sigma)
        data.append(math.remainder(excess, math.tau) / sigma)
    return np.reshape(rows, (-1, 9)), np.array(data)


class _Turn(NamedTuple):
    """Rotations (3, 3) of table and INS from the end of a window to the begin of the next."""

    table: FloatArray
    ins: FloatArray
    gap_s: float  #: Time between the windows.
    drift: float  #: Angle in that time at the rate at which the attitude changed in the earlier window, rad.


def _turns(dwell: Dwell) -> Iterator[_Turn]:
    pairs = zip(itertools.pairwise(dwell.C_nb_table), itertools.pairwise(dwell.windows), strict=True)
    for (before, after), (earlier, later) in pairs:
        gap_s = float(later.time_s[0] - earlier.time_s[-1])
        drift = angle_between(earlier.C_nb[-1], earlier.C_nb[0]) / earlier.duration_s * gap_s
        yield _Turn(after @ before.T, later.C_nb[0] @ earlier.C_nb[-1].T, gap_s, drift)


def _axis(rotation: FloatArray) -> FloatArray:
    """Axis (3,) of a rotation (3, 3), also of half a turn; its sign is arbitrary."""
    return np.asarray(np.linalg.eigh(rotation + rotation.T)[1][:, -1])


def _angle_about(rotation: FloatArray, axis: FloatArray) -> float:
    """Angle of a rotation (3, 3) about its axis, rad."""
    sine = 0.5 * float(np.einsum("ij,ijk,k->", rotation, _LEVI_CIVITA, axis))
    return math.atan2(sine, 0.5 * (float(np.trace(rotation)) - 1.0))


def _lost_velocity(earlier: NavigationWindow, later: NavigationWindow, noise: NoiseModel) -> float:
    """Velocity, m/s, that an INS had before it started again at rest; 0 if it did not.

    By chance velocity and acceleration East and North are hardly ever all zero after a turn, and the velocity
    before must differ by more than a turn explains.
    """
    gap_s = later.time_s[0] - earlier.time_s[-1]
    (before_mps, before_mps2), (after_mps, after_mps2) = (
        _velocity_at_edge(earlier, -1),
        _velocity_at_edge(later, 0),
    )
    rest_mps = _START_MPS + _START_SIGMAS * (
        _EDGE_NOISE * noise.velocity_white + noise.velocity_random_walk * math.sqrt(gap_s)
    )
    if max(np.abs(after_mps).max(), gap_s * np.abs(after_mps2).max()) > rest_mps:
        return 0.0
    lost_mps = float(np.linalg.norm(before_mps))
    explained_mps = _MAX_CHANGE * rest_mps + _MAX_CHANGE_SHARE * gap_s * float(np.linalg.norm(before_mps2))
    return lost_mps if lost_mps > explained_mps else 0.0


def _velocity_at_edge(window: NavigationWindow, index: int) -> tuple[FloatArray, FloatArray]:
    """Velocity East and North (2,), and its rate, at the first or last epoch of a window."""
    since_s = window.time_s - window.time_s[index]
    near = np.abs(since_s) <= _EDGE_S
    slope, constant = np.polyfit(since_s[near], window.velocity_enu_mps[near, :2], 1)
    return constant, slope


def _windows(marks: DwellMarks, navigation: NavigationData) -> tuple[NavigationWindow, ...]:
    return tuple(rest_output(navigation, mark).as_window() for mark in marks.windows)


def rest_output(navigation: NavigationData, mark: WindowMark) -> RestOutput:
    """Output in one window.

    The temperatures are those of :func:`gyrobench.bench.dwells.temperatures.temperatures_at`.
    Raises MeasurementError if the INS was not navigating all the time, or restarted.
    """
    inside = navigation.between(mark.first_frame, mark.end_frame)
    _check_navigating(navigation, inside)
    time_s = navigation.ins_time_s[inside]
    velocity = navigation.velocity_enu_mps[inside].copy()
    velocity[:, 2] = np.nan_to_num(velocity[:, 2])  # not every INS sends it, and no estimate needs it
    temperatures = temperatures_at(time_s, navigation.temperatures)
    return RestOutput(time_s, velocity, navigation.attitude[inside], *temperatures)


def _check_navigating(navigation: NavigationData, inside: slice) -> None:
    """Raise MeasurementError unless the INS navigated without a break, in the turns as well.

    An INS that realigns in a turn continues with different errors.
    """
    if not np.isin(navigation.mode[inside], (InsMode.NAVIGATE, InsMode.UNKNOWN)).all():
        raise MeasurementError(
            "the INS left navigation during the dwell or its turn. Check its status in the raw CAN log"
        )
    if len(np.unique(navigation.alignment[inside])) > 1:
        raise MeasurementError(
            "the INS reported another alignment during the dwell or its turn. Did it realign?"
        )
    if len(np.unique(navigation.segment[inside])) > 1:
        raise MeasurementError("the clock of the INS was reset during the dwell. Did it restart?")
    if not np.isfinite(navigation.attitude[inside]).all():
        raise MeasurementError(
            "the INS reported an invalid attitude during the dwell or its turn. Did it realign?"
        )
