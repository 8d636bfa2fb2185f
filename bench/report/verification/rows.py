"""Rows of the tables about the proof of a compensation, as text; an empty cell says nothing."""

from __future__ import annotations

import math
from collections.abc import Sequence

from gyrobench.bench.report.verification.wording import LABELS
from gyrobench.bench.verification.comparison import Comparison, ComparisonRow

#: Sizes of a row, with the units of :data:`UNITS`.
SIZES = ("bias", "varying", "spread", "V_E", "24 h")
UNITS = "bias, varying and spread in 0.001 deg/h, V_E in mm/s, 24 h in nmi"
_NOISE = "noise"


def total_rows(comparison: Comparison) -> list[list[str]]:
    """Compensation and sizes over all stops; the noise below."""
    return _block([each.total for each in comparison.leftovers])


def stop_rows(comparison: Comparison) -> list[list[str]]:
    """Temperature, cycle, where the fit was, compensation and sizes, for each stop; its noise below."""
    rows = []
    for stop in zip(*(each.rows for each in comparison.leftovers), strict=False):
        first = stop[0]
        where = [f"{first.gyro_c:.0f}", f"{first.cycle}", first.fit]
        for line in _block(stop):
            rows.append([*where, *line])
            where = [""] * len(where)
    return rows


def _block(rows: Sequence[ComparisonRow]) -> list[list[str]]:
    lines = [[LABELS[row.compensation], *_sizes(row)] for row in rows]
    return [*lines, [_NOISE, *_noise(rows[-1])]]


def _sizes(row: ComparisonRow) -> list[str]:
    return [
        _text(row.bias_rms_dph, 1000.0),
        _text(row.varying_rms_dph, 1000.0),
        _text(row.spread_dph, 1000.0),
        _text(row.velocity_east_mps, 1000.0, 1),
        _text(row.position_nmi),
    ]


def _noise(row: ComparisonRow) -> list[str]:
    return [
        _text(row.bias_noise_dph, 1000.0),
        _text(row.bias_noise_dph, 1000.0),
        _text(row.spread_noise_dph, 1000.0),
        _text(row.velocity_noise_mps, 1000.0, 1),
        _text(row.position_noise_nmi),
    ]


def _text(value: float, factor: float = 1.0, decimals: int = 2) -> str:
    return "" if math.isnan(value) else f"{factor * value:.{decimals}f}"
