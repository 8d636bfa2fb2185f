"""The page of a verification (verification.html)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path

import numpy as np

from gyrobench.bench.calibration.coefficients import COEFFICIENTS
from gyrobench.bench.calibration.mission import HOURS
from gyrobench.bench.closure.loadable_model import LoadableModel
from gyrobench.bench.closure.outcome import Closure
from gyrobench.bench.foundations.text import counted, hours_minutes, listed, plain_name, plural
from gyrobench.bench.report import verification_text as text
from gyrobench.bench.report.closure_text import searched_name, verdict_sentence
from gyrobench.bench.report.figures.verification import (
    coefficient_residuals_figure,
    day_figure,
    mission_figure,
    residual_bars_figure,
)
from gyrobench.bench.report.page import Box, Findings, Section, SectionFigure, SectionTable, write_findings
from gyrobench.bench.verification.compensation_verification import IN_WORDS, VerificationResult

_RESIDUALS_CAPTION = (
    "Residual with each compensation at each plateau: gyro temperature in °C, in brackets the cycle where "
    "there are several. The black lines are the noise."
)
_DAY_CAPTION = (
    "Position error over a day at rest of a rotational INS with the biases measured at each temperature. The "
    "black line is the largest error expected from the measurement noise alone."
)
_TOTAL_CAPTION = "All plateaus: rms of bias and varying bias, otherwise the maximum; {}"
_TOTAL_COMMON_CAPTION = (
    "All plateaus: rms of bias and varying bias over the dwells that are valid in all runs, otherwise the "
    "maximum over the plateaus with a value in all runs; {}"
)
_COMPENSATION_CAPTION = (
    "Numbers of the compensation and their standard uncertainties, by gyro, as in compensation.yaml. Those "
    "of one gyro are correlated: the uncertainty of what is subtracted is stated under Residual."
)
_PLATEAUS_CAPTION = (
    "By mean gyro temperature in °C; fit: whether the model was fitted at the temperature, between fitted "
    "temperatures, or outside them; {}"
)


_COEFFICIENTS_CAPTION = (
    "Rms of each coefficient over the plateaus with each compensation, and of the standard uncertainty of "
    "the measurement (lines). The body frame is that of the accelerometers."
)
_MISSION_CAPTION = (
    "Distance from the true position with the remaining coefficient errors, at the plateau where it is "
    "largest after a day. Dashed: limits below which 95 % of all missions stay up to 1, 8 and 24 h, given "
    "the uncertainty of the coefficients."
)
_MISSION_TEXT = (
    "The mission is a mechanisation of the increments of a dual-axis rotational INS at rest: sixteen half "
    "turns at 10 deg/s between rests of 3 min, of which the last eight retrace the first eight; fixed "
    "altitude, a start without error, and coefficients constant at those of one plateau. "
    "Coefficients that are not observable count as zero. Position errors are the largest up to the time "
    "stated, at the plateau where that is largest."
)


def _coefficient_section(result: VerificationResult) -> Section:
    """Rms of all coefficients with each compensation."""
    results = result.coefficients
    header = ["coefficient", "unit", *(text.LABELS[each.compensation] for each in results), "noise"]
    rows = []
    for index, coefficient in enumerate(COEFFICIENTS):
        sizes = [*(each.rms[index] for each in results), results[-1].noise[index]]
        texts = ["not observable" if np.isnan(size) else f"{size:.3g}" for size in sizes]
        rows.append([f"{plain_name(coefficient.name)} {coefficient.axis}", coefficient.unit, *texts])
    figure = SectionFigure(
        "coefficients", _COEFFICIENTS_CAPTION, partial(coefficient_residuals_figure, result)
    )
    table = SectionTable("Rms over the plateaus", header, rows, words=2)
    return Section("All coefficients", figures=[figure], tables=[table])


def _mission_section(result: VerificationResult) -> Section:
    """Position error after each time, with each compensation."""
    rows, sentences, limits_of_runs = [], [], []
    for each in result.coefficients:
        errors, limits = (
            [f"{nmi:.2g}" if nmi < 1.0 else f"{nmi:.1f}" for nmi in values]
            for values in (each.worst.error.stated_nmi, each.worst.error.high_nmi)
        )
        limits_of_runs.append(limits)
        sentences.append(f"{', '.join(errors)} nmi {text.with_compensation(each)}")
        cells = [f"{error} (< {limit})" for error, limit in zip(errors, limits, strict=True)]
        rows.append([text.LABELS[each.compensation], f"{each.worst.gyro_c:z.0f}", *cells])
    sentence = (
        "Largest position error of a mission with the remaining coefficient errors, within "
        f"{listed([f'{hours:g}' for hours in HOURS])} h: {'; '.join(sentences)}. Given the uncertainty of "
        f"the last, 95 % of all missions stay below {', '.join(limits_of_runs[-1])} nmi."
    )
    header = ["compensation", "°C", *(f"{hours:g} h" for hours in HOURS)]
    table = SectionTable("Position error in nmi, in brackets the limit of 95 %", header, rows)
    figure = SectionFigure("mission", _MISSION_CAPTION, partial(mission_figure, result))
    return Section("A mission of a rotational INS", [sentence, _MISSION_TEXT], [figure], [table])


def verification_sections(result: VerificationResult) -> list[Section]:
    """Sections: compensations, residual, a day of a rotational INS, coefficients, definitions."""
    units, heads = text.size_units(result), text.size_heads(result)
    caption = _TOTAL_CAPTION if result.is_complete or len(result.results) < 2 else _TOTAL_COMMON_CAPTION
    totals_table = SectionTable(caption.format(units), ["compensation", *heads], text.total_rows(result))
    plateaus_table = SectionTable(
        _PLATEAUS_CAPTION.format(units),
        ["°C", "cycle", "fit", "compensation", *heads],
        text.plateau_rows(result),
        words=4,
    )
    compensation_table = SectionTable(
        _COMPENSATION_CAPTION, ["number", "x", "y", "z"], text.compensation_rows(result.models)
    )
    figures = [SectionFigure("residuals", _RESIDUALS_CAPTION, partial(residual_bars_figure, result))]
    day_section_figure = SectionFigure("day", _DAY_CAPTION, partial(day_figure, result))
    has_day = any(row.day for each in result.results for row in each.rows)
    return [
        Section(
            "Compensations",
            text.model_sentences(result.closure, result.models, result.searches),
            tables=[compensation_table],
        ),
        Section("Residual", text.change_sentences(result), figures, [totals_table, plateaus_table]),
        *([Section("A day of a rotational INS", figures=[day_section_figure])] if has_day else []),
        *([_coefficient_section(result), _mission_section(result)] if result.coefficients else []),
        Section("Definitions", text.definition_sentences(result)),
    ]


#: Colours of the template's box by judgement, otherwise "stopped".
_COLOURS = {text.CONFIRMED: "finished", text.NOT_CONFIRMED: "failed"}


def verification_findings(result: VerificationResult) -> Findings:
    """Judgement, facts and all sections; at least one compensation must have been measured."""
    judgement = text.outcome(result)
    return Findings(
        title="Verification of a compensation",
        source=result.source,
        judgement=judgement,
        colour=_COLOURS.get(judgement, "stopped"),
        sentence=text.outcome_sentence(result),
        facts=_facts(result),
        sections=verification_sections(result),
    )


def write_verification_page(folder: Path, result: VerificationResult, dwells: Path | None = None) -> Path:
    """Write figures and page into an existing folder.

    ``dwells`` is the table that the model was fitted to. Raises RunFolderError if a file can't be written.
    """
    findings, sources = verification_findings(result), result.closure.campaign.sources
    return write_findings(folder / "verification.html", findings, sources, dwells)


def _facts(result: VerificationResult) -> dict[str, str]:
    closure = result.closure
    measured = [text.with_compensation(each) for each in result.results]
    others = {f"search, {searched_name(each)}": _verdict_text(each) for each in result.searches}
    return {
        f"search, {searched_name(closure)}" if others else "search": _verdict_text(closure),
        **others,
        "compensations": f"{counted(len(measured), 'run')}: {listed(measured)}",
        "dwells": f"{result.dwells} per run, at {counted(len(result.plateaus), 'plateau')}",
    }


def _verdict_text(closure: Closure) -> str:
    return f"{closure.verdict}. {verdict_sentence(closure)}"


def verification_plan(
    closure: Closure,
    models: Mapping[str, LoadableModel],
    missing: Sequence[str],
    run_s: float,
    searches: Sequence[Closure] = (),
) -> Section:
    """Verdict of the search, compensations, and duration of the remaining runs.

    ``searches``: searches in other coefficients.
    """
    sentences = text.model_sentences(closure, models, searches)
    if missing:
        total = f", {hours_minutes(len(missing) * run_s)} h in total" if missing[1:] else ""
        verb, names = plural(len(missing), "remains", "remain"), [IN_WORDS[name] for name in missing]
        sentences.append(
            f"{counted(len(missing), 'run')} of {hours_minutes(run_s)} h {verb}{total}: {listed(names)}."
        )
    else:
        sentences.append("All runs are complete.")
    boxes = [
        Box(
            "open",
            f"{f'{searched_name(each)}: ' if searches else ''}{each.verdict}.".capitalize(),
            verdict_sentence(each),
        )
        for each in (closure, *searches)
    ]
    return Section("", boxes=boxes, paragraphs=sentences)
