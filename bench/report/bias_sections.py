"""Bias sections of a run report: by gyro and bin, by dwell, against limits, before and after a change."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import MappingProxyType

from gyrobench.bench.bias.bins import BiasBin, PositionComparison, compare_positions, paper_bins
from gyrobench.bench.bias.dwell_table import DwellRow, paper_rows
from gyrobench.bench.bias.verdicts import Acceptance, AcceptanceLimits, Judgement, Verdict
from gyrobench.bench.foundations.text import bin_label, flag_text, hours_minutes, listed
from gyrobench.bench.navigation.positions import AXES, POSITIONS, gyro_label, position_label
from gyrobench.bench.report.figures.bias import before_after_figure
from gyrobench.bench.report.number_format import (
    NO_PAPER,
    BiasScale,
    bins_by_temperature,
    p_text,
    scale_of_bins,
)
from gyrobench.bench.report.page import Box, Mark, Section, SectionFigure, SectionTable
from gyrobench.bench.report.run_content import RunContent
from gyrobench.bench.report.run_text import (
    NOTHING_TO_COMPARE,
    VERDICT_COLOURS,
    acceptance_sentence,
    paper_agreement_sentence,
    position_comparison_sentence,
    power_cycle_sentence,
    scatter_sentence,
    significant_differences,
)

_DIFFERENCE_CAPTION = (
    "Largest difference between two positions in each temperature bin, reduced to one temperature, with its "
    "standard uncertainty (k = 1). Noise alone makes the largest of several differences greater than zero: "
    "with six equal positions it is usually about 2.5 times the uncertainty of one of them, so the p-value "
    "decides. Filled markers: significant difference."
)
_LIMITS_CAPTION = (
    " Red lines are acceptance limits, which hold within one plateau: a bin with dwells of several "
    "plateaus can be above them although the unit is accepted. The uncertainties are those of bin means; the "
    "section Acceptance has those of plateaus corrected to one temperature."
)
_BIAS_CAPTION = (
    "Bias of the {} against its own temperature{}. Lines join the weighted means of the temperature bins, "
    "faint points are single dwells; bars are standard uncertainties. All gyros have the same scale."
)
_PAIR_CAPTION = (
    "Biases in Z-Up and in Y-Up (Yu et al., Figs. 8, 9, 12 and 13): lines join the weighted means of the "
    "temperature bins, numbers those of their dwells if several, bars are standard uncertainties (k = 1)."
)
_BOTH_SIDES = ", on the left by the state-space estimator, on the right by the paper's method"
_COMPARISON_CAPTION = (
    "Comparison of positions{}. p: probability of differences this large if the bias were the same in all "
    "positions, with all biases reduced to one temperature. Spread: difference of the positions' mean "
    "temperatures inside the bin."
)
_PAPER_P = "; in grey by the paper's method, whose systematic errors are not in its p"
_P_EQUAL_NOTE = (
    "p equal: probability of differences this large if the bias were the same in all positions; * "
    "significant. Two bins between which the positions of a plateau are divided are compared as one."
)
_PAPER_NOTE = (
    "Second line: result of the paper's method, which neglects the Schuler loop, the coupling by the Earth's "
    "rotation and the accelerometers; its uncertainty does not include the resulting errors."
)
_DWELLS_CAPTION = (
    "Bias ± standard uncertainty in {}; start in h:mm; temperatures in °C.{} Fit: p-value of the residuals. "
    "Flagged dwells are not in the bins."
)


def comparison_section(
    bins: Sequence[BiasBin], acceptance: Acceptance | None, figures: Mapping[str, Path], *notes: str
) -> Section:
    """Results of all gyros in sentences, ``notes``, and the figures of differences with their limits."""
    boxes = [_gyro_box(gyro, [each for each in bins if each.gyro == gyro]) for gyro in AXES]
    if all(box.text == NOTHING_TO_COMPARE for box in boxes):
        boxes_with_notes = [replace(box, text="") for box in boxes if box.notes]
        boxes = [Box("stopped", "", NOTHING_TO_COMPARE), *boxes_with_notes] if bins else []
    caption = _DIFFERENCE_CAPTION + (_LIMITS_CAPTION if acceptance and acceptance.limits else "")
    section_figures = _available_figure(figures, "position_differences", caption)
    section_figures += _available_figure(figures, "position_pair", _PAIR_CAPTION)
    return Section("Results", boxes=boxes, paragraphs=notes, figures=section_figures)


def _gyro_box(gyro: str, bins: Sequence[BiasBin]) -> Box:
    comparisons = compare_positions(bins)
    colour = ("failed" if significant_differences(comparisons) else "finished") if comparisons else "stopped"
    notes = [
        paper_agreement_sentence(comparisons, compare_positions(paper_bins(bins))),
        power_cycle_sentence(bins),
        scatter_sentence(bins),
    ]
    sentence = position_comparison_sentence(comparisons)
    return Box(colour, f"{gyro_label(gyro)}.", sentence, notes)


def gyro_section(gyro: str, bins: Sequence[BiasBin], figures: Mapping[str, Path]) -> Section | None:
    """Figure and tables of one gyro; None without data.

    ``bins``: those of all gyros, so that the table has a column for every position measured.
    """
    gyro_bins = [each for each in bins if each.gyro == gyro]
    by_paper = paper_bins(gyro_bins)
    has_paper = any(not each.is_empty for each in by_paper)
    caption = _BIAS_CAPTION.format(gyro_label(gyro), _BOTH_SIDES if has_paper else "")
    figure = _available_figure(figures, f"bias_{gyro}", caption)
    if not (gyro_bins or figure):
        return None
    scale = scale_of_bins([*gyro_bins, *by_paper])
    measured = {each.position for each in bins}
    positions = [name for name in POSITIONS if name in measured]
    rows = []
    for low, high, members in bins_by_temperature(gyro_bins):
        cells = _bin_cells(members, positions, scale)
        rows.append([bin_label(low, high), *(cells or ["empty in all positions"])])
    tables = [
        SectionTable(
            f"Bias ± standard uncertainty in {scale.unit} (number of dwells), by temperature of the gyro"
            + ("; in grey by the paper's method" if has_paper else ""),
            ["bin / °C", *map(position_label, positions)],
            rows,
        ),
        _comparison_table(compare_positions(gyro_bins), compare_positions(by_paper), scale),
    ]
    return Section(gyro_label(gyro), figures=figure, tables=[each for each in tables if each.rows])


def bins_summary(bins: Sequence[BiasBin]) -> Section:
    """Tables of the biases of all gyros by bin and position with p-values of the comparisons, no figures."""
    if not bins:
        return Section("", ["No dwell gave a bias, so there are no temperature bins."])
    is_compared = bool(compare_positions(bins))
    positions = [name for name in POSITIONS if name in {each.position for each in bins}]
    sections = []
    for gyro in AXES:
        gyro_bins = [each for each in bins if each.gyro == gyro]
        if not gyro_bins:
            continue
        scale = scale_of_bins([*gyro_bins, *paper_bins(gyro_bins)])
        p_values = [_p_values(compare_positions(each)) for each in (gyro_bins, paper_bins(gyro_bins))]
        rows = []
        for low, high, members in bins_by_temperature(gyro_bins):
            cells = _bin_cells(members, positions, scale, has_count=False) or ["empty"] * len(positions)
            p_value = "\n".join(text for each in p_values for ends, text in each if ends[0] <= low < ends[1])
            rows.append([bin_label(low, high, ".."), *cells, *([p_value] if p_values[0] else [])])
        caption = f"Bias ± standard uncertainty in {scale.unit} by gyro temperature"
        header = ["bin / °C", *map(position_label, positions), *(["p equal"] if p_values[0] else [])]
        box = _gyro_box(gyro, gyro_bins)
        sentences = [*([box.text] if is_compared else []), *box.notes]
        sections.append(Section(gyro_label(gyro), sentences, tables=[SectionTable(caption, header, rows)]))
    has_paper = any(not each.is_empty for each in paper_bins(bins))
    notes = [_P_EQUAL_NOTE if is_compared else NOTHING_TO_COMPARE, _PAPER_NOTE if has_paper else NO_PAPER]
    return Section("", sections=[*sections, Section("Notes", notes)])


def _p_values(comparisons: Sequence[PositionComparison]) -> list[tuple[tuple[float, float], str]]:
    """Ranges compared and their p-values as text; a star marks a significant difference."""
    different = significant_differences(comparisons)
    return [
        ((each.bin_low_c, each.bin_high_c), f"{p_text(each.p_value)}{'*' if each in different else ' '}")
        for each in comparisons
    ]


def _bin_cells(
    members: Sequence[BiasBin], positions: Iterable[str], scale: BiasScale, *, has_count: bool = True
) -> list[str]:
    """Cells of the positions of one bin, the paper's result in a second line; empty list for an empty bin."""
    texts = {
        each.position: scale.with_sigma(each.bias_dph, each.sigma_dph)
        + (f" ({each.count})" if has_count else "")
        for each in members
        if not each.is_empty
    }
    for each in paper_bins(members):
        if each.position in texts and not each.is_empty:
            texts[each.position] += f"\n{scale.with_sigma(each.bias_dph, each.sigma_dph)}"
    return [texts.get(position, "empty") for position in positions] if texts else []


def _comparison_table(
    comparisons: Sequence[PositionComparison], by_paper: Sequence[PositionComparison], scale: BiasScale
) -> SectionTable:
    paper_by_bin = {each.bin_low_c: each for each in by_paper}
    significant, paper_significant = significant_differences(comparisons), significant_differences(by_paper)
    rows = []
    for each in comparisons:
        paper = paper_by_bin.get(each.bin_low_c)
        cells_of_methods = [_comparison_cells(one, scale) for one in (each, paper) if one is not None]
        pair, p_value, size = ("\n".join(lines) for lines in zip(*cells_of_methods, strict=True))
        by_method = each in significant, None if paper is None else paper in paper_significant
        cells = [pair, _methods_with_difference(*by_method), p_value, size]
        rows.append([bin_label(each.bin_low_c, each.bin_high_c), *cells, f"{each.temperature_spread_c:.1f}"])
    return SectionTable(
        _COMPARISON_CAPTION.format(_PAPER_P if by_paper else ""),
        ["bin / °C", "largest difference", "significant", "p", f"size / ({scale.unit})", "spread / K"],
        rows,
        words=3,
        marks=["bad" if each in significant else "" for each in comparisons],
    )


def _comparison_cells(comparison: PositionComparison, scale: BiasScale) -> tuple[str, str, str]:
    pair = " above ".join(map(position_label, comparison.largest_pair))
    size = scale.with_sigma(comparison.largest_difference_dph, comparison.largest_difference_sigma_dph)
    return pair, p_text(comparison.p_value), size


def _methods_with_difference(by_state_space: bool, by_paper: bool | None) -> str:
    """Methods that find a significant difference; ``by_paper`` is None without the paper's method."""
    if by_paper is None or not (by_state_space or by_paper):
        return "yes" if by_state_space else ""
    if by_state_space:
        return "both methods" if by_paper else "state-space only"
    return "paper's method only"


def dwells_section(rows: Sequence[DwellRow], empty: str) -> Section:
    """Table of all dwells; the sentence ``empty`` if there are none."""
    if not rows:
        return Section("Dwells", [empty])
    has_paper = bool(paper_rows(rows))
    scale = BiasScale.of(
        (bias for row in rows for each in (row, *paper_rows([row])) for bias in each.bias_dph),
        (sigma for row in rows for each in (row, *paper_rows([row])) for sigma in each.sigma_dph),
    )
    lines: list[list[str]] = []
    marks: list[Mark] = []
    for row in rows:
        lines.append(_dwell_cells(row, scale))
        marks.append("doubtful" if row.flags else "")
        if row.flags:
            lines.append(["", f"flagged: {flag_text(row.flags)}"])
            marks.append("doubtful")
    header = ["position", "dwell", "cycle", "start", "chamber set", *map(gyro_label, AXES)]
    header += [*(f"{gyro.upper()} bias" for gyro in AXES), "fit p"]
    paper = " In grey by the paper's method." if has_paper else ""
    return Section(
        "Dwells", tables=[SectionTable(_DWELLS_CAPTION.format(scale.unit, paper), header, lines, marks=marks)]
    )


def _dwell_cells(row: DwellRow, scale: BiasScale) -> list[str]:
    biases = _dwell_biases(row, scale)
    for paper_row in paper_rows([row]):
        biases = [
            f"{bias}\n{paper_bias}".rstrip()
            for bias, paper_bias in zip(biases, _dwell_biases(paper_row, scale), strict=True)
        ]
    return [
        position_label(row.position),
        str(row.dwell),
        str(row.cycle),
        hours_minutes(row.start_s),
        *("" if math.isnan(value) else f"{value:.1f}" for value in (row.chamber_set_c, *row.gyro_c)),
        *biases,
        p_text(row.fit_p_value),
    ]


def _dwell_biases(row: DwellRow, scale: BiasScale) -> list[str]:
    return [scale.with_sigma(*pair) for pair in zip(row.bias_dph, row.sigma_dph, strict=True)]


def _available_figure(figures: Mapping[str, Path], name: str, caption: str) -> list[SectionFigure]:
    return [SectionFigure(name, caption, figures[name])] if name in figures else []


_METHOD = (
    "Positions are compared within one plateau and one power cycle, at the mean temperature of the "
    "plateau; each bias is corrected to that temperature with the gyro's own temperature curve. The "
    "uncertainties are standard uncertainties (k = 1) and include that of the correction, which those of bin "
    "means in the section Results do not. Errors that dwells have in common do not average out; drift of "
    "the accelerometers counts as independent from dwell to dwell.{2} Plateaus of one set point in several "
    "cycles are averaged where they agree and judged separately otherwise. The largest of several noisy "
    "differences overestimates the largest true one, so the table gives confidence limits for the true one. "
    "Pass: every pair of positions is below the limit with {0:g} % confidence. Fail: at least one pair is "
    "above it with {0:g} % confidence, corrected for the number of pairs. Marginal: neither. The probability "
    "of accepting a unit at a limit, and of rejecting one within all limits, is at most {1:g} %."
)
_SINGLE_DWELL_NOTE = (
    " A bias is that of the single dwell with the largest, which is more uncertain than the mean of "
    "several in the section Results."
)
_NOT_COMPARED_DWELLS = (
    "Planned dwells not compared with the others of their plateau (flagged, missing, or separated by a power "
    "cycle or other temperatures): {}."
)
_DISAGREEING_PLATEAUS = (
    "Plateaus of one set point differ between cycles by more than their noise and are judged separately: {}. "
    "The bias may depend on the temperature history."
)
_MAX_NAMED = 12
_ACCEPTANCE_CAPTIONS = (
    "Largest difference between two positions ± standard uncertainty u (k = 1) in {}, with {:g} % confidence "
    "limits, by temperature of the gyro",
    "Largest difference between two positions, and largest bias of a dwell, ± standard uncertainty u (k = 1) "
    "in {}, with {:g} % confidence limits, by temperature of the gyro",
)
_VERDICT_MARKS: Mapping[Verdict, Mark] = MappingProxyType({"pass": "", "marginal": "doubtful", "fail": "bad"})


def acceptance_section(acceptance: Acceptance | None) -> Section | None:
    """Table of the judgements of a run; None without limits."""
    if acceptance is None or acceptance.limits is None:
        return None
    limits = acceptance.limits
    paragraphs = [
        _limits_sentence(limits),
        _METHOD.format(
            100.0 * limits.confidence,
            round(100.0 * (1.0 - limits.confidence), 6),
            "" if limits.bias_dph is None else _SINGLE_DWELL_NOTE,
        ),
        _disagreement_sentence(acceptance),
        _not_compared_sentence(acceptance),
    ]
    return Section(
        "Acceptance",
        paragraphs,
        tables=[_acceptance_table(acceptance, acceptance.judgements)] if acceptance.judgements else [],
    )


def _limits_sentence(limits: AcceptanceLimits) -> str:
    texts = [f"{limits.position_difference_dph:g} deg/h between two positions at one plateau"]
    if limits.vertical_difference_dph is not None:
        texts.append(f"{limits.vertical_difference_dph:g} deg/h between a gyro's axis up and down")
    if limits.bias_dph is not None:
        texts.append(f"{limits.bias_dph:g} deg/h for the magnitude of the bias")
    sentence = f"Limits of the procedure: {listed(texts)}."
    if limits.bias_sigma_dph is not None:
        sentence += (
            f" A dwell with a standard uncertainty above {limits.bias_sigma_dph:g} deg/h counts as "
            "not measured."
        )
    return sentence


def _disagreement_sentence(acceptance: Acceptance) -> str:
    names = [
        f"{gyro_label(each.gyro)} at {bin_label(each.bin_low_c, each.bin_high_c)} °C"
        for each in acceptance.judgements
        if not each.passes_agree
    ]
    return _DISAGREEING_PLATEAUS.format(listed(names)) if names else ""


def _not_compared_sentence(acceptance: Acceptance) -> str:
    dwells = acceptance.dwells_not_measured
    if not dwells:
        return ""
    names = [
        position_label(position)
        + ("" if set_c is None else f" at {set_c:g} °C in the chamber")
        + f" in cycle {cycle}"
        for cycle, set_c, position in dwells[:_MAX_NAMED]
    ]
    unnamed = len(dwells) - len(names)
    return _NOT_COMPARED_DWELLS.format(listed([*names, f"{unnamed} more"] if unnamed else names))


def verdict_box(acceptance: Acceptance) -> Box:
    """The verdict on the unit."""
    verdict = acceptance.verdict
    return Box(VERDICT_COLOURS[verdict], f"Unit {verdict}.", acceptance_sentence(acceptance))


def acceptance_summary(acceptance: Acceptance) -> Section:
    """The verdict on the unit, and the decisive judgement of each gyro."""
    deciding = [each for each in map(acceptance.deciding, AXES) if each]
    table = _acceptance_table(acceptance, deciding)
    undecided = [
        [gyro_label(gyro), "", "", acceptance.gyros.get(gyro, "")]
        for gyro in AXES
        if gyro not in {each.gyro for each in deciding}
    ]
    table = replace(table, rows=[*table.rows, *undecided], marks=())
    return Section("", boxes=[verdict_box(acceptance)], tables=[table] if deciding else [])


def _acceptance_table(acceptance: Acceptance, judged: Sequence[Judgement]) -> SectionTable:
    judgements = acceptance.judgements
    confidence = 100.0 * acceptance.limits.confidence if acceptance.limits else math.nan
    scale = BiasScale.of([each.limit_dph for each in judgements], [each.sigma_dph for each in judgements])
    return SectionTable(
        _ACCEPTANCE_CAPTIONS[any(each.quantity == "bias" for each in judged)].format(scale.unit, confidence),
        ["gyro", "bin / °C", "positions", "verdict", "measured ± u", "lower", "upper", "limit"],
        [_acceptance_row(each, scale) for each in judged],
        words=4,
        marks=[_VERDICT_MARKS[each.verdict] for each in judged],
    )


def _acceptance_row(judgement: Judgement, scale: BiasScale) -> list[str]:
    return [
        gyro_label(judgement.gyro),
        bin_label(judgement.bin_low_c, judgement.bin_high_c),
        " above ".join(map(position_label, judgement.worst)),
        judgement.verdict,
        scale.with_sigma(judgement.value_dph, judgement.sigma_dph),
        scale.text(judgement.at_least_dph),
        scale.text(judgement.at_most_dph),
        scale.limit_text(judgement.limit_dph),
    ]


_BEFORE_AFTER_TEXT = "Before: run {0}{1}. After: this run."
_DIFFERENT_UNITS = "The runs are of different units: {} before, {} after."
_BEGAN_LATER = "Run {} began later, {:%Y-%m-%d %H:%M} UTC, than this run, {:%Y-%m-%d %H:%M} UTC."
_BEFORE_AFTER_CAPTION = (
    "{}: bias by position, before and after. Lines join the weighted means of the temperature bins; bars are "
    "standard uncertainties."
)


def before_after_section(before: RunContent, after: RunContent, marked_c: Sequence[float] = ()) -> Section:
    """Compare the biases of an earlier run with those of this one."""
    verdict = f", unit {before.acceptance.verdict}" if before.acceptance and before.acceptance.limits else ""
    paragraphs = [_BEFORE_AFTER_TEXT.format(before.name, verdict)]
    units = [", ".join(sorted({row.unit for row in content.dwells})) for content in (before, after)]
    if units[0] != units[1]:
        paragraphs.append(_DIFFERENT_UNITS.format(*(each or "unknown" for each in units)))
    if before.started and after.started and before.started > after.started:
        paragraphs.append(_BEGAN_LATER.format(before.name, before.started, after.started))
    paragraphs += before.damage.values()
    figures = [
        SectionFigure(
            f"before_after_{gyro}",
            _BEFORE_AFTER_CAPTION.format(gyro_label(gyro)),
            partial(before_after_figure, gyro, before.bins, after.bins, marked_c),
        )
        for gyro in AXES
    ]
    return Section("Before and after", paragraphs, figures, [_before_after_table(before.bins, after.bins)])


def _before_after_table(before: Sequence[BiasBin], after: Sequence[BiasBin]) -> SectionTable:
    compared = {"before": compare_positions(before), "after": compare_positions(after)}
    comparisons_of_both = [each for comparisons in compared.values() for each in comparisons]
    scale = BiasScale.of(
        [each.largest_difference_dph for each in comparisons_of_both],
        [each.largest_difference_sigma_dph for each in comparisons_of_both],
    )
    rows = []
    for gyro in AXES:
        for run, comparisons in compared.items():
            of_gyro = [each for each in comparisons if each.gyro == gyro]
            if largest := max(of_gyro, key=lambda each: each.largest_difference_dph, default=None):
                pair, _, size = _comparison_cells(largest, scale)
                cells = [bin_label(largest.bin_low_c, largest.bin_high_c), pair, size]
            else:
                cells = ["", "nothing to compare", ""]
            rows.append([gyro_label(gyro), run, *cells])
    return SectionTable(
        f"Largest difference between positions over all bins, in {scale.unit}",
        ["gyro", "run", "bin / °C", "positions", "difference ± 1 σ"],
        rows,
        words=4,
    )
