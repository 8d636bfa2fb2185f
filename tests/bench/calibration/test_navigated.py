"""Coefficients from navigation output: velocity and attitude of an INS that sends no increments."""

import numpy as np
import pytest

from gyrobench.bench.calibration.estimator import calibrate
from gyrobench.bench.calibration.information import CalibrationOptions
from gyrobench.bench.navigation.error_model import Site
from tests.bench.calibration.navigated_unit import WALKS, any_unit, rotated, six_dwells, truth
from tests.bench.calibration.test_rotation_list import NAMES, SHOWN, shipped

SITE = Site(np.deg2rad(45.0), 60.0)
ARCSEC = np.pi / 648000.0
#: Heading over the turns to 1 arcsec; their tilt is not used.
HEADING = CalibrationOptions(walks=WALKS, heading=ARCSEC)


def of(found, unit):
    """Uncertainties in the units of tables by name; checks that they hold."""
    seen = found.is_observed
    deviations = ((found.values - truth(unit)) / found.sigmas)[seen]
    assert np.abs(deviations).max() < 4.5
    assert np.sqrt(np.mean(deviations**2)) < 1.7
    sigmas = np.where(seen, found.sigmas * SHOWN, np.nan)
    return dict(zip(NAMES, sigmas, strict=True))


def test_six_dwells_give_misalignments_to_an_arcsec_and_one_scale_factor_by_the_heading():
    random = np.random.default_rng(5)
    unit = any_unit(random)
    found = calibrate(six_dwells(unit, 45.0, random), SITE, HEADING)
    sigmas = of(found, unit)
    assert found.fit.p_value > 1e-3
    names = [f"gyro_misalignment_{axes}" for axes in ("xz", "yz", "zx", "zy")]
    names += ["accelerometer_misalignment_zx"]
    assert max(sigmas[name] for name in names) < 1.0
    assert max(sigmas["accelerometer_bias_x"], sigmas["accelerometer_bias_y"]) < 1.8
    assert sigmas["gyro_scale_factor_z"] < 1.4
    # Gravity stands in place of the vertical force.
    assert np.isnan(sigmas["accelerometer_scale_factor_x"])


@pytest.mark.parametrize("latitude_deg", [67.0, -34.0])
def test_eighteen_rotations_of_navigation_output_give_all_gyro_coefficients(latitude_deg):
    random = np.random.default_rng(6)
    unit = any_unit(random)
    recordings = rotated(unit, latitude_deg, random, shipped("eighteen_rotations"))
    found = calibrate(recordings, Site(np.deg2rad(latitude_deg), 60.0), HEADING)
    sigmas = of(found, unit)
    assert max(sigma for name, sigma in sigmas.items() if "gyro_mis" in name) < 0.25
    assert max(sigma for name, sigma in sigmas.items() if "gyro_scale" in name) < 0.5
