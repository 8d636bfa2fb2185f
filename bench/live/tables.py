"""Dwells measured and the bins that they fill, as a view shows them."""

from __future__ import annotations

from collections.abc import Sequence

from gyrobench.bench.bias.bins import bin_biases
from gyrobench.bench.bias.dwell_table import DwellRow
from gyrobench.bench.live.picture_parts import DwellDone, FillingBin


def dwells_done(rows: Sequence[DwellRow]) -> tuple[DwellDone, ...]:
    """Each dwell in short."""
    return tuple(
        DwellDone(row.dwell, row.cycle, row.position, row.gyro_c, row.bias_dph, row.sigma_dph, row.flags)
        for row in rows
    )


def filling_bins(rows: Sequence[DwellRow], width_c: float) -> tuple[FillingBin, ...]:
    """Bins of the dwells without flags, empty ones between them included."""
    return tuple(
        FillingBin(
            each.gyro,
            each.position,
            each.bin_low_c,
            each.bin_high_c,
            each.bias_dph,
            each.sigma_dph,
            each.count,
        )
        for each in bin_biases([row for row in rows if not row.flags], width_c)
    )
