"""Words for a table that does not come to rest."""

from __future__ import annotations

import math
from collections.abc import Sequence


def turns_still(rates_dps: Sequence[float], waited_s: float) -> str:
    """Say that a table still turns, or may do so.

    Parameters
    ----------
    rates_dps : sequence of float
        Last known rate of each axis; NaN where none could be read.
    waited_s : float
        Time since the stop.
    """
    if any(math.isnan(rate_dps) for rate_dps in rates_dps):
        return f"tells no rate {waited_s:g} s after the stop and may still turn"
    fastest_dps = max(rates_dps, key=abs)
    return f"still turns at {fastest_dps:.3g} deg/s {waited_s:g} s after the stop"
