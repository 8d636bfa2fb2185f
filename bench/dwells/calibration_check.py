"""Calibration check: measures biases by alignments and navigations, and compares them with calibrated ones.

An INS that has levelled and gyrocompassed starts with attitude errors due to its own sensors: tilts that
cancel the accelerometer biases, and a heading error for which the Earth's rotation cancels the bias of the
East gyro. Therefore the heading after alignment measures the East gyro, and the velocity East of the
navigation that follows measures the North gyro. An accelerometer bias ``a`` along the same axis is not
separable from the gyro's here: both methods give ``b - (W_U / g) a``, 0.9e-3 deg/h for 100 ug at middle
latitudes. The calibrated value of ``a`` is taken into account.

References
----------
Yu et al., "The Six-Position Calibration Technique of Gyro Bias for Rotational Inertial
Navigation System Based on Ring Laser Gyroscope", section 5: names the two methods, without details of their
evaluation.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from gyrobench.bench.bias import parameters
from gyrobench.bench.bias.bias_filter import BiasFilter
from gyrobench.bench.bias.dwell import Dwell
from gyrobench.bench.bias.dwell_table import DwellRow
from gyrobench.bench.bias.paper import TURN_TOLERANCE, PolynomialTrend
from gyrobench.bench.bias.parameters import ErrorModel
from gyrobench.bench.bias.plateaus import MAX_FROM_MEAN_K, group_plateaus
from gyrobench.bench.bias.statistics import solve
from gyrobench.bench.dwells.earlier_calibration import AccelerometerBiases, EarlierCalibration
from gyrobench.bench.dwells.measure_dwell import CheckDwell, only_window
from gyrobench.bench.dwells.measurement_setup import MeasurementSetup
from gyrobench.bench.foundations.arrays import RADPS_TO_DPH, UG_TO_MPS2, FloatArray, Triple, triple
from gyrobench.bench.foundations.errors import MeasurementError
from gyrobench.bench.foundations.text import flag_text
from gyrobench.bench.navigation.attitude import UP, angle_between, rotation_matrix, rotation_vector_enu
from gyrobench.bench.navigation.earth import earth_rate_enu
from gyrobench.bench.navigation.error_model import Site
from gyrobench.bench.navigation.positions import AXES, POSITIONS, half_turn_pairs
from gyrobench.bench.runs.marks import DwellMarks
from gyrobench.bench.runs.tables.calibration_check_table import CalibrationCheckRow

_EAST, _NORTH = np.eye(3)[:2]
#: Largest difference of azimuth errors of the table in one position: this, rad, or this number of standard
#: uncertainties of each.
_MAX_TABLE_ERROR, _MAX_TABLE_SIGMAS = math.radians(0.05), 5.0
#: Largest angle between a gyro and East or North.
_MAX_ANGLE_DEG = 1.0

#: Two alignments half a turn apart; None if the second one is missing.
_Pair = tuple[CheckDwell, CheckDwell | None]


def calibration_check_rows(
    dwells: Sequence[CheckDwell], calibration: Sequence[DwellRow], setup: MeasurementSetup
) -> list[CalibrationCheckRow]:
    """Biases measured by a calibration check, compared with the calibrated ones.

    Each navigation gives the bias of the gyro along North; two alignments half a turn apart, in one position
    and on one plateau, give that of the gyro along East. A bias that is not observable has a row with the
    reason. ``dwells``: in any order; ``calibration``: of this run or another one; rows of other units are
    skipped. Without any, nothing is compared and the accelerometer biases are unknown.
    """
    calibrations = {
        unit: EarlierCalibration((row for row in calibration if row.unit == unit), setup.prior)
        for unit in {each.marks.unit for each in dwells}
    }
    rows = [_velocity_row(each, calibrations[each.marks.unit], setup) for each in dwells]
    for plateau in group_plateaus(sorted(dwells, key=lambda dwell: dwell.dwell)):
        pairs = half_turn_pairs(plateau, lambda each: each.marks.azimuth_deg, _are_comparable)
        for first, second in pairs:
            row = _alignment_row(first, second, calibrations[first.marks.unit], setup, pairs)
            rows.append(row)
    return sorted(rows, key=lambda row: (row.dwell, row.method))


def _velocity_row(
    each: CheckDwell, calibration: EarlierCalibration, setup: MeasurementSetup
) -> CalibrationCheckRow:
    row = _empty_row(each.marks, "velocity", _NORTH, each.flags)
    if each.navigation is None:
        return row
    dwell, model = each.navigation.dwell, setup.error_model(each.navigation.noise)
    gyro_c = each.temperatures.gyro_c
    accelerometers = calibration.accelerometers(row.position, gyro_c)
    bias = bias_from_velocity(dwell, each.marks.align_s, model, accelerometers)
    slope = bias_from_velocity_slope(dwell, model, accelerometers)
    return _compare(row, gyro_c, bias, slope, accelerometers, calibration)


def _alignment_row(
    first: CheckDwell,
    second: CheckDwell | None,
    calibration: EarlierCalibration,
    setup: MeasurementSetup,
    pairs: Sequence[_Pair],
) -> CalibrationCheckRow:
    """Bias by a pair of alignments; ``pairs``: those of its plateau."""
    if second is None:
        opposite_deg = (first.marks.azimuth_deg + 180.0) % 360.0
        flag = f"no alignment at azimuth {opposite_deg:g} deg: a single one contains the table's error too"
        return _empty_row(first.marks, "alignment", _EAST, (*first.flags, flag))
    flags = [f"dwell {each.dwell}: {flag_text(each.flags)}" for each in (first, second) if each.flags]
    row = replace(_empty_row(first.marks, "alignment", _EAST, flags), turned_dwell=second.marks.dwell)
    if first.navigation is None or second.navigation is None:
        return row
    row = replace(row, flags=(*row.flags, *_table_flags((first, second), pairs, setup)))
    x, y, z = np.mean([first.alignment_c, second.alignment_c], axis=0).tolist()
    accelerometers = calibration.accelerometers(row.position, (x, y, z))
    bias = bias_from_alignments(
        first.navigation.dwell,
        second.navigation.dwell,
        min(first.marks.align_s, second.marks.align_s),
        setup.error_model(first.navigation.noise),
        accelerometers,
    )
    return _compare(row, (x, y, z), bias, None, accelerometers, calibration)


def _table_flags(pair: _Pair, pairs: Sequence[_Pair], setup: MeasurementSetup) -> Iterator[str]:
    """Flag if the azimuth error of the table in a pair differs from that of another pair in its position.

    The bias cancels in the mean of a pair's headings. An encoder with a wrong scale, or one that slips, would
    look like a bias.
    """
    error = _table_error(pair, setup)
    for other in pairs:
        other_error = _table_error(other, setup) if _have_same_position(pair[0], other[0]) else None
        if (
            error
            and other_error
            and abs(error[0] - other_error[0]) > max(_MAX_TABLE_ERROR, error[1] + other_error[1])
        ):
            numbers = " and ".join(str(each.dwell) for each in other if each)
            yield (
                f"the heading of the INS is {math.degrees(error[0]):.2f} deg off that of the table, and "
                f"{math.degrees(other_error[0]):.2f} deg in dwells {numbers}: the table does not turn by "
                "what it reads. Check encoder and coupling of the vertical axis"
            )
            return


def _table_error(pair: _Pair, setup: MeasurementSetup) -> tuple[float, float] | None:
    """Heading of the INS minus that of the table, mean of a pair, and the limit of its noise, rad."""
    dwells = [each.navigation for each in pair if each and each.navigation]
    if len(dwells) < len(pair):
        return None
    _, rate_n, _ = earth_rate_enu(setup.site.latitude)
    align_s = min(each.marks.align_s for each in pair if each)
    noise = max(each.noise.angle_random_walk for each in dwells) / rate_n / math.sqrt(2.0 * align_s)
    return sum(_heading_error(each.dwell) for each in dwells) / len(dwells), _MAX_TABLE_SIGMAS * noise


def _have_same_position(first: CheckDwell, other: CheckDwell) -> bool:
    return (first.marks.unit, first.marks.position) == (other.marks.unit, other.marks.position)


def _are_comparable(first: CheckDwell, other: CheckDwell) -> bool:
    differences_k = np.abs(np.subtract(first.alignment_c, other.alignment_c))  # NaN where there are no data
    return _have_same_position(first, other) and not (differences_k > MAX_FROM_MEAN_K).any()


def _empty_row(
    marks: DwellMarks, method: str, direction: FloatArray, flags: Sequence[str]
) -> CalibrationCheckRow:
    direction_body = POSITIONS[marks.position].C_nb(math.radians(marks.azimuth_deg)).T @ direction
    return CalibrationCheckRow(
        unit=marks.unit,
        run=marks.run,
        dwell=marks.dwell,
        turned_dwell=None,
        cycle=marks.cycle,
        position=marks.position,
        azimuth_deg=marks.azimuth_deg,
        gyro=AXES[int(np.argmax(np.abs(direction_body)))],
        method=method,
        flags=tuple(flags),
    )


def _compare(
    row: CalibrationCheckRow,
    gyro_c: Triple,
    bias: AxisBias,
    slope: AxisBias | None,
    accelerometers: AccelerometerBiases,
    calibration: EarlierCalibration,
) -> CalibrationCheckRow:
    """Fill in the bias of the gyro and compare it with the calibrated one."""
    axis = AXES.index(row.gyro)
    component = bias.direction[axis]
    if (angle_deg := math.degrees(math.acos(min(abs(component), 1.0)))) > _MAX_ANGLE_DEG:
        oblique = f"the {row.gyro} gyro is {angle_deg:.0f} deg off: check at azimuth 0, 90, 180 or 270 deg"
        return replace(row, flags=(*row.flags, oblique))
    sign = math.copysign(1.0, component)
    row = replace(
        row,
        temperature_c=gyro_c[axis],
        bias_dph=sign * bias.bias_dph,
        sigma_dph=bias.sigma_dph,
        paper_bias_dph=sign * slope.bias_dph if slope else math.nan,
        paper_sigma_dph=slope.sigma_dph if slope else math.nan,
        accelerometer_ug=float(accelerometers.bias[axis] / UG_TO_MPS2),
        accelerometer_sigma_ug=float(accelerometers.sigma[axis] / UG_TO_MPS2),
    )
    calibrated = calibration.gyro_dph(row.position, axis, row.temperature_c)
    return _with_difference(row, *calibrated) if calibrated else row


def _with_difference(
    row: CalibrationCheckRow, calibrated_dph: float, sigma_dph: float
) -> CalibrationCheckRow:
    """Row with the calibrated bias; the difference is not given for a row with flags."""
    row = replace(row, calibrated_dph=calibrated_dph, calibrated_sigma_dph=sigma_dph)
    if row.flags:
        return row
    difference, difference_sigma = row.bias_dph - calibrated_dph, math.hypot(row.sigma_dph, sigma_dph)
    p_value = math.erfc(abs(difference) / difference_sigma / math.sqrt(2.0))
    return replace(row, difference_dph=difference, difference_sigma_dph=difference_sigma, p_value=p_value)


@dataclass(frozen=True)
class AxisBias:
    """Bias along one direction, as measured in one attitude of the INS."""

    direction: tuple[float, float, float]  #: Unit vector in body axes.
    #: bias_radps, sigma_radps: Bias along it and its standard uncertainty.
    bias_radps: float
    sigma_radps: float

    @property
    def bias_dph(self) -> float:
        """Bias, deg/h."""
        return self.bias_radps * RADPS_TO_DPH

    @property
    def sigma_dph(self) -> float:
        """Its standard uncertainty, deg/h."""
        return self.sigma_radps * RADPS_TO_DPH


def bias_from_alignments(
    first: Dwell, second: Dwell, align_s: float, model: ErrorModel, accelerometers: AccelerometerBiases
) -> AxisBias:
    """Bias of the gyro that points East, from two alignments half a turn apart.

    Each heading error is the bias over the Earth's horizontal rate; the azimuth error of the table is the
    same in both and cancels. A misalignment towards the vertical looks like a bias.

    ``first`` and ``second``: navigation directly after the alignments, in one position. ``align_s``: length
    of each alignment, s; sets the noise of the heading. An INS that uses less of that time has more noise.
    Raises MeasurementError if the two are not half a turn apart.
    """
    _check_half_turn(first, second)
    site, noise, prior = model.site, model.noise, model.prior
    _, rate_n, rate_u = earth_rate_enu(site.latitude)
    headings = [_heading_error(each) for each in (first, second)]
    sigmas = (
        noise.angle_random_walk / math.sqrt(2.0 * align_s),
        noise.heading_white * rate_n / math.sqrt(2.0),
        prior.tilt_step * rate_n / 2.0,
        prior.gyro_misalignment * rate_u,
    )
    apparent = float(rate_n * (headings[0] - headings[1]) / 2.0)
    east = first.C_nb_table[0].T @ _EAST
    return _correct_for_accelerometer(east, apparent, math.hypot(*sigmas), site, accelerometers)


def bias_from_velocity(
    dwell: Dwell, align_s: float, model: ErrorModel, accelerometers: AccelerometerBiases
) -> AxisBias:
    """Bias of the gyro that points North, from the navigation directly after an alignment.

    The full error model, with the initial errors of an alignment, is fitted to the whole output.

    ``dwell``: with one window. ``align_s``: length of the alignment, s; sets the noise of the first attitude.
    Raises MeasurementError if there is not one window.
    """
    window = only_window(dwell)
    bias_filter = BiasFilter(model)
    bias_filter.begin_window(window.time_s[0], window.C_nb[0])
    bias_filter.add(window)
    information = bias_filter.information()
    mean, root = _aligned_prior(window.C_nb[0], align_s, model, accelerometers)
    values, covariance = solve(information.rows, information.data - information.rows @ mean, root)
    north = window.C_nb[0].T @ _NORTH
    weights = north @ information.bias_at_mean
    sigma = math.sqrt(weights @ covariance @ weights)
    return AxisBias(triple(north), float(weights @ (values + mean)), sigma)


def bias_from_velocity_slope(
    dwell: Dwell, model: ErrorModel, accelerometers: AccelerometerBiases
) -> AxisBias:
    """Bias of the gyro that points North, from the second derivative of the velocity East over g.

    For comparison: neglects the Schuler loop and the Earth's rotation, as the paper does. Raises
    MeasurementError if there is not one window.
    """
    window, site = only_window(dwell), model.site
    time = window.time_s - window.time_s[0]
    weights = PolynomialTrend(time, 2).weights / site.gravity
    apparent = float(window.velocity_enu_mps[:, 0] @ weights)
    sigma = math.sqrt(float(model.noise.velocity_variance(time, weights, site.gravity)))
    return _correct_for_accelerometer(window.C_nb[0].T @ _NORTH, apparent, sigma, site, accelerometers)


def _check_half_turn(first: Dwell, second: Dwell) -> None:
    half_turned = rotation_matrix(UP, np.pi) @ first.C_nb_table[0]
    if angle_between(second.C_nb_table[0], half_turned) > TURN_TOLERANCE:
        raise MeasurementError(
            f"{first.position_name}: two alignments give a bias only if they are half a turn apart. "
            "Align once at an azimuth and once 180 deg from it"
        )


def _heading_error(dwell: Dwell) -> float:
    """Initial heading of the INS minus that of the table, rad."""
    return float(rotation_vector_enu(dwell.windows[0].C_nb[:1], dwell.C_nb_table[0])[0, 2])


def _aligned_prior(
    C_nb: FloatArray, align_s: float, model: ErrorModel, accelerometers: AccelerometerBiases
) -> tuple[FloatArray, FloatArray]:
    """Prior mean (p,) of the parameters after an alignment, and root (p, p) of their covariance."""
    site, noise = model.site, model.noise
    earth_rate = earth_rate_enu(site.latitude)
    level_sigma = noise.velocity_random_walk / site.gravity / math.sqrt(align_s)
    heading_sigma = noise.angle_random_walk / earth_rate[1] / math.sqrt(align_s)
    root = parameters.prior_root(model.prior, 1, earth_rate)
    root[parameters.ACCELEROMETER_BIAS, parameters.ACCELEROMETER_BIAS] = np.diag(accelerometers.sigma)
    attitude = np.arange(len(root))[parameters.COMMON_COUNT :][parameters.ATTITUDE]
    root[attitude, attitude] = level_sigma, level_sigma, heading_sigma
    mean = np.zeros(len(root))
    mean[parameters.ACCELEROMETER_BIAS] = accelerometers.bias
    coupling = np.zeros_like(root)
    coupling[attitude] = _aligned_attitude(C_nb, earth_rate, site.gravity, len(root))
    return mean + coupling @ mean, root + coupling @ root


def _aligned_attitude(C_nb: FloatArray, earth_rate: FloatArray, gravity: float, count: int) -> FloatArray:
    """Initial attitude error (3, count) after levelling and gyrocompassing, for a unit of each parameter."""
    _, rate_n, rate_u = earth_rate
    unit_inputs = parameters.inputs(C_nb, C_nb.T @ earth_rate, count)
    east_rate, tilt_n, tilt_e = unit_inputs[0], unit_inputs[3] / gravity, -unit_inputs[4] / gravity
    return np.stack([tilt_e, tilt_n, (rate_u * tilt_n - east_rate) / rate_n])


def _correct_for_accelerometer(
    direction: FloatArray, apparent: float, sigma: float, site: Site, accelerometers: AccelerometerBiases
) -> AxisBias:
    """Correct the apparent bias for the accelerometer bias along ``direction``."""
    factor = earth_rate_enu(site.latitude)[2] / site.gravity
    accelerometer_bias, accelerometer_sigma = accelerometers.along(direction)
    bias, bias_sigma = apparent + factor * accelerometer_bias, factor * accelerometer_sigma
    return AxisBias(triple(direction), bias, math.hypot(sigma, bias_sigma))
