"""What the Earth's rotation in the biases of a log reveals about its import map."""

import numpy as np
import pytest

from gyrobench.bench.bias.dwell_table import DwellRow
from gyrobench.bench.exchange.earth_check import earth_warnings
from gyrobench.bench.exchange.import_map import EarthRate
from gyrobench.bench.exchange.window_checks import earth_rate_dph, nearest_position
from gyrobench.bench.foundations.arrays import triple
from gyrobench.bench.navigation.positions import POSITIONS

TRUE = EarthRate(latitude_deg=45.0, azimuth_deg=20.0)


def rows(
    rule, gyro_columns=None, force_columns=None, scale=(1.0, 1.0, 1.0), g_dph=0.0, noise_dph=0.01, seed=0
):
    """Two cycles in six positions; columns are matrices (3, 3) from true axes to those of the map."""
    random = np.random.default_rng(seed)
    gyro_columns = np.eye(3) if gyro_columns is None else gyro_columns
    force_columns = np.eye(3) if force_columns is None else force_columns
    g_matrix = g_dph * random.standard_normal((3, 3))
    found = []
    for temperature_c in (20.0, 35.0, 50.0, 35.0):
        for true_position in POSITIONS:
            up = POSITIONS[true_position].C_nb()[2]
            bias = np.array([0.3, -0.2, 0.1]) + np.array([4e-3, -3e-3, 2e-3]) * (temperature_c - 35.0)
            sensed = np.array(scale) * (earth_rate_dph(true_position, TRUE) + bias + g_matrix @ up)
            position, _ = nearest_position(force_columns @ up)
            rate = gyro_columns @ sensed + noise_dph * random.standard_normal(3)
            found.append(
                DwellRow(
                    unit="7", run="1", dwell=len(found) + 1, cycle=1, position=position,
                    start_s=0.0, end_s=300.0, since_power_on_s=0.0,
                    gyro_c=(temperature_c,) * 3, gyro_rate_c_per_h=(0.0,) * 3,
                    bias_dph=triple(rate - earth_rate_dph(position, rule)), sigma_dph=(noise_dph,) * 3,
                )
            )  # fmt: skip
    return found


@pytest.mark.parametrize(
    ("rule", "text"),
    [
        ({"latitude_deg": 45.0, "azimuth_deg": 20.0}, ""),
        ({"latitude_deg": 46.0, "azimuth_deg": 20.0}, "fits a latitude_deg of 45.0"),
        ({"latitude_deg": 45.0, "azimuth_deg": 200.0}, "fits an azimuth_deg of 20.0"),
        ({"latitude_deg": 10.0, "azimuth_deg": 50.0}, "a latitude_deg of 45.0"),
        ({"latitude_deg": 45.0}, ""),
        ({"latitude_deg": 30.0}, "1.41 times the vertical part of the Earth's rotation"),
    ],
)
def test_a_wrong_place_or_azimuth_is_named_with_the_right_one(rule, text):
    rule = EarthRate(**rule)
    found = earth_warnings(rows(rule), rule, is_by_force=True)
    assert len(found) == bool(text)
    assert text in "".join(found)


def test_a_wrong_scale_of_all_gyros_or_of_one_is_named():
    for factor in (0.2, 0.5, 1.1, 57.3):
        [found] = earth_warnings(rows(TRUE, scale=(factor,) * 3), TRUE, is_by_force=True)
        assert f"the gyros sense {factor:.3g} times the Earth's rotation" in found
    [found] = earth_warnings(rows(TRUE, scale=(1.0, 0.5, 1.0)), TRUE, is_by_force=True)
    assert "the y gyro senses 0.5 times" in found


@pytest.mark.parametrize(
    ("columns", "held"), [(np.diag([1, -1, 1]), "x, -y, z"), (np.eye(3)[[1, 0, 2]], "y, x, z")]
)
def test_axes_that_are_left_handed_are_named_though_they_agree_with_the_accelerometers(columns, held):
    [both] = earth_warnings(rows(TRUE, columns, columns), TRUE, is_by_force=True)
    assert f"columns x, y, z of gyros and accelerometers hold {held}." in both
    [gyros] = earth_warnings(rows(TRUE, columns), TRUE, is_by_force=False)
    assert f"columns x, y, z of the gyros hold {held}." in gyros


@pytest.mark.parametrize(
    ("declared", "scale", "texts"),
    [
        ({}, 1.0, []),
        ({}, 57.3, ["the gyros sense 58.4 times the vertical part of the Earth's rotation"]),
        ({"latitude_deg": 10.0}, 1.0, ["4.15 times the vertical part of the Earth's rotation"]),
        ({}, (1.0, 1.0, -1.0), ["bias of the z gyro is -21.4 deg/h along Up: twice the vertical part"]),
    ],
)
def test_three_positions_suffice_to_see_a_wrong_scale_latitude_or_sign(declared, scale, texts):
    rule = EarthRate(**({"latitude_deg": 45.0} | declared))
    measured = rows(rule, scale=np.ones(3) * scale)
    three = [row for row in measured if row.position in ("z_up", "x_up", "y_down")]
    found = earth_warnings(three, rule, is_by_force=True)
    assert len(found) == len(texts)
    assert all(text in each for text, each in zip(texts, found, strict=True))


def test_biases_that_follow_gravity_and_few_rows_are_no_mistake_of_the_map():
    for g_dph in (0.0, 0.3, 30.0):
        for seed in range(20):
            for rule in (TRUE, EarthRate(latitude_deg=45.0)):
                measured = rows(rule, g_dph=g_dph, seed=seed)
                found = earth_warnings(measured, rule, is_by_force=True)
                # The bias of a single gyro may follow gravity by just the Earth's rotation.
                single = ("gyro seems to lack", "gyro differs by") if g_dph == 30.0 else ()
                assert [each for each in found if not any(text in each for text in single)] == []
    wrong = EarthRate(latitude_deg=10.0, azimuth_deg=20.0)
    assert earth_warnings(rows(wrong)[:6], wrong, is_by_force=True) == []
    upside_down = [row for row in rows(wrong) * 3 if row.position in ("z_up", "z_down")]
    assert earth_warnings(upside_down, wrong, is_by_force=True) == []
