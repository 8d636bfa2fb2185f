import math
from dataclasses import replace

import pytest

from gyrobench.bench.report.calibration_check_section import (
    calibration_check_section,
    calibration_check_sentence,
    dwells_text,
    table_rows,
)
from gyrobench.bench.report.terminal.tables import section_view
from gyrobench.bench.runs.tables.calibration_check_table import CalibrationCheckRow
from tests.bench.report.plain_terminal import printed

NOTHING = math.nan
ROW = CalibrationCheckRow(
    unit="U7",
    run="R2",
    dwell=1,
    turned_dwell=None,
    cycle=1,
    position="y_up",
    azimuth_deg=0.0,
    gyro="z",
    method="velocity",
    temperature_c=-9.6,
    bias_dph=0.0142,
    sigma_dph=0.0015,
    paper_bias_dph=0.0127,
    paper_sigma_dph=0.0017,
    accelerometer_ug=30.0,
    accelerometer_sigma_ug=2.0,
    calibrated_dph=0.0137,
    calibrated_sigma_dph=0.0004,
    difference_dph=0.0005,
    difference_sigma_dph=0.00155,
    p_value=0.75,
)
ALIGNMENT = replace(
    ROW, method="alignment", gyro="x", turned_dwell=2, paper_bias_dph=NOTHING, paper_sigma_dph=NOTHING
)
CHANGED = replace(
    ROW, dwell=3, position="z_up", gyro="y", calibrated_dph=0.0042, difference_dph=0.01, p_value=1e-9
)
UNCALIBRATED = replace(
    ROW,
    calibrated_dph=NOTHING,
    calibrated_sigma_dph=NOTHING,
    difference_dph=NOTHING,
    difference_sigma_dph=NOTHING,
    p_value=NOTHING,
)
FLAGGED = CalibrationCheckRow(
    "U7", "R2", 5, None, 1, "z_up", 180.0, "y", "velocity", flags=("the INS left navigation",)
)


def paragraphs(rows):
    return " ".join(calibration_check_section(rows).paragraphs)


def test_agreement_is_stated_with_the_largest_difference():
    assert calibration_check_sentence([ROW, ALIGNMENT]) == (
        "All 2 biases agree with the calibration (no p < 0.01, corrected for 2 comparisons). The largest "
        "difference, measured minus calibrated, is 0.0005 ± 0.0015 deg/h (+0.3 standard uncertainties): "
        "Z gyro in Y-Up 0° at -10 °C, by velocity."
    )
    assert calibration_check_sentence([ROW]).startswith(
        "The bias agrees with the calibration (no p < 0.01, one"
    )


def test_differences_are_stated():
    sentence = calibration_check_sentence([ROW, CHANGED, ALIGNMENT])
    assert sentence.startswith("1 of 3 biases differs from the calibration (p < 0.01, corrected for 3")
    assert "is 0.0100 ± 0.0015 deg/h (+6.5 standard uncertainties): Y gyro in Z-Up 0°" in sentence


def test_every_comparison_is_one_more_chance_to_differ_by_chance():
    rare = replace(ROW, p_value=0.004)
    assert calibration_check_sentence([rare]).startswith(
        "The bias differs from the calibration (p < 0.01, one"
    )
    assert "All 3 biases agree" in calibration_check_sentence([rare, ROW, ROW])


def test_what_could_not_be_compared_is_counted():
    assert calibration_check_sentence([ROW, UNCALIBRATED, FLAGGED, FLAGGED]).endswith(
        "Not compared: 1 without a calibrated bias near in position and temperature, 2 with flags."
    )
    assert calibration_check_sentence([FLAGGED]) == (
        "No bias could be compared with a calibrated one. Not compared: 1 with flags."
    )


def test_the_table_holds_every_bias_beside_the_calibrated_one():
    (table,) = calibration_check_section([ROW, ALIGNMENT, CHANGED, UNCALIBRATED]).tables
    assert "in 0.001 deg/h" in table.caption
    assert [tuple(row) for row in table.rows] == [
        ("Y-Up 0°", "Z", "velocity", "-9.6", "14.2 ± 1.5", "12.7 ± 1.7", "13.7 ± 0.4", "+0.3"),
        ("Y-Up 0/180°", "X", "alignment", "-9.6", "14.2 ± 1.5", "", "13.7 ± 0.4", "+0.3"),
        ("Z-Up 0°", "Y", "velocity", "-9.6", "14.2 ± 1.5", "12.7 ± 1.7", "4.2 ± 0.4", "+6.5*"),
        ("Y-Up 0°", "Z", "velocity", "-9.6", "14.2 ± 1.5", "12.7 ± 1.7", "", ""),
    ]
    assert {len(row) for row in table.rows} == {len(table.header)}


def test_azimuths_distinguish_dwells_of_one_position():
    opposite = replace(ROW, dwell=2, azimuth_deg=180.0)
    pair = replace(ALIGNMENT, azimuth_deg=270.0)
    assert [line[0] for line in table_rows([ROW, opposite, pair])] == ["Y-Up 0°", "Y-Up 180°", "Y-Up 270/90°"]


def test_zero_has_no_minus():
    tiny = replace(ROW, bias_dph=-1e-8, paper_bias_dph=-1e-8, calibrated_dph=-1e-8, difference_dph=-1e-8)
    (line,) = table_rows([tiny])
    assert line[4:7] == ["0.0 ± 1.5", "0.0 ± 1.7", "0.0 ± 0.4"]
    assert line[7] == "+0.0"
    assert "-0.0" not in calibration_check_sentence([tiny])


def test_dwells_are_counted_regardless_of_the_number_of_their_biases():
    assert dwells_text([ROW, ALIGNMENT]) == "2 dwells for the calibration check"
    assert dwells_text([ROW]) == "1 dwell for the calibration check"


def test_flags_are_stated_with_their_place():
    biases, flags = calibration_check_section([ROW, FLAGGED]).tables
    assert biases.rows[1][-1] == "flagged"
    assert list(flags.rows) == [("dwell 5, Z-Up at 180 deg, Y gyro by velocity", "the INS left navigation")]


def test_the_text_says_what_is_in_no_uncertainty_and_what_was_assumed():
    text = paragraphs([ROW])
    assert "Turn-on bias is not included" in text
    assert "The paper states these two methods without details" in text
    assert "power-on" not in paragraphs([UNCALIBRATED])


@pytest.mark.parametrize(("sigma_ug", "is_explained"), [(2.0, False), (1000.0, True)])
def test_large_uncertainties_from_accelerometers_are_explained(sigma_ug, is_explained):
    text = paragraphs([ROW, replace(ROW, accelerometer_sigma_ug=sigma_ug), FLAGGED])
    assert ("For 1 of 2 biases the calibration has no bias of the accelerometer" in text) is is_explained
    assert ("100 µg appear as 0.0009 deg/h. The large uncertainties include 1000 µg" in text) is is_explained


def test_without_a_calibration_check_there_is_no_section():
    assert calibration_check_section([]) is None


def on_terminal(rows):
    return printed(section_view(calibration_check_section(rows)))


@pytest.mark.parametrize("bias_dph", [0.0142, -0.9876, -12.3456])
def test_it_fits_a_terminal_and_nothing_is_cut_off(bias_dph):
    rows = [
        replace(
            ROW,
            position="z_down",
            azimuth_deg=270.0,
            turned_dwell=2,
            bias_dph=bias_dph,
            paper_bias_dph=bias_dph,
            calibrated_dph=bias_dph,
        )
    ]
    text = on_terminal([*rows, FLAGGED])
    shown = f"{bias_dph:.4f}" if abs(bias_dph) > 1.0 else f"{1000.0 * bias_dph:.1f}"
    assert text.count(shown) == 3
    assert "+0.3" in text
    assert "flagged" in text
    assert "calibrated" in text
