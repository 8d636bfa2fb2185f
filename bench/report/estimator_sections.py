"""Estimators in the report of a run: their difference, the fit, the joint solution, the noise of the INS."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from gyrobench.bench.bias.dwell_table import DwellRow, paper_rows
from gyrobench.bench.bias.noise_estimate import NoiseEstimate, compare_noise
from gyrobench.bench.bias.noise_model import NoiseModel
from gyrobench.bench.bias.vertical_pairs import Finding
from gyrobench.bench.foundations.text import counted
from gyrobench.bench.navigation.positions import AXES, POSITIONS, gyro_label, position_label
from gyrobench.bench.report.figures.estimators import (
    differences_dph,
    estimators_figure,
    fit_figure,
    has_distribution,
    with_both,
)
from gyrobench.bench.report.figures.noise import noise_figure
from gyrobench.bench.report.number_format import NO_PAPER, BiasScale, p_text
from gyrobench.bench.report.page import Section, SectionFigure, SectionTable
from gyrobench.bench.report.statements import SIGNIFICANCE, fit_sentence
from gyrobench.bench.runs.tables.joint_table import JointBiasRow, JointPlateauRow

_STATE_SPACE = (
    "Biases are those of the state-space estimator: it fits the full error model of an INS at rest, "
    "with Schuler loop, Earth rate, accelerometer biases and initial errors, to velocity and heading of"
    " a whole dwell. Its uncertainty holds the noise and what is not known of unit and bench."
)
_PAPER = (
    "What the paper's method makes of the same data stands beside them in grey: quadratic fits of the "
    "velocities and slopes of the heading, before and after a turn of 180 deg. Its uncertainty is that "
    "of the noise alone."
)
_UNKNOWN = "The dwell table does not tell by which estimator these biases were measured."
_LEAKS = (
    "The paper's method leaves out that the errors of an INS are coupled. Over windows of ten minutes "
    "it reads a level bias 8 to 17 % wrong, because the Schuler loop feeds velocity back into tilt; up "
    "to 20 % of one axis leaks into another, because the Earth's rotation couples them; and 10 µg of "
    "accelerometer bias pass for up to 0.001 deg/h. In each position the same bias leaks differently, "
    "so a difference between positions that only the paper's method finds may be its own. The "
    "state-space estimator has all this in its model."
)
_DIFFERENCES = (
    "The paper's bias less the state-space one, dwell by dwell. Bars are the uncertainties of both "
    "combined; as both come from the same data, noise alone keeps them closer together than that. "
    "Points beyond their bars are what the paper's method leaves out."
)
_FIT = (
    "In each dwell the residuals of velocity and heading, summed minute by minute, are compared with "
    "the noise: a wrong model leaves residuals that are slow, and these add up."
)
_FIT_SIZES = "Size of the residuals of each dwell, 1 where model and noise are true."
_FIT_P_VALUES = (
    f"Left: {_FIT_SIZES[0].lower()}{_FIT_SIZES[1:]} Right: share of the dwells whose p-value is below a "
    "value; the straight line where model and noise are true, the grey band what chance makes of it in "
    f"{100 * (1 - SIGNIFICANCE):.0f} of 100 runs."
)


def estimators_note(rows: Sequence[DwellRow]) -> str:
    """Say by which estimator the biases of the report are."""
    if paper_rows(rows):
        return f"{_STATE_SPACE} {_PAPER}"
    if any(not math.isnan(row.fit_p_value) for row in rows):
        return f"{_STATE_SPACE} {NO_PAPER}"
    return _UNKNOWN if rows else ""


def estimators_section(rows: Sequence[DwellRow], marked_c: Sequence[float] = ()) -> Section | None:
    """Compare the estimators; None where no good dwell has both."""
    both = with_both(rows)
    if not both:
        return None
    # A single dwell has no course to draw: the table says it all.
    drawn = (
        [SectionFigure("estimators", _DIFFERENCES, estimators_figure(both, marked_c))]
        if len(both) > 1
        else []
    )
    return Section("The two estimators", [_LEAKS], drawn, [_difference_table(both)])


def fit_section(rows: Sequence[DwellRow]) -> Section | None:
    """Tell whether model and noise explain the data; None where no dwell was tested."""
    sentence = fit_sentence(rows)
    if not sentence:
        return None
    caption = _FIT_P_VALUES if has_distribution(rows) else _FIT_SIZES
    return Section(
        "Does the model explain the data?",
        [_FIT, sentence],
        [SectionFigure("fit", caption, fit_figure(rows))],
    )


def _difference_table(rows: Sequence[DwellRow]) -> SectionTable:
    pairs = [differences_dph(row) for row in rows]
    scale = BiasScale.of(*zip(*(pair for three in pairs for pair in three), strict=True))
    cells = []
    for axis, gyro in enumerate(AXES):
        own = [three[axis] for three in pairs]
        rms_dph = math.sqrt(sum(difference**2 for difference, _ in own) / len(own))
        largest, row = max(zip(own, rows, strict=True), key=lambda each: abs(each[0][0]))
        where = f"{position_label(row.position)}, {row.gyro_c[axis]:.0f} °C, dwell {row.dwell}"
        cells.append([gyro_label(gyro), where, scale.text(rms_dph), scale.with_sigma(*largest)])
    return SectionTable(
        f"The paper's bias less the state-space one in {scale.unit}, over {counted(len(rows), 'dwell')}",
        ["gyro", "largest in", "rms", "largest ± combined uncertainty"],
        cells,
        words=2,
    )


_TOGETHER = (
    "On each plateau the dwells are also solved together: they share accelerometer biases, "
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
_NOT_TRUSTED = "the joint biases of this plateau are not to be trusted."
_WRONG_FIT_P = 1e-3
#: An accelerometer known no better has only what was known of it before.
_UNKNOWN_ACCELEROMETER_UG = 100.0


def joint_section(biases: Sequence[JointBiasRow], plateaus: Sequence[JointPlateauRow]) -> Section | None:
    """Tell what solving together gives; None where nothing was, or a table is missing."""
    if not (biases and plateaus):
        return None
    return Section(
        "All dwells of one temperature together",
        [
            f"{_TOGETHER} {_gain_sentence(biases)}",
            f"{_UP} {_finding_sentence(plateaus)}",
            *_misfits(plateaus),
        ],
        tables=[_gain_table(biases), _plateau_table(plateaus)],
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


def _finding_sentence(plateaus: Sequence[JointPlateauRow]) -> str:
    last = plateaus[-1]
    finding = Finding[last.finding.upper()]
    where = "Over all plateaus" if last.plateau == 0 else "On this plateau"
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


def _misfits(plateaus: Sequence[JointPlateauRow]) -> list[str]:
    return [
        f"On plateau {row.plateau} the dwells do not agree on what they share"
        f"{_p_in_brackets(row.fit_p_value)}: "
        + (_LATITUDE if row.any_north_p_value >= _WRONG_FIT_P else _NOT_TRUSTED)
        for row in plateaus
        if row.fit_p_value < _WRONG_FIT_P
    ]


def _p_in_brackets(p_value: float) -> str:
    """Write " (p = 0.012)" or " (p <1e-9)"; empty where nothing was compared."""
    text = p_text(p_value)
    return text and f" (p {text if text.startswith('<') else f'= {text}'})"


def _gain_table(rows: Sequence[JointBiasRow]) -> SectionTable:
    plateaus = sorted({row.plateau for row in rows})
    cells = []
    for plateau in plateaus:
        own = [row for row in rows if row.plateau == plateau]
        cells.append([str(plateau)])
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
            *("plateau", "level, by itself", "level, together", "gain"),
            *("vertical, by itself", "vertical, together", "gain"),
        ],
        cells,
    )


def _plateau_table(plateaus: Sequence[JointPlateauRow]) -> SectionTable:
    return SectionTable(
        "What the dwells of each plateau share: accelerometer biases in µg where the "
        "dwells tell them, rates in 10⁻³ deg/h, p of the fit",
        ["plateau", "chamber °C", "dwells", "x", "y", "z", "rate North", "rate Up", "p"],
        [
            [
                "all" if row.plateau == 0 else str(row.plateau),
                "" if math.isnan(row.chamber_set_c) else f"{row.chamber_set_c:g}",
                str(row.dwells),
                *(
                    _accelerometer(
                        getattr(row, f"accelerometer_{axis}_ug"),
                        getattr(row, f"accelerometer_{axis}_sigma_ug"),
                    )
                    for axis in AXES
                ),
                _signed(1e3 * row.north_rate_dph, 1e3 * row.north_rate_sigma_dph, 2),
                _signed(1e3 * row.up_rate_dph, 1e3 * row.up_rate_sigma_dph, 2),
                "" if math.isnan(row.fit_p_value) else p_text(row.fit_p_value),
            ]
            for row in plateaus
        ],
    )


def _accelerometer(bias_ug: float, sigma_ug: float) -> str:
    return "" if sigma_ug >= _UNKNOWN_ACCELEROMETER_UG else _signed(bias_ug, sigma_ug, 1)


def _signed(value: float, sigma: float, decimals: int) -> str:
    return "" if math.isnan(value) else f"{value:+z.{decimals}f} ± {sigma:.{decimals}f}"


_TEXT = (
    "Allan deviation of the rates and accelerations at rest, from the output of the INS in all good dwells. "
    "The uncertainties of the biases stand on these noises: where one is larger than declared, they are too "
    "small."
)
_ESTIMATED = "The station declares no noise: each dwell was evaluated with the noise of its own windows."
_FIGURE = (
    "Allan deviation, with the random walk that was fitted and the one that the station declares. Thin lines "
    "are all that was fitted: the random walk, steeper at the left the noise of the output, rising at the "
    "right the tilt that the gyros' random walk makes."
)


def noise_section(noise: NoiseEstimate | None, station: Mapping[str, Any]) -> Section | None:
    """Set the measured noise beside that of the station's file; None where none was measured."""
    if noise is None:
        return None
    declared = _declared(station)
    tables = []
    if declared is not None:
        rows = [
            [each.name, each.sentence.removeprefix(each.name).strip()]
            for each in compare_noise(noise, declared)
            if each.declared > 0.0
        ]
        tables = [
            SectionTable("Measured and declared", ["parameter", "measured, declared: verdict"], rows, words=2)
        ]
    return Section(
        "Noise of the INS",
        [_TEXT if declared else f"{_TEXT} {_ESTIMATED}"],
        [SectionFigure("noise", _FIGURE, noise_figure(noise, declared))],
        tables,
    )


def _declared(station: Mapping[str, Any]) -> NoiseModel | None:
    noise = station.get("ins", {}).get("noise")
    if not isinstance(noise, Mapping):
        return None
    return NoiseModel.from_datasheet(
        noise["angle_random_walk_deg_per_sqrt_h"],
        noise.get("velocity_random_walk_ug_per_sqrt_hz", 0.0),
        velocity_output_mps=noise.get("velocity_output_mps", 0.0),
        heading_output_rad=math.radians(noise.get("heading_output_deg", 0.0)),
    )
