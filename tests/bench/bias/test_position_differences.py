import math
from dataclasses import replace

import numpy as np
import pytest

from gyrobench.bench.bias.position_differences import (
    SLOPE_SIGMA_DPH_PER_C,
    fit_bias_curve,
    position_differences,
)
from tests.bench.bias.dwell_rows import dwell_row

PLATEAUS_C = (70.0, 30.0, 0.0, -25.0, 50.0)


def cubic_dph(gyro_c):
    return 1e-3 * gyro_c - 8e-6 * gyro_c**2 + 2e-7 * gyro_c**3


def pair(gyro_c, high_dph=0.0, drift_c=4.0, cycle=1, run="1", number=1):
    """Z-Up and Z-Down with a drift of temperature between them, of a gyro with a cubic."""
    return [
        dwell_row(number, "z_up", gyro_c, cubic_dph(gyro_c) + high_dph, cycle=cycle, run=run),
        dwell_row(number + 1, "z_down", gyro_c + drift_c, cubic_dph(gyro_c + drift_c), cycle=cycle, run=run),
    ]


def difference(found, high="z_up", low="z_down"):
    (result,) = [each for each in found.differences if (each.high, each.low) == (high, low)]
    return result


def test_the_drift_of_the_temperature_is_taken_off():
    plateaus = [pair(gyro_c) for gyro_c in PLATEAUS_C]
    curve = fit_bias_curve(plateaus, 0)
    for plateau in plateaus:
        found = difference(position_differences([plateau], 0, curve))
        assert found.value_dph == pytest.approx(0.0, abs=5e-4)
        assert found.sigma_dph < 2.0 * math.sqrt(2.0) * 0.001


def test_the_constant_of_a_power_on_is_not_taken_for_a_slope():
    plateaus = [pair(gyro_c) for gyro_c in PLATEAUS_C]
    moved = [
        [dwell_row(row.dwell, row.position, row.gyro_c[0], row.bias_dph[0] + 0.5, run="2") for row in plateau]
        for plateau in plateaus[2:]
    ]
    curve = fit_bias_curve([*plateaus[:2], *moved], 0)
    assert difference(position_differences([moved[0]], 0, curve)).value_dph == pytest.approx(0.0, abs=1e-3)


def test_scatter_about_the_curve_makes_it_less_certain():
    plateaus = [pair(gyro_c) for gyro_c in (*PLATEAUS_C, *PLATEAUS_C)]
    scattered = [
        [dwell_row(1, row.position, row.gyro_c[0], row.bias_dph[0] + 0.01 * (-1) ** n) for row in plateau]
        for n, plateau in enumerate(plateaus)
    ]
    quiet, noisy = (np.diag(fit_bias_curve(each, 0).covariance) for each in (plateaus, scattered))
    assert (noisy > 20.0 * quiet).all()


def test_a_slope_that_the_run_does_not_show_goes_into_the_uncertainty():
    plateau = pair(30.0)
    found = difference(position_differences([plateau], 0, fit_bias_curve([plateau], 0)))
    assert found.sigma_dph == pytest.approx(
        math.hypot(0.001 * math.sqrt(2.0), 4.0 * SLOPE_SIGMA_DPH_PER_C), rel=0.02
    )


def test_without_plateaus_the_curve_is_flat_and_uncertain():
    curve = fit_bias_curve([], 0)
    assert not curve.coefficients.any()
    assert (np.diag(curve.covariance) > 0.0).all()


def test_three_plateaus_of_a_nearly_straight_curve_leave_the_differences_as_certain_as_their_noise():
    plateaus = [
        [replace(row, bias_dph=(2e-5 * row.gyro_c[0],) * 3) for row in pair(gyro_c)]
        for gyro_c in (-10.0, 25.0, 60.0)
    ]
    curve = fit_bias_curve(plateaus, 0)
    for plateau in plateaus:
        found = difference(position_differences([plateau], 0, curve))
        assert found.sigma_dph < 1.1 * math.sqrt(2.0) * 0.001


def test_a_power_that_two_plateaus_do_not_show_is_as_uncertain_as_the_others_are_large():
    plateaus = [pair(gyro_c, drift_c=3.0) for gyro_c in (-10.0, 60.0)]
    curve = fit_bias_curve(plateaus, 0)
    for plateau in plateaus:
        found = difference(position_differences([plateau], 0, curve))
        assert 2.0 * math.sqrt(2.0) * 0.001 < abs(found.value_dph) + found.sigma_dph
        assert abs(found.value_dph) < 2.0 * found.sigma_dph


def test_passes_that_agree_halve_the_variance_and_those_that_differ_are_found():
    curve = fit_bias_curve([pair(gyro_c) for gyro_c in PLATEAUS_C], 0)
    agreeing = [pair(30.0, 0.01, drift_c=0.0), pair(30.0, 0.01, drift_c=0.0, cycle=2, number=3)]
    found = position_differences(agreeing, 0, curve)
    assert difference(found).value_dph == pytest.approx(0.01)
    assert difference(found).sigma_dph == pytest.approx(0.001)
    assert found.p_value == pytest.approx(1.0)
    opposite = [agreeing[0], pair(30.0, -0.01, drift_c=0.0, cycle=2, number=3)]
    assert position_differences(opposite, 0, curve).p_value < 1e-10
    assert math.isnan(position_differences(agreeing[:1], 0, curve).p_value)


def test_an_error_that_is_the_same_in_each_pass_does_not_average_out():
    curve = fit_bias_curve([pair(gyro_c) for gyro_c in PLATEAUS_C], 0)
    passes = [pair(30.0, drift_c=0.0), pair(30.0, drift_c=0.0, cycle=2, number=3)]
    own, common = 0.0006, 0.0008  # of 0.001 deg/h

    def sigma_dph(in_lower):
        columns = {
            row.dwell: np.full((3, 1), common if row.position == "z_up" else in_lower)
            for row in [*passes[0], *passes[1]]
        }
        return difference(position_differences(passes, 0, curve, columns)).sigma_dph

    assert sigma_dph(-common) == pytest.approx(math.hypot(own, 2.0 * common), rel=1e-3)
    # What cancels between the positions leaves what independent dwells have.
    assert sigma_dph(common) == pytest.approx(0.001, rel=1e-3)


def test_positions_that_met_in_no_pass_are_not_compared():
    curve = fit_bias_curve([], 0)
    passes = [
        [dwell_row(1, "z_up", 30.0), dwell_row(2, "z_down", 30.0)],
        [dwell_row(3, "z_down", 30.0, cycle=2), dwell_row(4, "y_up", 30.0, cycle=2)],
    ]
    pairs = {(each.high, each.low) for each in position_differences(passes, 0, curve).differences}
    assert pairs == {("z_up", "z_down"), ("z_down", "z_up"), ("z_down", "y_up"), ("y_up", "z_down")}
