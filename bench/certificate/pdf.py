"""The certificate as PDF/A-3: tagged, with vector figures, and with the DCC attached if there is one."""

from __future__ import annotations

import math
import tempfile
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from gyrobench.bench.certificate.content import MODEL_DIGITS, BiasResult, Certificate
from gyrobench.bench.foundations.text import bin_label, with_expanded
from gyrobench.bench.navigation.positions import AXES, POSITIONS, gyro_label, position_label
from gyrobench.bench.report.figures.style import draw_watermark
from gyrobench.bench.report.number_format import BiasScale, range_text
from gyrobench.bench.report.page import Box, Section, SectionFigure, SectionTable, pdf_of, render_page
from gyrobench.bench.report.run_report import figures_of
from gyrobench.bench.report.run_text import VERDICT_COLOURS
from gyrobench.bench.runs.provenance import SIMULATED
from gyrobench.bench.runs.tables.coefficient_table import (
    FRAME_TEXT,
    TEMPERATURE_TEXT,
    plateau_findings,
    plateau_heads,
    plateau_notes,
)

_VARIANT = "pdf/a-3a"
#: Number of plateaus in one table of coefficients.
_PLATEAUS_PER_TABLE = 5
#: Numbers below this power of ten are written with it.
_MIN_POWER = -4
_CAPTIONS = {
    "position_differences": (
        "Differences between positions",
        "Largest difference between two positions in each temperature bin; bars are standard uncertainties.",
    ),
    "position_pair": (
        "Z-Up and Y-Up",
        "Biases in Z-Up and in Y-Up, means of the temperature bins; bars are standard uncertainties (k = 1).",
    ),
    "temperature": ("Temperatures", "Temperatures over the run; bands and bars are dwells by position."),
}
_BIAS_CAPTION = "Bias of the {} against its own temperature; bars are standard uncertainties (k = 1)."
_SIMULATED_BOX = (
    "Emulated instruments, no measurement. This document shows what a certificate contains; it is none."
)


def certificate_pdf(certificate: Certificate, attachments: Mapping[str, bytes] | None) -> bytes:
    """The certificate as PDF/A-3a, with files attached by name.

    Raises GyrobenchError if a system library is missing, and MissingPackageError if weasyprint is not
    installed.
    """
    watermark = certificate.run.watermark
    with tempfile.TemporaryDirectory() as folder:
        page = _page(certificate, dict(_figures(certificate, Path(folder), watermark)))
        title = f"{watermark} Calibration certificate {certificate.order.number}".strip()
        html = "".join(render_page(page, f"{title}, unit {certificate.unit}", watermark, title))
    return pdf_of(html, attachments, _VARIANT)


def _page(certificate: Certificate, figures: Mapping[str, Path]) -> Section:
    statement, rule = certificate.conformity
    acceptance = certificate.run.acceptance
    colour = VERDICT_COLOURS[acceptance.verdict] if acceptance and acceptance.limits else "open"
    boxes = [Box("failed", SIMULATED, _SIMULATED_BOX)] if certificate.run.is_simulated else []
    boxes.append(Box(colour, "Conformity.", statement, [f"Decision rule: {rule}"] if rule else []))
    sections = [
        Section("Laboratory", facts=certificate.laboratory),
        Section("Method", certificate.method),
        Section("Deviations from the procedure", items=certificate.deviations),
        Section("Conditions and location", facts=certificate.conditions),
        _traceability(certificate),
        *_bias_sections(certificate.results, figures),
        _model_section(certificate),
        _coefficients_section(certificate),
        Section("Recalibration", [certificate.order.recalibration])
        if certificate.order.recalibration
        else None,
        Section("Inputs of the estimator as used", facts=certificate.inputs),
        *(
            Section(title, figures=[SectionFigure(name, text, figures[name])])
            for name, (title, text) in _CAPTIONS.items()
            if name in figures
        ),
    ]
    return Section(
        "Calibration certificate",
        boxes=boxes,
        facts=certificate.item,
        sections=[part for part in sections if part],
    )


def _traceability(certificate: Certificate) -> Section:
    rows = certificate.traceability
    if not rows:
        return Section("Traceability", ["The station file states no calibrations of the instruments used."])
    header = ["instrument", "serial number", "certificate", "calibrated", "due", "expanded uncertainty"]
    return Section("Traceability", tables=[SectionTable("", header, rows, words=len(header))])


def _bias_sections(results: Sequence[BiasResult], figures: Mapping[str, Path]) -> Iterator[Section]:
    for gyro in AXES:
        gyro_results = [each for each in results if each.gyro == gyro]
        if not gyro_results:
            continue
        name = f"bias_{gyro}"
        bias_figures = [SectionFigure(name, _BIAS_CAPTION.format(gyro_label(gyro)), figures[name])]
        yield Section(
            f"Bias of the {gyro_label(gyro)}",
            figures=bias_figures if name in figures else [],
            tables=[_bias_table(gyro_results)],
        )


def _bias_table(results: Sequence[BiasResult]) -> SectionTable:
    positions = [each for each in POSITIONS if any(result.position == each for result in results)]
    bins: dict[tuple[float, float], dict[str, BiasResult]] = defaultdict(dict)
    for each in results:
        bins[each.bin_low_c, each.bin_high_c][each.position] = each
    scale = BiasScale.of([each.bias_dph for each in results], [each.expanded_dph for each in results])
    factors = {f"{each.k:.2f}" for each in results}

    def cell(found: BiasResult | None) -> str:
        if found is None:
            return "–"
        text = with_expanded(found.bias_dph * scale.factor, found.expanded_dph * scale.factor)
        return text if len(factors) == 1 else f"{text}\nk = {found.k:.2f}"

    rows = [
        [bin_label(*limits), *(cell(found.get(each)) for each in positions)]
        for limits, found in sorted(bins.items())
    ]
    k = f"k = {min(factors)} for all values" if len(factors) == 1 else "with the coverage factor k"
    caption = f"Bias ± U in {scale.unit} by temperature bin of the gyro and position; {k}."
    return SectionTable(caption, ["bin / °C", *map(position_label, positions)], rows)


def _model_section(certificate: Certificate) -> Section | None:
    table: dict[tuple[str, str], dict[str, str]] = defaultdict(dict)
    bases = [each.name.partition(" along ")[0] for each in certificate.model]
    for _, each in sorted(
        zip(bases, certificate.model, strict=True), key=lambda pair: (bases.index(pair[0]), pair[1].name)
    ):
        table[each.name, _unit_text(each.unit)][each.axis] = _number_text(each.value, each.expanded)
    if not table:
        return None
    header = ["number", "unit", *map(gyro_label, AXES)]
    rows = [
        [name, unit, *(by_gyro.get(gyro, "–") for gyro in AXES)] for (name, unit), by_gyro in table.items()
    ]
    factors = range_text((each.k for each in certificate.model), ".2f")
    caption = (
        f"Value ± U, k = {factors}. The numbers of one gyro are correlated: U may exceed a value although "
        "the effect is significant, and digits beyond U count."
    )
    number_table = SectionTable(caption, header, rows, words=2)
    return Section("Bias model", [certificate.model_note], tables=[number_table])


def _coefficients_section(certificate: Certificate) -> Section | None:
    by_name: dict[tuple[str, str, str], dict[int, str]] = defaultdict(dict)
    heads = plateau_heads(certificate.run.coefficients)
    for each in certificate.coefficients:
        factor, unit = (1000.0, "0.001 deg/h") if each.unit == "deg/h" else (1.0, _unit_text(each.unit))
        text = with_expanded(each.value * factor, each.expanded * factor)
        by_name[each.name, each.axis, unit][each.plateau] = text
    plateaus = sorted({each.plateau for each in certificate.coefficients})
    tables = []
    for start in range(0, len(plateaus), _PLATEAUS_PER_TABLE):
        group = plateaus[start : start + _PLATEAUS_PER_TABLE]
        header = ["coefficient", "unit", *(heads[each] for each in group)]
        rows = [
            [f"{name} {axis}", unit, *(by_plateau.get(each, "–") for each in group)]
            for (name, axis, unit), by_plateau in by_name.items()
            if by_plateau.keys() & set(group)
        ]
        factors = range_text((each.k for each in certificate.coefficients if each.plateau in group), ".2f")
        caption = f"Coefficient ± U, k = {factors}, at the plateaus from {group[0]} to {group[-1]}."
        tables.append(SectionTable(caption, header, rows, words=2))
    notes = plateau_notes(row for row in certificate.run.coefficients if row.plateau in plateaus)
    texts = [f"{FRAME_TEXT} {TEMPERATURE_TEXT}", *notes] if tables else []
    texts += [f"Not certified: {text}" for text in plateau_findings(certificate.run.coefficients)]
    return Section("Coefficients of the sensors", texts, tables=tables) if texts else None


def _number_text(value: float, expanded: float) -> str:
    """Value ± U of a number of a model; small numbers with a common power of ten."""
    power = min(math.floor(math.log10(max(abs(value), expanded))), 0)
    power = 0 if power > _MIN_POWER else power
    text = with_expanded(value / 10.0**power, expanded / 10.0**power, MODEL_DIGITS)
    return f"({text})e{power}" if power else text


def _unit_text(unit: str) -> str:
    return unit.replace("K2", "K²").replace("K3", "K³")


def _figures(certificate: Certificate, folder: Path, watermark: str) -> Iterator[tuple[str, Path]]:
    run = certificate.run
    nan_biases = math.nan, math.nan, math.nan  # the biases by the paper's method are not certified
    dwells = [replace(each, paper_bias_dph=nan_biases) for each in run.dwells]
    bins = [replace(each, paper_bias_dph=math.nan) for each in run.bins]
    for name, draw in figures_of(replace(run, dwells=dwells, bins=bins)):
        path, figure = folder / f"{name}.svg", draw()
        draw_watermark(figure, watermark)
        figure.savefig(path, metadata={"Date": None, "Title": watermark or None})
        yield name, path
