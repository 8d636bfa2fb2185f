"""Velocity that an INS damps, although free inertial navigation is expected of it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

#: Least rate that is reported, 1/s: what a slower one does to the biases is small.
_MIN_DAMPING = 0.5 / 3600.0
#: Share of its uncertainty in one dwell that is the same in all dwells of a unit.
_COMMON_SHARE = 0.3


@dataclass(frozen=True, slots=True)
class Damping:
    """Rate at which an INS damps its velocity, with its standard uncertainty, 1/s."""

    FLAG: ClassVar = "the INS damps its velocity"

    rate: float
    sigma: float

    @property
    def p_value(self) -> float:
        """Probability of at least this rate in an INS that is free inertial; damping is never negative."""
        return 0.5 * math.erfc(self.rate / self.sigma / math.sqrt(2.0))

    def shows(self, p_value: float) -> bool:
        """Whether the INS damps its velocity: at a rate that matters, rarer by chance than this."""
        return self.rate >= _MIN_DAMPING and self.p_value < p_value

    @property
    def text(self) -> str:
        """Message for an INS that damps its velocity."""
        return (
            f"{self.FLAG} with a time constant of {1.0 / self.rate:.0f} s, so that the biases "
            "of the level gyros are wrong. Switch it to free inertial navigation"
        )

    @classmethod
    def mean(cls, several: Sequence[Damping]) -> Damping:
        """Mean of several dwells of one INS, weighted by the inverse squares of their uncertainties.

        Its uncertainty is that of the scatter, and of what the dwells have in common: how accelerometers
        settle, and biases that follow the temperature within a dwell. ``several``: one or more, 1/s.
        """
        rates = np.array([each.rate for each in several])
        weights = np.array([each.sigma**-2.0 for each in several])
        rate = weights @ rates / weights.sum()
        scatter = weights @ (rates - rate) ** 2 / max(len(rates) - 1, 1)
        common = _COMMON_SHARE**2 * len(rates) if len(rates) > 1 else 0.0
        return cls(float(rate), float(np.sqrt((max(scatter, 1.0) + common) / weights.sum())))
