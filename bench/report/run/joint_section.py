"""What the report says of the dwells of each temperature solved together."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from gyrobench.bench.bias.vertical_pairs import Finding
from gyrobench.bench.navigation.positions import AXES, POSITIONS
from gyrobench.bench.report.page.sections import Section, SectionTable
from gyrobench.bench.report.wording import p_text
from gyrobench.bench.runs.tables.joint_table import JointBiasRow, JointStopRow

_TOGETHER = (
    "At each stop of the chamber the dwells are also solved together: they share accelerometer biases, "
    "the errors of the gyros' axes and any rate that is fixed in the navigation frame. The gyro biases of "
    "each dwell stay its own."
)
_UP = (
    "A rate Up that nobody declared, from a wrong latitude for instance, adds to the bias of a vertical gyro "
    "that points up and takes from it when it points down: half the sum of the two is the bias, half their "
    "difference the rate, if the bias is the same both ways."
)
_LATITUDE = (
    "they do once a rate North is allowed, so the latitude is wrong by more than declared. The biases "
    "without the rate Up are right where it applies; check the latitude that station and INS have."
)
_NOT_TRUSTED = "the joint biases of this stop are not to be trusted."
_WRONG_FIT_P = 1e-3
#: An accelerometer known no better has only what was known of it before.
_UNKNOWN_ACCELEROMETER_UG = 100.0


def joint_section(biases: Sequence[JointBiasRow], stops: Sequence[JointStopRow]) -> Section | None:
    """Tell what solving together gives; None where nothing was, or a table is missing."""
    if not (biases and stops):
        return None
    return Section(
        "All dwells of one temperature together",
        [f"{_TOGETHER} {_gain_sentence(biases)}", f"{_UP} {_finding_sentence(stops)}", *_misfits(stops)],
        tables=[_gain_table(biases), _stop_table(stops)],
    )


def _gain_sentence(rows: Sequence[JointBiasRow]) -> str:
    level, vertical = (
        _smaller(float(np.median([row.gain for row in rows if _is_vertical(row) is wanted])))
        for wanted in (False, True)
    )
    if not (level or vertical):
        return "That makes the uncertainty of neither level nor vertical gyros smaller (medians)."
    return (
        f"That makes the uncertainty of level gyros {level or 'no'} smaller and that of vertical ones "
        f"{vertical or 'no'} smaller (medians)."
    )


def _smaller(gain: float) -> str:
    """Write by how much; empty where it rounds to nothing."""
    text = f"{100.0 * (1.0 - 1.0 / gain):.1f}"
    return f"{text} %" if float(text) > 0.0 else ""


def _is_vertical(row: JointBiasRow) -> bool:
    return AXES[POSITIONS[row.position].up_axis] == row.gyro


def _finding_sentence(stops: Sequence[JointStopRow]) -> str:
    last = stops[-1]
    finding = Finding[last.finding.upper()]
    where = "Over all stops" if last.stop == 0 else "At this stop"
    if finding is Finding.NO_PAIR:
        return f"{where}: {finding.value}."
    rate = f"{1e3 * last.up_rate_dph:+.2f} ± {1e3 * last.up_rate_sigma_dph:.2f} · 10⁻³ deg/h"
    latitude = f"{last.latitude_error_arcmin:+.2f} ± {last.latitude_error_sigma_arcmin:.2f} arcmin"
    p_value = _p_in_brackets(last.up_rate_p_value)
    text = f"{where} the half-differences amount to {rate}{p_value}: {finding.value}."
    if finding in (Finding.LATITUDE, Finding.NOT_CONTRADICTED):
        text += (
            f" It would be a latitude error of {latitude}; joint_biases.csv also holds the biases without it."
        )
    return text


def _misfits(stops: Sequence[JointStopRow]) -> list[str]:
    return [
        f"At stop {row.stop} the dwells do not agree on what they share{_p_in_brackets(row.fit_p_value)}: "
        + (_LATITUDE if row.any_north_p_value >= _WRONG_FIT_P else _NOT_TRUSTED)
        for row in stops
        if row.fit_p_value < _WRONG_FIT_P
    ]


def _p_in_brackets(p_value: float) -> str:
    """Write " (p = 0.012)" or " (p <1e-09)"; empty where nothing was compared."""
    text = p_text(p_value)
    return text and f" (p {text if text.startswith('<') else f'= {text}'})"


def _gain_table(rows: Sequence[JointBiasRow]) -> SectionTable:
    stops = sorted({row.stop for row in rows})
    cells = []
    for stop in stops:
        own = [row for row in rows if row.stop == stop]
        cells.append([str(stop)])
        for vertical in (False, True):
            chosen = [row for row in own if _is_vertical(row) is vertical]
            cells[-1] += [
                f"{1e3 * float(np.median([row.single_sigma_dph for row in chosen])):.2f}",
                f"{1e3 * float(np.median([row.joint_sigma_dph for row in chosen])):.2f}",
                f"{float(np.median([row.gain for row in chosen])):.3f}",
            ]
    return SectionTable(
        "Median uncertainty of a bias by itself and solved together, 10⁻³ deg/h, and their ratio",
        [
            *("stop", "level, by itself", "level, together", "gain"),
            *("vertical, by itself", "vertical, together", "gain"),
        ],
        cells,
    )


def _stop_table(stops: Sequence[JointStopRow]) -> SectionTable:
    return SectionTable(
        "What the dwells of each stop share: accelerometer biases in µg where the "
        "dwells tell them, rates in 10⁻³ deg/h, p of the fit",
        ["stop", "chamber °C", "dwells", "x", "y", "z", "rate North", "rate Up", "p"],
        [
            [
                "all" if row.stop == 0 else str(row.stop),
                "" if math.isnan(row.chamber_set_c) else f"{row.chamber_set_c:g}",
                str(row.dwells),
                *(
                    _accelerometer(
                        getattr(row, f"accelerometer_{axis}_ug"),
                        getattr(row, f"accelerometer_{axis}_sigma_ug"),
                    )
                    for axis in AXES
                ),
                _with_sigma(1e3 * row.north_rate_dph, 1e3 * row.north_rate_sigma_dph, 2),
                _with_sigma(1e3 * row.up_rate_dph, 1e3 * row.up_rate_sigma_dph, 2),
                "" if math.isnan(row.fit_p_value) else p_text(row.fit_p_value),
            ]
            for row in stops
        ],
    )


def _accelerometer(bias_ug: float, sigma_ug: float) -> str:
    return "" if sigma_ug >= _UNKNOWN_ACCELEROMETER_UG else _with_sigma(bias_ug, sigma_ug, 1)


def _with_sigma(value: float, sigma: float, decimals: int) -> str:
    return "" if math.isnan(value) else f"{value:+z.{decimals}f} ± {sigma:.{decimals}f}"
