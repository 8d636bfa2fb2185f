"""Second differences of an angle; apart from what reads their results, since kernels load numba: 50 MB."""

from __future__ import annotations

import numpy as np

from gyrobench.bench.foundations.arrays import FloatArray
from gyrobench.bench.foundations.kernels import compiled


@compiled
def sum_of_squares(angle: FloatArray, factor: int) -> tuple[float, int]:
    """Sum of squares about their mean of the second differences, and their number."""
    mean, squares, count = 0.0, 0.0, 0
    for k in range(len(angle) - 2 * factor):
        second = angle[k + 2 * factor] - 2.0 * angle[k + factor] + angle[k]
        if np.isfinite(second):
            count += 1
            away = second - mean
            mean += away / count
            squares += away * (second - mean)
    return (squares, count) if count > 1 else (0.0, 0)
