"""P-values of many comparisons made at once."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gyrobench.bench.foundations.arrays import FloatArray


def holm(p_values: Sequence[float]) -> FloatArray:
    """P-values after Holm: what is left below a level is so with that chance at most of one false alarm.

    It holds whether or not the comparisons depend on one another. NaN stays and is not counted.
    """
    given = np.asarray(p_values, dtype=np.float64)
    known = np.flatnonzero(~np.isnan(given))
    order = known[np.argsort(given[known], kind="stable")]
    counts = np.arange(len(order), 0, -1)
    adjusted = np.full(len(given), np.nan)
    adjusted[order] = np.minimum(np.maximum.accumulate(counts * given[order]), 1.0)
    return adjusted
