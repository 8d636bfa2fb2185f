"""The tables of a report as text, cell by cell."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from bench.bias.bins import BiasBin
from bench.bias.dwell_table import DwellRow
from bench.bias.equality import PositionComparison, compare_positions
from bench.navigation.positions import POSITIONS
from bench.procedure.timeline import hours_minutes
from bench.report.wording import (
    BiasScale,
    bin_label,
    bins_by_temperature,
    differing,
    equality_sentence,
    gyro_label,
    p_text,
    position_label,
    scale_of_bins,
    scatter_sentence,
)


@dataclass(frozen=True)
class BinRow:
    """A temperature bin of one gyro as text: a cell for each position, and what their comparison shows.

    Bins in a row that are empty in all positions make one row without cells.
    """

    label: str
    cells: list[str]
    comparison: PositionComparison | None
    p_value: str = ""
    difference: str = ""
    pair: str = ""
    differs: bool = False


@dataclass(frozen=True)
class GyroPart:
    """What the report says of one gyro."""

    label: str
    name: str
    unit: str
    sentence: str
    scatter: str
    rows: list[BinRow]


@dataclass(frozen=True)
class DwellLine:
    """A dwell: temperatures of the chamber's set point and the gyros, biases of the gyros, as text."""

    dwell: int
    cycle: int
    position: str
    start: str
    temperatures: list[str]
    biases: list[str]
    flags: str


@dataclass(frozen=True)
class DwellTable:
    """All dwells, and the unit of their biases."""

    unit: str
    rows: list[DwellLine]


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
    scale = scale_of_bins(own)
    comparisons = compare_positions(own)
    by_bin = {each.bin_low_c: each for each in comparisons}
    different = {each.bin_low_c for each in differing(comparisons)}
    rows = []
    for low, high, members in bins_by_temperature(own):
        cells = {each.position: _cell(each, scale) for each in members}
        texts = [cells.get(position, "empty") for position in measured_positions(bins)] if members else []
        rows.append(_bin_row(bin_label(low, high), texts, by_bin.get(low), scale, low in different))
    return GyroPart(
        gyro_label(gyro), gyro, scale.unit, equality_sentence(comparisons), scatter_sentence(own), rows
    )


def _bin_row(
    label: str, cells: list[str], comparison: PositionComparison | None, scale: BiasScale, differs: bool
) -> BinRow:
    if comparison is None:
        return BinRow(label, cells, None)
    high, low = map(position_label, comparison.largest_pair)
    return BinRow(
        label,
        cells,
        comparison,
        p_value=p_text(comparison.p_value),
        difference=scale.with_sigma(
            comparison.largest_difference_dph, comparison.largest_difference_sigma_dph
        ),
        pair=f"{high} above {low}",
        differs=differs,
    )


def _cell(each: BiasBin, scale: BiasScale) -> str:
    return "empty" if each.is_empty else f"{scale.with_sigma(each.bias_dph, each.sigma_dph)} ({each.count})"


def dwell_table(rows: Sequence[DwellRow]) -> DwellTable:
    """Put the dwells into a table."""
    scale = BiasScale.of(
        [bias for row in rows for bias in row.bias_dph], [sigma for row in rows for sigma in row.sigma_dph]
    )
    return DwellTable(scale.unit, [_dwell_line(row, scale) for row in rows])


def _dwell_line(row: DwellRow, scale: BiasScale) -> DwellLine:
    biases = [
        "" if math.isnan(bias) else scale.with_sigma(bias, sigma)
        for bias, sigma in zip(row.bias_dph, row.sigma_dph, strict=True)
    ]
    return DwellLine(
        dwell=row.dwell,
        cycle=row.cycle,
        position=position_label(row.position),
        start=hours_minutes(row.start_s),
        temperatures=[_number(value) for value in (row.chamber_set_c, *row.gyro_c)],
        biases=biases,
        flags=row.flags,
    )


def _number(value: float) -> str:
    return "" if math.isnan(value) else f"{value:.1f}"
