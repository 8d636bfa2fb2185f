"""Estimator sections of a run report: difference of the estimators, fit, joint solution, noise of the INS."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np

from gyrobench.bench.bias.dwell_table import DwellRow, PackedDwells, paper_rows
from gyrobench.bench.bias.noise_estimate import NoiseEstimate, compare_noise
from gyrobench.bench.bias.vertical_pairs import Finding
from gyrobench.bench.foundations.text import counted
from gyrobench.bench.navigation.positions import AXES, gyro_label, position_label
from gyrobench.bench.report.figures.estimators import (
    differences_dph,
    estimators_figure,
    fit_figure,
    has_both_estimates,
    has_distribution,
    noise_figure,
)
from gyrobench.bench.report.number_format import NO_PAPER, BiasScale, corrected_p, p_in_brackets, p_text
from gyrobench.bench.report.page import Section, SectionFigure, SectionTable
from gyrobench.bench.report.run_findings import CONTRADICTION_P, corrected_p_values, declared_noise
from gyrobench.bench.report.run_text import POSITION_SIGNIFICANCE, fit_sentence
from gyrobench.bench.runs.tables.joint_table import JointPlateauRow, JointSigmas

_STATE_SPACE_TEXT = (
    "Biases are those of the state-space estimator: it fits the full error model of an INS at rest, "
    "with Schuler loop, Earth rate, accelerometer biases and initial errors, to velocity and heading of"
    " a whole dwell. Its uncertainty includes noise and the prior uncertainties of unit and bench."
)
_PAPER_TEXT = (
    "Results of the paper's method from the same data are in grey: quadratic fits of the velocities and "
    "slopes of the heading, before and after a turn of 180 deg. Their uncertainty includes noise only."
)
_UNKNOWN_ESTIMATOR = "The estimator of these biases is unknown: the dwell table has no column for it."
_PAPER_ERRORS_TEXT = (
    "The paper's method neglects the coupling of INS errors. Over windows of ten minutes, a level bias is "
    "8 to 17 % in error because the Schuler loop feeds velocity back into tilt; up to 20 % of one axis "
    "leaks into another through the Earth's rotation; and 10 µg of accelerometer bias appear as up to "
    "0.001 deg/h. The leakage depends on the position, so a difference between positions found only by "
    "the paper's method may be an artefact. The state-space estimator models all of these."
)
_DIFFERENCES_CAPTION = (
    "Bias by the paper's method minus bias by the state-space estimator, for each dwell. Bars are combined "
    "standard uncertainties; both use the same data, so noise alone separates them by less. Points beyond "
    "their bars show systematic errors of the paper's method."
)
_FIT_TEXT = (
    "The residuals of velocity and heading in each dwell, summed over one-minute blocks, are compared with "
    "the noise: a wrong model leaves slowly varying residuals, which add up."
)
_FIT_SIZES_CAPTION = (
    "Residuals of each dwell relative to the expected size; 1 if model and noise are correct."
)
_FIT_P_VALUES_CAPTION = (
    f"Left: {_FIT_SIZES_CAPTION[0].lower()}{_FIT_SIZES_CAPTION[1:]} Right: cumulative distribution of the "
    "p-values, with its expectation if model and noise are correct, and the band that it leaves with a "
    f"probability of {100 * POSITION_SIGNIFICANCE:.0f} %."
)


def estimators_note(rows: Sequence[DwellRow]) -> str:
    """Name the estimators of the report."""
    if any(paper_rows([row]) for row in rows):
        return f"{_STATE_SPACE_TEXT} {_PAPER_TEXT}"
    if any(not math.isnan(row.fit_p_value) for row in rows):
        return f"{_STATE_SPACE_TEXT} {NO_PAPER}"
    return _UNKNOWN_ESTIMATOR if rows else ""


def estimators_section(rows: Sequence[DwellRow], marked_c: Sequence[float] = ()) -> Section | None:
    """Comparison of the estimators; None if no unflagged dwell has results of both."""
    dwells = PackedDwells(row for row in rows if has_both_estimates(row))
    if not dwells:
        return None
    figures = (
        [SectionFigure("estimators", _DIFFERENCES_CAPTION, partial(estimators_figure, rows, marked_c))]
        if len(dwells) > 1
        else []
    )
    return Section("Comparison of the estimators", [_PAPER_ERRORS_TEXT], figures, [_difference_table(dwells)])


def fit_section(rows: Sequence[DwellRow]) -> Section | None:
    """Whether model and noise explain the data; None if no dwell was tested."""
    sentence = fit_sentence(rows)
    if not sentence:
        return None
    caption = _FIT_P_VALUES_CAPTION if has_distribution(rows) else _FIT_SIZES_CAPTION
    return Section(
        "Goodness of fit", [_FIT_TEXT, sentence], [SectionFigure("fit", caption, partial(fit_figure, rows))]
    )


def _difference_table(rows: Sequence[DwellRow]) -> SectionTable:
    pairs = [differences_dph(row) for row in rows]
    scale = BiasScale.of(*zip(*(pair for dwell_pairs in pairs for pair in dwell_pairs), strict=True))
    cells = []
    for axis, gyro in enumerate(AXES):
        differences = [dwell_pairs[axis] for dwell_pairs in pairs]
        rms_dph = math.sqrt(sum(difference**2 for difference, _ in differences) / len(differences))
        largest, row = max(zip(differences, rows, strict=True), key=lambda each: abs(each[0][0]))
        dwell_text = f"{position_label(row.position)}, {row.gyro_c[axis]:.0f} °C, dwell {row.dwell}"
        cells.append([gyro_label(gyro), dwell_text, scale.text(rms_dph), scale.with_sigma(*largest)])
    return SectionTable(
        f"Paper's method minus state-space estimator in {scale.unit}, over {counted(len(rows), 'dwell')}",
        ["gyro", "dwell of the largest", "rms", "largest ± combined uncertainty"],
        cells,
        words=2,
    )


_JOINT_TEXT = (
    "The dwells of each plateau are also solved jointly: they share accelerometer biases, misalignments of "
    "the gyros, and any rate fixed in the navigation frame. Each dwell keeps its own gyro biases."
)
_RATE_UP_TEXT = (
    "An undeclared rate Up, from a wrong latitude for instance, adds to the bias of a vertical gyro that "
    "points up and subtracts when it points down. If the bias is the same in both positions, half the sum of "
    "the two results is the bias and half the difference is the rate."
)
_LATITUDE_CONCLUSION = (
    "with a free rate North they agree, so the latitude error exceeds the declared uncertainty. Use the "
    "biases without the rate Up, and check the latitude in station file and INS."
)
_INVALID_CONCLUSION = "the joint biases of this plateau are invalid."
#: The data do not determine an accelerometer bias with a larger uncertainty.
_MAX_ACCELEROMETER_SIGMA_UG = 100.0
#: Uncertainties by plateau and whether the gyro was vertical.
_JointSigmasByGroup = Mapping[tuple[int, bool], JointSigmas]


def joint_section(sigmas: _JointSigmasByGroup, plateaus: Sequence[JointPlateauRow]) -> Section | None:
    """Results of the joint solution; None without its tables, and where no plateau has several dwells.

    The contradiction between a single dwell and the declared latitude is stated all the same.
    """
    shared = [row for row in plateaus if row.dwells > 1]
    misfits = _misfit_sentences(plateaus)
    if not (sigmas and plateaus and (any(row.plateau for row in shared) or misfits)):
        return None
    reductions = [_reduction_text(sigmas, is_vertical=is_vertical) for is_vertical in (False, True)]
    return Section(
        "Joint solution of each plateau",
        [
            f"{_JOINT_TEXT} {_gain_sentence(*reductions)}",
            f"{_RATE_UP_TEXT} {_finding_sentence(plateaus)}",
            *misfits,
        ],
        tables=[
            *([_gain_table(sigmas)] if any(reductions) else []),
            *([_plateau_table(shared)] if shared else []),
        ],
    )


def _reduction_text(sigmas: _JointSigmasByGroup, *, is_vertical: bool) -> str:
    """Median reduction of the uncertainties of level or of vertical gyros; empty if it rounds to zero."""
    groups = (group for (_, is_group_vertical), group in sigmas.items() if is_group_vertical is is_vertical)
    gain = float(np.median([gain for group in groups for gain in group.gains]))
    text = f"{100.0 * (1.0 - 1.0 / gain):.1f}"
    return f"{text} %" if float(text) > 0.0 else ""


def _gain_sentence(level: str, vertical: str) -> str:
    if not (level or vertical):
        return "The joint solution does not reduce the uncertainties (medians)."
    return (
        f"This reduces the standard uncertainty of level gyros by {level or '0 %'} and of vertical gyros by "
        f"{vertical or '0 %'} (medians)."
    )


def _finding_sentence(plateaus: Sequence[JointPlateauRow]) -> str:
    last = plateaus[-1]
    finding = Finding[last.finding.upper()]
    scope = "Over all plateaus" if last.plateau == 0 else "At this plateau"
    if finding is Finding.NO_PAIR:
        return f"{scope}: {finding.value}."
    rate = f"({1e3 * last.up_rate_dph:+.2f} ± {1e3 * last.up_rate_sigma_dph:.2f}) · 10⁻³ deg/h"
    latitude = f"{last.latitude_error_arcmin:+.2f} ± {last.latitude_error_sigma_arcmin:.2f} arcmin"
    p_value = p_in_brackets(last.up_rate_p_value)
    text = f"{scope} the half-difference is {rate}{p_value}: {finding.value}."
    if finding in (Finding.LATITUDE, Finding.LATITUDE_OFF, Finding.NOT_CONTRADICTED):
        text += f" Equivalent latitude error: {latitude}; joint_biases.csv also has the biases without it."
    return text


def _misfit_sentences(plateaus: Sequence[JointPlateauRow]) -> list[str]:
    corrected = corrected_p_values(plateaus)
    subjects = {True: "dwells disagree on shared parameters", False: "dwell and declared latitude disagree"}
    return [
        f"At plateau {row.plateau} {subjects[row.dwells > 1]}{corrected_p(fit_p, len(corrected))}: "
        + (_LATITUDE_CONCLUSION if any_north_p >= CONTRADICTION_P else _INVALID_CONCLUSION)
        for row, fit_p, any_north_p in corrected
        # The goodness-of-fit test of a single dwell finds its other contradictions.
        if fit_p < CONTRADICTION_P and (row.dwells > 1 or any_north_p >= CONTRADICTION_P)
    ]


def _gain_table(sigmas: _JointSigmasByGroup) -> SectionTable:
    cells = []
    for plateau in sorted({plateau for plateau, _ in sigmas}):
        groups = [sigmas.get((plateau, is_vertical), JointSigmas()) for is_vertical in (False, True)]
        medians = [map(np.median, (each.single_dph, each.joint_dph, each.gains)) for each in groups]
        texts = [
            (f"{1e3 * single:.2f}", f"{1e3 * joint:.2f}", f"{gain:.3f}") for single, joint, gain in medians
        ]
        cells.append([str(plateau), *texts[0], *texts[1]])
    return SectionTable(
        "Median standard uncertainty of a bias, single and joint, 0.001 deg/h, and their ratio",
        [
            *("plateau", "level, single", "level, joint", "ratio"),
            *("vertical, single", "vertical, joint", "ratio"),
        ],
        cells,
    )


def _plateau_table(plateaus: Sequence[JointPlateauRow]) -> SectionTable:
    return SectionTable(
        "Shared parameters of each plateau of several dwells: accelerometer biases in µg where observable, "
        "rates in 0.001 deg/h, p-value of the fit",
        ["plateau", "chamber °C", "dwells", "x", "y", "z", "rate North", "rate Up", "p"],
        [
            [
                "all" if row.plateau == 0 else str(row.plateau),
                "" if math.isnan(row.chamber_set_c) else f"{row.chamber_set_c:g}",
                str(row.dwells),
                *(
                    _accelerometer_cell(
                        getattr(row, f"accelerometer_{axis}_ug"),
                        getattr(row, f"accelerometer_{axis}_sigma_ug"),
                    )
                    for axis in AXES
                ),
                _cell_with_sigma(1e3 * row.north_rate_dph, 1e3 * row.north_rate_sigma_dph, 2),
                _cell_with_sigma(1e3 * row.up_rate_dph, 1e3 * row.up_rate_sigma_dph, 2),
                "" if math.isnan(row.fit_p_value) else p_text(row.fit_p_value),
            ]
            for row in plateaus
        ],
    )


def _accelerometer_cell(bias_ug: float, sigma_ug: float) -> str:
    return "" if sigma_ug >= _MAX_ACCELEROMETER_SIGMA_UG else _cell_with_sigma(bias_ug, sigma_ug, 1)


def _cell_with_sigma(value: float, sigma: float, decimals: int) -> str:
    return "" if math.isnan(value) else f"{value:+z.{decimals}f} ± {sigma:.{decimals}f}"


_NOISE_TEXT = (
    "Allan deviation of the rates and accelerations at rest, from the output of the INS in all unflagged "
    "dwells. The uncertainties of the biases are based on the declared noise: if the measured noise is "
    "larger, they are too small."
)
_NOISE_ESTIMATED_TEXT = (
    "The station declares no noise: each dwell was evaluated with the noise estimated from its windows."
)
_NOISE_CAPTION = (
    "Allan deviation with the fitted and the declared random walk. Thin lines: the complete fit, with output "
    "noise at short and tilt caused by the gyros' random walk at long averaging times."
)


def noise_section(noise: NoiseEstimate | None, station: Mapping[str, Any]) -> Section | None:
    """Measured and declared noise; None without a measurement."""
    if noise is None:
        return None
    declared = declared_noise(station)
    tables = []
    if declared is not None:
        rows = [
            [each.name, each.sentence.removeprefix(each.name).strip()]
            for each in compare_noise(noise, declared)
            if each.declared > 0.0
        ]
        tables = [
            SectionTable(
                "Noise, measured and declared", ["parameter", "measured, declared: verdict"], rows, words=2
            )
        ]
    return Section(
        "Noise of the INS",
        [_NOISE_TEXT if declared else f"{_NOISE_TEXT} {_NOISE_ESTIMATED_TEXT}"],
        [SectionFigure("noise", _NOISE_CAPTION, partial(noise_figure, noise, declared))],
        tables,
    )
