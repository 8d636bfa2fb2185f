"""What a view shows of the dwell under way: its windows and its estimates, as they build up."""

from __future__ import annotations

import numpy as np

from gyrobench.bench.bias.bias_filter import StateSpaceEstimate
from gyrobench.bench.foundations.arrays import FloatArray
from gyrobench.bench.live.picture import MOST_ESTIMATES, MOST_IN_WINDOW
from gyrobench.bench.live.picture_parts import DwellNow, LiveBias, WindowTrace
from gyrobench.bench.live.thinned import Thinned
from gyrobench.bench.procedure.plan import PlannedStep
from gyrobench.drivers.ins.ins_status import InsStatus


class _Window:
    """One window; its heading counts from the first attitude that is known."""

    def __init__(self, planned_s: float, begun_s: float) -> None:
        self._planned_s = planned_s
        self._begun_s = begun_s
        self._first: FloatArray | None = None
        self._rows: Thinned[tuple[float, float, float, float]] = Thinned(MOST_IN_WINDOW)

    def add(self, time_s: float, ins: InsStatus) -> None:
        if self._first is None and not np.isnan(ins.attitude).any():
            self._first = ins.attitude
        heading_deg = float("nan") if self._first is None else _heading_deg(ins.attitude @ self._first.T)
        east, north, _ = ins.velocity_enu_mps.tolist()
        self._rows.add((time_s - self._begun_s, east, north, heading_deg))

    def trace(self) -> WindowTrace:
        rows = self._rows.rows()
        return (
            WindowTrace(self._planned_s, *map(tuple, zip(*rows, strict=True)))
            if rows
            else WindowTrace(self._planned_s)
        )


class DwellTrace:
    """Collects the dwell under way.

    Parameters
    ----------
    planned : PlannedStep
        Its alignment.
    count : int
        Number of dwells of the plan.
    """

    def __init__(self, planned: PlannedStep, count: int) -> None:
        self._planned = planned
        self._count = count
        self._windows: list[_Window] = []
        self._is_open = False
        self._estimates: Thinned[LiveBias] = Thinned(MOST_ESTIMATES)

    def begin_window(self, planned_s: float, now_s: float) -> None:
        """A stretch of navigation begins."""
        self._windows.append(_Window(planned_s, now_s))
        self._is_open = True

    def end_window(self) -> None:
        """It is over: what the INS says in a turn belongs to no window."""
        self._is_open = False

    def add(self, time_s: float, ins: InsStatus) -> None:
        """Take what the INS says; kept while a window goes on."""
        if self._is_open:
            self._windows[-1].add(time_s, ins)

    def estimated(self, time_s: float, estimate: StateSpaceEstimate) -> None:
        """Take the newest estimate."""
        bias, sigma = estimate.bias_dph.tolist(), estimate.sigma_dph.tolist()
        self._estimates.add(LiveBias(time_s, tuple(bias), tuple(sigma)))

    def now(self) -> DwellNow:
        """What there is by now."""
        planned = self._planned
        return DwellNow(
            number=planned.dwell or 0,
            count=self._count,
            cycle=planned.cycle,
            position=planned.after.position or "",
            windows=tuple(window.trace() for window in self._windows),
            estimates=tuple(self._estimates.rows()),
        )


def _heading_deg(turned: FloatArray) -> float:
    """Angle about Up of a small rotation (3, 3), NaN if that is not known."""
    return float(np.rad2deg(np.arctan2(turned[1, 0] - turned[0, 1], turned[0, 0] + turned[1, 1])))
