"""What the report says of the estimators."""

import math
from dataclasses import replace

import pytest

from gyrobench.bench.report.estimator_sections import (
    estimators_note,
    estimators_section,
    fit_section,
    joint_section,
    noise_section,
)
from gyrobench.bench.report.figures.style import png_bytes
from gyrobench.bench.runs.tables.joint_table import JointBiasRow, JointPlateauRow, JointSigmas
from tests.bench.report.made_up_noise import made_up_noise


def test_table_names_the_dwell_in_which_the_estimators_differ_most(dwells):
    x, y, z = dwells[20].bias_dph
    apart = replace(dwells[20], paper_bias_dph=(x, y - 0.05, z))
    section = estimators_section([*dwells[:20], apart])
    (table,) = section.tables
    assert [row[0] for row in table.rows] == ["X gyro", "Y gyro", "Z gyro"]
    assert table.rows[1][1] == f"Y-Up, {apart.gyro_c[1]:.0f} °C, dwell 21"
    assert table.rows[1][3].startswith("-50.0 ± 1.")
    assert all(len(row) == len(table.header) for row in table.rows)


def test_rms_is_that_of_the_leaks(dwells):
    section = estimators_section(dwells)
    assert [float(row[2]) for row in section.tables[0].rows] == pytest.approx([3.3] * 3, abs=0.3)


def test_single_dwell_has_a_table_and_no_picture(dwells):
    section = estimators_section(dwells[:1])
    assert section.figures == []
    assert section.tables[0].caption.endswith("over 1 dwell")
    both = estimators_section(dwells[:2])
    assert len(both.figures) == 1


@pytest.mark.parametrize(("count", "has_band"), [(4, False), (5, True)])
def test_caption_of_the_fit_states_what_is_drawn(dwells, count, has_band):
    section = fit_section(dwells[:count])
    (drawn,) = section.figures
    assert ("a probability of 1 %" in drawn.caption) is has_band
    assert ("Right:" in drawn.caption) is has_band


def test_sections_are_there_where_there_is_something_to_say(dwells, old_dwells):
    assert estimators_section(old_dwells) is None
    assert fit_section(old_dwells) is None
    assert fit_section(dwells) is not None
    assert estimators_section([]) is None
    assert estimators_note([]) == ""


def plateau_row(plateau=1, finding="different", **changed):
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
    return JointPlateauRow(plateau=plateau, cycle=1, finding=finding, **{**values, "dwells": 4, **changed})


def bias_row(position, gyro, single_dph, joint_dph, plateau=1):
    """One whose uncertainties are these."""
    return JointBiasRow(plateau, 1, position, gyro, 25.0, 0.0, single_dph, 0.0, joint_dph, math.nan, math.nan)


def bias_rows(plateau=1, level=0.002, vertical=0.0012):
    """Z up and y down: level gyros gain a quarter by the joint solution, vertical ones a fifth."""
    return [
        bias_row(position, gyro, single, joint, plateau)
        for position, up in (("z_up", "z"), ("y_down", "y"))
        for gyro in "xyz"
        for single, joint in [(vertical, 0.8 * vertical) if gyro == up else (level, 0.75 * level)]
    ]


def joint_section_of(plateaus, biases=None):
    return joint_section(JointSigmas.of(bias_rows() if biases is None else biases), plateaus)


def test_gain_of_level_and_vertical_gyros_is_distinguished():
    section = joint_section_of([plateau_row()])
    assert "level gyros by 25.0 % and of vertical gyros by 20.0 %" in section.paragraphs[0]
    gains, _ = section.tables
    assert gains.rows == [["1", "2.00", "1.50", "1.333", "1.20", "0.96", "1.250"]]
    assert len(gains.header) == len(gains.rows[0])


@pytest.mark.parametrize("joint", [0.00199999, 0.002, 0.0021])
def test_a_solution_that_gains_nothing_says_so(joint):
    rows = [replace(row, single_sigma_dph=0.002, joint_sigma_dph=joint) for row in bias_rows()]
    section = joint_section_of([plateau_row()], rows)
    assert [table.header[1] for table in section.tables] == ["chamber °C"]
    text = section.paragraphs[0]
    assert text.endswith("The joint solution does not reduce the uncertainties (medians).")
    half = [replace(row, joint_sigma_dph=0.001) if row.gyro == "x" else row for row in rows]
    assert (
        "level gyros by 50.0 % and of vertical gyros by 0 %"
        in (
            joint_section_of(
                [plateau_row()], [row for row in half if row.gyro != "y" or row.position == "y_down"]
            ).paragraphs[0]
        )
    )


def test_rate_of_all_plateaus_is_stated_in_words():
    section = joint_section_of([plateau_row(), plateau_row(2), plateau_row(0, up_rate_p_value=1.4e-6)])
    assert (
        "Over all plateaus the half-difference is (-3.28 ± 0.49) · 10⁻³ deg/h (p = 1e-6): the "
        "half-differences of up and down disagree: biases differ up and down" in section.paragraphs[1]
    )
    assert "latitude error of" not in section.paragraphs[1]


@pytest.mark.parametrize("finding", ["latitude", "not_contradicted"])
def test_a_rate_that_may_be_a_latitude_error_says_how_large_that_would_be(finding):
    text = joint_section_of([plateau_row(finding=finding)]).paragraphs[1]
    assert "At this plateau the half-difference is" in text
    assert "Equivalent latitude error: +0.61 ± 0.11 arcmin; joint_biases.csv also has" in text


def test_without_a_pair_no_rate_is_stated():
    nothing = {"up_rate_dph": math.nan, "up_rate_sigma_dph": math.nan, "up_rate_p_value": math.nan}
    section = joint_section_of([plateau_row(finding="no_pair", **nothing)])
    assert section.paragraphs[1].endswith("At this plateau: no gyro was vertical both up and down.")
    assert section.tables[1].rows[0][7] == ""
    assert "nan" not in str(section)


def test_one_gyro_has_nothing_to_be_compared_with():
    text = joint_section_of([plateau_row(finding="one_gyro", up_rate_p_value=math.nan)]).paragraphs[1]
    assert "10⁻³ deg/h: only one gyro was vertical both up and down" in text


def test_plateaus_whose_dwells_do_not_agree_are_named():
    wrong = plateau_row(2, fit_p_value=1e-12, any_north_p_value=1e-12)
    section = joint_section_of([plateau_row(), wrong, plateau_row(3, fit_p_value=2e-4)])
    assert [text[: text.index(":")] for text in section.paragraphs[2:]] == [
        "At plateau 2 dwells disagree on shared parameters (p < 1e-9, corrected for 3 plateaus)",
        "At plateau 3 dwells disagree on shared parameters (p = 6e-4, corrected for 3 plateaus)",
    ]
    assert "are invalid" in section.paragraphs[2]
    assert "the latitude error exceeds the declared uncertainty" in section.paragraphs[3]


def test_a_plateau_of_one_dwell_shares_nothing():
    alone = plateau_row(2, dwells=1, fit_p_value=1e-5, any_north_p_value=1e-5)
    section = joint_section_of([plateau_row(), alone])
    assert [row[0] for row in section.tables[1].rows] == ["1"]
    assert len(section.paragraphs) == 2
    assert joint_section_of([alone, plateau_row(0, dwells=2)]) is None
    latitude = replace(alone, any_north_p_value=0.3)
    assert (
        joint_section_of([latitude])
        .paragraphs[-1]
        .startswith(
            "At plateau 2 dwell and declared latitude disagree (p = 1e-5): with a free rate North they agree"
        )
    )


def test_table_of_plateaus_has_values_with_uncertainties_and_a_row_of_all():
    last = {"chamber_set_c": math.nan, "north_rate_dph": math.nan, "fit_p_value": math.nan}
    last |= {f"accelerometer_{axis}_ug": math.nan for axis in "xyz"}
    _, table = joint_section_of([plateau_row(), plateau_row(0, **last)]).tables
    assert table.rows == [
        ["1", "57", "4", "+2.4 ± 1.8", "-1.6 ± 1.8", "+1.5 ± 5.8", "-0.67 ± 0.83", "-3.28 ± 0.49", "0.980"],
        ["all", "", "4", "", "", "", "", "-3.28 ± 0.49", ""],
    ]  # fmt: skip
    assert len(table.header) == len(table.rows[0])


def test_accelerometers_that_the_dwells_do_not_show_are_empty():
    unknown = plateau_row(accelerometer_y_sigma_ug=100.0, accelerometer_z_sigma_ug=99.0)
    _, table = joint_section_of([unknown]).tables
    assert table.rows[0][3:6] == ["+2.4 ± 1.8", "", "+1.5 ± 99.0"]


def test_zero_has_no_minus():
    _, table = joint_section_of([plateau_row(accelerometer_x_ug=-0.01, north_rate_dph=-1e-7)]).tables
    assert table.rows[0][3] == "+0.0 ± 1.8"
    assert table.rows[0][6] == "+0.00 ± 0.83"


def test_each_plateau_has_its_gains():
    biases = [*bias_rows(1), *bias_rows(2, level=0.004)]
    gains, _ = joint_section_of([plateau_row(), plateau_row(2), plateau_row(0)], biases).tables
    assert [row[:3] for row in gains.rows] == [["1", "2.00", "1.50"], ["2", "4.00", "3.00"]]


def test_there_is_no_section_without_either_table():
    assert joint_section({}, []) is None
    assert joint_section({}, [plateau_row()]) is None
    assert joint_section(JointSigmas.of(bias_rows()), []) is None


@pytest.fixture(scope="module")
def noise():
    """Random walks of 0.001 deg/sqrt(h) and 20 ug/sqrt(Hz)."""
    return made_up_noise()


def station(**noise):
    return {"ins": {"noise": noise}}


def verdicts(section):
    (table,) = section.tables
    assert all(len(row) == len(table.header) for row in table.rows)
    return dict(table.rows)


def test_measured_noise_stands_beside_the_declared_one(noise):
    section = noise_section(
        noise, station(angle_random_walk_deg_per_sqrt_h=0.001, velocity_random_walk_ug_per_sqrt_hz=5.0)
    )
    found = verdicts(section)
    assert [name for name in found if name.startswith("angle random walk of the")] == [
        f"angle random walk of the {axis} gyro" for axis in "xyz"
    ]
    of_all = found["angle random walk of all gyros"]
    assert of_all.startswith("0.00")
    assert of_all.endswith("deg/sqrt(h), declared 0.001 deg/sqrt(h): consistent")
    assert found["velocity random walk"].endswith("declared 5 ug/sqrt(Hz): larger than declared")


def test_what_the_station_does_not_declare_has_no_row(noise):
    found = verdicts(noise_section(noise, station(angle_random_walk_deg_per_sqrt_h=0.001)))
    assert "velocity random walk" not in found
    assert "noise of the velocity output" not in found


def test_declared_noise_of_the_output_is_compared_in_its_own_units(noise):
    found = verdicts(
        noise_section(
            noise,
            station(
                angle_random_walk_deg_per_sqrt_h=0.01, velocity_output_mps=0.002, heading_output_deg=0.001
            ),
        )
    )
    assert found["angle random walk of all gyros"].endswith("smaller than declared")
    assert "declared 0.002 m/s" in found["noise of the velocity output"]
    assert "declared 17.5 urad" in found["noise of the attitude output"]


def test_without_a_declared_noise_the_text_says_whose_was_used(noise):
    section = noise_section(noise, {"ins": {"noise": "estimated"}})
    assert section.tables == []
    assert section.paragraphs[0].endswith(
        "each dwell was evaluated with the noise estimated from its windows."
    )
    declared = noise_section(noise, station(angle_random_walk_deg_per_sqrt_h=0.001))
    assert "declares no noise" not in declared.paragraphs[0]


@pytest.mark.parametrize("content", [{}, {"ins": {}}])
def test_a_station_that_is_missing_still_gives_the_figure(noise, content):
    section = noise_section(noise, content)
    (drawn,) = section.figures
    assert drawn.name == "noise"
    figure = drawn.figure()
    assert len(figure.axes) == 2
    assert png_bytes(figure).startswith(b"\x89PNG")


def test_there_is_no_section_without_an_estimate():
    assert noise_section(None, station(angle_random_walk_deg_per_sqrt_h=0.001)) is None
