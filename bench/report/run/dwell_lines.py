"""The table of dwells of a report, cell by cell."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from gyrobench.bench.bias.dwell_table import DwellRow, paper_rows
from gyrobench.bench.navigation.positions import position_label
from gyrobench.bench.procedure.timeline import hours_minutes
from gyrobench.bench.report.wording import BiasScale, p_text


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
        temperatures=[_number(value) for value in (row.chamber_set_c, *row.gyro_c)],
        biases=_biases(row, scale),
        paper_biases=[text for own in paper_rows([row]) for text in _biases(own, scale)],
        fit=p_text(row.fit_p_value),
        flags=row.flags,
    )


def _biases(row: DwellRow, scale: BiasScale) -> list[str]:
    pairs = zip(row.bias_dph, row.sigma_dph, strict=True)
    return ["" if math.isnan(bias) else scale.with_sigma(bias, sigma) for bias, sigma in pairs]


def _number(value: float) -> str:
    return "" if math.isnan(value) else f"{value:.1f}"
