"""What the report says of dwells solved together: texts and tables from made-up rows."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from gyrobench.bench.report.estimator_sections import joint_section
from gyrobench.bench.report.page import Section
from gyrobench.bench.runs.tables.joint_table import JointBiasRow, JointPlateauRow, JointSigmas


def plateau_row(plateau: int = 1, finding: str = "different", **changed: float) -> JointPlateauRow:
    values = {
        "chamber_set_c": 57.0,
        "accelerometer_x_ug": 2.4,
        "accelerometer_y_ug": -1.55,
        "accelerometer_z_ug": 1.5,
        "accelerometer_x_sigma_ug": 1.78,
        "accelerometer_y_sigma_ug": 1.82,
        "accelerometer_z_sigma_ug": 5.8,
        "north_rate_dph": -0.00067,
        "north_rate_sigma_dph": 0.00083,
        "up_rate_dph": -0.00328,
        "up_rate_sigma_dph": 0.00049,
        "latitude_error_arcmin": 0.61,
        "latitude_error_sigma_arcmin": 0.11,
        "up_rate_p_value": 0.0123,
        "fit_p_value": 0.98,
        "any_north_p_value": 0.97,
    }
    return JointPlateauRow(plateau=plateau, cycle=1, dwells=4, finding=finding, **{**values, **changed})


def bias_row(position: str, gyro: str, single_dph: float, joint_dph: float, plateau: int = 1) -> JointBiasRow:
    """One whose uncertainties are these."""
    return JointBiasRow(plateau, 1, position, gyro, 25.0, 0.0, single_dph, 0.0, joint_dph, math.nan, math.nan)


def bias_rows(plateau: int = 1, level: float = 0.002, vertical: float = 0.0012) -> list[JointBiasRow]:
    """Z up and y down: level gyros gain a quarter by the joint solution, vertical ones a fifth."""
    return [
        bias_row(position, gyro, single, joint, plateau)
        for position, up in (("z_up", "z"), ("y_down", "y"))
        for gyro in "xyz"
        for single, joint in [(vertical, 0.8 * vertical) if gyro == up else (level, 0.75 * level)]
    ]


def section_of(plateaus: list[JointPlateauRow], biases: list[JointBiasRow] | None = None) -> Section:
    section = joint_section(JointSigmas.of(bias_rows() if biases is None else biases), plateaus)
    assert section is not None
    return section


def test_gain_of_level_and_vertical_gyros_is_distinguished() -> None:
    section = section_of([plateau_row()])
    assert "level gyros by 25.0 % and of vertical gyros by 20.0 %" in section.paragraphs[0]
    gains, _ = section.tables
    assert gains.rows == [["1", "2.00", "1.50", "1.333", "1.20", "0.96", "1.250"]]
    assert len(gains.header) == len(gains.rows[0])


@pytest.mark.parametrize("joint", [0.00199999, 0.002, 0.0021])
def test_a_solution_that_gains_nothing_says_so(joint: float) -> None:
    rows = [replace(row, single_sigma_dph=0.002, joint_sigma_dph=joint) for row in bias_rows()]
    text = section_of([plateau_row()], rows).paragraphs[0]
    assert text.endswith("The joint solution does not reduce the uncertainties (medians).")
    half = [replace(row, joint_sigma_dph=0.001) if row.gyro == "x" else row for row in rows]
    assert (
        "level gyros by 50.0 % and of vertical gyros by 0 %"
        in (
            section_of(
                [plateau_row()], [row for row in half if row.gyro != "y" or row.position == "y_down"]
            ).paragraphs[0]
        )
    )


def test_rate_of_all_plateaus_is_stated_in_words() -> None:
    section = section_of([plateau_row(), plateau_row(2), plateau_row(0, up_rate_p_value=1.4e-6)])
    assert (
        "Over all plateaus the half-difference is (-3.28 ± 0.49) · 10⁻³ deg/h (p = 1e-6): the "
        "half-differences of up and down disagree: biases differ up and down" in section.paragraphs[1]
    )
    assert "latitude error of" not in section.paragraphs[1]


@pytest.mark.parametrize("finding", ["latitude", "not_contradicted"])
def test_a_rate_that_may_be_a_latitude_error_says_how_large_that_would_be(finding: str) -> None:
    text = section_of([plateau_row(finding=finding)]).paragraphs[1]
    assert "At this plateau the half-difference is" in text
    assert "Equivalent latitude error: +0.61 ± 0.11 arcmin; joint_biases.csv also has" in text


def test_without_a_pair_no_rate_is_stated() -> None:
    nothing = {"up_rate_dph": math.nan, "up_rate_sigma_dph": math.nan, "up_rate_p_value": math.nan}
    section = section_of([plateau_row(finding="no_pair", **nothing)])
    assert section.paragraphs[1].endswith("At this plateau: no gyro was vertical both up and down.")
    assert section.tables[1].rows[0][7] == ""
    assert "nan" not in str(section)


def test_one_gyro_has_nothing_to_be_compared_with() -> None:
    text = section_of([plateau_row(finding="one_gyro", up_rate_p_value=math.nan)]).paragraphs[1]
    assert "10⁻³ deg/h: only one gyro was vertical both up and down" in text


def test_plateaus_whose_dwells_do_not_agree_are_named() -> None:
    wrong = plateau_row(2, fit_p_value=1e-12, any_north_p_value=1e-12)
    section = section_of([plateau_row(), wrong, plateau_row(3, fit_p_value=2e-4)])
    assert [text[: text.index(":")] for text in section.paragraphs[2:]] == [
        "At plateau 2 dwells disagree on shared parameters (p < 1e-9)",
        "At plateau 3 dwells disagree on shared parameters (p = 2e-4)",
    ]
    assert "are invalid" in section.paragraphs[2]
    assert "the latitude error exceeds the declared uncertainty" in section.paragraphs[3]


def test_table_of_plateaus_has_values_with_uncertainties_and_a_row_of_all() -> None:
    last = {"chamber_set_c": math.nan, "north_rate_dph": math.nan, "fit_p_value": math.nan}
    last |= {f"accelerometer_{axis}_ug": math.nan for axis in "xyz"}
    _, table = section_of([plateau_row(), plateau_row(0, **last)]).tables
    assert table.rows == [
        ["1", "57", "4", "+2.4 ± 1.8", "-1.6 ± 1.8", "+1.5 ± 5.8", "-0.67 ± 0.83", "-3.28 ± 0.49", "0.980"],
        ["all", "", "4", "", "", "", "", "-3.28 ± 0.49", ""],
    ]  # fmt: skip
    assert len(table.header) == len(table.rows[0])


def test_accelerometers_that_the_dwells_do_not_show_are_empty() -> None:
    unknown = plateau_row(accelerometer_y_sigma_ug=100.0, accelerometer_z_sigma_ug=99.0)
    _, table = section_of([unknown]).tables
    assert table.rows[0][3:6] == ["+2.4 ± 1.8", "", "+1.5 ± 99.0"]


def test_zero_has_no_minus() -> None:
    _, table = section_of([plateau_row(accelerometer_x_ug=-0.01, north_rate_dph=-1e-7)]).tables
    assert table.rows[0][3] == "+0.0 ± 1.8"
    assert table.rows[0][6] == "+0.00 ± 0.83"


def test_each_plateau_has_its_gains() -> None:
    biases = [*bias_rows(1), *bias_rows(2, level=0.004)]
    gains, _ = section_of([plateau_row(), plateau_row(2), plateau_row(0)], biases).tables
    assert [row[:3] for row in gains.rows] == [["1", "2.00", "1.50"], ["2", "4.00", "3.00"]]


def test_there_is_no_section_without_either_table() -> None:
    assert joint_section({}, []) is None
    assert joint_section({}, [plateau_row()]) is None
    assert joint_section(JointSigmas.of(bias_rows()), []) is None
