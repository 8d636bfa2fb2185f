"""Damping of the velocity by an INS that should navigate free inertially."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

#: Lowest rate that is reported, 1/s: a lower one has little effect on the biases.
_MIN_DAMPING = 0.5 / 3600.0
#: Share of the uncertainty of the rate in one dwell that is the same error in all dwells of a unit.
_COMMON_SHARE = 0.3


@dataclass(frozen=True, slots=True)
class Damping:
    """Rate at which an INS damps its velocity, with its standard uncertainty, 1/s."""

    FLAG: ClassVar = "the INS damps its velocity"

    rate: float
    sigma: float

    @property
    def p_value(self) -> float:
        """Probability of at least this rate in a free inertial INS (one-sided)."""
        return 0.5 * math.erfc(self.rate / self.sigma / math.sqrt(2.0))

    def is_significant(self, max_p_value: float) -> bool:
        """Whether the rate is large enough to affect the biases, and its p-value below ``max_p_value``."""
        return self.rate >= _MIN_DAMPING and self.p_value < max_p_value

    @property
    def text(self) -> str:
        """Message for an INS that damps its velocity."""
        return (
            f"{self.FLAG} with a time constant of {1.0 / self.rate:.0f} s, so that the biases "
            "of the level gyros are wrong. Switch it to free inertial navigation"
        )

    @classmethod
    def mean(cls, dwells: Sequence[Damping]) -> Damping:
        """Mean of the rates of one or more dwells of an INS, weighted by 1/sigma^2.

        Its uncertainty includes the scatter and the errors that the dwells have in common: settling of the
        accelerometers, and biases that follow the temperature within a dwell.
        """
        rates = np.array([each.rate for each in dwells])
        weights = np.array([each.sigma**-2.0 for each in dwells])
        rate = weights @ rates / weights.sum()
        scatter = weights @ (rates - rate) ** 2 / max(len(rates) - 1, 1)
        common = _COMMON_SHARE**2 * len(rates) if len(rates) > 1 else 0.0
        return cls(float(rate), float(np.sqrt((max(scatter, 1.0) + common) / weights.sum())))
