"""How fast the temperatures of the gyros still change in a soak."""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from gyrobench.bench.dwells.temperatures import slopes_c_per_h
from gyrobench.bench.engine.bench_state import Readings
from gyrobench.bench.foundations.errors import InstrumentError

#: Span over which the rate is fitted.
_FIT_S = 600.0


class SoakTemperatures:
    """Temperatures of the gyros of one unit over the last ten minutes."""

    def __init__(self) -> None:
        self._history: deque[tuple[float, ...]] = deque()

    def add(self, name: str, readings: Readings) -> None:
        """Add the newest temperatures. Raises InstrumentError if the unit of this name sends none."""
        if any(map(math.isnan, readings.ins.optics_c)):
            raise InstrumentError(name, "sends no gyro temperatures for the soak to wait for. Use for_s.")
        self._history.append((readings.asked_s, *readings.ins.optics_c))
        while self._history[-1][0] - self._history[0][0] > _FIT_S:
            self._history.popleft()

    @property
    def rate_c_per_h(self) -> float:
        """Largest rate of a gyro's temperature; infinite while the span is too short."""
        if not self._history or self._history[-1][0] - self._history[0][0] < 0.9 * _FIT_S:
            return math.inf
        values = np.array(self._history)
        return float(np.abs(slopes_c_per_h(values[:, 0], values[:, 1:])).max())
