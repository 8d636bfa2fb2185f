"""What a list of rotations will show, before it is measured."""

from pathlib import Path

import numpy as np
import pytest

from gyrobench.bench.calibration.coefficients import COEFFICIENTS
from gyrobench.bench.calibration.estimator import calibrate
from gyrobench.bench.calibration.increment_recording import IncrementRecording, SensorNoise
from gyrobench.bench.calibration.information import CalibrationOptions
from gyrobench.bench.calibration.rotation_list import (
    RotationList,
    RotationSetup,
    TableRotation,
    expected_uncertainties,
    load_rotation_list,
)
from gyrobench.bench.foundations.errors import DocumentError
from gyrobench.bench.foundations.shipped import find_document, shipped_names
from gyrobench.bench.navigation.error_model import Site
from gyrobench.bench.navigation.table_axes import TwoAxisTable
from tests.bench.calibration.rotated_unit import Noise, Unit

SITE = Site(np.deg2rad(45.0))
EAST, UP = np.eye(3)[[0, 2]]
TABLE = TwoAxisTable(EAST, UP, np.eye(3), (-200.0, 200.0), (-380.0, 380.0))
SHOWN = np.array([each.per_si for each in COEFFICIENTS])
NAMES = [f"{each.name}_{each.axis}" for each in COEFFICIENTS]
#: ARW 0.0006 deg/sqrt(h), 5 ug/sqrt(Hz), 1 mm/s at 1 Hz.
NOISE = SensorNoise(
    *(np.full(3, each) for each in (Noise().angle_random_walk, 0.0, Noise().velocity_random_walk, 1e-3))
)
UNLIMITED = TwoAxisTable(EAST, UP, np.eye(3))


def shipped(name):
    return load_rotation_list(find_document("rotations", name))


def sigmas(rotations, table=TABLE, noise=NOISE, **options):
    """Expected uncertainties in the units of tables, NaN where not observable, by name."""
    found = expected_uncertainties(rotations, RotationSetup(table, SITE, noise, 100.0, **options))
    values = np.where(found.is_observed, found.sigmas * SHOWN, np.nan)
    return dict(zip(NAMES, values, strict=True))


def of(found, part):
    return np.array([value for name, value in found.items() if part in name])


@pytest.mark.parametrize("name", shipped_names("rotations"))
def test_shipped_lists_fit_the_emulated_table(name):
    assert Path(find_document("rotations", name)).stem == shipped(name).rotation_list
    assert np.isfinite(of(sigmas(shipped(name)), "gyro_scale_factor_x")).all()


def test_eighteen_rotations_give_the_expected_uncertainties():
    """0.4 to 0.5 ppm and 0.1 to 0.4 arcsec at an ARW of 0.0006 deg/sqrt(h)."""
    rotations = shipped("eighteen_rotations")
    assert len(rotations.rotations) == 18
    assert {abs(each.angle_deg) for each in rotations.rotations} == {90.0}
    assert rotations.duration_s == pytest.approx(3000.0, rel=0.01)
    found = sigmas(rotations)
    assert of(found, "gyro_scale_factor").max() < 0.5
    assert of(found, "gyro_misalignment").max() < 0.25
    assert np.isfinite(list(found.values())).all()
    level = sigmas(rotations, has_vertical=False)
    assert of(level, "gyro_scale_factor").max() < 0.5
    assert of(level, "gyro_misalignment").max() < 0.25
    assert {name for name in level if np.isnan(level[name])} == {
        f"accelerometer_scale_factor_{axis}" for axis in "xyz"
    }


@pytest.mark.parametrize("site_sigmas", [(0.0, 0.0), (1e-4, np.deg2rad(1.0 / 60.0))])
def test_the_expected_uncertainties_are_what_a_calibration_of_simulated_increments_then_states(site_sigmas):
    rotations = RotationList(
        rotation_list="short",
        dwell_s=60.0,
        rate_dps=10.0,
        rotations=[TableRotation(axis=axis, angle_deg=angle) for axis, angle in FORTH],
    )
    noise = Noise(white_velocity=1e-3)
    unit = Unit(FORTH, dwell_s=60.0, sample_hz=20.0, gravity=SITE.gravity)
    increments = noise.added(*unit.increments(), 0.05, np.random.default_rng(9))
    walks = noise.angle_random_walk, noise.velocity_random_walk
    options = CalibrationOptions(
        walks=walks, gravity_sigma=site_sigmas[0], latitude_sigma=site_sigmas[1], quadratic=None
    )
    measured = calibrate([IncrementRecording(0.05, *increments)], SITE, options)
    expected = sigmas(rotations, site_sigmas=site_sigmas)
    np.testing.assert_allclose(measured.sigmas * SHOWN, list(expected.values()), rtol=0.1)


FORTH = [
    ("outer", 90.0),
    ("inner", 90.0),
    ("outer", -90.0),
    ("inner", 90.0),
    ("outer", -90.0),
    ("inner", -90.0),
]
FORTH += [("outer", 90.0), ("inner", -90.0), ("outer", 90.0)]


def test_the_outer_axis_alone_leaves_scale_factors_across_it_open():
    found = sigmas(shipped("outer_axis"))
    assert found["gyro_scale_factor_x"] < 0.6
    assert np.isnan([found["gyro_scale_factor_y"], found["gyro_scale_factor_z"]]).all()


def test_ten_whole_turns_each_way_give_a_tenth_of_a_ppm():
    spins = [TableRotation(axis="inner", angle_deg=turn, rate_dps=60.0) for turn in (3600.0, -3600.0)]
    rotations = shipped("eighteen_rotations")
    longer = rotations.model_copy(update={"rotations": [*rotations.rotations, *spins]})
    found = sigmas(longer, UNLIMITED, whole_turns=np.pi / 648000.0)
    # 1 arcsec in ten turns, twice, is 0.055 ppm; angle random walk over a minute adds to it.
    assert 0.05 < found["gyro_scale_factor_z"] < 0.1


def test_a_rotation_beyond_the_limits_of_the_table_is_named():
    rotations = shipped("eighteen_rotations")
    narrow = TwoAxisTable(EAST, UP, np.eye(3), (-100.0, 100.0), (-380.0, 380.0))
    with pytest.raises(
        DocumentError, match=r"eighteen_rotations: rotation \d+ \(outer .90 deg\) leads to .*180"
    ):
        expected_uncertainties(rotations, RotationSetup(narrow, SITE, NOISE, 100.0))
    with pytest.raises(DocumentError, match="10 deg/s; the table turns at most 5 deg/s"):
        expected_uncertainties(rotations, RotationSetup(TABLE, SITE, NOISE, 5.0))


def test_a_table_of_one_axis_is_named():
    one_axis = TwoAxisTable(EAST, UP, np.eye(3), (0.0, 0.0), (-380.0, 380.0))
    with pytest.raises(DocumentError, match="the table of the station has no outer axis that turns"):
        expected_uncertainties(shipped("eighteen_rotations"), RotationSetup(one_axis, SITE, NOISE, 100.0))
