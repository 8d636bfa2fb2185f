"""A soak that ends when the temperatures of the gyros have settled."""

from __future__ import annotations

import math
from collections import defaultdict, deque

import numpy as np

from gyrobench.bench.dwells.temperatures import slopes_c_per_h
from gyrobench.bench.engine.bench_state import Readings
from gyrobench.bench.engine.measured_unit import MeasuredUnit
from gyrobench.bench.engine.step_context import StepContext, Ticks
from gyrobench.bench.foundations.errors import InstrumentError
from gyrobench.bench.procedure.steps import RATE_SPAN_S, Soak, span


def until_settled(step: Soak, context: StepContext) -> Ticks:
    """Wait until no gyro's temperature changes faster than the step's limit, or its time is over.

    Yields once a tick. What follows a soak that ended by its time is measured all the same, and noted.
    """
    run, bench, units = context.run, context.bench, context.units
    begin_s, polled_s, is_new = bench.clock.now(), -math.inf, False
    histories: dict[MeasuredUnit, _GyroTemperatures] = defaultdict(_GyroTemperatures)
    while (elapsed_s := bench.clock.now() - begin_s) < (step.at_most_s or math.inf):
        if polled_s < bench.readings.polled_s:
            polled_s, is_new = bench.readings.polled_s, True
            for unit in units.measuring:
                try:
                    histories[unit].add(unit.live.name, unit.live.readings)
                except InstrumentError as error:
                    units.fail(unit, error)
        if is_new and elapsed_s >= step.at_least_s:
            is_new = False
            rates = [histories[unit].rate_c_per_h for unit in units.measuring]
            if max(rates, default=math.inf) < (step.until_gyro_rate_below_c_per_h or 0.0):
                return
        yield
    rate_c_per_h = max((each.rate_c_per_h for each in histories.values()), default=math.inf)
    is_known, limit_c_per_h = math.isfinite(rate_c_per_h), step.until_gyro_rate_below_c_per_h
    rate = f"a gyro still changes by {rate_c_per_h:.3g} degC/h" if is_known else "the rate is not known yet"
    text = (
        f"soak not settled after at_most_s ({span(step.at_most_s)}), the run continues: {rate}, "
        f"limit {limit_c_per_h:g} degC/h"
    )
    run.journal.record("soak_not_settled", text=text, rate_c_per_h=rate_c_per_h, limit_c_per_h=limit_c_per_h)
    run.observers.noted(text)


class _GyroTemperatures:
    """Temperatures of the gyros of one unit over the last ten minutes."""

    def __init__(self) -> None:
        self._history: deque[tuple[float, ...]] = deque()

    def add(self, name: str, readings: Readings) -> None:
        """Add the newest temperatures. Raises InstrumentError if the unit of this name sends none."""
        if any(map(math.isnan, readings.ins.optics_c)):
            raise InstrumentError(name, "sends no gyro temperatures for the soak to wait for. Use for_s.")
        self._history.append((readings.polled_s, *readings.ins.optics_c))
        while self._history[-1][0] - self._history[0][0] > RATE_SPAN_S:
            self._history.popleft()

    @property
    def rate_c_per_h(self) -> float:
        """Largest rate of a gyro's temperature; infinite while the span is too short."""
        if not self._history or self._history[-1][0] - self._history[0][0] < 0.9 * RATE_SPAN_S:
            return math.inf
        values = np.array(self._history)
        return float(np.abs(slopes_c_per_h(values[:, 0], values[:, 1:])).max())
