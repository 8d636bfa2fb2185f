"""Calibration check: biases from alignments and navigations, beside the calibrated ones."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from gyrobench.bench.bias.dwell_table import DwellRow
from gyrobench.bench.bias.plateaus import MAX_FROM_MEAN_K, group_plateaus
from gyrobench.bench.dwells.calibration_check_bias import (
    AxisBias,
    KnownAccelerometers,
    bias_from_alignments,
    bias_from_velocity,
    bias_from_velocity_slope,
)
from gyrobench.bench.dwells.check_dwell import CheckDwell
from gyrobench.bench.dwells.earlier_calibration import EarlierCalibration
from gyrobench.bench.dwells.measurement_setup import MeasurementSetup
from gyrobench.bench.foundations.arrays import UG_TO_MPS2, FloatArray, Triple
from gyrobench.bench.foundations.text import flag_text
from gyrobench.bench.navigation.positions import AXES, POSITIONS, half_turn_pairs
from gyrobench.bench.runs.marks import DwellMarks
from gyrobench.bench.runs.tables.calibration_check_table import CalibrationCheckRow

_EAST, _NORTH = np.eye(3)[:2]
#: A gyro points East or North if it is no farther away than this.
_MAX_ANGLE_DEG = 1.0


def calibration_check_rows(
    dwells: Sequence[CheckDwell], calibration: Sequence[DwellRow], setup: MeasurementSetup
) -> list[CalibrationCheckRow]:
    """Biases that a calibration check measures, beside the calibrated ones.

    Each navigation gives the gyro along North; two alignments half a turn apart, in one position and
    on one plateau, give the gyro along East. A bias that is not observable is a row with the reason.

    Parameters
    ----------
    dwells : sequence of CheckDwell
        In any order.
    calibration : sequence of DwellRow
        Of this run or another one; rows of other units are passed over. Without any there is
        nothing to compare with, and the accelerometers are not known.
    setup : MeasurementSetup
        As for the dwells.
    """
    calibrations = {
        unit: EarlierCalibration((row for row in calibration if row.unit == unit), setup.prior)
        for unit in {each.marks.unit for each in dwells}
    }
    rows = [_velocity_row(each, calibrations[each.marks.unit], setup) for each in dwells]
    for plateau in group_plateaus(sorted(dwells, key=lambda dwell: dwell.dwell)):
        for first, second in half_turn_pairs(plateau, lambda each: each.marks.azimuth_deg, _are_comparable):
            rows.append(_alignment_row(first, second, calibrations[first.marks.unit], setup))
    return sorted(rows, key=lambda row: (row.dwell, row.method))


def _velocity_row(
    each: CheckDwell, calibration: EarlierCalibration, setup: MeasurementSetup
) -> CalibrationCheckRow:
    row = _empty_row(each.marks, "velocity", _NORTH, each.flags)
    if each.navigation is None:
        return row
    dwell, noise = each.navigation.dwell, each.navigation.noise
    gyro_c = each.temperatures.gyro_c
    known = calibration.accelerometers(row.position, gyro_c)
    bias = bias_from_velocity(dwell, each.marks.align_s, setup.site, noise, setup.prior, known)
    slope = bias_from_velocity_slope(dwell, setup.site, noise, known)
    return _compared(row, gyro_c, bias, slope, known, calibration)


def _alignment_row(
    first: CheckDwell, second: CheckDwell | None, calibration: EarlierCalibration, setup: MeasurementSetup
) -> CalibrationCheckRow:
    if second is None:
        opposite_deg = (first.marks.azimuth_deg + 180.0) % 360.0
        alone = f"no alignment at azimuth {opposite_deg:g} deg: a single one contains the table's error too"
        return _empty_row(first.marks, "alignment", _EAST, (*first.flags, alone))
    flags = [f"dwell {each.dwell}: {flag_text(each.flags)}" for each in (first, second) if each.flags]
    row = replace(_empty_row(first.marks, "alignment", _EAST, flags), turned_dwell=second.marks.dwell)
    if first.navigation is None or second.navigation is None:
        return row
    x, y, z = np.mean([first.aligning_c, second.aligning_c], axis=0).tolist()
    known = calibration.accelerometers(row.position, (x, y, z))
    bias = bias_from_alignments(
        first.navigation.dwell,
        second.navigation.dwell,
        min(first.marks.align_s, second.marks.align_s),
        setup.site,
        first.navigation.noise,
        setup.prior,
        known,
    )
    return _compared(row, (x, y, z), bias, None, known, calibration)


def _are_comparable(one: CheckDwell, other: CheckDwell) -> bool:
    is_same = (one.marks.unit, one.marks.position) == (other.marks.unit, other.marks.position)
    apart_k = np.abs(np.subtract(one.aligning_c, other.aligning_c))  # NaN where there are no data
    return is_same and not (apart_k > MAX_FROM_MEAN_K).any()


def _empty_row(
    marks: DwellMarks, method: str, direction: FloatArray, flags: Sequence[str]
) -> CalibrationCheckRow:
    along = POSITIONS[marks.position].C_nb(math.radians(marks.azimuth_deg)).T @ direction
    return CalibrationCheckRow(
        unit=marks.unit,
        run=marks.run,
        dwell=marks.dwell,
        turned_dwell=None,
        cycle=marks.cycle,
        position=marks.position,
        azimuth_deg=marks.azimuth_deg,
        gyro=AXES[int(np.argmax(np.abs(along)))],
        method=method,
        flags=tuple(flags),
    )


def _compared(
    row: CalibrationCheckRow,
    gyro_c: Triple,
    bias: AxisBias,
    slope: AxisBias | None,
    known: KnownAccelerometers,
    calibration: EarlierCalibration,
) -> CalibrationCheckRow:
    """Fill in the bias of the gyro and hold it against the calibrated one."""
    axis = AXES.index(row.gyro)
    along = bias.direction[axis]
    if (angle_deg := math.degrees(math.acos(min(abs(along), 1.0)))) > _MAX_ANGLE_DEG:
        oblique = f"the {row.gyro} gyro is {angle_deg:.0f} deg off: check at azimuth 0, 90, 180 or 270 deg"
        return replace(row, flags=(*row.flags, oblique))
    sign = math.copysign(1.0, along)
    row = replace(
        row,
        temperature_c=gyro_c[axis],
        bias_dph=sign * bias.bias_dph,
        sigma_dph=bias.sigma_dph,
        paper_bias_dph=sign * slope.bias_dph if slope else math.nan,
        paper_sigma_dph=slope.sigma_dph if slope else math.nan,
        accelerometer_ug=float(known.bias[axis] / UG_TO_MPS2),
        accelerometer_sigma_ug=float(known.sigma[axis] / UG_TO_MPS2),
    )
    calibrated = calibration.gyro_dph(row.position, axis, row.temperature_c)
    return _with_difference(row, *calibrated) if calibrated else row


def _with_difference(
    row: CalibrationCheckRow, calibrated_dph: float, sigma_dph: float
) -> CalibrationCheckRow:
    """Row with the calibrated bias; what has flags is not judged."""
    row = replace(row, calibrated_dph=calibrated_dph, calibrated_sigma_dph=sigma_dph)
    if row.flags:
        return row
    difference, both = row.bias_dph - calibrated_dph, math.hypot(row.sigma_dph, sigma_dph)
    p_value = math.erfc(abs(difference) / both / math.sqrt(2.0))
    return replace(row, difference_dph=difference, difference_sigma_dph=both, p_value=p_value)
