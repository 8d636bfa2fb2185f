"""Scale factor by whole turns: per spin, per rate, by direction."""

from functools import cache

import numpy as np
import pytest

from gyrobench.bench.calibration.estimator import calibrate
from gyrobench.bench.calibration.increment_recording import IncrementRecording
from gyrobench.bench.calibration.information import CalibrationOptions
from gyrobench.bench.calibration.spins import gravity_contradiction, spin_scale_factors
from gyrobench.bench.navigation.attitude import rotation_matrices
from gyrobench.bench.navigation.error_model import Site
from tests.bench.calibration.rotated_unit import EIGHTEEN, Noise, Unit

SITE = Site(np.deg2rad(45.0))
ARCSEC = np.pi / 648000.0
OPTIONS = CalibrationOptions(whole_turns=ARCSEC)
RATES_DPS = (20.0, 60.0, 100.0)
SCALE_PPM = 30.0


def rotated_unit(*rotations):
    return Unit(
        rotations=rotations,
        dwell_s=60.0,
        rate_dps=10.0,
        sample_hz=20.0,
        gravity=SITE.gravity,
        gyro_matrix=SCALE_PPM * 1e-6 * np.eye(3),
    )


@cache
def unit():
    """Nine rotations, then ten turns of the z gyro at three rates in both directions."""
    spins = [("inner", sign * 3600.0, rate) for rate in RATES_DPS for sign in (1.0, -1.0)]
    return rotated_unit(*EIGHTEEN[:9], *spins).increments()


def measured(seed, excess):
    """Calibration and spins of a unit whose z gyro senses ``excess`` (a part of the rate) more."""
    angle, velocity = unit()
    rate = angle[:, 2] * 20.0
    angle = angle.copy()
    turning = np.abs(rate) > np.deg2rad(1.0)
    angle[turning, 2] *= 1.0 + excess(rate[turning])
    increments = Noise().added(angle, velocity, 0.05, np.random.default_rng(seed))
    found = calibrate([IncrementRecording(0.05, *increments)], SITE, OPTIONS)
    (spun,) = spin_scale_factors(found, ARCSEC)
    return found, spun


def test_a_constant_scale_factor_is_found_at_every_rate_and_in_both_directions():
    found, spun = measured(1, lambda rate: 0.0 * rate)
    assert spun.axis == "z"
    assert [round(each.rate_dps) for each in spun.spins] == [20, -20, 60, -60, 100, -100]
    assert [each.turns for each in spun.spins] == [10, -10] * 3
    assert abs(spun.scale_factor_ppm - SCALE_PPM) < 4.0 * spun.sigma_ppm
    assert spun.sigma_ppm < 0.1
    assert spun.p_value > 1e-3
    for each in spun.rates:
        assert abs(each.deviation_ppm) < 4.0 * each.deviation_sigma_ppm < 0.8
        assert abs(each.asymmetry_ppm) < 4.0 * each.asymmetry_sigma_ppm < 4.0
    assert found.fit.p_value > 1e-3


def test_nonlinearity_and_asymmetry_are_those_of_the_gyro_and_widen_its_scale_factor():
    per_dps, asymmetry = 0.05e-6, 2e-6
    found, spun = measured(
        2, lambda rate: per_dps * np.abs(np.rad2deg(rate)) + 0.5 * asymmetry * np.sign(rate)
    )
    mean_rate = 60.0
    for each in spun.rates:
        expected_ppm = 1e6 * per_dps * (each.rate_dps - mean_rate)
        # Ramps up and down, and weights of the rates, take a part of it.
        assert each.deviation_ppm == pytest.approx(expected_ppm, abs=0.35)
        assert each.asymmetry_ppm == pytest.approx(1e6 * asymmetry, abs=0.1 + 4.0 * each.asymmetry_sigma_ppm)
    assert spun.p_value < 1e-6
    assert max(abs(each.residual_ppm) for each in spun.spins) > 2.0
    # The rests fit: the scale factor is uncertain by what the rates differ.
    assert found.fit.p_value > 1e-3
    assert 0.3e-6 < found.sigmas[11] < 3e-6


def test_what_the_table_does_not_return_by_is_no_error_of_the_gyro():
    short_deg = 0.002  # within the tolerance of a table's position: 5.6 ppm of a turn
    spins = [("inner", sign * (360.0 - short_deg), rate) for rate in RATES_DPS for sign in (1.0, -1.0)]
    made = rotated_unit(*EIGHTEEN[:9], *spins)
    increments = Noise().added(*made.increments(), 0.05, np.random.default_rng(3))
    outer, inner = made.profile(0.05 * np.arange(1.0, len(increments[0]) + 1.0))
    table = rotation_matrices(np.outer(outer[0], [1.0, 0.0, 0.0])) @ rotation_matrices(
        np.outer(inner[0], [0.0, 0.0, 1.0])
    )
    found = calibrate([IncrementRecording(0.05, *increments, table=table)], SITE, OPTIONS)
    (spun,) = spin_scale_factors(found, ARCSEC)
    for value, sigma in (
        (spun.scale_factor_ppm, spun.sigma_ppm),
        (1e6 * found.values[11], 1e6 * found.sigmas[11]),
    ):
        assert abs(value - SCALE_PPM) < 4.0 * sigma < 3.0


@pytest.mark.parametrize("table_ppm", [0.0, 100.0])
def test_turns_that_are_not_whole_contradict_gravity_where_a_gyro_is_spun_level(table_ppm):
    """A wrong scale of the encoder, which repeats from turn to turn."""
    turn_deg = 360.0 * (1.0 + table_ppm * 1e-6)
    made = rotated_unit(
        *[("outer", angle_deg, 20.0) for angle_deg in (90.0, 90.0, -90.0, -90.0)],
        *[("outer", sign * turn_deg, 20.0) for _ in range(2) for sign in (1.0, -1.0)],
    )
    increments = Noise().added(*made.increments(), 0.05, np.random.default_rng(3))
    alone = CalibrationOptions(whole_turns=None)
    found = calibrate([IncrementRecording(0.05, *increments)], SITE, alone)
    spun = spin_scale_factors(found, ARCSEC)
    contradiction = gravity_contradiction(found, spun)
    if table_ppm:
        assert "give a scale factor of 130.1 ppm against the table, and 30.0" in contradiction
    else:
        assert not contradiction
