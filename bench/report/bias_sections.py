"""Biases in the report of a run: by gyro and bin, by dwell, against limits, before and after a change."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

from gyrobench.bench.bias.bins import BiasBin, PositionComparison, compare_positions, paper_bins
from gyrobench.bench.bias.dwell_table import DwellRow, paper_rows
from gyrobench.bench.bias.verdicts import Acceptance, AcceptanceLimits, Judgement, Verdict
from gyrobench.bench.foundations.text import bin_label, listed
from gyrobench.bench.navigation.positions import AXES, POSITIONS, gyro_label, position_label
from gyrobench.bench.procedure.timeline import hours_minutes
from gyrobench.bench.report.content import RunContent
from gyrobench.bench.report.figures.bias import before_after_figure
from gyrobench.bench.report.number_format import BiasScale, bins_by_temperature, p_text, scale_of_bins
from gyrobench.bench.report.page import Mark, Section, SectionFigure, SectionTable
from gyrobench.bench.report.statements import (
    agreement_sentence,
    differing,
    equality_sentence,
    place_of,
    scatter_sentence,
)


@dataclass(frozen=True)
class ComparisonText:
    """How the positions compare in a bin by one estimator: largest difference, and between which."""

    p_value: str
    difference: str
    pair: str
    differs: bool


@dataclass(frozen=True)
class BinRow:
    """A temperature bin of one gyro as text: a cell for each position, and what their comparison shows.

    Bins in a row that are empty in all positions make one row without cells; without the paper's
    method there are no cells of it.
    """

    label: str
    cells: list[str]
    paper_cells: list[str]
    comparison: ComparisonText | None
    paper_comparison: ComparisonText | None
    temperature_spread: str

    @property
    def differs(self) -> bool:
        """Whether the positions differ by the state-space estimator."""
        return self.comparison is not None and self.comparison.differs

    @property
    def verdict(self) -> str:
        """Say which estimators find that the positions differ."""
        by_paper = self.paper_comparison is not None and self.paper_comparison.differs
        if self.paper_comparison is None or not (self.differs or by_paper):
            return "differs" if self.differs else ""
        if self.differs:
            return "differs by both" if by_paper else "differs, by the paper's not"
        return "only by the paper's"


@dataclass(frozen=True)
class GyroPart:
    """What the report says of one gyro."""

    label: str
    name: str
    unit: str
    sentence: str
    agreement: str
    scatter: str
    rows: list[BinRow]


def measured_positions(bins: Iterable[BiasBin]) -> list[str]:
    """Positions that have bins, in the order of the paper."""
    measured = {each.position for each in bins}
    return [name for name in POSITIONS if name in measured]


def gyro_part(gyro: str, bins: Sequence[BiasBin]) -> GyroPart:
    """Put the bins of one gyro into words and tables.

    Parameters
    ----------
    gyro : {"x", "y", "z"}
        Which gyro.
    bins : sequence of BiasBin
        Of all gyros: each has a column for every position measured.
    """
    own = [each for each in bins if each.gyro == gyro]
    by_paper = paper_bins(own)
    scale = scale_of_bins([*own, *by_paper])
    comparisons, paper_comparisons = compare_positions(own), compare_positions(by_paper)
    texts, paper_texts = _comparison_texts(comparisons, scale), _comparison_texts(paper_comparisons, scale)
    spreads = {each.bin_low_c: f"{each.temperature_spread_c:.1f}" for each in comparisons}
    positions = measured_positions(bins)
    rows = [
        BinRow(
            bin_label(low, high),
            _bin_cells(members, positions, scale, with_count=True),
            _bin_cells(paper_bins(members), positions, scale, with_count=False),
            texts.get(low),
            paper_texts.get(low),
            spreads.get(low, ""),
        )
        for low, high, members in bins_by_temperature(own)
    ]
    return GyroPart(
        gyro_label(gyro),
        gyro,
        scale.unit,
        equality_sentence(comparisons),
        agreement_sentence(comparisons, paper_comparisons),
        scatter_sentence(own),
        rows,
    )


def _comparison_texts(
    comparisons: Sequence[PositionComparison], scale: BiasScale
) -> dict[float, ComparisonText]:
    """Comparisons by the lower end of their bin."""
    different = differing(comparisons)
    return {
        each.bin_low_c: ComparisonText(
            p_text(each.p_value),
            scale.with_sigma(each.largest_difference_dph, each.largest_difference_sigma_dph),
            " above ".join(map(position_label, each.largest_pair)),
            each in different,
        )
        for each in comparisons
    }


def _bin_cells(
    members: Iterable[BiasBin], positions: Iterable[str], scale: BiasScale, *, with_count: bool
) -> list[str]:
    """Texts of the positions of one bin; none where all are empty."""
    texts = {
        each.position: scale.with_sigma(each.bias_dph, each.sigma_dph)
        + (f" ({each.count})" if with_count else "")
        for each in members
        if not each.is_empty
    }
    return [texts.get(position, "empty") for position in positions] if texts else []


@dataclass(frozen=True)
class DwellLine:
    """A dwell as text: temperatures of the chamber's set point and the gyros, both estimates, fit."""

    dwell: int
    cycle: int
    position: str
    start: str
    temperatures: list[str]
    biases: list[str]
    paper_biases: list[str]
    fit: str
    flags: str


@dataclass(frozen=True)
class DwellTable:
    """All dwells, and the unit of their biases."""

    unit: str
    rows: list[DwellLine]


def dwell_table(rows: Sequence[DwellRow]) -> DwellTable:
    """Put the dwells into a table."""
    estimates = [*rows, *paper_rows(rows)]
    scale = BiasScale.of(
        [bias for row in estimates for bias in row.bias_dph],
        [sigma for row in estimates for sigma in row.sigma_dph],
    )
    return DwellTable(scale.unit, [_dwell_line(row, scale) for row in rows])


def _dwell_line(row: DwellRow, scale: BiasScale) -> DwellLine:
    return DwellLine(
        dwell=row.dwell,
        cycle=row.cycle,
        position=position_label(row.position),
        start=hours_minutes(row.start_s),
        temperatures=[_temperature(value) for value in (row.chamber_set_c, *row.gyro_c)],
        biases=_dwell_biases(row, scale),
        paper_biases=[text for own in paper_rows([row]) for text in _dwell_biases(own, scale)],
        fit=p_text(row.fit_p_value),
        flags=row.flags,
    )


def _dwell_biases(row: DwellRow, scale: BiasScale) -> list[str]:
    pairs = zip(row.bias_dph, row.sigma_dph, strict=True)
    return ["" if math.isnan(bias) else scale.with_sigma(bias, sigma) for bias, sigma in pairs]


def _temperature(value: float) -> str:
    return "" if math.isnan(value) else f"{value:.1f}"


_HOW = (
    "Positions are compared within one stop of the chamber, in one power-on, at the mean temperature of the "
    "stop, with the gyro's own curve over temperature; passes of a stop in several cycles are judged by "
    "their mean where they agree, else one by one. "
    "The largest of several noisy differences is larger than the largest true one, so the table tells "
    "between which limits the true one lies. Pass: every pair of positions stays below the limit with "
    "{0:g} % confidence. Fail: some pair is above it with {0:g} % confidence, allowing for the number of all "
    "pairs. Marginal: between the two. A unit at a limit is accepted, and one within all limits is "
    "rejected, with a probability of at most {1:g} %."
)
_LACKING = (
    "Planned dwells that were not compared with the others of their stop, because they are flagged or "
    "missing, or because of a power-on or other temperatures between them: {}."
)
_DISAGREEING = (
    "Passes of the same stop disagree by more than their noise does, and are judged one by one: {}. Bias "
    "may depend there on how the temperature came about."
)
_MOST_NAMED = 12
_CAPTIONS = (
    "Largest difference between two positions in {}, by temperature of the gyro",
    "Largest difference between two positions, and largest bias, in {}, by temperature of the gyro",
)
_MARKS: Mapping[Verdict, Mark] = MappingProxyType({"pass": "", "marginal": "doubtful", "fail": "bad"})


def acceptance_section(acceptance: Acceptance | None) -> Section | None:
    """Put the judgements of a run into a table; None where the procedure states no limits."""
    if acceptance is None or acceptance.limits is None:
        return None
    limits = acceptance.limits
    paragraphs = [
        _limits_sentence(limits),
        _how(limits),
        _disagreeing_sentence(acceptance),
        _lacking_sentence(acceptance),
    ]
    return Section(
        "Acceptance",
        [text for text in paragraphs if text],
        tables=[_acceptance_table(acceptance)] if acceptance.judgements else [],
    )


def _limits_sentence(limits: AcceptanceLimits) -> str:
    told = [f"{limits.position_difference_dph:g} deg/h between two positions at one stop"]
    if limits.bias_dph is not None:
        told.append(f"a bias of {limits.bias_dph:g} deg/h of either sign")
    sentence = f"Limits of the procedure: {listed(told)}."
    if limits.bias_sigma_dph is not None:
        sentence += (
            f" A dwell whose bias is less certain than {limits.bias_sigma_dph:g} deg/h counts as "
            "not measured."
        )
    return sentence


def _how(limits: AcceptanceLimits) -> str:
    return _HOW.format(100.0 * limits.confidence, round(100.0 * (1.0 - limits.confidence), 6))


def _disagreeing_sentence(acceptance: Acceptance) -> str:
    places = [
        f"{gyro_label(each.gyro)} at {bin_label(each.bin_low_c, each.bin_high_c)} °C"
        for each in acceptance.judgements
        if not each.passes_agree
    ]
    return _DISAGREEING.format(listed(places)) if places else ""


def _lacking_sentence(acceptance: Acceptance) -> str:
    places = list(
        dict.fromkeys((each.cycle, each.chamber_set_c, each.position) for each in acceptance.not_measured)
    )
    if not places:
        return ""
    named = [
        position_label(position)
        + ("" if set_c is None else f" at {set_c:g} °C in the chamber")
        + f" in cycle {cycle}"
        for cycle, set_c, position in places[:_MOST_NAMED]
    ]
    more = len(places) - len(named)
    return _LACKING.format(listed([*named, f"{more} more"] if more else named))


def _acceptance_table(acceptance: Acceptance) -> SectionTable:
    judged = acceptance.judgements
    scale = BiasScale.of([each.limit_dph for each in judged], [each.sigma_dph for each in judged])
    return SectionTable(
        _CAPTIONS[any(each.quantity == "bias" for each in judged)].format(scale.unit),
        ["gyro", "bin / °C", "position", "verdict", "measured ± 1 σ", "true, at least", "at most", "limit"],
        [_acceptance_row(each, scale) for each in judged],
        words=4,
        marks=[_MARKS[each.verdict] for each in judged],
    )


def _acceptance_row(judged: Judgement, scale: BiasScale) -> list[str]:
    return [
        gyro_label(judged.gyro),
        bin_label(judged.bin_low_c, judged.bin_high_c),
        place_of(judged),
        judged.verdict,
        scale.with_sigma(judged.value_dph, judged.sigma_dph),
        scale.text(judged.at_least_dph),
        scale.text(judged.at_most_dph),
        scale.text(judged.limit_dph),
    ]


_TEXT = (
    "Before: run {0}{1}. After: this run. Both panels of a figure have the same scale; lines join the "
    "weighted means of the temperature bins, bars are standard uncertainties."
)
_OTHER_UNIT = "The two runs are of different units: {} before, {} after."
_FIGURE = "{}: bias by position, before and after."
_NOT_COMPARABLE = ["", "nothing to compare", ""]


def before_after_section(before: RunContent, after: RunContent, marked_c: Sequence[float] = ()) -> Section:
    """Set the biases of an earlier run beside those of this one."""
    verdict = f", unit {before.acceptance.verdict}" if before.acceptance and before.acceptance.limits else ""
    paragraphs = [_TEXT.format(before.name, verdict)]
    units = [", ".join(sorted({row.unit for row in content.dwells})) for content in (before, after)]
    if units[0] != units[1]:
        paragraphs.append(_OTHER_UNIT.format(*(unit or "unknown" for unit in units)))
    figures = [
        SectionFigure(
            f"before_after_{gyro}",
            _FIGURE.format(gyro_label(gyro)),
            before_after_figure(gyro, before.bins, after.bins, marked_c),
        )
        for gyro in AXES
    ]
    return Section("Before and after", paragraphs, figures, [_before_after_table(before.bins, after.bins)])


def _before_after_table(before: Sequence[BiasBin], after: Sequence[BiasBin]) -> SectionTable:
    compared = {"before": compare_positions(before), "after": compare_positions(after)}
    every = [each for comparisons in compared.values() for each in comparisons]
    scale = BiasScale.of(
        [each.largest_difference_dph for each in every],
        [each.largest_difference_sigma_dph for each in every],
    )
    rows = [
        [gyro_label(gyro), when, *_worst([each for each in comparisons if each.gyro == gyro], scale)]
        for gyro in AXES
        for when, comparisons in compared.items()
    ]
    return SectionTable(
        f"Largest difference between positions over all bins, in {scale.unit}",
        ["gyro", "run", "bin / °C", "between", "difference ± 1 σ"],
        rows,
        words=4,
    )


def _worst(comparisons: Sequence[PositionComparison], scale: BiasScale) -> list[str]:
    if not comparisons:
        return _NOT_COMPARABLE
    worst = max(comparisons, key=lambda each: each.largest_difference_dph)
    return [
        bin_label(worst.bin_low_c, worst.bin_high_c),
        " above ".join(map(position_label, worst.largest_pair)),
        scale.with_sigma(worst.largest_difference_dph, worst.largest_difference_sigma_dph),
    ]
