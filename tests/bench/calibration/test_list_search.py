"""The shortest list of rotations that reaches given uncertainties."""

import numpy as np
import pytest

from gyrobench.bench.calibration.list_search import parse_targets, shortest_list
from gyrobench.bench.calibration.rotation_list import (
    RotationSetup,
    expected_uncertainties,
    load_rotation_list,
    rotation_list_text,
)
from gyrobench.bench.foundations.errors import DocumentError
from gyrobench.bench.navigation.table_axes import TwoAxisTable
from tests.bench.calibration.test_rotation_list import EAST, NAMES, NOISE, SHOWN, SITE, TABLE, UP, shipped


def proposed(targets, name="eighteen_rotations", table=TABLE, **options):
    return shortest_list(shipped(name), targets, RotationSetup(table, SITE, NOISE, 100.0, **options))


@pytest.mark.long
@pytest.mark.parametrize("name", ["eighteen_rotations", "nineteen_positions"])
@pytest.mark.parametrize("kinds", [("gyro_scale", "gyro_mis"), ("",)])
def test_a_list_that_reaches_what_a_shipped_one_does_is_not_longer(name, kinds):
    reached = expected_uncertainties(shipped(name), RotationSetup(TABLE, SITE, NOISE, 100.0))
    named = np.array([any(part in each for part in kinds) for each in NAMES])
    targets = np.where(named, reached.sigmas, np.inf)
    found, expected = proposed(targets, name)
    assert (expected.sigmas <= targets)[named].all()
    assert found.duration_s <= reached.duration_s
    assert expected.duration_s == found.duration_s


@pytest.mark.long
@pytest.mark.parametrize("has_vertical", [True, False])
def test_an_arcsec_and_a_ppm_need_eight_rotations(has_vertical):
    """Six or less leave what quadratic terms of the accelerometers do to misalignments."""
    targets = parse_targets("gyro_misalignment_arcsec=1, gyro_scale_factor_ppm=1")
    found, expected = proposed(targets, has_vertical=has_vertical)
    assert len(found.rotations) <= 8
    assert (expected.sigmas * SHOWN)[3:12].max() <= 1.0


def test_no_rotation_of_the_list_can_be_left_out(tmp_path):
    targets = parse_targets("accelerometer_bias_ug=20")
    found, _ = proposed(targets)
    (tmp_path / "list.yaml").write_text(rotation_list_text(found))
    assert load_rotation_list(tmp_path / "list.yaml") == found
    for number in range(len(found.rotations)):
        fewer = [*found.rotations[:number], *found.rotations[number + 1 :]]
        shorter = found.model_copy(update={"rotations": fewer})
        try:
            expected = expected_uncertainties(shorter, RotationSetup(TABLE, SITE, NOISE, 100.0))
        except DocumentError:
            continue  # beyond the limits of the table
        assert (expected.sigmas > 0.97 * targets)[np.isfinite(targets)].any()


def test_whole_turns_are_proposed_for_a_scale_factor_below_a_tenth_of_a_ppm():
    unlimited = TwoAxisTable(EAST, UP, np.eye(3))
    found, expected = proposed(
        parse_targets("gyro_scale_factor_z_ppm=0.08"), table=unlimited, whole_turns=np.pi / 648000.0
    )
    assert max(abs(each.angle_deg) for each in found.rotations) == 3600.0
    assert expected.sigmas[11] <= 0.08e-6


def test_limits_of_the_table_are_kept_and_what_they_leave_open_is_named():
    outer_alone = TwoAxisTable(EAST, UP, np.eye(3), (-200.0, 200.0), (0.0, 0.0))
    with pytest.raises(DocumentError, match=r"no list of up to .* reaches the targets: gyro_scale_factor z"):
        proposed(parse_targets("gyro_scale_factor_z_ppm=1"), table=outer_alone)


def test_a_target_of_what_is_not_observable_is_refused():
    targets = parse_targets("accelerometer_scale_factor_ppm=150")
    with pytest.raises(DocumentError, match="scale factors are not observable without increments"):
        proposed(targets, has_vertical=False)


@pytest.mark.long
def test_a_target_that_gravity_or_latitude_keeps_out_of_reach_is_named():
    narrow = TwoAxisTable(EAST, UP, np.eye(3), (-200.0, 200.0), (-100.0, 100.0))
    with pytest.raises(DocumentError, match=r"targets: accelerometer_scale_factor x \(3\d"):
        proposed(parse_targets("accelerometer_scale_factor_x_ppm=1"), table=narrow, site_sigmas=(3e-4, 0.0))


@pytest.mark.parametrize("text", ["gyro_bias=1", "gyro_bias_dph", "gyro_bias_dph=-1", "gyro_bias_dph=nan"])
def test_targets_that_are_none_are_refused_with_the_known_names(text):
    with pytest.raises(DocumentError, match="gyro_misalignment_arcsec"):
        parse_targets(text)
