"""What the report says of a change: the run before it beside this one."""

from __future__ import annotations

from collections.abc import Sequence

from gyrobench.bench.bias.bins import BiasBin, PositionComparison, compare_positions
from gyrobench.bench.foundations.text import bin_label
from gyrobench.bench.navigation.positions import AXES, gyro_label, position_label
from gyrobench.bench.report.content import RunContent
from gyrobench.bench.report.figures.before_after import before_after_figure
from gyrobench.bench.report.page.sections import Section, SectionFigure, SectionTable
from gyrobench.bench.report.wording import BiasScale

_TEXT = (
    "Before: run {0}{1}. After: this run. Both panels of a figure have the same scale; lines join the "
    "weighted means of the temperature bins, bars are standard uncertainties."
)
_OTHER_UNIT = "The two runs are of different units: {} before, {} after."
_FIGURE = "{}: bias by position, before and after."
_NOTHING = ["", "nothing to compare", ""]


def before_after_section(before: RunContent, after: RunContent) -> Section:
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
            before_after_figure(gyro, before.bins, after.bins),
        )
        for gyro in AXES
    ]
    return Section("Before and after", paragraphs, figures, [_table(before.bins, after.bins)])


def _table(before: Sequence[BiasBin], after: Sequence[BiasBin]) -> SectionTable:
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
        return _NOTHING
    worst = max(comparisons, key=lambda each: each.largest_difference_dph)
    return [
        bin_label(worst.bin_low_c, worst.bin_high_c),
        " above ".join(map(position_label, worst.largest_pair)),
        scale.with_sigma(worst.largest_difference_dph, worst.largest_difference_sigma_dph),
    ]
