"""Recordings from the navigation output of a unit on a two-axis table, for all six positions or a list."""

from __future__ import annotations

from itertools import pairwise
from types import SimpleNamespace

import numpy as np

from gyrobench.bench.calibration.coefficients import COUNT, SensorErrors
from gyrobench.bench.calibration.increment_recording import IncrementRecording, Rest
from gyrobench.bench.dwells.rotated_dwell import increments_from_navigation
from gyrobench.bench.navigation.attitude import rotation_matrices
from gyrobench.bench.navigation.error_model import Site
from gyrobench.bench.navigation.positions import POSITIONS
from gyrobench.bench.navigation.table_axes import TwoAxisTable
from tests.adversarial.strapdown import ARCSEC, DPH, UG, Place, Schedule, Table, Unit, simulate

TABLE = TwoAxisTable(np.eye(3)[0], np.eye(3)[2], np.eye(3))
ARW_DEG, VRW_UG = 0.0006, 5.0
#: The table's axes as read lie 2 arcmin off North, and the unit 3 arcmin off the table.
OFF_NORTH = rotation_matrices(np.deg2rad([0.0, 0.0, 2.0 / 60.0]))
OFF_TABLE = rotation_matrices(np.deg2rad([0.03, -0.02, 0.04]))
WALKS = ARW_DEG * np.pi / 180.0 / 60.0, VRW_UG * UG


def any_unit(random):
    """A unit of navigation grade with small errors of all kinds but accelerometer scale factors."""
    return Unit(
        gyro_bias_dph=tuple(random.normal(0.0, 0.005, 3)),
        gyro_scale_ppm=tuple(random.normal(0.0, 10.0, 3)),
        gyro_misalignment_arcsec=tuple(random.normal(0.0, 5.0, 6)),
        accelerometer_bias_ug=tuple(random.normal(0.0, 30.0, 3)),
        accelerometer_misalignment_arcsec=tuple(random.normal(0.0, 5.0, 6)),
        angle_random_walk=ARW_DEG,
        velocity_random_walk=VRW_UG,
        velocity_output_mps=1e-3,
        attitude_output_arcsec=0.4,
    )


def truth(unit):
    """Coefficients (21,) of a unit, SI."""

    def matrix(diagonal, others):
        result = np.diag(np.asarray(diagonal, float))
        result[~np.eye(3, dtype=bool)] = np.array(others) * ARCSEC
        return result

    errors = SensorErrors(
        np.array(unit.gyro_bias_dph) * DPH,
        matrix(np.array(unit.gyro_scale_ppm) * 1e-6, unit.gyro_misalignment_arcsec),
        np.array(unit.accelerometer_bias_ug) * UG,
        matrix(np.zeros(3), unit.accelerometer_misalignment_arcsec),
    )
    assert len(errors.vector()) == COUNT
    return errors.vector()


def recording(unit, place, schedule, angles_deg, random):
    """One recording with its rests and the attitude of the table."""
    output = simulate(unit, place, schedule, angles_deg, random)
    site = Site(np.deg2rad(place.latitude_deg), place.height_m)
    navigation = SimpleNamespace(
        ins_time_s=output.time_s,
        attitude=output.C_nb,
        velocity_enu_mps=output.velocity_enu_mps,
        row=np.arange(len(output.time_s)),
    )
    found = increments_from_navigation(navigation, site)
    rests = tuple(Rest(begin, end - 1) for begin, end in output.windows)
    at_table = np.empty((len(found.angle), 3, 3))
    edges = [0, *(window[0] for window in output.windows[1:]), len(at_table)]
    for angles, (begin, end) in zip(angles_deg, pairwise(edges), strict=True):
        at_table[begin:end] = OFF_NORTH @ Table().attitude(*np.radians(angles)[:, np.newaxis])[0] @ OFF_TABLE
    return IncrementRecording(
        found.interval_s, found.angle, found.velocity, has_vertical=False, table=at_table, given_rests=rests
    )


def six_dwells(unit, latitude_deg, random):
    """Two windows of 10 min in each position, with a turn of 180 deg about Up between them."""
    return [recording(unit, Place(latitude_deg), *each, random) for each in six_schedules()]


def six_schedules():
    """Schedule and angles of each of the six dwells."""
    starts = [TABLE.angles(position.C_nb()) for position in POSITIONS.values()]
    return [(Schedule(), [start, TABLE.turn(start, 180.0)]) for start in starts]


def rotated(unit, latitude_deg, random, rotations):
    """The rests and rotations of a list, all in one navigation."""
    return [recording(unit, Place(latitude_deg), *rotated_schedule(rotations), random)]


def rotated_schedule(rotations):
    """Schedule and angles of a list of rotations."""
    angles = [TABLE.angles(POSITIONS[rotations.start].C_nb())]
    for each in rotations.rotations:
        outer, inner = angles[-1]
        is_outer = each.axis == "outer"
        angles.append((outer + each.angle_deg, inner) if is_outer else (outer, inner + each.angle_deg))
    return Schedule(window_s=rotations.dwell_s, turn_s=10.0), angles
