"""Calibration check in the report of a run: comparison of measured and calibrated biases."""

from __future__ import annotations

import math
from collections.abc import Sequence

from gyrobench.bench.foundations.text import counted, flag_text
from gyrobench.bench.navigation.positions import gyro_label, position_label
from gyrobench.bench.report.number_format import BiasScale, dph_with_sigma
from gyrobench.bench.report.page import Section, SectionTable
from gyrobench.bench.report.run_text import POSITION_SIGNIFICANCE
from gyrobench.bench.runs.tables.calibration_check_table import CalibrationCheckRow

_METHODS = (
    "The INS aligns itself and navigates without a turn. The headings of two alignments half a turn apart "
    "give the bias of the gyro that points East; the velocity after an alignment gives the bias of the gyro "
    "that points North, by the full error model. The second derivative of the East velocity alone, without "
    "Schuler loop and Earth rotation, is given for comparison. The paper states these two methods without "
    "details; azimuths, times, temperatures and the evaluation are chosen here."
)
_CALIBRATED = (
    "Calibrated biases are those of the same position, interpolated linearly between temperatures; their "
    "uncertainty includes the curvature. Turn-on bias is not included: after another power-on, a difference "
    "of that size is not an error of the calibration."
)
_UNKNOWN_ACCELEROMETERS = (
    "For {} of {} biases the calibration has no bias of the accelerometer along the gyro. At rest the two "
    "can't be distinguished: at middle latitudes 100 µg appear as 0.0009 deg/h. The large uncertainties "
    "include {:.0f} µg."
)
_LARGE_ACCELEROMETER_UG = 100.0
_HEADER = ("position", "gyro", "method", "gyro / °C", "bias", "by slope", "calibrated", "difference / σ")
_NOT_COMPARED = "No bias could be compared with a calibrated one."


def calibration_check_section(rows: Sequence[CalibrationCheckRow]) -> Section | None:
    """Table of measured and calibrated biases; None without any."""
    if not rows:
        return None
    flags = [
        (
            f"dwell {row.dwell}, {position_label(row.position)} at {row.azimuth_deg:g} deg, "
            f"{gyro_label(row.gyro)} by {row.method}",
            flag_text(row.flags),
        )
        for row in rows
        if row.flags
    ]
    caption = (
        f"Biases ± standard uncertainty in {_scale(rows).unit}. Difference: measured minus "
        "calibrated in combined standard uncertainties; * significant"
    )
    tables = [SectionTable(caption, _HEADER, table_rows(rows), words=3)]
    tables += [SectionTable("Flagged", ["dwell", "flag"], flags, words=2)] if flags else []
    paragraphs = [calibration_check_sentence(rows), _METHODS]
    if any(not math.isnan(row.calibrated_dph) for row in rows):
        paragraphs.append(_CALIBRATED)
    sigmas_ug = [row.accelerometer_sigma_ug for row in rows if not row.flags]
    if large := [sigma for sigma in sigmas_ug if sigma > _LARGE_ACCELEROMETER_UG]:
        paragraphs.append(_UNKNOWN_ACCELEROMETERS.format(len(large), len(sigmas_ug), max(large)))
    return Section("Calibration check", paragraphs, tables=tables)


def calibration_check_sentence(rows: Sequence[CalibrationCheckRow]) -> str:
    """Number of biases that agree with the calibration, and the largest difference."""
    compared = [row for row in rows if row.is_compared]
    flagged = sum(bool(row.flags) for row in rows)
    uncalibrated = len(rows) - len(compared) - flagged
    left_out = [
        f"{uncalibrated} without a calibrated bias near in position and temperature" if uncalibrated else "",
        f"{flagged} with flags" if flagged else "",
    ]
    reasons = ", ".join(text for text in left_out if text)
    return (_agreement_sentence(compared) if compared else _NOT_COMPARED) + (
        f" Not compared: {reasons}." if reasons else ""
    )


def _scale(rows: Sequence[CalibrationCheckRow]) -> BiasScale:
    """Choose unit and decimals for the biases of a calibration check."""
    return BiasScale.of(
        [bias for row in rows for bias in (row.bias_dph, row.paper_bias_dph, row.calibrated_dph)],
        [sigma for row in rows for sigma in (row.sigma_dph, row.calibrated_sigma_dph)],
    )


def table_rows(rows: Sequence[CalibrationCheckRow]) -> list[list[str]]:
    """Rows with the columns of :data:`_HEADER`; a star marks a significant difference."""
    scale = _scale(rows)
    significant = _significant_differences(rows)
    return [
        [
            _alignment_label(row),
            row.gyro.upper(),
            row.method,
            "" if math.isnan(row.temperature_c) else f"{row.temperature_c:.1f}",
            scale.with_sigma(row.bias_dph, row.sigma_dph),
            scale.with_sigma(row.paper_bias_dph, row.paper_sigma_dph),
            scale.with_sigma(row.calibrated_dph, row.calibrated_sigma_dph),
            _difference_cell(row, row in significant),
        ]
        for row in rows
    ]


def _alignment_label(row: CalibrationCheckRow) -> str:
    """Position and azimuth, with both azimuths for a pair of alignments: "Z-Up 180°", "Z-Up 0/180°"."""
    azimuths_deg = [row.azimuth_deg]
    if row.turned_dwell is not None:
        azimuths_deg.append((row.azimuth_deg + 180.0) % 360.0)
    return f"{position_label(row.position)} {'/'.join(f'{azimuth:g}' for azimuth in azimuths_deg)}°"


def dwells_text(rows: Sequence[CalibrationCheckRow]) -> str:
    """Number of dwells: "12 dwells for the calibration check"."""
    dwells = {row.dwell for row in rows} | {row.turned_dwell for row in rows if row.turned_dwell}
    return f"{counted(len(dwells), 'dwell')} for the calibration check"


def _agreement_sentence(compared: Sequence[CalibrationCheckRow]) -> str:
    count, different = len(compared), len(_significant_differences(compared))
    corrected = f"corrected for {count} comparisons" if count > 1 else "one comparison"
    if different:
        verb = "differs" if different == 1 else "differ"
        subject = f"{different} of {count} biases {verb}" if count > 1 else "The bias differs"
        result = f"{subject} from the calibration (p < {POSITION_SIGNIFICANCE:g}, {corrected})."
    else:
        subject = f"All {count} biases agree" if count > 1 else "The bias agrees"
        result = f"{subject} with the calibration (no p < {POSITION_SIGNIFICANCE:g}, {corrected})."
    largest = max(compared, key=lambda row: abs(row.difference_dph))
    return (
        f"{result} The largest difference, measured minus calibrated, is "
        f"{dph_with_sigma(largest.difference_dph, largest.difference_sigma_dph)} "
        f"({_normalised_difference(largest):+z.1f} standard uncertainties): {gyro_label(largest.gyro)} in "
        f"{_alignment_label(largest)} at {largest.temperature_c:.0f} °C, by {largest.method}."
    )


def _significant_differences(rows: Sequence[CalibrationCheckRow]) -> list[CalibrationCheckRow]:
    """Rows with a significant difference, corrected for the number of comparisons (Bonferroni)."""
    compared = [row for row in rows if row.is_compared]
    return [row for row in compared if row.p_value < POSITION_SIGNIFICANCE / len(compared)]


def _normalised_difference(row: CalibrationCheckRow) -> float:
    return row.difference_dph / row.difference_sigma_dph


def _difference_cell(row: CalibrationCheckRow, is_significant: bool) -> str:
    if row.flags:
        return "flagged"
    return f"{_normalised_difference(row):+z.1f}{'*' if is_significant else ''}" if row.is_compared else ""
