"""Are p-values as chance would have them? The Kolmogorov-Smirnov test against the uniform distribution."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.special import smirnov, smirnovi


def uniformity_p_value(p_values: Sequence[float]) -> float:
    """Probability of a distribution at least as far from uniform, of at least one value in 0 to 1.

    Twice the exact one-sided probability: exact where it is small, too large elsewhere.
    """
    count, ordered = len(p_values), np.sort(p_values)
    steps = np.arange(count + 1) / count
    distance = max(np.max(steps[1:] - ordered), np.max(ordered - steps[:-1]))
    return min(1.0, 2.0 * float(smirnov(count, distance)))


def uniformity_band(count: int, probability: float = 0.95) -> float:
    """How far the distribution of so many p-values strays from uniform, with this probability at most."""
    return float(smirnovi(count, 0.5 * (1.0 - probability)))
