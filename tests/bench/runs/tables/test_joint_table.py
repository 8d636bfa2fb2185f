"""Joint solutions as tables, from the strapdown INS of the emulated bench."""

import math
from dataclasses import asdict

import numpy as np
import pytest

from gyrobench.bench.bias.joint_solution import pooled_up_rate
from gyrobench.bench.bias.parameters import PriorKnowledge
from gyrobench.bench.foundations.arrays import RADPS_TO_DPH
from gyrobench.bench.foundations.errors import DocumentError, RunFolderError
from gyrobench.bench.runs.tables.joint_table import (
    JOINT_BIASES_TABLE,
    JOINT_PLATEAUS_TABLE,
    JointSigmas,
    joint_bias_rows,
    joint_plateau_rows,
)
from tests.bench.bias.emulated_groups import any_unit, follow_gravity, is_vertical, joint_solution_of, measure

# As the units of emulated_groups are: their mounts do not tilt.
PRIOR = PriorKnowledge.from_datasheet(
    latitude_arcmin=0.02, tilt_step_arcsec=0.0, accelerometer_drift_ug_per_h=2.0
)
LATITUDE_ERROR_ARCMIN = 2.0
SET_POINTS_C = (20.0, 50.0)


def solved(unit, random):
    """Joint solutions of two temperatures, and the rate Up of both."""
    solutions = [
        joint_solution_of(measure(unit, random, first=1 + 6 * plateau, chamber_set_c=set_c), PRIOR)
        for plateau, set_c in enumerate(SET_POINTS_C)
    ]
    return solutions, pooled_up_rate(solutions, PRIOR)


@pytest.fixture(scope="module")
def wrong_latitude():
    random = np.random.default_rng(3)
    unit = any_unit(random, latitude_error_arcmin=LATITUDE_ERROR_ARCMIN)
    return unit, *solved(unit, random)


@pytest.fixture(scope="module")
def parting():
    """Solutions of a unit whose vertical biases differ up and down, each gyro's in its own way."""
    random = np.random.default_rng(4)
    return solved(follow_gravity(any_unit(random), np.array([0.01, -0.01, 0.0])), random)


@pytest.fixture(scope="module")
def biases(wrong_latitude):
    return joint_bias_rows(*wrong_latitude[1:])


@pytest.fixture(scope="module")
def plateaus(wrong_latitude):
    return joint_plateau_rows(*wrong_latitude[1:])


def columns(rows, *names):
    return np.array([[getattr(row, name) for name in names] for row in rows])


def test_every_gyro_of_every_dwell_has_a_row(biases):
    assert [(row.plateau, row.dwell, row.gyro) for row in biases] == [
        (1 + (dwell - 1) // 6, dwell, gyro) for dwell in range(1, 13) for gyro in "xyz"
    ]
    assert {row.temperature_c for row in biases} == {25.0}


def test_biases_of_a_dwell_by_itself_together_and_corrected_are_those_of_the_solution(wrong_latitude, biases):
    _, solutions, rate = wrong_latitude
    for name, of in (
        ("single", lambda each: each.single),
        ("joint", lambda each: each.together),
        ("corrected", lambda each: each.corrected(rate)),
    ):
        expected = RADPS_TO_DPH * np.vstack(
            [
                np.column_stack([of(each).bias_radps.ravel(), of(each).sigma_radps.ravel()])
                for each in solutions
            ]
        )
        np.testing.assert_allclose(columns(biases, f"{name}_dph", f"{name}_sigma_dph"), expected, rtol=1e-12)


def test_corrected_biases_are_free_of_the_latitude_and_the_joint_ones_of_vertical_gyros_are_not(
    wrong_latitude, biases
):
    unit, _, _ = wrong_latitude
    true_dph = np.tile(unit.true_bias_dph().ravel(), 2)
    joint, corrected = (
        np.abs(bias - true_dph) / sigma
        for bias, sigma in (
            columns(biases, f"{name}_dph", f"{name}_sigma_dph").T for name in ("joint", "corrected")
        )
    )
    assert corrected.max() < 4.0
    assert joint[np.tile(is_vertical().ravel(), 2)].min() > 4.0


def test_nothing_is_corrected_where_biases_part_up_and_down(parting):
    solutions, rate = parting
    rows = joint_bias_rows(solutions, rate)
    assert np.isnan(columns(rows, "corrected_dph", "corrected_sigma_dph")).all()
    assert {row.finding for row in joint_plateau_rows(solutions, rate)} == {"different"}


def test_plateaus_show_what_their_dwells_share(wrong_latitude, plateaus):
    unit, _, _ = wrong_latitude
    assert [(row.plateau, row.cycle, row.dwells) for row in plateaus] == [(1, 1, 6), (2, 1, 6), (0, 0, 12)]
    assert [row.chamber_set_c for row in plateaus[:2]] == list(SET_POINTS_C)
    for row in plateaus[:2]:
        for axis, true_ug in zip("xyz", unit.accelerometer_ug, strict=True):
            found, sigma = (getattr(row, f"accelerometer_{axis}_{what}ug") for what in ("", "sigma_"))
            assert found == pytest.approx(true_ug, abs=4.0 * sigma)
    for row in plateaus:
        assert row.finding == "latitude_off"
        assert row.latitude_error_arcmin == pytest.approx(
            LATITUDE_ERROR_ARCMIN, abs=4.0 * row.latitude_error_sigma_arcmin
        )


def test_last_row_holds_the_rate_of_all_plateaus_and_no_more(plateaus):
    last = plateaus[-1]
    assert last.up_rate_sigma_dph < 0.8 * plateaus[0].up_rate_sigma_dph
    assert np.isnan(
        [last.north_rate_dph, last.accelerometer_x_ug, last.chamber_set_c, last.fit_p_value]
    ).all()


def test_one_plateau_needs_no_row_of_all(wrong_latitude):
    _, (first, _), _ = wrong_latitude
    assert [row.plateau for row in joint_plateau_rows([first], first.up_rate)] == [1]


def test_no_solutions_make_no_rows():
    assert joint_bias_rows([], None) == []
    assert joint_plateau_rows([], None) == []


def test_gain_is_the_ratio_of_the_uncertainties(wrong_latitude, biases):
    _, solutions, _ = wrong_latitude
    expected = np.concatenate(
        [(each.single.sigma_radps / each.together.sigma_radps).ravel() for each in solutions]
    )
    found = [gain for sigmas in JointSigmas.of(biases).values() for gain in sigmas.gains]
    np.testing.assert_allclose(sorted(found), sorted(expected))


def assert_same(read, written):
    for one, other in zip(read, written, strict=True):
        for (name, value), expected in zip(asdict(one).items(), asdict(other).values(), strict=True):
            if isinstance(expected, float):
                assert value == pytest.approx(expected, rel=1e-8, nan_ok=True), name
            else:
                assert value == expected, name


def test_tables_survive_writing_and_reading(biases, plateaus, parting, tmp_path):
    for rows in (biases, joint_bias_rows(*parting)):
        JOINT_BIASES_TABLE.write(tmp_path / "joint_biases.csv", rows)
        assert_same(JOINT_BIASES_TABLE.iterate(tmp_path / "joint_biases.csv"), rows)
    JOINT_PLATEAUS_TABLE.write(tmp_path / "joint.csv", plateaus)
    assert_same(JOINT_PLATEAUS_TABLE.read(tmp_path / "joint.csv"), plateaus)


def test_what_is_not_known_is_an_empty_cell(plateaus, tmp_path):
    JOINT_PLATEAUS_TABLE.write(tmp_path / "joint.csv", plateaus)
    header, *lines = (tmp_path / "joint.csv").read_text().splitlines()
    cells = dict(zip(header.split(","), lines[-1].split(","), strict=True))
    assert cells["accelerometer_x_ug"] == cells["fit_p_value"] == ""
    assert cells["finding"] == "latitude_off"


def test_every_mistake_is_reported_with_line_and_column(biases, tmp_path):
    path = tmp_path / "joint_biases.csv"
    JOINT_BIASES_TABLE.write(path, biases[:3])
    lines = path.read_text().splitlines()
    lines[1] = lines[1].replace("z_up", "upside_down")
    lines[2] = lines[2].replace("1,1,", "1,one,", 1)
    lines[3] = lines[3].replace(",z,", ",w,").replace(f"{biases[2].joint_dph:.9g}", "much")
    path.write_text("\n".join(lines))
    with pytest.raises(DocumentError) as caught:
        list(JOINT_BIASES_TABLE.iterate(path))
    message = str(caught.value)
    assert "joint_biases.csv:2: column position: expected one of z_up" in message
    assert "joint_biases.csv:3: column dwell: expected a whole number; found 'one'" in message
    assert "joint_biases.csv:4: column gyro: expected one of x, y, z; found 'w'" in message
    assert "joint_biases.csv:4: column joint_dph: expected a number; found 'much'" in message


def test_a_finding_that_is_none_is_reported(plateaus, tmp_path):
    path = tmp_path / "joint.csv"
    JOINT_PLATEAUS_TABLE.write(path, plateaus)
    path.write_text(path.read_text().replace(",latitude_off,", ",longitude,"))
    with pytest.raises(DocumentError, match=r"joint\.csv:2: column finding: expected one of no_pair, "):
        JOINT_PLATEAUS_TABLE.read(path)


def test_a_table_of_a_version_without_the_gyro_errors_is_read(plateaus, tmp_path):
    path = tmp_path / "joint.csv"
    JOINT_PLATEAUS_TABLE.write(path, plateaus)
    lines = [line.rsplit(",", 2)[0] for line in path.read_text().splitlines()]
    path.write_text("\n".join(lines))
    rows = JOINT_PLATEAUS_TABLE.read(path)
    assert [row.fit_p_value for row in rows] == pytest.approx(
        [row.fit_p_value for row in plateaus], nan_ok=True
    )
    assert all(math.isnan(row.gyro_error_factor) and math.isnan(row.scale_factor_ratio) for row in rows)


def test_files_that_can_not_be_read_or_written_are_named(tmp_path):
    with pytest.raises(DocumentError, match=r"absent\.csv: can't be read"):
        JOINT_PLATEAUS_TABLE.read(tmp_path / "absent.csv")
    with pytest.raises(RunFolderError, match="can't be written"):
        JOINT_PLATEAUS_TABLE.write(tmp_path / "absent" / "joint.csv", [])


def test_a_chamber_without_set_point_has_an_empty_cell(tmp_path):
    unit = any_unit(np.random.default_rng(5))
    dwells = measure(unit, None, ("z_up", "z_down"), chamber_set_c=math.nan)
    solution = joint_solution_of(dwells, PRIOR)
    JOINT_PLATEAUS_TABLE.write(tmp_path / "joint.csv", joint_plateau_rows([solution], solution.up_rate))
    (row,) = JOINT_PLATEAUS_TABLE.read(tmp_path / "joint.csv")
    assert math.isnan(row.chamber_set_c)
    assert row.finding == "one_gyro"
    assert math.isnan(row.up_rate_p_value)
