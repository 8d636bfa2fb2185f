import io
from dataclasses import replace

import pytest
from rich.console import Console

from gyrobench.bench.report.calibration_check_section import calibration_check_section
from gyrobench.bench.report.terminal.tables import section_view
from tests.bench.report.test_calibration_check import ALIGNMENT, CHANGED, FLAGGED, ROW, UNCALIBRATED


def printed(rows):
    stream = io.StringIO()
    Console(file=stream, width=80).print(section_view(calibration_check_section(rows)))
    return stream.getvalue()


def test_each_bias_has_a_line():
    lines = [line.split() for line in printed([ROW, ALIGNMENT, CHANGED, UNCALIBRATED]).splitlines()]
    first = next(number for number, line in enumerate(lines) if line[:1] == ["Y-Up"])
    assert [" ".join(line).replace(" ± ", "±").split() for line in lines[first : first + 4]] == [
        ["Y-Up", "0°", "Z", "velocity", "-9.6", "14.2±1.5", "12.7±1.7", "13.7±0.4", "+0.3"],
        ["Y-Up", "0/180°", "X", "alignment", "-9.6", "14.2±1.5", "13.7±0.4", "+0.3"],
        ["Z-Up", "0°", "Y", "velocity", "-9.6", "14.2±1.5", "12.7±1.7", "4.2±0.4", "+6.5*"],
        ["Y-Up", "0°", "Z", "velocity", "-9.6", "14.2±1.5", "12.7±1.7"],
    ]


def test_the_finding_and_the_flags_stand_below():
    text = " ".join(printed([ROW, FLAGGED]).split())
    assert "The bias agrees with the calibration" in text
    assert "dwell 5, Z-Up at 180 deg, Y gyro by velocity the INS left navigation" in text


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
    text = printed([*rows, FLAGGED])
    assert max(map(len, text.splitlines())) <= 80
    assert "…" not in text
    shown = f"{bias_dph:.4f}" if abs(bias_dph) > 1.0 else f"{1000.0 * bias_dph:.1f}"
    assert text.count(shown) == 3
    assert "+0.3" in text
    assert "flagged" in text
    assert "calibrated" in text
